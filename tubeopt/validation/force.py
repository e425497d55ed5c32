"""The force at the tip of a robot from where its arm is measured: a least-squares fit, and what it cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import renamed, typed
from ..block.transcription.loaded import position_slopes, tip_slopes
from ..display import Displayed
from ..equilibrium.answer import point_of
from ..equilibrium.kinematics import forward_kinematics, under_load
from ..equilibrium.result import Equilibrium
from ..errors import (
    InputError,
    SolveError,
    TimeLimitError,
    choice,
    finite,
    vector,
    whole,
    without_unit_warnings,
)
from ..files.field_metadata import POSITIVE, TYPICAL_NOISE, OneOf, form, typical_length, unit
from ..robots.concentric import ConcentricRobot
from ..robots.limits import check_target
from ..robots.load import Load
from ..robots.order import last_tube
from ..robots.robot import Robot, joint_values
from ..solvers.blas import small
from ..solvers.robust_least_squares import LeastSquaresSolver, Weights, descend
from ..solvers.time_limit import LONG_TIME_LIMIT, TIME_LIMIT, check_time, limited
from ..typing import Array, Mask, Progress, StatusEnum
from .comparison import check_tubes
from .effects import Setup
from .measurements import Measurements, Timeline
from .model import about_z
from .registration import Registration

# Distance from the tip, m, within which a measured point is the tip: round-off of the arm's length.
ARRIVED = 1e-12

# Directions in which a force moves the measured points so many times less than in the best one are not seen at all:
# the Jacobian is known to about as many digits, so that its singular value there is noise.
UNSEEN = 1e-8


class Effort(NamedTuple):
    """How far a force is fitted."""

    steps: int
    """Maximum number of equilibria tried."""
    settled: float
    """Step, in standard errors of the force, below which it has settled."""


# Of 40 random forces on the thesis robot fits took 3 to 25 steps. Where one direction is hardly seen, steps along it
# are shortened again and again, and take more.
FULL = Effort(60, 1e-4)

# For fits to moved measurements, from which errors are computed. They start at the fit to the measurement itself; a
# hundredth of a standard error changes the errors by a per cent.
QUICK = Effort(12, 1e-2)

# Largest displacement of a measured point in one step, as a fraction of the arm: the linear fit is useless beyond.
LONGEST_MOVE = 0.1

# Relative to the diagonal of the normal equations. Directions may be seen a thousand times less than others, a
# million times in squares: a damping of 1e-6 would hold the force along them.
FIRST_DAMPING = 1e-8

# Step, in standard errors, below which a force has settled where steps end for another reason.
SURE = 1e-3

# Residual along a direction, in standard errors, below which a fit is as good as the noise, whatever the force along
# it.
WITHIN = 4.0

# Standard deviations by which measurements are moved: the nodes -sqrt(3), 0, sqrt(3) integrate polynomials up to
# degree 5 against a Gaussian (Gauss-Hermite), so that second moments of F + a z + b z^2 / 2 are exact.
ROOT = np.sqrt(3.0)

# (1024, 3) normal numbers from a Halton sequence: the quantile of 95 % of squares from as many random ones would be
# off by 4 %.
NORMAL = scipy.special.ndtri(scipy.stats.qmc.Halton(3, scramble=False).random(1025)[1:])

EVERYWHERE = np.eye(3)


class ForceStatus(StatusEnum):
    """How far a force is told; every value reads as a sentence."""

    TOLD = "the force is determined in all directions"
    IN_PART = "the force differs from zero significantly in some directions only"


@dataclass(frozen=True)
class ForceStatistics:
    """What an estimate took: steps of the fit."""

    iterations: int


@dataclass(frozen=True, eq=False)
class Measured:
    """Points of an arm that were measured, in the plate frame."""

    arc_length: Array
    """(P,) m."""
    position: Array
    """(P, 3) m."""
    noise: float
    """Standard deviation of a coordinate, m."""
    offset: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) of the foremost point from the arm, in the frame of the tip, m."""


@dataclass(frozen=True, eq=False)
class ForceEstimate(Displayed):
    """Estimated force at the tip, in world axes, with its covariance."""

    force: Annotated[Array, unit("mN"), form(".3f", label="force at the tip"), "force on the tip in the base frame"]
    """Shape (3,)."""
    covariance: Array
    """(3, 3) covariance from the measurement noise, to second order, N^2; inf along directions that the measurement
    does not bound. Its ellipsoid is an approximation. If a standard error is several hundredths of a newton, it may
    contain the force less often than stated: `coverage` computes how often. `contains` is a region with the stated
    confidence.
    """
    directions: Annotated[Array, "unit vectors, from the best to the worst determined"]
    """Shape (3, 3), by row."""
    errors: Annotated[
        Array,
        unit("mN"),
        form(".3f", label="standard errors, best direction to worst"),
        "standard error along each of them",
    ]
    """Shape (3,)."""
    equilibrium: Equilibrium
    """Equilibrium of the robot under that force."""
    residual: Annotated[
        float,
        unit("mm"),
        form(".4f", label="RMS distance of the points"),
        "RMS distance between measured and fitted points",
    ]
    fit: tuple[float, int]
    """Sum of squares of residuals over noise, and by what number it is on average: measured coordinates less 3."""
    iterations: int
    """Steps of the fit."""
    measured: Measured
    """The measurement."""
    base: Load
    """Loads that were known."""

    def contains(self, force: ArrayLike, confidence: float = 0.95) -> bool:
        """True if a force (N) is in the confidence region of the likelihood.

        The region is the set of forces for which the sum of squares over the noise exceeds its minimum by at most the
        quantile of chi-squared with 3 degrees of freedom. If only the tip was measured its confidence is exact, for any
        bending of the arm.
        """
        wanted = vector("force", force, 3, "x, y, z")
        try:
            there = _trial(self.equilibrium, self.base, wanted, self.measured)
        except SolveError:
            return False
        excess = float(there.residual @ there.residual) - self.fit[0]
        return excess <= float(scipy.special.chdtri(3, 1 - confidence))

    @limited
    def coverage(
        self, confidence: float = 0.95, *, draws: int = 100, seed: int = 0, time_limit: float = TIME_LIMIT
    ) -> float:
        """Fraction of simulated measurements with this noise for which the ellipsoid contains the force.

        A parametric bootstrap: the estimated force is taken for the true one and estimated again from every draw. The
        standard error of the fraction p is sqrt(p (1 - p) / draws). A draw that no force fits counts as outside.

        Raises:
            InputError: a confidence that is not in (0, 1), fewer than one draw.
            TimeLimitError: (a SolveError) the time limit was reached before all draws were made.
        """
        if not 0 < finite("confidence", confidence) < 1:
            raise InputError(f"confidence is {confidence:g}; it must be between 0 and 1")
        most, random = float(scipy.special.chdtri(3, 1 - confidence)), np.random.default_rng(seed)
        fitted = _trial(self.equilibrium, self.base, self.force, self.measured)
        noise, position = self.measured.noise, self.measured.position
        # Residuals are measured less fitted, over the noise: without them the points are those of the fitted arm.
        position = position - noise * fitted.residual.reshape(position.shape)
        held = 0
        for _ in range(whole("draws", draws, 1)):
            check_time()
            drawn = replace(self.measured, position=position + noise * random.normal(size=position.shape))
            with suppress(SolveError):
                start = _trial(self.equilibrium, self.base, self.force, drawn)
                again = _estimate(start, self.base, drawn)
                off = again.directions @ (self.force - again.force)
                # Squares along the own axes of the ellipsoid; a direction without a bound adds 0.
                held += float(np.sum((off / again.errors) ** 2)) <= most
        return held / draws

    @property
    def value(self) -> Array:
        """(3,) the force, N."""
        return self.force

    @property
    def status(self) -> ForceStatus:
        """Whether the force is determined in all directions, as a sentence."""
        told = np.abs(self.directions @ self.force) >= 2 * self.errors
        return ForceStatus.TOLD if told.all() else ForceStatus.IN_PART

    @property
    def statistics(self) -> ForceStatistics:
        """Number of iterations."""
        return ForceStatistics(self.iterations)

    @property
    def undetermined(self) -> str:
        """Directions in which the force cannot be distinguished from zero, as a sentence."""
        parts = []
        for direction, error in zip(self.directions, self.errors, strict=True):
            along = abs(float(direction @ self.force))
            if along < 2 * error:
                axis = ", ".join(f"{x + 0.0:.2f}" for x in direction)
                known = f"it is {along * 1e3:.3g} mN with a standard error of {error * 1e3:.3g} mN"
                parts.append(f"along ({axis}) {known if np.isfinite(error) else 'the measurement does not bound it'}")
        return str(ForceStatus.TOLD) if not parts else "undetermined: " + "; ".join(parts)


@dataclass(frozen=True, eq=False)
class ForceRecord(Displayed):
    """Forces at the tip over the N rows of a recording."""

    robot: Robot
    """The robot."""
    measurements: Measurements
    """The measurements."""
    noise: Annotated[
        float,
        unit("mm"),
        form(".3g", label="noise of a measured coordinate"),
        "standard deviation of a measured coordinate",
    ]
    estimates: tuple[ForceEstimate | None, ...]
    """Estimates, one per row; None for rows without one."""
    failures: tuple[tuple[int, str], ...]
    """(row, reason in words) of those."""

    @property
    def force(self) -> Array:
        """(N, 3) N, world axes; NaN in rows without an estimate."""
        return np.array([np.full(3, np.nan) if e is None else e.force for e in self.estimates])

    @property
    def standard_error(self) -> Array:
        """(N, 3) of the forces by axis, N; inf where an axis is not seen, NaN in rows without an estimate."""
        rows = [np.full(3, np.nan) if e is None else np.sqrt(np.diag(e.covariance)) for e in self.estimates]
        return np.array(rows)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Effects of the robot that the estimates ignore."""
        r = self.robot
        words = {
            "the room between the tubes (clearance)": isinstance(r, ConcentricRobot) and r.clearance is not None,
            "friction between the tubes": isinstance(r, ConcentricRobot) and r.friction is not None,
        }
        return tuple(f"{what} is left out of the estimates" for what, has in words.items() if has)


@typed
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
    """The dead force at the tip in every row of a recording, as `estimate_force`, each started from the row before.

    The robot's calibration converts readings to joint values, with latency and backlash, and gives the poses of sensor
    and plate. Full turns of the readings count. Forces and known loads are in the axes of the plate, tilted by the
    calibration.

    Args:
        measurements: joint readings, and positions; sensors behind the tip are points of the arm. Sensors at the same
            place of a row count by their mean.
        noise: standard deviation of a measured coordinate, m.
        known: as in `estimate_force`.
        registration: frame of the positions: none (base frame) or saved (device frame of the calibration). It is
            required if the calibration has a registration and was fitted to other positions.
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
    positions = (_of_plate(robot, measurements, registration) - setup.plate_shift) @ setup.plate_turn
    found: list[ForceEstimate | None] = []
    failures = []
    last: Equilibrium | None = None
    for row in range(len(measurements)):
        length = robot.assembly(shift[row]).total_length
        seen = np.isfinite(positions[row, :, 0])
        try:
            joints = joint_values(robot, alpha[row], shift[row])
            offset = setup.sensor_offset if seen[0] else np.zeros(3)
            measured = Measured(length - stations[seen], positions[row, seen], noise, offset)
            estimate = _fitted(robot, joints, measured, base, last)
        except SolveError as error:
            failures.append((row, str(error)))
            found.append(None)
            # The branch is lost: the next row begins without force.
            last = None
        else:
            found.append(estimate)
            last = estimate.equilibrium
        if progress is not None:
            progress(row + 1, len(measurements))
    return ForceRecord(robot, measurements, noise, tuple(found), tuple(failures))


def _of_plate(robot: Robot, measurements: Measurements, method: str | None) -> Array:
    """(N, K, 3) measured positions of the stations in the plate frame, m."""
    saved = robot.calibration.registration if robot.calibration is not None else None
    if method is None:
        own = saved is not None and saved.recording == measurements.mark
        at_plate = saved is None or (np.allclose(saved.rotation, np.eye(3)) and not any(saved.translation))
        if not (own or at_plate):
            raise InputError(
                "registration is missing, and the robot's calibration has one; it must be "
                "'saved' for positions of that device, or 'none' for positions in the base "
                "frame"
            )
        method = "saved" if own else "none"
    if choice("registration", method, ("none", "saved")) == "none":
        return measurements.station_position
    if saved is None:
        raise InputError("registration is 'saved', but the robot's calibration has none; it must be 'none'")
    return Registration.of_saved(saved).apply(measurements.station_position)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A force with its equilibrium, residuals (3 P,) over noise and their derivative (3 P, 3) by the force."""

    force: Array
    equilibrium: Equilibrium
    residual: Array
    jacobian: Array


@renamed(guess="start")
@typed
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
    """The dead force at the tip that fits measured positions best (Levenberg and Marquardt, with exact derivatives).

    Equilibria are those of the branch that starts without force.

    Args:
        rotations, translations: (n,) rad and m; translations default to home.
        tip_position: (3,) measured, m, plate frame.
        points: (arc length from the plate, (3,) measured position), m, along the arm.
        noise: standard deviation of every measured coordinate, m.
        known: other loads, such as the robot's weight; the estimate is added to its tip force.
        start: where the fit begins, such as the equilibrium of the last estimate; by default without force.
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
    places = _measured(
        float(robot.assembly(shift).total_length), tip_position, points, typical_length("noise", noise, TYPICAL_NOISE)
    )
    return _fitted(robot, (alpha, shift), places, _known(known), start)


def _known(load: Load | None) -> Load:
    """A load beside which a force is estimated."""
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
    """The estimate at joint values of the model, rad and m."""
    check_target(robot.tubes, "what is measured", measured.position)
    first = base if start is None or start.load is None else replace(base, force=start.load.force)
    pushed = forward_kinematics(robot, *joints, load=first, start=start)
    return _estimate(_trial(pushed, base, np.subtract(first.force, base.force), measured), base, measured)


def _settled(
    trial: _Trial, base: Load, measured: Measured, effort: Effort, axes: Array = EVERYWHERE
) -> tuple[_Trial, int]:
    """The fit of a force that differs from that of a trial along orthonormal axes (3, m) only, and the forces it tried;
    raises SolveError where it does not settle."""
    model = _Pushed(trial, base, measured, effort.steps, axes)
    count = len(trial.residual)
    weights = Weights(np.ones(count), np.ones(count), np.full(axes.shape[1], np.inf))
    steps = LeastSquaresSolver(
        iterations=effort.steps,
        settled=1e-12,  # a direction that is hardly seen is a small part of the cost
        first_damping=FIRST_DAMPING,
        round_off=effort.settled**2 / count,
    )
    end = descend(model, weights, model.start, solver=steps).state.trial
    if float(np.linalg.norm(_remaining(end, axes))) <= max(SURE, effort.settled):
        return end, model.tried
    raise SolveError(
        f"the force did not converge in {effort.steps} steps: the residual is {_distance(end, measured) * 1e3:.3g} mm",
        end.equilibrium,
    )


class _Force:
    """A force, N, that is x (m,) along the axes, with its trial, which is solved from a trial near by where it is asked
    for."""

    def __init__(self, model: _Pushed, x: Array, near: _Trial) -> None:
        self._model, self.x, self._near = model, x, near

    @cached_property
    def trial(self) -> _Trial:
        """Raises SolveError where there is none, or where points would move farther than the slopes say anything of."""
        return self._near if self is self._model.start else self._model.tried_at(self.x, self._near)

    def moved(self, step: Array) -> _Force:
        """The force after a step."""
        return _Force(self._model, self.x + step, self.trial)


class _Pushed:
    """The coordinates of the measured points over their noise, under a force at the tip: what `descend` fits."""

    freedoms = 0

    def __init__(self, start: _Trial, base: Load, measured: Measured, most_steps: int, axes: Array) -> None:
        self.bounds = np.outer([-np.inf, np.inf], np.ones(axes.shape[1]))
        # The part of the force across the axes stays as it is.
        self._axes, self._held = axes, start.force - axes @ (axes.T @ start.force)
        self._base, self._measured, self._most_steps, self.tried = base, measured, most_steps, 0
        self.start = _Force(self, axes.T @ start.force, start)

    def tried_at(self, x: Array, near: _Trial) -> _Trial:
        """The trial of a force; raises SolveError where there is none."""
        force = self._held + self._axes @ x
        self.tried += 1
        if self.tried > self._most_steps:
            raise SolveError("the step limit was reached")
        # The Jacobian is over the noise: times it, this is in m.
        moved = np.abs(near.jacobian @ (force - near.force)).max() * self._measured.noise
        if moved > LONGEST_MOVE * float(near.equilibrium.arc_length[-1]):
            raise SolveError("the force moves the arm beyond the range of the linearisation")
        try:
            return _trial(near.equilibrium, self._base, force, self._measured)
        except InputError as error:
            raise SolveError(str(error)) from None

    def residuals(self, state: _Force) -> Array:
        """(3 P, 1) fitted less measured."""
        return -state.trial.residual[:, None]

    def jacobian(self, state: _Force) -> Array:
        """(3 P, 1, m) by the force along the axes."""
        return (state.trial.jacobian @ self._axes)[:, None]

    def costly(self, state: _Force) -> bool:
        """Derivatives come with the equilibrium."""
        return False


def _measured(
    length: float, tip: ArrayLike | None, points: Sequence[tuple[float, ArrayLike]] | None, noise: float
) -> Measured:
    places, positions = [], []
    for k, entry in enumerate(() if points is None else points):
        try:
            at, position = entry
        except (TypeError, ValueError):
            raise InputError(f"points[{k}] is {entry!r}; it must be (arc length, (x, y, z))") from None
        if not 0 < at <= length * (1 + 1e-12):
            raise InputError(f"points[{k}] is at the arc length {at:g} m; it must be above 0 and at most {length:g} m")
        places.append(float(at))
        positions.append(vector(f"position of points[{k}]", position, 3, "x, y, z"))
    if tip is not None:
        places.append(length)
        positions.append(vector("tip_position", tip, 3, "x, y, z"))
    if not places:
        raise InputError("neither tip_position nor points are given; give one of them")
    return Measured(np.array(places), np.array(positions), noise)


def _trial(near: Equilibrium, base: Load, force: Array, measured: Measured) -> _Trial:
    load = replace(base, force=tuple(np.add(base.force, force).tolist()))
    with without_unit_warnings():  # forces that are tried
        e = under_load(near, load)
    noise = measured.noise
    tip = last_tube(e.robot.assembly(e.translations).end)
    away = e.tip_rotation @ about_z(e.rotation[int(tip), -1]) @ measured.offset
    # The compliance of the tip has these slopes already; other points need the Hessian.
    if len(measured.arc_length) == 1 and abs(measured.arc_length[0] - e.arc_length[-1]) <= ARRIVED:
        slopes = e.compliance[:3, :3] + _turned_by(e.compliance[3:, :3], away)
        return _Trial(force, e, (measured.position[0] - e.tip_position - away) / noise, slopes / noise)
    point = point_of(e)
    problem, state = point.member.problem, point.state
    # dx/dF = H^-1 (dp/dx)': a force at the tip enters the equations by the slopes of the tip (virtual work).
    moved = np.linalg.solve(state.hessian, tip_slopes(problem, state)[:3].T)
    residuals, rows = [], []
    for s, position in zip(measured.arc_length, measured.position, strict=True):
        here, slopes = position_slopes(problem, state, float(s))
        residuals.append(position - here)
        rows.append(slopes @ moved)
    if away.any():
        residuals[0] -= away
        rows[0] += _turned_by(e.compliance[3:, :3], away)
    return _Trial(force, e, np.concatenate(residuals) / noise, np.concatenate(rows) / noise)


def _turned_by(turns: Array, away: Array) -> Array:
    """(3, 3) by which a vector (3,) changes as its frame turns by the columns of (3, 3), rad."""
    return np.cross(turns.T, away).T


def _remaining(trial: _Trial, axes: Array) -> Array:
    """(3 P,) what the step of Gauss and Newton along axes (3, m) changes, over the noise, in what is seen."""
    slopes = trial.jacobian @ axes
    return np.asarray(slopes @ np.linalg.lstsq(slopes, trial.residual, rcond=UNSEEN)[0])


def _distance(trial: _Trial, measured: Measured) -> float:
    # The mean is over coordinates, and a point has three of them.
    return measured.noise * float(np.sqrt(3 * (trial.residual**2).mean()))


def _estimate(start: _Trial, base: Load, measured: Measured) -> ForceEstimate:
    """The estimate from a trial. Where directions are hidden, the others are fitted first: hidden there too, the force
    along them stays that of the trial. So does it along the directions that are seen worst where the fit does not
    settle, if the rest settles within the noise and fits along them fail for moved measurements.
    A short arm hardly gives to a force along it."""
    # Right singular vectors by column, from the best seen direction to the worst.
    weakest = np.linalg.svd(start.jacobian)[2].T
    failed: SolveError | None = None
    choices = [EVERYWHERE, weakest[:, :2], weakest[:, :1]]
    seen = weakest[:, ~_hidden(start)]
    if 0 < seen.shape[1] < 3:
        choices.insert(0, seen)
    for axes in choices:
        try:
            trial, iterations = _settled(start, base, measured, FULL, axes)
        except TimeLimitError:
            raise
        except SolveError as error:
            failed = failed if axes is seen else failed or error
            continue
        if axes is seen and _hidden(trial).sum() < 3 - seen.shape[1]:
            # Along seen directions the fit came to where more of them are seen: all are fitted from there.
            start = trial
        elif axes is seen or axes is EVERYWHERE or float(np.linalg.norm(_remaining(trial, EVERYWHERE))) <= WITHIN:
            break
    else:
        assert failed is not None
        raise failed
    covariance, directions, errors = _spread(trial, base, measured, axes)
    if failed is not None and np.isfinite(errors).sum() > axes.shape[1]:
        raise failed
    return ForceEstimate(
        force=trial.force,
        covariance=covariance,
        directions=directions,
        errors=errors,
        equilibrium=trial.equilibrium,
        residual=_distance(trial, measured),
        fit=(float(trial.residual @ trial.residual), len(trial.residual) - 3),
        iterations=iterations,
        measured=measured,
        base=base,
    )


def _hidden(trial: _Trial) -> Mask:
    """(3,) which directions, from the best to the worst seen, are not seen: one standard error along them is more, to
    first order, than four times the load under which a straight arm buckles."""
    e, size = trial.equilibrium, np.linalg.svd(trial.jacobian, compute_uv=False)
    # Euler's load of a column that is clamped at one end, pi^2 K / (4 L^2).
    buckling = np.pi**2 / 4 * sum(tube.bending_stiffness for tube in e.robot.tubes) / float(e.arc_length[-1]) ** 2
    return np.asarray((size * 4 * buckling < 1) | (size <= UNSEEN * size[0]))


def _spread(trial: _Trial, base: Load, measured: Measured, axes: Array) -> tuple[Array, Array, Array]:
    """Covariance, its axes by row from the best to the worst told, and standard errors along these, to second order.

    A measurement that is off by z standard deviations along the k-th left singular vector of the Jacobian gives a
    force F(z) = F + a z + b z^2 / 2. Both vectors are taken from fits to measurements that are moved by the root of 3
    standard deviations, forth and back: these points integrate a Gaussian to the third order. The covariance is the
    mean of squares about F, scaled so that its ellipsoid of 95 % holds 95 % of the forces F(z) of normal z.

    Fits to moved measurements differ along `axes` (3, m), as the fit to the measurement does, and along one of the
    others where that one is asked for.
    """
    left, size, right = np.linalg.svd(trial.jacobian @ axes, full_matrices=True)
    right = right @ axes.T
    if len(right) < 3:
        rest = scipy.linalg.null_space(axes.T)
        others = np.linalg.svd(trial.jacobian @ rest, full_matrices=False)
        left = np.column_stack([left[:, : len(right)], others[0]])
        size, right = np.append(size, others[1]), np.vstack([right, others[2] @ rest.T])
    linear, bent, lost = np.zeros((3, 3)), np.zeros((3, 3)), _hidden(trial)
    for k in np.flatnonzero(~lost):
        along = axes if k < axes.shape[1] else np.column_stack([axes, right[k]])
        sides = [_moved(trial, base, measured, sign * ROOT * left[:, k], along) for sign in (1.0, -1.0)]
        known = [side for side in sides if side is not None]
        lost[k] = len(known) < 2
        if sides[0] is not None and sides[1] is not None:
            # F(r) - F(-r) = 2 a r, and the sum of both changes is b r^2.
            linear[k], bent[k] = (sides[0] - sides[1]) / (2 * ROOT), (sides[0] + sides[1]) / ROOT**2
        elif known:
            side = 1.0 if sides[0] is not None else -1.0
            # With one side only, a = v / size is that of the linear fit, and the rest is b r^2 / 2.
            bent[k] = 2 * (known[0] - side * ROOT * right[k] / size[k]) / ROOT**2
    if lost.any():
        return _open(linear, bent, right, lost)
    first = right.T / size
    forces = NORMAL @ linear + 0.5 * NORMAL**2 @ bent
    covariance = _second_moment(linear, bent)
    # The same quantile for the linear F with the same draws: their sampling error cancels in the ratio.
    reached, usual = (
        np.quantile(np.einsum("ki,ij,kj->k", f, np.linalg.inv(c), f), 0.95)
        for f, c in ((forces, covariance), (NORMAL @ first.T, first @ first.T))
    )
    covariance *= reached / usual
    square, axes = np.linalg.eigh(covariance)
    return covariance, axes.T, np.sqrt(square)


def _second_moment(linear: Array, bent: Array) -> Array:
    """(3, 3) mean of F F' of F = sum_k a_k z_k + b_k z_k^2 / 2, rows a_k and b_k, z normal."""
    # E z^4 = 3 and E z_j^2 z_k^2 = 1: squares leave b_k b_k' / 2, and the mean of F adds its own square.
    total = bent.sum(0)
    return np.asarray(linear.T @ linear + bent.T @ bent / 2 + np.outer(total, total) / 4)


def _moved(trial: _Trial, base: Load, measured: Measured, by: Array, axes: Array) -> Array | None:
    """(3,) how the force changes along axes (3, m), N, where residuals change `by` (3 P,) standard deviations; None if
    none is found."""
    other = replace(measured, position=measured.position + measured.noise * by.reshape(-1, 3))
    near = replace(trial, residual=trial.residual + by)
    try:
        return np.asarray(_settled(near, base, other, QUICK, axes)[0].force - trial.force)
    except (InputError, SolveError):
        return None


def _open(linear: Array, bent: Array, right: Array, lost: Mask) -> tuple[Array, Array, Array]:
    """The same as `_spread` where forces along some directions have no bound."""
    rest = right[~lost]
    square = rest @ _second_moment(linear, bent) @ rest.T
    own, turns = np.linalg.eigh(square)
    directions = np.vstack([turns.T @ rest, right[lost]])
    errors = np.append(np.sqrt(np.maximum(own, 0.0)), np.full(int(lost.sum()), np.inf))
    return _covariance(directions, errors), directions, errors


def _covariance(directions: Array, errors: Array) -> Array:
    """(3, 3), inf in every entry that a direction without bound reaches."""
    told = np.isfinite(errors)
    out = (directions[told].T * errors[told] ** 2) @ directions[told]
    for direction in directions[~told]:
        reached = np.abs(np.outer(direction, direction)) > UNSEEN
        out[reached] = np.inf * np.sign(np.outer(direction, direction))[reached]
    return np.asarray(out)
