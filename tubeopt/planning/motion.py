"""A motion: joint values as a function of time, polynomials between knots; and the limits that actuators set to it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, numbers, positive
from ..files.marks import POSITIVE, key
from ..inverse.joints import JointSpace
from ..typing import Array
from .effort import Timing

INSTANT = 1e-9
"""Duration (s) of a motion that goes nowhere."""

OF_JOINTS = ("rotation", "translation", "rotation_acceleration", "translation_acceleration")
"""Limits that are one number for all tubes, or one per tube."""


Rates = float | tuple[float, ...]
EACH = "for all tubes, or one per tube"


@dataclass(frozen=True)
class RateLimits(Displayed):
    """How fast the actuators are; but for the tip, one number for all tubes, or one per tube.

    Args:
        rotation, translation: greatest rates, rad/s and m/s.
        rotation_acceleration, translation_acceleration: rad/s^2 and m/s^2.
        tip: greatest speed of the tip, m/s; None where it does not matter.

    Raises:
        InputError: a limit that is not a finite number greater than 0.
    """

    rotation: Annotated[Rates, key("rotation_deg_per_s"), POSITIVE, EACH] = np.pi / 2
    translation: Annotated[Rates, key("translation_mm_per_s"), POSITIVE, EACH] = 0.02
    rotation_acceleration: Annotated[Rates, key("rotation_deg_per_s2"), POSITIVE, EACH] = np.pi
    translation_acceleration: Annotated[Rates, key("translation_mm_per_s2"), POSITIVE, EACH] = 0.04
    tip: Annotated[float | None, key("tip_mm_per_s"), POSITIVE, "greatest speed of the tip; by default any"] = None

    def __post_init__(self) -> None:
        if self.tip is not None:
            object.__setattr__(self, "tip", positive("tip of the rate limits", self.tip))
        for name in OF_JOINTS:
            given, label = getattr(self, name), f"{name} of the rate limits"
            values = tuple(positive(label, each) for each in numbers(label, given))
            object.__setattr__(self, name, values if np.ndim(given) else values[0])

    def of(self, space: JointSpace) -> tuple[Array, Array]:
        """(m,) rates and (m,) accelerations of independent joints; raises InputError for another number of tubes."""
        n, table = space.robot.n_tubes, []
        for name in OF_JOINTS:
            values = np.atleast_1d(np.array(getattr(self, name)))
            if len(values) not in (1, n):
                raise InputError(f"{name} of the rate limits has {len(values)} numbers; it must be 1 or {n}")
            table.append(np.broadcast_to(values, (n,)))
        rates, accelerations = (
            np.concatenate([turn, [move[list(tubes)].min() for tubes in space.carriages]])
            for turn, move in (table[:2], table[2:])
        )
        return rates, accelerations


DEFAULT_RATES = RateLimits()


@dataclass(frozen=True, eq=False)
class Motion:
    """Knots: time (K,) s from 0, joint values (K, m); in between polynomials of the time since the knot before, with
    coefficients (d, K - 1, m), that of the highest power first and without the constant one. `tip_limited`: whether the
    speed of the tip is."""

    time: Array
    joints: Array
    """(K, m) at the knots."""
    powers: Array
    """(d, K - 1, m) coefficients in between."""
    tip_limited: bool = False

    @property
    def duration(self) -> float:
        """Seconds."""
        return float(self.time[-1])

    @property
    def curve(self) -> scipy.interpolate.PPoly:
        """The same as a function of time, of a motion that takes time."""
        return scipy.interpolate.PPoly(np.concatenate([self.powers, self.joints[None, :-1]]), self.time)

    def slower(self, factor: float) -> Motion:
        """The same in so many times the time."""
        order = np.arange(len(self.powers), 0, -1)[:, None, None]
        return replace(self, time=self.time * factor, powers=self.powers / factor**order)

    def length(self, scale: Array, timing: Timing) -> float:
        """Of the path in joint space, in units of the joints' scales."""
        return float(np.linalg.norm(np.diff(self.sampled(scale, timing)[1] / scale, axis=0), axis=1).sum())

    def at(self, time: ArrayLike) -> Array:
        """(T, m) joint values at times (T,)."""
        if self.duration == 0:
            return np.repeat(self.joints[:1], np.size(time), axis=0)
        values: Array = self.curve(np.asarray(time))
        return values

    def sampled(self, scale: Array, timing: Timing) -> tuple[Array, Array]:
        """Evenly spaced times (T,) and joint values (T, m), close enough that straight lines between them will do."""
        if self.duration < INSTANT:  # from joint values to the same, but for round-off
            return np.zeros(1), self.joints[:1]
        coarse = self.at(np.linspace(0, self.duration, 40 * len(self.time)))
        change = np.abs(np.diff(coarse / scale, axis=0)).max() * len(coarse)
        least = timing.samples_of_tip if self.tip_limited else timing.samples
        count = int(np.clip(np.ceil(change / timing.sample_step), least, timing.most_samples))
        time = np.linspace(0, self.duration, count + 1)
        return time, self.at(time)


def cubic(time: Array, joints: Array, rates: Array) -> Motion:
    """The motion with joint values and rates (K, m) at times (K,), cubic in between."""
    return Motion(time, joints, scipy.interpolate.CubicHermiteSpline(time, joints, rates).c[:-1])
