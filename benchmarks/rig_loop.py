"""Heatings in the loop on a thermal model of their own: does the law hold the window that the package says it holds?

    python -m benchmarks.rig_loop [--robots WORD ...] [--rigs WORD ...] [--sensors WORD ...] [--objectives NAME ...]

Every tube of every robot in `configs/robots` is planned on every rig in `configs/rigs` and led by a thermocouple, and
the tube of each rig's own file (`--robots own`) by every sensor. The package says schedule, reference and gains; rig,
sensor and law here are written apart (`rig_thermal`; the law from its equations, with numbers in the steps of the
sketch's tables). Each is led three times: by a sensor without bias, and by one that is off by as much as it may be, up
and down. The worst of the three is told: the coldest and the hottest point of the curved part in the hold, and the
hottest at any time.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from tubeopt import (
    Camera,
    Feedback,
    HeatingPlan,
    HeatingSpec,
    Rig,
    Thermocouple,
    Tube,
    TubeResistance,
    design_feedback,
    load_rig,
    load_robot,
    plan_heating,
)
from tubeopt.shaping.heating.controller import HeatingLaw
from tubeopt.shaping.heating.sensors import Sensor, equipped
from tubeopt.typing import Array

from .rig_thermal import KELVIN, Bench, Fleet
from .timing import ROOT, show, table

SAMPLES = 20
"""Uncertain rigs of `design_feedback`, which tell a likelihood that is not asked for here."""

METAL = 5e9
"""Young's modulus, Pa, below which no current heats a tube."""

STIFF = 100e9
"""Young's modulus, Pa, above which a tube is of steel, which is not set by heat."""


@dataclass(frozen=True)
class Case:
    """A tube on a rig, and what feels it."""

    name: str
    tube: Tube
    rig: Rig
    sensor: Sensor


@dataclass(frozen=True)
class Found:
    """What became of a case: degC, and K of room to the window's ends and the limit (negative: missed).

    planned: the package's verdict of the schedule. said: room in the package's own loop. lowest, highest, top, room:
    here, the worst of all biases. unbiased: room with a sensor without bias.
    """

    case: str
    planned: str
    stated: float
    lowest: float
    highest: float
    top: float
    room: float
    unbiased: float

    @property
    def faulty(self) -> bool:
        """Whether the package says that a sensor without bias holds what it does not hold here."""
        return self.stated >= 0 > self.unbiased


def cases(robots: list[str], rigs: list[str], sensors: list[str]) -> Iterator[Case]:
    """What is led; words are parts of names, no words all of them. Equal tubes of a robot count once."""
    kinds: tuple[Sensor, ...] = (Thermocouple(), Camera(), TubeResistance())
    desired = [kind for kind in kinds if _meant(kind.name, sensors)]
    for path in sorted((ROOT / "configs" / "rigs").glob("*.yaml")):
        if not _meant(path.stem, rigs):
            continue
        rig = load_rig(path)
        if rig.tube is not None and _meant("own", robots):
            yield from (Case(f"own tube, {path.stem}, {kind.name}", rig.tube, rig, kind) for kind in desired)
        tried = desired if sensors else desired[:1]
        for name, tube in tubes(robots):
            yield from (Case(f"{name}, {path.stem}, {kind.name}", tube, rig, kind) for kind in tried)


def tubes(robots: list[str]) -> Iterator[tuple[str, Tube]]:
    """Curved tubes of nitinol of the shipped robots."""
    for path in sorted((ROOT / "configs" / "robots").glob("*.yaml")):
        if not _meant(path.stem, robots):
            continue
        robot, before = load_robot(path), []
        for k, tube in enumerate(robot.tubes, start=1):
            if tube.curved_length > 0 and METAL < tube.material.youngs_modulus < STIFF and tube not in before:
                before.append(tube)
                yield f"{path.stem} {k}", tube


def _meant(name: str, words: list[str]) -> bool:
    return not words or any(word in name for word in words)


class Feeler:
    """A sensor on every rig of a fleet: lag, steps, noise, and a bias that grows with the rise up to `hot` degC.

    Args:
        bias: (B,) of the corrected reading, K. lag: (B,) or one, s; by default that of the sensor.
    """

    def __init__(
        self, sensor: Sensor, fleet: Fleet, bias: Array, hot: float, lag: Array | float | None = None, seed: int = 0
    ) -> None:
        self.sensor, self.fleet, self.bias, self.hot = sensor, fleet, bias, hot
        self.lag = np.maximum(sensor.lag if lag is None else lag, 1e-9)
        self.noise = np.random.default_rng(seed)
        self.shown = self.before = self.target()

    def target(self) -> Array:
        """(B,) degC without error."""
        fleet, sensor, metal = self.fleet, self.sensor, self.fleet.metal
        if isinstance(sensor, TubeResistance):
            ratio = (2 * fleet.half_resistance() + fleet.contact) / (2 * fleet.cold + fleet.contact)
            rise = fleet.ambient - metal["reference_temperature"]
            return np.asarray(fleet.ambient - KELVIN + (ratio - 1) * (1 / sensor.slope + rise))
        places = sensor.positions if isinstance(sensor, Camera) else (getattr(sensor, "position", 0.0),)
        at = fleet.first.half - np.abs(places)
        return np.array([np.interp(at, fleet.first.place, tube).mean() for tube in fleet.tube])

    def follow(self, span: float) -> None:
        """Let the readings follow a step of `span` s that has just passed."""
        target = self.target()
        # The target rises in a straight line.
        slope, kept = (target - self.before) / span, np.exp(-span / self.lag)
        self.shown = target - self.lag * slope + (self.shown - self.before + self.lag * slope) * kept
        self.before = target

    def read(self) -> Array:
        """(B,) degC."""
        ambient = self.fleet.ambient - KELVIN
        off = self.bias * np.clip((self.shown - ambient) / (self.hot - ambient), 0.0, 1.0)
        value = self.shown + off + self.sensor.noise * self.noise.standard_normal(len(self.shown))
        return np.round(value / self.sensor.quantum) * self.sensor.quantum if self.sensor.quantum else value


@dataclass(frozen=True)
class Led:
    """What became of every rig: (B,) coldest and hottest of the curved part in the hold, hottest ever, degC; and why
    its board ended. Without a hold the first two are infinite.
    """

    low: Array
    high: Array
    top: Array
    reason: np.ndarray
    time: Array

    @property
    def done(self) -> np.ndarray:
        """Whether the board says that it was a success."""
        return self.reason == "done"


TICKS = 5
"""Of a slot: times at which a board looks at its thermometer."""


def led(fleet: Fleet, law: HeatingLaw, feeler: Feeler, tables: Sequence[tuple[float, Array]] = ()) -> Led:
    """The law as a board runs it, on every rig of a fleet.

    share = proportional e + integral of e, counts by error diffusion; it waits while the tube lags behind, and in the
    hold while the reading is below its floor; a reading above the ceiling stops it at the next tick.

    Args:
        tables: voltage at rest and schedule of several charges, the fullest battery first.
    """
    count_of, size = len(law.planned), len(fleet.ambient)
    planned = np.round(100 * np.tile(law.planned, (size, 1))) / 100
    # The first table from the emptiest whose battery is no fuller than this one.
    for volt, schedule in tables[::-1]:
        chosen = (volt <= fleet.rest() + 0.05) | (volt == tables[-1][0])
        planned[chosen] = np.round(100 * np.asarray(schedule)) / 100
    reference = np.round(10 * law.reference) / 10
    first, last = law.hold
    place, total, owed, waited = np.zeros(size, dtype=int), *np.zeros((3, size))
    low, high, top, ended = np.full(size, np.inf), np.full(size, -np.inf), np.full(size, -np.inf), np.zeros(size)
    reason = np.full(size, "", dtype="U20")
    rows, top_count = np.arange(size), min(law.bare_count, 249 - law.lost)

    def end(which: np.ndarray, why: str) -> None:
        fresh = which & (reason == "")
        reason[fresh], ended[fresh] = why, clock

    clock = 0.0
    while (reason == "").any():
        reading = feeler.read()
        end(reading > law.ceiling, "over-temperature")
        end(place >= count_of, "done")
        at = np.minimum(place, count_of - 1)
        error = reference[at] - reading
        behind = (error > law.holdback) & (place <= first)
        waits = behind | ((reading < law.floor) & (place >= first))
        waited = waited + np.where(waits, law.slot, 0.0)
        late = waited > law.patience
        end(late & (place >= first) & ~behind, "too cold")
        end(late, "behind schedule")
        now = planned[rows, at]
        most = np.where(now > 0, np.clip(top_count / np.maximum(now, 1e-9) - 1, 0.0, law.share), law.share)
        total = np.clip(total + law.integral * law.slot * error, -law.share, most)
        share = np.clip(law.proportional * error + total, -law.share, most)
        desired = now * np.maximum(1 + share, 0.0)
        due = desired + owed
        counts = np.where(due > 0.5 + 2**-8, np.clip(np.floor(due + law.lost + 0.5 - 2**-8), 0, 249), 0.0)
        owed = np.where(desired > 0, np.clip(due - np.maximum(counts - law.lost, 0.0), -1 - law.lost, 1.0), 0.0)
        held = (place >= first) & (place < last) & ~waits
        place = np.where(waits, place, place + 1)
        for tick in range(TICKS):
            if tick:
                end(feeler.read() > law.ceiling, "over-temperature")
            running = reason == ""
            cold, hot = fleet.bend()
            inside = held & running
            low[inside], high[inside] = np.minimum(low, cold)[inside], np.maximum(high, hot)[inside]
            fleet.pass_time(np.where(running, counts, 0), law.slot / TICKS)
            feeler.follow(law.slot / TICKS)
            clock += law.slot / TICKS
            top = np.maximum(top, fleet.tube.max(1))
    return Led(low, high, top, reason, ended)


def room(plan: HeatingPlan, low: float, high: float, top: float) -> float:
    """Least distance from the window's ends and the limit, K."""
    lowest_allowed, end = plan.spec.window_degC
    return min(low - lowest_allowed, end - high, plan.spec.limit - top)


def measure(case: Case, objective: str) -> Found:
    """Plan it, find its law, and lead it here."""
    rig = equipped(case.rig, case.sensor)
    plan = plan_heating(case.tube, rig, HeatingSpec(objective=objective))
    feedback: Feedback = design_feedback(plan, case.sensor, samples=SAMPLES)
    law, off = feedback.law, case.sensor.bias
    low, high = feedback.history.extremes(law)
    stated = room(plan, float(low[0]), float(high[0]), float(feedback.history.top[:, 0].max()))
    biases = np.array([0.0, off, -off] if off else [0.0])
    fleet = Fleet([Bench(case.tube, rig)] * len(biases))
    found = led(fleet, law, Feeler(case.sensor, fleet, biases, float(law.reference.max())))
    runs = np.column_stack([found.low, found.high, found.top])
    runs[~found.done, :2] = -math.inf, math.inf
    unbiased = room(plan, *runs[0])
    worst = float(runs[:, 0].min()), float(runs[:, 1].max()), float(runs[:, 2].max())
    result = Found(f"{case.name}, {objective}", plan.verdict, stated, *worst, room(plan, *worst), unbiased)
    print(f"{result.case}: {result.lowest:.1f} to {result.highest:.1f} degC, room {result.room:+.1f} K (unbiased "
          f"{unbiased:+.1f}, stated {stated:+.1f}), {plan.verdict}", file=sys.stderr, flush=True)  # fmt: skip
    return result


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("robots", "rigs", "sensors"):
        parser.add_argument(f"--{name}", nargs="*", default=[], help="only those whose names hold one of these words")
    parser.add_argument("--objectives", nargs="*", default=["time", "margin"], help="of the schedule")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = [
        measure(case, objective)
        for objective in options.objectives
        for case in cases(options.robots, options.rigs, options.sensors)
    ]
    if options.json:
        print(json.dumps([asdict(one) for one in result]))
        return
    rows = [
        (
            f.case,
            f"{f.lowest:.1f}-{f.highest:.1f}",
            *(f"{value:+.1f}" for value in (f.room, f.unbiased, f.stated)),
            f.planned,
        )
        for f in sorted(result, key=lambda f: f.room)
    ]
    columns = ("case", "hold, degC", "room, K", "unbiased", "said", "schedule")
    notes = [
        f"{sum(f.room >= 0 for f in result)} of {len(result)} hold the window with every bias, "
        f"{sum(f.unbiased >= 0 for f in result)} without; {sum(f.faulty for f in result)} are wrongly stated to hold it"
    ]
    show([table("heatings in the loop, on a model of their own", columns, rows)], notes)


if __name__ == "__main__":
    main()
