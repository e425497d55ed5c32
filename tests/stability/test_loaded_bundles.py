"""All equilibria of loaded bundles against stationary points of their energy in finite elements, from random starts."""

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares

from tubeopt import BundleRobot, Load, Tube, find_equilibria
from tubeopt.typing import Array

ELEMENTS = 14
"""Elements from the plate to the end of the shorter tube, and from there to the tip."""


def stationary(robot: BundleRobot, rotations: Array, force: Array, weights: Array) -> ca.Function:
    """Gradient of the energy with multipliers for own lengths, its Jacobian and the tip; the first tube ends last.

    Args:
        weights: (2, 3) weight of each tube per length, N/m.
    """
    bend, twist = ca.SX.sym("u", 2, 2 * ELEMENTS), ca.SX.sym("w", 2, 2 * ELEMENTS)
    length, multiplier = ca.SX.sym("s", 2), ca.SX.sym("l", 2)
    position, frame, energy = ca.SX.zeros(3), ca.SX.eye(3), 0.0
    theta, own = [ca.SX(float(each)) for each in rotations], [ca.SX(0.0), ca.SX(0.0)]
    for k in range(2 * ELEMENTS):
        h, u = length[k // ELEMENTS] / ELEMENTS, bend[:, k]
        skew = ca.skew(ca.vertcat(u, 0.0))
        angle = ca.sqrt(ca.sumsqr(u) + 1e-20)
        half, whole = (
            ca.SX.eye(3) + ca.sin(angle * s) / angle * skew + (1 - ca.cos(angle * s)) / angle**2 * skew @ skew
            for s in (h / 2, h)
        )
        middle = frame @ half
        for i in range(1 if k >= ELEMENTS else 2):
            d, cos, sin = robot.offset[i], math.cos(robot.angle[i]), math.sin(robot.angle[i])
            bending, torsional, curvature = (
                float(getattr(robot.tubes[i], name))
                for name in ("bending_stiffness", "torsional_stiffness", "curvature")
            )
            g = 1 + d * (u[0] * sin - u[1] * cos)
            at = theta[i] + h * g * twist[i, k] / 2
            bent = u / g - curvature * ca.vertcat(ca.cos(at), ca.sin(at))
            axis = position + middle @ ca.DM([d * cos, d * sin, 0.0]) + h * middle[:, 2] / 2
            elastic = bending * ca.sumsqr(bent) + torsional * twist[i, k] ** 2
            energy += h * g * (elastic / 2 - ca.dot(ca.DM(weights[i]), axis))
            theta[i] += h * g * twist[i, k]
            own[i] += h * g
        position, frame = position + h * middle[:, 2], frame @ whole
    # Twists that the second tube does not have beyond its end vanish.
    energy += ca.sumsqr(twist[1, ELEMENTS:]) * 1e-6 - ca.dot(ca.DM(force), position)
    energy += sum(multiplier[i] * (own[i] - float(robot.tubes[i].curved_length)) for i in range(2))
    x = ca.vertcat(ca.vec(bend), ca.vec(twist), length, multiplier)
    gradient = ca.gradient(energy, x)
    return ca.Function("stationary", [x], [gradient, ca.jacobian(gradient, x), position])


@pytest.mark.parametrize("kind", ["tip", "weight"])
def test_all_equilibria_are_those_of_finite_elements(kind: str) -> None:
    sizes = ((0.09, 34.0, 0.3), (0.06, 30.0, 0.2))
    tubes = tuple(Tube(1e-3, 0.7e-3, 0.0, length, bend, mass_per_length=mass) for length, bend, mass in sizes)
    robot = BundleRobot(tubes, (0.7e-3,) * 2, (0.0, np.pi))
    force = np.array([0.25, 0.1, -0.2]) * (kind == "tip")
    gravity = np.array([0.0, -9.81, 0.0]) * (kind == "weight")
    given: dict[str, Any] = {"force": tuple(force)} if kind == "tip" else {"gravity": tuple(gravity)}
    rotations = np.radians([175.0, 0.0])
    found = find_equilibria(robot, rotations, load=Load(**given))
    function = stationary(robot, rotations, force, np.outer([0.3, 0.2], gravity))
    count, random = 2 * ELEMENTS, np.random.default_rng(3)
    scale = np.concatenate([np.full(2 * count, 30.0), np.full(2 * count, 20.0), np.full(2, 0.06), np.full(2, 2.0)])
    tips: list[Array] = []
    for _ in range(20):
        start = np.concatenate([np.repeat(random.uniform(-1, 1, (1, 2)), count, axis=0).ravel(), np.zeros(2 * count)])
        twist = np.outer(1 - np.arange(count) / count, random.uniform(-3, 3, 2))
        start[2 * count :] = twist.ravel()
        reached = least_squares(
            lambda x: function(x * scale)[0].full().ravel() * scale,
            np.concatenate([start, [1.0, 0.5, 0.0, 0.0]]),
            jac=lambda x: function(x * scale)[1].full() * scale * scale[:, None],
            max_nfev=80,
            gtol=1e-14,
        )
        tip = function(reached.x * scale)[2].full().ravel()
        solved = np.abs(reached.fun).max() < 1e-9 and (reached.x[-4:-2] > 0).all()
        if solved and all(np.abs(tip - known).max() > 1e-3 for known in tips):
            tips.append(tip)
    assert len(tips) == len(found) == 3
    for equilibrium in found:
        assert min(np.abs(tip - equilibrium.tip_position).max() for tip in tips) < 5e-4
