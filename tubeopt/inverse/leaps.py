"""Whether the straight way of joint values between two answers leaps: what the tip does between two targets."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .descent import SLACK
from .goal import Goal, angle
from .posture import Posture, same_place


def leap(goal: Goal, before: Posture, after: Posture) -> tuple[str, bool]:
    """What makes the straight way of joint values between two answers a leap, in words, empty if nothing does; and
    whether the robot follows it to the second without a snap, as far as steps of ordinary length tell.

    The tip has to stay near the straight line, joints may move no farther than the motion of the tip explains, and
    margin and clearance are kept.
    """
    words, solver = _far(goal, before, after), goal.solver
    count = 1 + int(np.ceil(float(np.abs((after.q - before.q) / goal.space.scale).max()) / solver.leap_sampled))
    aside, margin, gap, here = 0.0, np.inf, 0.0, before
    for k in range(1, count + 1):
        there = here.to(before.q + (after.q - before.q) * (k / count) if k < count else after.q)
        if there is None or (k == count and not same_place(there, after)):
            return ", ".join([*words, "the robot snaps on the straight way, or comes close to it"]), False
        here = there
        if k < count:
            aside = max(aside, _aside(here.tip, before.tip, after.tip))
            margin, gap = min(margin, here.margin), max(gap, goal.violation(here) if goal.hindered else 0.0)
    if aside > solver.leap_aside * float(np.linalg.norm(after.tip - before.tip)) + solver.leap_least_aside:
        words.append(f"the tip leaves the line between the targets by {aside * 1e3:.3g} mm")
    if margin < min(goal.floor, before.margin, after.margin) - solver.margin_room:
        words.append(f"the margin falls to {margin:.4g}")
    if gap > SLACK + max(goal.gap - goal.clearance, 0.0):
        words.append("the arm comes too close to an obstacle" if goal.scene.bodies else "an own constraint is not kept")
    return ", ".join(words), True


def _far(goal: Goal, before: Posture, after: Posture) -> list[str]:
    """In words, the joint that moves farthest beyond what the motion of the tip explains; empty if none does."""
    n, solver = goal.space.robot.n_tubes, goal.solver
    moved = np.abs(after.q - before.q) / goal.space.scale
    size = float(np.linalg.norm(after.tip - before.tip)) / goal.space.length
    if goal.pointed:
        size += angle(before.direction, after.direction)
    allowed = np.where(np.arange(len(moved)) < n, solver.leap_turn, solver.leap_shift) * size + solver.leap_least
    turn = np.arctan2(after.tip[1], after.tip[0]) - np.arctan2(before.tip[1], before.tip[0])
    allowed[:n] += solver.leap_azimuth * abs(float(turn + np.pi) % (2 * np.pi) - np.pi)
    worst = int(np.argmax(moved - allowed))
    if moved[worst] <= allowed[worst]:
        return []
    if worst < n:
        return [f"tube {worst + 1} turns by {np.degrees(moved[worst]):.4g} deg"]
    tube = goal.space.carriages[worst - n][0] + 1
    return [f"tube {tube} is moved by {moved[worst] * goal.space.scale[worst] * 1e3:.4g} mm"]


def _aside(point: Array, start: Array, end: Array) -> float:
    """Distance of a point from a straight line between two others, m."""
    along = end - start
    share = float(np.clip((point - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0))
    return float(np.linalg.norm(point - start - share * along))
