"""Requirements as expressions of tubes and poses, at least 0 where they are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from typing import Any

import casadi as ca
import numpy as np

from ..block.custom import CustomRequirement
from ..block.quantities import Expression, PoseQuantities, Quantities, recorded
from .requirements import (
    SHARES,
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


@dataclass(frozen=True)
class Limit:
    """What a group of rows is about."""

    words: str
    """What is limited."""
    value: float
    """The limit, SI."""
    most: bool
    """Whether the limit is an upper one."""
    unit: str
    """In which it is shown."""
    factor: float
    """What turns SI into that unit."""
    size: float
    """SI change that counts as one step when limits are relaxed against each other."""
    movable: bool = True
    """Whether it may be relaxed."""

    def shown(self, value: float | None = None) -> str:
        """The limit, or another value of the same kind, with its unit."""
        number = f"{(self.value if value is None else value) * self.factor:.4g}"
        return f"{number} {self.unit}".strip()


@dataclass(frozen=True, eq=False)
class Statement:
    """A limit as an expression."""

    part: int
    """Tells the statements of a requirement apart."""
    limit: Limit
    expression: Expression
    """(K,) >= 0, SI."""
    vector: Expression | None = None
    """(3 K,), one after the other, where the length of a vector is limited."""
    always: bool = False
    """Whether it stays a constraint though no unknown may move it for a while."""


Poses = tuple[int, ...]
Points = Sequence[tuple[float, ...]]
Stated = Iterator[tuple[Limit, Function, Function | None]]


def statements(
    requirement: Requirement, pieces: Sequence[int], poses: Poses, points: Points = ()
) -> tuple[Statement, ...]:
    """What a requirement states as expressions, for tubes of so many pieces; () where it is none of that kind.

    `poses` are those that it is about: its own for Reach and Coverage, also those on joint paths for SnapFreeInUse, all
    task poses for others. `points` are those of a box in the program for Coverage, the translations of the certificate
    for SnapFree.
    """
    n, count, own = len(pieces), max(poses, default=-1) + 1, isinstance(requirement, CustomRequirement)

    def record(function: Function, limit: Limit) -> Expression:
        return recorded(function, n, count, limit.words, pieces)

    return tuple(
        Statement(k, limit, record(function, limit), None if vector is None else record(vector, limit), own)
        for k, (limit, function, vector) in enumerate(_stated(requirement, n, poses, points))
    )


def _stated(one: Requirement, n: int, poses: Poses, points: Points) -> Stated:
    """Every limit, what is left of it, and the vector whose length it limits: of tubes and certificates."""
    match one:
        case CustomRequirement():
            movable = one.relaxed(one.size) is not None
            limit = Limit(
                one.words, float(one.limit), bool(one.is_upper_bound), one.unit, one.factor, one.size, movable
            )
            yield limit, one.expression, None
        case SnapFree(floor=least):
            limit = Limit("certified margin", least, False, "", 1.0, 0.1)
            yield limit, lambda q: ca.vertcat(*(q.certificate(row) for row in points)) - least, None
        case Nesting(clearance=least) if n > 1:
            limit = Limit("clearance of the diameters", least, False, "mm", 1e3, 1e-4)
            yield limit, lambda q: q.tubes["inner_diameter"][1:] - q.tubes["outer_diameter"][:-1] - least, None
        case Wall(thickness=least):
            limit = Limit("wall thickness", least, False, "mm", 1e3, 1e-4)
            yield limit, lambda q: (q.tubes["outer_diameter"] - q.tubes["inner_diameter"]) / 2 - least, None
        case Length(field=field, tube=i):
            sign, whole = 1.0 if one.least else -1.0, field == "length"
            words = f"{'overall length' if whole else field.replace('_', ' ')} of tube {i + 1}"
            parts = ("straight_length", "curved_length") if whole else (field,)
            limit = Limit(words, one.limit, not one.least, "mm", 1e3, 1e-2)
            yield limit, lambda q: sign * (sum(q.tubes[part][i] for part in parts) - limit.value), None
        case _:
            yield from _stated_of_poses(one, poses, points)


def _stated_of_poses(one: Requirement, poses: Poses, points: Points) -> Stated:
    match one:
        case SnapFreeInUse(margin=least) if poses:
            limit = Limit("margin in use", least, False, "", 1.0, 0.1)
            yield limit, lambda q: ca.vertcat(*(e.margin for e in arms(q, poses, one.deployed))) - least, None
        case Strain(limits=limits):
            posed = poses if one.in_poses else ()
            for i, most in enumerate(limits if one.straightened or posed else ()):
                limit = Limit(f"strain of tube {i + 1}", most, True, "%", 1e2, 1e-3)
                yield limit, partial(_unstrained, one, posed, i), None
        case Avoid(clearance=least) if poses:
            limit = Limit("clearance of the obstacles", least, False, "mm", 1e3, 1e-3)
            yield limit, lambda q: ca.vertcat(*(e.clearance(one) for e in arms(q, poses, one.deployed))) - least, None
        case Stroke(limit=most) if len(poses) > 1:
            limit = Limit("stroke of a carriage", most, True, "mm", 1e3, 1e-2)
            yield limit, lambda q: most - ca.vertcat(*_travels(q, poses)), None
        case StrokeForce(limit=least):
            limit = Limit("stroke force", least, False, "mN", 1e3, 1e-2)
            yield limit, lambda q: ca.vertcat(*(q.poses[k].stroke_force for k in poses)) - least, None
        case Reach(targets=targets):
            for k, (pose, target) in enumerate(zip(poses, targets, strict=True), start=1):
                limit = Limit(f"tolerance of target {k}", target.tolerance, True, "mm", 1e3, 1e-3)
                yield _near(limit, (pose,), (target.position,))
                if target.direction is not None:
                    words, most = f"tolerance of the direction at target {k}", target.direction_tolerance
                    limit = Limit(words, most, True, "deg", 180 / np.pi, np.radians(5.0))
                    yield limit, partial(_along, limit, pose, target.direction), None
        case Coverage(tolerance=most):
            limit = Limit("tolerance of the workspace box", most, True, "mm", 1e3, 1e-3)
            yield _near(limit, poses, points)
        case _:
            return


def arms(q: Quantities, poses: Poses, deployed: bool) -> list[PoseQuantities]:
    """The arms of some poses; with `deployed` also those on their way out."""
    drawn = SHARES if deployed else ()
    return [arm for k in poses for arm in (q.poses[k], *(q.poses[k].drawn(share) for share in drawn))]


def _travels(q: Quantities, poses: Poses) -> list[Any]:
    return [q.poses[a].translations - q.poses[b].translations for a, b in permutations(poses, 2)]


def _unstrained(one: Strain, poses: Poses, tube: int, q: Quantities) -> Any:
    """What is left of the strain of a tube."""
    straight = [q.straightened_strain(tube)] if one.straightened else []
    return one.limits[tube] - ca.vertcat(*straight, *(q.poses[k].strain(tube) for k in poses))


# Requirements of one limit: the field that is it, and whether it rises (1) or falls (-1) to the easier side.
LIMITS = {
    SnapFreeInUse: ("margin", -1),
    Nesting: ("clearance", -1),
    Wall: ("thickness", -1),
    Stroke: ("limit", 1),
    StrokeForce: ("limit", -1),
    Coverage: ("tolerance", 1),
    Avoid: ("clearance", -1),
}


def relaxed(requirement: Requirement, part: int, amount: float) -> Requirement:
    """The requirement with the limit of one of its statements moved by `amount` > 0, SI, to the easier side."""
    match requirement:
        case SnapFree():
            return requirement.eased(amount)
        case Strain(limits=limits):
            return replace(requirement, limits=tuple(most + amount * (i == part) for i, most in enumerate(limits)))
        case Length(limit=limit, least=least):
            return replace(requirement, limit=limit + (-amount if least else amount))
        case Reach(targets=targets):
            both = [(k, name) for k in range(len(targets)) for name in ("tolerance", "direction_tolerance")]
            k, field = [each for each in both if each[1] == "tolerance" or targets[each[0]].direction is not None][part]
            eased = replace(targets[k], **{field: getattr(targets[k], field) + amount})
            return replace(requirement, targets=(*targets[:k], eased, *targets[k + 1 :]))
        case CustomRequirement():
            return requirement.relaxed(amount) or requirement
    field, sign = LIMITS[type(requirement)]
    moved = getattr(requirement, field) + sign * amount
    return replace(requirement, **{field: max(0.0, moved) if isinstance(requirement, Nesting) else moved})


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
