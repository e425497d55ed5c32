"""Heatings in the loop on a thermal model of their own: does the law hold the window that the package says it holds?

    python -m benchmarks.rig_loop [--robots WORD ...] [--rigs WORD ...] [--sensors WORD ...] [--objective NAME] [--json]

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
from collections.abc import Iterator
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
from tubeopt.shaping.heating.sensors import Sensor

from .rig_thermal import KELVIN, Bench
from .timing import ROOT, show, table

SAMPLES = 20
"""Uncertain rigs of `design_feedback`, which tell a likelihood that is not asked for here."""

METAL = 5e9
"""Young's modulus, Pa, below which no current heats a tube."""


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
    """Curved metal tubes of the shipped robots."""
    for path in sorted((ROOT / "configs" / "robots").glob("*.yaml")):
        if not _meant(path.stem, robots):
            continue
        robot, before = load_robot(path), []
        for k, tube in enumerate(robot.tubes, start=1):
            if tube.curved_length > 0 and tube.material.youngs_modulus > METAL and tube not in before:
                before.append(tube)
                yield f"{path.stem} {k}", tube


def _meant(name: str, words: list[str]) -> bool:
    return not words or any(word in name for word in words)


class Feeler:
    """A sensor on the bench: lag, steps, noise, and a bias that grows with the rise up to `hot` degC."""

    def __init__(self, sensor: Sensor, bench: Bench, bias: float, hot: float) -> None:
        self.sensor, self.bench, self.bias, self.hot = sensor, bench, bias, hot
        self.shown = self.target(bench.state[: bench.n] - KELVIN)
        self.noise = np.random.default_rng(0)

    def target(self, tube: np.ndarray) -> float:
        """degC without error, with the tube at (n,) degC."""
        bench, ambient = self.bench, self.bench.rig.ambient - KELVIN
        if isinstance(self.sensor, TubeResistance):
            contact = self.bench.rig.circuit.contact_resistance
            warm = 1 + bench.metal.resistivity_slope * (tube + KELVIN - bench.metal.reference_temperature)
            ratio = (2 * float(bench.ohms @ warm) + contact) / (2 * bench.cold + contact)
            return ambient + (ratio - 1) * (1 / self.sensor.slope + ambient - 25)
        places = self.sensor.positions if isinstance(self.sensor, Camera) else (getattr(self.sensor, "position", 0.0),)
        return float(np.interp(bench.half - np.abs(places), bench.place, tube).mean())

    def follow(self, tube: np.ndarray, span: float) -> None:
        """Let the reading follow a step of `span` s that ends at these temperatures."""
        kept = math.exp(-span / self.sensor.lag) if self.sensor.lag else 0.0
        self.shown = self.target(tube) + (self.shown - self.target(tube)) * kept

    def read(self) -> float:
        """degC."""
        ambient = self.bench.rig.ambient - KELVIN
        off = self.bias * min(max((self.shown - ambient) / (self.hot - ambient), 0.0), 1.0)
        value = self.shown + off + self.sensor.noise * float(self.noise.standard_normal())
        return round(value / self.sensor.quantum) * self.sensor.quantum if self.sensor.quantum else value


def led(case: Case, law: HeatingLaw, bias: float) -> tuple[float, float, float]:
    """Coldest and hottest of the curved part in the hold, and hottest ever, degC; infinite where there was no hold.

    The law as a board runs it: share = proportional e + integral of e, counts by error diffusion, and it waits while
    the tube lags behind.
    """
    planned, reference = np.round(100 * law.planned) / 100, np.round(10 * law.reference) / 10
    bench = Bench(case.tube, case.rig)
    feeler = Feeler(case.sensor, bench, bias, float(reference.max()) + 1e-3)
    place, total, owed, waited = 0, 0.0, 0.0, 0.0
    first, last = law.hold
    low, high, top = math.inf, -math.inf, -math.inf
    while place < len(planned) and waited <= law.patience:
        error = float(reference[place]) - feeler.read()
        total = min(max(total + law.integral * law.slot * error, -law.share), law.share)
        share = min(max(law.proportional * error + total, -law.share), law.share)
        desired = float(planned[place]) * (1 + share)
        due = desired + owed
        count = min(max(math.floor(due + law.lost + 0.5), 0), 255) if due > 0.5 else 0
        owed = min(max(due - max(count - law.lost, 0.0), -1 - law.lost), 1.0) if desired > 0 else 0.0
        seen = bench.pass_time(count, law.slot)
        for tube in seen:
            feeler.follow(tube, law.slot / len(seen))
        top = max(top, float(seen.max()))
        if first <= place < last:
            bend = np.column_stack([bench.bend_begins(seen), seen[:, bench.bend_from :]])
            low, high = min(low, float(bend.min())), max(high, float(bend.max()))
        if error > law.holdback and place <= first:
            waited += law.slot
        else:
            place += 1
    return (low, high, top) if place >= len(planned) else (-math.inf, math.inf, top)


def room(plan: HeatingPlan, low: float, high: float, top: float) -> float:
    """Least distance from the window's ends and the limit, K."""
    lowest_allowed, end = plan.spec.window_degC
    return min(low - lowest_allowed, end - high, plan.spec.limit - top)


def measure(case: Case, objective: str) -> Found:
    """Plan it, find its law, and lead it here."""
    plan = plan_heating(case.tube, case.rig, HeatingSpec(objective=objective))
    feedback: Feedback = design_feedback(plan, case.sensor, samples=SAMPLES)
    law, off = feedback.law, case.sensor.bias
    low, high = feedback.history.extremes(law)
    stated = room(plan, float(low[0]), float(high[0]), float(feedback.history.top[:, 0].max()))
    runs = np.array([led(case, law, bias) for bias in ((0.0, off, -off) if off else (0.0,))])
    unbiased = room(plan, *runs[0])
    worst = float(runs[:, 0].min()), float(runs[:, 1].max()), float(runs[:, 2].max())
    result = Found(case.name, plan.verdict, stated, *worst, room(plan, *worst), unbiased)
    print(f"{case.name}: {result.lowest:.1f} to {result.highest:.1f} degC, room {result.room:+.1f} K (unbiased "
          f"{unbiased:+.1f}, stated {stated:+.1f}), {plan.verdict}", file=sys.stderr, flush=True)  # fmt: skip
    return result


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("robots", "rigs", "sensors"):
        parser.add_argument(f"--{name}", nargs="*", default=[], help="only those whose names hold one of these words")
    parser.add_argument("--objective", default="time", help="of the schedule: time or margin")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = [measure(case, options.objective) for case in cases(options.robots, options.rigs, options.sensors)]
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
