"""A design of the robot of the thesis that cannot snap under any tip force up to 50 mN.

Result: a design that cannot snap without load can still snap under a force. The certificate decreases almost in
proportion to the force. For 50 mN the inner tube loses nearly two thirds of its curvature; without a force it loses
little more than one third.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.design import Free, Objective, SnapFree
from tubeopt.show.plots import plot_bearing

ROOT = Path(__file__).resolve().parents[1]
FORCE = 0.05


def main(out: Path, samples: int = 9) -> list[Path]:
    """Design with and without the force, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    assert isinstance(robot, tubeopt.ConcentricRobot)
    forces = np.linspace(0.0, 1.5 * FORCE, samples)
    curves = {}
    for name, requirement in (
        ("cannot snap by itself", SnapFree(0.02)),
        ("cannot snap under 50 mN", SnapFree(0.02, max_force=FORCE)),
    ):
        task = tubeopt.DesignTask(
            robot,
            free=(Free("curvature", (0, 1, 2), 0.5, 15.0),),
            requirements=(requirement,),
            objective=Objective("change"),
            name=name,
        )
        design = tubeopt.optimize_design(task)
        curves[name] = np.array([tubeopt.snap_free_certificate(design.robot, max_force=force) for force in forces])
        bends = ", ".join(f"{tube.curvature:.2f}" for tube in design.robot.tubes)
        print(f"{name}: curvatures {bends} per m, certificate {design.certificate:.3f}, in {design.seconds:.0f} s")
        print(f"  under 50 mN {tubeopt.snap_free_certificate(design.robot, max_force=FORCE):.3f}")
    picture = out / "design_bears_force.png"
    plot_bearing(curves, picture, forces=forces, title="Certificate of designs over the largest force on the tip")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
