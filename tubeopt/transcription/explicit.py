"""Equilibria without equations to solve: from the tubes' rotations at their tips to the joint rotations that they need.

Torsion vanishes at every tube's own end. Given the rotations there and the translations, the equations of torsion are
therefore an initial-value problem from the tip to the plate, whose solution always exists and is unique: every
equilibrium, stable or not, is one point (tip rotations, translations), and every such point is one equilibrium. Where
several equilibria have the same joint values, these points tell them apart; a continuous path of points is a branch.

The integrator takes `STEPS` steps of order 4 per section, of which there are 2 n with lengths that may be 0:
breakpoints are sorted by comparisons, so that one function serves every translation. The margin enters as in
`inverse_program`, by the determinants of the Jacobi fields of softened tubes, for tubes off the centreline those of
their own equations.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from ..physics.matrix import determinant
from ..physics.shape import exponential
from ..physics.torsion import section_functions
from ..robots.robot import Robot
from ..typing import Array

STEPS = 4
"""Steps per section: joint rotations of the thesis' robot to about 1e-5 rad."""


def explicit_parameters(robot: Robot) -> Array:
    """What `explicit_arm` needs to know of a robot: kb, kt, m = kb kappa, straight and whole lengths, place; (7n,)."""
    home = robot.assembly(robot.home_translations)
    tubes = robot.tubes
    return np.concatenate(
        [
            home.bending_stiffness,
            home.torsional_stiffness,
            home.bending_stiffness * home.curvature,
            home.transmission + robot.home_translations,
            [tube.length for tube in tubes],
            home.offset,
            home.offset_angle,
        ]
    )


@lru_cache(maxsize=16)
def explicit_arm(n: int, eccentric: bool, steps: int = STEPS) -> ca.Function:
    """(tip rotations (n,), translations (n,), margin, robot (7n,)) -> the equilibrium.

    Outputs: `rotations` (n,) of the joints; `fields` (2n,) determinants of the Jacobi fields of tubes softened by the
    margin, all positive if and only if the equilibrium's own margin is larger; `points` (3, p) and `tangents` (3, p) of
    the centreline, plate to tip, and their `arc_length` (p,). Each of the 2n sections takes `steps` steps.
    """
    tip, shift, margin, robot = (ca.SX.sym(k, m) for k, m in (("tip", n), ("d", n), ("mu", 1), ("robot", 7 * n)))
    parts = tuple(ca.vertsplit(robot, n))
    kb, _, moment, straight, whole, _, _ = parts
    transition, end = shift, shift - straight + whole
    cuts = _sorted([ca.fmax(v, 0) for v in (*ca.vertsplit(transition), *ca.vertsplit(end))])
    cuts = [ca.SX(0), *cuts]
    march = _March(parts, margin, eccentric, tip, steps)
    fields = []
    for a, b in reversed(list(pairwise(cuts))):
        middle = (a + b) / 2
        present = middle < end
        # The middle of a section without length, or with one of a rounding error, may lie at the end of all tubes:
        # whichever it has, they must not divide by 0.
        stiffness = ca.if_else(ca.sum1(present) > 0, kb * present, kb)
        march.section(b - a, stiffness, moment * present * (middle > transition))
        fields.append(determinant(march.y))
    transmission = ca.fmax(straight - shift, 0)
    fields[-1] = determinant(march.y - ca.diag(transmission) @ march.v)
    rotations = march.theta - transmission * march.twist
    position, tangent, s = march.shape()
    return ca.Function(
        "explicit_arm",
        [tip, shift, margin, robot],
        [rotations, ca.vertcat(*fields), position, tangent, s],
        ["tip", "translations", "margin", "robot"],
        ["rotations", "fields", "points", "tangents", "arc_length"],
        {"cse": True},
    )


@lru_cache(maxsize=16)
def explicit_joints(n: int, eccentric: bool) -> ca.Function:
    """The outputs `rotations` and `fields` of `explicit_arm` alone, which cost less without the shape."""
    arm = explicit_arm(n, eccentric)
    inputs = [ca.SX.sym(arm.name_in(i), arm.size1_in(i)) for i in range(4)]
    outputs: Any = arm(*inputs)
    return ca.Function("explicit_joints", inputs, list(outputs[:2]), {"cse": True})


def _sorted(values: list[Any]) -> list[Any]:
    """Values in increasing order, by a network of comparisons."""
    out = list(values)
    for last in range(len(out) - 1, 0, -1):
        for k in range(last):
            out[k], out[k + 1] = ca.fmin(out[k], out[k + 1]), ca.fmax(out[k], out[k + 1])
    return out


class _March:
    """The state of the integration from tip to plate: theta, w, Jacobi fields, and the curvature met on the way."""

    def __init__(self, robot: tuple[Any, ...], margin: Any, eccentric: bool, tip: Any, steps: int) -> None:
        self.kt, self.softening, self.eccentric, self.count = robot[1], 1 - margin, eccentric, steps
        self.place = robot[5:7] if eccentric else ()
        n = tip.numel()
        self.theta, self.twist = tip, ca.SX.zeros(n)
        self.y, self.v = ca.SX.eye(n), ca.SX.zeros(n, n)
        self.steps: list[tuple[Any, list[Any]]] = []
        self.balance = section_functions(n, eccentric)["balance"]
        self.bend = section_functions(n, eccentric)["curvature"]

    def section(self, length: Any, stiffness: Any, moment: Any) -> None:
        """Integrate over one section."""
        h = length / self.count
        given = (stiffness, moment, *self.place)
        for _ in range(self.count):
            far, far_rate = self.theta, self._turning(self.theta, self.twist, given)
            (self._runge_kutta if self.eccentric else self._nystrom)(given, h)
            near_rate = self._turning(self.theta, self.twist, given)
            middle = (far + self.theta) / 2 + h / 8 * (near_rate - far_rate)
            self.steps.append((h, [self.bend(theta, *given) for theta in (self.theta, middle, far)]))

    def _turning(self, theta: Any, w: Any, given: tuple[Any, ...]) -> Any:
        """theta' at a cross-section."""
        return self.balance(theta, *given)[3] * w if self.eccentric else w

    def _gains(self, theta: Any, given: tuple[Any, ...]) -> tuple[Any, Any]:
        """w' (n,), and its derivative (n, n) with the tubes softened, of concentric tubes."""
        moment, slope, *_ = self.balance(theta, *given)
        return moment / self.kt, ca.diag(1 / (self.softening * self.kt)) @ slope

    def _nystrom(self, given: tuple[Any, ...], h: Any) -> None:
        """A step of theta'' = M / kt and of its Jacobi fields towards the plate, of order 4."""
        theta, w, y, v = self.theta, self.twist, self.y, self.v
        k1, slope = self._gains(theta, given)
        f1 = slope @ y
        k2, slope = self._gains(theta - h / 2 * w + h**2 / 8 * k1, given)
        f2 = slope @ (y - h / 2 * v + h**2 / 8 * f1)
        k3, slope = self._gains(theta - h * w + h**2 / 2 * k2, given)
        f3 = slope @ (y - h * v + h**2 / 2 * f2)
        self.theta, self.twist = theta - h * w + h**2 / 6 * (k1 + 2 * k2), w - h / 6 * (k1 + 4 * k2 + k3)
        self.y, self.v = y - h * v + h**2 / 6 * (f1 + 2 * f2), v - h / 6 * (f1 + 4 * f2 + f3)

    def _runge_kutta(self, given: tuple[Any, ...], h: Any) -> None:
        """A step of theta' = g w, w' = M / kt and of its Jacobi fields towards the plate, of order 4."""

        def rates(theta: Any, w: Any, y: Any, v: Any) -> list[Any]:
            moment, slope, _, stretch, stretching = self.balance(theta, *given)
            turned = ca.diag(stretch) @ v + ca.diag(w) @ (stretching @ y)
            return [stretch * w, moment / self.kt, turned, ca.diag(1 / (self.softening * self.kt)) @ slope @ y]

        start = [self.theta, self.twist, self.y, self.v]
        k = [rates(*start)]
        for part in (0.5, 0.5, 1.0):
            k.append(rates(*(a - part * h * b for a, b in zip(start, k[-1], strict=True))))
        mean = [(a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(*k, strict=True)]
        self.theta, self.twist, self.y, self.v = (a - h * b for a, b in zip(start, mean, strict=True))

    def shape(self) -> tuple[Any, Any, Any]:
        """Positions and tangents (3, p), arc lengths (p,), plate to tip: Magnus steps of order 4 on SE(3)."""
        frame, position, s = ca.SX.eye(3), ca.SX.zeros(3), ca.SX(0)
        out = [(position, frame[:, 2], s)]
        for h, (near, middle, far) in reversed(self.steps):
            mean = h / 6 * (near + 4 * middle + far)
            bracket = h**2 / 12
            turn = ca.vertcat(mean, bracket * (near[0] * far[1] - near[1] * far[0]))
            # The commutator of the twists (u, e3) at both ends: (u0 - u1) x e3.
            change = near - far
            move = ca.vertcat(bracket * change[1], -bracket * change[0], h)
            rotation, step = exponential(turn, move)
            position, frame, s = position + frame @ step, frame @ rotation, s + h
            out.append((position, frame[:, 2], s))
        # Zeros are entries as well: who reads the numbers takes them to be all there.
        return (
            ca.densify(ca.horzcat(*(p for p, _, _ in out))),
            ca.densify(ca.horzcat(*(t for _, t, _ in out))),
            ca.densify(ca.vertcat(*(a for *_, a in out))),
        )
