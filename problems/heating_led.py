"""The thesis' tube heated on a hundred rigs that nobody measured: with the schedule alone, and led by a thermocouple.

The thesis asks for temperature feedback. Here losses, gap, contacts, resistivity, diameters, ambient, battery and what
pulses lose are unknown all at once, as in a workshop; the law that the microcontroller runs has gains from the model.

One learns: what no schedule can hold, one thermocouple holds; and the tube's own resistance is no thermometer before
its slope was measured.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.runs.heating_study import LedHeating
from tubeopt.shaping.firmware.boards import Wiring
from tubeopt.show.plots.heating import plot_feedback

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 100) -> list[Path]:
    """Plan the heating, lead it, try the law on rigs, save the picture into `out`, and return the path."""
    rig = tubeopt.load_rig(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")
    assert rig.tube is not None
    plan = tubeopt.plan_heating(rig.tube, rig, tubeopt.HeatingSpec(objective="margin"))
    sensors = {"thermocouple": tubeopt.Thermocouple(), "resistance": tubeopt.TubeResistance()}
    laws = {name: tubeopt.design_feedback(plan, sensor, samples=samples) for name, sensor in sensors.items()}
    for sensor, led in laws.items():
        low, high = led.interval
        print(
            f"{sensor}: {100 * led.probability:.1f} % of rigs keep the window ({100 * low:.1f} to {100 * high:.1f} %)"
        )
    picture = out / "heating_led.png"
    plot_feedback(LedHeating(plan, laws["thermocouple"], Wiring(), rig.circuit.pwm_frequency), picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    parser.add_argument("--samples", type=int, default=100, help="rigs on which the law is tried")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
