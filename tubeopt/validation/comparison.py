"""Measured tips beside predicted ones, and their distances, summed up."""

from __future__ import annotations

import reprlib
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..arguments import typed
from ..bodies.certainty import RegistrationError
from ..display import Displayed
from ..errors import InputError, SolveError, finite_array
from ..files.field_metadata import unit
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array
from .certainty import check_registration, registration_error, remark
from .folds import Parity, parity, passes
from .measurements import Measurements
from .model import ArmModel, State
from .registration import SENSOR_FRAME, BasePose, Registration


@dataclass(frozen=True)
class ErrorSummary:
    """Mean, root mean square, 95th percentile (interpolated) and greatest of `count` distances, m."""

    count: int
    mean: float
    rms: float
    p95: float
    max: float

    @classmethod
    def of(cls, errors: Array) -> ErrorSummary:
        """The summary of errors (N,), m; NaN are left out, and there must be others."""
        errors = errors[np.isfinite(errors)]
        return cls(
            count=len(errors),
            mean=float(errors.mean()),
            rms=float(np.sqrt((errors**2).mean())),
            p95=float(np.percentile(errors, 95)),
            max=float(errors.max()),
        )


@dataclass(frozen=True)
class ErrorGroup:
    """The errors of all configurations with one direction, or one separation (`value`, rad)."""

    value: float
    summary: ErrorSummary


def _errors(errors: Array) -> Array:
    """(N,) as floats, NaN where there is none."""
    try:
        return np.asarray(errors, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"errors is {reprlib.repr(errors)}; it must be numbers") from None


@typed
def group_errors(values: Array | None, errors: Array) -> tuple[ErrorGroup, ...]:
    """Errors (N,), m, by values (N,), rad, in ascending order; nothing where there are no values."""
    if values is None:
        return ()
    values, errors = finite_array("values", values, 1), _errors(errors)
    if errors.shape != values.shape:
        raise InputError(f"errors has shape {errors.shape}; it must have a number for each of {len(values)} values")
    labels = np.round(values / 1e-6).astype(int)
    groups = []
    for label in np.unique(labels):
        inside = labels == label
        if np.isfinite(errors[inside]).any():
            groups.append(ErrorGroup(float(values[inside].mean()), ErrorSummary.of(errors[inside])))
    return tuple(groups)


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """A published table of tip errors over direction and separation, with the means that were printed beside it."""

    direction: Array
    """(D,) rad."""
    separation: Array
    """(S,) rad."""
    error: Array
    """(S, D) m."""
    mean_by_direction: Array
    """(D,) m."""
    mean_by_separation: Array
    """(S,) m."""
    mean: float
    """Of all, m."""

    @property
    def summary(self) -> ErrorSummary:
        """Of all errors in the table."""
        return ErrorSummary.of(self.error.ravel())


@dataclass(frozen=True, eq=False)
class Validation(Displayed):
    """Measured against predicted tips of N configurations, both in the plate frame. SI units; NaN where nothing was
    seen, or no stable shape was found.
    """

    robot: Robot
    """Its calibration makes joint values of the readings."""
    measurements: Measurements
    """What it is held against."""
    registration: Annotated[Registration, "registration, device to plate"]
    measured: Array
    """(N, 3) positions of the foremost station, m."""
    predicted: Array
    """(N, 3) of the same, m."""
    along: Array
    """(N, K) distances between measured and predicted positions of all stations, m, the foremost first."""
    axis_errors: Array | None
    """(N,) angle between the measured and the predicted direction of the tip, rad; None where it was not measured."""
    margin: Array
    """(N,) stability margin of the predicted shapes."""
    length: Annotated[float, unit("mm"), "length of the arm, reference of percentages"]
    """Greatest arc length in front of the plate."""
    parity: Annotated[Parity | None, "errors that depend on the direction of motion"]
    """None where the path does not retrace itself."""
    registration_error: Annotated[RegistrationError | None, "standard errors of a registration by least squares"]
    """None of a registration that was given."""
    left_out: tuple[tuple[int, str], ...] = ()
    """(row, reason in words) of rows without a stable shape."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was noticed in the measurements and in their comparison, in words."""
        error = self.registration_error
        known = "" if error is None else remark(error)
        words = list(self.measurements.remarks) + ([known] if known else [])
        if self.left_out:
            row, reason = self.left_out[0]
            count = f"{len(self.left_out)} rows have no stable shape and were left out"
            words.append(f"{count}; the first is row {row + 1}: {reason}")
        return tuple(words)

    @property
    def residuals(self) -> Array:
        """(N, 3) measured minus predicted, m."""
        return self.measured - self.predicted

    @property
    def errors(self) -> Array:
        """(N,) distances between measured and predicted tips, m."""
        return np.asarray(self.along[:, 0])

    @property
    def summary(self) -> ErrorSummary:
        """Of all errors."""
        return ErrorSummary.of(self.errors)

    @property
    def by_direction(self) -> tuple[ErrorGroup, ...]:
        """Errors of each direction; empty where the measurements name none."""
        return group_errors(self.measurements.direction, self.errors)

    @property
    def by_separation(self) -> tuple[ErrorGroup, ...]:
        """Errors of each separation; empty where the measurements name none."""
        return group_errors(self.measurements.separation, self.errors)


@typed
@small
@limited
def validate(
    robot: Robot,
    measurements: Measurements,
    *,
    registration: str | None = None,
    base: BasePose = SENSOR_FRAME,
    time_limit: float = LONG_TIME_LIMIT,
) -> Validation:
    """Measured tips compared with the tips of the model at the same joint readings.

    Every configuration is solved for a stable equilibrium on its own, from tubes without torsion. A robot that can snap
    may have been in another one; its margin shows which configurations are in doubt.

    A calibrated robot includes the fitted sensor, plate and registration. Its errors for the recording of the fit are
    those that the fit reported.

    Args:
        registration: "rigid" (rotation and translation by least squares), "base-axis" (base and axis from `base`, yaw
            by least squares), "none", or "saved" (that of the robot's calibration); see `register`. None is "saved" for
            the recording of the calibration, "rigid" for others.
        time_limit: maximum run time, s.

    Raises:
        InputError: measurements of another number of tubes, or joint values out of range (with their row). A
            registration that the data leave undetermined, or uncertain by more than 5 deg (standard error).
        SolveError: no stable shape was found for a row.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("thesis_etr")
        >>> found = tubeopt.validate(robot, tubeopt.load_measurements("synthetic_etr", robot))
        >>> round(1e3 * found.summary.rms, 2)
        1.25
    """
    check_tubes(robot, measurements)
    known = robot.calibration.registration if robot.calibration is not None else None
    own = known is not None and known.recording == measurements.mark
    method = registration or ("saved" if own else "rigid")
    model = ArmModel(robot, measurements, (), method, base)
    if model.failures and not own:
        row, reason = model.failures[0]
        raise SolveError(f"row {row + 1}: {reason}")
    found = compare_at(model, model.start, robot)
    check_registration(found.registration_error, method)
    return found


def check_tubes(robot: Robot, measurements: Measurements) -> None:
    """Raise InputError where measurements are of another number of tubes."""
    if measurements.n_tubes != robot.n_tubes:
        raise InputError(f"the measurements are of {measurements.n_tubes} tubes; the robot has {robot.n_tubes}")


def compare_at(model: ArmModel, state: State, robot: Robot) -> Validation:
    """Measured beside predicted at a state of a model, whose robot this is."""
    m, motion = model.measurements, state.registration
    poses = model.poses(model.setup(state.x), margins=True)
    predicted = model.predicted(state)
    along, axis = distances(model, predicted - model.observed)
    tip = np.full((len(m), 3), np.nan)
    front = model.station == 0
    tip[model.row[front]] = motion.apply(predicted[front])
    measured = motion.apply(m.tip_position)
    found = passes(m)
    return Validation(
        robot=robot,
        measurements=m,
        registration=motion,
        measured=measured,
        predicted=tip,
        along=along,
        axis_errors=axis,
        margin=poses.margin,
        length=model.length,
        parity=parity(found.pairs, measured - tip, measured),
        registration_error=registration_error(model, state),
        left_out=model.failures,
    )


def distances(model: ArmModel, residuals: Array) -> tuple[Array, Array | None]:
    """(N, K) lengths of the residuals (V, 3) of positions, m, and (N,) angles of those of directions, rad."""
    size = np.linalg.norm(residuals, axis=1)
    along = np.full((len(model.measurements), len(model.stations)), np.nan)
    a = model.directed
    along[model.row[~a], model.station[~a]] = size[~a]
    if not a.any():
        return along, None
    axis = np.full(len(model.measurements), np.nan)
    axis[model.row[a]] = 2 * np.arcsin(np.clip(size[a] / 2, 0, 1))
    return along, axis
