"""The tightest snap-free turn of three tubes from stock, with the sizes of published robots.

Result: most combinations need no design. Bounds from the limits on dimensions exclude them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tubeopt.design import choose_from_stock
from tubeopt.runs.design_parts import load_stock
from tubeopt.runs.design_study import DesignStudy
from tubeopt.runs.study_file import load_study
from tubeopt.show.plots.design import plot_stock

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Choose, print the best, save the picture into `out`, and return its path."""
    study = load_study(ROOT / "configs" / "studies" / "design_stock.yaml")
    assert isinstance(study, DesignStudy)
    task = study.task()
    choice = choose_from_stock(task, load_stock(ROOT / "configs" / "tubes" / "stock.yaml"), clearance=0.05e-3, keep=5)
    print(f"{len(choice.candidates)} choices nest; {choice.count('design')} designed, {choice.count('pruned')} pruned")
    for one in choice.candidates[:5]:
        assert one.objective is not None
        print(f"{', '.join(size.name for size in one.sizes)}: {one.objective:.3f} per m")
    picture = out / "design_from_stock.png"
    plot_stock(choice, picture, task=task)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
