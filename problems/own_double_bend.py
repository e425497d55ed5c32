"""A two-tube robot for a given double bend: the outer tube is S-shaped, the inner one extends beyond it.

The target curve goes 40 mm to one side and 40 mm to the other, with radii of 60 and 45 mm in one plane. The unknowns
are the curvatures of the two pieces of each tube. A least-squares fit minimises the distance from the curve, at full
length and while the inner tube is withdrawn into the outer one.

Result: at full length many pairs of tubes fit equally well, since only the stiffness-weighted mean of the curvatures
matters. If the robot also follows the curve while it grows, one pair remains: an inner tube of constant curvature, free
to slide, and an S-shaped outer tube that compensates it. It cannot snap at any rotation, although two plain tubes of
these curvatures would: an S and an arc cannot oppose each other along the whole length. The certificate, exact for two
tubes, is 0.15: the margin in the plane at the shortest length.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    EquilibriumBlock,
    Ipopt,
    Piece,
    Problem,
    Tube,
    forward_kinematics,
    snap_free_certificate,
)
from tubeopt.show.plots.style import save_figure

ROOT = Path(__file__).resolve().parents[1]

FIRST, SECOND = 40e-3, 40e-3
RADII = 60e-3, 45e-3
INNER, OUTER = (1.0e-3, 0.7e-3), (1.6e-3, 1.2e-3)
OUT = 15e-3
"""Length of the inner tube in front of the outer one at full length, m."""

DRAWN_BACK = (0.0, 5e-3, 10e-3, 15e-3)
"""Withdrawal of the inner tube, m."""

PARTS = np.linspace(0.1, 1.0, 10)
"""Points of the arm, as fractions, with a distance from the target curve in the fit."""


def way(s: np.ndarray) -> np.ndarray:
    """(N, 3) points of the double bend at arc lengths (N,), m; it begins along z and bends towards -y."""
    heading = np.where(s < FIRST, s / RADII[0], FIRST / RADII[0] - (s - FIRST) / RADII[1])
    first = RADII[0] * np.column_stack([1 - np.cos(heading), np.sin(heading)])
    turn = FIRST / RADII[0]
    joint = RADII[0] * np.array([1 - np.cos(turn), np.sin(turn)])
    second = joint + RADII[1] * np.column_stack([np.cos(heading) - np.cos(turn), np.sin(turn) - np.sin(heading)])
    plane = np.where((s < FIRST)[:, None], first, second)
    return np.column_stack([np.zeros(len(s)), -plane[:, 0], plane[:, 1]])


def robot_of(x: np.ndarray) -> ConcentricRobot:
    """The robot with curvatures (1/m) of the pieces of the inner tube and of the outer tube."""
    inner = Tube.of_pieces(*INNER, [Piece(FIRST, x[0]), Piece(SECOND, x[1])], straight_length=40e-3)
    outer = Tube.of_pieces(*OUTER, [Piece(FIRST, x[2]), Piece(SECOND - OUT, x[3])], straight_length=20e-3)
    return ConcentricRobot((inner, outer))


def solved(robot: ConcentricRobot, back: float) -> Equilibrium:
    """The robot with the inner tube withdrawn, m; both curves lie in one plane."""
    return forward_kinematics(robot, np.zeros(2), robot.home_translations - np.array([back, 0.0]))


def fitted() -> np.ndarray:
    """(4,) curvatures (1/m) of the best pair: one program, with a block for every length."""
    start = np.array([8.0, -8.0, 1 / RADII[0], -1 / RADII[1]])
    problem = Problem()
    bends = problem.variable("curvatures", 4, guess=start, scale=10.0)
    off = 0.0
    for back in DRAWN_BACK:
        block = EquilibriumBlock(problem, solved(robot_of(start), back), tubes={"piece_curvature": bends})
        length = FIRST + SECOND - back
        for part, goal in zip(PARTS, way(PARTS * length), strict=True):
            off += ca.sumsqr(1e3 * (block.position(part) - goal))
    problem.minimize(off)
    return np.asarray(problem.solve(Ipopt(tolerance=1e-10)).value(bends))


def _offsets(equilibrium: Equilibrium) -> np.ndarray:
    """(3 m,) coordinates of the points of the centreline minus those of the target curve at the same arc lengths, m."""
    return np.asarray((equilibrium.position - way(equilibrium.arc_length)).ravel())


def main(out: Path, samples: int = 30) -> list[Path]:
    """Fit the tubes, sample the deviation of the robot while it grows, and save the picture into `out`."""
    x = fitted()
    robot = robot_of(x)
    print("inner tube {:.3f}, {:.3f}; outer tube {:.3f}, {:.3f} per m".format(*x))
    backs = np.linspace(0.0, OUT, samples)
    grown = [solved(robot, float(back)) for back in backs]
    off = [float(np.abs(_offsets(each)).max()) for each in grown]
    print(f"off the target curve by at most {max(off) * 1e6:.2f} um at {samples} lengths")
    proved = min(snap_free_certificate(robot, each.translations) for each in grown)
    print(f"least margin {min(each.margin for each in grown):.4f}, least certificate {proved:.4f}")
    picture = out / "own_double_bend.png"
    _draw(x, grown, picture)
    return [picture]


def _draw(x: np.ndarray, grown: list[Equilibrium], path: Path) -> None:
    """The target curve with the robot at three lengths, and the curvatures of its tubes."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.6), layout="constrained")
    line = way(np.linspace(0.0, FIRST + SECOND, 400)) * 1e3
    left.plot(line[:, 2], line[:, 1], color="0.75", lw=7, solid_capstyle="round", label="way")
    for k, colour in ((0, "#0072B2"), (len(grown) // 2, "#E69F00"), (len(grown) - 1, "#D55E00")):
        points = grown[k].position * 1e3
        length = grown[k].arc_length[-1] * 1e3
        left.plot(points[:, 2], points[:, 1], color=colour, lw=1.6, label=f"robot, {length:.0f} mm long")
        left.plot(points[-1, 2], points[-1, 1], "o", ms=4, color=colour)
    left.set_aspect("equal")
    left.set_xlabel("z (mm)")
    left.set_ylabel("y (mm)")
    left.legend(fontsize=8, frameon=False)
    for tube, colour, ends, values in (
        ("inner", "#D55E00", (0, FIRST, FIRST + SECOND), x[:2]),
        ("outer", "#0072B2", (0, FIRST, FIRST + SECOND - OUT), x[2:]),
        ("way", "0.6", (0, FIRST, FIRST + SECOND), (1 / RADII[0], -1 / RADII[1])),
    ):
        right.stairs(values, np.array(ends) * 1e3, baseline=None, color=colour, lw=2.0, label=tube)
    right.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    right.set_xlabel("arc length of the curved part (mm)")
    right.set_ylabel("curvature (1/m)")
    right.legend(fontsize=8, frameon=False)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    save_figure(figure, path)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    parser.add_argument("--samples", type=int, default=30, help="lengths to sample")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
