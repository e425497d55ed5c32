"""Parameters of a robot from measured tips: nonlinear least squares, with intervals and held-out errors.

    minimise  sum_k | R m_k + t - p_k(x) |^2   over the parameters x and the registration (R, t)

where p_k(x) is the tip of the equilibrium at row k. The registration is eliminated: for every x it is solved in closed
form (variable projection, Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973)), so the Jacobian of the remaining
residuals already contains how the frame gives way, and J'J that of x with the registration estimated jointly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..errors import InputError, SolveError
from ..robots.robot import Robot
from ..typing import Array, Sentence
from .comparison import Progress, Validation, validate
from .errors import ErrorSummary
from .identifiability import doubts, undetermined
from .measurements import Measurements
from .model import TipModel
from .parameters import Parameter, apply, choose_parameters
from .registration import FREEDOMS, SENSOR_FRAME, BasePose

ITERATIONS = 50
SHUFFLE_SEED = 0


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter with its confidence interval [low, high]; unit "", "1/m", "rad" or "m".

    A parameter that the data cannot determine is held at its start: its value is the start and its interval infinite.
    """

    name: str
    unit: str
    start: float
    value: float
    standard_error: float
    low: float
    high: float
    held: bool


class FitStatus(Sentence):
    """What became of a fit; every value reads as a sentence."""

    ESTIMATED = "all parameters were estimated"
    HELD = "some parameters are not determined by the measurements and were held at their start"


@dataclass(frozen=True)
class FitStatistics:
    """What a fit took: shapes that were solved; and of how many numbers it was made."""

    evaluations: int
    numbers: int


@dataclass(frozen=True, eq=False)
class Fit:
    """A robot calibrated to measurements.

    Attributes:
        robot: with the estimated parameters; save it as YAML.
        rotation_offsets: (n,) to add to the rotations that are asked of the robot, rad; no robot file holds them.
        estimates: one for every chosen parameter.
        correlation: (P, P) of the estimates, NaN for those that are held.
        confidence: of the intervals.
        noise: estimated standard deviation of one measured coordinate, m.
        before, after: the robot as given and as fitted, against all measurements.
        held_out_errors: (N,) tip errors (m) of each row, by the fit to the folds without it; None without folds.
        remarks: in words, what the data do not determine, or hardly.
        evaluations: shapes that were solved.
    """

    robot: Robot
    rotation_offsets: Array
    estimates: tuple[Estimate, ...]
    correlation: Array
    confidence: float
    noise: float
    before: Validation
    after: Validation
    held_out_errors: Array | None
    remarks: tuple[str, ...]
    evaluations: int

    @property
    def value(self) -> Robot:
        """The robot with the estimated parameters."""
        return self.robot

    @property
    def status(self) -> FitStatus:
        """Whether every parameter was estimated; `remarks` say which were not."""
        return FitStatus.HELD if any(each.held for each in self.estimates) else FitStatus.ESTIMATED

    @property
    def statistics(self) -> FitStatistics:
        """What it took."""
        return FitStatistics(self.evaluations, self.after.predicted.size)

    @property
    def held_out(self) -> ErrorSummary | None:
        """Summary of the held-out errors."""
        return None if self.held_out_errors is None else ErrorSummary.of(self.held_out_errors)


def fit(
    robot: Robot,
    measurements: Measurements,
    parameters: Sequence[str],
    *,
    registration: str = "rigid",
    base: BasePose = SENSOR_FRAME,
    folds: int = 5,
    confidence: float = 0.95,
    progress: Progress | None = None,
) -> Fit:
    """Estimate chosen parameters of a robot from measured tips, jointly with the registration.

    Intervals follow from J'J at the solution with Student's t: they hold where the model is right and the errors of all
    coordinates are independent and alike. Systematic errors make them too narrow; compare the held-out error.

    Args:
        parameters: names out of `parameters.KINDS`, such as "curvature", "curvature_2", "stiffness_ratio_2", "nu",
            "rotation_1", "transmission_length".
        registration, base: as for `validate`.
        folds: of the cross-validation; each row is predicted by a fit, registration included, to the other folds. 0
            leaves it out.
        confidence: of the intervals, between 0 and 1.
        progress: called with the number of shapes solved and an estimate of all.

    Raises:
        InputError: unknown or contradicting parameters, fewer numbers than unknowns, folds or confidence out of range,
            data on which no chosen parameter has an effect, and what `validate` raises.
        SolveError: no stable shape for a row, or the iteration did not converge.
    """
    chosen = choose_parameters(robot, measurements, parameters)
    _check(measurements, len(chosen) + FREEDOMS.get(registration, 0), folds, confidence)
    count = len(measurements)
    counter = _Counter(progress, count * (9 + 4 * folds))
    before = validate(robot, measurements, registration=registration, base=base, progress=counter.step)
    model = TipModel(robot, measurements, chosen, registration, base, counter.step)
    start = np.array([parameter.start for parameter in chosen])
    held, remarks = undetermined(chosen, model.jacobian(start), before.length)
    free = [k for k in range(len(chosen)) if k not in held]
    if not free:
        raise InputError("\n".join(remarks))
    model.vary(free)
    values = start.copy()
    values[free], residuals, jacobian = _minimise(model, start[free])
    degrees = residuals.size - len(free) - FREEDOMS[registration]
    noise = float(np.sqrt(residuals @ residuals / degrees))
    errors, correlation = _spread(jacobian, noise, free, len(chosen))
    half = scipy.stats.t.ppf((1 + confidence) / 2, degrees) * errors
    calibrated, offsets = apply(robot, chosen, values)
    after = validate(calibrated, measurements.turned(offsets), registration=registration, base=base)
    return Fit(
        robot=calibrated,
        rotation_offsets=offsets,
        estimates=_estimates(chosen, values, errors, half),
        correlation=correlation,
        confidence=confidence,
        noise=noise,
        before=before,
        after=after,
        held_out_errors=_cross_validate(model, values, free, folds) if folds else None,
        remarks=(*remarks, *doubts(chosen, free, values, half, correlation)),
        evaluations=counter.done,
    )


def _estimates(parameters: Sequence[Parameter], values: Array, errors: Array, half: Array) -> tuple[Estimate, ...]:
    table = zip(parameters, values.tolist(), errors.tolist(), half.tolist(), strict=True)
    return tuple(
        Estimate(p.name, p.unit, p.start, value, error, value - width, value + width, bool(np.isinf(error)))
        for p, value, error, width in table
    )


def _check(measurements: Measurements, unknowns: int, folds: int, confidence: float) -> None:
    count = len(measurements)
    if 3 * count <= unknowns:
        raise InputError(
            f"{count} measured tips are {3 * count} numbers; {unknowns} unknowns (parameters and registration) need "
            "more"
        )
    if folds and not 2 <= folds <= count:
        raise InputError(f"folds is {folds}; it must be 0, or 2 to the number of measurements, {count}")
    if not 0 < confidence < 1:
        raise InputError(f"confidence is {confidence:g}; it must lie between 0 and 1")


class _Counter:
    """Counts solved shapes across the stages of a fit."""

    def __init__(self, progress: Progress | None, expected: int) -> None:
        self.done, self.expected, self.progress = 0, expected, progress

    def step(self, *_: object) -> None:
        """One more shape is solved."""
        self.done += 1
        if self.progress is not None:
            self.progress(self.done, max(self.expected, self.done))


def _minimise(model: TipModel, start: Array) -> tuple[Array, Array, Array]:
    """Solution, residuals and Jacobian of a least-squares problem; raises SolveError where it does not converge."""
    parameters = model.varied
    bounds = [p.low for p in parameters], [p.high for p in parameters]
    result = scipy.optimize.least_squares(
        model.residuals,
        np.clip(start, *bounds),
        jac=model.jacobian,
        bounds=bounds,
        x_scale=[p.scale for p in parameters],
        ftol=1e-7,
        xtol=1e-8,
        gtol=1e-12,
        max_nfev=ITERATIONS,
    )
    if result.status <= 0:
        raise SolveError(
            f"the fit did not converge in {ITERATIONS} iterations; the last had a root mean square residual of "
            f"{1e3 * np.sqrt(np.mean(result.fun**2)):.3g} mm. Estimate fewer parameters, or start from a closer robot"
        )
    return result.x, result.fun, result.jac


def _spread(jacobian: Array, noise: float, free: Sequence[int], count: int) -> tuple[Array, Array]:
    """Standard errors (P,) and correlation (P, P) from (J'J)^-1; infinite and NaN for parameters that are held."""
    scale = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    errors, correlation = np.full(count, np.inf), np.full((count, count), np.nan)
    errors[free] = noise * np.sqrt(np.diag(inverse)) / scale
    deviation = np.sqrt(np.diag(inverse))
    correlation[np.ix_(free, free)] = inverse / np.outer(deviation, deviation)
    return errors, correlation


def _cross_validate(model: TipModel, values: Array, free: list[int], folds: int) -> Array:
    """(N,) errors of rows predicted without them, m; rows are dealt to the folds in a fixed, shuffled order."""
    count = len(model.measurements)
    fold = np.empty(count, dtype=int)
    fold[np.random.default_rng(SHUFFLE_SEED).permutation(count)] = np.arange(count) % folds
    errors = np.empty(count)
    for k in range(folds):
        train = model.rows(np.flatnonzero(fold != k))
        x = _minimise(train, values[free])[0]
        train.residuals(x)
        rest = np.flatnonzero(fold == k)
        test = model.rows(rest)
        predicted = test.tips(x)
        measured = train.registration.apply(test.measurements.tip_position)
        errors[rest] = np.linalg.norm(measured - predicted, axis=1)
    return errors
