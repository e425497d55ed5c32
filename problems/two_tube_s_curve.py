"""The S-curve of two tubes, with its closed form in Jacobi's elliptic functions.

Two tubes have equal Poisson's ratio nu, overlap L and transmission l; c = (1 + nu) kappa_1 kappa_2. The relative tip
angle 2 acos(k) belongs to the relative input  2 acos(k cd(L sqrt(c))) + 2 l sqrt(c) k k' sd(L sqrt(c)).

Result: the robot snaps at the turning points of the S. Continuation and closed form agree to ten digits, so folds
without a closed form can be trusted.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipj

import tubeopt
from tubeopt.show.plots import plot_branch

ROOT = Path(__file__).resolve().parents[1]
DOTS = 25


def closed_form(tubes: Sequence[tubeopt.Tube], tips: NDArray[np.float64]) -> NDArray[np.float64]:
    """Relative input angles of relative tip angles, rad, at home."""
    inner, outer = tubes
    root_c = np.sqrt((1 + inner.material.poisson_ratio) * inner.curvature * outer.curvature)
    k, complement = np.cos(tips / 2), np.sin(tips / 2)
    sn, cn, dn, _ = ellipj(root_c * inner.curved_length, k**2)
    wound = 2 * inner.straight_length * root_c * k * complement * sn / dn
    return np.asarray(2 * np.arccos(k * cn / dn) + wound)


def main(out: Path) -> list[Path]:
    """Follow the branch, compare it, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "two_tube.yaml")
    branch = tubeopt.trace_branch(robot, (0.0, 0.0), (2 * np.pi, 0.0))
    inputs = branch.rotations[:, 0] - branch.rotations[:, 1]
    tips = branch.tip_rotations[:, 0] - branch.tip_rotations[:, 1]
    error = np.abs(inputs - closed_form(robot.tubes, tips)).max()
    print(f"{len(tips)} points differ from the closed form by at most {error:.1e} rad")
    dots = np.linspace(0, 2 * np.pi, DOTS)
    picture = out / "two_tube_s_curve.png"
    plot_branch(branch, picture, dots=np.column_stack([closed_form(robot.tubes, dots), dots]))
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
