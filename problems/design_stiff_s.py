"""The stiffest S-shaped inner tube in an outer tube with 1.6 mm outer diameter.

The inner tube bends to one side, then to the other, so it is made of pieces. A force of 20 mN pushes the tip to the
side at two task poses. The diameters are free; clearance and walls are fixed. No rotation may snap.

Result: a thicker inner tube is stiffer where it is alone, but the outer tube then has a thinner wall. The optimum lies
between. Separate solutions for many diameters have their optimum at the same diameter.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tubeopt
from tubeopt import ConcentricRobot, Piece, Tube
from tubeopt.design import Free, Nesting, Objective, Poses, SnapFree, Wall
from tubeopt.show.plots.style import save_figure

ROOT = Path(__file__).resolve().parents[1]

SHEATH, CLEARANCE, WALL = 1.6e-3, 0.1e-3, 0.1e-3
"""Outer diameter, difference of diameters, and least wall, m."""

FORCE = (0.0, 0.02, 0.0)
"""On the tip, N."""

POSES = Poses(((0.0, 0.0), (0.0, 2.0)), ((0.0, 0.0), (-0.01, 0.0)))
"""Rotations and translations of the tubes."""


def robot(diameter: float, bore: float) -> ConcentricRobot:
    """Robot of an S-shaped tube with this outer diameter in a curved tube with this bore, m."""
    inner = Tube.of_pieces(diameter, 0.6e-3, [Piece(0.03, 12.0), Piece(0.04, -12.0)], straight_length=0.05)
    outer = Tube.of_pieces(SHEATH, bore, [Piece(0.035, 14.0), Piece(0.015, 0.0)], straight_length=0.02)
    return ConcentricRobot((inner, outer))


def deflection(diameter: float) -> float:
    """Displacement of the tip under the force, m: the larger one of the two poses, with the narrowest bore."""
    current = robot(diameter, diameter + CLEARANCE)
    moved = []
    for rotations, translations in zip(POSES.rotations, POSES.translations, strict=True):
        plain, pushed = (
            tubeopt.forward_kinematics(current, rotations, translations, load=load)
            for load in (None, tubeopt.Load(FORCE))
        )
        moved.append(float(np.linalg.norm(pushed.tip_position - plain.tip_position)))
    return max(moved)


def main(out: Path, samples: int = 25) -> list[Path]:
    """Design the diameters, save the picture into `out`, and return its path."""
    task = tubeopt.DesignTask(
        robot(0.9e-3, 1.05e-3),
        free=(Free("outer_diameter", (0,), 0.8e-3, 1.35e-3), Free("inner_diameter", (1,), 0.9e-3, 1.45e-3)),
        requirements=(POSES, SnapFree(0.05), Nesting(CLEARANCE), Wall(WALL)),
        objective=Objective("tip_deflection", tip_force=FORCE),
    )
    design = tubeopt.optimize_design(task)
    inner, outer = design.robot.tubes
    print(f"inner tube {inner.outer_diameter * 1e3:.3f} mm, bore {outer.inner_diameter * 1e3:.3f} mm")
    print(f"tip moved by {design.objective * 1e3:.3f} mm, certificate {design.certificate:.3f}")
    diameters = np.linspace(0.8e-3, 1.3e-3, samples)
    fig, ax = plt.subplots(layout="constrained")
    ax.plot(diameters * 1e3, [deflection(float(d)) * 1e3 for d in diameters], label="solved for each diameter")
    ax.plot(inner.outer_diameter * 1e3, design.objective * 1e3, "o", label="design")
    ax.set(xlabel="outer diameter of the inner tube (mm)", ylabel="tip moved by 20 mN (mm)")
    ax.legend()
    picture = out / "design_stiff_s.png"
    save_figure(fig, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
