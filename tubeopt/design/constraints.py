"""Requirements as expressions of tubes and poses, at least 0 where they are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..block.custom import CustomRequirement
from ..block.quantities import Expression, PoseQuantities, Quantities, recorded
from ..robots.eccentric import BundleRobot
from ..robots.robot import Robot
from .parameters import DesignSpace
from .requirements import (
    DEPLOYED_FRACTIONS,
    Avoid,
    Bore,
    Channel,
    Coverage,
    Girth,
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

ORDER_RESERVE = 1e-4
"""Reserve (m) of the order of the ends in a design: the accuracy of cut tubes, or 3 % of 3 mm for their curvature."""

Function = Callable[[Quantities], Any]


@dataclass(frozen=True)
class Limit:
    """Limit that a group of constraints expresses."""

    description: str
    """Name of the limited quantity."""
    value: float
    """Value of the limit, SI."""
    is_upper_bound: bool
    """True for an upper limit."""
    unit: str
    """Unit for display."""
    factor: float
    """Factor from SI to that unit."""
    size: float
    """SI change that counts as one step when limits are relaxed against each other."""
    movable: bool = True
    """True if the limit may be relaxed."""

    def shown(self, value: float | None = None) -> str:
        """Text of the limit, or of another value of the same quantity, with its unit."""
        number = f"{(self.value if value is None else value) * self.factor:.4g}"
        return f"{number} {self.unit}".strip()


@dataclass(frozen=True, eq=False)
class Statement:
    """Limit as an expression."""

    part: int
    """Index among the statements of its requirement."""
    limit: Limit
    expression: Expression
    """Distances (K,) to the limit, SI; >= 0 if it is satisfied."""
    vector: Expression | None = None
    """Vectors (3 K,), one after the other, if the limit is on their lengths."""
    always: bool = False
    """True if it stays a constraint where its derivative is 0."""


Poses = tuple[int, ...]
Points = Sequence[tuple[float, ...]]


class Stated(NamedTuple):
    """Limit of a requirement as functions of the quantities of a design."""

    limit: Limit
    remaining: Function
    """Distances to the limit, at least 0 where it is kept."""
    vector: Function | None = None
    """Vectors whose length is limited; None for other limits."""


def statements(
    requirement: Requirement, space: DesignSpace, poses: Poses, points: Points = ()
) -> tuple[Statement, ...]:
    """Limits of a requirement as expressions; () if it has none.

    Args:
        space: unknowns of the design.
        poses: numbers of the poses to which it applies: its own for Reach and Coverage, also those on joint paths for
            SnapFreeInUse, all task poses for others.
        points: positions for Coverage, translations of the certificate for SnapFree.
    """
    pieces, count, always = space.pieces, max(poses, default=-1) + 1, isinstance(requirement, CustomRequirement)

    def record(function: Function, limit: Limit) -> Expression:
        return recorded(function, len(pieces), count, limit.description, pieces)

    return tuple(
        Statement(k, limit, record(function, limit), None if vector is None else record(vector, limit), always)
        for k, (limit, function, vector) in enumerate(_stated(requirement, space.robot, poses, points))
    )


def _stated(requirement: Requirement, robot: Robot, poses: Poses, points: Points) -> Iterator[Stated]:
    """Limits of requirements on tubes alone: each with the distance to it, and the vector if its length is limited."""
    match requirement:
        case CustomRequirement():
            movable = requirement.relaxed(requirement.size) is not None
            limit = Limit(
                requirement.description,
                float(requirement.limit),
                is_upper_bound=bool(requirement.is_upper_bound),
                unit=requirement.unit,
                factor=requirement.factor,
                size=requirement.size,
                movable=movable,
            )
            yield Stated(limit, requirement.expression)
        case SnapFree(required_margin=lower):
            limit = Limit("certified margin", lower, is_upper_bound=False, unit="", factor=1.0, size=0.1)
            yield Stated(limit, lambda q: ca.vertcat(*(q.certificate(row) for row in points)) - lower)
            if isinstance(robot, BundleRobot) and robot.n_tubes > 1:
                # Their ends must keep their order, or the number proves nothing.
                limit = Limit(
                    "reserve of the order of the ends",
                    ORDER_RESERVE,
                    is_upper_bound=False,
                    unit="mm",
                    factor=1e3,
                    size=1e-3,
                    movable=False,
                )
                yield Stated(limit, lambda q: ca.vertcat(*(q.order_reserve(row) for row in points)) - ORDER_RESERVE)
        case Nesting(clearance=lower) if robot.nested_pairs:
            inner, outer = (list(tubes) for tubes in zip(*robot.nested_pairs, strict=True))
            limit = Limit("clearance of the diameters", lower, is_upper_bound=False, unit="mm", factor=1e3, size=1e-4)
            yield Stated(limit, lambda q: q.tubes["inner_diameter"][outer] - q.tubes["outer_diameter"][inner] - lower)
        case Channel(diameter=lower):
            limit = Limit("channel between the tubes", lower, is_upper_bound=False, unit="mm", factor=1e3, size=1e-4)
            yield Stated(limit, lambda q: q.channel - lower)
        case Bore(diameter=lower):
            around = {outer for _, outer in robot.nested_pairs}
            innermost = [i for i in range(robot.n_tubes) if i not in around]
            limit = Limit("bore of the innermost tubes", lower, is_upper_bound=False, unit="mm", factor=1e3, size=1e-4)
            yield Stated(limit, lambda q: q.tubes["inner_diameter"][innermost] - lower)
        case Girth(limit=upper):
            limit = Limit("diameter of the sheath", upper, is_upper_bound=True, unit="mm", factor=1e3, size=1e-4)
            yield Stated(limit, lambda q: upper - q.sheath_diameter)
        case Wall(thickness=lower):
            limit = Limit("wall thickness", lower, is_upper_bound=False, unit="mm", factor=1e3, size=1e-4)
            yield Stated(limit, lambda q: (q.tubes["outer_diameter"] - q.tubes["inner_diameter"]) / 2 - lower)
        case Length(field=field, tube=i):
            sign, overall = 1.0 if requirement.least else -1.0, field == "length"
            name = f"{'overall length' if overall else field.replace('_', ' ')} of tube {i + 1}"
            parts = ("straight_length", "curved_length") if overall else (field,)
            limit = Limit(
                name, requirement.limit, is_upper_bound=not requirement.least, unit="mm", factor=1e3, size=1e-2
            )
            yield Stated(limit, lambda q: sign * (sum(q.tubes[part][i] for part in parts) - limit.value))
        case _:
            yield from _stated_of_poses(requirement, poses, points)


def _stated_of_poses(requirement: Requirement, poses: Poses, points: Points) -> Iterator[Stated]:
    """Limits of requirements on poses: each with the distance to it, and the vector if its length is limited."""
    match requirement:
        case SnapFreeInUse(margin=lower) if poses:
            limit = Limit("margin in use", lower, is_upper_bound=False, unit="", factor=1.0, size=0.1)
            yield Stated(limit, lambda q: ca.vertcat(*(e.margin for e in arms(q, poses, requirement.deployed))) - lower)
        case Strain(limits=limits):
            posed = poses if requirement.in_poses else ()
            for i, upper in enumerate(limits if requirement.straightened or posed else ()):
                limit = Limit(f"strain of tube {i + 1}", upper, is_upper_bound=True, unit="%", factor=1e2, size=1e-3)
                yield Stated(limit, partial(_remaining_strain, requirement, posed, i))
        case Avoid(clearance=lower) if poses:
            limit = Limit("clearance of the obstacles", lower, is_upper_bound=False, unit="mm", factor=1e3, size=1e-3)
            yield Stated(
                limit,
                lambda q: ca.vertcat(*(e.clearance(requirement) for e in arms(q, poses, requirement.deployed))) - lower,
            )
        case Stroke(limit=upper) if len(poses) > 1:
            limit = Limit("stroke of a carriage", upper, is_upper_bound=True, unit="mm", factor=1e3, size=1e-2)
            yield Stated(limit, partial(_remaining_stroke, upper, poses))
        case StrokeForce(limit=lower):
            limit = Limit("stroke force", lower, is_upper_bound=False, unit="mN", factor=1e3, size=1e-2)
            yield Stated(limit, lambda q: ca.vertcat(*(q.poses[k].stroke_force for k in poses)) - lower)
        case Reach(targets=targets):
            for k, (pose, target) in enumerate(zip(poses, targets, strict=True), start=1):
                limit = Limit(
                    f"tolerance of target {k}", target.tolerance, is_upper_bound=True, unit="mm", factor=1e3, size=1e-3
                )
                yield _near(limit, (pose,), (target.position,))
                if target.direction is not None:
                    name, upper = f"tolerance of the direction at target {k}", target.direction_tolerance
                    limit = Limit(
                        name, upper, is_upper_bound=True, unit="deg", factor=180 / np.pi, size=np.radians(5.0)
                    )
                    yield Stated(limit, partial(_along, limit, pose, target.direction))
        case Coverage(tolerance=upper):
            limit = Limit(
                "tolerance of the workspace box", upper, is_upper_bound=True, unit="mm", factor=1e3, size=1e-3
            )
            yield _near(limit, poses, points)
        case _:
            return


def arms(q: Quantities, poses: Poses, deployed: bool) -> list[PoseQuantities]:
    """Arms of some poses; with `deployed` also the partly deployed ones."""
    fractions = DEPLOYED_FRACTIONS if deployed else ()
    return [arm for k in poses for arm in (q.poses[k], *(q.poses[k].retracted(fraction) for fraction in fractions))]


def _remaining_stroke(limit: float, poses: Poses, q: Quantities) -> Any:
    """Stroke limit minus the travel of each carriage between any two poses."""
    return limit - ca.vertcat(*(q.poses[a].translations - q.poses[b].translations for a, b in permutations(poses, 2)))


def _remaining_strain(requirement: Strain, poses: Poses, tube: int, q: Quantities) -> Any:
    """Strain limit of a tube minus its strains, when straightened and in poses."""
    straight = [q.straightened_strain(tube)] if requirement.straightened else []
    return requirement.limits[tube] - ca.vertcat(*straight, *(q.poses[k].strain(tube) for k in poses))


# Requirements with one limit: its field, and the sign by which it is relaxed.
LIMITS = {
    SnapFreeInUse: ("margin", -1),
    Nesting: ("clearance", -1),
    Wall: ("thickness", -1),
    Channel: ("diameter", -1),
    Bore: ("diameter", -1),
    Girth: ("limit", 1),
    Stroke: ("limit", 1),
    StrokeForce: ("limit", -1),
    Coverage: ("tolerance", 1),
    Avoid: ("clearance", -1),
}


def relaxed(requirement: Requirement, part: int, amount: float) -> Requirement:
    """Requirement with the limit of one statement relaxed by `amount` > 0, SI."""
    match requirement:
        case SnapFree():
            return requirement.eased(amount)
        case Strain(limits=limits):
            return replace(requirement, limits=tuple(upper + amount * (i == part) for i, upper in enumerate(limits)))
        case Length(limit=limit, least=is_lower):
            return replace(requirement, limit=limit + (-amount if is_lower else amount))
        case Reach(targets=targets):
            parts = [
                (k, name)
                for k, target in enumerate(targets)
                for name in ("tolerance", "direction_tolerance")
                if name == "tolerance" or target.direction is not None
            ]
            k, field = parts[part]
            eased = replace(targets[k], **{field: getattr(targets[k], field) + amount})
            return replace(requirement, targets=(*targets[:k], eased, *targets[k + 1 :]))
        case CustomRequirement():
            return requirement.relaxed(amount) or requirement
    field, sign = LIMITS[type(requirement)]
    moved = getattr(requirement, field) + sign * amount
    return replace(requirement, **{field: max(0.0, moved) if isinstance(requirement, Nesting) else moved})


def _near(limit: Limit, poses: Poses, points: Points) -> Stated:
    """Limit on the distances of pose tips from points: excess of the limit, and vectors from the points."""

    def offsets(q: Quantities) -> Any:
        return ca.vertcat(*(q.poses[k].tip_position - ca.DM(p) for k, p in zip(poses, points, strict=True)))

    def remaining(q: Quantities) -> Any:
        # Rounded off near the target, to be smooth at the target itself.
        soft = 0.03 * limit.value
        distance = ca.sqrt(ca.sum1(ca.reshape(offsets(q), 3, len(poses)) ** 2) + soft**2)
        return np.sqrt(limit.value**2 + soft**2) - distance.T

    return Stated(limit, remaining, offsets)


def _along(limit: Limit, pose: int, direction: tuple[float, ...], q: Quantities) -> Any:
    """Angular tolerance of the tip direction minus its error, rad."""
    # The angle between unit vectors a and b is 2 atan2(|a - b|, |a + b|), accurate near 0 and pi.
    heading, target = q.poses[pose].tip_direction, ca.DM(direction)
    difference, total = (ca.sqrt(ca.sumsqr(heading + sign * target) + 1e-9**2) for sign in (-1, 1))
    return limit.value - 2 * ca.atan2(difference, total)
