"""What a rig really is, from a logged heating: nonlinear least squares with intervals.

    minimise  sum over channels c and rows k of ((model_c(x, t_k) - logged_c(t_k)) / sigma_c)^2

over factors x on loss, even gap of the groove, contact resistance, resistivity and battery resistance, as many as the
log determines. Factors are fitted as logarithms, so that they stay positive; the Jacobian comes from simulating all
perturbed rigs at once. The noise of every channel is estimated from its own residuals. Intervals are those of the
noise, with the error of the model's own grid to spare.

A thermometer that shows the same all the time although the tube is heated is dead; one that stays at its greatest
reading is saturated there; one that does not begin where the tube does is shifted.
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
from .sensors import followed, tube_at
from .simulation import State, advance, at_rest, current
from .thermal import COARSE, FINE, ThermalModel, gap_of, stack, thermal_model

# --- logged heatings: what was measured when, and which of it can be believed -----------------------------------------


# Two equal greatest readings are common where a converter has steps of 0.25 K.
FLAT = 3
"""Readings in a row at a channel's greatest value that are more than chance."""

# Below it a slow thermometer, or one at a cold end, need not move.
HEATED = 30.0
"""Rise that the rig's file must expect of a thermometer before it is called dead or saturated, K."""

# Twice the standard limit of error of type K near room temperature, 2.2 K (ASTM E230).
SHIFTED = 5.0
"""Difference of a thermometer from the ambient temperature before heating that gets a remark, K."""

# Two tests on some ten channels: one false alarm in 500 logs; `test_false_alarms_are_rare` counts them.
RARE = 1e-4
"""Probability below which a deviation is no accident of noise."""

NOISE = {"temperature": 5.0, "voltage": 0.05, "current": 0.5}
"""Noise of the channels to begin with, K, V, A."""

LEAST_NOISE = {"temperature": 0.05, "voltage": 1e-3, "current": 1e-2}
"""No instrument is better."""

POSSIBLE = {
    "temperature": (ZERO_CELSIUS - 60.0, ZERO_CELSIUS + 2500.0),
    "voltage": (-1.0, 150.0),
    "current": (-50.0, 5000.0),
}
"""What thermometers, battery and current of such a rig can show, K, V, A."""

UNITS = {"temperature": "K", "voltage": "V", "current": "A"}


@dataclass(frozen=True, eq=False)
class HeatingLog:
    """A logged heating; NaN where nothing was read.

    Raises:
        InputError: fewer than 3 rows, times that do not increase, duties out of range, or nothing that was measured.
    """

    time: Array
    """(T,) times, s, increasing."""
    duty: Array
    """(T,) counts 0-255, held from each row to the next."""
    temperature: Array | None = None
    """(T,) of the tube, K; (T, S) of several thermometers, or of the pixels of a camera."""
    voltage: Array | None = None
    """(T,) at the battery while the MOSFET conducts, V."""
    current: Array | None = None
    """(T,) from the battery while the MOSFET conducts, A."""
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
        places = np.abs([finite("position", x) for x in np.atleast_1d(np.asarray(self.position, dtype=float))])
        seen = 1 if self.temperature is None or self.temperature.ndim == 1 else self.temperature.shape[1]
        if len(places) != seen:
            raise InputError(f"position of the log has {len(places)} numbers; it must have {seen}, one per thermometer")
        lags = np.asarray(self.lag, dtype=float)
        if lags.shape not in ((), (seen,)) or not (np.isfinite(lags) & (lags >= 0)).all():
            raise InputError(
                f"lag of the log is {self.lag}; it must be at least 0 s, one number or one per thermometer"
            )
        object.__setattr__(self, "position", float(places[0]) if seen == 1 else places)
        if not any(np.isfinite(values).any() for values in self.channels.values()):
            raise InputError("the log has neither temperature nor voltage nor current; it must have one of them")

    @property
    def positions(self) -> Array:
        """(S,) distances of the thermometers from the middle of the curved part, m."""
        return np.atleast_1d(np.asarray(self.position, dtype=float))

    @property
    def thermometers(self) -> tuple[str, ...]:
        """Names of the channels of temperature: of several with their places."""
        if len(self.positions) == 1:
            return ("temperature",)
        return tuple(f"temperature {k} at {1e3 * x:g} mm" for k, x in enumerate(self.positions, start=1))

    @property
    def channels(self) -> dict[str, Array]:
        """The measured channels by name."""
        found: dict[str, Array] = {}
        if self.temperature is not None:
            columns = self.temperature.reshape(len(self.time), -1).T
            found |= dict(zip(self.thermometers, columns, strict=True))
        return found | {name: getattr(self, name) for name in ("voltage", "current") if getattr(self, name) is not None}

    def with_camera(self, time: Array, positions: Array, temperature: Array) -> HeatingLog:
        """A copy with the readings of a camera: temperatures (C, P), K, at its own times (C,) and positions (P,), m.

        Duties are those of this log. The camera has no lag. A missing reading is no reading of the other either.

        Raises:
            InputError: as of the class, or a camera that saw nothing during the log.
        """
        inside = (time >= self.time[0]) & (time <= self.time[-1])
        if not inside.any():
            raise InputError(
                f"the camera saw the tube from {time.min():g} to {time.max():g} s; the log goes from {self.time[0]:g} "
                f"to {self.time[-1]:g} s"
            )
        # Two clocks: rows at all times of either, with no reading where the other has none.
        both = np.union1d(self.time, time[inside])

        def spread(at: Array, values: Array) -> Array:
            table = np.full((len(both), *values.shape[1:]), np.nan)
            table[np.searchsorted(both, at)] = values
            return table

        others = {name: spread(self.time, v) for name, v in self.channels.items() if name in ("voltage", "current")}
        before = [] if self.temperature is None else [spread(self.time, self.temperature.reshape(len(self.time), -1))]
        known = self.positions if before else np.zeros(0)
        return HeatingLog(
            both,
            self.duty[np.searchsorted(self.time, both, side="right") - 1],
            temperature=np.hstack([*before, spread(time[inside], temperature[inside])]),
            position=np.concatenate([known, positions]),
            lag=np.concatenate([np.broadcast_to(self.lag, len(known)), np.zeros(len(positions))]),
            **others,
        )

    def kept(self, channels: dict[str, Array]) -> HeatingLog:
        """A copy with other temperature readings."""
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
    """Temperature, voltage or current."""
    return channel.split()[0]


def believable(log: HeatingLog, rig: Rig, expected: dict[str, Array]) -> tuple[HeatingLog, tuple[str, ...]]:
    """The log without readings of a saturated thermometer, and what to know of its thermometers.

    Args:
        expected: channels (T,) as the rig's file predicts them.

    Raises:
        InputError: a thermometer that is dead.
    """
    if log.temperature is None:
        return log, ()
    channels, words = dict(log.channels), []
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
        stays = len(top) >= FLAT and len(top) == top[-1] - top[0] + 1
        if stays and float(np.ptp(expected[name][read[top]])) > 0.2 * HEATED and rise > HEATED:
            channels[name] = channels[name].copy()
            channels[name][read[top]] = np.nan
            words.append(
                f"{name} stays at {values.max() - ZERO_CELSIUS:.1f} degC for {len(top)} readings, as a saturated "
                "thermometer does: they are left out"
            )
        off = float(values[0] - rig.ambient)
        if log.time[read[0]] == log.time[0] and abs(off) > SHIFTED:
            words.append(
                f"{name} begins {abs(off):.1f} K {'above' if off > 0 else 'below'} the rig's ambient temperature: the "
                "thermometer is shifted, or the tube was not cold; fit bias estimates the shift"
            )
    return log.kept(channels), tuple(words)


def step_of(values: Array) -> float:
    """Least difference between readings (N,) that differ: the step of an instrument that reads in steps; 0 where all
    are equal."""
    different = np.diff(np.unique(values))
    return float(different.min()) if len(different) else 0.0


def unexplained(
    channel: str,
    residual: Array,
    stated: float | None,
    unknowns: float,
    step: float = 0.0,
) -> tuple[str, ...]:
    """What residuals (N,), in time, say against the model: more than the stated noise, or in long waves.

    The first by the chi-square test, the second by the mean number of runs of one sign (Wald and Wolfowitz).

    Args:
        unknowns: that were fitted to this channel.
        step: in which the channel is read; waves within half of one are what rounding makes of a slow change.
    """
    words, unit = [], UNITS[kind_of(channel)]
    count = len(residual)
    # Unbiased by the unknowns that were fitted to this channel.
    spread = float(np.sqrt((residual**2).sum() / max(count - unknowns, 1.0)))
    if stated is not None and scipy.stats.chi2.sf((residual**2).sum() / stated**2, max(count - unknowns, 1.0)) < RARE:
        words.append(
            f"residuals of {channel} are {spread:.3g} {unit}, {spread / stated:.1f} times the stated noise of "
            f"{stated:g} {unit}: the model does not explain the log, and intervals are too narrow"
        )
    signs = residual > 0
    above, below = int(signs.sum()), int((~signs).sum())
    if min(above, below) >= 5 and spread > step / 2:
        runs = 1 + int((signs[1:] != signs[:-1]).sum())
        # Mean and variance of the number of runs of independent signs.
        mean = 1 + 2 * above * below / count
        deviation = np.sqrt((mean - 1) * (mean - 2) / (count - 1))
        if scipy.stats.norm.cdf((runs - mean) / deviation) < RARE:
            words.append(
                f"residuals of {channel} change sign {runs - 1} times in {count} readings, noise would {mean - 1:.0f} "
                "times: the model misses something, and intervals are too narrow"
            )
    return tuple(words)


# --- the fit ----------------------------------------------------------------------------------------------------------


# Twice the step of a plan's simulation (`simulation.STEP`): a fit simulates all perturbed rigs several times.
STEP = 0.5
"""Longest step of the simulation of a log, s."""

# One-sided differences: half of it times the curvature is their error, and round-off takes three of 15 digits.
PERTURBATION = 1e-3
"""Step of the logarithm of a factor in finite differences."""

# Scales the unknown only, so that a step of the search is of one size in all.
BIAS_SIZE = 25.0
"""Bias of a thermometer that counts as much as a factor of e, K."""

# A factor known to exp(0.4), 50 %, says less than the file of a rig.
WEAK = 0.4
"""Standard error of a factor's logarithm above which the log does not determine it, and it is fixed."""

BIAS = "bias"
"""What can be fitted besides factors: by how much every thermometer is off, K."""


def _scaled(part: str, name: str) -> Callable[[Rig, float], Rig]:
    @without_unit_warnings()
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

    name: Annotated[str, "name of the parameter"]
    factor: Annotated[float, "factor on the value of the rig file; bias in K"]
    low: Annotated[float, "lower end of its interval"]
    high: Annotated[float, "upper end of its interval"]
    held: Annotated[bool, "true if it was fixed because the log does not determine it"]


@dataclass(frozen=True, eq=False)
class RigFit(Displayed):
    """A rig calibrated to a log."""

    rig: Rig
    """With the factors applied."""
    estimates: Annotated[tuple[Estimate, ...], "the fitted parameters"]
    confidence: Annotated[float, "confidence of the intervals"]
    noise: Annotated[dict[str, float], "RMS residuals: temperature in K, voltage in V, current in A"]
    before: dict[str, Array]
    """(T,) channels that the rig predicts as given."""
    after: dict[str, Array]
    """(T,) channels that it predicts as fitted, biases included."""
    log: HeatingLog
    """That was fitted, without what was not believed."""
    remarks: Annotated[tuple[str, ...], "remarks on the fit"]


def predict(tube: Tube, rigs: Sequence[Rig], log: HeatingLog, grid: Resolution = FINE) -> dict[str, Array]:
    """(T, B) what the log's channels would show on each rig, simulated in steps of at most `STEP`, s."""
    model = stack([thermal_model(tube, rig, grid) for rig in rigs])
    state = at_rest(model)
    lags = np.broadcast_to(log.lag, len(log.positions))[:, None]
    touched = shown = _touched(model, state, log)
    rows = [_seen(model, state, shown)]
    for duty, span in zip(log.duty.tolist(), np.diff(log.time).tolist(), strict=False):
        steps = math.ceil(span / STEP)
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
) -> RigFit:
    """The rig that explains a log, from any subset of temperature, voltage and current.

    Factors that the log does not determine are held at 1 and reported, weakest first, until the rest is determined.
    Residuals that are more than the stated noise, or come in waves, are remarked.

    Args:
        parameters: names of FACTORS, and "bias" for that of every thermometer.
        noise: stated standard deviations by "temperature", "voltage", "current", K, V, A.

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
    expected = {name: values[:, 0] for name, values in predict(tube, [rig], log).items()}
    log, doubts = believable(log, rig, expected)
    names = [
        each for name in names for each in ((f"{BIAS} of {t}" for t in log.thermometers) if name == BIAS else (name,))
    ]
    problem = _Problem(tube, rig, log)
    free, remarks = list(names), list(doubts)
    while True:
        # The weakest factor first: holding it often determines others that were mixed with it.
        x, sigma, J, errors = problem.solve(free)
        weak = int(np.argmax(errors)) if len(free) else 0
        if not len(free) or errors[weak] < WEAK:
            break
        remarks.append(f"{free[weak]} is not determined by the log; it is held at what the file says")
        free.pop(weak)
    freedom = max(problem.count - len(free), 1)
    reach = float(scipy.special.stdtrit(freedom, 0.5 + confidence / 2))
    # Noise of the readings and the error of the grid add up in the worst case.
    room = reach * errors + np.abs(problem.shift(free, x, sigma, J))
    values = dict(zip(free, zip(x, room, strict=True), strict=True))
    estimates = tuple(_estimate(name, values.get(name)) for name in names)
    before, after = problem.before_and_after(free, x)
    for channel, read in problem.read.items():
        share = len(free) * float(read.sum()) / problem.count
        logged = log.channels[channel][read]
        residual = after[channel][read] - logged
        remarks += unexplained(channel, residual, stated.get(kind_of(channel)), share, step_of(logged))
    return RigFit(problem.rig(free, x), estimates, confidence, sigma, before, after, log, tuple(remarks))


def _estimate(name: str, value: tuple[float, float] | None) -> Estimate:
    if value is None:
        return Estimate(name, *((0.0, -math.inf) if name.startswith(BIAS) else (1.0, 0.0)), math.inf, True)
    x, room = value
    if name.startswith(BIAS):
        return Estimate(name, BIAS_SIZE * x, BIAS_SIZE * (x - room), BIAS_SIZE * (x + room), False)
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


class _Fitted(NamedTuple):
    """The solution of a calibration."""

    x: Array
    """(P,) logarithms of the factors, and biases over `BIAS_SIZE`."""
    noise: dict[str, float]
    """Of the channels, K, V, A."""
    jacobian: Array
    """(N, P) of the residuals over the noise."""
    errors: Array
    """(P,) standard errors of x."""


class _Problem:
    """Residuals of a log over logarithms of factors."""

    def __init__(self, tube: Tube, rig: Rig, log: HeatingLog) -> None:
        self.tube, self.given, self.log = tube, rig, log
        self.read = {name: np.isfinite(values) for name, values in log.channels.items()}
        self.count = int(sum(read.sum() for read in self.read.values()))

    def rig(self, names: Sequence[str], x: Array) -> Rig:
        """The rig with its factors exp(x)."""
        rig = self.given
        # A gap that follows from the groove is written out first, so that a factor has something to act on.
        if "gap" in names:
            rig = replace(rig, mold=replace(rig.mold, gap=gap_of(self.tube, rig)))
        for name, value in zip(names, x, strict=True):
            if name in FACTORS:
                rig = FACTORS[name](rig, float(np.exp(value)))
        return rig

    def _predicted(self, rigs: Sequence[Rig], grid: Resolution = FINE) -> dict[str, Array]:
        return predict(self.tube, rigs, self.log, grid)

    def biases(self, names: Sequence[str], x: Array) -> dict[str, float]:
        """What each thermometer shows too much, K."""
        start = f"{BIAS} of "
        found = zip(names, x, strict=True)
        return {name.removeprefix(start): BIAS_SIZE * float(v) for name, v in found if name.startswith(start)}

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
        return self.differences(names, x + PERTURBATION * np.vstack([np.zeros(len(x)), np.eye(len(x))]))

    def quotients(self, now: dict[str, Array]) -> Array:
        """(N, P) derivatives by the unknowns, of what is `perturbed`."""
        return np.vstack([(d[:, 1:] - d[:, :1]) / PERTURBATION for d in now.values()])

    def spread(self, sigma: dict[str, float]) -> Array:
        """(N,) noise of every reading."""
        return np.concatenate([np.full(int(read.sum()), sigma[c]) for c, read in self.read.items()])

    def solve(self, names: Sequence[str]) -> _Fitted:
        """Logarithms of the factors, noise of the channels, Jacobian of the residuals, and standard errors."""
        x = np.zeros(len(names))
        sigma = {c: NOISE[kind_of(c)] for c in self.read}
        # Weights need the noise and the noise needs the fit: a second round with the first one's noise.
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
        # A direction that no reading sees has a huge error instead of a division by 0.
        floor = 1e-12 * max(float(values.max(initial=0.0)), 1e-12)
        errors = np.sqrt((vectors**2 / np.maximum(values, floor)).sum(1))
        return _Fitted(x, sigma, J, errors)

    def shift(self, names: Sequence[str], x: Array, sigma: dict[str, float], J: Array) -> Array:
        """By how much the grid's own error moves the logarithms: grids are of second order, so that it is a third of
        the difference from one of half as many cells."""
        rig = [self.rig(names, x)]
        fine, coarse = (self._predicted(rig, grid) for grid in (FINE, COARSE))
        # Order 2 on half as many cells: the coarse error is 4 times the fine one, their difference 3 times.
        error = np.concatenate([(fine[c] - coarse[c])[read, 0] / 3 / sigma[c] for c, read in self.read.items()])
        return np.asarray(np.linalg.lstsq(J, error, rcond=None)[0])

    def _fit(self, names: Sequence[str], x: Array, sigma: dict[str, float]) -> Array:
        weights = Weights(self.spread(sigma), np.ones(self.count), np.full(len(x), np.inf))
        return descend(_Logged(self, names, x), weights, _Factors(x), solver=STEPS).state.x
