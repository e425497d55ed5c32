"""The firmware in the loop beside the law in Python: how far apart the temperatures are that they make.

    python -m benchmarks.firmware [--rigs N] [--seed N] [--json]

The sketch of the thesis' rig is compiled for this computer and leads uncertain rigs (`Uncertainty.of_a_workshop`), each
simulated in steps of a tenth of a second; beside it the law leads an equal rig with an equal thermocouple. Told is the
greatest difference of the hottest points over all of each heating, and what the firmware's hold was.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from tests.shaping.firmware_host import TICK, built, run
from tubeopt import HeatingSpec, Thermocouple, design_feedback, load_rig, plan_heating
from tubeopt.constants import ZERO_CELSIUS
from tubeopt.shaping.firmware.boards import BOARDS, Wiring
from tubeopt.shaping.firmware.line import SimulatedRig
from tubeopt.shaping.firmware.sketch_files import schedules, tabled, write_sketch
from tubeopt.shaping.heating.controller import HeatingLaw, LawState, decide
from tubeopt.shaping.heating.uncertainty import Uncertainty
from tubeopt.typing import Array

from .timing import ROOT, show, table

SEED = 11
"""Of the rigs; those on which the law was chosen have others."""


@dataclass(frozen=True)
class Pair:
    """Greatest difference of the hottest points, K; coldest and hottest in the firmware's hold, degC; why it ended."""

    rig: int
    apart: float
    lowest: float
    highest: float
    reason: str


def by_law(law: HeatingLaw, rig: SimulatedRig, ticks: int) -> Array:
    """(ticks,) hottest point of a rig that the law leads, degC."""
    memory, hottest, count = LawState.start(1), [], np.zeros(1, dtype=np.int64)
    per_slot = round(law.slot / TICK)
    for k in range(ticks):
        reading = rig.reading
        if k % per_slot == 0:
            count, memory = decide(law, memory, np.array([reading]))
        hottest.append(rig.hottest - ZERO_CELSIUS)
        rig.pass_time(int(count[0]), TICK)
    return np.array(hottest)


def measure(rigs: int, seed: int) -> list[Pair]:
    """One pair of heatings for every rig."""
    rig = load_rig(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")
    assert rig.tube is not None
    rig = replace(rig, circuit=replace(rig.circuit, pwm_frequency=BOARDS["uno"].frequencies[0]))
    plan = plan_heating(rig.tube, rig, HeatingSpec(objective="margin"))
    led = design_feedback(plan, Thermocouple(), samples=20)
    fleet = Uncertainty.of_a_workshop().ensemble(plan.tube, plan.rig, rigs - 1, seed=seed)
    tables, model, pairs = schedules(plan, led), fleet.model, []
    with tempfile.TemporaryDirectory() as directory:
        write_sketch(plan, led, Wiring(), Path(directory), host=True)
        heater = built(Path(directory) / "tube_heater")
        for b in range(rigs):
            alone = replace(model, properties=model.properties[b : b + 1], volumes=model.volumes[b : b + 1])
            hot, bias = float(led.law.reference.max()), float(fleet.bias[b])
            pair = [SimulatedRig(alone, led.sensor, bias=bias, hot=hot, seed=b) for _ in range(2)]
            volt, _ = pair[1].electrics(False)
            chosen = next((planned for rest, planned in tables if rest <= volt + 0.05), tables[-1][1])
            course = run(heater, pair[0])
            hottest = by_law(tabled(replace(led.law, planned=chosen)), pair[1], course.columns.shape[1])
            # The heater tells its state once a slot; the rows are ticks.
            holding = [line["time_s"] for line in course.lines if line.get("state") == "holding"]
            inside = (course.columns[0] >= holding[0]) & (course.columns[0] <= holding[-1])
            apart = float(np.abs(course.columns[5] - hottest).max())
            low, high = float(course.columns[3, inside].min()), float(course.columns[4, inside].max())
            pairs.append(Pair(b, apart, low, high, course.reason))
    return pairs


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    pairs = measure(options.rigs, options.seed)
    if options.json:
        print(json.dumps([asdict(pair) for pair in pairs]))
        return
    rows = [(f"{p.rig}", f"{p.apart:.3f}", f"{p.lowest:.1f}-{p.highest:.1f}", p.reason) for p in pairs]
    most = max(pair.apart for pair in pairs)
    note = f"at most {most:.3f} K apart over {len(pairs)} rigs, of which the first is that of the file"
    show([table("firmware and law", ("rig", "apart, K", "hold, degC", "ended"), rows)], [note])


if __name__ == "__main__":
    main()
