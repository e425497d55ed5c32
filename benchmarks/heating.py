"""Processor time of a heating plan, whatever becomes of it: rigs, robots, slots, holds, and what cannot be held.

    python -m benchmarks.heating [--only WORD] [--json]

Every case is planned once, after one plan that warms up (CasADi's functions and the program are built once a process).
Times are of the processor, on one thread. Beside single questions there are all of molds, slots and holds, each with
one of some tubes, and rigs drawn at random that no workshop would have.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import cycle, product
from typing import Any

import numpy as np

from tubeopt import HeatingSpec, Rig, Tube, load_rig, load_robot, plan_heating

from .timing import ROOT, clock, show, table

MOLDS = ("calcium_silicate", "mdf", "steel")
ROBOTS = ("thesis_ctr", "grassmann_ctr", "timc_ctr")
SLOTS, HOLDS = (0.05, 0.1, 0.5), (30.0, 120.0, 300.0)
TUBES = (("thesis_etr", 1), ("thesis_ctr", 1), ("grassmann_ctr", 1), ("khadem_ctr", 3), ("medlab_ctr", 2))
"""Robots and tubes, counted from 1, that go round in `grid`; coprime in number with molds, slots and holds."""

NASTY = 16
"""Rigs drawn at random."""

LOGARITHMIC = {"limit": (1.0, 40.0), "lead": (1e-3, 60e-3), "thickness": (5e-3, 0.2), "clearance": (0.5e-3, 20e-3)}
"""Ranges from which `nasty` draws: A of mean current, m."""


@dataclass(frozen=True)
class Case:
    """A tube on a rig, and what is asked."""

    name: str
    tube: Tube
    rig: Rig
    spec: HeatingSpec


@dataclass(frozen=True)
class Found:
    """What a case took, s, and what became of it."""

    case: str
    seconds: float
    verdict: str
    hold_start: float
    lowest: float
    highest: float


def _rig(mold: str) -> Rig:
    return load_rig(ROOT / "configs" / "rigs" / f"thesis_{mold}.yaml")


def _tube(robot: str, number: int) -> Tube:
    return load_robot(ROOT / "configs" / "robots" / f"{robot}.yaml").tubes[number - 1]


def cases() -> Iterator[Case]:
    """What is measured."""
    yield from single()
    yield from grid()
    yield from nasty()


def grid() -> Iterator[Case]:
    """Every mold with every slot and hold."""
    tubes = cycle(TUBES)
    for mold, slot, hold in product(MOLDS, SLOTS, HOLDS):
        robot, number = next(tubes)
        name = f"{mold}, {robot} {number}, {slot:g} s, {hold:g} s"
        yield Case(name, _tube(robot, number), _rig(mold), HeatingSpec(slot=slot, hold_time=hold))


def nasty() -> Iterator[Case]:
    """Rigs that are hardly fit for anything, asked for windows narrow and wide, low and high."""
    generator = np.random.default_rng(22)
    for k in range(NASTY):
        robot, number = TUBES[int(generator.integers(len(TUBES)))]
        rig = _rig(MOLDS[int(generator.integers(len(MOLDS)))]).with_charge(float(generator.uniform(0.02, 1.0)))
        limit, lead, thickness, clearance = (
            float(np.exp(generator.uniform(*np.log(ends)))) for ends in LOGARITHMIC.values()
        )
        rig = replace(
            rig,
            circuit=replace(rig.circuit, current_limit=limit),
            mold=replace(rig.mold, lead=lead, thickness=thickness),
            clamps=replace(rig.clamps, clearance=clearance),
        )
        low = float(generator.uniform(300.0, 1000.0))
        high = low + float(np.exp(generator.uniform(np.log(5.0), np.log(100.0))))
        ramp = float(np.exp(generator.uniform(np.log(5.0), np.log(60.0))))
        spec = HeatingSpec(window_degC=(low, high), ramp=ramp, slot=0.05, hold_time=float(generator.choice(HOLDS)))
        yield Case(f"nasty rig {k + 1}", _tube(robot, number), rig, spec)


def single() -> Iterator[Case]:
    """One question each."""
    rig = _rig("calcium_silicate")
    tube = rig.tube
    assert tube is not None
    quick: dict[str, Any] = {"slot": 0.05}
    for slot in (0.5, 0.05):
        for hold in (2.0, 60.0, 300.0):
            yield Case(f"slot {slot:g} s, hold {hold:g} s", tube, rig, HeatingSpec(slot=slot, hold_time=hold))
    long = HeatingSpec(**quick, hold_time=300.0)
    for mold in MOLDS[1:]:
        yield Case(f"{mold}, as the last", tube, replace(_rig(mold), tube=tube), long)
    double = tuple((charge, 2 * volt) for charge, volt in rig.battery.open_circuit)
    yield Case("24 V", tube, replace(rig, battery=replace(rig.battery, open_circuit=double)), long)
    yield Case("lead of 4 mm", tube, replace(rig, mold=replace(rig.mold, lead=4e-3)), long)
    yield Case("battery at 20 %", tube, rig.with_charge(0.2), long)
    weak = replace(rig, circuit=replace(rig.circuit, current_limit=2.0))
    yield Case("2 A on average", tube, weak, long)
    yield Case("window of 10 K", tube, rig, replace(long, window_degC=(520.0, 530.0), limit_degC=None))
    yield Case("window of 900 degC", tube, rig, replace(long, window_degC=(880.0, 900.0), limit_degC=None))
    for objective in ("energy", "margin"):
        yield Case(f"objective {objective}", tube, rig, replace(long, objective=objective))
    yield Case("lead and vents free", tube, rig, replace(long, free=("lead", "vents")))
    for name in ROBOTS:
        robot = load_robot(ROOT / "configs" / "robots" / f"{name}.yaml")
        for k, other in enumerate(robot.tubes, start=1):
            if other.curved_length > 0 and other.material.thermal is not None:
                yield Case(f"{name}, tube {k}", other, rig, long)


def measure(case: Case) -> Found:
    """Plan it."""
    seconds, plan = clock(lambda: plan_heating(case.tube, case.rig, case.spec))
    print(f"{case.name}: {seconds:.2f} s, {plan.verdict}", file=sys.stderr, flush=True)
    return Found(case.name, seconds, plan.verdict, plan.hold_start, plan.lowest, plan.highest)


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="cases whose name holds this word")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    measure(replace(next(cases()), spec=HeatingSpec(hold_time=2.0, objective="energy")))
    measure(next(cases()))
    results = [measure(case) for case in cases() if options.only in case.name]
    if options.json:
        print(json.dumps([asdict(one) for one in results]))
        return
    rows = [
        (f.case, f"{f.seconds:.2f}", f"{f.hold_start:.1f}", f"{f.lowest:.0f}-{f.highest:.0f}", f.verdict)
        for f in results
    ]
    columns = ("case", "processor, s", "hold from, s", "degC", "verdict")
    show([table("heating plans", columns, rows)], [])


if __name__ == "__main__":
    main()
