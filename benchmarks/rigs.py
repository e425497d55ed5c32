"""How many uncertain rigs keep the window when they heat the thesis' tube: led by a thermometer, and by the schedule.

    python -m benchmarks.rigs [--rigs N] [--seed N] [--objective NAME] [--json]

Everything that a workshop has not measured is unknown at once (`Uncertainty.of_a_workshop`): losses, gap, contacts,
resistivity and its slope, the board's conductivity, heat capacity, inner diameter, ambient, charge, what pulses lose,
and the bias of the sensor. Gains and set-point are chosen on other rigs than those that are counted.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict, dataclass, replace

from tubeopt import Camera, HeatingSpec, Thermocouple, TubeResistance, design_feedback, load_rig, plan_heating
from tubeopt.shaping.firmware.boards import BOARDS
from tubeopt.shaping.heating.controller import wilson

from .timing import ROOT

RIG = ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml"


@dataclass(frozen=True)
class Kept:
    """Share of rigs that keep window and limit, its 95 % interval, and the hottest point of any above the limit, K."""

    sensor: str
    share: float
    interval: tuple[float, float]
    above_limit: float


def measure(rigs: int, seed: int, objective: str) -> list[Kept]:
    """By every sensor, and at last by none."""
    rig = load_rig(RIG)
    assert rig.tube is not None
    rig = replace(rig, circuit=replace(rig.circuit, pwm_frequency=BOARDS["uno"].frequencies[0]))
    plan = plan_heating(rig.tube, rig, HeatingSpec(objective=objective))
    results = []
    for sensor in (Thermocouple(), Camera(), TubeResistance()):
        led = design_feedback(plan, sensor, samples=rigs, seed=seed)
        results.append(Kept(sensor.name, led.probability, led.interval, float(led.top.max() - led.limit)))
    return [*results, Kept("none", led.open_loop, wilson(round(rigs * led.open_loop), rigs), float("nan"))]


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--objective", default="margin", help="of the schedule: time or margin")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = measure(options.rigs, options.seed, options.objective)
    if options.json:
        print(json.dumps([asdict(kept) for kept in results]))
        return
    for kept in results:
        low, high = (100 * end for end in kept.interval)
        hottest = "" if math.isnan(kept.above_limit) else f", hottest point {kept.above_limit:+.1f} K from the limit"
        share = f"{100 * kept.share:5.1f} % of {options.rigs} rigs ({low:.1f} to {high:.1f} %)"
        print(f"{kept.sensor:12} {share}{hottest}")


if __name__ == "__main__":
    main()
