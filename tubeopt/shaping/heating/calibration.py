"""What a rig really is, from a logged heating: nonlinear least squares with intervals.

    minimise  sum over channels c and rows k of ((model_c(x, t_k) - logged_c(t_k)) / sigma_c)^2

over factors x on loss, even gap of the groove, contact resistance, resistivity and battery resistance, as many as the
log determines. Factors are fitted as logarithms, so that they stay positive; the Jacobian comes from simulating all
perturbed rigs at once. The noise of every channel is estimated from its own residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy

from ...display import Displayed
from ...errors import InputError, choice, finite
from ...physics.heat import LEAD, Resolution
from ...robots.tubes import Tube
from ...typing import Array
from .rates import State, at_rest, current
from .rig import COUNTS, Rig
from .simulation import advance
from .thermal import ThermalModel, stack, thermal_model, with_gap

GRID = Resolution(3, 5, 9, 11, 16)
STEP = 0.5
"""Longest time step of the simulation, s."""

PERTURBATION = 1e-3
NOISE = {"temperature": 5.0, "voltage": 0.05, "current": 0.5}
"""Noise of the channels to begin with, K, V, A."""

LEAST_NOISE = {"temperature": 0.05, "voltage": 1e-3, "current": 1e-2}
"""No instrument is better."""

WEAK = 0.4
"""A factor known to less than this standard error of its logarithm is held: the log does not determine it."""


def _scaled(part: str, name: str) -> Callable[[Rig, float], Rig]:
    def change(rig: Rig, factor: float) -> Rig:
        piece: Any = getattr(rig, part)
        return replace(rig, **{part: replace(piece, **{name: getattr(piece, name) * factor})})

    return change


FACTORS: dict[str, Callable[[Rig, float], Rig]] = {
    "loss": lambda rig, factor: replace(rig, loss_factor=rig.loss_factor * factor),
    "gap": _scaled("mold", "gap"),
    "contact_resistance": _scaled("circuit", "contact_resistance"),
    "resistivity": lambda rig, factor: replace(rig, resistivity_factor=rig.resistivity_factor * factor),
    "internal_resistance": _scaled("battery", "internal_resistance"),
}
"""What can be fitted: loss, the groove's even gap, resistance of the clamps' contacts, resistivity, the battery's."""


@dataclass(frozen=True, eq=False)
class HeatingLog:
    """A logged heating, (T,) each; NaN where nothing was read.

    Attributes:
        time: s, increasing. duty: counts 0-255, held from each row to the next.
        temperature: of the tube, K. voltage, current: at the battery while the MOSFET conducts, V and A.
        position: of the thermometer from the middle of the curved part, m.

    Raises:
        InputError: fewer than 3 rows, times that do not increase, duties out of range, or nothing that was measured.
    """

    time: Array
    duty: Array
    temperature: Array | None = None
    voltage: Array | None = None
    current: Array | None = None
    position: float = 0.0

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is not None and f.name != "position":
                object.__setattr__(self, f.name, _column(f.name, value))
        object.__setattr__(self, "position", abs(finite("position", self.position)))
        count = len(self.time)
        if count < 3:
            raise InputError(f"the log has {count} rows; it must have at least 3")
        for name in ("duty", *NOISE):
            value = getattr(self, name)
            if value is not None and value.shape != (count,):
                raise InputError(
                    f"{name} of the log has shape {value.shape}; it must have {count} numbers, one per time"
                )
        if not (np.diff(self.time) > 0).all():
            raise InputError("time of the log must increase from row to row")
        if not ((self.duty >= 0) & (self.duty <= COUNTS)).all():
            raise InputError("duty of the log must be from 0 to 255")
        if not any(np.isfinite(values).any() for values in self.channels.values()):
            raise InputError("the log holds neither temperature nor voltage nor current; it must hold one of them")

    @property
    def channels(self) -> dict[str, Array]:
        """The measured channels by name."""
        return {name: getattr(self, name) for name in NOISE if getattr(self, name) is not None}


def _column(name: str, value: Any) -> Array:
    try:
        column = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} of the log is {value!r}; it must be a list of numbers") from None
    if column.ndim != 1:
        raise InputError(f"{name} of the log has shape {column.shape}; it must be one number per row")
    return column


@dataclass(frozen=True)
class Estimate:
    """A fitted factor on what the rig's file says, and its interval; held at 1, and infinite, where undetermined."""

    name: str
    factor: float
    low: float
    high: float
    held: bool


@dataclass(frozen=True, eq=False)
class RigFit(Displayed):
    """A rig calibrated to a log.

    Attributes:
        rig: with the factors applied. estimates: one for every factor that was asked for. confidence: of the intervals.
        noise: standard deviation of the residuals of each channel, K, V, A.
        before, after: predicted channels (T,) of the rig as given and as fitted. log: what was measured.
        remarks: in words, what the log does not determine.
    """

    rig: Rig
    estimates: tuple[Estimate, ...]
    confidence: float
    noise: dict[str, float]
    before: dict[str, Array]
    after: dict[str, Array]
    log: HeatingLog
    remarks: tuple[str, ...]


def predict(tube: Tube, rigs: Sequence[Rig], log: HeatingLog) -> dict[str, Array]:
    """(T, B) what the log's channels would show on each rig."""
    model = stack([thermal_model(tube, rig, GRID) for rig in rigs])
    state = at_rest(model)
    rows: dict[str, list[Array]] = {name: [] for name in NOISE}
    for k, time in enumerate(log.time):
        if k:
            span = float(time - log.time[k - 1])
            state = advance(model, state, float(log.duty[k - 1]) / COUNTS, span, max(1, int(np.ceil(span / STEP))))
        seen = _seen(model, state, log.position)
        for name in NOISE:
            rows[name].append(seen[name])
    return {name: np.array(values) for name, values in rows.items()}


def _seen(model: ThermalModel, state: State, position: float) -> dict[str, Array]:
    tube = state.cells[:, :, 0]
    now = current(model, tube, state.lumped)
    at = max(model.half_length - position, float(model.position[model.zone == LEAD][0]))
    temperature = np.array([np.interp(at, model.position, row) for row in tube])
    return {"temperature": temperature, "voltage": now.terminal_voltage, "current": now.total}


def calibrate(
    tube: Tube,
    rig: Rig,
    log: HeatingLog,
    parameters: Sequence[str] = ("loss", "gap", "contact_resistance", "resistivity"),
    *,
    confidence: float = 0.95,
) -> RigFit:
    """The rig that explains a log, from any subset of temperature, voltage and current.

    Factors that the log does not determine are held at 1 and reported, weakest first, until the rest is determined.

    Raises:
        InputError: an unknown factor, none, or a confidence outside of (0, 1).
    """
    names = [choice("parameter", name, FACTORS) for name in dict.fromkeys(parameters)]
    if not names:
        raise InputError(f"parameters is empty; it must name some of {', '.join(FACTORS)}")
    if not 0 < confidence < 1:
        raise InputError(f"confidence is {confidence:g}; it must be between 0 and 1")
    problem = _Problem(tube, rig, log)
    free, remarks = list(names), []
    while True:
        x, sigma, errors = problem.solve(free)
        weak = int(np.argmax(errors)) if len(free) else 0
        if not len(free) or errors[weak] < WEAK:
            break
        remarks.append(f"{free[weak]} is not determined by the log; it is held at what the file says")
        free.pop(weak)
    freedom = max(problem.count - len(free), 1)
    reach = float(scipy.special.stdtrit(freedom, 0.5 + confidence / 2))
    values = dict(zip(free, zip(x, errors, strict=True), strict=True))
    estimates = tuple(_estimate(name, values.get(name), reach) for name in names)
    fitted = problem.rig(free, x)
    seen = predict(tube, [rig, fitted], log)
    before, after = ({c: seen[c][:, side] for c in log.channels} for side in (0, 1))
    return RigFit(fitted, estimates, confidence, sigma, before, after, log, tuple(remarks))


def _estimate(name: str, value: tuple[float, float] | None, reach: float) -> Estimate:
    if value is None:
        return Estimate(name, 1.0, 0.0, float("inf"), True)
    x, error = value
    return Estimate(name, float(np.exp(x)), float(np.exp(x - reach * error)), float(np.exp(x + reach * error)), False)


class _Problem:
    """Residuals of a log over logarithms of factors."""

    def __init__(self, tube: Tube, rig: Rig, log: HeatingLog) -> None:
        self.tube, self.given, self.log = tube, rig, log
        self.read = {name: np.isfinite(values) for name, values in log.channels.items()}
        self.count = int(sum(read.sum() for read in self.read.values()))

    def rig(self, names: Sequence[str], x: Array) -> Rig:
        """The rig with its factors exp(x)."""
        rig = with_gap(self.tube, self.given) if "gap" in names else self.given
        for name, value in zip(names, x, strict=True):
            rig = FACTORS[name](rig, float(np.exp(value)))
        return rig

    def differences(self, names: Sequence[str], x: Array) -> dict[str, Array]:
        """(T, 1 + P) model less log of every channel, at x and with each unknown perturbed."""
        shifted = [x, *(x + PERTURBATION * unit for unit in np.eye(len(x)))]
        seen = predict(self.tube, [self.rig(names, at) for at in shifted], self.log)
        return {c: seen[c][read] - self.log.channels[c][read][:, None] for c, read in self.read.items()}

    def solve(self, names: Sequence[str]) -> tuple[Array, dict[str, float], Array]:
        """Logarithms of the factors, noise of the channels, and standard errors."""
        x = np.zeros(len(names))
        sigma = {c: NOISE[c] for c in self.read}
        for _ in range(2):
            if names:
                x = self._fit(names, x, sigma)
            now = self.differences(names, x)
            # Each channel pays for its share of the unknowns.
            share = len(names) / self.count
            sigma = {
                c: max(float(np.sqrt((d[:, 0] ** 2).sum() / max(len(d) * (1 - share), 1.0))), LEAST_NOISE[c])
                for c, d in now.items()
            }
        J = np.vstack([(d[:, 1:] - d[:, :1]) / PERTURBATION / sigma[c] for c, d in now.items()])
        information = J.T @ J
        values, vectors = np.linalg.eigh(information) if names else (np.zeros(0), np.zeros((0, 0)))
        floor = 1e-12 * max(float(values.max(initial=0.0)), 1e-12)
        errors = np.sqrt((vectors**2 / np.maximum(values, floor)).sum(1))
        return x, sigma, errors

    def _fit(self, names: Sequence[str], x: Array, sigma: dict[str, float]) -> Array:
        cache: dict[bytes, tuple[Array, Array]] = {}

        def both(at: Array) -> tuple[Array, Array]:
            key = at.tobytes()
            if key not in cache:
                now = self.differences(names, at)
                r = np.concatenate([d[:, 0] / sigma[c] for c, d in now.items()])
                J = np.vstack([(d[:, 1:] - d[:, :1]) / PERTURBATION / sigma[c] for c, d in now.items()])
                cache[key] = r, J
            return cache[key]

        found = scipy.optimize.least_squares(
            lambda at: both(at)[0], x, jac=lambda at: both(at)[1], bounds=(-2.5, 2.5), xtol=1e-5, ftol=1e-6, max_nfev=25
        )
        return np.asarray(found.x)
