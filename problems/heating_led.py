"""The tube of the thesis heated on a hundred unknown rigs: with the schedule alone, and controlled by a thermocouple.

The thesis proposes temperature feedback. All parameters are uncertain at once, as in a workshop: losses, gap, contacts,
resistivity, diameters, ambient temperature, battery and switching losses. The controller of the microcontroller has
gains from the model.

Result: no schedule alone keeps the window on these rigs; one thermocouple does. The resistance of the tube is no
thermometer until its slope has been measured.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.runs.heating_study import ClosedLoopHeating
from tubeopt.shaping.firmware.boards import Wiring
from tubeopt.show.plots.heating import plot_feedback

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 100) -> list[Path]:
    """Plan the heating, design the controller, test it on rigs, save the picture into `out`, and return the path."""
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
    plot_feedback(ClosedLoopHeating(plan, laws["thermocouple"], Wiring(), rig.circuit.pwm_frequency), picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    parser.add_argument("--samples", type=int, default=100, help="number of rigs for the test")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
