"""What a laboratory measures: joint readings, and where sensors saw the arm, when, and which way they pointed."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, finite_array, items
from ..typing import Array

SAME_PLACE = 1e-6
"""Sensors whose distances behind the tip differ by less (m) sit at one station."""

Z = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class JointLog:
    """Joint readings at times of their own.

    Raises:
        InputError: arrays that do not fit each other, times that do not ascend, or a number that is not finite.
    """

    time: Array
    """(M,) s, ascending."""
    rotations: Array
    """(M, n) rad."""
    translations: Array
    """(M, n) m."""

    def __post_init__(self) -> None:
        time, rotations = finite_array("log.time", self.time, 1), finite_array("log.rotations", self.rotations, 2)
        translations = finite_array("log.translations", self.translations, 2)
        if not rotations.shape == translations.shape == (len(time), rotations.shape[1]):
            raise InputError(
                f"the log has {len(time)} times, rotations of shape {rotations.shape} and translations of shape "
                f"{translations.shape}; they must fit"
            )
        if (np.diff(time) <= 0).any():
            k = int(np.argmax(np.diff(time) <= 0))
            raise InputError(f"log.time[{k + 1}] is {time[k + 1]:g} s after {time[k]:g} s; times must ascend")
        for name, array in (("time", time), ("rotations", rotations), ("translations", translations)):
            object.__setattr__(self, name, array)


@typed
@dataclass(frozen=True, eq=False)
class Measurements(Displayed):
    """N configurations with the positions of S sensors, and optionally the direction of the tip.

    Sensors at the same distance behind the tip form a station; its position is the mean of the visible ones. For an
    eccentric robot with one sensor in each of its three tubes that is the sheath's centreline. A single sensor is off
    by the tube's distance from the centreline.

    Raises:
        InputError: arrays that do not fit each other, no configuration, a row that no sensor saw, or a number that is
            not finite.
    """

    rotations: Array
    """(N, n) joint readings, rad."""
    translations: Array
    """(N, n) joint readings from home, m."""
    sensors: Array
    """(N, S, 3) positions in the frame of the measuring device, m; (N, 3) is one sensor. NaN where a sensor was not
    seen; every row needs one that was."""
    direction: Array | None = None
    """(N,) direction of the mirror actuation, rad, or None; the rotations follow from it."""
    separation: Array | None = None
    """(N,) of the same, rad."""
    source: str = ""
    """Origin of the data, for messages and figures."""
    time: Array | None = None
    """(N,) times of the positions, s. None: rows are single configurations, not a path."""
    behind: Array | None = None
    """(S,) distance of each sensor behind the tip along the arm, m; None is all at the tip."""
    orientation: Array | None = None
    """(N, 3, 3) frame of the tip's sensor in the device's, NaN where it was not seen; None for none."""
    sensor_axis: Array | None = None
    """(3,) direction along the tube, towards the tip, in the frame of the tip's sensor; None finds out which of +-x,
    +-y, +-z it is."""
    log: JointLog | None = None
    """Joint readings at a rate of their own, where the joints were recorded apart."""
    wrapped: tuple[bool, ...] = ()
    """(n,) True for rotations recorded within one turn, with an unknown number of turns before the first row; empty if
    none were.
    """
    remarks: tuple[str, ...] = ()
    """Remarks from reading the data, as text."""

    def __post_init__(self) -> None:
        rotations = finite_array("rotations", self.rotations, 2)
        count, n = rotations.shape
        if not rotations.size:
            raise InputError("there are no measurements; at least one configuration is needed")
        translations = finite_array("translations", self.translations, 2)
        if translations.shape != (count, n):
            raise InputError(f"translations have shape {translations.shape}; rotations have {rotations.shape}")
        found: dict[str, Array | None] = {"rotations": rotations, "translations": translations}
        found["sensors"] = _sensors(self.sensors, count)
        for name in ("direction", "separation", "time"):
            label = getattr(self, name)
            found[name] = None if label is None else finite_array(name, label, 1)
            if label is not None and len(label) != count:
                raise InputError(f"{name} has {len(label)} numbers; it must be {count}, one per configuration")
        for name, value in found.items():
            object.__setattr__(self, name, value)
        self._check_sensors()
        wrapped = tuple(items("wrapped", self.wrapped, bool, "True or False"))
        if wrapped and len(wrapped) != n:
            raise InputError(f"wrapped has {len(wrapped)} entries; it must have {n}, one per tube")
        object.__setattr__(self, "wrapped", wrapped)
        object.__setattr__(self, "remarks", items("remarks", self.remarks, str, "sentences"))
        if self.log is not None and (self.time is None or self.log.rotations.shape[1] != n):
            raise InputError(f"a log of joint readings needs the time of every row, and {n} tubes as the rows have")

    def _check_sensors(self) -> None:
        count, seen = self.sensors.shape[:2]
        if self.behind is not None:
            behind = finite_array("behind", self.behind, 1)
            if behind.shape != (seen,) or (behind < 0).any():
                raise InputError(f"behind is {behind.tolist()} m; it must be {seen} distances, at least 0")
            object.__setattr__(self, "behind", behind)
        if self.orientation is not None:
            try:
                frames = np.array(self.orientation, dtype=float)
            except (TypeError, ValueError):
                raise InputError(f"orientation is no array of numbers; it must be ({count}, 3, 3)") from None
            if frames.shape != (count, 3, 3):
                raise InputError(f"orientation has shape {frames.shape}; it must be ({count}, 3, 3)")
            object.__setattr__(self, "orientation", frames)
        if self.sensor_axis is not None:
            axis = finite_array("sensor_axis", self.sensor_axis, 1)
            if axis.shape != (3,) or not np.linalg.norm(axis):
                raise InputError(f"sensor_axis is {axis.tolist()}; it must be a direction in space")
            object.__setattr__(self, "sensor_axis", axis / np.linalg.norm(axis))

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return int(self.rotations.shape[1])

    @property
    def stations(self) -> Array:
        """(K,) distances behind the tip at which there are sensors, m, the foremost first."""
        return np.unique(np.round(self._behind / SAME_PLACE)) * SAME_PLACE

    @property
    def _behind(self) -> Array:
        return np.zeros(self.sensors.shape[1]) if self.behind is None else self.behind

    def _at(self, station: float) -> Array:
        """(N, s, 3) positions of the sensors at a station."""
        return np.asarray(self.sensors[:, np.abs(self._behind - station) < SAME_PLACE])

    @property
    def station_position(self) -> Array:
        """(N, K, 3) mean over the sensors of each station that were seen, m; NaN where none was."""
        return np.stack([_mean(self._at(station)) for station in self.stations], axis=1)

    @property
    def tip_position(self) -> Array:
        """(N, 3) position of the foremost station, m; NaN where it was not seen."""
        return np.asarray(self.station_position[:, 0])

    @property
    def sensor_spread(self) -> Array:
        """(N,) root mean square distance of the foremost sensors from their mean, m; 0 for one sensor."""
        squares = ((self._at(self.stations[0]) - self.tip_position[:, None]) ** 2).sum(2)
        return np.asarray(np.sqrt(np.nansum(squares, axis=1) / np.maximum(np.isfinite(squares).sum(1), 1)))

    @property
    def mark(self) -> str:
        """16 hexadecimal digits of the measured positions; they identify the recording of a saved registration."""
        return hashlib.sha256(np.nan_to_num(self.sensors, nan=1e9).tobytes()).hexdigest()[:16]

    def rows(self, index: ArrayLike | slice) -> Measurements:
        """The configurations with these indices, of this slice, or where this mask is true; a log stays whole."""
        k = index if isinstance(index, slice) else np.asarray(index)
        whole = {name: getattr(self, name) for name in BY_ROW}
        picked: dict[str, Any] = {name: None if value is None else value[k] for name, value in whole.items()}
        return replace(self, **picked)

    def turned(self, offsets: Array) -> Measurements:
        """The measurements with `offsets` (n,), rad, added to the rotations."""
        return replace(self, rotations=self.rotations + offsets)


BY_ROW = ("rotations", "translations", "sensors", "direction", "separation", "time", "orientation")
"""What a configuration has of its own."""


def _sensors(value: ArrayLike, count: int) -> Array:
    """(N, S, 3) with NaN where a sensor was not seen."""
    try:
        sensors = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError("sensors are not an array of numbers") from None
    sensors = sensors[:, None] if sensors.ndim == 2 else sensors
    if sensors.ndim != 3 or sensors.shape[0] != count or sensors.shape[1] < 1 or sensors.shape[2] != 3:
        raise InputError(f"sensors have shape {sensors.shape}; it must be ({count}, sensors, 3)")
    if np.isinf(sensors).any():
        place = np.argwhere(np.isinf(sensors))[0].tolist()
        raise InputError(f"sensors{place} is {sensors[tuple(place)]}; it must be finite, or NaN where nothing was seen")
    sensors[np.isnan(sensors).any(2)] = np.nan
    unseen = np.isnan(sensors).all((1, 2))
    if unseen.any():
        raise InputError(f"no sensor saw row {int(np.argmax(unseen)) + 1}; every row needs a measured position")
    return sensors


def _mean(sensors: Array) -> Array:
    """(N, 3) mean over the sensors (N, s, 3) that were seen; NaN where none was."""
    return np.asarray(np.ma.masked_invalid(sensors).mean(1).filled(np.nan))
