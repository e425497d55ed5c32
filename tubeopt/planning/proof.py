"""Proof of a trajectory: followed once more, by another solver than that of the search.

The joint values are followed densely by `forward_kinematics` (collocation and Newton's method, where the planner
integrates from the tip), in steps that are halved wherever the margin or the clearance could fall short between two
equilibria; samples are integrated once more by DOP853. Clearance is that of points on the surface of the arm.

Shared with the planner are `forward_kinematics`, with which smoothing looks between its knots, and the distances of
obstacles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..equilibrium import Equilibrium
from ..errors import InputError, SolveError, finite, positive
from ..inverse.joints import JointSpace, joint_space
from ..inverse.posture import arm_radius
from ..kinematics import forward_kinematics
from ..obstacles import Obstacle, nearest_distance
from ..robots.assembly import Array
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..stability.following import _waypoints
from ..verification import verify_equilibrium
from .arguments import check_robot, checked_obstacles, kind_of
from .clock import Clock
from .motion import RateLimits

TURN = 0.02
"""Largest turn (rad) of a joint between two equilibria of the proof."""

SHIFT = 0.002
"""Largest translation between two equilibria, as a share of the longest tube."""

LEAP = 0.2
"""Change (rad) of a tip rotation between two equilibria, beyond that of the joints, after which the step is halved: a
solver that starts on one branch and ends on another leaps, while on one branch halves of a step change less."""

HALVINGS = 6
"""Times that a step is halved at most, where margin or clearance may fall short in between, or the branch be lost."""

AROUND = 8
"""Points around the arm, and `ALONG` points along it, at which clearance is measured."""

ALONG = 300

SAMPLES = 5
"""Equilibria that are integrated once more."""

AGREEMENT = 1e-6
"""Largest difference of a tip from its re-integration, over the length of the robot."""

SLACK = 1e-6
"""Relative excess of a rate that is round-off."""


@dataclass(frozen=True, eq=False)
class Proof:
    """What was found on a trajectory that was followed once more.

    Attributes:
        snap: fraction of the time at which the branch ends, None where it reaches the end.
        least_margin, least_clearance (m): of all equilibria; `clearance_bound` (m) also of what is between them.
        largest_rotation_rate, largest_translation_rate: rad/s, m/s; largest accelerations, rad/s^2, m/s^2.
        largest_tip_step: between two equilibria of the proof, m.   tip_length: of the way of the tip, m.
        reintegration: largest difference of a tip from DOP853, m.
        equilibria: how many were solved.   end: the last of them.
        faults: in words, what is not as it must be; empty for a trajectory that is proved.
        followed: share of the time that was followed before a time limit ended the proof; else 1, or up to a snap.
    """

    snap: float | None
    least_margin: float
    least_clearance: float
    clearance_bound: float
    largest_rotation_rate: float
    largest_translation_rate: float
    largest_rotation_acceleration: float
    largest_translation_acceleration: float
    largest_tip_step: float
    tip_length: float
    reintegration: float
    equilibria: int
    end: Equilibrium
    faults: tuple[str, ...]
    followed: float = 1.0

    @property
    def holds(self) -> bool:
        """Whether the trajectory is proved."""
        return not self.faults

    @property
    def open(self) -> bool:
        """Whether time ran out before anything was proved or refuted."""
        return self.snap is None and self.followed < 1 and len(self.faults) == 1


@dataclass(frozen=True, eq=False)
class Follower:
    """What is looked at on the way: obstacles, and the margin and clearance (m) below which steps are halved."""

    robot: Robot
    obstacles: tuple[Obstacle, ...]
    min_margin: float
    clearance: float
    length: float
    clock: Clock | None = None

    @property
    def late(self) -> bool:
        """Whether the time that there is for the proof is over."""
        return self.clock is not None and self.clock.over

    def surface(self, e: Equilibrium) -> Array:
        """(p, 3) points of the arm's surface, m; of the centreline where there are no obstacles to be clear of."""
        s = np.linspace(0.0, float(e.arc_length[-1]), ALONG)
        line = _interpolate(e, s)
        if not self.obstacles:
            return line
        x, y = (np.column_stack([np.interp(s, e.arc_length, e.frame[:, k, c]) for k in range(3)]) for c in (0, 1))
        angle = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
        circle = np.cos(angle)[:, None, None] * x + np.sin(angle)[:, None, None] * y
        return np.asarray((line + arm_radius(e, s)[:, None] * circle).reshape(-1, 3))

    def least(self, e: Equilibrium) -> float:
        """Clearance of one equilibrium: of points of the surface, and of the centreline less the radius, m."""
        if not self.obstacles:
            return float("inf")
        s = np.linspace(0.0, float(e.arc_length[-1]), ALONG)
        line = nearest_distance(self.obstacles, _interpolate(e, s)) - arm_radius(e, s)
        return float(min(nearest_distance(self.obstacles, self.surface(e)).min(), line.min()))


@dataclass(frozen=True, eq=False)
class Step:
    """An equilibrium of the proof with its clearance, m, and the fraction of the time."""

    at: float
    equilibrium: Equilibrium
    clearance: float


def verify_trajectory(
    robot: Robot,
    time: ArrayLike,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    start: Equilibrium | None = None,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = 0.0,
    clearance: float = 0.0,
    rate_limits: RateLimits | None = None,
    limits: JointLimits | None = None,
    clock: Clock | None = None,
) -> Proof:
    """Follow a trajectory, of whatever origin, and say what is wrong with it. Between samples joint values are linear.

    Args:
        time: (T,) s, increasing.   rotations, translations: (T, n) rad and m; translations default to home.
        start: stable equilibrium at the first sample; by default that of `forward_kinematics`.
        obstacles, min_margin, clearance (m), rate_limits, limits: what must be kept. Rates are not limited by default;
            joint limits are those of the robot.
        clock: when it is over the proof ends where it is, not proved: `.open`, `.followed`.

    Raises:
        InputError: tables of wrong shape or with numbers that are not finite, times that do not increase, an unstable
            start or one at other joint values.
        SolveError: there is no stable equilibrium at the first sample.
    """
    check_robot(robot, limits)
    bodies = checked_obstacles(obstacles)
    for name, value, kind in (("rate_limits", rate_limits, RateLimits), ("start", start, Equilibrium)):
        if value is not None:
            kind_of(name, value, kind)
    alpha, shift = _waypoints(robot, rotations, translations)
    t = _times(time, len(alpha))
    if finite("min_margin", min_margin) >= 1:
        raise InputError(f"min_margin is {min_margin:g}; it must be less than 1")
    positive("clearance", clearance, zero=True)
    first = start if start is not None else forward_kinematics(robot, alpha[0], shift[0])
    if not first.stable:
        raise InputError(f"start has margin {first.margin:.3g}; it must be a stable equilibrium (margin above 0)")
    own = np.concatenate([first.rotations - alpha[0], first.translations - shift[0]])
    if np.abs(own).max() > 1e-6:
        raise InputError("start is at other joint values than the first sample; they must be the same")
    space = joint_space(robot, limits)
    follower = Follower(robot, bodies, min_margin, clearance, space.length, clock)
    steps, snap = _follow(follower, first, t, np.concatenate([alpha, shift], axis=1))
    return _judge(follower, space, steps, snap, (t, alpha, shift), rate_limits)


def _times(time: ArrayLike, count: int) -> Array:
    try:
        t = np.array(time, dtype=float)
    except (TypeError, ValueError):
        raise InputError("time must be numbers, one per sample") from None
    if t.shape != (count,):
        raise InputError(f"time has shape {t.shape}; it must be one number for each of the {count} samples")
    if not np.isfinite(t).all():
        raise InputError(
            f"time is {t[int(np.argmin(np.isfinite(t)))]} at sample {int(np.argmin(np.isfinite(t))) + 1}; "
            "it must be finite"
        )
    if (np.diff(t) <= 0).any():
        k = int(np.argmax(np.diff(t) <= 0))
        raise InputError(
            f"time is {t[k + 1]:g} s at sample {k + 2}, after {t[k]:g} s; it must increase from sample to sample"
        )
    return t


def _follow(follower: Follower, first: Equilibrium, t: Array, joints: Array) -> tuple[list[Step], float | None]:
    """Equilibria all along, and the fraction of the time where the branch ends."""
    steps = [Step(0.0, first, follower.least(first))]
    span = float(t[-1] - t[0]) or 1.0
    size = np.array([TURN] * (joints.shape[1] // 2) + [SHIFT * follower.length] * (joints.shape[1] // 2))
    for k in range(len(joints) - 1):
        a, b = joints[k], joints[k + 1]
        count = max(1, int(np.ceil((np.abs(b - a) / size).max() - 1e-9)))
        for j in range(1, count + 1):
            there = b if j == count else a + (b - a) * (j / count)
            at = float(t[k] + (t[k + 1] - t[k]) * (j / count) - t[0]) / span
            ahead = _towards(follower, steps[-1], at, there, HALVINGS)
            if ahead is None:
                return steps, steps[-1].at
            if follower.late:
                return steps, None
            steps += ahead
    return steps, None


def _towards(follower: Follower, here: Step, at: float, joint: Array, halvings: int) -> list[Step] | None:
    """Steps up to joint values (2n,), closer to each other where something may fall short; None where it snaps."""
    rotations, shift = np.split(joint, 2)
    own = np.concatenate([here.equilibrium.rotations, here.equilibrium.translations])
    try:
        e = forward_kinematics(follower.robot, rotations, shift, guess=here.equilibrium)
    except SolveError:
        return None
    if not e.stable:
        return None
    turned = float(np.abs(e.tip_rotations - here.equilibrium.tip_rotations).max())
    leaps = turned > LEAP + float(np.abs((joint - own)[: len(rotations)]).max())
    if leaps and halvings == 0:
        return None
    there = Step(at, e, follower.least(e))
    change = abs(e.margin - here.equilibrium.margin)
    near = min(e.margin, here.equilibrium.margin) - 0.5 * change < follower.min_margin + 1e-4
    tight = _bound(follower, here, there) < follower.clearance
    if halvings == 0 or not (near or tight or leaps) or follower.late:
        return [there]
    if np.abs(joint - own).max() < 1e-9:
        return [there]
    first = _towards(follower, here, (here.at + at) / 2, (own + joint) / 2, halvings - 1)
    if first is None:
        return None
    second = _towards(follower, first[-1], at, joint, halvings - 1)
    return None if second is None else first + second


def _bound(follower: Follower, one: Step, other: Step) -> float:
    """Clearance that is left between two equilibria: a distance changes by no more than its point moves, m."""
    if not follower.obstacles:
        return float("inf")
    lines = []
    for step in (one, other):
        e = step.equilibrium
        lines.append(_interpolate(e, np.linspace(0.0, float(e.arc_length[-1]), 60)))
    moved = float(np.linalg.norm(lines[1] - lines[0], axis=1).max())
    return min(one.clearance, other.clearance, (one.clearance + other.clearance - moved) / 2)


def _judge(
    follower: Follower,
    space: JointSpace,
    steps: list[Step],
    snap: float | None,
    table: tuple[Array, Array, Array],
    rate_limits: RateLimits | None,
) -> Proof:
    """Gather what was found, and say what is wrong."""
    t, alpha, shift = table
    margin = min(step.equilibrium.margin for step in steps)
    clear = min(step.clearance for step in steps)
    bound = min([clear, *(_bound(follower, a, b) for a, b in pairwise(steps))])
    tips = np.array([step.equilibrium.tip_position for step in steps])
    moved = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    picked = [steps[k].equilibrium for k in np.unique(np.linspace(0, len(steps) - 1, SAMPLES).astype(int))]
    late = follower.late and snap is None and steps[-1].at < 1 - SLACK
    checks = [] if late else [verify_equilibrium(e).verification for e in picked]
    again = max((check.tip_position for check in checks if check is not None), default=float("nan"))
    rates = [_rates(t, values) for values in (alpha, shift)]
    faults = []
    if late:
        faults.append(f"not proved: the time limit was reached when {100 * steps[-1].at:.1f} % of it was followed")
    if snap is not None:
        faults.append(f"the robot snaps: the branch ends after {100 * snap:.2f} % of the time")
    if margin < follower.min_margin:
        faults.append(f"the margin falls to {margin:.4g}; it must be at least {follower.min_margin:g}")
    if clear < follower.clearance:
        needed = follower.clearance
        faults.append(f"the arm comes as close as {clear * 1e3:.4g} mm; it must keep {needed * 1e3:g} mm")
    if again > AGREEMENT * follower.length:
        faults.append(f"re-integration moves the tip by {again * 1e3:.3g} mm")
    faults += _out_of_range(space, alpha, shift)
    if rate_limits is not None:
        faults += _too_fast(space, rates, rate_limits)
    return Proof(
        snap=snap,
        least_margin=margin,
        least_clearance=clear,
        clearance_bound=bound,
        largest_rotation_rate=float(rates[0][0].max(initial=0.0)),
        largest_translation_rate=float(rates[1][0].max(initial=0.0)),
        largest_rotation_acceleration=float(rates[0][1].max(initial=0.0)),
        largest_translation_acceleration=float(rates[1][1].max(initial=0.0)),
        largest_tip_step=float(moved.max(initial=0.0)),
        tip_length=float(moved.sum()),
        reintegration=again,
        equilibria=len(steps),
        end=steps[-1].equilibrium,
        faults=tuple(faults),
        followed=steps[-1].at if late or snap is not None else 1.0,
    )


def _rates(t: Array, values: Array) -> tuple[Array, Array]:
    """(n,) largest rates between samples, and largest accelerations between these, of columns."""
    if len(t) < 2:
        return np.zeros(values.shape[1]), np.zeros(values.shape[1])
    h = np.diff(t)[:, None]
    rate = np.diff(values, axis=0) / h
    change = np.diff(rate, axis=0) / ((h[1:] + h[:-1]) / 2) if len(h) > 1 else np.zeros((1, values.shape[1]))
    return np.abs(rate).max(0), np.abs(change).max(0)


def _out_of_range(space: JointSpace, alpha: Array, shift: Array) -> list[str]:
    """Joint values beyond their range, and tubes out of order."""
    faults = []
    q = np.array([space.join(a, d) for a, d in zip(alpha, shift, strict=True)])
    tied = np.abs(np.array([space.joint(row) for row in q])[:, alpha.shape[1] :] - shift).max()
    if tied > 1e-9:
        faults.append(f"tubes that move together are moved apart by {tied * 1e3:.3g} mm")
    over = np.maximum(space.lower - q, q - space.upper) / space.scale
    k, joint = np.unravel_index(int(np.argmax(over)), over.shape)
    if over[k, joint] > SLACK:
        n = alpha.shape[1]
        name = f"rotation of tube {joint + 1}" if joint < n else f"translation of carriage {joint - n + 1}"
        value = f"{np.degrees(q[k, joint]):.5g} deg" if joint < n else f"{q[k, joint] * 1e3:.5g} mm"
        faults.append(f"{name} leaves its range at sample {k + 1}, {value}")
    if len(space.least):
        late = (space.least - q @ space.rows.T).max(0) / space.length
        row = int(np.argmax(late))
        if late[row] > SLACK:
            faults.append(f"the tubes leave their order: beyond {space.row_names[row]}")
    return faults


def _too_fast(space: JointSpace, rates: Sequence[tuple[Array, Array]], limits: RateLimits) -> list[str]:
    """Joints that are faster, or accelerate more, than their limits."""
    faults = []
    n = space.robot.n_tubes
    units = ((180 / np.pi, "deg/s"), (1e3, "mm/s")), ((180 / np.pi, "deg/s^2"), (1e3, "mm/s^2"))
    for order, limit in enumerate(limits.of(space)):
        most = np.concatenate([limit[:n], (space.spread @ np.append(np.zeros(n), limit[n:]))[n:]])
        for kind, what in enumerate(("rotation", "translation")):
            own, allowed = rates[kind][order], most[kind * n : kind * n + n]
            i = int(np.argmax(own / allowed))
            factor, unit = units[order][kind]
            if own[i] > allowed[i] * (1 + 1e-3 * order + SLACK):
                faults.append(
                    f"{what} of tube {i + 1} reaches {own[i] * factor:.4g} {unit}; "
                    f"it must be at most {allowed[i] * factor:.4g} {unit}"
                )
    return faults


def _interpolate(e: Equilibrium, s: Array) -> Array:
    """(p, 3) centreline at arc lengths, cubic between the points of the solution."""
    from scipy.interpolate import CubicHermiteSpline

    along, keep = np.unique(e.arc_length, return_index=True)
    if len(along) < 2:
        return np.repeat(e.position[:1], len(s), axis=0)
    points: Array = CubicHermiteSpline(along, e.position[keep], e.frame[keep][:, :, 2])(s)
    return points
