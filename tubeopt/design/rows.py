"""Requirements as rows of constraints g(x) >= 0, in groups that can be named, relaxed and priced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from itertools import pairwise

import numpy as np

from ..robots.assembly import Array
from ..robots.limits import JointLimits
from .anatomy import arm_rows
from .order import Place, order_gaps
from .requirements import (
    Avoid,
    Corridor,
    Coverage,
    Length,
    Nesting,
    Poses,
    Reach,
    Requirement,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    Target,
    Wall,
    corridor_distance,
    obstacle_distance,
)
from .state import FreePose, State, Via

HELD = 5e-8
"""Part of a step by which limits are held inside, so that what a solver leaves open does not violate them."""

ORDERED = 9e-8
"""The same for joints and the order of tubes, in steps of 10 mm: planning allows no more than round-off."""

SOFT = 0.03
"""Part of a target's tolerance within which the distance from it is rounded off, to be smooth at the target itself."""


@dataclass(frozen=True)
class Limit:
    """What a group of rows is about.

    words: what is limited.  value: the limit, SI.  most: whether the limit is an upper one.  unit, factor: how it is
    shown.  size: SI change that counts as one step when limits are relaxed against each other.
    """

    words: str
    value: float
    most: bool
    unit: str
    factor: float
    size: float

    def shown(self, value: float | None = None) -> str:
        """The limit, or another value of the same kind, with its unit."""
        number = f"{(self.value if value is None else value) * self.factor:.4g}"
        return f"{number} {self.unit}".strip()


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one group: values (K,) and Jacobian (K, X), >= 0 where the limit is kept, in units of `limit.size`;
    `requirement` is the number of the requirement in the task, `part` tells its groups apart. Rows that limit the
    length of a vector tell it too: `vector` (K, 3) and its change (K, 3, X), in the same units, which leads least
    squares to 0 from far away faster than its length does. `slack`: steps by which the limit is eased, and
    their column."""

    requirement: int
    part: int
    limit: Limit
    values: Array
    jacobian: Array
    vector: tuple[Array, Array] | None = None
    slack: tuple[float, int] | None = None


def _rows(number: int, part: int, limit: Limit, values: Array, jacobian: Array) -> Rows:
    return Rows(number, part, limit, np.atleast_1d(values) / limit.size - HELD, np.atleast_2d(jacobian) / limit.size)


def _tip(state: State, index: int) -> tuple[Array, Array]:
    pose = state.pose(index)
    return pose.position[-1], pose.shape_slopes[0][-1] @ state.chain(index)


@singledispatch
def rows(requirement: Requirement, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    """Groups of rows of a requirement, the `number`-th of its task, at a state.

    `poses` are those that the requirement is about: its own for Reach, Coverage and Poses, via points for margins.
    """
    raise TypeError(f"{type(requirement).__name__} is no requirement")


@rows.register
def _(requirement: SnapFree, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    found = [state.certificate(k) for k in range(len(state.layout.certified))]
    limit = Limit("certified margin", requirement.margin, False, "", 1.0, 0.1)
    values = np.array([value for value, _ in found]) - requirement.margin
    return [_rows(number, 0, limit, values, np.array([slope for _, slope in found]))]


@rows.register
def _(requirement: SnapFreeInUse, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    limit = Limit("margin in use", requirement.margin, False, "", 1.0, 0.1)
    values = np.array([state.pose(k).margin for k in poses]) - requirement.margin
    return [_rows(number, 0, limit, values, np.array([state.pose(k).margin_slope @ state.chain(k) for k in poses]))]


def straightened(state: State, tube: int) -> tuple[float, Array]:
    """Strain of a tube held straight, r kappa / (1 - r kappa), and its change (X,)."""
    shape = state.tubes[tube]
    radius, kappa = shape.outer_diameter / 2, abs(shape.curvature)
    bend = radius * kappa
    slope = radius * np.sign(shape.curvature) * state.slopes["curvature"][tube]
    slope = slope + 0.5 * kappa * state.slopes["outer_diameter"][tube]
    return bend / (1 - bend), slope / (1 - bend) ** 2


def pose_strain(state: State, index: int, tube: int) -> tuple[float, Array]:
    """Largest bending strain of a tube in a pose, r |u - u*| / (1 - r |u*|), and its change (X,)."""
    pose, shape = state.pose(index), state.tubes[tube]
    assembly, mesh = pose.problem.assembly, pose.problem.mesh
    places = len(pose.bend) // max(len(mesh.length), 1)
    section = np.repeat(mesh.section, places)
    present, curved = assembly.present[section, tube], assembly.curved[section, tube]
    if not present.any():
        return 0.0, np.zeros(state.layout.size)
    theta = pose.theta[:, tube]
    direction = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    natural = np.where(curved, shape.curvature, 0.0)
    gap = pose.bend - natural[:, None] * direction
    size = np.linalg.norm(gap, axis=1)
    radius = shape.outer_diameter / 2
    loss = 1 / (1 - radius * np.abs(natural))
    k = int(np.argmax(np.where(present, radius * size * loss, -1.0)))
    along = gap[k] / max(size[k], 1e-12)
    dtheta, du = pose.bend_slopes
    across = np.array([-direction[k, 1], direction[k, 0]])
    local = along @ du[k] - natural[k] * (along @ across) * dtheta[k, tube]
    slope = radius * loss[k] * (local @ state.chain(index))
    by_curvature = -radius * loss[k] * (along @ direction[k])
    by_curvature += radius**2 * size[k] * loss[k] ** 2 * np.sign(natural[k])
    slope = slope + curved[k] * by_curvature * state.slopes["curvature"][tube]
    by_radius = size[k] * loss[k] + radius * size[k] * abs(natural[k]) * loss[k] ** 2
    return float(radius * size[k] * loss[k]), slope + 0.5 * by_radius * state.slopes["outer_diameter"][tube]


@rows.register
def _(requirement: Strain, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    out = []
    for i in range(state.layout.n):
        found = [straightened(state, i)] if requirement.straightened else []
        if requirement.in_poses:
            found += [pose_strain(state, k, i) for k in poses]
        if found:
            limit = Limit(f"strain of tube {i + 1}", requirement.limits[i], True, "%", 1e2, 1e-3)
            values = limit.value - np.array([value for value, _ in found])
            out.append(_rows(number, i, limit, values, -np.array([slope for _, slope in found])))
    return out


@rows.register
def _(requirement: Nesting, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    limit = Limit("clearance of the diameters", requirement.clearance, False, "mm", 1e3, 1e-4)
    bores, walls = state.slopes["inner_diameter"], state.slopes["outer_diameter"]
    gaps = [outer.inner_diameter - inner.outer_diameter for inner, outer in pairwise(state.tubes)]
    return [_rows(number, 0, limit, np.array(gaps) - requirement.clearance, bores[1:] - walls[:-1])] if gaps else []


@rows.register
def _(requirement: Wall, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    limit = Limit("wall thickness", requirement.thickness, False, "mm", 1e3, 1e-4)
    walls = np.array([(tube.outer_diameter - tube.inner_diameter) / 2 for tube in state.tubes])
    slope = (state.slopes["outer_diameter"] - state.slopes["inner_diameter"]) / 2
    return [_rows(number, 0, limit, walls - requirement.thickness, slope)]


@rows.register
def _(requirement: Length, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    field, i = requirement.field, requirement.tube
    words = f"{'overall length' if field == 'length' else field.replace('_', ' ')} of tube {i + 1}"
    limit = Limit(words, requirement.limit, not requirement.least, "mm", 1e3, 1e-2)
    parts = ("straight_length", "curved_length") if field == "length" else (field,)
    slope = np.asarray(sum(state.slopes[part][i] for part in parts))
    value = getattr(state.tubes[i], field) - requirement.limit
    sign = 1.0 if requirement.least else -1.0
    return [_rows(number, 0, limit, np.array([sign * value]), sign * slope)]


@rows.register
def _(requirement: Stroke, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    limit = Limit("stroke of a carriage", requirement.limit, True, "mm", 1e3, 1e-2)
    values, slopes = [], []
    for a in poses:
        for b in poses:
            if a != b:
                gap = state.joint_values(a)[1] - state.joint_values(b)[1]
                values.append(requirement.limit - gap)
                slopes.append(state.joint_slopes(b)[1] - state.joint_slopes(a)[1])
    return [_rows(number, 0, limit, np.concatenate(values), np.concatenate(slopes))] if values else []


def _near_points(
    number: int, part: int, limit: Limit, state: State, aims: Sequence[tuple[int, tuple[float, ...]]]
) -> Rows:
    """Rows that keep the tip of poses within the limit's value of points, and the way from the points to the tips."""
    tips = [_tip(state, index) for index, _ in aims]
    gap = np.array([tip for tip, _ in tips]) - np.array([point for _, point in aims])
    slope = np.array([change for _, change in tips])
    soft = SOFT * limit.value
    distance = np.sqrt((gap**2).sum(1) + soft**2)
    values = np.sqrt(limit.value**2 + soft**2) - distance
    jacobian = -np.einsum("kc,kcx->kx", gap / distance[:, None], slope)
    return replace(_rows(number, part, limit, values, jacobian), vector=(gap / limit.size, slope / limit.size))


def _along(state: State, index: int, target: Target) -> tuple[float, Array]:
    """What is left of the direction's tolerance, rad, and its change (X,)."""
    pose = state.pose(index)
    heading, wanted = pose.frame[-1][:, 2], np.array(target.direction)
    angle = float(np.arctan2(np.linalg.norm(np.cross(heading, wanted)), heading @ wanted))
    turn = pose.shape_slopes[1][-1] @ state.chain(index)
    slope = np.cross(heading, wanted) @ turn / max(np.sin(angle), 1e-6)
    return target.direction_tolerance - angle, slope


@rows.register
def _(requirement: Reach, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    out = []
    for k, (index, target) in enumerate(zip(poses, requirement.targets, strict=True)):
        limit = Limit(f"tolerance of target {k + 1}", target.tolerance, True, "mm", 1e3, 1e-3)
        out.append(_near_points(number, 2 * k, limit, state, [(index, target.position)]))
        if target.direction is not None:
            words = f"tolerance of the direction at target {k + 1}"
            limit = Limit(words, target.direction_tolerance, True, "deg", 180 / np.pi, np.radians(5.0))
            value, slope = _along(state, index, target)
            out.append(_rows(number, 2 * k + 1, limit, np.array([value]), slope))
    return out


def coverage_rows(
    requirement: Coverage, number: int, state: State, poses: tuple[int, ...], points: list[tuple[float, ...]]
) -> list[Rows]:
    """Rows of a workspace box at the points of it that are in the program."""
    limit = Limit("tolerance of the workspace box", requirement.tolerance, True, "mm", 1e3, 1e-3)
    return [_near_points(number, 0, limit, state, list(zip(poses, points, strict=True)))]


@rows.register
def _(requirement: Poses, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    return []


@rows.register
def _(requirement: Corridor, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    limit = Limit("radius of the corridor", requirement.radius, True, "mm", 1e3, 1e-3)
    values, slopes = arm_rows(state, poses, lambda points: corridor_distance(requirement, points), -1.0)
    return [_rows(number, 0, limit, requirement.radius + values, slopes)]


@rows.register
def _(requirement: Avoid, number: int, state: State, poses: tuple[int, ...]) -> list[Rows]:
    limit = Limit("clearance of the obstacles", requirement.clearance, False, "mm", 1e3, 1e-3)
    values, slopes = arm_rows(state, poses, lambda points: obstacle_distance(requirement, points), 1.0)
    return [_rows(number, 0, limit, values - requirement.clearance, slopes)]


def relaxed(requirement: Requirement, part: int, amount: float) -> Requirement:
    """The requirement with the limit of one of its groups of rows moved by `amount` > 0, SI, to the easier side."""
    match requirement:
        case SnapFree() | SnapFreeInUse():
            return replace(requirement, margin=requirement.margin - amount)
        case Strain(limits=limits):
            raised = [limit + amount * (i == part) for i, limit in enumerate(limits)]
            return replace(requirement, limits=tuple(raised))
        case Nesting():
            return replace(requirement, clearance=max(0.0, requirement.clearance - amount))
        case Wall():
            return replace(requirement, thickness=requirement.thickness - amount)
        case Length():
            return replace(requirement, limit=requirement.limit + (-amount if requirement.least else amount))
        case Stroke():
            return replace(requirement, limit=requirement.limit + amount)
        case Reach(targets=targets):
            target = targets[part // 2]
            field = "direction_tolerance" if part % 2 else "tolerance"
            eased = replace(target, **{field: getattr(target, field) + amount})
            return replace(requirement, targets=(*targets[: part // 2], eased, *targets[part // 2 + 1 :]))
        case Coverage():
            return replace(requirement, tolerance=requirement.tolerance + amount)
        case Corridor():
            return replace(requirement, radius=requirement.radius + amount)
        case Avoid():
            return replace(requirement, clearance=requirement.clearance - amount)
        case _:
            return requirement


def order_rows(state: State, places: Sequence[Place]) -> tuple[Array, Array]:
    """The order of the tubes at given translations, and that none is shorter than the next outer one, >= 0 where kept,
    in steps of 10 mm; what no unknown moves is left out, as the task has checked it."""
    straight, curved = (
        np.array([getattr(tube, name) for tube in state.tubes]) for name in ("straight_length", "curved_length")
    )
    length, longer = straight + curved, state.slopes["straight_length"] + state.slopes["curved_length"]
    values, slopes = [length[:-1] - length[1:]], [longer[:-1] - longer[1:]]
    for place in places:
        values.append(order_gaps(straight, curved, place))
        slopes.append(order_gaps(state.slopes["straight_length"], state.slopes["curved_length"], place))
    slope = np.concatenate(slopes)
    moves = slope.any(axis=1)
    return np.concatenate(values)[moves] / 1e-2 - ORDERED, slope[moves] / 1e-2


def joint_rows(state: State, limits: JointLimits | None) -> tuple[Array, Array]:
    """Limits of the joint values of every free pose, >= 0 where kept, in steps of 10 mm: carriages and ends in order,
    no tube withdrawn past the plate, and the ranges of the translations that the robot's actuators have."""
    layout = state.layout
    straight, curved = (state.slopes[name] for name in ("straight_length", "curved_length"))
    length = np.array([tube.length for tube in state.tubes])
    values: list[Array] = [np.zeros(0)]
    slopes: list[Array] = [np.zeros((0, layout.size))]
    for pose in layout.poses:
        if not isinstance(pose, FreePose):
            continue
        place = layout.joints(pose)[1]
        beta, moved = state.x[place], np.zeros((layout.n, layout.size))
        moved[:, place] = np.eye(layout.n)
        end, ended = beta + length, moved + straight + curved
        values += [beta[1:] - beta[:-1], end[:-1] - end[1:], end]
        slopes += [moved[1:] - moved[:-1], ended[:-1] - ended[1:], ended]
        if limits is not None:
            low, high = np.array(limits.translations).T
            shift = beta + np.array([tube.straight_length for tube in state.tubes])
            shifted = moved + straight
            values += [shift - low, high - shift]
            slopes += [shifted, -shifted]
    return np.concatenate(values) / 1e-2 - ORDERED, np.concatenate(slopes) / 1e-2


def via_points(state: State) -> tuple[int, ...]:
    """Numbers of the poses on the paths between task poses."""
    return tuple(k for k, pose in enumerate(state.layout.poses) if isinstance(pose, Via))
