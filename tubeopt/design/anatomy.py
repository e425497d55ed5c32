"""The arm against its anatomy: where its surface is, and how that changes with the design."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..block.quantities import CLEARANCES
from ..block.transcription.arm import between
from ..block.transcription.standing import hat
from ..typing import Array, Index
from .pose import Pose

WITHIN = 16
"""Places at which the arm is looked at within each of its CLEARANCES parts."""

HELD_OFF = 2e-5
"""How far (m) the arm is held off its anatomy at these places, for what lies between them."""

RAMP = 3e-3
"""Length (m) over which a tube's radius runs out beyond its end, for the arm's distance to its anatomy."""


def _cubic(x: Array) -> tuple[Array, Array]:
    """Weights (4, K) of p0, h t0, p1, h t1 in Hermite's cubic at x (K,), and their derivatives."""
    weights = np.stack([(1 + 2 * x) * (1 - x) ** 2, x * (1 - x) ** 2, x**2 * (3 - 2 * x), -(x**2) * (1 - x)])
    return weights, np.stack([6 * x * (x - 1), (1 - x) * (1 - 3 * x), 6 * x * (1 - x), x * (3 * x - 2)])


def _between(pose: Pose, share: Array) -> tuple[Index, Array, Array, Array]:
    """For parts (K,) of the arm: the shape point before, the length to the next, how far along it, 0 to 1, and what
    `_cubic` weighs (4, K, 3)."""
    s, position, tangent = pose.arm.arc_length, pose.arm.position, pose.arm.frame[:, :, 2]
    k, h, x = between(s, share * s[-1])
    nodes = np.stack([position[k], h[:, None] * tangent[k], position[k + 1], h[:, None] * tangent[k + 1]])
    return k, h, x, nodes


def arm_points(pose: Pose, share: Array) -> Array:
    """Centreline (K, 3) at parts (K,) of the arm's length, cubic between the shape points."""
    _, _, x, nodes = _between(pose, share)
    return np.asarray(np.einsum("wk,wkc->kc", _cubic(x)[0], nodes))


def arm_slopes(pose: Pose, share: Array) -> Array:
    """(K, 3, L) change of `arm_points`, at the same part of an arm whose length changes too."""
    k, h, x, nodes = _between(pose, share)
    position, turn, arc = pose.shape_slopes
    tangent = pose.arm.frame[:, :, 2]
    weights, rates = _cubic(x)
    dh = arc[k + 1] - arc[k]
    moved = weights[0][:, None, None] * position[k] + weights[2][:, None, None] * position[k + 1]
    for w, end in ((weights[1], k), (weights[3], k + 1)):
        turned = -hat(tangent[end]) @ turn[end]
        moved = moved + w[:, None, None] * (h[:, None, None] * turned + tangent[end][:, :, None] * dh[:, None, :])
    dx = (share[:, None] * arc[-1] - arc[k] - x[:, None] * dh) / h[:, None]
    return np.asarray(moved + np.einsum("wk,wkc->kc", rates, nodes)[:, :, None] * dx[:, None, :])


SHARES = (np.arange(CLEARANCES * WITHIN) + 1) / (CLEARANCES * WITHIN)


def arm_clearance(pose: Pose, body: Any, chain: Array, thicker: Array, ended: Array) -> tuple[Array, Array]:
    """Distance (CLEARANCES,) of the arm's surface from a body where it is least in each part of the arm, m, less what
    the arm is held off, and its change (.., X).

    `chain` (Q, X) takes the directions of the pose to the unknowns; `thicker` and `ended` (n, X) are the changes of the
    radii of the tubes and of their ends.
    """
    radius, rounder = _radius(pose, thicker, ended, pose.shape_slopes[2][-1] @ chain)
    points = arm_points(pose, SHARES)
    room = body.signed_distance(points) - radius - HELD_OFF
    worst = room.reshape(CLEARANCES, WITHIN).argmin(1) + WITHIN * np.arange(CLEARANCES)
    local = np.einsum("kc,kcl->kl", body.gradient(points[worst]), arm_slopes(pose, SHARES[worst]))
    return room[worst], local @ chain - rounder[worst]


def _radius(pose: Pose, thicker: Array, ended: Array, longer: Array) -> tuple[Array, Array]:
    """Radius (K,) of the arm at SHARES of its length, and its change (K, X) by those of the radii and the ends of the
    tubes, (n, X), and of its length (X,).

    Beyond its end a tube's radius runs out over RAMP, so that the radius is continuous, and never too small.
    """
    radii = np.array([tube.outer_diameter / 2 for tube in pose.solved.member.robot.tubes])
    share = SHARES[:, None]
    beyond = (share * pose.arm.arc_length[-1] - pose.problem.assembly.end) / RAMP
    ramp = np.clip(beyond, 0.0, 1.0)
    each = radii - (radii - radii[0]) * ramp
    tube = each.argmax(1)
    k = np.arange(len(SHARES))
    thin = ramp[k, tube, None]
    change = thin * thicker[0] + (1 - thin) * thicker[tube]
    sloping = (beyond[k, tube] > 0) & (beyond[k, tube] < 1)
    rate = np.where(sloping, (radii[0] - radii[tube]) / RAMP, 0.0)
    return each[k, tube], change + rate[:, None] * (share * longer - ended[tube])
