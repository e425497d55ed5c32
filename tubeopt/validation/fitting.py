"""Parameters of a robot from measured tips: nonlinear least squares, with intervals and held-out errors.

    minimise  sum_v |m_v - h_v(x, R, t)|^2 / sigma_v^2   over the parameters x and the registration (R, t)

where h_v is what the device should see: positions of stations along the arm and the direction of its tip.

The least squares are those of `solvers.robust_least_squares`. Errors held out take the slopes of the fit to all rows,
so that they need few solves or none. Intervals are those of independent errors, and those of `posterior`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
import scipy

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, SolveError, choice, finite, positive
from ..files.field_metadata import OneOf, check_fields, form, key, unit
from ..robots.calibration import Posterior
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.robust_least_squares import (
    NEARLY_SETTLED,
    LeastSquaresSolver,
    RobustDescent,
    Weights,
    bounded_step,
    descend,
    inverse_of,
    normal_equations,
    weighted_sums,
)
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Index, Progress, StatusEnum
from .certainty import ExpectedError, expected_error
from .comparison import (
    ErrorSummary,
    Validation,
    check_registration,
    check_tubes,
    compare_at,
    distances,
    join,
    registration_error,
    validate,
)
from .effects import PER_RECORDING, CommonRobot, Setup
from .identifiability import doubts, entangled_history, least_certain, left_out, louder, undetermined
from .learned import with_learned_priors
from .measurements import Measurements, recordings_of
from .model import ArmModel, ParameterState
from .parameters import Parameter, choose_parameters
from .posterior import posterior_of
from .registration import FIRST_GUESS, FREEDOMS, SENSOR_FRAME, BasePose, Registration
from .sessions import Registrations, Sessions
from .tube_shapes import MODES

# How a large error counts: by its square, or in the end by its size.
LOSSES = ("linear", "huber", "soft_l1")


# How a fit descends, and one of many similar fits whose slopes are known from near by, as in fits to all folds but one:
# each step there gains two digits or more.
FITTING = LeastSquaresSolver()
BY_CHORDS = LeastSquaresSolver(iterations=8, settled=NEARLY_SETTLED)

# Learned changes leave long valleys, along which the tips hardly change: a step that gains less than a thousandth of
# the cost is a small part of the standard errors. Before their priors are known a fit ends earlier.
LEARNING, ROUGH = LeastSquaresSolver(settled=1e-3), LeastSquaresSolver(settled=1e-2)

# Length of an error of three coordinates, in standard deviations of one, from which a robust loss grows like it and no
# longer like its square. Of normal errors 3 % are longer.
ROBUST_FROM = 3.0


def hold_out(
    model: Sessions, weights: Weights, fit: RobustDescent[ParameterState[Registrations]], fold: Index
) -> Array:
    """(V, 3) held-out residuals of every observation, by fits to the other folds with the derivatives of the fit to
    all.

    `fold` (N,) is the fold of each row.

    A fold without which the parameters leave the allowed robots keeps those of the whole fit.
    """
    fold_of_row = fold[model.row]
    out = np.empty_like(fit.residuals)
    for k in np.unique(fold_of_row):
        training = replace(weights, weight=weights.weight * (fold_of_row != k))
        try:
            without = descend(model, training, fit.state, jacobian=fit.jacobian, solver=BY_CHORDS)
            out[fold_of_row == k] = without.residuals[fold_of_row == k]
        except SolveError:
            out[fold_of_row == k] = fit.residuals[fold_of_row == k]
    return out


def hold_out_recordings(
    model: Sessions, weights: Weights, fit: RobustDescent[ParameterState[Registrations]], fold: Index
) -> Array:
    """(V, 3) held-out residuals of every recording, with the common parameters fitted to the other recordings.

    What it has of its own (registration, joint zeros, ...) is fitted to its other folds, common parameters held.
    """
    common = np.array([p.recording is None for p in model.parameters], dtype=bool)
    # Without slopes and priors a number does not move.
    held = np.append(common, np.full(model.freedoms, model.shared))
    slopes = np.where(held, 0.0, fit.jacobian)
    separate = replace(weights, prior=np.where(common, np.inf, weights.prior))
    out = np.empty_like(fit.residuals)
    for k in range(len(model.models)):
        mine = model.recording == k
        others = replace(weights, weight=weights.weight * ~mine)
        try:
            without = descend(model, others, fit.state, jacobian=fit.jacobian, solver=BY_CHORDS)
            inside = replace(separate, weight=separate.weight * mine)
            local_fit = replace(fit, state=without.state, residuals=without.residuals, jacobian=slopes)
            out[mine] = hold_out(model, inside, local_fit, fold)[mine]
        except SolveError:
            out[mine] = fit.residuals[mine]
    return out


def predicted_held_out(
    model: Sessions, weights: Weights, descent: RobustDescent[ParameterState[Registrations]], fold: Index
) -> Array:
    """(V, 3) approximate held-out residuals, from observations linearised about a state; nothing is solved."""
    fold_of_row, w, jacobian, x = fold[model.row], weights.of(descent.residuals), descent.jacobian, descent.state.x
    square, slope = normal_equations(model, weights, descent.state, descent.residuals, jacobian)
    free = np.full(model.freedoms, np.inf)
    low, high = model.bounds - x
    bounds = np.append(low, -free), np.append(high, free)
    out = np.empty_like(descent.residuals)
    for k in np.unique(fold_of_row):
        mine = fold_of_row == k
        a, b = weighted_sums(jacobian[mine], descent.residuals[mine], w[mine])
        # The normal equations without the rows of the fold: one Newton step within the bounds.
        out[mine] = descent.residuals[mine] + jacobian[mine] @ bounded_step(square - a, slope - b, bounds)
    return out


# Relative change of the estimated noise at which it has settled: from n numbers it is known to 1 / sqrt(2 n), 2 % of
# 1250. Noise changes the weights of positions against directions, and those the fit a little: a few rounds suffice.
SAME_NOISE, NOISE_ROUNDS = 0.02, 6

# The same of the deviations of learned changes, which a dozen numbers tell.
SAME_PRIOR = 0.1


@typed
@dataclass(frozen=True)
class FitOptions:
    """Options of a fit.

    Raises:
        InputError: a value out of its range.
    """

    registration: Annotated[
        str,
        OneOf(tuple(FREEDOMS)),
        "transformation from device frame to base frame: rigid (fitted), base-axis, none or saved",
    ] = "rigid"
    base: BasePose = SENSOR_FRAME
    """Pose of the base seen by the device, as for `validate`."""
    folds: int = 5
    """Number of folds of the cross-validation, 0 for none: blocks of the path (rows with times; repeated positions
    together), or rows dealt in a fixed order. Each is predicted by a fit to the others, with its registration."""
    confidence: float = 0.95
    """Confidence of the intervals, between 0 and 1."""
    loss: Annotated[str, OneOf(tuple(LOSSES)), "loss function of the residuals: linear, huber or soft_l1"] = "linear"
    """Loss function; linear is least squares."""
    priors: Annotated[
        bool, "penalise deviations from the robot file, relative to a typical error of each parameter"
    ] = False
    """Prior on each number of the drawing, with the standard deviation `prior` of its effect."""
    noise: tuple[float | None, float | None] = (None, None)
    """Standard deviation of a measured coordinate (m), of a measured direction (rad); None estimates it."""
    per_recording: tuple[str, ...] = ("registration", "latency", "translation", "rotation")
    """Effects of `effects.PER_RECORDING`, and "registration", with one value per recording; others are common."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name in self.per_recording:
            choice("per_recording", name, ("registration", *PER_RECORDING))
        if not 0 < finite("confidence", self.confidence) < 1:
            raise InputError(f"confidence is {self.confidence:g}; it must lie between 0 and 1")
        for name, value in zip(("position", "direction"), self.noise, strict=True):
            if value is not None:
                positive(f"noise of the {name}", value)


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter with its confidence interval."""

    name: str
    unit: str
    """Unit: "", "1/m", "rad", "m", "s", "N" or "m/N"."""
    start: float
    value: float
    standard_error: float
    """Standard error, assuming independent errors, as for `low` and `high`."""
    low: float
    high: float
    held: bool
    """True if the data do not determine it: its value is the start, and its interval is infinite."""
    posterior_error: float
    """Standard error that counts what the model lacks, see `validation.posterior`. The next two are its interval."""
    posterior_low: float
    posterior_high: float

    @property
    def learned(self) -> bool:
        """True for a number of a learned change along a tube."""
        return self.name.startswith("learned_")


class FitStatus(StatusEnum):
    """Result of a fit; every value reads as a sentence."""

    ESTIMATED = "all parameters were estimated"
    HELD = "some parameters are not determined by the measurements; they keep their initial values"


@dataclass(frozen=True)
class FitStatistics:
    """Number of solved shapes, and of fitted numbers."""

    evaluations: int
    numbers: int


@dataclass(frozen=True, eq=False)
class Fit(Displayed):
    """A robot calibrated to measurements."""

    robot: Robot
    """Robot with the estimated parameters; those of its drives are its `calibration`. Save it as YAML."""
    estimates: tuple[Estimate, ...]
    """Estimate of every chosen parameter."""
    correlation: Annotated[Array, "correlation of the estimates"]
    """(P, P) correlations; NaN for fixed parameters."""
    confidence: Annotated[float, "confidence of the intervals"]
    noise: Annotated[float, unit("mm"), form(".3f"), "noise per coordinate"]
    axis_noise: Annotated[float | None, unit("deg"), form(".3f"), "noise of a direction"]
    before: Annotated[Validation, "the comparison before the fit"]
    after: Annotated[Validation, "the comparison after the fit"]
    held_out_errors: Array | None
    """(N,) tip errors of each row, by the fit to the folds without it, m; None without folds."""
    held_out_axis_errors: Array | None
    """(N,) direction errors of each row, by the fit to the folds without it, rad.

    None without folds, or without directions.
    """
    fold: Index | None
    """(N,) fold of each row, None without folds."""
    held_out_inside: Annotated[float | None, "fraction of held-out coordinates within their interval"]
    """Positions only, with the intervals of `confidence` of parameters, misfit and noise."""
    held_out_recordings: Array | None
    """(N,) tip errors with the common parameters fitted to the other recordings, and what a recording has of its own to
    its other folds, m; None of one recording, or without folds."""
    remarks: Annotated[tuple[str, ...], "remarks on the fit"]
    """Remarks on badly determined parameters and on the data."""
    evaluations: Annotated[int, key("shapes_solved"), "number of solved shapes"]

    @property
    def value(self) -> Robot:
        """The robot with the estimated parameters."""
        return self.robot

    @property
    def status(self) -> FitStatus:
        """Status: all parameters estimated, or not; `remarks` names the others."""
        return FitStatus.HELD if any(each.held for each in self.estimates) else FitStatus.ESTIMATED

    @property
    def statistics(self) -> FitStatistics:
        """Effort of the fit."""
        return FitStatistics(self.evaluations, self.after.predicted.size)

    @property
    def learned(self) -> tuple[float, ...] | None:
        """Root mean square of the learned change of the precurvature along every tube, 1/m; None if none was fitted."""
        if not any(e.learned for e in self.estimates):
            return None
        tubes = Setup.of(self.robot).learned.reshape(-1, MODES)
        return tuple(np.sqrt((tubes**2).sum(1)).tolist())

    @property
    def held_out(self) -> ErrorSummary | None:
        """Summary of the held-out errors."""
        return None if self.held_out_errors is None else ErrorSummary.of(self.held_out_errors)

    @cached_property
    def new_paths(self) -> ExpectedError | None:
        """Error expected on new paths in the recorded ranges, by the posterior; None without one."""
        m = self.after.measurements
        return expected_error(self.robot, m.rotations, m.translations)

    @property
    def by_recording(self) -> tuple[ErrorSummary, ...]:
        """Summaries of the held-out errors of each of several recordings; empty for one."""
        if self.held_out_recordings is None:
            return ()
        ends = np.cumsum([len(v.measurements) for v in self.after.recordings])[:-1]
        return tuple(ErrorSummary.of(errors) for errors in np.split(self.held_out_recordings, ends))


@typed
@small
@limited
def fit(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    parameters: Sequence[str],
    options: FitOptions | None = None,
    *,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Fit:
    """Estimate chosen parameters of a robot from measured tips, jointly with the registration.

    Of several recordings tubes, friction and drives are common, and each has `options.per_recording` for itself. The
    robot has these of the last recording.

    Args:
        parameters: names out of `effects.KINDS`, such as "latency", "curvature_2", "rotation_1", "rotation_all".
        progress: called with the number of stages done and of all.
        time_limit: s, on the clock.

    Raises:
        InputError: unknown or contradicting parameters, fewer numbers than unknowns, folds out of range, and what
            `validate` raises.
        SolveError: no row has a stable shape.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    options = options or FitOptions()
    recordings = recordings_of(measurements)
    check_tubes(robot, recordings[0])
    chosen = choose_parameters(robot, recordings, parameters, options.registration, options.per_recording)
    report = progress or (lambda count, total: None)
    model = sessions(robot, recordings, chosen, options)
    report(1, 4)
    problem = FitProblem(model, options)
    report(2, 4)
    answer = problem.answer(report)
    report(4, 4)
    return answer


def sessions(
    robot: Robot, recordings: Sequence[Measurements], chosen: Sequence[Parameter], options: FitOptions
) -> Sessions:
    """Model of recordings; raises InputError for fewer numbers than unknowns, or more folds than rows."""
    shared = "registration" not in options.per_recording
    freedoms = FREEDOMS[options.registration]
    for k, m in enumerate(recordings):
        # What has a prior needs no measured number.
        n_parameters = sum(p.recording in (None, k) and not p.effect.random for p in chosen)
        check_counts(m, n_parameters + freedoms, options.folds)
    model = Sessions(robot, recordings, options.registration, options.base, shared=shared)
    return model.with_parameters(chosen)


def check_counts(measurements: Measurements, unknowns: int, folds: int) -> None:
    """Raise InputError for fewer numbers than unknowns, or more folds than rows."""
    count = int(np.isfinite(measurements.sensors[..., 0]).any(1).sum())
    if 3 * count <= unknowns:
        raise InputError(
            f"{count} measured tips are {3 * count} numbers; {unknowns} unknowns (parameters and registration) need "
            "more"
        )
    if folds and not 2 <= folds <= len(measurements):
        raise InputError(f"folds is {folds}; it must be 0, or 2 to the number of measurements, {len(measurements)}")


def weigh(model: Sessions, options: FitOptions, sigma: tuple[float, float]) -> Weights:
    """Weights of the observations at given noise of positions and directions."""
    prior = np.array([p.prior if options.priors or p.effect.random else np.inf for p in model.parameters])
    spread = np.where(model.directed, sigma[1], sigma[0])
    return Weights(spread, np.ones(len(model.row)), prior.reshape(-1), options.loss, ROBUST_FROM)


class FitProblem:
    """Solved fit of a model's parameters. Undetermined parameters are fixed, and the noise is estimated.

    Args:
        model: with the parameters that were chosen.   start: a state to begin at, of the same parameters.
        sigma: noise of positions and directions to begin with.
    """

    def __init__(
        self,
        model: Sessions,
        options: FitOptions,
        start: ParameterState[Registrations] | None = None,
        sigma: tuple[float, float] = FIRST_GUESS,
    ) -> None:
        self.chosen, self.options = model.parameters, options
        self.sigma = (options.noise[0] or sigma[0], options.noise[1] or sigma[1])
        origin = start or model.start
        slopes = model.jacobian(origin)
        self.held, self.remarks = self._undetermined(model, slopes)
        self.free = [k for k in range(len(self.chosen)) if k not in self.held]
        self.model = model.with_parameters([self.chosen[k] for k in self.free])
        columns = [*self.free, *range(len(self.chosen), slopes.shape[2])]
        self.fit = self._settle(ParameterState(origin.x[self.free], origin.registration), slopes[..., columns])

    def _undetermined(self, model: Sessions, slopes: Array) -> tuple[list[int], list[str]]:
        idle = [k for k, p in enumerate(self.chosen) if p.idle]
        messages = [left_out(self.chosen[k]) for k in idle]
        active = [k for k, p in enumerate(self.chosen) if not p.idle and not p.effect.random]
        if not active or self.options.priors:
            return idle, messages
        unit = np.where(model.directed, model.length, 1.0)
        columns = [*active, *range(len(self.chosen), slopes.shape[2])]
        chosen = [self.chosen[k] for k in active]
        held, more = undetermined(chosen, slopes[..., columns] * unit[:, None, None], model.length)
        return sorted([*idle, *(active[k] for k in held)]), messages + more

    def weights(self) -> Weights:
        """Weights of the observations for the noise."""
        return weigh(self.model, self.options, self.sigma)

    def _settle(
        self, start: ParameterState[Registrations], slopes: Array
    ) -> RobustDescent[ParameterState[Registrations]]:
        """Minimum from a start, with noise and learned priors estimated again until nothing changes any more.

        With least squares of positions alone, without priors, the noise has no effect.
        """
        random = any(p.effect.random for p in self.model.parameters)
        priors = self.options.priors or random
        solver = LEARNING if random else FITTING
        rough = ROUGH if random else solver
        descent = descend(self.model, self.weights(), start, first=slopes, secants=random, solver=rough)
        for _ in range(NOISE_ROUNDS):
            last, self.sigma = self.sigma, self._noise(descent)
            alike = np.allclose(self.sigma, last, rtol=SAME_NOISE, atol=0)
            if random:
                before = self.weights().prior
                self.model = self.model.with_parameters(with_learned_priors(self.model, self.weights(), descent))
                alike = alike and np.allclose(self.weights().prior, before, rtol=SAME_PRIOR)
            if alike or not (self.model.directed.any() or self.options.loss != "linear" or priors):
                break
            first, state = descent.jacobian, descent.state
            descent = descend(self.model, self.weights(), state, first=first, secants=random, solver=solver)
        return self._registered(descent)

    def _registered(
        self, descent: RobustDescent[ParameterState[Registrations]]
    ) -> RobustDescent[ParameterState[Registrations]]:
        """Fit with the exact registration in closed form, since its last step is linear."""
        if self.options.loss != "linear":
            return descent
        state = self.model.registered(descent.state, self.options.noise)
        # Slopes of motion with friction cost as much as a fit; those of the state before serve there, as in `descend`.
        slopes = descent.jacobian if self.model.costly(state) else self.model.jacobian(state)
        return replace(descent, state=state, residuals=self.model.residuals(state), jacobian=slopes)

    def _noise(self, descent: RobustDescent[ParameterState[Registrations]]) -> tuple[float, float]:
        """Standard deviations of position coordinates and of directions: as given, or those of the residuals."""
        left, known = self._left(descent), self.options.noise
        return known[0] or left[0], known[1] or left[1]

    def _left(self, descent: RobustDescent[ParameterState[Registrations]]) -> tuple[float, float]:
        """Standard deviations of the residuals of a fit, of position coordinates and of directions.

        With a robust loss they follow from the median, which outliers do not move.
        """
        size = np.linalg.norm(descent.residuals, axis=1)
        a = self.model.directed
        unknowns = len(self.free) + self.model.freedoms - self._from_priors(descent)
        total = 3 * (~a).sum() + 2 * a.sum()
        # Each unknown takes one number to fit, which leaves so much less in the residuals.
        freedom_ratio = max(total - unknowns, 1) / total
        out = []
        for sizes, coordinates, noise in ((size[~a], 3, self.options.noise[0]), (size[a], 2, self.options.noise[1])):
            if not len(sizes):
                out.append(noise or FIRST_GUESS[1])
            elif self.options.loss == "linear":
                out.append(float(np.sqrt((sizes**2).sum() / (coordinates * len(sizes) * freedom_ratio))))
            else:
                # The median of a chi distribution with k coordinates is sqrt(2 P^-1(k / 2, 1 / 2)), P the incomplete
                # gamma function.
                out.append(float(np.median(sizes) / np.sqrt(2 * scipy.special.gammaincinv(coordinates / 2, 0.5))))
        return max(out[0], 1e-12), max(out[1], 1e-12)

    def _from_priors(self, descent: RobustDescent[ParameterState[Registrations]]) -> float:
        """Number of unknowns that the priors fit, not the observations."""
        weights = self.weights()
        inverse = weights.prior**-2.0
        if not inverse.any():
            return 0.0
        square, _ = normal_equations(self.model, weights, descent.state, descent.residuals, descent.jacobian)
        return float(inverse @ np.diag(inverse_of(square))[: len(inverse)])

    @property
    def values(self) -> Array:
        """(P,) values of all chosen parameters."""
        out = np.array([p.start for p in self.chosen])
        out[self.free] = self.fit.state.x
        return out

    @cached_property
    def covariance(self) -> Array:
        """(P', P') covariance of the parameters that are not fixed."""
        square, _ = normal_equations(self.model, self.weights(), self.fit.state, self.fit.residuals, self.fit.jacobian)
        return inverse_of(square)[: len(self.free), : len(self.free)]

    def answer(self, report: Progress) -> Fit:
        """Result of the fit with its statistics."""
        model, options, parts = self.model, self.options, self.model.parts(self.fit.state)
        known = [registration_error(m, part) for m, part in zip(model.models, parts, strict=True)]
        if model.shared:  # the recording that knows it best stands for all
            known = [min((e for e in known if e), key=lambda e: e.turn, default=None)] * len(known)
        for error in known:
            check_registration(error, model.method)
        errors, correlation = self._spread()
        posterior, full, inside = None, np.full(len(self.chosen), np.inf), None
        fold, bands = model.fold(options.folds) if options.folds else None, None
        if self.free:
            per_recording, noise = options.per_recording, options.noise[0]
            known_fold = np.zeros(0, dtype=int) if fold is None else fold
            full_fit = posterior_of(model, self.fit, self.weights(), self.chosen, per_recording, noise, known_fold)
            posterior, full[self.free], bands = full_fit.posterior, full_fit.errors, full_fit.bands
        along, axis, elsewhere = None, None, None
        if fold is not None:
            left_over = hold_out(model, self.weights(), self.fit, fold)
            along, axis = distances(model, left_over)
            if bands is not None:
                within = scipy.special.ndtri((1 + options.confidence) / 2) * bands
                inside = float((np.abs(left_over) < within)[~model.directed].mean())
            if len(model.models) > 1:
                elsewhere, _ = distances(model, hold_out_recordings(model, self.weights(), self.fit, fold))
        report(3, 4)
        # A direction is three numbers with two degrees of freedom.
        degrees = max(1, 3 * len(model.row) - int(model.directed.sum()) - len(self.free) - model.freedoms)
        half = scipy.special.stdtrit(degrees, (1 + options.confidence) / 2) * errors
        wide = scipy.special.ndtri((1 + options.confidence) / 2) * full
        compared = []
        for k, error in enumerate(known):
            comparison = validate(self._calibrated(k, posterior), model.recordings[k])
            registration = replace(comparison.registration, method=model.method)
            compared.append(replace(comparison, registration=registration, registration_error=error))
        after = join(compared)
        starts = zip(model.models, model.parts(model.start), strict=True)
        return Fit(
            robot=after.robot,
            estimates=_estimates(self.chosen, self.values, (errors, half), (full, wide)),
            correlation=correlation,
            confidence=options.confidence,
            noise=self.sigma[0],
            axis_noise=self.sigma[1] if model.directed.any() else None,
            before=join([compare_at(m, start, model.robot) for m, start in starts]),
            after=after,
            held_out_errors=None if along is None else along[:, 0],
            held_out_axis_errors=axis,
            fold=fold,
            held_out_inside=inside,
            held_out_recordings=None if elsewhere is None else elsewhere[:, 0],
            remarks=(*after.remarks, *self.remarks, *self._doubts(half, correlation)),
            evaluations=model.evaluations,
        )

    def _calibrated(self, k: int, posterior: Posterior | None) -> Robot:
        """Robot with all fitted numbers, including those of recording k in its calibration."""
        model, state = self.model.models[k], self.model.part(self.fit.state, k)
        return replace(calibrated(model, model.setup(state.x), state.registration), posterior=posterior)

    def _spread(self) -> tuple[Array, Array]:
        """Standard errors (P,) and correlation (P, P) of the parameters; infinite and NaN for fixed ones."""
        count, free = len(self.chosen), self.free
        errors, correlation = np.full(count, np.inf), np.full((count, count), np.nan)
        deviation = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        errors[free] = deviation
        correlation[np.ix_(free, free)] = self.covariance / np.outer(deviation, deviation)
        return errors, correlation

    def _doubts(self, half: Array, correlation: Array) -> list[str]:
        plain = [k for k in self.free if not self.chosen[k].effect.random]
        messages = doubts(self.chosen, plain, self.values, half, correlation)
        messages += least_certain(self.chosen, self.free, half, correlation)
        messages += entangled_history(self.model, self.fit)
        messages += louder(self._left(self.fit), self.options.noise)
        if not self.fit.converged:
            messages.append(
                f"the fit had not settled after {FITTING.iterations} steps: estimate fewer parameters, or "
                "start from a closer robot"
            )
        if self.fit.obstacle:
            messages.append(
                f"the last steps were cut short, since beyond them there is no such robot: {self.fit.obstacle}"
            )
        if self.model.failures:
            row, reason = self.model.failures[0]
            messages.append(
                f"{len(self.model.failures)} rows have no stable shape and were left out; the first is row {row + 1}: "
                f"{reason}"
            )
        return messages


def calibrated(model: ArmModel, setup: Setup, registration: Registration) -> CommonRobot:
    """Robot with the numbers of a setup and the registration of a recording, without a posterior."""
    measurements = model.measurements
    found_by = f"{len(measurements)} rows of {measurements.source or 'measurements'}"
    drives = replace(setup.drives, registration=registration.saved(measurements.mark))
    if measurements.orientation is not None and model.axis is not None:
        drives = replace(drives, sensor_axis=tuple(model.axis.tolist()))
    return replace(replace(setup, drives=drives).robot(model.robot, found_by), posterior=None)


def _estimates(
    parameters: Sequence[Parameter], values: Array, errors: tuple[Array, Array], full: tuple[Array, Array]
) -> tuple[Estimate, ...]:
    return tuple(
        Estimate(
            name=p.name,
            unit=p.unit,
            start=p.start,
            value=float(values[k]),
            standard_error=float(errors[0][k]),
            low=float(values[k] - errors[1][k]),
            high=float(values[k] + errors[1][k]),
            held=bool(np.isinf(errors[0][k])),
            posterior_error=float(full[0][k]),
            posterior_low=float(values[k] - full[1][k]),
            posterior_high=float(values[k] + full[1][k]),
        )
        for k, p in enumerate(parameters)
    )
