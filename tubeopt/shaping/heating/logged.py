"""Logged heatings: what was measured when, and which of it can be believed.

A thermometer that shows the same all the time although the tube is heated is dead; one that stays at its greatest
reading is saturated there; one that does not begin where the tube does is shifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy

from ...constants import ZERO_CELSIUS
from ...errors import InputError, finite
from ...typing import Array
from .rig import COUNTS, Rig
from .settings import DEFAULT_RIG_SOLVER, RigSolver

NOISE = {"temperature": 5.0, "voltage": 0.05, "current": 0.5}
"""Noise of the channels to begin with, K, V, A."""

LEAST_NOISE = {"temperature": 0.05, "voltage": 1e-3, "current": 1e-2}
"""No instrument is better."""

POSSIBLE = {
    "temperature": (ZERO_CELSIUS - 60.0, ZERO_CELSIUS + 2500.0),
    "voltage": (-1.0, 150.0),
    "current": (-50.0, 5000.0),
}
"""What thermometers, battery and current of such a rig can show, K, V, A."""

UNITS = {"temperature": "K", "voltage": "V", "current": "A"}


@dataclass(frozen=True, eq=False)
class HeatingLog:
    """A logged heating; NaN where nothing was read.

    Raises:
        InputError: fewer than 3 rows, times that do not increase, duties out of range, or nothing that was measured.
    """

    time: Array
    """(T,) times, s, increasing."""
    duty: Array
    """(T,) counts 0-255, held from each row to the next."""
    temperature: Array | None = None
    """(T,) of the tube, K; (T, S) of several thermometers, or of the pixels of a camera."""
    voltage: Array | None = None
    """(T,) at the battery while the MOSFET conducts, V."""
    current: Array | None = None
    """(T,) from the battery while the MOSFET conducts, A."""
    position: float | Sequence[float] | Array = 0.0
    """Position of the thermometer from the middle of the curved part, m; (S,) for several."""
    lag: float | Array = 0.0
    """Time constant of the thermometer, s; (S,) for several different ones."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is not None and f.name not in ("position", "lag"):
                object.__setattr__(self, f.name, _column(f.name, value))
        count = len(self.time)
        if count < 3:
            raise InputError(f"the log has {count} rows; it must have at least 3")
        for name in ("duty", *NOISE):
            value = getattr(self, name)
            if value is not None and value.shape[:1] != (count,):
                raise InputError(
                    f"{name} of the log has shape {value.shape}; it must have {count} numbers, one per time"
                )
        if not (np.diff(self.time) > 0).all():
            raise InputError("time of the log must increase from row to row")
        for name, (low, high) in POSSIBLE.items():
            values = getattr(self, name)
            if values is not None and np.isfinite(values).any():
                extremes = float(np.nanmin(values)), float(np.nanmax(values))
                if extremes[0] < low or extremes[1] > high:
                    zero, sign = (ZERO_CELSIUS, "degC") if name == "temperature" else (0.0, UNITS[name])
                    raise InputError(
                        f"{name} of the log is {extremes[0] - zero:g} to {extremes[1] - zero:g} {sign}; it must be "
                        f"{low - zero:g} to {high - zero:g} {sign}"
                    )
        if not ((self.duty >= 0) & (self.duty <= COUNTS)).all():
            raise InputError("duty of the log must be from 0 to 255")
        places = np.abs([finite("position", x) for x in np.atleast_1d(np.asarray(self.position, dtype=float))])
        seen = 1 if self.temperature is None or self.temperature.ndim == 1 else self.temperature.shape[1]
        if len(places) != seen:
            raise InputError(f"position of the log has {len(places)} numbers; it must have {seen}, one per thermometer")
        lags = np.asarray(self.lag, dtype=float)
        if lags.shape not in ((), (seen,)) or not (np.isfinite(lags) & (lags >= 0)).all():
            raise InputError(
                f"lag of the log is {self.lag}; it must be at least 0 s, one number or one per thermometer"
            )
        object.__setattr__(self, "position", float(places[0]) if seen == 1 else places)
        if not any(np.isfinite(values).any() for values in self.channels.values()):
            raise InputError("the log has neither temperature nor voltage nor current; it must have one of them")

    @property
    def positions(self) -> Array:
        """(S,) distances of the thermometers from the middle of the curved part, m."""
        return np.atleast_1d(np.asarray(self.position, dtype=float))

    @property
    def thermometers(self) -> tuple[str, ...]:
        """Names of the channels of temperature: of several with their places."""
        if len(self.positions) == 1:
            return ("temperature",)
        return tuple(f"temperature {k} at {1e3 * x:g} mm" for k, x in enumerate(self.positions, start=1))

    @property
    def channels(self) -> dict[str, Array]:
        """The measured channels by name."""
        found: dict[str, Array] = {}
        if self.temperature is not None:
            columns = self.temperature.reshape(len(self.time), -1).T
            found |= dict(zip(self.thermometers, columns, strict=True))
        return found | {name: getattr(self, name) for name in ("voltage", "current") if getattr(self, name) is not None}

    def with_camera(self, time: Array, positions: Array, temperature: Array) -> HeatingLog:
        """A copy with the readings of a camera: temperatures (C, P), K, at its own times (C,) and positions (P,), m.

        Duties are those of this log. The camera has no lag. A missing reading is no reading of the other either.

        Raises:
            InputError: as of the class, or a camera that saw nothing during the log.
        """
        inside = (time >= self.time[0]) & (time <= self.time[-1])
        if not inside.any():
            raise InputError(
                f"the camera saw the tube from {time.min():g} to {time.max():g} s; the log goes from {self.time[0]:g} "
                f"to {self.time[-1]:g} s"
            )
        both = np.union1d(self.time, time[inside])

        def spread(at: Array, values: Array) -> Array:
            table = np.full((len(both), *values.shape[1:]), np.nan)
            table[np.searchsorted(both, at)] = values
            return table

        others = {name: spread(self.time, v) for name, v in self.channels.items() if name in ("voltage", "current")}
        before = [] if self.temperature is None else [spread(self.time, self.temperature.reshape(len(self.time), -1))]
        known = self.positions if before else np.zeros(0)
        return HeatingLog(
            both,
            self.duty[np.searchsorted(self.time, both, side="right") - 1],
            temperature=np.hstack([*before, spread(time[inside], temperature[inside])]),
            position=np.concatenate([known, positions]),
            lag=np.concatenate([np.broadcast_to(self.lag, len(known)), np.zeros(len(positions))]),
            **others,
        )

    def kept(self, channels: dict[str, Array]) -> HeatingLog:
        """A copy with other temperature readings."""
        columns = [channels[name] for name in self.thermometers]
        table = columns[0] if len(columns) == 1 else np.column_stack(columns)
        return replace(self, temperature=table)


def _column(name: str, value: Any) -> Array:
    try:
        column = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} of the log is {value!r}; it must be a list of numbers") from None
    if column.ndim != 1 and not (name == "temperature" and column.ndim == 2):
        raise InputError(f"{name} of the log has shape {column.shape}; it must be one number per row")
    return column


def kind_of(channel: str) -> str:
    """Temperature, voltage or current."""
    return channel.split()[0]


def believable(
    log: HeatingLog, rig: Rig, expected: dict[str, Array], solver: RigSolver = DEFAULT_RIG_SOLVER
) -> tuple[HeatingLog, tuple[str, ...]]:
    """The log without readings of a saturated thermometer, and what to know of its thermometers.

    Args:
        expected: channels (T,) as the rig's file predicts them.

    Raises:
        InputError: a thermometer that is dead.
    """
    if log.temperature is None:
        return log, ()
    channels, words = dict(log.channels), []
    for name in log.thermometers:
        read = np.flatnonzero(np.isfinite(channels[name]))
        if len(read) < 2 * solver.flat:
            continue
        values, rise = channels[name][read], float(np.ptp(expected[name][read]))
        if rise > solver.heated and np.ptp(values) == 0:
            raise InputError(
                f"{name} of the log is {values[0] - ZERO_CELSIUS:.1f} degC in all "
                f"{len(values)} readings; the rig file predicts a rise of {rise:.0f} K: the "
                "thermometer is broken; leave it out"
            )
        top = np.flatnonzero(values == values.max())
        stays = len(top) >= solver.flat and len(top) == top[-1] - top[0] + 1
        if stays and float(np.ptp(expected[name][read[top]])) > 0.2 * solver.heated and rise > solver.heated:
            channels[name] = channels[name].copy()
            channels[name][read[top]] = np.nan
            words.append(
                f"{name} stays at {values.max() - ZERO_CELSIUS:.1f} degC for {len(top)} readings, as a saturated "
                "thermometer does: they are left out"
            )
        off = float(values[0] - rig.ambient)
        if log.time[read[0]] == log.time[0] and abs(off) > solver.shifted:
            words.append(
                f"{name} begins {abs(off):.1f} K {'above' if off > 0 else 'below'} the rig's ambient temperature: the "
                "thermometer is shifted, or the tube was not cold; fit bias estimates the shift"
            )
    return log.kept(channels), tuple(words)


def step_of(values: Array) -> float:
    """Least difference between readings (N,) that differ: the step of an instrument that reads in steps; 0 where all
    are equal."""
    different = np.diff(np.unique(values))
    return float(different.min()) if len(different) else 0.0


def unexplained(
    channel: str,
    residual: Array,
    stated: float | None,
    unknowns: float,
    step: float = 0.0,
    *,
    rare: float = DEFAULT_RIG_SOLVER.rare,
) -> tuple[str, ...]:
    """What residuals (N,), in time, say against the model: more than the stated noise, or in long waves.

    The first by the chi-square test, the second by the mean number of runs of one sign (Wald and Wolfowitz).

    Args:
        unknowns: that were fitted to this channel.
        step: in which the channel is read; waves within half of one are what rounding makes of a slow change.
        rare: probability below which it is no accident.
    """
    words, unit = [], UNITS[kind_of(channel)]
    count = len(residual)
    spread = float(np.sqrt((residual**2).sum() / max(count - unknowns, 1.0)))
    if stated is not None and scipy.stats.chi2.sf((residual**2).sum() / stated**2, max(count - unknowns, 1.0)) < rare:
        words.append(
            f"residuals of {channel} are {spread:.3g} {unit}, {spread / stated:.1f} times the stated noise of "
            f"{stated:g} {unit}: the model does not explain the log, and intervals are too narrow"
        )
    signs = residual > 0
    above, below = int(signs.sum()), int((~signs).sum())
    if min(above, below) >= 5 and spread > step / 2:
        runs = 1 + int((signs[1:] != signs[:-1]).sum())
        mean = 1 + 2 * above * below / count
        deviation = np.sqrt((mean - 1) * (mean - 2) / (count - 1))
        if scipy.stats.norm.cdf((runs - mean) / deviation) < rare:
            words.append(
                f"residuals of {channel} change sign {runs - 1} times in {count} readings, noise would {mean - 1:.0f} "
                "times: the model misses something, and intervals are too narrow"
            )
    return tuple(words)
