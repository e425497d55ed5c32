"""The tightest turn of three tubes that cannot snap within their stroke, at 1 % strain, for several margins.

Result: a larger margin costs curvature. The multipliers of the optimum predict this cost.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tubeopt.design import optimize_design, pareto_front
from tubeopt.runs.design_study import DesignStudy
from tubeopt.runs.study_file import load_study
from tubeopt.show.plots.design import plot_front

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Design, compute the Pareto front, save its picture into `out`, and return its path."""
    study = load_study(ROOT / "configs" / "studies" / "design_tightest_turn.yaml")
    assert isinstance(study, DesignStudy)
    design = optimize_design(study.task())
    bends = ", ".join(f"{tube.curvature:.2f}" for tube in design.robot.tubes)
    print(f"tip curvature {design.objective:.4f} per m with curvatures {bends} per m, in {design.seconds:.1f} s")
    print(f"certificate {design.certificate:.4f}; worst cases added in {design.rounds} rounds")
    for price in design.sensitivities:
        print(price.sentence)
    front = pareto_front(study.task(), [0.05, 0.35, 0.65, 0.9], start=design.attempt)
    picture = out / "design_tightest_turn.png"
    plot_front(front, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
