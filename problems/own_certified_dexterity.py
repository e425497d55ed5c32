"""Dexterous tubes that cannot snap: the largest least singular value of the Jacobian, with a certificate of 0.1.

The certificate is a condition on tubes and translations. With it the energy has one minimum at all rotations; in the
last design also under any tip force of up to 20 mN. All searches are local, from the same tubes.

Result: the price of the guarantee. Without it the tubes bend up to their bounds. With it the certificate limits the
dexterity, and forces of 20 mN cost another 2 %.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]
UNITS = np.array([1.0, 1.0, 0.05, 0.05]) / 0.01
"""1 rad of rotation counts as much as 50 mm of translation; the tip is counted in cm."""

BARRIER = 0.01
"""Weight (cm^2) of the logarithm that keeps the matrix definite, since at the best singular values tend to be equal,
where the least one has a kink; of the least squared singular value it takes 3 times this at most."""

START, PUSH = 8.0, 0.02
"""Curvature of both tubes where the searches begin, 1/m, and the force on the tip, N."""

NO_FLOOR = -5.0
"""No tubes within the bounds come near this certificate."""


def minors(matrix: ca.MX) -> ca.MX:
    """Leading principal minors (3,): a symmetric matrix is positive semidefinite as long as they stay at least 0."""
    columns = ca.horzsplit(matrix)
    second = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] ** 2
    return ca.vertcat(matrix[0, 0], second, ca.dot(columns[0], ca.cross(columns[1], columns[2])))


def designs(
    near: tubeopt.Equilibrium, floors: list[float], max_force: float = 0.0
) -> Iterator[tuple[tubeopt.Equilibrium, float]]:
    """The best tubes in their best pose, and their least singular value, cm, for every lower bound of the certificate.

    The bound is a parameter of one program. The certificate covers tip forces up to `max_force`, N.
    """
    opti = ca.Opti()
    curvature, turn = 10 * opti.variable(2), opti.variable()  # turning both tubes turns the arm, no more
    smallest = opti.variable()
    tubes = {"curvature": curvature}
    block = tubeopt.EquilibriumBlock(opti, near, rotations=[turn, 0.0], tubes=tubes, refinement=0)
    block.margin_at_least(0.1)
    floor = opti.parameter()
    block.certificate_at_least(floor, max_force=max_force)
    jacobian = block.jacobian() @ ca.diag(ca.DM(UNITS))
    rest = minors(jacobian @ jacobian.T - smallest * ca.DM.eye(3))
    opti.subject_to(rest >= 0)
    opti.subject_to(opti.bounded(0.2, curvature / 10, 2.0))
    opti.subject_to(opti.bounded(0, turn, np.pi))
    for symbol, value in ((curvature, START), (turn, near.rotations[0]), (smallest, 0.1)):
        opti.set_initial(symbol, value)
    opti.minimize(-smallest - BARRIER * ca.log(rest[2]))
    opti.solver(
        "ipopt", {"print_time": False, "expand": True, "show_eval_warnings": False}, {"print_level": 0, "sb": "yes"}
    )
    for each in floors:
        opti.set_value(floor, each)
        solution = opti.solve()
        yield block.equilibrium(solution), float(np.sqrt(solution.value(smallest)))


def main(out: Path, samples: int = 3) -> list[Path]:
    """Design without the certificate, with it, and under a force, or the first `samples` of these.

    Save the picture into `out`, and return its path.
    """
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "two_tube.yaml")
    tubes = tuple(dataclasses.replace(tube, curvature=START) for tube in robot.tubes)
    near = tubeopt.forward_kinematics(tubeopt.ConcentricRobot(tubes), [1.2, 0.0], [-0.01, -0.03])
    poses, titles = [], []
    results = [*designs(near, [NO_FLOOR, 0.1]), *(designs(near, [0.1], PUSH) if samples > 2 else ())]
    names = ("no certificate", 0.0), ("certificate 0.1", 0.0), ("0.1 under any push of 20 mN", PUSH)
    for (name, force), (pose, smallest) in zip(names, results, strict=False):
        certified = tubeopt.snap_free_certificate(pose.robot, pose.translations, max_force=force)
        bends = ", ".join(f"{tube.curvature:.2f}" for tube in pose.robot.tubes)
        titles.append(f"{name}: {10 * smallest:.1f} mm per rad or 50 mm")
        print(f"{titles[-1]}; curvatures {bends} per m, margin {pose.margin:.3f}, certificate {certified:.3f}")
        poses.append(pose)
    picture = out / "own_certified_dexterity.png"
    plot_shapes(poses, picture, titles=titles)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
