"""The tightest certified turn of an eccentric robot with a free channel of 1.2 mm in its middle.

Curvature, diameters and offset of three tubes are free, and the lengths of two. The sheath is as wide as that of the
thesis, bores are as wide in proportion, the longest tube is as long, and each has at least 0.3 of the stiffness. By the
energy of the tubes, each with its own length, an arm jumps where the order of their ends changes. The certificate of
0.05 proves that the order stays, and that no rotation snaps.

Result: a turning radius of 75.4 mm, where the robot of the thesis has 120 mm and no room between its tubes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import tubeopt
from tubeopt.block.custom import CustomRequirement
from tubeopt.block.quantities import Quantities
from tubeopt.design import DesignTask, Free, Girth, Objective, Poses, SnapFree
from tubeopt.robots.eccentric import BundleRobot, EccentricRobot, free_channel
from tubeopt.robots.tubes import Tube

ROOT = Path(__file__).resolve().parents[1]
CHANNEL, MARGIN, STIFFNESS = 1.2e-3, 0.05, 0.3
"""Diameter of the channel, m; certificate; fraction of the bending stiffness of the thesis."""

TUBES, ZERO = (0, 1, 2), (0.0, 0.0, 0.0)
FREE = (
    Free("curvature", TUBES, 5.0, 30.0, "equal"),
    Free("outer_diameter", TUBES, 0.8e-3, 1.92e-3, "equal"),
    Free("inner_diameter", TUBES, 0.5e-3, 1.7e-3, "equal"),
    Free("offset", TUBES, 1e-3, 2e-3, "equal"),
    Free("curved_length", (1, 2), 0.087, 0.094),
)


class Room(CustomRequirement):
    """Room in the middle between the tubes, in their bores, and stiffness, compared with the tube of the thesis."""

    description, unit, factor, size, is_upper_bound, limit = "room between the tubes", "mm", 1e3, 1e-4, False, 0.0

    def __init__(self, tube: Tube) -> None:
        self.tube = tube

    def expression(self, q: Quantities) -> Any:
        """Reserves (3,) of the channel, of the bore and of the stiffness, as lengths."""
        tubes, tube = q.tubes, self.tube
        outer, inner = tubes["outer_diameter"][0], tubes["inner_diameter"][0]
        stiffness = tubes["bending_stiffness"][0] / tube.bending_stiffness
        return ca.vertcat(
            2 * tubes["offset"][0] - outer - CHANNEL,
            inner - outer * tube.inner_diameter / tube.outer_diameter,
            1e-3 * (stiffness - STIFFNESS),
        )


def main(out: Path, samples: int = 200) -> list[Path]:
    """Design the robot, save its picture into `out`, and return its path."""
    thesis = tubeopt.load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    requirements = (Poses((ZERO,), (ZERO,)), SnapFree(MARGIN), Girth(thesis.sheath_inner_diameter), Room(thesis.tube))
    design = tubeopt.optimize_design(DesignTask(thesis.bundle(), FREE, requirements, Objective("turning_radius")))
    assert isinstance(design.robot, BundleRobot)
    robot = replace(design.robot, name="eccentric robot with a channel")
    tube, certificate = robot.tubes[0], tubeopt.certify(robot)
    lengths = np.round([1e3 * each.curved_length for each in robot.tubes], 2)
    print(
        f"curvature {tube.curvature:.2f} per m, tubes of {1e3 * tube.outer_diameter:.3f} mm at "
        f"{1e3 * robot.offset[0]:.3f} mm, of lengths {lengths} mm"
    )
    print(f"certificate {certificate.margin:.4f}: {certificate.status}")
    print(f"with tubes of equal length: {tubeopt.certify(replace(robot, tubes=(tube,) * 3)).obstacle}")
    print(f"designed in {design.seconds:.0f} s")
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
