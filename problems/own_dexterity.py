"""Tubes for a dexterous robot in three positions of its carriages: the largest least singular value of the Jacobian.

The Jacobian J of the tip is part of the program: the derivatives of the equilibrium are further unknowns. If
J J' - s 1 is positive semidefinite, no squared singular value is below s. Its leading minors test this. A logarithm of
the determinant keeps the optimum away from equal singular values, where the least one has a kink.

Result: a derivative of the equilibrium can be an objective, with exact second derivatives. No eigenvalue needs to be
differentiated.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import casadi as ca
import numpy as np

import tubeopt
from tubeopt.show.plots import plot_shapes

ROOT = Path(__file__).resolve().parents[1]
TRANSLATIONS = ((-0.01, -0.03), (-0.02, -0.06), (-0.005, -0.02))
"""Where the carriages stand in the three poses, m."""
UNITS = np.array([1.0, 1.0, 0.05, 0.05]) / 0.01
"""1 rad of rotation counts as much as 50 mm of translation; the tip is counted in cm."""

BARRIER = 0.01
"""Weight (cm^2) of the logarithms that keep the matrices definite, since at the best singular values tend to be equal,
where the least one has a kink; of the least squared singular value they take 9 times this at most."""


def minors(matrix: ca.MX) -> ca.MX:
    """Leading principal minors (3,): a symmetric matrix is positive semidefinite as long as they stay at least 0."""
    columns = ca.horzsplit(matrix)
    second = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] ** 2
    return ca.vertcat(matrix[0, 0], second, ca.dot(columns[0], ca.cross(columns[1], columns[2])))


def main(out: Path, samples: int = len(TRANSLATIONS)) -> list[Path]:
    """Maximise the dexterity in the first `samples` poses, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "two_tube.yaml")
    problem = tubeopt.Problem("dexterity")
    curvature = problem.variable("curvature", 2, guess=12.5, lower=2.0, upper=20.0, scale=10.0)
    smallest = problem.variable("least squared singular value", guess=0.01)
    blocks, jacobians, inside = [], [], ca.MX(0.0)
    for k, translations in enumerate(TRANSLATIONS[:samples], start=1):
        near = tubeopt.forward_kinematics(robot, [1.2, 0.0], translations)
        turn = problem.variable(f"turn {k}", guess=1.2, lower=0.0, upper=np.pi)
        tubes = {"curvature": curvature}
        block = tubeopt.EquilibriumBlock(problem, near, rotations=[turn, 0.0], tubes=tubes, refinement=0)
        block.margin_at_least(0.2)
        jacobian = block.jacobian() @ ca.diag(ca.DM(UNITS))
        rest = minors(jacobian @ jacobian.T - smallest * ca.DM.eye(3))
        problem.subject_to(f"singular values {k}", rest)
        inside += ca.log(rest[2])
        blocks.append(block)
        jacobians.append(jacobian)
    problem.maximize(smallest + BARRIER * inside)
    solution = problem.solve(tubeopt.Ipopt(expand=True, tolerance=1e-8))

    poses = [block.equilibrium(solution) for block in blocks]
    print(f"{solution.status} in {solution.statistics.iterations} iterations")
    print("curvatures (1/m):", np.round(solution.value("curvature"), 3))
    after = [10 * np.linalg.svd(solution.value(jacobian), compute_uv=False)[-1] for jacobian in jacobians]
    print("least singular values (mm per rad or 50 mm):", np.round(after, 3))
    picture = out / "own_dexterity.png"
    plot_shapes(poses, picture, titles=[f"{value:.1f} mm per rad or 50 mm" for value in after])
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
