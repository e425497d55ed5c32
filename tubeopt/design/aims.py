"""Objectives that are stated as expressions: of one number, or of several of which the worst counts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from ..block.own import OwnObjective
from ..block.quantities import Expression, PoseQuantities, Quantities, recorded
from ..errors import InputError
from ..physics.torsion import cross_section
from ..robots.assembly import ROUND_OFF
from .objectives import AnyObjective, Objective
from .requirements import ROUNDED, deviations
from .statements import Points, Poses

PER_TURN = 0.05
"""Translation (m) that counts as much as a rotation of 1 rad."""

UNIT, REGULAR = 0.01, 1e-8
"""Length (m) in which singular values are counted, and what is added to their squares, so that none is 0."""

SLIGHT = 1e-7
"""What is added to squares of singular values of a turn, rad^2."""


def aim(
    one: AnyObjective, pieces: Sequence[int], poses: Poses, certified: Points, depth_pose: int | None
) -> Expression | None:
    """An objective in its own sign, SI, for tubes of so many pieces: the largest of its numbers counts where less is
    better, the least where more is; None for the change of the unknowns, which is no matter of tubes and poses.

    `poses` are those whose margin counts, `certified` the translations of the certificate, `depth_pose` the pose of
    reach_radius.
    """
    if isinstance(one, Objective) and one.kind == "change":
        return None
    numbers = one.expression if isinstance(one, OwnObjective) else partial(_numbers, one, poses, certified, depth_pose)
    last = max([*poses, depth_pose or 0] if isinstance(one, Objective) else poses, default=-1)
    found = recorded(numbers, len(pieces), last + 1, one.words, pieces)
    if isinstance(one, OwnObjective) and found.value.numel_out() != 1:
        raise InputError(f"the objective {one.words} has {found.value.numel_out()} numbers; it must be one")
    return found


def _numbers(one: Objective, poses: Poses, certified: Points, depth_pose: int | None, q: Quantities) -> Any:
    at = [q.poses[k] for k in poses]
    match one.kind:
        case "strain":
            return ca.vertcat(*(q.straightened_strain(i) for i in range(q.n_tubes)))
        case "margin" if certified:
            return ca.vertcat(*(q.certificate(row) for row in certified))
        case "margin":
            return ca.vertcat(*(pose.margin for pose in at))
        case "tip_deflection":
            return ca.vertcat(*(ca.norm_2(pose.deflection(one.tip_force)) for pose in at))
        case "tip_stiffness":
            force = ca.DM(list(one.tip_force or ()))
            return ca.vertcat(*(ca.sumsqr(force) / ca.dot(force, pose.deflection(one.tip_force)) for pose in at))
        case "stroke_force":
            return ca.vertcat(*(pose.stroke_force for pose in at))
        case "dexterity":
            return sum(_least_motion(pose.jacobian) for pose in at) / len(at)
        case "orientability":
            return sum(_least_turn(pose) for pose in at) / len(at)
        case "workspace_volume":
            return _swept([pose.tip_position for pose in at])
        case "deployment":
            gaps = deviations(q, poses)
            return ca.sqrt(ca.sumsqr(gaps) * 3 / gaps.numel() + ROUNDED**2)
        case "length":
            return q.tubes["straight_length"] + q.tubes["curved_length"]
        case "reach_radius":
            assert depth_pose is not None
            return ca.norm_2(q.poses[depth_pose].tip_position[:2])
        case "tip_curvature":
            return _tip_curvature(one, q)
        case _:
            return 1 / _tip_curvature(one, q)


def _scaled(jacobian: Any) -> Any:
    """A Jacobian (3, 2 n) by rotations and translations, for 1 rad or PER_TURN."""
    n = jacobian.shape[1] // 2
    return ca.horzcat(jacobian[:, :n], PER_TURN * jacobian[:, n:])


def _least_turn(pose: PoseQuantities) -> Any:
    """(s_1^-8 + s_2^-8)^(-1/8) of the singular values of the change of the tip's direction by joints that leave its
    place, rad: of what is left of its squares when the part that places the tip is eliminated."""
    moves, heading = _scaled(pose.jacobian) / UNIT, pose.tip_direction
    turns = -ca.skew(heading) @ _scaled(pose.turning)
    free = ca.DM.eye(moves.shape[1]) - moves.T @ ca.inv(moves @ moves.T + REGULAR * ca.DM.eye(3)) @ moves
    square = turns @ free @ turns.T  # its third eigenvalue, along the direction, is 0
    plain = ca.trace(square)
    total = plain + 2 * SLIGHT
    product = (plain**2 - ca.trace(square @ square)) / 2 + SLIGHT * plain + SLIGHT**2
    quartic = (total**2 - 2 * product) ** 2 - 2 * product**2
    return ca.sqrt(product) * quartic ** (-1 / 8)


def _least_motion(jacobian: Any) -> Any:
    """(sum s_k^-8)^(-1/8) of the singular values of a Jacobian of the tip (3, 2 n) by rotations and translations, m."""
    scaled = _scaled(jacobian) / UNIT
    inverse = ca.inv(scaled @ scaled.T + REGULAR * ca.DM.eye(3))
    return UNIT * ca.trace(inverse @ inverse @ inverse @ inverse) ** (-1 / 8)


def _swept(tips: Sequence[Any]) -> Any:
    """Volume of the body of revolution of a polygon of places (3,), by Pappus: positive however it is walked round."""
    radius = [ca.sqrt(tip[0] ** 2 + tip[1] ** 2 + ROUNDED**2) for tip in tips]
    total = 0.0
    for k, tip in enumerate(tips):
        r, z, s, w = radius[k - 1], tips[k - 1][2], radius[k], tip[2]
        total += (r * w - s * z) * (r + s)
    return np.pi / 3 * ca.sqrt(total**2 + 1e-12**2)


def _tip_curvature(one: Objective, q: Quantities) -> Any:
    """Curvature of the section at the tip, 1/m, with all tubes bending to one side."""
    shift = ca.DM.zeros(q.n_tubes) if one.translations is None else ca.DM(one.translations)
    kb, end = q.tubes["bending_stiffness"], shift + q.tubes["curved_length"]
    there = kb * (end >= ca.mmax(end) - ROUND_OFF)
    bent = there * ca.fabs(q.tubes["curvature"]) * (q.tubes["curved_length"] > 0)
    return cross_section(ca.DM.zeros(q.n_tubes), there, bent).curvature[0]
