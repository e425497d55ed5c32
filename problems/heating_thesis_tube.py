"""The eccentric tube of the thesis on its battery rig: the schedule of duty counts in a mold of calcium silicate.

Section 4.2 of the thesis heats for one minute at a duty found by trial. Here the duty follows from the rig file. The
curved part stays at 500 to 550 degC, no point gets hotter, and the voltage of the battery selects the table.

Result: no constant duty is right. A schedule from the model heats the tube fast, keeps it in the window, and stays
below the limit.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.shaping.heating.robust import assess
from tubeopt.show.plots.heating import plot_heating

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Plan the heating, save its picture into `out`, and return the path."""
    rig = tubeopt.load_rig(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")
    assert rig.tube is not None
    plan = tubeopt.plan_heating(rig.tube, rig, tubeopt.HeatingSpec(objective="margin"))
    picture = out / "heating_thesis_tube.png"
    plot_heating(plan, picture, band=assess(plan, samples=32))
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
