"""Measurements of a recording: rows, runs over time, and which rows may not be separated in a cross-validation.

Neighbouring rows of a path share their errors, and so do rows of another pass through the same joint values: whoever
holds out one and keeps the other measures how well the data were memorised. So rows are sorted by the place at which
the path first came by, and held out in blocks of places.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, finite_array, items
from ..files.field_metadata import unit
from ..robots.calibration import Calibration
from ..typing import Array, Index

# Sensors whose distances behind the tip differ by less (m) are at one station: rounding of distances in files.
SAME_POSITION = 1e-6

Z = (0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class JointLog:
    """Joint readings at times of their own.

    Raises:
        InputError: arrays that do not fit each other, times that do not ascend, or a number that is not finite.
    """

    time: Array
    """(M,) ascending times, s."""
    rotations: Array
    """(M, n) rotations, rad."""
    translations: Array
    """(M, n) translations, m."""

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
    """(N, S, 3) positions in the frame of the measuring device, m; (N, 3) is one sensor.

    NaN for a sensor that was not seen; every row needs one that was.
    """
    direction: Array | None = None
    """(N,) direction of the mirror actuation, rad, or None; the rotations follow from it."""
    separation: Array | None = None
    """(N,) measured separation of the tubes, rad."""
    source: str = ""
    """Origin of the data, for messages and figures."""
    time: Array | None = None
    """(N,) times of the positions, s. None: rows are single configurations, not a path."""
    behind: Array | None = None
    """(S,) distance of each sensor behind the tip along the arm, m; None is all at the tip."""
    orientation: Array | None = None
    """(N, 3, 3) frame of the tip's sensor in the device's, NaN if it was not seen; None for none."""
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
        arrays: dict[str, Array | None] = {"rotations": rotations, "translations": translations}
        arrays["sensors"] = _sensors(self.sensors, count)
        for name in ("direction", "separation", "time"):
            label = getattr(self, name)
            arrays[name] = None if label is None else finite_array(name, label, 1)
            if label is not None and len(label) != count:
                raise InputError(f"{name} has {len(label)} numbers; it must be {count}, one per configuration")
        for name, value in arrays.items():
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
        count, coordinates = self.sensors.shape[:2]
        if self.behind is not None:
            behind = finite_array("behind", self.behind, 1)
            if behind.shape != (coordinates,) or (behind < 0).any():
                raise InputError(f"behind is {behind.tolist()} m; it must be {coordinates} distances, at least 0")
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
        """(K,) distances of the sensors behind the tip, m, the foremost first."""
        return np.unique(np.round(self.sensor_distances / SAME_POSITION)) * SAME_POSITION

    @property
    def sensor_distances(self) -> Array:
        """(S,) distance of each sensor behind the tip, m."""
        return np.zeros(self.sensors.shape[1]) if self.behind is None else self.behind

    def _at(self, station: float) -> Array:
        """(N, s, 3) positions of the sensors at a station."""
        return np.asarray(self.sensors[:, np.abs(self.sensor_distances - station) < SAME_POSITION])

    @property
    def station_position(self) -> Array:
        """(N, K, 3) mean over the sensors of each station that were seen, m; NaN if none was."""
        return np.stack([_mean(self._at(station)) for station in self.stations], axis=1)

    @property
    def tip_position(self) -> Array:
        """(N, 3) position of the foremost station, m; NaN if it was not seen."""
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
        """Measurements of some rows, by indices, slice or mask; the joint log is unchanged."""
        k = index if isinstance(index, slice) else np.asarray(index)
        columns = {name: getattr(self, name) for name in BY_ROW}
        picked: dict[str, Any] = {name: None if value is None else value[k] for name, value in columns.items()}
        return replace(self, **picked)

    def turned(self, offsets: Array) -> Measurements:
        """The measurements with `offsets` (n,), rad, added to the rotations."""
        return replace(self, rotations=self.rotations + offsets)


def recordings_of(measurements: Measurements | Sequence[Measurements]) -> tuple[Measurements, ...]:
    """The recordings of a study; raises InputError if there is none, or another number of tubes."""
    recordings = (measurements,) if isinstance(measurements, Measurements) else tuple(measurements)
    if not recordings:
        raise InputError("there are no recordings; at least one is needed")
    if len({m.n_tubes for m in recordings}) > 1:
        raise InputError(
            f"the recordings are of {sorted({m.n_tubes for m in recordings})} tubes; they must be of one robot"
        )
    return recordings


def joined(recordings: Sequence[Measurements]) -> Measurements:
    """All rows of several recordings, for statistics; each keeps sensors and stations of its own."""
    if len(recordings) == 1:
        return recordings[0]
    count, first = sum(map(len, recordings)), np.cumsum([0, *map(len, recordings)])
    behind = [m.sensor_distances for m in recordings]
    alike = all(np.array_equal(b, behind[0]) for b in behind)
    places = behind[0] if alike else np.concatenate(behind)
    sensors = np.full((count, len(places), 3), np.nan)
    frames = np.full((count, 3, 3), np.nan)
    column = 0
    for k, m in zip(first, recordings, strict=False):
        sensors[k : k + len(m), column : column + m.sensors.shape[1]] = m.sensors
        column += 0 if alike else m.sensors.shape[1]
        if m.orientation is not None:
            frames[k : k + len(m)] = m.orientation
    labels: dict[str, Any] = {}
    for name in ("direction", "separation", "time"):
        values = [getattr(m, name) for m in recordings]
        labels[name] = None if any(v is None for v in values) else np.concatenate(values)
    return Measurements(
        np.vstack([m.rotations for m in recordings]),
        np.vstack([m.translations for m in recordings]),
        sensors,
        source=", ".join(m.source for m in recordings if m.source),
        behind=places,
        orientation=frames if np.isfinite(frames).any() else None,
        remarks=tuple(f"{m.source}: {remark}" for m in recordings for remark in m.remarks),
        **labels,
    )


# What a configuration has of its own.
BY_ROW = ("rotations", "translations", "sensors", "direction", "separation", "time", "orientation")


def _sensors(value: ArrayLike, count: int) -> Array:
    """(N, S, 3) positions with NaN for sensors that were not seen."""
    try:
        sensors = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError("sensors are not an array of numbers") from None
    sensors = sensors[:, None] if sensors.ndim == 2 else sensors
    if sensors.ndim != 3 or sensors.shape[0] != count or sensors.shape[1] < 1 or sensors.shape[2] != 3:
        raise InputError(f"sensors have shape {sensors.shape}; it must be ({count}, sensors, 3)")
    if np.isinf(sensors).any():
        entry = np.argwhere(np.isinf(sensors))[0].tolist()
        raise InputError(f"sensors{entry} is {sensors[tuple(entry)]}; it must be finite, or NaN if nothing was seen")
    sensors[np.isnan(sensors).any(2)] = np.nan
    unseen = np.isnan(sensors).all((1, 2))
    if unseen.any():
        raise InputError(f"no sensor saw row {int(np.argmax(unseen)) + 1}; every row needs a measured position")
    return sensors


def _mean(sensors: Array) -> Array:
    """(N, 3) mean over the sensors (N, s, 3) that were seen; NaN if none was."""
    return np.asarray(np.ma.masked_invalid(sensors).mean(1).filled(np.nan))


# rad.
TURN = 2 * math.pi


def runs_of(time: Array) -> list[Index]:
    """Indices of the rows of every run, in which times increase without a gap."""
    step = np.diff(time)
    forward = step[step > 0]
    usual = float(np.median(forward)) if len(forward) else 0.0
    cuts = np.flatnonzero((step <= 0) | (step > 5.0 * usual)) + 1  # runs are parted by much longer steps
    return list(np.split(np.arange(len(time)), cuts))


# A wrapped angle jumps by a full turn minus the step of the path. At pi, the default of NumPy, a drive that moves by
# half a turn between rows would be unwrapped; at two turns no jump would be found.
WRAP_JUMP = 1.5 * math.pi
"""Step of a rotation between consecutive rows above which the angle was wrapped, rad."""


class Unwrapped(NamedTuple):
    """Rotations that count turns."""

    rotations: Array
    """(N, n), rad."""
    wrapped: tuple[bool, ...]
    """(n,) True for tubes whose angle was wrapped."""
    jumps: Index
    """(n,) number of jumps by a full turn."""


def unwrapped(time: Array, rotations: Array) -> Unwrapped:
    """Unwrap rotations (N, n) within each run of times (N,).

    A run of a wrapped angle starts in the turn in which the previous run ended.
    """
    out, runs = rotations.copy(), runs_of(time)
    for rows in runs:
        out[rows] = np.unwrap(rotations[rows], discont=WRAP_JUMP, axis=0)
    # Corrections are multiples of 2 pi, so that 1 rad separates them from round-off.
    jumps = np.diff(rotations - out, axis=0)
    wrapped = np.any([np.abs(jumps[rows[:-1]]).max(0, initial=0.0) > 1.0 for rows in runs], axis=0)
    for before, rows in pairwise(runs):
        # The rotation during a gap in time is unknown: the nearest turn is assumed, for wrapped tubes only.
        turns = np.round((out[before[-1]] - out[rows[0]]) / TURN)
        out[rows] += np.where(wrapped, TURN * turns, 0.0)
    steps = np.abs(np.diff(rotations - out, axis=0)) > 1.0
    return Unwrapped(out, tuple(wrapped.tolist()), steps.sum(0))


@dataclass(frozen=True, eq=False)
class Timeline:
    """The joint readings of measurements, as a function of a latency.

    Readings between two rows are interpolated by monotone cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17 (1980)),
    which do not overshoot where a joint stops. Before the first and behind the last row of a run they are held.
    """

    measurements: Measurements
    runs: tuple[Index, ...]
    source: tuple[tuple[Array, Array], ...]
    """Times and joints (M, 2 n) of every run of the recorded joints."""

    @classmethod
    def of(cls, measurements: Measurements) -> Timeline:
        """The runs of measurements, in the order of time; without times there are none."""
        m = measurements
        if m.time is None:
            return cls(m, (), ())
        runs = tuple(runs_of(m.time))
        if m.log is None:
            time, joints, parts = m.time, np.hstack([m.rotations, m.translations]), list(runs)
        else:
            time, joints = m.log.time, np.hstack([m.log.rotations, m.log.translations])
            parts = runs_of(time)
        return cls(m, runs, tuple((time[part], joints[part]) for part in parts))

    def readings(self, latency: float) -> tuple[Array, Array]:
        """(N, n) rotations, rad, and translations, m, by a latency (s) before each row."""
        m = self.measurements
        if m.time is None or (m.log is None and latency == 0):
            return m.rotations, m.translations
        joints = np.empty((len(m), 2 * m.n_tubes))
        if m.log is None:
            for rows, (time, values) in zip(self.runs, self.source, strict=True):
                joints[rows] = _between(time, values, m.time[rows] - latency)
        else:
            instants = m.time - latency
            first = np.array([time[0] for time, _ in self.source])
            run = np.clip(np.searchsorted(first, instants, side="right") - 1, 0, len(first) - 1)
            for k, (time, values) in enumerate(self.source):
                joints[run == k] = _between(time, values, instants[run == k])
        return joints[:, : m.n_tubes], joints[:, m.n_tubes :]

    def driven(self, drives: Calibration, turns: Array) -> tuple[Array, Array]:
        """(N, n) joint values of the model, rad and m, at the readings less full `turns` (n,), for rigid carriages.

        Latency, lag and play of the drives are included, in this order.
        """
        read, moved = self.readings(drives.latency)
        alpha, shift = drives.to_model(read - TURN * turns, moved)
        return (
            self.with_play(self.with_lag(alpha, np.array(drives.rotation_lag)), np.array(drives.rotation_play)),
            self.with_play(self.with_lag(shift, np.array(drives.translation_lag)), np.array(drives.translation_play)),
        )

    def with_lag(self, joints: Array, lag: Array) -> Array:
        """(N, n) joint values y that follow drives x = `joints` by lag y' + y = x, lag (n,), s.

        Exact where a drive moves evenly between two rows. At the start of a run it stood still.
        """
        time = self.measurements.time
        if time is None or not lag.any():
            return joints
        followed = joints.copy()
        moved = lag > 0
        tau, x = lag[moved], joints[:, moved]
        for rows in self.runs:
            step = np.diff(time[rows])[:, None]
            behind = tau * np.diff(x[rows], axis=0) / step  # of a drive that moves evenly for long
            kept = np.exp(-step / tau)
            y = x[rows[0]]
            for k, row in enumerate(rows[1:]):
                y = x[row] - behind[k] + (y - x[rows[k]] + behind[k]) * kept[k]
                followed[row, moved] = y
        return followed

    def with_play(self, joints: Array, play: Array) -> Array:
        """(N, n) joint values of the tubes behind drives at `joints` with play of half width (n,), rad or m.

        A tube stands still until its drive has taken up the play. At the start of a run the play is taken up in the
        direction of the first motion.
        """
        if not play.any():
            return joints
        followed = joints.copy()
        for rows in self.runs:
            drive = joints[rows]
            moved = np.diff(drive, axis=0)
            begins = np.argmax(moved != 0, axis=0) if len(moved) else np.zeros(len(play), dtype=int)
            first = np.sign(moved[begins, np.arange(len(play))]) if len(moved) else np.zeros(len(play))
            low, high = drive - play, drive + play
            output = drive[0] - play * first
            for k, row in enumerate(rows):
                output = np.minimum(np.maximum(output, low[k]), high[k])
                followed[row] = output
        return followed


def _between(time: Array, values: Array, instants: Array) -> Array:
    """Interpolated values (K, c) at instants (K,), from values (M, c) at times (M,); constant beyond the ends."""
    if len(time) == 1 or not len(instants):
        return np.repeat(values[:1], len(instants), axis=0)
    inside = np.clip(instants, time[0], time[-1])
    return np.asarray(scipy.interpolate.PchipInterpolator(time, values)(inside))


def middles_of(drives: Calibration, measurements: Measurements, common: Array) -> tuple[Calibration, Array]:
    """Drives with gains relative to the turn of the recording, and (n,) turns from there to the median of the
    recording.

    A drive of gain 1 has no turn yet: its own begins next to `common` (n,), the median of all recordings.
    """
    middle = np.median(measurements.rotations, axis=0)
    gained = np.array(drives.rotation_gains) != 1.0
    known = np.where(gained, drives.rotation_middles, common)
    turns = np.where(gained, np.round((middle - known) / TURN), 0.0)
    return replace(drives, rotation_middles=tuple(known.tolist())), turns


# Joint values that are nearer than this are the same (rad, about 0.01 deg).
STILL = 2e-4


@dataclass(frozen=True, eq=False)
class Passes:
    """Rows of a path, and the configuration of each."""

    group: Index
    """(N,) first row at the configuration of each row; its own index for a new configuration."""
    pairs: Index
    """(M, 2) rows at one configuration passed in opposite directions, a row in at most one pair."""


def passes(measurements: Measurements) -> Passes:
    """Rows of a path that retraces itself; rows without times belong together only for equal joint values."""
    m = measurements
    joints = np.hstack([m.rotations, 20.0 * m.translations])  # rad per m: an arm bends by about as much on its length
    count = len(joints)
    if m.time is None:
        return Passes(_equal(joints), np.zeros((0, 2), dtype=int))
    ahead, behind, travelled = _motion(joints, m.time)
    step = np.maximum(np.linalg.norm(ahead, axis=1), np.linalg.norm(behind, axis=1))
    # Samples of two passes along one line are at most half a step apart.
    reach = np.maximum(0.75 * step, STILL)
    tree = scipy.spatial.cKDTree(joints)
    group, pairs, paired = np.arange(count), [], np.zeros(count, dtype=bool)
    for k, near in enumerate(tree.query_ball_point(joints, reach)):
        earlier = np.array([j for j in near if j < k], dtype=int)
        # Rows just before are near because little time has passed, unless the path reversed in between.
        earlier = earlier[travelled[k] - travelled[earlier] > 2 * reach[k]]
        if not len(earlier):
            continue
        distance = np.linalg.norm(joints[earlier] - joints[k], axis=1)
        group[k] = group[earlier[np.argmin(distance)]]
        against = (ahead[earlier] + behind[earlier]) @ (ahead[k] + behind[k]) < 0
        opposite = earlier[against & ~paired[earlier]]
        if len(opposite):
            j = int(opposite[np.argmin(distance[against & ~paired[earlier]])])
            pairs.append((j, k))
            paired[[j, k]] = True
    return Passes(group, np.array(pairs, dtype=int).reshape(-1, 2))


class _Motion(NamedTuple):
    """Motion of the joints at the N rows of a recording."""

    ahead: Array
    """(N, c) step to the next row; 0 at the end of a run."""
    behind: Array
    """(N, c) step from the row before; 0 at the start of a run."""
    travelled: Array
    """(N,) distance travelled; runs are separated by a large distance."""


def _motion(joints: Array, time: Array) -> _Motion:
    """Motion through joint values (N, c) at times (N,)."""
    ahead, behind, travelled = np.zeros_like(joints), np.zeros_like(joints), np.zeros(len(joints))
    far = 0.0
    for rows in runs_of(time):
        move = np.diff(joints[rows], axis=0)
        ahead[rows[:-1]], behind[rows[1:]] = move, move
        travelled[rows] = far + np.append(0.0, np.cumsum(np.linalg.norm(move, axis=1)))
        far = travelled[rows[-1]] + 1e3
    return _Motion(ahead, behind, travelled)


def _equal(joints: Array) -> Index:
    """Index of the first row with the same joint values, for every row."""
    _, first, inverse = np.unique(np.round(joints / STILL), axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()])


def deal(measurements: Measurements, folds: int, group: Index | None = None) -> Index:
    """(N,) fold of each row: blocks of a path, or configurations in a fixed, shuffled order without a path.

    All rows at one place are in one fold. There are at most as many folds as places.
    """
    where = passes(measurements).group if group is None else group
    distinct, inverse, counts = np.unique(where, return_inverse=True, return_counts=True)
    if measurements.time is None:
        fold = np.empty(len(distinct), dtype=int)
        fold[np.random.default_rng(0).permutation(len(distinct))] = np.arange(len(distinct)) % folds
        return np.asarray(fold[inverse])
    middle = np.cumsum(counts) - counts / 2  # of the rows, in the order of places
    return np.asarray(np.minimum((middle * folds / counts.sum()).astype(int), folds - 1)[inverse])


@dataclass(frozen=True)
class Parity:
    """Root mean square residuals, m, of configurations passed in both directions; all contain the noise."""

    pairs: Annotated[int, "places that were passed in both directions"]
    history: Annotated[float, unit("mm"), "RMS of half the difference of the errors in both directions"]
    """Error due to effects of the direction: latency, friction, backlash."""
    static: Annotated[float, unit("mm"), "RMS of half the sum of the errors in both directions"]
    measured: Annotated[float, unit("mm"), "RMS of half the difference of the measured tips in both directions"]
    """Difference of measurements, independent of any model."""


def parity(pairs: Index, residuals: Array, measured: Array) -> Parity | None:
    """Root mean square residuals of points passed in both directions, split by direction; None for fewer
    than 10 pairs.
    """
    forth, back = residuals[pairs[:, 0]], residuals[pairs[:, 1]]
    good = np.isfinite(forth).all(1) & np.isfinite(back).all(1)
    if good.sum() < 10:
        return None
    apart = measured[pairs[good, 0]] - measured[pairs[good, 1]]
    history, static, measured_rms = (
        _rms(x[good] if len(x) > len(apart) else x) for x in (forth - back, forth + back, apart)
    )
    return Parity(int(good.sum()), history, static, measured_rms)


def _rms(twice: Array) -> float:
    """Root mean square of half the vectors (M, 3)."""
    return float(np.sqrt((twice**2).sum(1).mean()) / 2)
