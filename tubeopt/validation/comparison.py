"""Compare measured with predicted tips: error statistics, and accuracy of the registration."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from ..arguments import typed
from ..bodies.frames import MAX_ROTATION_ERROR, RegistrationError, mirrored, narrowness, standard_errors, turn_curvature
from ..display import Displayed
from ..errors import InputError, SolveError, finite_array
from ..files.field_metadata import unit
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Index, Mask
from .measurements import Measurements, Parity, deal, joined, parity, passes, recordings_of
from .model import ArmModel, ParameterState
from .registration import FREEDOMS, SENSOR_FRAME, BasePose, Registration
from .sessions import Sessions


@dataclass(frozen=True)
class ErrorSummary:
    """Mean, root mean square, 95th percentile (interpolated) and maximum of `count` distances, m."""

    count: int
    mean: float
    rms: float
    p95: float
    max: float

    @classmethod
    def of(cls, errors: Array) -> ErrorSummary:
        """Summary of errors (N,), m, without NaN; at least one must be finite."""
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
    """Errors of all configurations with one direction, or one separation (`value`, rad)."""

    value: float
    summary: ErrorSummary


def _errors(errors: Array) -> Array:
    """(N,) errors as numbers; missing errors are NaN."""
    try:
        return np.asarray(errors, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"errors is {reprlib.repr(errors)}; it must be numbers") from None


@typed
def group_errors(values: Array | None, errors: Array) -> tuple[ErrorGroup, ...]:
    """Group errors (N,), m, by values (N,), rad, in ascending order; empty without values."""
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
    """Published table of tip errors over direction and separation, with the printed means."""

    direction: Array
    """(D,) directions, rad."""
    separation: Array
    """(S,) separations, rad."""
    error: Array
    """(S, D) tip errors, m."""
    mean_by_direction: Array
    """(D,) printed means over separations, m."""
    mean_by_separation: Array
    """(S,) printed means over directions, m."""
    mean: float
    """Printed mean of all errors, m."""

    @property
    def summary(self) -> ErrorSummary:
        """Summary of all errors in the table."""
        return ErrorSummary.of(self.error.ravel())


@dataclass(frozen=True, eq=False)
class Validation(Displayed):
    """Measured and predicted tips of N configurations in the plate frame, in SI units.

    NaN if nothing was measured, or there is no stable equilibrium.
    """

    robot: Robot
    """Robot of the predictions; its calibration converts readings to joint values."""
    measurements: Measurements
    """Recording that is compared."""
    registration: Annotated[Registration, "registration, device to plate"]
    measured: Array
    """(N, 3) positions of the foremost station, m."""
    predicted: Array
    """(N, 3) predicted positions of the foremost station, m."""
    along: Array
    """(N, K) distances between measured and predicted positions of all stations, m, the foremost first."""
    axis_errors: Array | None
    """(N,) angle between measured and predicted direction of the tip, rad; None if it was not measured."""
    margin: Array
    """(N,) margins of the predicted equilibria."""
    length: Annotated[float, unit("mm"), "length of the arm, reference of percentages"]
    """Largest arc length in front of the plate."""
    parity: Annotated[Parity | None, "errors that depend on the direction of motion"]
    """Comparison of configurations passed in both directions; None if the path does not retrace itself."""
    registration_error: Annotated[RegistrationError | None, "standard errors of a registration by least squares"]
    """Standard errors of the registration; None if it was given."""
    left_out: tuple[tuple[int, str], ...] = ()
    """Pairs (row, reason in words) of rows without a stable shape."""
    recordings: tuple[Validation, ...] = ()
    """Comparison of each of several recordings; robot and registration above are those of the last."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the measurements and on the comparison, as text."""
        error = self.registration_error
        known = "" if error is None else remark(error)
        remarks = list(self.measurements.remarks) + ([known] if known else [])
        if self.left_out:
            row, reason = self.left_out[0]
            count = f"{len(self.left_out)} rows have no stable shape and were left out"
            remarks.append(f"{count}; the first is row {row + 1}: {reason}")
        if self.outside.any():
            groups = (("there", self.outside), ("elsewhere", ~self.outside))
            errors = ((where, self.errors[rows & np.isfinite(self.errors)]) for where, rows in groups)
            parts = [f"RMS {1e3 * np.sqrt((e**2).mean()):.2f} mm {where}" for where, e in errors if len(e)]
            count = f"{int(self.outside.sum())} rows lie outside of the ranges that the robot was calibrated in"
            remarks.append(f"{count}: {', '.join(parts)}")
        return tuple(remarks)

    @property
    def outside(self) -> Mask:
        """(N,) True for rows outside of the ranges of readings that the robot was calibrated in."""
        posterior, m = self.robot.posterior, self.measurements
        if posterior is None:
            return np.zeros(len(m), dtype=bool)
        return posterior.outside(m.rotations, m.translations)

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
        """Summary of all tip errors."""
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
    measurements: Measurements | Sequence[Measurements],
    *,
    registration: str | None = None,
    base: BasePose = SENSOR_FRAME,
    time_limit: float = LONG_TIME_LIMIT,
) -> Validation:
    """Measured tips compared with the tips of the model at the same joint readings.

    Each of several recordings is registered for itself.

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
    if not isinstance(measurements, Measurements):
        each = recordings_of(measurements)
        return join([validate(robot, m, registration=registration, base=base) for m in each])
    check_tubes(robot, measurements)
    known = robot.calibration.registration if robot.calibration is not None else None
    saved_here = known is not None and known.recording == measurements.mark
    method = registration or ("saved" if saved_here else "rigid")
    model = ArmModel(robot, measurements, (), method, base)
    if model.failures and not saved_here:
        row, reason = model.failures[0]
        raise SolveError(f"row {row + 1}: {reason}")
    result = compare_at(model, model.start, robot)
    check_registration(result.registration_error, method)
    return result


def join(comparisons: Sequence[Validation]) -> Validation:
    """Comparison of all rows of several recordings; it also contains each recording."""
    last = comparisons[-1]
    if len(comparisons) == 1:
        return last
    measurements = joined([v.measurements for v in comparisons])
    measured, predicted, margin = (
        np.concatenate([getattr(v, name) for v in comparisons]) for name in ("measured", "predicted", "margin")
    )
    begins = np.cumsum([0, *(len(v.measurements) for v in comparisons)]).tolist()
    along = np.full((len(measured), len(measurements.stations)), np.nan)
    for first, v in zip(begins, comparisons, strict=False):
        at = np.searchsorted(measurements.stations, v.measurements.stations)
        along[first : first + len(v.along), at] = v.along
    axes = [v.axis_errors for v in comparisons]
    pairs = [first + passes(v.measurements).pairs for first, v in zip(begins, comparisons, strict=False)]
    return replace(
        last,
        measurements=measurements,
        measured=measured,
        predicted=predicted,
        along=along,
        axis_errors=None
        if all(a is None for a in axes)
        else np.concatenate(
            [np.full(len(v.measured), np.nan) if a is None else a for a, v in zip(axes, comparisons, strict=True)]
        ),
        margin=margin,
        length=max(v.length for v in comparisons),
        parity=parity(np.vstack(pairs), measured - predicted, measured),
        left_out=tuple((b + k, why) for b, v in zip(begins, comparisons, strict=False) for k, why in v.left_out),
        recordings=tuple(comparisons),
    )


def check_tubes(robot: Robot, measurements: Measurements) -> None:
    """Raise InputError if measurements are of another number of tubes."""
    if measurements.n_tubes != robot.n_tubes:
        raise InputError(f"the measurements are of {measurements.n_tubes} tubes; the robot has {robot.n_tubes}")


def compare_at(model: ArmModel, state: ParameterState[Registration], robot: Robot) -> Validation:
    """Measured and predicted values at a state of a model with this robot."""
    m, motion = model.measurements, state.registration
    poses = model.poses(model.setup(state.x), margins=True)
    predicted = model.predicted(state)
    along, axis = distances(model, predicted - model.observed)
    tip = np.full((len(m), 3), np.nan)
    front = model.station == 0
    tip[model.row[front]] = motion.apply(predicted[front])
    measured = motion.apply(m.tip_position)
    result = passes(m)
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
        parity=parity(result.pairs, measured - tip, measured),
        registration_error=registration_error(model, state),
        left_out=model.failures,
    )


def distances(model: ArmModel | Sessions, residuals: Array) -> tuple[Array, Array | None]:
    """(N, K) lengths of the residuals (V, 3) of positions, m, and (N,) angles of the residuals of directions, rad."""
    size = np.linalg.norm(residuals, axis=1)
    along = np.full((model.count, len(model.stations)), np.nan)
    a = model.directed
    along[model.row[~a], model.station[~a]] = size[~a]
    if not a.any():
        return along, None
    axis = np.full(model.count, np.nan)
    axis[model.row[a]] = 2 * np.arcsin(np.clip(size[a] / 2, 0, 1))
    return along, axis


# Of rows, where there are as many places, that errors and intervals are computed from as if independent: errors of
# neighbouring rows are alike, so that blocks must be long.
BLOCKS = 20


def remark(error: RegistrationError) -> str:
    """Remark on a registration that fits better as a mirror image, or has a badly determined rotation; or ""."""
    if error.mirrored is None:
        known = f"the frame is known to {math.degrees(error.turn):.0f} deg only (standard error)"
        return (
            ""
            if error.turn <= MAX_ROTATION_ERROR
            else f"{known}: the tips are too few, or the model is too far from them"
        )
    return (
        f"a mirror image of the measured tips fits better (RMS {error.mirrored * 1e3:.2f} mm): does a rotation or "
        "an axis of the device have the wrong sign?"
    )


def registration_error(model: ArmModel, state: ParameterState[Registration]) -> RegistrationError | None:
    """Standard errors of a registration; None for a registration that is not by least squares."""
    freedoms = FREEDOMS[model.method]
    if not freedoms:
        return None
    predicted, measured, lever = _pairs(model, state)
    a = model.directed
    size = [((predicted - measured)[part] ** 2).sum() for part in (~a, a)]
    freedom_ratio = max(3 * int((~a).sum()) + 2 * int(a.sum()) - freedoms, 1) / (3 * (~a).sum() + 2 * a.sum())
    counts = (3 * (~a).sum(), 2 * a.sum())
    variance = [max(s / max(n, 1) / freedom_ratio, 1e-30) for s, n in zip(size, counts, strict=True)]
    weight = 1 / np.where(a, variance[1], variance[0])
    turns = np.eye(3)[2:] if freedoms == 1 else np.eye(3)
    hessian = turn_curvature(measured + lever, predicted + lever, weight, turns)
    mirror = mirrored(measured[~a], predicted[~a], math.sqrt(size[0] / (~a).sum())) if freedoms == 6 else None
    narrow = narrowness(predicted[~a])
    if hessian is None:
        return RegistrationError(math.inf, math.inf, narrow, mirror)
    inverse = np.linalg.inv(hessian)
    moment = weight[:, None] * np.cross(measured + lever, predicted - measured) @ turns.T
    shift = np.where(a[:, None], 0.0, predicted - measured) / (~a).sum() if freedoms == 6 else np.zeros_like(measured)
    moved = np.hstack([moment @ inverse, shift])  # effect of each observation on rotation and translation
    alone = np.zeros((moved.shape[1],) * 2)
    alone[: len(turns), : len(turns)] = inverse
    if freedoms == 6:
        alone[3:, 3:] = np.eye(3) * variance[0] / (~a).sum()
    both_errors = (alone, _from_blocks(moved, _blocks(model)))
    centre = predicted[~a].mean(0) if freedoms == 6 else np.zeros(3)
    errors = [standard_errors(covariance, turns, centre, model.length) for covariance in both_errors]
    turn, reach = np.max(errors, axis=0).tolist()
    return RegistrationError(turn, reach, narrow, mirror)


class _Pairs(NamedTuple):
    """Predicted and measured positions (or directions) in the frame of the plate."""

    predicted: Array
    """(V, 3) predicted values."""
    measured: Array
    """(V, 3) measured values."""
    shift: Array
    """(V, 3) added to either to give the lever of a rotation."""


def _pairs(model: ArmModel, state: ParameterState[Registration]) -> _Pairs:
    """Predicted and measured pairs of all observations."""
    motion, a = state.registration, model.directed
    rotated = [each @ motion.rotation.T for each in (model.predicted(state), model.observed)]
    predicted, measured = (np.where(a[:, None], each, each + motion.translation) for each in rotated)
    shift = np.zeros_like(predicted)
    if FREEDOMS[model.method] == 6:
        shift[~a] = -predicted[~a].mean(0)
    return _Pairs(predicted, measured, shift)


def _blocks(model: ArmModel) -> Index:
    return deal(model.measurements, min(BLOCKS, len(model.measurements)))[model.row]


def _from_blocks(moved: Array, block: Index) -> Array:
    """Covariance of a sum, from its parts by block, which are assumed to be independent."""
    sums = np.array([moved[block == k].sum(0) for k in np.unique(block)])
    count = len(sums)
    return np.asarray(sums.T @ sums * (count / max(count - 1, 1)))


def check_registration(error: RegistrationError | None, method: str) -> None:
    """Raise InputError if the rotation of a rigid registration is too uncertain: the tips are close to a line."""
    if error is None or not error.too_large or method != "rigid":
        return
    known = "not at all" if math.isinf(error.turn) else f"to {math.degrees(error.turn):.0f} deg only"
    raise InputError(
        f"the tips determine the device frame {known} (standard error; it must be at most "
        f"{math.degrees(MAX_ROTATION_ERROR):g} deg): they lie too close to a line. Measure configurations "
        "bent in at least three directions, 90 deg apart, or give registration base-axis"
    )
