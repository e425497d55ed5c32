"""Calibration of a rig from a logged heating: nonlinear least squares with confidence intervals.

    minimise  sum over channels c and rows k of ((model_c(x, t_k) - logged_c(t_k)) / sigma_c)^2

over factors x on loss, uniform gap of the groove, contact resistance, resistivity and battery resistance, as many as
the log determines. Factors are fitted as logarithms, so that they stay positive; the Jacobian comes from simulating all
perturbed rigs at once. The noise of every channel is estimated from its own residuals. Intervals are those of the
noise, plus the error of the model's own grid.

A thermometer with a constant reading on a heated tube is broken; one that stays at its greatest reading is saturated;
one that does not begin at ambient temperature is shifted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy

from ...constants import ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError, choice, finite, positive, without_unit_warnings
from ...physics.heat import LEAD, Resolution
from ...robots.tubes import Tube
from ...solvers.robust_least_squares import LeastSquaresSolver, Weights, descend
from ...typing import Array
from .rig import COUNTS, Rig
from .sensors import lagged_reading, tube_temperature
from .simulation import State, advance, at_rest, circuit_state
from .thermal import COARSE, FINE, stack, thermal_model, uniform_gap_of

# --- logged heatings --------------------------------------------------------------------------------------------------


# Two equal greatest readings are common where a converter has steps of 0.25 K.
FLAT = 3
"""Number of consecutive readings at the greatest value of a channel that is more than chance."""

# Below it a slow thermometer, or one at a cold end, need not move.
HEATED = 30.0
"""Smallest predicted rise of a thermometer that is judged broken or saturated, K."""

# Twice the standard limit of error of type K near room temperature, 2.2 K (ASTM E230).
SHIFTED = 5.0
"""Difference of a thermometer from the ambient temperature before heating that gets a remark, K."""

# Two tests on some ten channels: one false alarm in 500 logs; `test_false_alarms_are_rare` counts them.
RARE = 1e-4
"""Probability below which a deviation is not explained by noise."""

NOISE = {"temperature": 5.0, "voltage": 0.05, "current": 0.5}
"""Initial noise of the channels, K, V, A."""

MIN_NOISE = {"temperature": 0.05, "voltage": 1e-3, "current": 1e-2}
"""Smallest noise of the channels, K, V, A: no instrument is better."""

POSSIBLE = {
    "temperature": (ZERO_CELSIUS - 60.0, ZERO_CELSIUS + 2500.0),
    "voltage": (-1.0, 150.0),
    "current": (-50.0, 5000.0),
}
"""Possible readings of thermometers, voltage and current of such a rig, K, V, A."""

UNITS = {"temperature": "K", "voltage": "V", "current": "A"}


@dataclass(frozen=True, eq=False)
class HeatingLog:
    """Logged heating of T rows; NaN for missing readings.

    Raises:
        InputError: fewer than 3 rows, times that do not increase, duties out of range, or no readings.
    """

    time: Array
    """(T,) times, s, increasing."""
    duty: Array
    """(T,) counts 0-255, constant from each row to the next."""
    temperature: Array | None = None
    """(T,) temperatures of the tube, K; (T, S) of several thermometers, or of the pixels of a camera."""
    voltage: Array | None = None
    """(T,) battery voltage while the MOSFET conducts, V."""
    current: Array | None = None
    """(T,) battery current while the MOSFET conducts, A."""
    position: float | Sequence[float] | Array = 0.0
    """Position of the thermometer from the middle of the curved part, m; (S,) for several."""
    lag: float | Array = 0.0
    """Time constant of the thermometer, s; (S,) for several different ones."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is not None and f.name not in ("position", "lag"):
                object.__setattr__(self, f.name, _column(f.name, value))
        count = len(self.time)
        if count < 3:
            raise InputError(f"the log has {count} rows; it must have at least 3")
        for name in ("duty", *NOISE):
            value = getattr(self, name)
            if value is not None and value.shape[:1] != (count,):
                raise InputError(
                    f"{name} of the log has shape {value.shape}; it must have {count} numbers, one per time"
                )
        if not (np.diff(self.time) > 0).all():
            raise InputError("time of the log must increase from row to row")
        for name, (low, high) in POSSIBLE.items():
            values = getattr(self, name)
            if values is not None and np.isfinite(values).any():
                extremes = float(np.nanmin(values)), float(np.nanmax(values))
                if extremes[0] < low or extremes[1] > high:
                    zero, sign = (ZERO_CELSIUS, "degC") if name == "temperature" else (0.0, UNITS[name])
                    raise InputError(
                        f"{name} of the log is {extremes[0] - zero:g} to {extremes[1] - zero:g} {sign}; it must be "
                        f"{low - zero:g} to {high - zero:g} {sign}"
                    )
        if not ((self.duty >= 0) & (self.duty <= COUNTS)).all():
            raise InputError("duty of the log must be from 0 to 255")
        positions = np.abs([finite("position", x) for x in np.atleast_1d(np.asarray(self.position, dtype=float))])
        sensors = 1 if self.temperature is None or self.temperature.ndim == 1 else self.temperature.shape[1]
        if len(positions) != sensors:
            raise InputError(
                f"position of the log has {len(positions)} numbers; it must have {sensors}, one per thermometer"
            )
        lags = np.asarray(self.lag, dtype=float)
        if lags.shape not in ((), (sensors,)) or not (np.isfinite(lags) & (lags >= 0)).all():
            raise InputError(
                f"lag of the log is {self.lag}; it must be at least 0 s, one number or one per thermometer"
            )
        object.__setattr__(self, "position", float(positions[0]) if sensors == 1 else positions)
        if not any(np.isfinite(values).any() for values in self.channels.values()):
            raise InputError("the log has neither temperature nor voltage nor current; it must have one of them")

    @property
    def positions(self) -> Array:
        """(S,) distances of the thermometers from the middle of the curved part, m."""
        return np.atleast_1d(np.asarray(self.position, dtype=float))

    @property
    def thermometers(self) -> tuple[str, ...]:
        """Names of the temperature channels; with positions if there are several."""
        if len(self.positions) == 1:
            return ("temperature",)
        return tuple(f"temperature {k} at {1e3 * x:g} mm" for k, x in enumerate(self.positions, start=1))

    @property
    def channels(self) -> dict[str, Array]:
        """Measured channels (T,) by name."""
        temperatures: dict[str, Array] = {}
        if self.temperature is not None:
            columns = self.temperature.reshape(len(self.time), -1).T
            temperatures = dict(zip(self.thermometers, columns, strict=True))
        return temperatures | {
            name: getattr(self, name) for name in ("voltage", "current") if getattr(self, name) is not None
        }

    def with_camera(self, time: Array, positions: Array, temperature: Array) -> HeatingLog:
        """Copy with the readings of a camera: temperatures (C, P), K, at its own times (C,) and positions (P,), m.

        Duties are those of this log. The camera has no lag.

        Raises:
            InputError: as of the class, or a camera without readings during the log.
        """
        inside = (time >= self.time[0]) & (time <= self.time[-1])
        if not inside.any():
            raise InputError(
                f"the camera saw the tube from {time.min():g} to {time.max():g} s; the log goes from {self.time[0]:g} "
                f"to {self.time[-1]:g} s"
            )
        # Two clocks: rows at all times of either, with no reading where the other has none.
        times = np.union1d(self.time, time[inside])

        def spread(at: Array, values: Array) -> Array:
            table = np.full((len(times), *values.shape[1:]), np.nan)
            table[np.searchsorted(times, at)] = values
            return table

        channels = self.channels
        electrics = {name: spread(self.time, channels[name]) for name in ("voltage", "current") if name in channels}
        contacts = []
        if self.temperature is not None:
            contacts.append(spread(self.time, self.temperature.reshape(len(self.time), -1)))
        contact_positions = self.positions if contacts else np.zeros(0)
        return HeatingLog(
            times,
            self.duty[np.searchsorted(self.time, times, side="right") - 1],
            temperature=np.hstack([*contacts, spread(time[inside], temperature[inside])]),
            position=np.concatenate([contact_positions, positions]),
            lag=np.concatenate([np.broadcast_to(self.lag, len(contact_positions)), np.zeros(len(positions))]),
            **electrics,
        )

    def with_temperatures(self, channels: dict[str, Array]) -> HeatingLog:
        """Copy with other temperature readings."""
        columns = [channels[name] for name in self.thermometers]
        table = columns[0] if len(columns) == 1 else np.column_stack(columns)
        return replace(self, temperature=table)


def _column(name: str, value: Any) -> Array:
    try:
        column = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} of the log is {value!r}; it must be a list of numbers") from None
    if column.ndim != 1 and not (name == "temperature" and column.ndim == 2):
        raise InputError(f"{name} of the log has shape {column.shape}; it must be one number per row")
    return column


def kind_of(channel: str) -> str:
    """Kind of a channel: "temperature", "voltage" or "current"."""
    return channel.split()[0]


def without_saturated(log: HeatingLog, rig: Rig, expected: dict[str, Array]) -> tuple[HeatingLog, tuple[str, ...]]:
    """Log without readings of saturated thermometers, and remarks on its thermometers.

    Args:
        expected: channels (T,) as the rig's file predicts them.

    Raises:
        InputError: a thermometer that is broken.
    """
    if log.temperature is None:
        return log, ()
    channels, remarks = dict(log.channels), []
    for name in log.thermometers:
        read = np.flatnonzero(np.isfinite(channels[name]))
        if len(read) < 2 * FLAT:
            continue
        values, rise = channels[name][read], float(np.ptp(expected[name][read]))
        if rise > HEATED and np.ptp(values) == 0:
            raise InputError(
                f"{name} of the log is {values[0] - ZERO_CELSIUS:.1f} degC in all "
                f"{len(values)} readings; the rig file predicts a rise of {rise:.0f} K: the "
                "thermometer is broken; leave it out"
            )
        top = np.flatnonzero(values == values.max())
        # Saturated readings are equal and follow one another; a true maximum varies by noise.
        constant = len(top) >= FLAT and len(top) == top[-1] - top[0] + 1
        if constant and float(np.ptp(expected[name][read[top]])) > 0.2 * HEATED and rise > HEATED:
            channels[name] = channels[name].copy()
            channels[name][read[top]] = np.nan
            remarks.append(
                f"{name} stays at {values.max() - ZERO_CELSIUS:.1f} degC for {len(top)} readings, as a saturated "
                "thermometer does: they are left out"
            )
        shift = float(values[0] - rig.ambient)
        if log.time[read[0]] == log.time[0] and abs(shift) > SHIFTED:
            remarks.append(
                f"{name} begins {abs(shift):.1f} K {'above' if shift > 0 else 'below'} the rig's ambient temperature: "
                "the thermometer is shifted, or the tube was not cold; fit bias estimates the shift"
            )
    return log.with_temperatures(channels), tuple(remarks)


def resolution_of(values: Array) -> float:
    """Resolution of an instrument: smallest difference between unequal readings (N,); 0 if all are equal."""
    differences = np.diff(np.unique(values))
    return float(differences.min()) if len(differences) else 0.0


def unexplained(
    channel: str,
    residual: Array,
    stated: float | None,
    unknowns: float,
    resolution: float = 0.0,
) -> tuple[str, ...]:
    """Remarks on residuals (N,), in time, that the model does not explain: larger than the noise, or in long waves.

    The first by the chi-square test, the second by the number of runs of one sign (Wald and Wolfowitz).

    Args:
        stated: noise of the channel, if known.
        unknowns: number of unknowns that were fitted to this channel.
        resolution: of the readings; rounding of a slow change makes waves within half of it.
    """
    remarks, unit = [], UNITS[kind_of(channel)]
    count = len(residual)
    freedom = max(count - unknowns, 1.0)
    sigma = float(np.sqrt((residual**2).sum() / freedom))
    if stated is not None and scipy.stats.chi2.sf((residual**2).sum() / stated**2, freedom) < RARE:
        remarks.append(
            f"residuals of {channel} are {sigma:.3g} {unit}, {sigma / stated:.1f} times the stated noise of "
            f"{stated:g} {unit}: the model does not explain the log, and intervals are too narrow"
        )
    signs = residual > 0
    above, below = int(signs.sum()), int((~signs).sum())
    if min(above, below) >= 5 and sigma > resolution / 2:
        runs = 1 + int((signs[1:] != signs[:-1]).sum())
        # Mean and variance of the number of runs of independent signs.
        mean = 1 + 2 * above * below / count
        deviation = np.sqrt((mean - 1) * (mean - 2) / (count - 1))
        if scipy.stats.norm.cdf((runs - mean) / deviation) < RARE:
            remarks.append(
                f"residuals of {channel} change sign {runs - 1} times in {count} readings, noise would {mean - 1:.0f} "
                "times: the model misses something, and intervals are too narrow"
            )
    return tuple(remarks)


# --- the fit ----------------------------------------------------------------------------------------------------------


# Twice the step of a plan's simulation (`simulation.STEP`): a fit simulates all perturbed rigs several times.
STEP = 0.5
"""Longest step of the simulation of a log, s."""

# One-sided differences: half of it times the curvature is their error, and round-off takes three of 15 digits.
PERTURBATION = 1e-3
"""Step of the logarithm of a factor in finite differences."""

BIAS_SCALE = 25.0
"""Scale of the bias of a thermometer as an unknown, K: it counts as much as a factor of e."""

# A factor known to exp(0.4), 50 %, is less certain than the file of a rig.
WEAK = 0.4
"""Standard error of a factor's logarithm above which the log does not determine it, and it is fixed."""

BIAS = "bias"
"""Parameter name for the bias of every thermometer, K."""


def _scaled(part: str, name: str) -> Callable[[Rig, float], Rig]:
    """Function (rig, factor) -> rig with one field of one of its parts multiplied by the factor."""

    @without_unit_warnings()
    def scale(rig: Rig, factor: float) -> Rig:
        old: Any = getattr(rig, part)
        return replace(rig, **{part: replace(old, **{name: getattr(old, name) * factor})})

    return scale


MAX_LOGARITHM = 2.5
"""Largest logarithm of a factor: 12 times the value of the file."""

# The error of the grid is much larger than that of the last step.
SOLVER = LeastSquaresSolver(iterations=25, settled=1e-6)

FACTORS: dict[str, Callable[[Rig, float], Rig]] = {
    "loss": lambda rig, factor: replace(rig, loss_factor=rig.loss_factor * factor),
    "gap": _scaled("mold", "gap"),
    "contact_resistance": _scaled("circuit", "contact_resistance"),
    "resistivity": lambda rig, factor: replace(rig, resistivity_factor=rig.resistivity_factor * factor),
    "internal_resistance": _scaled("battery", "internal_resistance"),
    "clamps": _scaled("clamps", "contact_conductance"),
}
"""Parameters that can be fitted, as functions (rig, factor) -> rig. The conductance into the clamps ("clamps") needs
thermometers along the tube."""


@dataclass(frozen=True)
class Estimate:
    """Fitted factor on a value of the rig's file, with its interval; 1 with an infinite interval if undetermined.

    A bias of a thermometer is no factor but an error in K; 0 if undetermined.
    """

    name: Annotated[str, "name of the parameter"]
    factor: Annotated[float, "factor on the value of the rig file; bias in K"]
    low: Annotated[float, "lower end of its interval"]
    high: Annotated[float, "upper end of its interval"]
    held: Annotated[bool, "true if it was fixed because the log does not determine it"]


@dataclass(frozen=True, eq=False)
class RigFit(Displayed):
    """Rig calibrated to a log."""

    rig: Rig
    """Rig with the factors applied."""
    estimates: Annotated[tuple[Estimate, ...], "the fitted parameters"]
    confidence: Annotated[float, "confidence of the intervals"]
    noise: Annotated[dict[str, float], "RMS residuals: temperature in K, voltage in V, current in A"]
    before: dict[str, Array]
    """(T,) channels that the given rig predicts."""
    after: dict[str, Array]
    """(T,) channels that the fitted rig predicts, with biases."""
    log: HeatingLog
    """Log without readings of saturated thermometers."""
    remarks: Annotated[tuple[str, ...], "remarks on the fit"]


def predict(tube: Tube, rigs: Sequence[Rig], log: HeatingLog, grid: Resolution = FINE) -> dict[str, Array]:
    """(T, B) channels of a log as each rig predicts them, simulated in steps of at most `STEP`, s."""
    model = stack([thermal_model(tube, rig, grid) for rig in rigs])
    if (off := float(log.positions.max())) >= model.half_length:
        raise InputError(
            f"position of a thermometer is {off * 1e3:g} mm from the middle of the tube; it must be less than "
            f"{model.half_length * 1e3:.4g} mm, where the tube ends"
        )
    # A thermometer outside the mold counts as at its edge.
    farthest = model.half_length - float(model.position[model.zone == LEAD][0])
    positions = np.minimum(log.positions, farthest)

    def at_thermometers(state: State) -> Array:
        return tube_temperature(model, state, positions).T + ZERO_CELSIUS

    def channels(state: State, reading: Array) -> Array:
        circuit = circuit_state(model, state.cells[:, :, 0], state.lumped)
        return np.vstack([reading, circuit.V_terminal, circuit.I_on])

    state = at_rest(model)
    lags = np.broadcast_to(log.lag, len(log.positions))[:, None]
    target = reading = at_thermometers(state)
    rows = [channels(state, reading)]
    for duty, span in zip(log.duty.tolist(), np.diff(log.time).tolist(), strict=False):
        steps = math.ceil(span / STEP)
        for _ in range(steps):
            state = advance(model, state, duty / COUNTS, span / steps, 1)
            before, target = target, at_thermometers(state)
            reading = lagged_reading(lags, reading, before, target, span / steps)
        rows.append(channels(state, reading))
    return dict(zip((*log.thermometers, "voltage", "current"), np.array(rows).swapaxes(0, 1), strict=True))


def calibrate(
    tube: Tube,
    rig: Rig,
    log: HeatingLog,
    parameters: Sequence[str] = ("loss", "gap", "contact_resistance", "resistivity"),
    *,
    noise: Mapping[str, float] | None = None,
    confidence: float = 0.95,
) -> RigFit:
    """Fit a rig to a log with any subset of temperature, voltage and current.

    Factors that the log does not determine are fixed at 1 and reported, weakest first, until all others are determined.
    Residuals that exceed the stated noise, or come in waves, are reported.

    Args:
        parameters: names of FACTORS, and "bias" for that of every thermometer.
        noise: stated standard deviations by "temperature", "voltage", "current", K, V, A.

    Raises:
        InputError: an unknown factor, none, a confidence outside of (0, 1), or a thermometer that is broken.
    """
    names = [choice("parameter", name, (*FACTORS, BIAS)) for name in dict.fromkeys(parameters)]
    stated = {
        choice("noise", name, NOISE): positive(f"noise of {name}", value) for name, value in (noise or {}).items()
    }
    if not names:
        raise InputError(f"parameters is empty; it must have at least one of {', '.join(FACTORS)}")
    if not 0 < confidence < 1:
        raise InputError(f"confidence is {confidence:g}; it must be between 0 and 1")
    expected = {name: values[:, 0] for name, values in predict(tube, [rig], log).items()}
    log, sensor_remarks = without_saturated(log, rig, expected)
    biases = [f"{BIAS} of {thermometer}" for thermometer in log.thermometers]
    names = [each for name in names for each in (biases if name == BIAS else (name,))]
    problem = _Problem(tube, rig, log)
    free, remarks = list(names), list(sensor_remarks)
    while True:
        # The weakest factor first: fixing it often determines others that were correlated with it.
        x, sigma, J, errors = problem.solve(free)
        weakest = int(np.argmax(errors)) if len(free) else 0
        if not len(free) or errors[weakest] < WEAK:
            break
        remarks.append(f"{free[weakest]} is not determined by the log; it keeps the value of the file")
        free.pop(weakest)
    freedom = max(problem.count - len(free), 1)
    quantile = float(scipy.special.stdtrit(freedom, 0.5 + confidence / 2))
    # Noise of the readings and the error of the grid add up in the worst case.
    half_width = quantile * errors + np.abs(problem.grid_error(free, x, sigma, J))
    fitted = dict(zip(free, zip(x, half_width, strict=True), strict=True))
    estimates = tuple(_estimate(name, fitted.get(name)) for name in names)
    predicted = predict(tube, [rig, problem.rig(free, x)], log)
    before, after = ({c: predicted[c][:, side] for c in log.channels} for side in (0, 1))
    after |= {c: after[c] + bias for c, bias in problem.biases(free, x).items()}
    for channel, read in problem.read.items():
        unknowns = len(free) * float(read.sum()) / problem.count
        logged = log.channels[channel][read]
        residual = after[channel][read] - logged
        remarks += unexplained(channel, residual, stated.get(kind_of(channel)), unknowns, resolution_of(logged))
    return RigFit(problem.rig(free, x), estimates, confidence, sigma, before, after, log, tuple(remarks))


def _estimate(name: str, fitted: tuple[float, float] | None) -> Estimate:
    """Estimate from the unknown and the half-width of its interval; None if it was fixed."""
    if fitted is None:
        return Estimate(name, *((0.0, -math.inf) if name.startswith(BIAS) else (1.0, 0.0)), math.inf, True)
    x, half_width = fitted
    if name.startswith(BIAS):
        low, high = BIAS_SCALE * (x - half_width), BIAS_SCALE * (x + half_width)
        return Estimate(name, BIAS_SCALE * x, low, high, False)
    return Estimate(name, float(np.exp(x)), float(np.exp(x - half_width)), float(np.exp(x + half_width)), False)


@dataclass(frozen=True, eq=False)
class _Factors:
    """Logarithms x of factors, and biases over their scale."""

    x: Array

    def moved(self, step: Array) -> _Factors:
        """Factors after a step."""
        return _Factors(self.x + step)


class _Logged:
    """Least-squares problem of the readings of a log, in the form of `descend`."""

    freedoms = 0

    def __init__(self, problem: _Problem, names: Sequence[str], start: Array) -> None:
        self.start, self._problem, self._names = _Factors(start), problem, names
        self.bounds = MAX_LOGARITHM * np.array([-np.ones(len(start)), np.ones(len(start))])

    def residuals(self, state: _Factors) -> Array:
        """(N, 1) model less log."""
        return np.vstack([*self._problem.differences(self._names, state.x[None]).values()])

    def jacobian(self, state: _Factors) -> Array:
        """(N, 1, P) derivatives of the residuals by the factors."""
        return self._problem.quotients(self._problem.perturbed(self._names, state.x))[:, None]

    def costly(self, state: _Factors) -> bool:
        """False: all perturbed rigs are simulated at once."""
        return False


class _Fitted(NamedTuple):
    """Solution of a calibration."""

    x: Array
    """(P,) logarithms of the factors, and biases over `BIAS_SCALE`."""
    noise: dict[str, float]
    """Noise of the channels, K, V, A."""
    jacobian: Array
    """(N, P) derivatives of the residuals over the noise."""
    errors: Array
    """(P,) standard errors of the logarithms and scaled biases `x`."""


class _Problem:
    """Residuals of a log as functions of logarithms of factors."""

    def __init__(self, tube: Tube, rig: Rig, log: HeatingLog) -> None:
        self.tube, self.nominal, self.log = tube, rig, log
        self.read = {name: np.isfinite(values) for name, values in log.channels.items()}
        self.count = int(sum(read.sum() for read in self.read.values()))

    def rig(self, names: Sequence[str], x: Array) -> Rig:
        """Rig with its factors exp(x)."""
        rig = self.nominal
        # A gap that follows from the groove is set first, so that a factor has something to act on.
        if "gap" in names:
            rig = replace(rig, mold=replace(rig.mold, gap=uniform_gap_of(self.tube, rig)))
        for name, value in zip(names, x, strict=True):
            if name in FACTORS:
                rig = FACTORS[name](rig, float(np.exp(value)))
        return rig

    def biases(self, names: Sequence[str], x: Array) -> dict[str, float]:
        """Bias of each thermometer, K."""
        prefix = f"{BIAS} of "
        unknowns = zip(names, x, strict=True)
        return {
            name.removeprefix(prefix): BIAS_SCALE * float(value) for name, value in unknowns if name.startswith(prefix)
        }

    def differences(self, names: Sequence[str], rows: Array) -> dict[str, Array]:
        """(T, B) model less log of every channel, at rows x (B, P)."""
        predicted = predict(self.tube, [self.rig(names, x) for x in rows], self.log)
        for k, x in enumerate(rows):
            for channel, bias in self.biases(names, x).items():
                predicted[channel][:, k] += bias
        return {c: predicted[c][read] - self.log.channels[c][read][:, None] for c, read in self.read.items()}

    def perturbed(self, names: Sequence[str], x: Array) -> dict[str, Array]:
        """(T, 1 + P) `differences` at x and with each unknown perturbed."""
        return self.differences(names, x + PERTURBATION * np.vstack([np.zeros(len(x)), np.eye(len(x))]))

    def quotients(self, perturbed: dict[str, Array]) -> Array:
        """(N, P) derivatives of the residuals by the unknowns, as difference quotients."""
        return np.vstack([(d[:, 1:] - d[:, :1]) / PERTURBATION for d in perturbed.values()])

    def noise(self, sigma: dict[str, float]) -> Array:
        """(N,) noise of every reading."""
        return np.concatenate([np.full(int(read.sum()), sigma[c]) for c, read in self.read.items()])

    def solve(self, names: Sequence[str]) -> _Fitted:
        """Fit the factors and the noise of the channels."""
        x = np.zeros(len(names))
        sigma = {c: NOISE[kind_of(c)] for c in self.read}
        # Weights need the noise and the noise needs the fit: a second round with the first one's noise.
        for _ in range(2):
            if names:
                weights = Weights(self.noise(sigma), np.ones(self.count), np.full(len(x), np.inf))
                x = descend(_Logged(self, names, x), weights, _Factors(x), solver=SOLVER).state.x
            perturbed = self.perturbed(names, x)
            # Each channel loses its part of the degrees of freedom.
            part = len(names) / self.count
            sigma = {
                c: max(float(np.sqrt((d[:, 0] ** 2).sum() / max(len(d) * (1 - part), 1.0))), MIN_NOISE[kind_of(c)])
                for c, d in perturbed.items()
            }
        J = self.quotients(perturbed) / self.noise(sigma)[:, None]
        values, vectors = np.linalg.eigh(J.T @ J)
        # A direction that no reading determines has a huge error instead of a division by 0.
        floor = 1e-12 * max(float(values.max(initial=0.0)), 1e-12)
        errors = np.sqrt((vectors**2 / np.maximum(values, floor)).sum(1))
        return _Fitted(x, sigma, J, errors)

    def grid_error(self, names: Sequence[str], x: Array, sigma: dict[str, float], J: Array) -> Array:
        """(P,) errors of the unknowns by the error of the grid, by Richardson extrapolation."""
        rig = [self.rig(names, x)]
        fine, coarse = (predict(self.tube, rig, self.log, grid) for grid in (FINE, COARSE))
        # Order 2 on half as many cells: the coarse error is 4 times the fine one, their difference 3 times.
        error = np.concatenate([(fine[c] - coarse[c])[read, 0] / 3 / sigma[c] for c, read in self.read.items()])
        return np.asarray(np.linalg.lstsq(J, error, rcond=None)[0])
