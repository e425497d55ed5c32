"""The snap of Till et al. as their program simulates it: with markers, weight, and friction that follows the bending.

J. Till, V. Aloi, K. E. Riojas, P. L. Anderson, R. J. Webster III, D. C. Rucker, "A Dynamic Model for Concentric Tube
Robots", IEEE Transactions on Robotics 36 (2020). Inputs are those of 01_Cpp_Snapping/main.cpp, and the numbers below
those of 02_Blender/theta_f.dat and p0.dat in https://github.com/JohnDTill/ConcentricTubeDynamics (finite differences).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest

from tubeopt import ConcentricRobot, Load, follow, load_robot
from tubeopt.block.transcription.inertia import MotionSlopes, TubeMotion
from tubeopt.equilibrium.kinematics import unsolved
from tubeopt.physics.dynamics import DryFriction
from tubeopt.robots.load import PointLoad
from tubeopt.solvers.energy_momentum import motion
from tubeopt.typing import Array

ENDS, CURVED = (0.0551, 0.0531), ((0.00797, 0.0436), (0.0132, 0.0531))
"""Arc lengths of the ends of the tubes, and of their curved parts, m."""

DENSITY = (6493.0, 8000.0)
MASS = (np.array([0.0278, 0.0714]) + 0.02) / 1e3
"""Masses of the markers at the ends of the tubes, kg."""
RADIUS, BORE, THICKNESS = np.array([2.73e-3, 4.46e-3]), np.array([0.508e-3, 1.055e-3]), np.array([1.13e-3, 1.09e-3])

RATIO, CREEP = 0.008, 300.0
"""Friction torque over the bending moment that passes from tube to tube, and the rate that smooths it, rad/s."""

START, RATE = 3.5601, 10.0
"""Rotation (rad) of the inner drive at the start, and its rate, rad/s."""

PUBLISHED = {"begins": 5.639e-3, "lasts": 1.176e-3, "largest": 6.201, "rate": 1.437e4, "speed": 6.19}
"""Time at which the relative rotation of the tips has passed 10 % of its change, and from then to 90 %, s; its largest
value, rad; its largest rate, rad/s; and the largest speed of the tip, m/s."""


@dataclass(frozen=True, eq=False)
class MarkedPair(TubeMotion):
    """The pair with markers at the ends of its tubes, and friction in proportion to bending moments at jumps."""

    @cached_property
    def spin(self) -> Array:
        axial = MASS * (RADIUS**2 + BORE**2) / 2
        plain: Array = TubeMotion.spin.func(self)  # type: ignore[attr-defined]
        return np.asarray(plain + self.tip_rows.T @ (axial[:, None] * self.tip_rows))

    @cached_property
    def mass(self) -> Array:
        out: Array = TubeMotion.mass.func(self)  # type: ignore[attr-defined]
        s, weight = self.problem.torsion.arc_length, self.problem.torsion.weight
        across = MASS * (3 * (RADIUS**2 + BORE**2) + THICKNESS**2) / 12
        for end, mass, tilt in zip(ENDS, MASS, across, strict=True):
            to_end, last = np.where(s < end, weight, 0.0), 3 * int(np.flatnonzero(s < end)[-1])
            out[: 3 * len(s), : 3 * len(s)] += np.kron(mass * np.outer(to_end, to_end), np.eye(3))
            out[last : last + 3, last : last + 3] += tilt * np.eye(3)
        return out

    def slopes(self, y: Array) -> MotionSlopes:
        object.__setattr__(self, "state", (self.at(y).curvature, self._angles(y)[0]))
        return super().slopes(y)

    @cached_property
    def slips(self) -> Array:
        """Derivative (5, Y) of the relative rotations at the plate, at the jumps of curvature, and at the outer end."""
        split, size = self.problem.torsion.size, self.problem.size
        twists = self._twists(self._compliance_at(np.array([0.0, 0.00797, 0.0132, 0.0436, 0.0531])))
        out = np.zeros((5, size + 2))
        out[:, :split], out[:, size:] = twists[:, 1] - twists[:, 0], (-1.0, 1.0)
        return out

    @property
    def friction(self) -> DryFriction:
        curvature, theta = self.state  # type: ignore[attr-defined]
        s = self.problem.torsion.arc_length
        stiffness, natural = self.problem.torsion.stiffness[0], (37.12, 8.72)

        def moment(tube: int, k: int) -> Array:
            low, high = CURVED[tube]
            own = natural[tube] * (low < s[k] < high)
            bent: Array = curvature[k] - own * np.array([np.cos(theta[k, tube]), np.sin(theta[k, tube])])
            return float(stiffness[tube]) * bent

        last = [int(np.flatnonzero(s < place)[-1]) for place in (0.00797, 0.0132, 0.0436, 0.0531)]
        passed = [moment(0, 0), *(moment(0, k) - moment(0, k + 1) for k in last[:3]), moment(1, last[3])]
        return DryFriction(self.slips, RATIO * np.linalg.norm(passed, axis=1), CREEP)


def test_the_published_motion_is_reproduced() -> None:
    robot, shift = load_robot("till_snapping_pair"), (0.00797, 0.0132)
    assert isinstance(robot, ConcentricRobot)
    area = [np.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2) for tube in robot.tubes]
    heavy = [replace(t, mass_per_length=d * a) for t, d, a in zip(robot.tubes, DENSITY, area, strict=True)]
    robot = replace(robot, tubes=tuple(heavy))
    weight = np.array([0.0, -9.81, 0.0])
    load = Load(tuple(MASS[0] * weight), points=(PointLoad(0.0531, tuple(MASS[1] * weight)),), gravity=tuple(weight))
    start = follow(robot, [[0.0, 0.0], [-START, 0.0]], [shift, shift], load=load).equilibria[-1]
    member, x = unsolved(start, load)
    diameters = np.array([[tube.outer_diameter, tube.inner_diameter] for tube in robot.tubes])
    system = MarkedPair(member.problem, np.array(DENSITY) * area, diameters, np.zeros(2))
    torsion, rows = member.problem.torsion, []
    steps = motion(
        system, np.concatenate([x, start.rotations]), np.array([-RATE, 0.0]), scale=0.03, tolerance=2e-3, first=1e-6
    )
    for instant in steps:
        inner, outer = system.tip_rotations(instant.y)
        tip = torsion.weight @ instant.position[: 3 * len(torsion.weight)].reshape(-1, 3)
        rows.append((instant.time, outer - inner, *tip))
        if instant.time > 9e-3:
            break
    time, turn, *tips = np.transpose(rows)
    low, high = (
        np.interp(2.011 + part * (5.22 - 2.011), turn[: turn.argmax()], time[: turn.argmax()]) for part in (0.1, 0.9)
    )
    every = np.arange(1e-5, 9e-3, 1e-5)
    path = np.transpose([np.interp(every, time, row) for row in tips])
    found = {
        "begins": low, "lasts": high - low, "largest": turn.max(),
        "rate": (np.diff(np.interp(every, time, turn)) / 1e-5).max(),
        "speed": np.linalg.norm(np.diff(path, axis=0), axis=1).max() / 1e-5,
    }  # fmt: skip
    for name, value in PUBLISHED.items():
        assert found[name] == pytest.approx(value, rel=0.05), (name, found)
