"""A two-tube robot with a body that follows its tip along a space curve, as well as helical tubes can.

Both tubes are deployed together, then the inner one alone. Each rotates in proportion to its translation. The unknowns
are curvature and natural twist of each tube, and its rotation per length. A least-squares fit minimises the distance
between the robot, at many lengths, and the start of the curve.

Result: a helix, and two helices of equal torsion in sequence, are followed without error, as theory predicts. The inner
tube needs the curvature of the second helix; the outer tube compensates it. For a curve with growing curvature the best
pair of helical tubes deviates by 0.6 mm.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import scipy.integrate

from tubeopt import ConcentricRobot, Equilibrium, EquilibriumBlock, Ipopt, Piece, Problem, Tube, forward_kinematics
from tubeopt.show.plots.style import save_figure

ROOT = Path(__file__).resolve().parents[1]

INNER, OUTER = (1.0e-3, 0.7e-3), (1.6e-3, 1.2e-3)
TOGETHER, ALONE = 50e-3, 30e-3
"""Deployed lengths of both tubes, and then of the inner one alone, m."""

PARTS = np.linspace(0.2, 1.0, 5)
"""Points of the arm, as fractions, with a distance from the curve in the fit."""

Curve = Callable[[np.ndarray], np.ndarray]


def curve_of(curvature: Callable[[float], float], torsion: float) -> Curve:
    """The curve of this curvature and torsion (1/m) by its arc length (m): from the origin, along z, towards -y."""

    def rate(s: float, y: np.ndarray) -> np.ndarray:
        t, normal, binormal = y[3:].reshape(3, 3)
        k = curvature(s)
        return np.concatenate([t, k * normal, torsion * binormal - k * t, -torsion * normal])

    start = np.array([0, 0, 0, 0, 0, 1, 0, -1, 0, 1, 0, 0], dtype=float)
    whole = scipy.integrate.solve_ivp(
        rate, (0.0, TOGETHER + ALONE), start, "DOP853", dense_output=True, rtol=1e-11, atol=1e-13, max_step=1e-3
    ).sol
    return lambda s: np.asarray(whole(s)[:3].T)


CURVES = {
    "helix": curve_of(lambda s: 15.0, 20.0),
    "two helices": curve_of(lambda s: 18.0 if s < TOGETHER else 9.0, 20.0),
    "growing curvature": curve_of(lambda s: 6.0 + 200.0 * s, 20.0),
}


def robot_of(x: np.ndarray) -> ConcentricRobot:
    """The robot of unknowns as in `fitted`."""
    inner = Tube.of_pieces(*INNER, [Piece(TOGETHER + ALONE, (x[0], 0.0, x[1]))], straight_length=40e-3)
    outer = Tube.of_pieces(*OUTER, [Piece(TOGETHER, (x[2], 0.0, x[3]))], straight_length=20e-3)
    return ConcentricRobot((inner, outer))


def ways(count: int) -> list[tuple[float, float]]:
    """Withdrawal of the inner tube alone, and of both tubes, m, at `count` lengths in each phase."""
    first = [(back, 0.0) for back in np.linspace(0.0, ALONE, count).tolist()]
    return first + [(ALONE, back) for back in np.linspace(0.0, TOGETHER - 10e-3, count)[1:].tolist()]


def turns(x: Any, alone: float, both: float) -> list[Any]:
    """Rotations of the tubes, rad, at these withdrawals."""
    return [x[6] - x[5] * alone - x[4] * both, x[7] - x[4] * both]


def deployed(x: np.ndarray, count: int) -> list[Equilibrium]:
    """The robot at `count` lengths in each phase."""
    robot = robot_of(x)
    results: list[Equilibrium] = []
    for alone, both in ways(count):
        shift = robot.home_translations - np.array([alone + both, both])
        results.append(forward_kinematics(robot, np.array(turns(x, alone, both)), shift))
    return results


def offsets(curve: Curve, equilibrium: Equilibrium) -> np.ndarray:
    """(m, 3) from the curve to the points of the robot at the same arc lengths, m."""
    return np.asarray(equilibrium.position - curve(equilibrium.arc_length))


def deviation(curve: Curve, at: list[Equilibrium]) -> float:
    """Largest distance (m) of the robot from the curve at any of the lengths."""
    return max(float(np.linalg.norm(offsets(curve, each), axis=1).max()) for each in at)


def fitted(curve: Curve, start: np.ndarray) -> np.ndarray:
    """(8,) the best tubes and rotations.

    Curvature and twist of the inner and the outer tube, 1/m. Rotation per withdrawal of both, and of the inner one
    alone, rad/m. Final rotations of both, rad.
    """
    scale = np.array([10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 0.3, 0.3])
    problem = Problem()
    x = problem.variable("tubes and turns", 8, guess=start, scale=scale)
    tubes = {"piece_curvature": x[[0, 2]], "piece_twist": x[[1, 3]]}
    off = 0.0
    for near, (alone, both) in zip(deployed(start, 4), ways(4), strict=True):
        block = EquilibriumBlock(problem, near, rotations=turns(x, alone, both), tubes=tubes, refinement=0)
        for part, goal in zip(PARTS, curve(PARTS * near.arc_length[-1]), strict=True):
            off += ca.sumsqr(1e3 * (block.position(part) - goal))
    problem.minimize(off)
    return np.asarray(problem.solve(Ipopt(tolerance=1e-10)).value(x))


def main(out: Path, samples: int = 12) -> list[Path]:
    """Fit tubes to every curve, test other lengths than the fitted ones, and save the picture into `out`."""
    figure, axes = plt.subplots(1, len(CURVES), figsize=(9.6, 3.6), layout="constrained", sharey=True)
    x = np.array([10.0, 10.0, 15.0, 10.0, 10.0, 10.0, 0.0, 0.0])
    for panel, (name, curve) in zip(axes, CURVES.items(), strict=True):
        # Every fit starts from the tubes of the curve before.
        x = fitted(curve, x)
        at = deployed(x, samples)
        worst, margin = deviation(curve, at), min(each.margin for each in at)
        print(
            f"{name}: inner {x[0]:.3f}, twist {x[1]:.3f}; outer {x[2]:.3f}, twist {x[3]:.3f} per m; off by at most "
            f"{worst * 1e3:.2g} mm at {len(at)} lengths; least margin {margin:.3f}"
        )
        line = curve(np.linspace(0.0, TOGETHER + ALONE, 300)) * 1e3
        for axis, label in ((0, "x"), (1, "y")):
            panel.plot(line[:, 2], line[:, axis], color="0.78", lw=6, solid_capstyle="round", label="curve")
            for k, colour in ((-1, "#D55E00"), (samples - 1, "#E69F00"), (0, "#0072B2")):
                points = at[k].position * 1e3
                long = f"robot, {at[k].arc_length[-1] * 1e3:.0f} mm long"
                panel.plot(points[:, 2], points[:, axis], color=colour, lw=1.4, label=long)
                panel.plot(points[-1, 2], points[-1, axis], "o", ms=4, color=colour)
            panel.text(line[-1, 2] + 1.5, line[-1, axis], label, va="center")
        panel.set_title(f"{name}: off by {worst * 1e3:.1g} mm" if worst > 1e-6 else f"{name}: no error", fontsize=9)
        panel.set_xlabel("z (mm)")
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("x and y (mm)")
    axes[0].legend(
        *(each[:4] for each in axes[0].get_legend_handles_labels()), frameon=False, fontsize=8, loc="lower left"
    )
    picture = out / "own_follow_the_leader.png"
    save_figure(figure, picture)
    plt.close(figure)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    parser.add_argument("--samples", type=int, default=12, help="lengths to sample in each phase")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
