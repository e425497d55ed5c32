"""The robot of the thesis follows a helix of targets, each solved from the last one, without a snap.

Result: solved in sequence, all targets are reached on one branch. The remaining freedom of the joints increases the
margin.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.show.plots.workspace import plot_targets

ROOT = Path(__file__).resolve().parents[1]
CENTRE_MM, RADIUS_MM, RISE_MM, TURNS, STEP_MM = (55.0, 10.0, 115.0), 22.0, 50.0, 2.0, 0.5


def helix() -> np.ndarray:
    """(T, 3) targets about STEP_MM apart, m."""
    length = TURNS * 2 * np.pi * RADIUS_MM
    t = np.linspace(0.0, 1.0, int(np.hypot(length, RISE_MM) / STEP_MM) + 1)
    angle = 2 * np.pi * TURNS * t
    around = RADIUS_MM * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(t)])
    return (np.array(CENTRE_MM) + around + np.outer(t, [0.0, 0.0, RISE_MM])) * 1e-3


def main(out: Path) -> list[Path]:
    """Follow the helix, check the path for snaps, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    session = tubeopt.IkSession(robot, min_margin=0.1)
    solutions = [session.solve(target) for target in helix()]
    path = tubeopt.follow(
        robot,
        [each.rotations for each in solutions],
        [each.translations for each in solutions],
        start=solutions[0].equilibrium,
    )
    off = max(
        np.linalg.norm(a.tip_position - b.target_position) for a, b in zip(path.equilibria, solutions, strict=True)
    )
    print(f"{len(solutions)} targets, {len(path.snaps)} snaps, the tip stays within {off * 1e9:.2g} nm of them")
    print(f"margin at least {min(each.margin for each in solutions):.3f}")
    picture = out / "inverse_helix.png"
    plot_targets(solutions, picture, title=f"{robot.name} on a helix")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
