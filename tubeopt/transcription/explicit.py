"""Equilibria without equations to solve: from the tubes' rotations at their tips to the joint rotations that they need.

Torsion vanishes at every tube's own end. Given the rotations there and the translations, the equations of torsion are
therefore an initial-value problem from the tip to the plate, whose solution always exists and is unique: every
equilibrium, stable or not, is one point (tip rotations, translations), and every such point is one equilibrium. Where
several equilibria have the same joint values, these points tell them apart; a continuous path of points is a branch.

The integrator takes `STEPS` steps of order 4 per section, of which there are 2 n with lengths that may be 0:
breakpoints are sorted by comparisons, so that one function serves every translation. The margin enters as in
`inverse_program`, by the determinants of the Jacobi fields of softened tubes.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from ..mechanics.shape import _exponential
from ..mechanics.torsion import cross_section
from ..robots.assembly import Array
from ..robots.robot import Robot
from .inverse_program import MOST_STRETCHED, _determinant, _nystrom, coupling, stretched_stage, stretched_step

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
def explicit_arm(n: int, eccentric: bool) -> ca.Function:
    """(tip rotations (n,), translations (n,), margin, robot (7n,)) -> the equilibrium.

    Outputs: `rotations` (n,) of the joints; `fields` (2n,) determinants of the Jacobi fields of tubes softened by the
    margin, all positive if and only if the equilibrium's own margin is larger; `points` (3, p) and `tangents` (3, p) of
    the centreline, plate to tip, and their `arc_length` (p,).
    """
    tip, shift, margin, robot = (ca.SX.sym(k, m) for k, m in (("tip", n), ("d", n), ("mu", 1), ("robot", 7 * n)))
    kb, kt, moment, straight, whole, offset, angle = ca.vertsplit(robot, n)
    transition, end = shift, shift - straight + whole
    cuts = _sorted([ca.fmax(v, 0) for v in (*ca.vertsplit(transition), *ca.vertsplit(end))])
    cuts = [ca.SX(0), *cuts]
    place = (offset, angle) if eccentric else (None, None)
    march = _March(n, kt, (1 - margin) * kt, place, tip)
    fields = []
    for a, b in reversed(list(pairwise(cuts))):
        middle = (a + b) / 2
        present = middle < end
        # The middle of a section without length, or with one of a rounding error, may lie at the end of all tubes:
        # whichever it has, they must not divide by 0.
        stiffness = ca.if_else(ca.sum1(present) > 0, kb * present, kb)
        march.section(b - a, stiffness, moment * present * (middle > transition))
        fields.append(_determinant(march.y))
    transmission = ca.fmax(straight - shift, 0)
    fields[-1] = _determinant(march.y - ca.diag(transmission) @ march.slope)
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

    def __init__(self, n: int, kt: Any, softened: Any, place: tuple[Any, Any], tip: Any) -> None:
        self.kt, self.softened, self.place = kt, softened, place
        self.theta, self.twist = tip, ca.SX.zeros(n)
        self.y, self.slope = ca.SX.eye(n), ca.SX.zeros(n, n)
        self.steps: list[tuple[Any, list[Any]]] = []

    def section(self, length: Any, stiffness: Any, moment: Any) -> None:
        """Integrate over one section."""
        h = length / STEPS
        for _ in range(STEPS):
            far, w_far = self.theta, self.twist
            first = cross_section(far, stiffness, moment, *self.place)
            if self.place[0] is None:
                near, w_near = self._nystrom(far, w_far, stiffness, moment, h)
                rates = w_far, w_near
            else:
                near, w_near = self._runge_kutta(far, w_far, stiffness, moment, h)
                rates = first.stretch * w_far, cross_section(near, stiffness, moment, *self.place).stretch * w_near
            middle = (far + near) / 2 + h / 8 * (rates[1] - rates[0])
            if self.place[0] is None or far.numel() > MOST_STRETCHED:
                stages = [coupling(theta, stiffness, moment, self.softened) for theta in (near, middle, far)]
                self.y, self.slope = _nystrom(self.y, self.slope, stages, h)
            else:
                gains = [self._gain(theta, stiffness, moment) for theta in (near, far)]
                twists = w_near, (w_near + w_far) / 2 + h / 8 * (gains[0] - gains[1]), w_far
                section = (stiffness, moment, *self.place)
                states = zip((near, middle, far), twists, strict=True)
                fields = [stretched_stage(theta, w, section, self.softened) for theta, w in states]
                self.y, self.slope = stretched_step(self.y, self.slope, fields, h)
            u = [cross_section(theta, stiffness, moment, *self.place).curvature for theta in (near, middle, far)]
            self.steps.append((h, u))
            self.theta, self.twist = near, w_near

    def _gain(self, theta: Any, stiffness: Any, moment: Any) -> Any:
        return cross_section(theta, stiffness, moment, *self.place).moment / self.kt

    def _nystrom(self, theta: Any, w: Any, stiffness: Any, moment: Any, h: Any) -> tuple[Any, Any]:
        """A step of theta'' = M / kt towards the plate."""
        k1 = self._gain(theta, stiffness, moment)
        k2 = self._gain(theta - h / 2 * w + h**2 / 8 * k1, stiffness, moment)
        k3 = self._gain(theta - h * w + h**2 / 2 * k2, stiffness, moment)
        return theta - h * w + h**2 / 6 * (k1 + 2 * k2), w - h / 6 * (k1 + 4 * k2 + k3)

    def _runge_kutta(self, theta: Any, w: Any, stiffness: Any, moment: Any, h: Any) -> tuple[Any, Any]:
        """A step of theta' = g w, w' = M / kt towards the plate."""

        def rates(a: Any, b: Any) -> tuple[Any, Any]:
            here = cross_section(a, stiffness, moment, *self.place)
            return here.stretch * b, here.moment / self.kt

        k = [rates(theta, w)]
        for part in (0.5, 0.5, 1.0):
            k.append(rates(theta - part * h * k[-1][0], w - part * h * k[-1][1]))
        weights = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
        turned = sum(c * a for c, (a, _) in zip(weights, k, strict=True))
        gained = sum(c * b for c, (_, b) in zip(weights, k, strict=True))
        return theta - h * turned, w - h * gained

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
            rotation, step = _exponential(turn, move)
            position, frame, s = position + frame @ step, frame @ rotation, s + h
            out.append((position, frame[:, 2], s))
        return (
            ca.horzcat(*(p for p, _, _ in out)),
            ca.horzcat(*(t for _, t, _ in out)),
            ca.vertcat(*(a for *_, a in out)),
        )
