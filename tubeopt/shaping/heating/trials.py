"""A rig calibrated without a thermometer: from trials in which a tube came out too soft, set, or overheated.

So worked the thesis: heat for a minute, look at the spring-back, turn the dial. Every trial tells on which side of the
window the tube was; what all trials tell together is the loss factor, with an interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
import scipy

from ...constants import ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError, Settings, choice, positive
from ...files.field_metadata import POSITIVE, REQUIRED, check_fields, key, unit
from ...physics.heat import Resolution
from ...robots.tubes import Tube
from ...typing import Array
from .rig import COUNTS, Rig
from .simulation import simulate
from .spec import HeatingSpec
from .thermal import stack, thermal_model

RESULTS = ("under", "good", "over")
GRID = Resolution(2, 4, 6, 8, 8)
FACTORS = np.geomspace(0.4, 2.5, 49)

OTHER_TIME = 2.0
"""By which factor the time of a trial may differ from that of a colour in the table."""


@dataclass(frozen=True)
class Colour:
    """Temperature range of a colour.

    Raises:
        InputError: a number is out of its range, or the range is empty.
    """

    name: Annotated[str, REQUIRED, "name of the colour"] = ""
    low: Annotated[float, key("low_degC"), POSITIVE, REQUIRED, "lowest temperature of the colour"] = 1.0
    high: Annotated[float, key("high_degC"), POSITIVE, REQUIRED, "highest temperature of the colour"] = 2.0
    time: Annotated[float | None, unit("s"), POSITIVE, "time at the temperature, if the source states it"] = None

    def __post_init__(self) -> None:
        check_fields(self, f"colour {self.name!r}")
        if not self.name or not self.low < self.high:
            raise InputError(
                f"colour {self.name!r} goes from {self.low - ZERO_CELSIUS:g} to {self.high - ZERO_CELSIUS:g} degC; it "
                "must have a name, and its least temperature must be below its greatest"
            )


@dataclass(frozen=True)
class ColourTable(Displayed):
    """Colours by temperature.

    They are a thermometer that is read afterwards: heat grows a thin oxide on nitinol, and light interferes in it:
    straw, purple, blue as it gets thicker. How thick it is depends on temperature, time, surface and air, so that a
    table holds for one laboratory and one time.

    Raises:
        InputError: no source, no colours, or two of one name.
    """

    source: Annotated[str, REQUIRED, "source of the numbers: a publication, or your own trials with their date"] = ""
    colours: Annotated[tuple[Colour, ...], REQUIRED, "colours of the oxide"] = field(default_factory=tuple)
    spread: Annotated[float, unit("K"), POSITIVE, "standard deviation of the ends of each temperature range"] = 50.0

    def __post_init__(self) -> None:
        check_fields(self, "the table of colours")
        names = [colour.name for colour in self.colours]
        if not self.source.strip() or not names or len(set(names)) < len(names):
            raise InputError("a table of colours must have a source and different colour names")

    def chance(self, name: str, temperature: Array, duration: float) -> Array:
        """Probability of a colour at temperatures, degC, after `duration` s.

        Raises:
            InputError: no such colour, or the table's time for it is another by more than `OTHER_TIME`.
        """
        choice("colour of a trial", name, [colour.name for colour in self.colours])
        one = next(colour for colour in self.colours if colour.name == name)
        if one.time is not None and not one.time / OTHER_TIME <= duration <= one.time * OTHER_TIME:
            raise InputError(
                f"the table of colours has {name} after {one.time:g} s; a trial took "
                f"{duration:g} s; the times must differ by at most a factor of "
                f"{OTHER_TIME:g}"
            )
        below, above = (
            scipy.stats.norm.cdf((temperature + ZERO_CELSIUS - edge) / self.spread) for edge in (one.low, one.high)
        )
        return np.asarray(below - above)


NITINOL_COLOURS = ColourTable(
    source="a maker of nickel-titanium wire, as a rough correspondence that says no time (www.wgnietai.com, heat "
    "treatment temperature and colour); the thesis found purple and yellow on tubes that were set well within a minute "
    "(section 4.2.3)",
    colours=(
        Colour("light yellow", 473.15, 573.15),
        Colour("yellow", 573.15, 673.15),
        Colour("purple and yellow", 673.15, 823.15),
        Colour("purple", 673.15, 773.15),
        Colour("blue", 773.15, 873.15),
    ),
)
"""Colours of nitinol, wide: to be replaced by a table of one's own trials."""


@dataclass(frozen=True)
class Trial:
    """One heating by hand, and what came of it.

    Raises:
        InputError: a value is out of its range.
    """

    duty: float
    """Counts 0-255 at the end."""
    duration: float
    """From switching on to taking the tube out, s."""
    result: str
    """ "under" (it sprang back), "good" (the shape is the mold's and the tube still superelastic), "over" (the shape is
    the mold's but the tube no longer superelastic), "set" (good or over, not tested), or "" where only the colour was
    looked at."""
    ramp: float = 0.0
    """In which the duty was raised from 0, evenly, s."""
    colour: str | None = None
    """Of the oxide afterwards, one of the table's; None where nobody looked."""

    def __post_init__(self) -> None:
        if self.result or self.colour is None:
            choice("result of a trial", self.result, (*RESULTS, "set"))
        if not 0 < positive("duty of a trial", self.duty) <= COUNTS:
            raise InputError(f"duty of a trial is {self.duty:g}; it must be at most {COUNTS}")
        if positive("ramp of a trial", self.ramp, zero=True) > positive("duration of a trial", self.duration):
            raise InputError(f"ramp of a trial is {self.ramp:g} s; it must not be longer than the trial")


@dataclass(frozen=True)
class TrialSolver(Settings):
    """Settings of `calibrate_from_trials`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    spread: float = 15.0
    """Standard deviation, K, of the temperature at which a trial turns out so or so: tubes and eyes differ; assumed."""
    prior: float = 0.3
    """Standard deviation of the logarithm of the loss factor before any trial; assumed."""
    slots: int = 120
    """Number of time steps of the simulation of a trial."""


DEFAULT_TRIALS = TrialSolver()


@dataclass(frozen=True, eq=False)
class TrialFit(Displayed):
    """The loss factor that trials speak for."""

    rig: Rig
    """With it."""
    factor: float
    """Median, on what the rig's file says."""
    low: float
    """Of the interval."""
    high: float
    """Of the interval."""
    confidence: float
    """Of the interval."""
    temperatures: Array
    """(K,) of the middle of the tube at the end of each trial, by the fitted rig, degC."""
    grid: Array
    """(G,) factors."""
    density: Array
    """(G,) their probability given the trials."""
    surprise: float
    """Least probability that any trial had under the fitted rig; small where trials contradict the model."""


def calibrate_from_trials(
    tube: Tube,
    rig: Rig,
    trials: Sequence[Trial],
    spec: HeatingSpec | None = None,
    *,
    colours: ColourTable = NITINOL_COLOURS,
    confidence: float = 0.95,
    solver: TrialSolver = DEFAULT_TRIALS,
) -> TrialFit:
    """The loss factor from trial outcomes: Bayes' rule on a grid, with a log-normal prior around the rig's file.

    Args:
        colours: temperatures of the oxide's colours; by default wide ones of nitinol.
        solver: how far trials are trusted.

    Raises:
        InputError: no trials, a colour that the table does not know, or knows after another time, or a confidence
            outside of (0, 1).
    """
    if not trials:
        raise InputError("there are no trials; there must be at least one")
    if not 0 < confidence < 1:
        raise InputError(f"confidence is {confidence:g}; it must be between 0 and 1")
    window = (spec or HeatingSpec()).window_degC
    ends = np.array([_end_temperatures(tube, rig, trial, solver.slots) for trial in trials])  # (K, G)
    spread = solver.spread
    chance = np.array([_chance(trial, row, window, colours, spread) for trial, row in zip(trials, ends, strict=True)])
    log = np.log(np.maximum(chance, 1e-12)).sum(0) + scipy.stats.norm.logpdf(np.log(FACTORS), scale=solver.prior)
    density = np.exp(log - log.max())
    density /= density.sum()
    cumulative = np.cumsum(density) - 0.5 * density
    tail = 0.5 * (1 - confidence)
    low, middle, high = (float(np.interp(q, cumulative, FACTORS)) for q in (tail, 0.5, 1 - tail))
    at = [float(np.interp(middle, FACTORS, row)) for row in ends]
    fitted = replace(rig, loss_factor=rig.loss_factor * middle)
    surprise = min(float(np.interp(middle, FACTORS, row)) for row in chance)
    return TrialFit(fitted, middle, low, high, confidence, np.array(at), FACTORS, density, surprise)


def _end_temperatures(tube: Tube, rig: Rig, trial: Trial, slots: int) -> Array:
    """(G,) temperature of the middle at the end of a trial for every factor of the grid, degC."""
    rigs = [replace(rig, loss_factor=rig.loss_factor * factor) for factor in FACTORS]
    model = stack([thermal_model(tube, each, GRID) for each in rigs])
    slot = trial.duration / slots
    at = (np.arange(slots) + 0.5) * slot
    duty = trial.duty / COUNTS * np.minimum(at / trial.ramp if trial.ramp else 1.0, 1.0) * np.ones(slots)
    history = simulate(model, slot, duty, steps=3)
    return np.asarray(history.tube[-1, :, -1]) - ZERO_CELSIUS


def _chance(
    trial: Trial, temperature: Array, window: tuple[float, float], colours: ColourTable, spread: float
) -> Array:
    """Probability of what a trial showed at temperatures, degC: of its result, and of its colour."""
    set_, over = (scipy.stats.norm.cdf((temperature - edge) / spread) for edge in window)
    results = {"under": 1 - set_, "good": set_ - over, "over": over, "set": set_, "": np.ones_like(set_)}
    found = np.asarray(results[trial.result])
    if trial.colour is not None:
        found = found * colours.chance(trial.colour, temperature, trial.duration - trial.ramp)
    return found
