"""Estimate the force at the tip of a robot from measured points of its arm, with its undetermined directions."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import renamed, typed
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import (
    InputError,
    SolveError,
    TimeLimitError,
    choice,
    finite,
    vector,
    whole,
)
from ..files.field_metadata import POSITIVE, TYPICAL_NOISE, OneOf, form, typical_length, unit
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import by_model
from ..robots.limits import check_target
from ..robots.load import Load
from ..robots.robot import Robot, joint_values
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, TIME_LIMIT, check_time, limited
from ..typing import Array, Progress, StatusEnum
from .comparison import check_tubes
from .effects import Setup
from .force_fit import (
    EVERYWHERE,
    FULL,
    WITHIN,
    Measured,
    Trial,
    covariance_of,
    fit,
    hidden,
    remaining_step,
    rms_distance,
    trial_at,
)
from .measurements import Measurements, Timeline
from .registration import Registration


class ForceStatus(StatusEnum):
    """Observability of a force; every value reads as a sentence."""

    DETERMINED = "the force is determined in all directions"
    IN_PART = "the force differs from zero significantly in some directions only"


@dataclass(frozen=True)
class ForceStatistics:
    """Effort of an estimate."""

    iterations: int
    """Number of steps of the fit."""


@dataclass(frozen=True, eq=False)
class ForceEstimate(Displayed):
    """Estimated force at the tip, in world axes, with its covariance."""

    force: Annotated[Array, unit("mN"), form(".3f", label="force at the tip"), "force on the tip in the base frame"]
    """(3,) force, N."""
    covariance: Array
    """(3, 3) covariance from the measurement noise, to second order, N^2; inf along undetermined directions.

    Its ellipsoid is an approximation. If a standard error is several hundredths of a newton, it may contain the force
    less often than stated: `coverage` computes the actual fraction. `contains` is a region with the stated confidence.
    """
    directions: Annotated[Array, "unit vectors, from the best to the worst determined"]
    """(3, 3) unit vectors by row."""
    errors: Annotated[
        Array,
        unit("mN"),
        form(".3f", label="standard errors, best direction to worst"),
        "standard error along each of them",
    ]
    """(3,) standard errors, N."""
    equilibrium: Equilibrium
    """Equilibrium of the robot under that force."""
    residual: Annotated[
        float,
        unit("mm"),
        form(".4f", label="RMS distance of the points"),
        "RMS distance between measured and fitted points",
    ]
    fit: tuple[float, int]
    """Sum of squares of residuals over noise, and its expected value: number of measured coordinates less 3."""
    iterations: int
    """Number of steps of the fit."""
    measured: Measured
    """Measured points of the arm."""
    base: Load
    """Known loads, without the estimated force."""

    def contains(self, force: ArrayLike, confidence: float = 0.95) -> bool:
        """True if a force (N) is in the confidence region of the likelihood.

        The region is the set of forces for which the sum of squares over the noise exceeds its minimum by at most the
        quantile of chi-squared with 3 degrees of freedom. If only the tip was measured its confidence is exact, for any
        bending of the arm.
        """
        candidate = vector("force", force, 3, "x, y, z")
        try:
            trial = trial_at(self.equilibrium, self.base, candidate, self.measured)
        except SolveError:
            return False
        excess = float(trial.residual @ trial.residual) - self.fit[0]
        return excess <= float(scipy.special.chdtri(3, 1 - confidence))

    @limited
    def coverage(
        self, confidence: float = 0.95, *, draws: int = 100, seed: int = 0, time_limit: float = TIME_LIMIT
    ) -> float:
        """Fraction of simulated measurements with this noise and an ellipsoid that contains the force.

        A parametric bootstrap: the estimated force is taken for the true one and estimated again from every draw. The
        standard error of the fraction p is sqrt(p (1 - p) / draws). A draw that no force fits counts as outside.

        Raises:
            InputError: a confidence that is not in (0, 1), fewer than one draw.
            TimeLimitError: (a SolveError) the time limit was reached before all draws were made.
        """
        if not 0 < finite("confidence", confidence) < 1:
            raise InputError(f"confidence is {confidence:g}; it must be between 0 and 1")
        quantile, random = float(scipy.special.chdtri(3, 1 - confidence)), np.random.default_rng(seed)
        fitted = trial_at(self.equilibrium, self.base, self.force, self.measured)
        noise, position = self.measured.noise, self.measured.position
        # Residuals are measured less fitted, over the noise: without them the points are those of the fitted arm.
        position = position - noise * fitted.residual.reshape(position.shape)
        inside = 0
        for _ in range(whole("draws", draws, 1)):
            check_time()
            drawn = replace(self.measured, position=position + noise * random.normal(size=position.shape))
            with suppress(SolveError):
                start = trial_at(self.equilibrium, self.base, self.force, drawn)
                estimate = _estimate(start, self.base, drawn)
                error = estimate.directions @ (self.force - estimate.force)
                # Squares along the principal axes of the ellipsoid; a direction without a bound adds 0.
                inside += float(np.sum((error / estimate.errors) ** 2)) <= quantile
        return inside / draws

    @property
    def value(self) -> Array:
        """(3,) force, N."""
        return self.force

    @property
    def status(self) -> ForceStatus:
        """Result as a sentence: determined in all directions, or only in some."""
        determined = np.abs(self.directions @ self.force) >= 2 * self.errors
        return ForceStatus.DETERMINED if determined.all() else ForceStatus.IN_PART

    @property
    def statistics(self) -> ForceStatistics:
        """Number of steps of the fit."""
        return ForceStatistics(self.iterations)

    @property
    def undetermined(self) -> str:
        """Directions without a measurable force, as a sentence."""
        parts = []
        for direction, error in zip(self.directions, self.errors, strict=True):
            along = abs(float(direction @ self.force))
            if along < 2 * error:
                axis = ", ".join(f"{x + 0.0:.2f}" for x in direction)
                known = f"it is {along * 1e3:.3g} mN with a standard error of {error * 1e3:.3g} mN"
                parts.append(f"along ({axis}) {known if np.isfinite(error) else 'the measurement does not bound it'}")
        return str(ForceStatus.DETERMINED) if not parts else "undetermined: " + "; ".join(parts)


@dataclass(frozen=True, eq=False)
class ForceRecord(Displayed):
    """Forces at the tip over the N rows of a recording."""

    robot: Robot
    """Measured robot."""
    measurements: Measurements
    """Recording with N rows."""
    noise: Annotated[
        float,
        unit("mm"),
        form(".3g", label="noise of a measured coordinate"),
        "standard deviation of a measured coordinate",
    ]
    estimates: tuple[ForceEstimate | None, ...]
    """Estimates, one per row; None for rows without one."""
    failures: tuple[tuple[int, str], ...]
    """Pairs (row, reason) of rows without an estimate."""

    @property
    def force(self) -> Array:
        """(N, 3) forces in world axes, N; NaN in rows without an estimate."""
        return np.array([np.full(3, np.nan) if e is None else e.force for e in self.estimates])

    @property
    def standard_error(self) -> Array:
        """(N, 3) standard errors by axis, N; inf for an unobservable axis, NaN in rows without an estimate."""
        rows = [np.full(3, np.nan) if e is None else np.sqrt(np.diag(e.covariance)) for e in self.estimates]
        return np.array(rows)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Effects of the robot that the estimates ignore."""
        r = self.robot
        ignored = {
            "the room between the tubes (clearance)": isinstance(r, ConcentricRobot) and r.clearance is not None,
            "friction between the tubes": isinstance(r, ConcentricRobot) and r.friction is not None,
        }
        return tuple(f"{what} is left out of the estimates" for what, has in ignored.items() if has)


@typed
@by_model
@small
@limited
def estimate_forces(
    robot: Robot,
    measurements: Measurements,
    *,
    noise: Annotated[float, unit("mm"), POSITIVE, TYPICAL_NOISE] = 1e-3,
    known: Load | None = None,
    registration: Annotated[str | None, OneOf(("none", "saved"))] = None,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> ForceRecord:
    """Estimate the dead force at the tip in every row of a recording, each started from the row before.

    The robot's calibration converts readings to joint values, with latency and backlash, and gives the poses of sensor
    and plate. Full turns of the readings count. Forces and known loads are in the axes of the plate, tilted by the
    calibration.

    Args:
        measurements: joint readings, and positions; sensors behind the tip are points of the arm. Sensors at the same
            place of a row count by their mean.
        noise: standard deviation of a measured coordinate, m.
        known: as in `estimate_force`.
        registration: frame of the positions: none (base frame) or saved (device frame of the calibration); default
            saved for the calibration recording, none without a saved registration, otherwise required.
        progress: called with rows done and rows in all.
        time_limit: maximum run time, s.

    Raises:
        InputError: as in `estimate_force`; measurements of a robot with another number of tubes, a calibration with
            compliant carriages, or a registration that is required or missing in the calibration.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> from tubeopt.validation import Measurements
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> turns, pushed = [[0.0, 1.0, 2.0], [0.2, 1.0, 2.0]], tubeopt.Load((0.02, 0.0, 0.0))
        >>> tips = [tubeopt.forward_kinematics(robot, turn, load=pushed).tip_position for turn in turns]
        >>> recording = Measurements(np.array(turns), np.zeros((2, 3)), np.array(tips))
        >>> np.round(tubeopt.estimate_forces(robot, recording, noise=1e-4).force[:, 0], 4)
        array([0.02, 0.02])
    """
    check_tubes(robot, measurements)
    typical_length("noise", noise, TYPICAL_NOISE)
    base, setup = _known(known), Setup.of(robot)
    if any(setup.drives.translation_compliance):
        raise InputError(
            "the robot's calibration has translation_compliance; force estimation does not "
            "model it: use a robot without it"
        )
    alpha, shift = Timeline.of(measurements).driven(setup.drives, np.zeros(robot.n_tubes))
    stations = measurements.stations
    _check_points(robot, bool(np.any(stations > 0)))
    positions = (_of_plate(robot, measurements, registration) - setup.plate_shift) @ setup.plate_turn
    estimates: list[ForceEstimate | None] = []
    failures = []
    last: Equilibrium | None = None
    for row in range(len(measurements)):
        length = _arm_length(robot, shift[row])
        present = np.isfinite(positions[row, :, 0])
        try:
            joints = joint_values(robot, alpha[row], shift[row])
            offset = setup.sensor_offset if present[0] else np.zeros(3)
            measured = Measured(length - stations[present], positions[row, present], noise, offset)
            estimate = _fitted(robot, joints, measured, base, last)
        except SolveError as error:
            failures.append((row, str(error)))
            estimates.append(None)
            # The branch is lost: the next row starts without force.
            last = None
        else:
            estimates.append(estimate)
            last = estimate.equilibrium
        if progress is not None:
            progress(row + 1, len(measurements))
    return ForceRecord(robot, measurements, noise, tuple(estimates), tuple(failures))


def _of_plate(robot: Robot, measurements: Measurements, method: str | None) -> Array:
    """(N, K, 3) measured positions of the stations in the plate frame, m."""
    saved = robot.calibration.registration if robot.calibration is not None else None
    if method is None:
        saved_here = saved is not None and saved.recording == measurements.mark
        at_plate = saved is None or (np.allclose(saved.rotation, np.eye(3)) and not any(saved.translation))
        if not (saved_here or at_plate):
            raise InputError(
                "registration is missing, and the robot's calibration has one; it must be "
                "'saved' for positions of that device, or 'none' for positions in the base "
                "frame"
            )
        method = "saved" if saved_here else "none"
    if choice("registration", method, ("none", "saved")) == "none":
        return measurements.station_position
    if saved is None:
        raise InputError("registration is 'saved', but the robot's calibration has none; it must be 'none'")
    return Registration.of_saved(saved).apply(measurements.station_position)


@renamed(guess="start")
@typed
@by_model
@small
@limited
def estimate_force(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    tip_position: ArrayLike | None = None,
    points: Sequence[tuple[float, ArrayLike]] | None = None,
    noise: float = 1e-3,
    known: Load | None = None,
    start: Equilibrium | None = None,
    time_limit: float = TIME_LIMIT,
) -> ForceEstimate:
    """Estimate the dead force at the tip from measured positions, by Levenberg-Marquardt with exact derivatives.

    Equilibria are those of the branch that starts without force.

    Args:
        rotations, translations: (n,) rad and m; translations default to home.
        tip_position: (3,) measured, m, plate frame.
        points: (arc length from the plate, (3,) measured position), m, along the arm.
        noise: standard deviation of every measured coordinate, m.
        known: other loads, such as the robot's weight; the estimate is added to its tip force.
        start: equilibrium at which the fit starts, such as the last estimate; by default without force.
        time_limit: maximum run time, s.

    Raises:
        InputError: joint values as in `forward_kinematics`, nothing measured, a point that is not on the arm, a known
            load that turns with the tip.
        SolveError: no equilibrium without the force, or the fit does not converge.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pushed = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0], load=tubeopt.Load((0.02, 0.0, 0.0)))
        >>> found = tubeopt.estimate_force(robot, [0.0, 1.0, 2.0], tip_position=pushed.tip_position, noise=1e-4)
        >>> round(float(found.force[0]), 4)
        0.02
    """
    alpha, shift = joint_values(robot, rotations, translations)
    readings = _measured(_arm_length(robot, shift), tip_position, points, typical_length("noise", noise, TYPICAL_NOISE))
    _check_points(robot, points is not None and len(points) > 0)
    return _fitted(robot, (alpha, shift), readings, _known(known), start)


def _arm_length(robot: Robot, translations: Array) -> float:
    """Arc length of the tip, m; inf for a bundle, whose tip moves along the centreline."""
    return float(robot.assembly(translations).total_length) if robot.fixed_sections else np.inf


def _check_points(robot: Robot, behind: bool) -> None:
    """Raise InputError for points of a bundle behind the tip."""
    if behind and not robot.fixed_sections:
        raise InputError("points behind the tip are measured; for a bundle the tip only is allowed")


def _known(load: Load | None) -> Load:
    """Known load; raises InputError if a part of it turns with the tip."""
    base = load if load is not None else Load()
    if base.frame != "world" and (any(base.force) or any(base.moment)):
        raise InputError("known has a force or moment that turns with the tip; its frame must be 'world'")
    return base


def _fitted(
    robot: Robot,
    joints: tuple[Array, Array],
    measured: Measured,
    base: Load,
    start: Equilibrium | None,
) -> ForceEstimate:
    """Estimate at joint values of the model, rad and m."""
    check_target(robot.tubes, "what is measured", measured.position)
    first = base if start is None or start.load is None else replace(base, force=start.load.force)
    pushed = forward_kinematics(robot, *joints, load=first, start=start)
    return _estimate(trial_at(pushed, base, np.subtract(first.force, base.force), measured), base, measured)


def _measured(
    length: float, tip: ArrayLike | None, points: Sequence[tuple[float, ArrayLike]] | None, noise: float
) -> Measured:
    readings, positions = [], []
    for k, entry in enumerate(() if points is None else points):
        try:
            at, position = entry
        except (TypeError, ValueError):
            raise InputError(f"points[{k}] is {entry!r}; it must be (arc length, (x, y, z))") from None
        if not 0 < at <= length * (1 + 1e-12):
            raise InputError(f"points[{k}] is at the arc length {at:g} m; it must be above 0 and at most {length:g} m")
        readings.append(float(at))
        positions.append(vector(f"position of points[{k}]", position, 3, "x, y, z"))
    if tip is not None:
        readings.append(length)
        positions.append(vector("tip_position", tip, 3, "x, y, z"))
    if not readings:
        raise InputError("neither tip_position nor points are given; give one of them")
    return Measured(np.array(readings), np.array(positions), noise)


def _estimate(start: Trial, base: Load, measured: Measured) -> ForceEstimate:
    """Estimate from a trial, with the force of the trial along directions that cannot be determined.

    Observable directions are fitted first. If the others are unobservable at that fit too, they are not fitted. If the
    fit in all directions does not converge, the least observable ones are not fitted, provided that the remaining
    residual is within the noise and fits along them fail for moved measurements. (A short arm is very stiff along its
    axis.)
    """
    # Right singular vectors by column, from the best observable direction to the worst.
    weakest = np.linalg.svd(start.jacobian)[2].T
    failed: SolveError | None = None
    choices = [EVERYWHERE, weakest[:, :2], weakest[:, :1]]
    observable = weakest[:, ~hidden(start)]
    if 0 < observable.shape[1] < 3:
        choices.insert(0, observable)
    for axes in choices:
        try:
            trial, iterations = fit(start, base, measured, FULL, axes)
        except TimeLimitError:
            raise
        except SolveError as error:
            failed = failed if axes is observable else failed or error
            continue
        if axes is observable and hidden(trial).sum() < 3 - observable.shape[1]:
            # At this fit more directions are observable: all are fitted from here.
            start = trial
        elif (
            axes is observable
            or axes is EVERYWHERE
            or float(np.linalg.norm(remaining_step(trial, EVERYWHERE))) <= WITHIN
        ):
            break
    else:
        assert failed is not None
        raise failed
    covariance = covariance_of(trial, base, measured, axes)
    if failed is not None and np.isfinite(covariance.errors).sum() > axes.shape[1]:
        raise failed
    return ForceEstimate(
        force=trial.force,
        covariance=covariance.matrix,
        directions=covariance.directions,
        errors=covariance.errors,
        equilibrium=trial.equilibrium,
        residual=rms_distance(trial, measured),
        fit=(float(trial.residual @ trial.residual), len(trial.residual) - 3),
        iterations=iterations,
        measured=measured,
        base=base,
    )
