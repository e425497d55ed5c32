"""A design task: start, free dimensions, requirements, objectives, and the order of the tubes that it implies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..block.custom import CustomObjective, CustomRequirement
from ..display import Displayed
from ..errors import InputError, Settings, instance, items
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import BundleRobot, SheathedRobot
from ..robots.robot import Robot
from ..robots.tubes import Tube, slots_unknown
from ..typing import Array
from .objectives import KINDS, POSED, AnyObjective, Objective, key_of
from .parameters import NAMES, PLACES, DesignSpace, Free, design_space
from .requirements import (
    Avoid,
    Coverage,
    Deflection,
    Deployment,
    Length,
    Poses,
    Reach,
    Requirement,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    StrokeForce,
    of_kind,
)

DesignedRobot = ConcentricRobot | BundleRobot
"""Robot that a design can change."""

# Length (m) by which round-off may take tubes out of order: what inverse kinematics and planning allow.
ORDER_SLACK = 1e-10


@dataclass(frozen=True)
class TranslationRange:
    """Translations that require an order of the tubes: description, smallest and largest translations (n,), m."""

    description: str
    low: tuple[float, ...]
    high: tuple[float, ...]


class TubeOrder(NamedTuple):
    """Pairs of nested tubes of different carriages, which must be in order."""

    inner: tuple[int, ...]
    """Inner tube (P,) of each pair, from 0."""
    outer: tuple[int, ...]
    """Tube (P,) around it."""
    curves_apart: bool
    """True if the curve of an inner tube must begin beyond the tube around it."""


def tube_order(robot: Robot) -> TubeOrder:
    """Pairs of nested tubes of a robot, one for every two carriages."""
    carriage = {i: tubes for tubes in robot.moving_together for i in tubes}
    pairs = {(carriage[i], carriage[o]): (i, o) for i, o in reversed(robot.nested_pairs)}
    inner, outer = zip(*sorted(pairs.values()), strict=True) if pairs else ((), ())
    return TubeOrder(tuple(inner), tuple(outer), not robot.nested_curves)


def ordered_ranges(
    robot: Robot, requirements: Sequence[Requirement], objectives: Sequence[AnyObjective]
) -> tuple[TranslationRange, ...]:
    """Translations that require an order of the tubes.

    They are 0, which is then home, and the translations of requirements and objectives. Segments have another home.
    """
    zero = (0.0,) * robot.n_tubes
    ranges = [TranslationRange("at translations 0", zero, zero)] if robot.nested_curves else []
    for requirement in requirements:
        match requirement:
            case SnapFree(translations=rows, box=box):
                ranges += [
                    TranslationRange(f"at the certified translations {_mm(row)}", row, row) for row in rows or ()
                ]
                ranges += (
                    []
                    if box is None
                    else [TranslationRange(f"in the certified box {_mm(box[0])} to {_mm(box[1])}", *box)]
                )
            case Poses(translations=rows):
                ranges += [
                    TranslationRange(f"at the pose with translations {_mm(row)}", row, row)
                    for row in dict.fromkeys(rows)
                ]
            case _:
                pass
    for aim in objectives:
        if isinstance(aim, Objective) and aim.translations is not None:
            ranges.append(
                TranslationRange(f"at the objective's translations {_mm(aim.translations)}", *(aim.translations,) * 2)
            )
    return tuple({(translations.low, translations.high): translations for translations in reversed(ranges)}.values())[
        ::-1
    ]


def order_distances(order: TubeOrder, straight: Array, curved: Array, low: Array, high: Array) -> Array:
    """Distances, m, in the order constraints; < 0 if violated.

    They are of carriages (P,), of ends (P,), of ends from the plate (n,), and for `curves_apart` of curves (P,).
    Translations may lie between `low` and `high`. The function is linear, so that it maps derivatives (n, X) too.
    """
    i, o = list(order.inner), list(order.outer)
    carriages = straight[i] - straight[o] + low[o] - high[i]
    ends = curved[i] - curved[o] + low[i] - high[o]
    curves = [low[i] - curved[o] - high[o]] if order.curves_apart else []
    return np.concatenate([carriages, ends, curved + low, *curves])


def tube_distances(
    order: TubeOrder, tubes: Sequence[Tube], low: Sequence[float] | Array, high: Sequence[float] | Array
) -> Array:
    """Distances, m, in the order constraints of tubes between two rows of translations, as `order_distances`."""
    straight, curved = (
        np.array([getattr(tube, name) for tube in tubes]) for name in ("straight_length", "curved_length")
    )
    return order_distances(order, straight, curved, np.array(low), np.array(high))


def worst_order(order: TubeOrder, tubes: Sequence[Tube], ranges: Sequence[TranslationRange]) -> tuple[float, str]:
    """Smallest distance (m) in the order constraints over sets of translations, and a clause that names
    set and tubes.
    """
    return min(
        (
            _worst(order, tube_distances(order, tubes, translations.low, translations.high), translations)
            for translations in ranges
        ),
        key=lambda pair: pair[0],
    )


def check_order(
    order: TubeOrder,
    ranges: Sequence[TranslationRange],
    shortest: dict[str, Array],
    longest: dict[str, Array],
) -> None:
    """Raise InputError if no lengths within their bounds (n,) satisfy the order at all sets of translations."""
    for translations in ranges:
        lows = order_distances(
            order,
            longest["straight_length"],
            longest["curved_length"],
            np.array(translations.low),
            np.array(translations.high),
        )
        count, outer = len(order.outer), list(order.outer)
        starts = [("straight_length", 0), ("curved_length", count)]
        starts += [("curved_length", len(lows) - count)] if order.curves_apart else []
        # The outer tube of a pair counts with its least length.
        for name, first in starts:
            lows[first : first + count] += longest[name][outer] - shortest[name][outer]
        distance, clause = _worst(order, lows, translations)
        if distance < -ORDER_SLACK:
            raise InputError(
                f"{clause}, whatever lengths are chosen; ordered=False (in a file: ordered: false) allows it"
            )


def _worst(order: TubeOrder, distances: Array, translations: TranslationRange) -> tuple[float, str]:
    """Smallest distance (m) in the order constraints, and a clause that names it."""
    k, n, pairs = int(np.argmin(distances)), len(translations.low), len(order.inner)
    distance = float(distances[k])
    size = f"{abs(distance) * 1e3:.4g} mm"
    if 2 * pairs <= k < 2 * pairs + n:
        i = k - 2 * pairs + 1
        side = f"ends {size} behind the plate" if distance < 0 else f"ends {size} beyond the plate"
        return distance, f"tube {i} {side} {translations.description}"
    pair = (k if k < 2 * pairs else k - n) % pairs
    inner, outer = f"tube {order.inner[pair] + 1}", f"tube {order.outer[pair] + 1}"
    if k >= 2 * pairs:
        side = "inside" if distance < 0 else "beyond the end of"
        return distance, f"the curve of {inner} begins {size} {side} {outer} {translations.description}"
    if k < pairs:
        side = "before" if distance < 0 else "behind"
        return distance, f"the carriage of {inner} stands {size} {side} that of {outer} {translations.description}"
    side = "inside" if distance < 0 else "beyond"
    return (
        distance,
        f"{inner} ends {size} {side} {'' if distance < 0 else 'the end of '}{outer} {translations.description}",
    )


def pose_ranges(translations: Sequence[Array]) -> tuple[TranslationRange, ...]:
    """Translations of the task poses with their descriptions, for the order of the tubes."""
    rows = [tuple(row.tolist()) for row in translations]
    return tuple(TranslationRange(f"at task pose {k}", row, row) for k, row in enumerate(rows, start=1))


def _mm(row: Sequence[float]) -> str:
    return f"({', '.join(f'{1e3 * value:.4g}' for value in row)}) mm"


@dataclass(frozen=True)
class DesignSolver(Settings):
    """Effort of the search for a design; a field of a `DesignTask`."""

    retries: int = 4
    """Number of starts that are tried before a task counts as infeasible, if fewer were requested."""
    poses: int = 256
    """Number of random joint values per target; the best is the start. Raise it where targets are hard to reach."""
    iterations: int = 150
    """Maximum number of IPOPT iterations per run, then the search continues in one order of breakpoints."""
    orders: int = 6
    """Maximum number of orders of breakpoints per start. Lower it if a local optimum in less time is enough."""


DEFAULT_SOLVER = DesignSolver()


@dataclass(frozen=True)
class DesignTask(Displayed):
    """A robot, its free dimensions, requirements and objectives.

    Raises:
        InputError: no free dimension, no objective, or an order that no lengths satisfy. Missing tubes or task poses,
            or translations for another number of tubes.
    """

    robot: DesignedRobot
    """Robot with the starting dimensions; an eccentric one becomes its bundle, which has an energy."""
    free: tuple[Free, ...]
    """Dimensions that may change."""
    requirements: tuple[Requirement, ...] = ()
    """Requirements; the design satisfies all of them."""
    objective: AnyObjective | tuple[AnyObjective, ...] = field(default_factory=lambda: Objective("change"))
    """Objective, or several that are added with their weights."""
    name: str = ""
    """Name in tables and messages."""
    ordered: bool = True
    """True if the tubes must be in order: carriages in order, ends in order, no tube withdrawn past the plate. It
    applies at translations 0, over certified boxes, and at all translations that requirements and objectives name.
    Poses with free joint values always keep the order.
    """
    solver: DesignSolver = DEFAULT_SOLVER
    """Settings of the search."""

    def __post_init__(self) -> None:
        if isinstance(self.robot, SheathedRobot):
            object.__setattr__(self, "robot", self.robot.bundle())
        if not isinstance(self.robot, DesignedRobot):
            raise InputError(
                f"robot is a {type(self.robot).__name__}; a design needs a robot, as of tubeopt.load_robot"
            )
        object.__setattr__(self, "free", items("free", self.free, Free, "Free"))
        requirements = items("requirements", self.requirements, Requirement, "requirements (SnapFree, Reach, ...)")
        if not isinstance(self.objective, AnyObjective):
            object.__setattr__(self, "objective", items("objective", self.objective, AnyObjective, "Objective"))
        n = self.robot.n_tubes
        spread = [
            replace(requirement, limits=requirement.limits * n)
            if isinstance(requirement, Strain) and len(requirement.limits) == 1
            else requirement
            for requirement in requirements
        ]
        object.__setattr__(self, "requirements", tuple(spread))
        self.space  # noqa: B018  (its checks)
        if not self.objectives:
            raise InputError("objective is empty; a design needs at least one")
        instance("ordered", self.ordered, bool)
        instance("name", self.name, str)
        instance("solver", self.solver, DesignSolver)
        _check_requirements(self)
        _check_objectives(self)
        _check_pieces(self)
        if isinstance(self.robot, BundleRobot):
            _check_bundle(self, self.robot)
        check_order(
            tube_order(self.robot),
            self.translation_ranges,
            *(extreme_lengths(self, side) for side in ("lower", "upper")),
        )

    @property
    def objectives(self) -> tuple[AnyObjective, ...]:
        """Objectives of the task as a tuple."""
        return (self.objective,) if isinstance(self.objective, AnyObjective) else tuple(self.objective)

    @property
    def built_in(self) -> tuple[Objective, ...]:
        """Objectives that are not custom."""
        return tuple(objective for objective in self.objectives if isinstance(objective, Objective))

    @property
    def translation_ranges(self) -> tuple[TranslationRange, ...]:
        """Translations that require an order of the tubes."""
        return ordered_ranges(self.robot, self.requirements, self.objectives) if self.ordered else ()

    @property
    def space(self) -> DesignSpace:
        """The unknown dimensions and their bounds."""
        return design_space(self.robot, self.free)

    @property
    def has_poses(self) -> bool:
        """True if the task has poses."""
        kinds = (Reach, Poses, Coverage)
        posed = any(isinstance(requirement, kinds) for requirement in self.requirements)
        return posed or any(objective.kind == "reach_radius" for objective in self.built_in)


def extreme_lengths(task: DesignTask, side: str) -> dict[str, Array]:
    """Smallest ("lower") or largest ("upper") straight and curved lengths (n,) within the bounds, m."""
    space = task.space
    lengths = {
        field: np.array([getattr(tube, field) for tube in task.robot.tubes])
        for field in ("straight_length", "curved_length")
    }
    for unknown, bound in zip(space.unknowns, getattr(space, side), strict=True):
        for i in unknown.tubes if unknown.field in lengths else ():
            lengths[unknown.field][i] = float(bound) * (lengths[unknown.field][i] if unknown.scaled else 1.0)
    return lengths


def _advanced(task: DesignTask, name: str, row: Sequence[float]) -> None:
    _per_tube(name, row, task.robot.n_tubes)
    straight = extreme_lengths(task, "lower")["straight_length"].tolist()
    for i, (shift, max_shift) in enumerate(zip(row, straight, strict=True)):
        if shift > max_shift + 1e-12:
            raise InputError(
                f"translation of tube {i + 1} is {shift:g} m; it must be at most the lower "
                f"bound of its straight length, {max_shift:g} m"
            )


def _per_tube(name: str, row: Sequence[float], n: int) -> None:
    if len(row) != n:
        raise InputError(f"{name} has {len(row)} numbers; it must be {n} (one per tube)")


def _check_requirements(task: DesignTask) -> None:
    n = task.robot.n_tubes
    for requirement in task.requirements:
        match requirement:
            case SnapFree(translations=rows, box=box):
                for row in (*(rows or ()), *(box or ())):
                    _advanced(task, "translations of the certificate", row)
            case Poses(rotations=rotations, translations=translations):
                for row in rotations:
                    _per_tube("a pose", row, n)
                for row in translations:
                    _advanced(task, "a pose", row)
            case Strain(limits=limits) if len(limits) != n:
                raise InputError(f"strain has {len(limits)} limits; it must be 1 or {n} (one per tube)")
            case Length(tube=tube) if not 0 <= tube < n:
                raise InputError(f"length names tube {tube + 1}; the robot has tubes 1 to {n}")
            case SnapFreeInUse() | Stroke() | Avoid() | Deployment() | Deflection() if not task.has_poses:
                raise InputError(
                    f"{type(requirement).__name__} needs task poses; the task must have Reach, Coverage or Poses"
                )
            case StrokeForce():
                _given_poses(task, "requirement StrokeForce")
            case CustomRequirement():
                requirement.checked()
            case _:
                pass
    for kind in (SnapFree, SnapFreeInUse, Strain, Stroke, StrokeForce):
        if len(of_kind(task.requirements, kind)) > 1:
            raise InputError(f"{kind.__name__} is given twice; it must be given once")


def _check_bundle(task: DesignTask, robot: BundleRobot) -> None:
    """Raise InputError for what designs of bundles do not support."""
    for requirement in task.requirements:
        if isinstance(requirement, SnapFree):
            if requirement.max_force or requirement.box is not None or requirement.growth > 1:
                raise InputError(
                    "SnapFree of an eccentric robot has a force, a box or tube errors; its proof covers given "
                    "translations without them: require a larger margin, and check tolerances"
                )
            if robot.sheath_rigid_from is not None:
                raise InputError(
                    "SnapFree is required with a rigid tip of the sheath; there is a proof for flexible tips "
                    "only: require SnapFreeInUse"
                )
            for row in requirement.translations or ():
                robot.admit(np.array(row))
        if isinstance(requirement, Poses):
            for row in requirement.translations:
                robot.admit(np.array(row))
        deployed = isinstance(requirement, Deployment) or getattr(requirement, "deployed", False)
        if deployed and len(robot.moving_together) < robot.n_tubes:
            raise InputError(
                "a deployment retracts tubes one by one; tubes of this robot share carriages, so that it has none"
            )
    for objective in task.built_in:
        if objective.kind == "deployment" and len(robot.moving_together) < robot.n_tubes:
            raise InputError("objective deployment retracts tubes one by one; tubes of this robot share carriages")
        if objective.kind in ("tip_curvature", "turning_radius") and not of_kind(task.requirements, Poses):
            raise InputError(
                f"objective {objective.kind} of an eccentric robot is that of its first task pose; give poses"
            )
    for stack in robot.stacks:
        for name in PLACES:
            free = [unknown for unknown in task.space.unknowns if unknown.field == name]
            if any(0 < len(set(stack) & set(unknown.tubes)) < len(stack) for unknown in free):
                nested = ", ".join(str(i + 1) for i in stack)
                raise InputError(
                    f"the {NAMES[name]} of tubes {nested}, which are nested, is not free together; name "
                    "all in one, equal"
                )


def _given_poses(task: DesignTask, what: str) -> None:
    """Raise InputError if task poses have free joint values.

    The buckling load is not differentiable where joint values leave the plane of the arm.
    """
    if not of_kind(task.requirements, Poses) or of_kind(task.requirements, Reach) + of_kind(
        task.requirements, Coverage
    ):
        raise InputError(f"{what} needs task poses with given joint values; use Poses only")


def _check_pieces(task: DesignTask) -> None:
    """Raise InputError for requirements and objectives that are not defined for tubes made of pieces."""
    may_vary = any(unknown.pieces for unknown in task.space.unknowns) or not all(
        tube.even for tube in task.space.robot_tubes
    )
    if may_vary and any(
        isinstance(requirement, SnapFree) and requirement.growth > 1 for requirement in task.requirements
    ):
        raise InputError(
            "snap_free has errors of curvature or stiffness; there is no proof for tubes "
            "made of pieces: require a larger margin, and check tolerances"
        )
    if not task.space.pieced:
        return
    for requirement in task.requirements:
        if isinstance(requirement, Strain):
            _check_slots(task.space)
    for objective in task.objectives:
        if isinstance(objective, Objective) and objective.kind in ("tip_curvature", "turning_radius"):
            raise InputError(
                f"objective is {objective.kind}; it is not defined for tubes made of pieces: "
                "require a tip direction at a target instead"
            )
        if isinstance(objective, Objective) and objective.kind == "strain":
            _check_slots(task.space)


def _check_slots(space: DesignSpace) -> None:
    """Raise InputError if strain is limited and slots are unknown: the remaining material has a higher strain."""
    free = {
        position for unknown in space.unknowns if unknown.field == "piece_bending_factor" for position in unknown.pieces
    }
    for i, tube in enumerate(space.robot_tubes):
        for j, piece in enumerate(tube.pieces):
            if piece.slots is None and (slots_unknown(tube, piece) or (i, j) in free):
                how = "may be" if (i, j) in free else "is"
                raise InputError(
                    f"strain is limited, and piece {j + 1} of tube {i + 1} {how} softer than "
                    f"its tube; give slots: {{share: ...}}, the slotted fraction of its length "
                    "(1 if uniform), because the remaining material has higher strain"
                )


def _check_objectives(task: DesignTask) -> None:
    certified = bool(of_kind(task.requirements, SnapFree))
    for objective in task.objectives:
        if isinstance(objective, CustomObjective):
            objective.checked()
            if objective.description in KINDS:
                raise InputError(
                    "a user-defined objective has the description "
                    f"{objective.description!r} of a built-in one; use another description"
                )
            continue
        if objective.translations is not None:
            _advanced(task, "translations of the objective", objective.translations)
        if objective.kind == "margin" and not (certified or task.has_poses):
            raise InputError("objective margin needs a certificate or task poses; the task has neither")
        if objective.kind == "orientability" and task.robot.n_tubes < 3:
            raise InputError(f"objective orientability needs 3 tubes; the robot has {task.robot.n_tubes}")
        if objective.kind in ("stroke_force", "workspace_volume"):
            _given_poses(task, f"objective {objective.kind}")
        count = sum(len(each.rotations) for each in of_kind(task.requirements, Poses))
        if objective.kind == "workspace_volume" and count < 3:
            raise InputError(f"objective workspace_volume has {count} task poses; a polygon needs at least 3")
        if objective.kind in POSED and not task.has_poses:
            raise InputError(
                f"objective {objective.kind} needs task poses (Reach, Coverage or Poses); the task has none"
            )
    if len({key_of(objective) for objective in task.objectives}) < len(task.objectives):
        raise InputError("an objective is given twice; each must be given once")
