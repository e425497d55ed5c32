"""Calibration of drives: conversion between joint readings and the joint values of the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, choice, finite, positive, vector
from ..files.field_metadata import NOT_NEGATIVE, Absent, unit
from ..files.units import UNITS
from ..typing import Array, Mask
from .limits import JointLimits, default_limits
from .tubes import Tube

Numbers = tuple[float, ...]
"""Numbers of the tubes, inner to outer."""

Vector = tuple[float, ...]
"""Components along x, y and, of three, z."""

LEFT_OUT = Absent(None)

NONE3, NONE2 = (0.0,) * 3, (0.0,) * 2


@dataclass(frozen=True)
class SavedRegistration:
    """Frame of a measuring device, fitted to one recording.

    Raises:
        InputError: a rotation that is no rotation matrix, or a translation that is not three finite numbers.
    """

    recording: Annotated[str, "checksum of the recorded positions"]
    method: Annotated[str, "method of the registration: rigid, base-axis, none or saved"]
    rotation: Annotated[tuple[Vector, ...], "three rows of the rotation matrix from device frame to base frame"]
    translation: Annotated[Vector, unit("mm"), "translation from device frame to base frame"]

    def __post_init__(self) -> None:
        matrix = np.array([vector("a row of rotation", row, 3, "x, y, z") for row in self.rotation])
        turns = matrix.shape == (3, 3) and np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
        if not turns or np.linalg.det(matrix) < 0:
            raise InputError("rotation of the registration is not a rotation matrix; it must be three orthogonal rows")
        object.__setattr__(self, "rotation", tuple(tuple(row) for row in matrix.tolist()))
        object.__setattr__(self, "translation", tuple(vector("translation", self.translation, 3, "x, y, z").tolist()))


@dataclass(frozen=True)
class Calibration(Displayed):
    """Joint values of the model from the readings of the drives, tube by tube:

        model = zero + gain * (reading - zero) + offset - compliance * force

    The zero of a translation is 0. That of a rotation is the full turn next to the middle of the calibrated motion.
    The library works in the model's joint values throughout; the command line takes and gives readings. What belongs to
    the measurement (latency, sensor, plate, registration) is read by `validate` and by fits alone.

    Raises:
        InputError: tables of different length, a number that is not finite, a gain that is not positive, or a play
            or compliance below 0.
    """

    rotation_offsets: Annotated[Numbers, unit("deg"), LEFT_OUT, "added to the rotations; default 0"]
    translation_offsets: Annotated[Numbers, unit("mm"), LEFT_OUT, "added to the translations; default 0"]
    rotation_gains: Annotated[Numbers, LEFT_OUT, "factors on the rotations; default 1"]
    translation_gains: Annotated[Numbers, LEFT_OUT, "factors on the translations; default 1"]
    rotation_play: Annotated[
        Numbers, unit("deg"), LEFT_OUT, "half widths of the rotational backlash, for information; not applied"
    ]
    """Backlash: the tube follows its drive after a turn of this size. It depends on the history, so `to_model` omits
    it.
    """

    latency: Annotated[float, unit("s"), "delay of measured tips behind joint readings with the same time"] = 0.0
    found_by: Annotated[str, "data of the calibration"] = ""
    translation_play: Annotated[
        Numbers, unit("mm"), LEFT_OUT, "half widths of the carriage backlash, for information; not applied"
    ] = ()
    rotation_lag: Annotated[
        Numbers, unit("s"), LEFT_OUT, "time constants of tubes that follow their rotation drives, not applied"
    ] = ()
    translation_lag: Annotated[
        Numbers, unit("s"), LEFT_OUT, "time constants of tubes that follow their carriages, not applied"
    ] = ()
    translation_compliance: Annotated[
        Numbers, unit("mm_per_N"), LEFT_OUT, "compliance of the carriages along the tubes"
    ] = ()
    """Compliance of the carriages, concentric robots only. `tubeopt.equilibrium.readings` applies it with the forces of
    the tubes at the equilibrium; `to_model` omits it."""

    rotation_middles: Annotated[
        Numbers,
        unit("deg"),
        LEFT_OUT,
        "rotation readings in the middle of the calibrated motion; gains act about the nearest full turn; default 0",
    ] = ()
    """A reading that is a turn larger is another joint value, where the gain is not 1."""

    sensor_offset: Annotated[Vector, unit("mm"), "position of the tip sensor in the tip frame"] = NONE3
    sensor_tilt: Annotated[Vector, unit("deg"), "tilt of the sensor axis about x and y of the tip frame"] = NONE2
    sensor_axis: Annotated[Vector, LEFT_OUT, "tube direction in the frame of the tip sensor"] = ()
    plate_shift: Annotated[Vector, unit("mm"), "shift of the base plate relative to the registration"] = NONE3
    plate_tilt: Annotated[Vector, unit("deg"), "tilt of the base plate about x and y relative to the registration"] = (
        NONE2
    )
    registration: Annotated[SavedRegistration | None, "registration of one recording"] = None

    def __post_init__(self) -> None:
        count = len(self.rotation_offsets)
        for name in TABLES:
            values = getattr(self, name) or ((0.0,) * count if name in LATER else ())
            if len(values) != count:
                raise InputError(f"{name} are {len(values)} numbers; rotation_offsets are {count}, one per tube")
            object.__setattr__(self, name, tuple(_number(name, i, value) for i, value in enumerate(values)))
        object.__setattr__(self, "latency", finite("latency", self.latency))
        for name, length in (("sensor_offset", 3), ("sensor_tilt", 2), ("plate_shift", 3), ("plate_tilt", 2)):
            object.__setattr__(
                self, name, tuple(vector(name, getattr(self, name), length, "x, y, z"[: 3 * length - 2]).tolist())
            )
        if self.sensor_axis:
            object.__setattr__(
                self, "sensor_axis", tuple(vector("sensor_axis", self.sensor_axis, 3, "x, y, z").tolist())
            )

    @classmethod
    def none(cls, n_tubes: int) -> Calibration:
        """Calibration of ideal drives: readings equal the joint values of the model."""
        zeros, ones = (0.0,) * n_tubes, (1.0,) * n_tubes
        return cls(zeros, zeros, ones, ones, zeros)

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.rotation_offsets)

    @property
    def trivial(self) -> bool:
        """True if drives and measurements need no correction."""
        return replace(self, found_by="") == Calibration.none(self.n_tubes)

    @property
    def reads_true(self) -> bool:
        """True if readings equal the joint values of the model, without history."""
        n = self.n_tubes
        gains, offsets = self.rotation_gains + self.translation_gains, self.rotation_offsets + self.translation_offsets
        return gains == (1.0,) * 2 * n and not any(offsets) and not any(self.translation_compliance)

    @property
    def rotation_zeros(self) -> Array:
        """Readings (n,), rad, at which the rotation gains have no effect: full turns."""
        full_turn = 2 * math.pi
        return full_turn * np.round(np.array(self.rotation_middles) / full_turn)

    def to_model(self, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
        """Joint values (..., n) of the model, rad and m, at readings (..., n), with rigid carriages."""
        zero = self.rotation_zeros
        alpha = zero + (np.asarray(rotations, dtype=float) - zero) * self.rotation_gains + self.rotation_offsets
        shift = np.asarray(translations, dtype=float) * self.translation_gains + self.translation_offsets
        return alpha, shift

    def to_readings(self, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
        """Readings (..., n) at joint values (..., n) of the model, rad and m, with rigid carriages."""
        zero = self.rotation_zeros
        alpha = zero + (np.asarray(rotations, dtype=float) - self.rotation_offsets - zero) / self.rotation_gains
        shift = (np.asarray(translations, dtype=float) - self.translation_offsets) / self.translation_gains
        return alpha, shift

    def limits_of_model(self, limits: JointLimits) -> JointLimits:
        """Limits of the joint values of the model, from limits of the readings."""
        tables = (limits.rotations, limits.translations)
        # Gains are positive, so that the smallest reading gives the smallest joint value.
        low = self.to_model(*(np.array([pair[0] for pair in table]) for table in tables))
        high = self.to_model(*(np.array([pair[1] for pair in table]) for table in tables))
        rotations, translations = (
            tuple(zip(a.tolist(), b.tolist(), strict=True)) for a, b in zip(low, high, strict=True)
        )
        return JointLimits(rotations=rotations, translations=translations)


# Readings closer than this, rad or m, are the same but for round-off.
SAME_READING = 1e-9

DEVIATIONS = {"": "", "1/m": "per_m", "rad": "deg", "m": "mm", "s": "s", "N": "mN_m_per_m", "m/N": "mm_per_N"}
"""SI unit of a fitted parameter -> unit in files and records."""


@dataclass(frozen=True)
class Deviation:
    """Standard deviation of a parameter of the robot."""

    name: Annotated[str, "name of the parameter, as for `tubeopt validate --fit`"]
    unit: Annotated[str, "unit of the deviation; empty for a factor"]
    deviation: Annotated[float, NOT_NEGATIVE, "standard deviation from the value in this file"]

    def __post_init__(self) -> None:
        choice("unit", self.unit, tuple(DEVIATIONS.values()))
        positive(f"deviation of {self.name}", self.deviation, zero=True)

    @property
    def si(self) -> float:
        """The deviation in SI."""
        return self.deviation * (float(UNITS[self.unit]) if self.unit else 1.0)


@dataclass(frozen=True)
class Posterior(Displayed):
    """Normal deviations of the parameters of the real robot from its file, after a fit.

    Raises:
        InputError: correlations that are not those of the parameters.
    """

    parameters: Annotated[tuple[Deviation, ...], "parameters of the real robot that may differ from this file"]
    correlations: Annotated[tuple[Numbers, ...], "correlations of the parameters, one row for each"]
    misfit: Annotated[
        float, unit("mm"), NOT_NEGATIVE, "standard deviation of a coordinate of the tip that no parameter explains"
    ] = 0.0
    noise: Annotated[float, unit("mm"), NOT_NEGATIVE, "standard deviation of a measured coordinate of the tip"] = 0.0
    rotations: Annotated[
        tuple[tuple[float, float], ...], unit("deg"), LEFT_OUT, "least and greatest recorded rotation of every tube"
    ] = ()
    translations: Annotated[
        tuple[tuple[float, float], ...], unit("mm"), LEFT_OUT, "least and greatest recorded translation of every tube"
    ] = ()

    def __post_init__(self) -> None:
        count = len(self.parameters)
        table = np.array([len(row) == count for row in self.correlations])
        if len(table) != count or not table.all():
            raise InputError(f"correlations must be {count} rows of {count} numbers, one for every parameter")
        matrix = np.array(self.correlations).reshape(count, count)
        if not np.allclose(matrix, matrix.T) or not np.allclose(np.diag(matrix), 1) or (np.abs(matrix) > 1.001).any():
            raise InputError("correlations must be a symmetric table of numbers from -1 to 1, with 1 on the diagonal")

    @classmethod
    def of(
        cls, names: Sequence[str], units: Sequence[str], covariance: Array, misfit: float, noise: float
    ) -> Posterior:
        """Posterior of parameters with SI units and a covariance (P, P) in SI, and errors of tips, m."""
        sizes = np.sqrt(np.diag(covariance))
        correlations = covariance / np.outer(sizes, sizes)
        shown = [DEVIATIONS[each] for each in units]
        scaled = [size / float(UNITS[each]) if each else size for size, each in zip(sizes.tolist(), shown, strict=True)]
        return cls(
            tuple(map(Deviation, names, shown, scaled)),
            tuple(tuple(row) for row in np.round((correlations + correlations.T) / 2, 9).tolist()),
            misfit,
            noise,
        )

    def outside(self, rotations: Array, translations: Array) -> Mask:
        """(...,) True where readings (..., n), rad and m, are outside of the recorded ranges; False if unknown."""
        out = np.zeros(np.shape(rotations)[:-1], dtype=bool)
        for values, ranges in ((rotations, self.rotations), (translations, self.translations)):
            if ranges:
                low, high = np.array(ranges).T
                out |= ((values < low - SAME_READING) | (values > high + SAME_READING)).any(-1)
        return np.asarray(out)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(each.name for each in self.parameters)

    @property
    def factor(self) -> Array:
        """(P, P) matrix with which independent standard normal numbers give deviations of the parameters, SI."""
        count = len(self.parameters)
        values, vectors = np.linalg.eigh(np.array(self.correlations).reshape(count, count))
        sizes = np.array([each.si for each in self.parameters])
        return np.asarray(sizes[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True)
class PathBounds(Displayed):
    """Bounds on the real robot along a path, estimated to first order at some of its configurations."""

    probabilities: tuple[float, ...]
    """Probabilities (Q,) of the bounds."""
    margin: tuple[float, ...]
    """(Q,) margins; 0 where it may snap."""
    clearance: tuple[float, ...]
    """(Q,) distances from obstacles, m; infinite without obstacles."""


# Names of the fields with a number for every tube.
TABLES = tuple(field.name for field in fields(Calibration) if str(field.type).startswith("Annotated[Numbers"))

# Fields that are 0 by default.
LATER = ("translation_play", "rotation_lag", "translation_lag", "translation_compliance", "rotation_middles")


def _number(name: str, tube: int, value: float) -> float:
    label = f"{name} of tube {tube + 1}"
    if name.endswith("_gains"):
        return positive(label, value)
    return finite(label, value) if name.endswith(("_offsets", "_middles")) else positive(label, value, zero=True)


def check_calibration(calibration: Calibration | None, n_tubes: int, *, yields: bool = False) -> None:
    """Raise InputError if a calibration is for another number of tubes, or for compliant carriages that are rigid."""
    if calibration is None:
        return
    if calibration.n_tubes != n_tubes:
        raise InputError(f"calibration is for {calibration.n_tubes} tubes; the robot has {n_tubes}")
    if any(calibration.translation_compliance) and not yields:
        raise InputError("calibration has a translation_compliance; only carriages of concentric robots can have one")


def limits_of(readings: JointLimits | None, calibration: Calibration | None, tubes: Sequence[Tube]) -> JointLimits:
    """Limits of the joint values, from limits of the readings, or by default from the lengths of the tubes."""
    if readings is None:
        return default_limits(tubes)
    return readings if calibration is None else calibration.limits_of_model(readings)
