"""Objectives that are stated as expressions: of one number, or of several of which the worst counts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import casadi as ca

from ..block.own import OwnObjective
from ..block.quantities import Expression, Quantities, recorded
from ..errors import InputError
from ..physics.torsion import cross_section
from ..robots.assembly import ROUND_OFF
from .objectives import Objective
from .statements import Points, Poses


@singledispatch
def aim(one: Any, pieces: Sequence[int], poses: Poses, certified: Points, depth_pose: int | None) -> Expression | None:
    """An objective in its own sign, SI, for tubes of so many pieces: the largest of its numbers counts where less is
    better, the least where more is; None for the change of the unknowns, which is no matter of tubes and poses.

    `poses` are those whose margin counts, `certified` the translations of the certificate, `depth_pose` the pose of
    reach_radius.

    Raises:
        InputError: an own objective whose expression makes no sense.
    """
    raise NotImplementedError(type(one))


@aim.register
def _(one: OwnObjective, pieces: Sequence[int], poses: Poses, certified: Points, depth_pose: int | None) -> Expression:
    found = recorded(one.expression, len(pieces), max(poses, default=-1) + 1, one.words, pieces)
    if found.value.numel_out() != 1:
        raise InputError(f"the objective {one.words} has {found.value.numel_out()} numbers; it must be one")
    return found


@aim.register
def _(
    one: Objective, pieces: Sequence[int], poses: Poses, certified: Points, depth_pose: int | None
) -> Expression | None:
    if one.kind == "change":
        return None

    def numbers(q: Quantities) -> Any:
        match one.kind:
            case "strain":
                return ca.vertcat(*(q.straightened_strain(i) for i in range(len(pieces))))
            case "margin" if certified:
                return ca.vertcat(*(q.certificate(row) for row in certified))
            case "margin":
                return ca.vertcat(*(q.poses[k].margin for k in poses))
            case "tip_deflection":
                return ca.vertcat(*(ca.norm_2(q.poses[k].deflection(one.tip_force)) for k in poses))
            case "tip_stiffness":
                force = ca.DM(list(one.tip_force or ()))
                return ca.vertcat(
                    *(ca.sumsqr(force) / ca.dot(force, q.poses[k].deflection(one.tip_force)) for k in poses)
                )
            case "stroke_force":
                return ca.vertcat(*(q.poses[k].stroke_force for k in poses))
            case "length":
                return q.tubes["straight_length"] + q.tubes["curved_length"]
            case "reach_radius":
                assert depth_pose is not None
                return ca.norm_2(q.poses[depth_pose].tip_position[:2])
            case "tip_curvature":
                return _tip_curvature(one, q)
            case _:
                return 1 / _tip_curvature(one, q)

    return recorded(numbers, len(pieces), max([*poses, depth_pose or 0], default=-1) + 1, one.words, pieces)


def _tip_curvature(one: Objective, q: Quantities) -> Any:
    """Curvature of the section at the tip, 1/m, with all tubes bending to one side."""
    shift = ca.DM.zeros(q.n_tubes) if one.translations is None else ca.DM(one.translations)
    kb, end = q.tubes["bending_stiffness"], shift + q.tubes["curved_length"]
    there = kb * (end >= ca.mmax(end) - ROUND_OFF)
    bent = there * ca.fabs(q.tubes["curvature"]) * (q.tubes["curved_length"] > 0)
    return cross_section(ca.DM.zeros(q.n_tubes), there, bent).curvature[0]
