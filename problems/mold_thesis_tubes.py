"""Molds for the tubes of the thesis: its eccentric tube, and the three concentric tubes on one plate.

The four mold materials of section 4.2.2 of the thesis are ranked for the eccentric tube.

Result: a tube is straighter than its groove after release; only trials determine this spring-back. The best material
conducts no current and stores little heat: calcium silicate.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.shaping import rank_mold_materials
from tubeopt.show.plots.mold import plot_materials, plot_mold
from tubeopt.show.plots.sheets import plot_setup_sheet

ROOT = Path(__file__).resolve().parents[1]
ROBOTS = ROOT / "configs" / "robots"


def main(out: Path) -> list[Path]:
    """Plan the molds, rank the materials, save the pictures into `out`, and return their paths."""
    pictures, molds = [], {}
    eccentric = tubeopt.load_robot(ROBOTS / "thesis_etr.yaml").tubes[0]
    concentric = tubeopt.load_robot(ROBOTS / "thesis_ctr.yaml").tubes
    for name, tubes in (("thesis_etr", [eccentric]), ("thesis_ctr", list(concentric))):
        mold = molds[name] = tubeopt.plan_mold(tubes)
        for groove in mold.grooves:
            cold, growth, stock = (x * 1e3 for x in (groove.cold.length, groove.growth, groove.stock_length))
            print(
                f"{name}, tube {groove.number}: groove {groove.width * 1e3:g} x {groove.depth * 1e3:g} mm, "
                f"cold ends {cold:.1f} mm, grows {growth:.2f} mm, cut {stock:.1f} mm"
            )
        pictures.append(out / f"mold_{name}.png")
        plot_mold(mold, pictures[-1])
    ratings = rank_mold_materials(eccentric)
    for rating in ratings:
        print(f"{rating.material.name}: {', '.join(rating.reasons)}")
    pictures += [out / "mold_materials.png", out / "mold_setup_sheet.png"]
    plot_materials(ratings, pictures[-2])
    plot_setup_sheet(molds["thesis_etr"], pictures[-1], title="eccentric tube of the thesis")
    return pictures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
