"""The tightest certified turn of an eccentric robot with a free channel of 1.2 mm in its middle.

Curvature, diameter and offset of three equal tubes are free. The sheath is as wide as that of the thesis, the tubes are
as long, and have at least 0.3 of their stiffness. The certificate of 0.05 proves that no rotation snaps, by the balance
of moments of the thesis. It is no proof for the energy model, in which ends of tubes pass each other.

Result: a turning radius of 71.5 mm, where the robot of the thesis has 120 mm and no room between its tubes. But in the
energy model it has two stable equilibria at some rotations: it may snap where the ends of two tubes meet.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy

import tubeopt
from tubeopt.robots.eccentric import EccentricRobot, free_channel, sheath_inner_diameter
from tubeopt.typing import Array

ROOT = Path(__file__).resolve().parents[1]
CHANNEL, MARGIN, STIFFNESS = 1.2e-3, 0.05, 0.3
"""Diameter of the channel, m; certificate; fraction of the bending stiffness of the thesis."""


def robot_of(x: Array, thesis: EccentricRobot) -> EccentricRobot:
    """Robot with the curvature (1/m), and outer diameter and offset (mm), of `x`; walls are in proportion."""
    curvature, outer, offset = x[0], 1e-3 * x[1], 1e-3 * x[2]
    inner = outer * thesis.tube.inner_diameter / thesis.tube.outer_diameter
    tube = replace(thesis.tube, outer_diameter=outer, inner_diameter=inner, curvature=curvature)
    return replace(thesis, tube=tube, offset=offset, name="eccentric robot with a channel")


def main(out: Path, samples: int = 200) -> list[Path]:
    """Design the robot, save its picture into `out`, and return its path."""
    thesis = tubeopt.load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    sheath = 1e3 * sheath_inner_diameter(thesis.tube.outer_diameter)
    constraints = [
        lambda x: tubeopt.snap_free_certificate(robot_of(x, thesis)) - MARGIN,
        lambda x: 2 * x[2] - x[1] - 1e3 * CHANNEL,
        lambda x: sheath - 2 * x[2] - x[1],
        lambda x: robot_of(x, thesis).tube.bending_stiffness / thesis.tube.bending_stiffness - STIFFNESS,
    ]
    start = np.array([thesis.tube.curvature, 1.45, 1.33])
    optimum = scipy.optimize.minimize(
        lambda x: -x[0] / thesis.tube.curvature,
        start,
        method="SLSQP",
        bounds=[(5.0, 30.0), (0.8, 1.92), (1.0, 2.0)],
        constraints=[{"type": "ineq", "fun": each} for each in constraints],
    )
    assert optimum.success, optimum.message
    robot = robot_of(optimum.x, thesis)
    bundle = robot.bundle()
    print(
        f"curvature {robot.tube.curvature:.2f} per m, tubes of {1e3 * robot.tube.outer_diameter:.3f} mm at "
        f"{1e3 * robot.distance:.3f} mm"
    )
    print(f"certificate {tubeopt.snap_free_certificate(robot):.4f}, thesis {tubeopt.snap_free_certificate(thesis):.4f}")
    room = free_channel(replace(bundle, tubes=tuple(replace(t, inner_diameter=1e-6) for t in bundle.tubes)))
    print(f"channel between the tubes {1e3 * room.diameter:.3f} mm, sheath {1e3 * bundle.least_sheath_diameter:.3f} mm")
    for name, each in (("this robot", robot), ("thesis", thesis)):
        bent = each.bundle().fk(np.zeros(3))
        print(f"{name}: turning radius {1e3 / np.linalg.norm(bent.curvature[0]):.1f} mm by the energy")
    turns = np.random.default_rng(0).uniform(-np.pi, np.pi, (samples, 3))
    least = min(bundle.fk(rotations).margin for rotations in turns)
    print(f"least margin of the energy at {samples} random rotations: {least:.3f}")
    # Along this path the ends of the first and the third tube are about to meet.
    first, last = np.radians([-125.85, 48.13, 19.81]), np.radians([-131.45, 56.04, 39.55])
    pose = bundle.fk(first)
    for x in np.linspace(0, 1, 9)[1:]:
        pose = bundle.fk(first + x * (last - first), start=pose)
    other = bundle.fk(last)
    apart = 1e3 * np.linalg.norm(pose.tip_position - other.tip_position)
    print(f"two stable equilibria of the energy at {np.round(np.degrees(last), 2)} deg: tips {apart:.2f} mm apart")
    print(f"margins {pose.margin:.4f} and {other.margin:.4f}, energies {pose.energy:.6f} and {other.energy:.6f} J")
    figure, axes = plt.subplots(figsize=(4, 4))
    for name, one in (("this robot", bundle), ("robot of the thesis", thesis.bundle())):
        line = 1e3 * one.fk(np.zeros(3)).position
        axes.plot(-line[:, 1], line[:, 2], label=name)
    axes.set(xlabel="y (mm)", ylabel="z (mm)", aspect="equal")
    axes.legend(frameon=False)
    path = out / "design_eccentric_channel.png"
    figure.savefig(path, bbox_inches="tight")
    plt.close(figure)
    return [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
