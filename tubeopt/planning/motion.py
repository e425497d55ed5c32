"""Joint values over time, limits of the actuators, and violations of ranges, order, rates and accelerations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.interpolate import PPoly

from ..display import Displayed
from ..errors import InputError, numbers, positive, without_unit_warnings
from ..files.field_metadata import POSITIVE, Typical, check_typical, key
from ..files.units import TO_MM
from ..inverse.joints import JointSpace, joint_space
from ..robots.limits import MOST_TURN, JointLimits, default_limits
from ..robots.robot import Robot
from ..typing import Array

INSTANT = 1e-9
"""Duration (s) below which a motion counts as a rest."""

OF_JOINTS = ("rotation", "translation", "rotation_acceleration", "translation_acceleration")
"""Limits that are one number for all tubes, or one per tube."""


# Drives interpolate linearly between samples, and so does the proof.
MIN_SAMPLES, MIN_SAMPLES_OF_TIP, MAX_SAMPLES = 100, 300, 4000
"""Bounds of the number of samples of a motion; the second applies where the speed of the tip is limited."""

# As far apart as the equilibria of a proof (`trajectory_trace.LARGEST_TURN`), whose first steps are the samples.
# Measured on six plans: half takes 1.4 times as many equilibria, twice changes their number by 1 %, since the proof
# adds its own.
SAMPLE_STEP = 0.04
"""Largest change of a joint between samples, in units of its scale."""

SLACK = 1e-6
"""Relative excess of a rate or a range that is round-off."""

Rates = float | tuple[float, ...]


@dataclass(frozen=True)
class RateLimits(Displayed):
    """Limits on the speeds and accelerations of the actuators and the tip; one number for all tubes, or one per tube.

    Raises:
        InputError: a limit that is not a finite number greater than 0.
    """

    rotation: Annotated[
        Rates, key("rotation_deg_per_s"), POSITIVE, Typical(0.03, 4 * np.pi), "largest rotation rate"
    ] = np.pi / 2
    """Largest rotation rate, rad/s."""
    translation: Annotated[
        Rates, key("translation_mm_per_s"), POSITIVE, Typical(1e-4, 0.2), "largest translation rate"
    ] = 0.02
    """Largest translation rate, m/s."""
    rotation_acceleration: Annotated[
        Rates, key("rotation_deg_per_s2"), POSITIVE, Typical(0.03, 20 * np.pi), "largest rotation acceleration"
    ] = np.pi
    """Largest acceleration of the rotations, rad/s^2."""
    translation_acceleration: Annotated[
        Rates, key("translation_mm_per_s2"), POSITIVE, Typical(1e-4, 5.0), "largest translation acceleration"
    ] = 0.04
    """Largest acceleration of the translations, m/s^2."""
    tip: Annotated[
        float | None, key("tip_mm_per_s"), POSITIVE, Typical(1e-4, 2.0), "largest tip speed; default no limit"
    ] = None
    """Largest speed of the tip, m/s; None for no limit."""

    def __post_init__(self) -> None:
        if self.tip is not None:
            object.__setattr__(self, "tip", positive("tip of the rate limits", self.tip))
        for name in OF_JOINTS:
            limit, label = getattr(self, name), f"{name} of the rate limits"
            values = tuple(positive(label, each) for each in numbers(label, limit))
            object.__setattr__(self, name, values if np.ndim(limit) else values[0])
        check_typical(self, "the rate limits")

    def of(self, space: JointSpace) -> tuple[Array, Array]:
        """(m,) rates and (m,) accelerations of independent joints; raises InputError for another number of tubes."""
        n, table = space.robot.n_tubes, []
        for name in OF_JOINTS:
            values = np.atleast_1d(np.array(getattr(self, name)))
            if len(values) not in (1, n):
                raise InputError(f"rate_limits.{name} has {len(values)} numbers; it must have 1, or {n} (one per tube)")
            table.append(np.broadcast_to(values, (n,)))
        rates, accelerations = (
            np.concatenate([turn, [move[list(tubes)].min() for tubes in space.carriages]])
            for turn, move in (table[:2], table[2:])
        )
        return rates, accelerations


DEFAULT_RATES = RateLimits()

with without_unit_warnings():
    ANY_RATES = RateLimits(*(1e12,) * 4)
"""Limits that no motion reaches."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joint values (m,) as polynomials of time in between knots, from 0 s on."""

    curve: PPoly
    tip_limited: bool = False
    """True if the speed of the tip is limited, which needs more samples."""

    @staticmethod
    def resting(q: Array) -> JointMotion:
        """Rest at joint values (m,)."""
        return JointMotion(PPoly(q[None, None], [0.0, INSTANT / 2]))

    @property
    def time(self) -> Array:
        """(K,) times of the knots, s."""
        return np.asarray(self.curve.x)

    @property
    def duration(self) -> float:
        """Duration, s."""
        return float(self.time[-1])

    def slower(self, factor: float) -> JointMotion:
        """Motion with its duration multiplied by a factor."""
        order = np.arange(len(self.curve.c) - 1, -1, -1)[:, None, None]
        return replace(self, curve=PPoly(self.curve.c / factor**order, self.time * factor))

    def length(self, scale: Array) -> float:
        """Length of the path in joint space, in units of the joints' scales."""
        return float(np.linalg.norm(np.diff(self.sampled(scale)[1] / scale, axis=0), axis=1).sum())

    def sampled(self, scale: Array) -> tuple[Array, Array]:
        """Evenly spaced times (T,) and joint values (T, m), close enough for linear interpolation."""
        if self.duration < INSTANT:  # from joint values to the same, but for round-off
            return np.zeros(1), self.curve(np.zeros(1))
        coarse = self.curve(np.linspace(0, self.duration, 40 * len(self.time)))
        change = np.abs(np.diff(coarse / scale, axis=0)).max() * len(coarse)
        min_count = MIN_SAMPLES_OF_TIP if self.tip_limited else MIN_SAMPLES
        count = int(np.clip(np.ceil(change / SAMPLE_STEP), min_count, MAX_SAMPLES))
        time = np.linspace(0, self.duration, count + 1)
        return time, self.curve(time)


def joint_range(robot: Robot, limits: JointLimits | None) -> JointSpace:
    """Joint space of limits, by default those of the robot.

    Without limits, rotations are free and lengths limit translations.
    """
    if limits is None and robot.joint_limits is None:
        free = ((-MOST_TURN, MOST_TURN),) * robot.n_tubes
        limits = JointLimits(free, default_limits(robot.tubes).translations)
    return joint_space(robot, limits)


def rates_of(t: Array, values: Array) -> tuple[Array, Array]:
    """(n,) largest rates between samples, and largest accelerations, of the columns of a table (T, n)."""
    if len(t) < 2:
        return np.zeros(values.shape[1]), np.zeros(values.shape[1])
    h = np.diff(t)[:, None]
    rate = np.diff(values, axis=0) / h
    change = np.diff(rate, axis=0) / ((h[1:] + h[:-1]) / 2) if len(h) > 1 else np.zeros((1, values.shape[1]))
    return np.abs(rate).max(0), np.abs(change).max(0)


def out_of_range(space: JointSpace, alpha: Array, shift: Array) -> list[str]:
    """Messages on joint values out of range and on tubes out of order."""
    faults = []
    space = space.holding(*shift)
    try:
        q = np.array([space.join(a, d) for a, d in zip(alpha, shift, strict=True)])
    except InputError as error:
        return [f"the tubes leave their order: {error}"]
    over = np.maximum(space.lower - q, q - space.upper) / space.scale
    k, joint = np.unravel_index(int(np.argmax(over)), over.shape)
    if over[k, joint] > SLACK:
        n = alpha.shape[1]
        name = f"rotation of tube {joint + 1}" if joint < n else f"translation of carriage {joint - n + 1}"
        value = f"{np.degrees(q[k, joint]):.5g} deg" if joint < n else f"{q[k, joint] * 1e3:.5g} mm"
        faults.append(f"{name} leaves its range at sample {k + 1}, {value}")
    if len(space.row_lower):
        excess = (space.row_lower - q @ space.rows.T).max(0) / space.length
        row = int(np.argmax(excess))
        if excess[row] > SLACK:
            far = excess[row] * space.length * TO_MM
            faults.append(f"tubes leave their order: {space.row_faults[row]}, by {far:.4g} mm")
    return faults


def too_fast(space: JointSpace, rates: Sequence[tuple[Array, Array]], tip_rate: float, limits: RateLimits) -> list[str]:
    """Messages on rates and accelerations of joints, and on tip speeds, above their limits."""
    faults = []
    if limits.tip is not None and tip_rate > limits.tip * (1 + SLACK):
        faults.append(f"the tip reaches {tip_rate * 1e3:.4g} mm/s; it must be at most {limits.tip * 1e3:.4g} mm/s")
    n = space.robot.n_tubes
    units = ((180 / np.pi, "deg/s"), (1e3, "mm/s")), ((180 / np.pi, "deg/s^2"), (1e3, "mm/s^2"))
    for order, limit in enumerate(limits.of(space)):
        max_rate = np.concatenate([limit[:n], (space.spread @ np.append(np.zeros(n), limit[n:]))[n:]])
        for kind, what in enumerate(("rotation", "translation")):
            needed, allowed = rates[kind][order], max_rate[kind * n : kind * n + n]
            i = int(np.argmax(needed / allowed))
            factor, unit = units[order][kind]
            if needed[i] > allowed[i] * (1 + 1e-3 * order + SLACK):
                faults.append(
                    f"{what} of tube {i + 1} reaches {needed[i] * factor:.4g} {unit}; "
                    f"it must be at most {allowed[i] * factor:.4g} {unit}"
                )
    return faults
