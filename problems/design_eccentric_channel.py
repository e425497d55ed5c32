"""The tightest certified turn of an eccentric robot with a free channel of 1.2 mm in its middle.

Curvature, diameter and offset of three tubes are free. The sheath is as wide as that of the thesis, the longest tube is
as long, and each has at least 0.3 of the stiffness. By the energy of the tubes, each with its own length, an arm jumps
where the order of their ends changes. So each tube is shorter than the one before, by as much as it takes to keep the
order at all rotations. The certificate of 0.05 then proves that no rotation snaps.

Result: a turning radius of 76.2 mm, where the robot of the thesis has 120 mm and no room between its tubes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy

import tubeopt
from tubeopt.robots.eccentric import BundleRobot, EccentricRobot, free_channel, sheath_inner_diameter
from tubeopt.typing import Array

ROOT = Path(__file__).resolve().parents[1]
CHANNEL, MARGIN, STIFFNESS = 1.2e-3, 0.05, 0.3
"""Diameter of the channel, m; certificate; fraction of the bending stiffness of the thesis."""

RESERVE = 1.08
"""Difference of the lengths of two tubes, relative to the one that a circular arc of their precurvature takes."""


def robot_of(x: Array, thesis: EccentricRobot) -> BundleRobot:
    """Robot with the curvature (1/m), and outer diameter and offset (mm), of `x`; walls are in proportion."""
    curvature, outer, offset = x[0], 1e-3 * x[1], 1e-3 * x[2]
    inner = outer * thesis.tube.inner_diameter / thesis.tube.outer_diameter
    tube = replace(thesis.tube, outer_diameter=outer, inner_diameter=inner, curvature=curvature)
    # Two tubes are sqrt(3) times the offset apart: in an arc their lengths differ by that times its angle.
    step = RESERVE * np.sqrt(3) * offset * curvature * tube.curved_length
    tubes = tuple(tube.resized("curved_length", tube.curved_length - k * step) for k in range(3))
    like = thesis.bundle()
    return replace(like, tubes=tubes, offset=(offset,) * 3, carriages=None, name="eccentric robot with a channel")


def main(out: Path, samples: int = 200) -> list[Path]:
    """Design the robot, save its picture into `out`, and return its path."""
    thesis = tubeopt.load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    sheath = 1e3 * sheath_inner_diameter(thesis.tube.outer_diameter)
    stiffness = thesis.tube.bending_stiffness
    constraints = [
        lambda x: tubeopt.snap_free_certificate(robot_of(x, thesis)) - MARGIN,
        lambda x: 2 * x[2] - x[1] - 1e3 * CHANNEL,
        lambda x: sheath - 2 * x[2] - x[1],
        lambda x: robot_of(x, thesis).tubes[0].bending_stiffness / stiffness - STIFFNESS,
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
    tube, certificate = robot.tubes[0], tubeopt.certify(robot)
    lengths = np.round([1e3 * each.curved_length for each in robot.tubes], 2)
    print(
        f"curvature {tube.curvature:.2f} per m, tubes of {1e3 * tube.outer_diameter:.3f} mm at "
        f"{1e3 * robot.offset[0]:.3f} mm, of lengths {lengths} mm"
    )
    print(f"certificate {certificate.margin:.4f}: {certificate.status}")
    print(f"with tubes of equal length: {tubeopt.certify(replace(robot, tubes=(tube,) * 3)).obstacle}")
    room = free_channel(replace(robot, tubes=tuple(replace(each, inner_diameter=1e-6) for each in robot.tubes)))
    print(f"channel between the tubes {1e3 * room.diameter:.3f} mm, sheath {1e3 * robot.least_sheath_diameter:.3f} mm")
    for name, each in (("this robot", robot), ("thesis", thesis.bundle())):
        bent = each.fk(np.zeros(3))
        print(f"{name}: turning radius {1e3 / np.linalg.norm(bent.curvature[0]):.1f} mm by the energy")
    turns = np.random.default_rng(0).uniform(-2 * np.pi, 2 * np.pi, (samples, 2, 3))
    ends = [robot.fk(end, start=robot.fk(start)) for start, end in turns]
    snaps = [tubeopt.find_snap(robot, (start, None), (end, None)) for start, end in turns]
    print(f"least margin found {tubeopt.worst_margin(robot).margin:.3f}")
    count = sum(snap is not None for snap in snaps)
    print(f"snaps on {count} of {samples} random paths, least margin at their ends {min(e.margin for e in ends):.3f}")
    figure, axes = plt.subplots(figsize=(4, 4))
    for name, each in (("this robot", robot), ("robot of the thesis", thesis.bundle())):
        line = 1e3 * each.fk(np.zeros(3)).position
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
