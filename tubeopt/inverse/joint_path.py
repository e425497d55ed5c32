"""Joint paths: snap-free paths to solutions of inverse kinematics, and checks for jumps between solutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..stability.following import follow
from ..typing import Array
from .answer import InverseSolution, InverseStatistics, InverseStatus, JointPath
from .clock import Clock
from .gauss_newton import SLACK, held_by
from .goal import MARGIN_ROOM, Goal, angle
from .joints import JointSpace
from .posture import Posture, posture_of, same_place
from .search import find_way
from .task import Task, TipCoordinates

# Counted and not timed, so that a loaded machine finds the same path. On an idle core it is half of the 20 s that
# `tubeopt ik` has for a target by default; the other half is left to the search of the answer.
PATH_WORK, PATH_MARGIN = 10.0, 2e-3
"""Largest work of a search for a snap-free path to one solution, in seconds of counted work (`task.Work`), and the
margin kept on it; half of the margin at its ends if that is less."""

# Near the axis, and near straight arms, joints turn far although nothing jumps.
TURN_PER_MOVE, SHIFT_PER_MOVE = 20.0, 8.0
"""Motion of a rotation, rad, and of a translation, in units of its scale, that is no jump: per motion of the tip in
robot's lengths and, where it is pointed, rad. A carriage that moves more than four times as far as the tip changes the
configuration."""

# A tip that moves around the axis turns all tubes with it by its azimuth, however close to the axis it is.
TURN_PER_AZIMUTH = 2.0
"""Additional rotation that is no jump, per angle that the tip moves about the axis of the plate."""

# The motion in the null space turns joints also where the tip rests.
LEAST_JUMP = 0.02
"""Motion of a joint, in units of its scale, that is no jump in any case."""

# The path of the tip leaves the chord by the square of the step. The least one keeps round-off out.
DEVIATION, LEAST_DEVIATION = 0.05, 1e-5
"""Distance of the tip from the line between two targets that is no jump: as a share of their distance; least, m."""

CHECKED_EVERY = 0.1
"""Joint motion between two checked points of the path, in units of the joints' scales."""


def snap_free_path(
    space: JointSpace, start: Equilibrium, goal: Equilibrium, clock: Clock, *, least_margin: float
) -> tuple[Array, Array] | None:
    """Rotations and translations (W, n) of waypoints from one stable equilibrium to another, straight from each to the
    next, without a snap.

    Searched as `plan_trajectory` does, in tip rotations and translations, where an equilibrium is a point and a line of
    stable ones a motion, with `least_margin` or half of what the ends have where that is less; then thinned, and
    followed once more by `follow`. Ranges of the joints and the order of the tubes are kept; obstacles are not looked
    at. None where no way was found by PATH_WORK or in the time of the clock, which does not prove that there is none.
    Without OMPL only straight ways and those by translations that exclude any snap are tried.
    """
    ends = posture_of(space, start), posture_of(space, goal)
    straight = _followed(space, np.stack([end.q for end in ends]), ends)
    if straight is not None:
        return straight
    # With an end's own margin as the bound nothing around that end would be allowed.
    floor = min(least_margin, 0.5 * start.margin, 0.5 * goal.margin)
    task = Task(TipCoordinates(space), (), 0.0, 0.0, margin_room=floor)
    budget = Clock(PATH_WORK, clock, lambda: task.work.seconds)
    try:
        way = find_way(task, task.chart.of(start), [task.chart.of(goal)], budget)
    except InputError:  # no OMPL
        return None
    if way.points is None:
        return None
    for parts in (1, 4):  # as the search checks motions, then more finely
        table = _joints(task, way.points, parts)
        table[0], table[-1] = ends[0].q, ends[1].q
        thin = _thinned(table, ends[0])
        for rows in [table] if thin is None else [thin, table]:
            found = _followed(space, rows, ends)
            if found is not None:
                return found
    return None


def _joints(task: Task, points: Array, parts: int) -> Array:
    """(W, m) joint values along the straight motions between points of the chart."""
    rows = [points[:1]]
    for a, b in pairwise(points):
        marks = task.line(a, b)
        steps = np.arange(1, parts + 1)[:, None, None] / parts
        rows.append((marks[:-1] + steps * np.diff(marks, axis=0)).transpose(1, 0, 2).reshape(-1, len(a)))
    line = np.concatenate(rows)
    return task.chart.joints(line)


def _thinned(table: Array, start: Posture) -> Array | None:
    """Rows of a table of joint values (W, m) between which the robot can go straight, few of them; None where the
    branch is lost between two rows."""
    branch = [start]
    for q in table[1:]:
        there = branch[-1].to(q)
        if there is None:
            return None
        branch.append(there)
    kept, here = [table[0]], 0
    while here < len(table) - 1:
        step = len(table) - 1 - here
        # Bisection: the longest step found whose straight motion ends on the same branch.
        while step > 1 and not same_place(branch[here].to(table[here + step]), branch[here + step]):
            step = (step + 1) // 2
        here += step
        kept.append(table[here])
    return np.stack(kept)


def _followed(space: JointSpace, table: Array, ends: tuple[Posture, Posture]) -> tuple[Array, Array] | None:
    """Rotations and translations of rows of joint values (W, m), if the robot follows them from the one posture to the
    other without a snap; else None."""
    rotations, translations = np.split(space.joint(table), 2, axis=1)
    try:
        # The search integrated from tip angles. Here equilibria are solved at joint values, and snaps are searched.
        path = follow(space.robot, rotations, translations, start=ends[0].equilibrium)
    except (SolveError, InputError):
        return None
    missed = float(np.linalg.norm(path.equilibria[-1].tip_position - ends[1].tip))
    return None if path.snaps or missed > 1e-6 else (rotations, translations)


def straight_way(origin: str, begin: Posture | None, end: Posture) -> JointPath | None:
    """The straight way of joint values between two postures; None where steps of ordinary length do not show that the
    robot does not snap on it, or there is no begin."""
    if begin is None or not same_place(begin.to(end.q), end):
        return None
    return joint_path_of(origin, end.space, [begin.q, end.q])


def answer_at(
    goal: Goal, at: Posture, status: InverseStatus, statistics: InverseStatistics, **told: Any
) -> InverseSolution:
    """The answer to a question at a posture, with what is `told` of how the robot gets there."""
    return InverseSolution(
        target_position=goal.position,
        target_direction=goal.direction,
        equilibrium=at.equilibrium,
        position_error=goal.position_error(at),
        direction_error=goal.direction_error(at),
        scene=goal.scene,
        active=tuple(held_by(goal, at)),
        status=status,
        statistics=statistics,
        **told,
    )


def joint_path_of(origin: str, space: JointSpace, points: Sequence[Array]) -> JointPath:
    """A way through independent joint values (m,)."""
    return JointPath(origin, *np.split(space.joint(np.array(points)), 2, axis=1))


def with_a_way(answer: InverseSolution, begin: Posture | None, goal: Goal) -> InverseSolution:
    """The answer with a way to it from a posture, its `reachable` False where none is found in time."""
    if answer.path is not None:
        return answer
    found = None
    if begin is not None and not goal.clock.over:
        ends = begin.equilibrium, answer.equilibrium
        found = snap_free_path(goal.space, *ends, goal.clock, least_margin=PATH_MARGIN)
    if found is None:
        return replace(answer, reachable=False)
    way = JointPath("home" if answer.straight_from_seed is None else "seed", *found)
    straight = None if answer.straight_from_seed is None else len(way.rotations) == 2
    return replace(answer, reachable=True, path=way, straight_from_seed=straight)


def jump_between(goal: Goal, before: Posture, after: Posture) -> tuple[str, bool]:
    """Reason why the straight joint path between two solutions jumps, or ''; and whether it is free of snaps.

    No jump: the tip stays near the straight line, no joint moves farther than the motion of the tip explains, and
    margin and clearance are kept. Snaps are found as far as steps of ordinary length show them.
    """
    words = _far(goal, before, after)
    count = 1 + int(np.ceil(float(np.abs((after.q - before.q) / goal.space.scale).max()) / CHECKED_EVERY))
    deviation, margin, gap, here = 0.0, np.inf, 0.0, before
    for k in range(1, count + 1):
        there = here.to(before.q + (after.q - before.q) * (k / count) if k < count else after.q)
        if there is None or (k == count and not same_place(there, after)):
            return ", ".join([*words, "the robot snaps on the straight path, or comes close to a snap"]), False
        here = there
        if k < count:
            deviation = max(deviation, _distance_from_line(here.tip, before.tip, after.tip))
            margin, gap = min(margin, here.margin), max(gap, goal.violation(here) if goal.hindered else 0.0)
    if deviation > DEVIATION * float(np.linalg.norm(after.tip - before.tip)) + LEAST_DEVIATION:
        words.append(f"the tip leaves the line between the targets by {deviation * 1e3:.3g} mm")
    if margin < min(goal.floor, before.margin, after.margin) - MARGIN_ROOM:
        words.append(f"the margin falls to {margin:.4g}")
    if gap > SLACK + max(goal.gap - goal.clearance, 0.0):
        words.append(
            "the arm comes too close to an obstacle" if goal.scene.bodies else "a custom constraint is violated"
        )
    return ", ".join(words), True


def _far(goal: Goal, before: Posture, after: Posture) -> list[str]:
    """In words, the joint that moves farthest beyond what the motion of the tip explains; empty if none does."""
    n = goal.space.robot.n_tubes
    moved = np.abs(after.q - before.q) / goal.space.scale
    size = float(np.linalg.norm(after.tip - before.tip)) / goal.space.length
    if goal.pointed:
        size += angle(before.direction, after.direction)
    allowed = np.where(np.arange(len(moved)) < n, TURN_PER_MOVE, SHIFT_PER_MOVE) * size + LEAST_JUMP
    turn = np.arctan2(after.tip[1], after.tip[0]) - np.arctan2(before.tip[1], before.tip[0])
    allowed[:n] += TURN_PER_AZIMUTH * abs(float(turn + np.pi) % (2 * np.pi) - np.pi)
    worst = int(np.argmax(moved - allowed))
    if moved[worst] <= allowed[worst]:
        return []
    if worst < n:
        return [f"tube {worst + 1} turns by {np.degrees(moved[worst]):.4g} deg"]
    tube = goal.space.carriages[worst - n][0] + 1
    return [f"tube {tube} is moved by {moved[worst] * goal.space.scale[worst] * 1e3:.4g} mm"]


def _distance_from_line(point: Array, start: Array, end: Array) -> float:
    """Distance of a point from a straight line between two others, m."""
    along = end - start
    share = float(np.clip((point - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0))
    return float(np.linalg.norm(point - start - share * along))
