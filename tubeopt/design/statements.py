"""Requirements that are stated as expressions: of tubes and poses, at least 0 where they are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, singledispatch
from itertools import permutations
from typing import Any

import casadi as ca
import numpy as np

from ..block.own import OwnRequirement
from ..block.quantities import Expression, PoseQuantities, Quantities, recorded
from .drawn import SHARES
from .limit import Limit
from .requirements import (
    Avoid,
    Coverage,
    Length,
    Nesting,
    Reach,
    Requirement,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    StrokeForce,
    Wall,
)

Function = Callable[[Quantities], Any]


@dataclass(frozen=True, eq=False)
class Statement:
    """A limit as an expression (K,) >= 0, SI. Where it limits the length of a vector, `vector` (3 K,) is that, one
    after the other. `part` tells the statements of a requirement apart; `always`: it stays a constraint though it may
    not move for a while."""

    part: int
    limit: Limit
    expression: Expression
    vector: Expression | None = None
    always: bool = False


Poses = tuple[int, ...]
Points = Sequence[tuple[float, ...]]


def statements(
    requirement: Requirement, pieces: Sequence[int], poses: Poses, points: Points = ()
) -> tuple[Statement, ...]:
    """What a requirement states as expressions, for tubes of so many pieces; () where it is none of that kind.

    `poses` are those that it is about: its own for Reach and Coverage, also those on joint paths for SnapFreeInUse, all
    task poses for others. `points` are those of a box in the program for Coverage, the translations of the certificate
    for SnapFree.

    Raises:
        InputError: an own requirement whose expression makes no sense.
    """
    n, count = len(pieces), max(poses, default=-1) + 1
    out = []
    for k, (limit, function, vector) in enumerate(_stated(requirement, n, poses, points)):
        own = isinstance(requirement, OwnRequirement)
        words = limit.words
        found = None if vector is None else recorded(vector, n, count, words, pieces)
        out.append(Statement(k, limit, recorded(function, n, count, words, pieces), found, own))
    return tuple(out)


Stated = list[tuple[Limit, Function, Function | None]]


@singledispatch
def _stated(requirement: Requirement, n: int, poses: Poses, points: Points) -> Stated:
    return []


@_stated.register
def _(requirement: OwnRequirement, n: int, poses: Poses, points: Points) -> Stated:
    one, movable = requirement, requirement.relaxed(requirement.size) is not None
    limit = Limit(one.words, float(one.limit), bool(one.most), one.unit, one.factor, one.size, movable)
    return [(limit, one.expression, None)]


@_stated.register
def _(requirement: SnapFree, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("certified margin", requirement.floor, False, "", 1.0, 0.1)

    def room(q: Quantities) -> Any:
        return ca.vertcat(*(q.certificate(row) for row in points)) - requirement.floor

    return [(limit, room, None)]


def arms(q: Quantities, poses: Poses, deployed: bool) -> list[PoseQuantities]:
    """The arms of some poses; with `deployed` also those on their way out."""
    drawn = SHARES if deployed else ()
    return [arm for k in poses for arm in (q.poses[k], *(q.poses[k].drawn(share) for share in drawn))]


@_stated.register
def _(requirement: SnapFreeInUse, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("margin in use", requirement.margin, False, "", 1.0, 0.1)

    def room(q: Quantities) -> Any:
        return ca.vertcat(*(arm.margin for arm in arms(q, poses, requirement.deployed))) - requirement.margin

    return [(limit, room, None)] if poses else []


@_stated.register
def _(requirement: Strain, n: int, poses: Poses, points: Points) -> Stated:
    posed = poses if requirement.in_poses else ()

    def room(q: Quantities, tube: int) -> Any:
        straight = [q.straightened_strain(tube)] if requirement.straightened else []
        return requirement.limits[tube] - ca.vertcat(*straight, *(q.poses[k].strain(tube) for k in posed))

    limits = [Limit(f"strain of tube {i + 1}", most, True, "%", 1e2, 1e-3) for i, most in enumerate(requirement.limits)]
    some = requirement.straightened or posed
    return [(limit, partial(room, tube=i), None) for i, limit in enumerate(limits)] if some else []


@_stated.register
def _(requirement: Avoid, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("clearance of the obstacles", requirement.clearance, False, "mm", 1e3, 1e-3)

    def room(q: Quantities) -> Any:
        rooms = (arm.clearance(requirement) for arm in arms(q, poses, requirement.deployed))
        return ca.vertcat(*rooms) - requirement.clearance

    return [(limit, room, None)] if poses else []


@_stated.register
def _(requirement: Nesting, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("clearance of the diameters", requirement.clearance, False, "mm", 1e3, 1e-4)

    def gaps(q: Quantities) -> Any:
        return q.tubes["inner_diameter"][1:] - q.tubes["outer_diameter"][:-1] - requirement.clearance

    return [(limit, gaps, None)] if n > 1 else []


@_stated.register
def _(requirement: Wall, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("wall thickness", requirement.thickness, False, "mm", 1e3, 1e-4)

    def walls(q: Quantities) -> Any:
        return (q.tubes["outer_diameter"] - q.tubes["inner_diameter"]) / 2 - requirement.thickness

    return [(limit, walls, None)]


@_stated.register
def _(requirement: Length, n: int, poses: Poses, points: Points) -> Stated:
    field, i, sign = requirement.field, requirement.tube, 1.0 if requirement.least else -1.0
    words = f"{'overall length' if field == 'length' else field.replace('_', ' ')} of tube {i + 1}"
    limit = Limit(words, requirement.limit, not requirement.least, "mm", 1e3, 1e-2)
    parts = ("straight_length", "curved_length") if field == "length" else (field,)

    def room(q: Quantities) -> Any:
        return sign * (sum(q.tubes[part][i] for part in parts) - requirement.limit)

    return [(limit, room, None)]


@_stated.register
def _(requirement: Stroke, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("stroke of a carriage", requirement.limit, True, "mm", 1e3, 1e-2)

    def room(q: Quantities) -> Any:
        moved = [q.poses[a].translations - q.poses[b].translations for a, b in permutations(poses, 2)]
        return requirement.limit - ca.vertcat(*moved)

    return [(limit, room, None)] if len(poses) > 1 else []


@_stated.register
def _(requirement: StrokeForce, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("stroke force", requirement.limit, False, "mN", 1e3, 1e-2)

    def room(q: Quantities) -> Any:
        return ca.vertcat(*(q.poses[k].stroke_force for k in poses)) - requirement.limit

    return [(limit, room, None)]


@_stated.register
def _(requirement: Reach, n: int, poses: Poses, points: Points) -> Stated:
    out: Stated = []
    for k, (index, target) in enumerate(zip(poses, requirement.targets, strict=True)):
        limit = Limit(f"tolerance of target {k + 1}", target.tolerance, True, "mm", 1e3, 1e-3)
        out.append(_near(limit, (index,), (target.position,)))
        if target.direction is not None:
            words = f"tolerance of the direction at target {k + 1}"
            limit = Limit(words, target.direction_tolerance, True, "deg", 180 / np.pi, np.radians(5.0))
            out.append((limit, partial(_along, limit, index, target.direction), None))
    return out


@_stated.register
def _(requirement: Coverage, n: int, poses: Poses, points: Points) -> Stated:
    limit = Limit("tolerance of the workspace box", requirement.tolerance, True, "mm", 1e3, 1e-3)
    return [_near(limit, poses, points)]


def reach_parts(requirement: Reach) -> list[tuple[int, str]]:
    """The target and its tolerance that each part of the statements of a requirement limits."""
    both = [(k, name) for k in range(len(requirement.targets)) for name in ("tolerance", "direction_tolerance")]
    return [(k, name) for k, name in both if name == "tolerance" or requirement.targets[k].direction is not None]


def _near(limit: Limit, poses: Poses, points: Points) -> tuple[Limit, Function, Function]:
    """The tips of poses are within the limit's value of points."""

    def gap(q: Quantities) -> Any:
        return ca.vertcat(*(q.poses[k].tip_position - ca.DM(p) for k, p in zip(poses, points, strict=True)))

    def room(q: Quantities) -> Any:
        # Rounded off near the target, to be smooth at the target itself.
        soft = 0.03 * limit.value
        distance = ca.sqrt(ca.sum1(ca.reshape(gap(q), 3, len(poses)) ** 2) + soft**2)
        return np.sqrt(limit.value**2 + soft**2) - distance.T

    return limit, room, gap


def _along(limit: Limit, pose: int, direction: tuple[float, ...], q: Quantities) -> Any:
    """What is left of the direction's tolerance, rad."""
    heading, wanted = q.poses[pose].tip_direction, ca.DM(direction)
    apart, together = (ca.sqrt(ca.sumsqr(heading + sign * wanted) + 1e-9**2) for sign in (-1, 1))
    return limit.value - 2 * ca.atan2(apart, together)
