"""A motion: joint values as a function of time, cubic between knots; and the limits that actuators set to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..control.joints import JointSpace
from ..display import Displayed
from ..errors import InputError
from ..typing import Array

MOST_SAMPLES = 4000
"""Samples of a trajectory at most."""

LEAST_SAMPLES = 100
"""Samples of a trajectory at least."""

PRUDENCE = 0.94
"""Share of the limits that is used where a table stands for a curve."""

SAMPLE_STEP = 0.04
"""Largest change of a joint between samples, in units of its scale."""


@dataclass(frozen=True)
class RateLimits(Displayed):
    """How fast the actuators are.

    Args:
        rotation, translation: greatest rates, rad/s and m/s.
        rotation_acceleration, translation_acceleration: rad/s^2 and m/s^2.
        Each is one number for all tubes, or one per tube.

    Raises:
        InputError: a limit that is not a finite number greater than 0.
    """

    rotation: float | tuple[float, ...] = np.pi / 2
    translation: float | tuple[float, ...] = 0.02
    rotation_acceleration: float | tuple[float, ...] = np.pi
    translation_acceleration: float | tuple[float, ...] = 0.04

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            try:
                values = np.array(getattr(self, name), dtype=float)
            except (TypeError, ValueError):
                values = np.array([np.nan])
            if values.ndim > 1 or not np.isfinite(values).all() or (values <= 0).any():
                raise InputError(
                    f"{name} of the rate limits is {getattr(self, name)!r}; it must be a number greater than 0, or one "
                    "per tube"
                )
            object.__setattr__(self, name, tuple(values.tolist()) if values.ndim else float(values))

    def of(self, space: JointSpace) -> tuple[Array, Array]:
        """(m,) rates and (m,) accelerations of independent joints; raises InputError for another number of tubes."""
        n = space.robot.n_tubes
        out = []
        for turn, move in (("rotation", "translation"), ("rotation_acceleration", "translation_acceleration")):
            both = []
            for name in (turn, move):
                values = np.atleast_1d(np.array(getattr(self, name)))
                if len(values) not in (1, n):
                    raise InputError(f"{name} of the rate limits has {len(values)} numbers; it must be 1 or {n}")
                both.append(np.broadcast_to(values, (n,)))
            out.append(np.concatenate([both[0], [both[1][list(tubes)].min() for tubes in space.carriages]]))
        return out[0], out[1]


DEFAULT_RATES = RateLimits()


@dataclass(frozen=True, eq=False)
class Motion:
    """Knots: time (K,) s, joint values (K, m) and rates (K, m); cubic in between."""

    time: Array
    joints: Array
    rates: Array

    @property
    def duration(self) -> float:
        """Seconds."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> Array:
        """(T, m) joint values at times (T,)."""
        if self.duration == 0:
            return np.repeat(self.joints[:1], np.size(time), axis=0)
        values: Array = scipy.interpolate.CubicHermiteSpline(self.time, self.joints, self.rates)(np.asarray(time))
        return values

    def sampled(self, scale: Array) -> tuple[Array, Array]:
        """Evenly spaced times (T,) and joint values (T, m), close enough that straight lines between them will do."""
        if self.duration == 0:
            return np.zeros(1), self.joints[:1]
        coarse = self.at(np.linspace(0, self.duration, 40 * len(self.time)))
        change = np.abs(np.diff(coarse / scale, axis=0)).max() * len(coarse)
        count = int(np.clip(np.ceil(change / SAMPLE_STEP), LEAST_SAMPLES, MOST_SAMPLES))
        time = np.linspace(0, self.duration, count + 1)
        return time, self.at(time)


def stopping_at(ways: list[Array], rate: Array, acceleration: Array) -> Motion:
    """The motion along curves of joint values, each a table (k, m) of evenly spaced points, at rest where they meet.

    Along each curve the parameter is the smooth step of degree 5, slowed down until rates and accelerations are kept.
    """
    times, joints, rates, began = [np.zeros(1)], [ways[0][:1]], [np.zeros_like(ways[0][:1])], 0.0
    for way in ways:
        curve, slope, bend = rounded(way)
        tau = np.linspace(0, 1, 8 * len(way) + 33)
        s, ds, dds = _smooth_step(tau)
        along, turning = slope(s), bend(s)
        speed = (np.abs(along * ds[:, None]) / rate).max()
        hardness = (np.abs(turning * ds[:, None] ** 2 + along * dds[:, None]) / acceleration).max()
        duration = 1.02 * max(float(speed), float(np.sqrt(hardness)), 1e-3)
        times.append(began + tau[1:] * duration)
        joints.append(curve(s)[1:])
        rates.append((along * ds[:, None] / duration)[1:])
        began += duration
    return Motion(np.concatenate(times), np.concatenate(joints), np.concatenate(rates))


def hurried(way: Array, rate: Array, acceleration: Array) -> Motion:
    """The motion along a curve of joint values, a table (k, m) of evenly spaced points, from rest to rest, that is slow
    only where limits ask for it.

    With b the square of ds/dt along the curve q(s), accelerations are q'' b + q' b' / 2. Half of the limit is given to
    either term: the first bounds b, the second how steeply b may rise and fall.
    """
    curve, slope, bend = rounded(way)
    s = np.linspace(0, 1, 8 * len(way) + 1)
    along, turning, h = np.abs(slope(s)), np.abs(bend(s)), s[1]
    tiny = 1e-12 * np.maximum(along.max(), 1.0)
    fast = np.minimum((rate / (along + tiny)).min(1) ** 2, (acceleration / 2 / (turning + tiny)).min(1))
    # Of neighbours the least: what holds at the points of the table is to hold between them.
    b = PRUDENCE * np.minimum(fast, np.minimum(np.append(fast[1:], fast[-1]), np.append(fast[0], fast[:-1])))
    steep = PRUDENCE * (acceleration / (along + tiny)).min(1)
    steep = np.minimum(steep[1:], steep[:-1]) * h
    b[0] = b[-1] = 0.0
    for k in range(len(steep)):
        b[k + 1] = min(b[k + 1], b[k] + steep[k])
    for k in reversed(range(len(steep))):
        b[k] = min(b[k], b[k + 1] + steep[k])
    speed = np.sqrt(b)
    time = np.concatenate([[0.0], np.cumsum(2 * h / (speed[1:] + speed[:-1]))])
    return Motion(time, curve(s), slope(s) * speed[:, None])


def rounded(table: Array) -> tuple[scipy.interpolate.BSpline, scipy.interpolate.BSpline, scipy.interpolate.BSpline]:
    """A smooth curve over [0, 1] close to evenly spaced points (k, m), with its first two derivatives.

    The cubic B-spline whose control points lie on the polyline: it begins and ends at its ends, and stays within the
    hull of neighbouring points, so that whatever ranges and order these keep, it keeps.
    """
    count = max(8, len(table))
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, count - 2), np.ones(3)])
    places = np.array([knots[k + 1 : k + 4].mean() for k in range(count)])
    x = np.linspace(0, 1, len(table))
    control = np.column_stack([np.interp(places, x, column) for column in table.T])
    curve = scipy.interpolate.BSpline(knots, control, 3)
    return curve, curve.derivative(), curve.derivative(2)


def _smooth_step(x: Array) -> tuple[Array, Array, Array]:
    """6 x^5 - 15 x^4 + 10 x^3 and its first two derivatives: at rest, without acceleration, at both ends."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)
