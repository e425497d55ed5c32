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
from .gauss_newton import SLACK
from .goal import EXTRA_MARGIN, Goal, angle
from .joints import JointSpace
from .miss import active_constraints
from .posture import Posture, posture_of, same_posture
from .search import find_path
from .task import Coordinates, JointCoordinates, Task, TipCoordinates

# Counted and not timed, so that a loaded machine finds the same path. On an idle core it is half of the 20 s that
# `tubeopt ik` has for a target by default; the other half is left to the search of the answer.
PATH_WORK, PATH_MARGIN = 10.0, 2e-3
"""Largest work of a search for a snap-free path to one solution, in seconds of counted work (`task.Work`), and the
margin kept on it; half of the margin at its ends if that is less."""

# Near the axis, and near straight arms, joints turn far although nothing jumps.
TURN_PER_MOVE, SHIFT_PER_MOVE = 20.0, 8.0
"""Largest changes of a rotation, rad, and of a translation, in units of its scale, that are no jump.

They are per motion of the tip in robot's lengths and, for a target with direction, rad. A carriage that moves more than
four times as far as the tip changes the configuration.
"""

# A tip that moves around the axis turns all tubes with it by its azimuth, however close to the axis it is.
TURN_PER_AZIMUTH = 2.0
"""Additional rotation that is no jump, per angle that the tip moves about the axis of the plate."""

# The motion in the null space turns joints also where the tip rests.
MIN_JUMP = 0.02
"""Motion of a joint, in units of its scale, that is no jump in any case."""

# The path of the tip leaves the chord by the square of the step. The least one keeps round-off out.
DEVIATION, MIN_DEVIATION = 0.05, 1e-5
"""Distance of the tip from the line between two targets that is no jump: relative to their distance, plus a
constant, m."""

CHECKED_EVERY = 0.1
"""Joint motion between two checked points of the path, in units of the joints' scales."""


def snap_free_path(
    space: JointSpace, start: Equilibrium, goal: Equilibrium, clock: Clock, *, least_margin: float
) -> tuple[Array, Array] | None:
    """Rotations and translations (W, n) of the waypoints of a snap-free path between two stable equilibria.

    The search is that of `plan_trajectory`, in tip rotations and translations: an equilibrium is a point, and a line of
    stable equilibria a motion. They have `least_margin`, or half the margin of the ends if that is less. The path is
    then thinned, and checked by `follow`. Joint limits and the order of the tubes are satisfied; obstacles are ignored.

    Returns None if no path is found within PATH_WORK or the time of the clock, which is no proof that there is none.
    Without OMPL only straight paths, and paths by translations that exclude any snap, are tried.
    """
    ends = posture_of(space, start), posture_of(space, goal)
    straight = _followed(space, np.stack([end.q for end in ends]), ends)
    if straight is not None:
        return straight
    # With an end's own margin as the bound nothing around that end would be allowed.
    reserve = min(least_margin, 0.5 * start.margin, 0.5 * goal.margin)
    coordinates: Coordinates = TipCoordinates(space) if space.robot.fixed_sections else JointCoordinates(space)
    task = Task(coordinates, (), 0.0, 0.0, margin_reserve=reserve)
    budget = Clock(PATH_WORK, clock, lambda: task.work.seconds)
    try:
        path = find_path(task, task.coordinates.of(start), [task.coordinates.of(goal)], budget)
    except InputError:  # no OMPL
        return None
    if path.points is None:
        return None
    for parts in (1, 4):  # as the search checks motions, then more finely
        table = _joints(task, path.points, parts)
        table[0], table[-1] = ends[0].q, ends[1].q
        thin = _thinned(table, ends[0])
        for rows in [table] if thin is None else [thin, table]:
            equilibria = _followed(space, rows, ends)
            if equilibria is not None:
                return equilibria
    return None


def _joints(task: Task, points: Array, parts: int) -> Array:
    """Joint values (W, m) along straight motions between points in tip coordinates."""
    rows = [points[:1]]
    for a, b in pairwise(points):
        waypoints = task.line(a, b)
        steps = np.arange(1, parts + 1)[:, None, None] / parts
        rows.append((waypoints[:-1] + steps * np.diff(waypoints, axis=0)).transpose(1, 0, 2).reshape(-1, len(a)))
    line = np.concatenate(rows)
    return task.coordinates.joints(line)


def _thinned(table: Array, start: Posture) -> Array | None:
    """Selected rows of a table of joint values (W, m), few enough that straight motions between them stay on the
    branch.

    None if the branch ends between two rows of the table.
    """
    branch = [start]
    for q in table[1:]:
        following = branch[-1].to(q)
        if following is None:
            return None
        branch.append(following)
    thinned, current = [table[0]], 0
    while current < len(table) - 1:
        step = len(table) - 1 - current
        # Bisection: the longest step found whose straight motion ends on the same branch.
        while step > 1 and not same_posture(branch[current].to(table[current + step]), branch[current + step]):
            step = (step + 1) // 2
        current += step
        thinned.append(table[current])
    return np.stack(thinned)


def _followed(space: JointSpace, table: Array, ends: tuple[Posture, Posture]) -> tuple[Array, Array] | None:
    """Rotations and translations (W, n) of joint values (W, m) if the robot follows them without a snap, else None."""
    rotations, translations = np.split(space.joint(table), 2, axis=1)
    try:
        # The search integrated from tip angles. Here equilibria are solved at joint values, and snaps are searched.
        path = follow(space.robot, rotations, translations, start=ends[0].equilibrium)
    except (SolveError, InputError):
        return None
    miss = float(np.linalg.norm(path.equilibria[-1].tip_position - ends[1].tip))
    return None if path.snaps or miss > 1e-6 else (rotations, translations)


def straight_path(origin: str, start: Posture | None, end: Posture) -> JointPath | None:
    """Straight joint path between two postures; None without a start, or if the robot may snap on the path."""
    if start is None or not same_posture(start.to(end.q), end):
        return None
    return joint_path_of(origin, end.space, [start.q, end.q])


def answer_at(
    goal: Goal, at: Posture, status: InverseStatus, statistics: InverseStatistics, **path_fields: Any
) -> InverseSolution:
    """Solution at a posture; `path_fields` are the fields on the path to it."""
    return InverseSolution(
        target_position=goal.position,
        target_direction=goal.direction,
        equilibrium=at.equilibrium,
        position_error=goal.position_error(at),
        direction_error=goal.direction_error(at),
        scene=goal.scene,
        active=tuple(active_constraints(goal, at)),
        status=status,
        statistics=statistics,
        **path_fields,
    )


def joint_path_of(origin: str, space: JointSpace, points: Sequence[Array]) -> JointPath:
    """Joint path through independent joint values (m,)."""
    return JointPath(origin, *np.split(space.joint(np.array(points)), 2, axis=1))


def with_path(answer: InverseSolution, start: Posture | None, goal: Goal) -> InverseSolution:
    """Solution with a snap-free path from a posture; `reachable` is False if none is found in time."""
    if answer.path is not None:
        return answer
    known = None
    if start is not None and not goal.clock.over:
        ends = start.equilibrium, answer.equilibrium
        known = snap_free_path(goal.space, *ends, goal.clock, least_margin=PATH_MARGIN)
    if known is None:
        return replace(answer, reachable=False)
    path = JointPath("home" if answer.straight_from_seed is None else "seed", *known)
    straight = None if answer.straight_from_seed is None else len(path.rotations) == 2
    return replace(answer, reachable=True, path=path, straight_from_seed=straight)


def jump_between(goal: Goal, before: Posture, after: Posture) -> tuple[str, bool]:
    """Reason why the straight joint path between two solutions jumps, or ''; and whether it is free of snaps.

    No jump: the tip stays near the straight line, no joint moves farther than the motion of the tip explains, and
    margin and clearance are kept. Snaps are found as far as steps of ordinary length show them.
    """
    reasons = _large_motion(goal, before, after)
    count = 1 + int(np.ceil(float(np.abs((after.q - before.q) / goal.space.scale).max()) / CHECKED_EVERY))
    deviation, margin, violation, current = 0.0, np.inf, 0.0, before
    for k in range(1, count + 1):
        following = current.to(before.q + (after.q - before.q) * (k / count) if k < count else after.q)
        if following is None or (k == count and not same_posture(following, after)):
            return ", ".join([*reasons, "the robot snaps on the straight path, or comes close to a snap"]), False
        current = following
        if k < count:
            deviation = max(deviation, _distance_from_line(current.tip, before.tip, after.tip))
            margin = min(margin, current.margin)
            violation = max(violation, goal.violation(current) if goal.hindered else 0.0)
    if deviation > DEVIATION * float(np.linalg.norm(after.tip - before.tip)) + MIN_DEVIATION:
        reasons.append(f"the tip leaves the line between the targets by {deviation * 1e3:.3g} mm")
    if margin < min(goal.kept_margin, before.margin, after.margin) - EXTRA_MARGIN:
        reasons.append(f"the margin falls to {margin:.4g}")
    if violation > SLACK + max(goal.kept_clearance - goal.clearance, 0.0):
        reasons.append(
            "the arm comes too close to an obstacle" if goal.scene.bodies else "a custom constraint is violated"
        )
    return ", ".join(reasons), True


def _large_motion(goal: Goal, before: Posture, after: Posture) -> list[str]:
    """Text on the joint that moves much more than the motion of the tip requires; "" if there is none."""
    n = goal.space.robot.n_tubes
    moved = np.abs(after.q - before.q) / goal.space.scale
    size = float(np.linalg.norm(after.tip - before.tip)) / goal.space.length
    if goal.pointed:
        size += angle(before.direction, after.direction)
    allowed = np.where(np.arange(len(moved)) < n, TURN_PER_MOVE, SHIFT_PER_MOVE) * size + MIN_JUMP
    azimuth = np.arctan2(after.tip[1], after.tip[0]) - np.arctan2(before.tip[1], before.tip[0])
    allowed[:n] += TURN_PER_AZIMUTH * abs(float(azimuth + np.pi) % (2 * np.pi) - np.pi)
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
    fraction = float(np.clip((point - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0))
    return float(np.linalg.norm(point - start - fraction * along))
