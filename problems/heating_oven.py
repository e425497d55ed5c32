"""The steel mold of the thesis in an oven: soak time, quench, and the radius of the cold tube.

Section 4.2.2 of the thesis first heated half-inch steel plates in an oven, which took long, and then went to a battery.
Here the time follows from heat conduction in the mold, convection and radiation.

Result: the 5.5 kg of steel need 29 minutes to warm through, 18 times the whole heating by the battery. Steel grows
more than nitinol: a groove of 120.00 mm gives a cold tube of 120.19 mm.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.show.plots.heating import plot_oven

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Plan the oven, save its picture into `out`, and return the path."""
    oven = tubeopt.load_oven(ROOT / "configs" / "ovens" / "steel_slab.yaml")
    assert oven.tube is not None
    plan = tubeopt.plan_oven(oven.tube, oven)
    print(
        f"soak: {plan.soak_time / 60:.0f} min: {plan.warm_time / 60:.0f} min to warm {plan.mold_mass:.1f} kg, then hold"
    )
    print(f"radius of the cold tube: {1e3 * plan.cold_radius:.2f} mm; mill {1e3 * plan.groove_radius:.2f} mm")
    picture = out / "heating_oven.png"
    plot_oven(plan, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
