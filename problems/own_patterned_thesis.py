"""The robot of the thesis made snap-free at its full curvature by slots, with the least material removed.

Slots in the curved parts reduce the bending stiffness more than the torsional stiffness. A slotted piece keeps the
fraction b of its bending stiffness, at least 0.2, and t = 1 - (1 - b) / 2 of its torsional stiffness. A workshop
measures these numbers on its own tubes; here they are assumed.

Result: nearly all slots are in the inner tube, which keeps 38 % of its bending stiffness. The middle tube keeps 94 %,
the outer tube stays whole. Then no rotation snaps, and every tube keeps its full curvature. Compare
`design_thesis_snap_free.py`, which straightens the tubes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import tubeopt
from tubeopt import ConcentricRobot, Piece, Tube
from tubeopt.design import count_snaps
from tubeopt.show.plots.style import save_figure

ROOT = Path(__file__).resolve().parents[1]

LEAST = 0.2
"""Least fraction of the bending stiffness that the workshop leaves."""

RESERVE = 0.05
"""Required certificate: the torsional stiffnesses may be smaller by this fraction."""


def torsion_factor(bending_factor: Any) -> Any:
    """Fraction of the torsional stiffness that remains at this fraction of the bending stiffness."""
    return 1 - (1 - bending_factor) / 2


def patterned(robot: ConcentricRobot, bending_factors: np.ndarray) -> ConcentricRobot:
    """The robot with slots in the curved parts of its tubes."""
    tubes = []
    for tube, b in zip(robot.tubes, bending_factors, strict=True):
        slotted = Piece(
            tube.curved_length,
            tube.curvature,
            bending_stiffness=float(b) * float(tube.bending_stiffness),
            torsional_stiffness=torsion_factor(float(b)) * float(tube.torsional_stiffness),
        )
        sizes = tube.outer_diameter, tube.inner_diameter
        tubes.append(Tube.of_pieces(*sizes, [slotted], straight_length=tube.straight_length, material=tube.material))
    return ConcentricRobot(tuple(tubes))


def least_pattern(robot: ConcentricRobot) -> np.ndarray:
    """(n,) bending factors with the least sum of squares of the removed fractions, for a positive certificate."""
    n = robot.n_tubes
    whole = tubeopt.forward_kinematics(patterned(robot, np.ones(n)), np.zeros(n))
    problem = tubeopt.Problem()
    bending = problem.variable("bending factors", n, guess=0.35, lower=LEAST, upper=1.0)
    tubes = {"piece_bending_factor": bending, "piece_torsion_factor": torsion_factor(bending)}
    block = tubeopt.EquilibriumBlock(problem, whole, tubes=tubes)
    block.certificate_at_least(RESERVE)
    problem.minimize(ca.sumsqr(1 - bending))
    return np.asarray(problem.solve().value(bending))


def main(out: Path, samples: int = 30) -> list[Path]:
    """Find the pattern, rotate the robot at random, and save the picture into `out`."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    assert isinstance(robot, ConcentricRobot)
    factors = least_pattern(robot)
    after = patterned(robot, factors)
    text = ", ".join(f"{b:.3f}" for b in factors)
    print(f"bending factors {text}; certificate {tubeopt.snap_free_certificate(after):.4f}")
    for name, one in (("before", robot), ("after", after)):
        snaps, turns = count_snaps(one, samples)
        print(f"{name}: {snaps} snaps on {turns} of {samples} random full turns forth and back")
    picture = out / "own_patterned_thesis.png"
    _draw(robot, after, factors, picture)
    return [picture]


def _draw(before: ConcentricRobot, after: ConcentricRobot, factors: np.ndarray, path: Path) -> None:
    """Remaining stiffness, and the tip angle of the inner tube over its rotation, before and after the design."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.6), layout="constrained")
    n = len(factors)
    left.bar(np.arange(1, n + 1) - 0.2, factors, 0.38, color="#0072B2", label="bending stiffness")
    left.bar(np.arange(1, n + 1) + 0.2, [torsion_factor(b) for b in factors], 0.38, color="#E69F00", label="torsional")
    left.axhline(LEAST, color="0.3", lw=0.8, ls="--", label="least bending stiffness that can be cut")
    left.set_xticks(range(1, n + 1))
    left.set_xlabel("tube, inner to outer")
    left.set_ylabel("fraction of the stiffness with slots")
    left.set_ylim(0, 1.3)
    left.set_yticks(np.linspace(0, 1, 6))
    left.legend(fontsize=8, frameon=False, loc="upper left")
    turn = np.radians(np.arange(0.0, 361.0, 3.0))
    motion = np.zeros((len(turn), n))
    motion[:, 0] = turn
    for robot, colour, name in ((before, "#D55E00", "thesis"), (after, "#009E73", "slotted")):
        passed = tubeopt.follow(robot, motion)
        tips = np.degrees([equilibrium.tip_rotations[0] for equilibrium in passed.equilibria])
        right.plot(np.degrees(turn), tips, ".", ms=3, color=colour, label=name)
    right.plot([0, 360], [0, 360], color="0.7", lw=0.8, zorder=0, label="without torsion")
    right.set_xlabel("rotation of the inner tube at its base (deg)")
    right.set_ylabel("rotation at its tip (deg)")
    right.set_xticks(range(0, 361, 60))
    right.set_yticks(range(0, 361, 60))
    right.legend(fontsize=8, frameon=False)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    parser.add_argument("--samples", type=int, default=30, help="full turns")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
