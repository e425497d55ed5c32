"""The shortest robot with a tip that reaches six targets around a corner, inside a corridor at every target.

Result: lengths, curvatures and the joint values of all poses are unknowns of one problem. The margin at every pose and
on every path between poses is a constraint.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tubeopt.design import Reach, optimize_design
from tubeopt.design.requirements import of_kind
from tubeopt.runs.design_study import DesignStudy
from tubeopt.runs.study_file import load_study
from tubeopt.show.plots.design import plot_poses

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Design, print what was reached, save the picture into `out`, and return its path."""
    study = load_study(ROOT / "configs" / "studies" / "design_corner.yaml")
    assert isinstance(study, DesignStudy)
    task = study.task()
    design = optimize_design(task)
    (reach,) = of_kind(task.requirements, Reach)
    gaps = [
        np.linalg.norm(pose.tip_position - target.position)
        for pose, target in zip(design.equilibria, reach.targets, strict=True)
    ]
    print(f"length {design.objective * 1e3:.2f} mm, in {design.seconds:.1f} s")
    print(f"the tip is within {max(gaps) * 1e3:.4f} mm of all targets")
    for check in design.verification.checks:
        print(f"{check.what}: {check.value}")
    picture = out / "design_corner.png"
    plot_poses(design, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
