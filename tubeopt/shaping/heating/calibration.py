"""What a rig really is, from a logged heating: nonlinear least squares with intervals.

    minimise  sum over channels c and rows k of ((model_c(x, t_k) - logged_c(t_k)) / sigma_c)^2

over factors x on loss, even gap of the groove, contact resistance, resistivity and battery resistance, as many as the
log determines. Factors are fitted as logarithms, so that they stay positive; the Jacobian comes from simulating all
perturbed rigs at once. The noise of every channel is estimated from its own residuals. Intervals are those of the
noise, with the error of the model's own grid to spare.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ...constants import ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError, choice, positive, undoubted
from ...physics.heat import LEAD, Resolution
from ...robots.tubes import Tube
from ...solvers.robust_least_squares import LeastSquaresSolver, Weights, descend
from ...typing import Array
from .logged import LEAST_NOISE, NOISE, HeatingLog, believable, kind_of, step_of, unexplained
from .rig import COUNTS, Rig
from .sensors import followed, tube_at
from .settings import DEFAULT_RIG_SOLVER, RigSolver
from .simulation import State, advance, at_rest, current
from .thermal import COARSE, FINE, ThermalModel, gap_of, stack, thermal_model

BIAS = "bias"
"""What can be fitted besides factors: by how much every thermometer is off, K."""


def _scaled(part: str, name: str) -> Callable[[Rig, float], Rig]:
    @undoubted()
    def change(rig: Rig, factor: float) -> Rig:
        piece: Any = getattr(rig, part)
        return replace(rig, **{part: replace(piece, **{name: getattr(piece, name) * factor})})

    return change


FARTHEST = 2.5
"""Largest logarithm of a factor: 12 times what the file says."""

STEPS = LeastSquaresSolver(iterations=25, settled=1e-6)
"""The grid's own error is far more than a step below leaves."""

FACTORS: dict[str, Callable[[Rig, float], Rig]] = {
    "loss": lambda rig, factor: replace(rig, loss_factor=rig.loss_factor * factor),
    "gap": _scaled("mold", "gap"),
    "contact_resistance": _scaled("circuit", "contact_resistance"),
    "resistivity": lambda rig, factor: replace(rig, resistivity_factor=rig.resistivity_factor * factor),
    "internal_resistance": _scaled("battery", "internal_resistance"),
    "clamps": _scaled("clamps", "contact_conductance"),
}
"""What can be fitted: loss, the groove's even gap, resistance of the clamps' contacts, resistivity, the battery's,
and how well heat passes into the clamps, which thermometers along the tube tell."""


@dataclass(frozen=True)
class Estimate:
    """A fitted factor on what the rig's file says, and its interval; held at 1, and infinite, where undetermined.

    A bias is no factor: by how much a thermometer shows too much, K; held at 0 between infinities.
    """

    name: str
    factor: float
    low: float
    high: float
    held: bool


@dataclass(frozen=True, eq=False)
class RigFit(Displayed):
    """A rig calibrated to a log."""

    rig: Rig
    """With the factors applied."""
    estimates: tuple[Estimate, ...]
    """One for every factor that was asked for."""
    confidence: float
    """Of the intervals."""
    noise: dict[str, float]
    """Standard deviation of the residuals of each channel, K, V, A."""
    before: dict[str, Array]
    """(T,) channels that the rig predicts as given."""
    after: dict[str, Array]
    """(T,) channels that it predicts as fitted, biases included."""
    log: HeatingLog
    """That was fitted, without what was not believed."""
    remarks: tuple[str, ...]
    """In words, what the log does not determine, and what the model does not explain."""


def predict(
    tube: Tube, rigs: Sequence[Rig], log: HeatingLog, grid: Resolution = FINE, *, step: float = DEFAULT_RIG_SOLVER.step
) -> dict[str, Array]:
    """(T, B) what the log's channels would show on each rig, simulated in steps of at most `step`, s."""
    model = stack([thermal_model(tube, rig, grid) for rig in rigs])
    state = at_rest(model)
    lags = np.broadcast_to(log.lag, len(log.positions))[:, None]
    touched = shown = _touched(model, state, log)
    rows = [_seen(model, state, shown)]
    for duty, span in zip(log.duty.tolist(), np.diff(log.time).tolist(), strict=False):
        steps = math.ceil(span / step)
        for _ in range(steps):
            state = advance(model, state, duty / COUNTS, span / steps, 1)
            before, touched = touched, _touched(model, state, log)
            shown = followed(lags, shown, before, touched, span / steps)
        rows.append(_seen(model, state, shown))
    return dict(zip((*log.thermometers, "voltage", "current"), np.array(rows).swapaxes(0, 1), strict=True))


def _touched(model: ThermalModel, state: State, log: HeatingLog) -> Array:
    """(S, B) temperatures of the tube, K, where the thermometers are, or where the mold begins."""
    farthest = model.half_length - float(model.position[model.zone == LEAD][0])
    return tube_at(model, state, np.minimum(log.positions, farthest)).T + ZERO_CELSIUS


def _seen(model: ThermalModel, state: State, shown: Array) -> Array:
    """(S + 2, B) of the channels, whose thermometers show (S, B)."""
    now = current(model, state.cells[:, :, 0], state.lumped)
    return np.vstack([shown, now.terminal_voltage, now.total])


def calibrate(
    tube: Tube,
    rig: Rig,
    log: HeatingLog,
    parameters: Sequence[str] = ("loss", "gap", "contact_resistance", "resistivity"),
    *,
    noise: Mapping[str, float] | None = None,
    confidence: float = 0.95,
    solver: RigSolver = DEFAULT_RIG_SOLVER,
) -> RigFit:
    """The rig that explains a log, from any subset of temperature, voltage and current.

    Factors that the log does not determine are held at 1 and reported, weakest first, until the rest is determined.
    Residuals that are more than the stated noise, or come in waves, are remarked.

    Args:
        parameters: names of FACTORS, and "bias" for that of every thermometer.
        noise: stated standard deviations by "temperature", "voltage", "current", K, V, A.
        solver: how it is calibrated.

    Raises:
        InputError: an unknown factor, none, a confidence outside of (0, 1), or a thermometer that is dead.
    """
    names = [choice("parameter", name, (*FACTORS, BIAS)) for name in dict.fromkeys(parameters)]
    stated = {
        choice("noise", name, NOISE): positive(f"noise of {name}", value) for name, value in (noise or {}).items()
    }
    if not names:
        raise InputError(f"parameters is empty; it must have at least one of {', '.join(FACTORS)}")
    if not 0 < confidence < 1:
        raise InputError(f"confidence is {confidence:g}; it must be between 0 and 1")
    expected = {name: values[:, 0] for name, values in predict(tube, [rig], log, step=solver.step).items()}
    log, doubts = believable(log, rig, expected, solver)
    names = [
        each for name in names for each in ((f"{BIAS} of {t}" for t in log.thermometers) if name == BIAS else (name,))
    ]
    problem = _Problem(tube, rig, log, solver)
    free, remarks = list(names), list(doubts)
    while True:
        x, sigma, J, errors = problem.solve(free)
        weak = int(np.argmax(errors)) if len(free) else 0
        if not len(free) or errors[weak] < solver.weak:
            break
        remarks.append(f"{free[weak]} is not determined by the log; it is held at what the file says")
        free.pop(weak)
    freedom = max(problem.count - len(free), 1)
    reach = float(scipy.special.stdtrit(freedom, 0.5 + confidence / 2))
    room = reach * errors + np.abs(problem.shift(free, x, sigma, J))
    values = dict(zip(free, zip(x, room, strict=True), strict=True))
    estimates = tuple(_estimate(name, values.get(name), solver.bias) for name in names)
    before, after = problem.before_and_after(free, x)
    for channel, read in problem.read.items():
        share = len(free) * float(read.sum()) / problem.count
        logged = log.channels[channel][read]
        residual = after[channel][read] - logged
        remarks += unexplained(
            channel, residual, stated.get(kind_of(channel)), share, step_of(logged), rare=solver.rare
        )
    return RigFit(problem.rig(free, x), estimates, confidence, sigma, before, after, log, tuple(remarks))


def _estimate(name: str, value: tuple[float, float] | None, bias: float) -> Estimate:
    if value is None:
        return Estimate(name, *((0.0, -math.inf) if name.startswith(BIAS) else (1.0, 0.0)), math.inf, True)
    x, room = value
    if name.startswith(BIAS):
        return Estimate(name, bias * x, bias * (x - room), bias * (x + room), False)
    return Estimate(name, float(np.exp(x)), float(np.exp(x - room)), float(np.exp(x + room)), False)


@dataclass(frozen=True, eq=False)
class _Factors:
    """Logarithms x of factors, and biases over their size."""

    x: Array

    def moved(self, step: Array) -> _Factors:
        """After a step."""
        return _Factors(self.x + step)


class _Logged:
    """The readings of a log by named factors: what `descend` fits."""

    freedoms = 0

    def __init__(self, problem: _Problem, names: Sequence[str], start: Array) -> None:
        self.start, self._problem, self._names = _Factors(start), problem, names
        self.bounds = FARTHEST * np.array([-np.ones(len(start)), np.ones(len(start))])

    def residuals(self, state: _Factors) -> Array:
        """(N, 1) model less log."""
        return np.vstack([*self._problem.differences(self._names, state.x[None]).values()])

    def jacobian(self, state: _Factors) -> Array:
        """(N, 1, P) by the factors."""
        return self._problem.quotients(self._problem.perturbed(self._names, state.x))[:, None]

    def costly(self, state: _Factors) -> bool:
        """All perturbed rigs are simulated at once."""
        return False


class _Problem:
    """Residuals of a log over logarithms of factors."""

    def __init__(self, tube: Tube, rig: Rig, log: HeatingLog, solver: RigSolver) -> None:
        self.tube, self.given, self.log, self.solver = tube, rig, log, solver
        self.read = {name: np.isfinite(values) for name, values in log.channels.items()}
        self.count = int(sum(read.sum() for read in self.read.values()))

    def rig(self, names: Sequence[str], x: Array) -> Rig:
        """The rig with its factors exp(x)."""
        rig = self.given
        if "gap" in names:
            rig = replace(rig, mold=replace(rig.mold, gap=gap_of(self.tube, rig)))
        for name, value in zip(names, x, strict=True):
            if name in FACTORS:
                rig = FACTORS[name](rig, float(np.exp(value)))
        return rig

    def _predicted(self, rigs: Sequence[Rig], grid: Resolution = FINE) -> dict[str, Array]:
        return predict(self.tube, rigs, self.log, grid, step=self.solver.step)

    def biases(self, names: Sequence[str], x: Array) -> dict[str, float]:
        """What each thermometer shows too much, K."""
        start = f"{BIAS} of "
        found = zip(names, x, strict=True)
        return {name.removeprefix(start): self.solver.bias * float(v) for name, v in found if name.startswith(start)}

    def before_and_after(self, names: Sequence[str], x: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        """(T,) channels as the rig's file predicts them, and as at x."""
        seen = self._predicted([self.given, self.rig(names, x)])
        before, after = ({c: seen[c][:, side] for c in self.log.channels} for side in (0, 1))
        return before, after | {c: after[c] + off for c, off in self.biases(names, x).items()}

    def differences(self, names: Sequence[str], rows: Array) -> dict[str, Array]:
        """(T, B) model less log of every channel, at rows x (B, P)."""
        seen = self._predicted([self.rig(names, at) for at in rows])
        for k, at in enumerate(rows):
            for channel, off in self.biases(names, at).items():
                seen[channel][:, k] += off
        return {c: seen[c][read] - self.log.channels[c][read][:, None] for c, read in self.read.items()}

    def perturbed(self, names: Sequence[str], x: Array) -> dict[str, Array]:
        """(T, 1 + P) the same at x and with each unknown perturbed."""
        return self.differences(names, x + self.solver.perturbation * np.vstack([np.zeros(len(x)), np.eye(len(x))]))

    def quotients(self, now: dict[str, Array]) -> Array:
        """(N, P) derivatives by the unknowns, of what is `perturbed`."""
        return np.vstack([(d[:, 1:] - d[:, :1]) / self.solver.perturbation for d in now.values()])

    def spread(self, sigma: dict[str, float]) -> Array:
        """(N,) noise of every reading."""
        return np.concatenate([np.full(int(read.sum()), sigma[c]) for c, read in self.read.items()])

    def solve(self, names: Sequence[str]) -> tuple[Array, dict[str, float], Array, Array]:
        """Logarithms of the factors, noise of the channels, Jacobian of the residuals, and standard errors."""
        x = np.zeros(len(names))
        sigma = {c: NOISE[kind_of(c)] for c in self.read}
        for _ in range(2):
            if names:
                x = self._fit(names, x, sigma)
            now = self.perturbed(names, x)
            # Each channel pays for its share of the unknowns.
            share = len(names) / self.count
            sigma = {
                c: max(float(np.sqrt((d[:, 0] ** 2).sum() / max(len(d) * (1 - share), 1.0))), LEAST_NOISE[kind_of(c)])
                for c, d in now.items()
            }
        J = self.quotients(now) / self.spread(sigma)[:, None]
        values, vectors = np.linalg.eigh(J.T @ J)
        floor = 1e-12 * max(float(values.max(initial=0.0)), 1e-12)
        errors = np.sqrt((vectors**2 / np.maximum(values, floor)).sum(1))
        return x, sigma, J, errors

    def shift(self, names: Sequence[str], x: Array, sigma: dict[str, float], J: Array) -> Array:
        """By how much the grid's own error moves the logarithms: grids are of second order, so that it is a third of
        the difference from one of half as many cells."""
        rig = [self.rig(names, x)]
        fine, coarse = (self._predicted(rig, grid) for grid in (FINE, COARSE))
        error = np.concatenate([(fine[c] - coarse[c])[read, 0] / 3 / sigma[c] for c, read in self.read.items()])
        return np.asarray(np.linalg.lstsq(J, error, rcond=None)[0])

    def _fit(self, names: Sequence[str], x: Array, sigma: dict[str, float]) -> Array:
        weights = Weights(self.spread(sigma), np.ones(self.count), np.full(len(x), np.inf))
        return descend(_Logged(self, names, x), weights, _Factors(x), solver=STEPS).state.x
