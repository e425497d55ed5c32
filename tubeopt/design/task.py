"""A design task: start, free dimensions, requirements, objectives, and the order of the tubes that it implies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..block.custom import CustomObjective, CustomRequirement
from ..display import Displayed
from ..errors import InputError, Settings, instance, items
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import Tube, slots_unknown
from ..typing import Array
from .objectives import KINDS, POSED, AnyObjective, Objective, key_of
from .parameters import DesignSpace, Free, design_space
from .requirements import (
    Avoid,
    Coverage,
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

# Length (m) by which round-off may take tubes out of order: what inverse kinematics and planning allow.
ORDER_SLACK = 1e-10


@dataclass(frozen=True)
class Place:
    """Translations at which the order must hold: words, and the least and the greatest of every tube (n,), m."""

    words: str
    low: tuple[float, ...]
    high: tuple[float, ...]


def ordered_places(
    n_tubes: int, requirements: Sequence[Requirement], objectives: Sequence[AnyObjective]
) -> tuple[Place, ...]:
    """Where tubes must be in order: at translations 0, which is then home, and wherever a requirement or an objective
    puts them."""
    zero = (0.0,) * n_tubes
    found = [Place("at translations 0", zero, zero)]
    for one in requirements:
        match one:
            case SnapFree(translations=rows, box=box):
                found += [Place(f"at the certified translations {_mm(row)}", row, row) for row in rows or ()]
                found += [] if box is None else [Place(f"in the certified box {_mm(box[0])} to {_mm(box[1])}", *box)]
            case Poses(translations=rows):
                found += [Place(f"at the pose with translations {_mm(row)}", row, row) for row in dict.fromkeys(rows)]
            case _:
                pass
    for aim in objectives:
        if isinstance(aim, Objective) and aim.translations is not None:
            found.append(Place(f"at the objective's translations {_mm(aim.translations)}", *(aim.translations,) * 2))
    return tuple({(place.low, place.high): place for place in reversed(found)}.values())[::-1]


def order_gaps(straight: Array, curved: Array, low: Array, high: Array) -> Array:
    """(3 n - 2,) m by which the order holds between two rows of translations, < 0 where it does not: of carriages, of
    ends, from the plate; or, linear in all as it is, its change (3 n - 2, X) from those (n, X)."""
    carriages = straight[:-1] - straight[1:] + low[1:] - high[:-1]
    return np.concatenate([carriages, curved[:-1] - curved[1:] + low[:-1] - high[1:], curved + low])


def gaps_of(tubes: Sequence[Tube], low: Sequence[float] | Array, high: Sequence[float] | Array) -> Array:
    """(3 n - 2,) m by which the order of tubes holds."""
    straight, curved = (
        np.array([getattr(tube, name) for tube in tubes]) for name in ("straight_length", "curved_length")
    )
    return order_gaps(straight, curved, np.array(low), np.array(high))


def worst_order(tubes: Sequence[Tube], places: Sequence[Place]) -> tuple[float, str]:
    """Least gap of the order at places, m, and in words where and of which tubes."""
    return min((_worst(gaps_of(tubes, place.low, place.high), place) for place in places), key=lambda found: found[0])


def check_order(places: Sequence[Place], least: dict[str, Array], most: dict[str, Array]) -> None:
    """Raise InputError where no lengths within their bounds (n,) keep the order at places."""
    for place in places:
        lows = order_gaps(most["straight_length"], most["curved_length"], np.array(place.low), np.array(place.high))
        n = len(place.low)
        # The outer tube of a pair counts with its least length.
        for name, first in (("straight_length", 0), ("curved_length", n - 1)):
            lows[first : first + n - 1] += most[name][1:] - least[name][1:]
        gap, words = _worst(lows, place)
        if gap < -ORDER_SLACK:
            raise InputError(
                f"{words}, whatever lengths are chosen; ordered=False (in a file: ordered: false) allows it"
            )


def _worst(gaps: Array, place: Place) -> tuple[float, str]:
    """The least gap, and a clause for it."""
    k, n = int(np.argmin(gaps)), len(place.low)
    gap = float(gaps[k])
    far = f"{abs(gap) * 1e3:.4g} mm"
    if k >= 2 * (n - 1):
        i = k - 2 * (n - 1) + 1
        side = f"ends {far} behind the plate" if gap < 0 else f"ends {far} beyond the plate"
        return gap, f"tube {i} {side} {place.words}"
    i = k % (n - 1) + 1
    inner, outer = f"tube {i}", f"tube {i + 1}"
    if k < n - 1:
        side = "before" if gap < 0 else "behind"
        return gap, f"the carriage of {inner} stands {far} {side} that of {outer} {place.words}"
    side = "inside" if gap < 0 else "beyond"
    return gap, f"{inner} ends {far} {side} {'' if gap < 0 else 'the end of '}{outer} {place.words}"


def pose_places(translations: Sequence[Array]) -> tuple[Place, ...]:
    """Places of task poses."""
    rows = [tuple(row.tolist()) for row in translations]
    return tuple(Place(f"at task pose {k}", row, row) for k, row in enumerate(rows, start=1))


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

    robot: ConcentricRobot
    """Robot with the starting dimensions."""
    free: tuple[Free, ...]
    """Dimensions that may change."""
    requirements: tuple[Requirement, ...] = ()
    """Requirements; the design satisfies all of them."""
    objective: AnyObjective | tuple[AnyObjective, ...] = field(default_factory=lambda: Objective("change"))
    """One, or several that are added with their weights."""
    name: str = ""
    """Name in tables and messages."""
    ordered: bool = True
    """Whether the tubes must be in order: carriages in order, ends in order, no tube withdrawn past the plate. It
    applies at translations 0, over certified boxes, and at all translations that requirements and objectives name.
    Poses with free joint values always keep the order.
    """
    solver: DesignSolver = DEFAULT_SOLVER
    """Settings of the search."""

    def __post_init__(self) -> None:
        if not isinstance(self.robot, ConcentricRobot):
            raise InputError(f"robot is a {type(self.robot).__name__}; a design needs a ConcentricRobot")
        object.__setattr__(self, "free", items("free", self.free, Free, "Free"))
        requirements = items("requirements", self.requirements, Requirement, "requirements (SnapFree, Reach, ...)")
        if not isinstance(self.objective, AnyObjective):
            object.__setattr__(self, "objective", items("objective", self.objective, AnyObjective, "Objective"))
        n = self.robot.n_tubes
        spread = [
            replace(one, limits=one.limits * n) if isinstance(one, Strain) and len(one.limits) == 1 else one
            for one in requirements
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
        check_order(self.places, *(extreme_lengths(self, side) for side in ("lower", "upper")))

    @property
    def objectives(self) -> tuple[AnyObjective, ...]:
        """All objectives of the task."""
        return (self.objective,) if isinstance(self.objective, AnyObjective) else tuple(self.objective)

    @property
    def built_in(self) -> tuple[Objective, ...]:
        """Objectives that are not custom."""
        return tuple(one for one in self.objectives if isinstance(one, Objective))

    @property
    def places(self) -> tuple[Place, ...]:
        """Translations at which the tubes must be in order."""
        return ordered_places(self.robot.n_tubes, self.requirements, self.objectives) if self.ordered else ()

    @property
    def space(self) -> DesignSpace:
        """The unknown dimensions and their bounds."""
        return design_space(self.robot.tubes, self.free)

    @property
    def has_poses(self) -> bool:
        """True if the task has poses."""
        kinds = (Reach, Poses, Coverage)
        posed = any(isinstance(one, kinds) for one in self.requirements)
        return posed or any(one.kind == "reach_radius" for one in self.built_in)


def extreme_lengths(task: DesignTask, side: str) -> dict[str, Array]:
    """(n,) least ("lower") or greatest ("upper") straight and curved length that every tube may get, m."""
    space = task.space
    found = {
        field: np.array([getattr(tube, field) for tube in task.robot.tubes])
        for field in ("straight_length", "curved_length")
    }
    for one, bound in zip(space.unknowns, getattr(space, side), strict=True):
        for i in one.tubes if one.field in found else ():
            found[one.field][i] = float(bound) * (found[one.field][i] if one.scaled else 1.0)
    return found


def _advanced(task: DesignTask, name: str, row: Sequence[float]) -> None:
    _per_tube(name, row, task.robot.n_tubes)
    least = extreme_lengths(task, "lower")["straight_length"].tolist()
    for i, (shift, most) in enumerate(zip(row, least, strict=True)):
        if shift > most + 1e-12:
            raise InputError(
                f"translation of tube {i + 1} is {shift:g} m; it must be at most the lower "
                f"bound of its straight length, {most:g} m"
            )


def _per_tube(name: str, row: Sequence[float], n: int) -> None:
    if len(row) != n:
        raise InputError(f"{name} has {len(row)} numbers; it must be {n} (one per tube)")


def _check_requirements(task: DesignTask) -> None:
    n = task.robot.n_tubes
    for one in task.requirements:
        match one:
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
            case SnapFreeInUse() | Stroke() | Avoid() | Deployment() if not task.has_poses:
                raise InputError(f"{type(one).__name__} needs task poses; the task must have Reach, Coverage or Poses")
            case StrokeForce():
                _given_poses(task, "requirement StrokeForce")
            case CustomRequirement():
                one.checked()
            case _:
                pass
    for kind in (SnapFree, SnapFreeInUse, Strain, Stroke, StrokeForce):
        if len(of_kind(task.requirements, kind)) > 1:
            raise InputError(f"{kind.__name__} is given twice; it must be given once")


def _given_poses(task: DesignTask, what: str) -> None:
    """A limit of buckling ends where joint values leave the plane in which the arm lies."""
    if not of_kind(task.requirements, Poses) or of_kind(task.requirements, Reach) + of_kind(
        task.requirements, Coverage
    ):
        raise InputError(f"{what} needs task poses with given joint values; use Poses only")


def _check_pieces(task: DesignTask) -> None:
    """What a design of pieces cannot ask for: bounds for errors of tubes, and what one curvature gives."""
    may_vary = any(one.pieces for one in task.space.unknowns) or not all(tube.even for tube in task.space.robot_tubes)
    if may_vary and any(isinstance(one, SnapFree) and one.growth > 1 for one in task.requirements):
        raise InputError(
            "snap_free has errors of curvature or stiffness; there is no proof for tubes "
            "made of pieces: require a larger margin, and check tolerances"
        )
    if not task.space.pieced:
        return
    for one in task.requirements:
        if isinstance(one, Strain):
            _check_slots(task.space)
    for wanted in task.objectives:
        if isinstance(wanted, Objective) and wanted.kind in ("tip_curvature", "turning_radius"):
            raise InputError(
                f"objective is {wanted.kind}; it is not defined for tubes made of pieces: "
                "require a tip direction at a target instead"
            )
        if isinstance(wanted, Objective) and wanted.kind == "strain":
            _check_slots(task.space)


def _check_slots(space: DesignSpace) -> None:
    """A limit of strain must know where slots are: they strain what they leave more than a whole tube."""
    free = {place for one in space.unknowns if one.field == "piece_bending_factor" for place in one.pieces}
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
    for one in task.objectives:
        if isinstance(one, CustomObjective):
            one.checked()
            if one.words in KINDS:
                raise InputError(
                    "a user-defined objective has the description "
                    f"{one.words!r} of a built-in one; use another description"
                )
            continue
        if one.translations is not None:
            _advanced(task, "translations of the objective", one.translations)
        if one.kind == "margin" and not (certified or task.has_poses):
            raise InputError("objective margin needs a certificate or task poses; the task has neither")
        if one.kind == "orientability" and task.robot.n_tubes < 3:
            raise InputError(f"objective orientability needs 3 tubes; the robot has {task.robot.n_tubes}")
        if one.kind in ("stroke_force", "workspace_volume"):
            _given_poses(task, f"objective {one.kind}")
        count = sum(len(each.rotations) for each in of_kind(task.requirements, Poses))
        if one.kind == "workspace_volume" and count < 3:
            raise InputError(f"objective workspace_volume has {count} task poses; a polygon needs at least 3")
        if one.kind in POSED and not task.has_poses:
            raise InputError(f"objective {one.kind} needs task poses (Reach, Coverage or Poses); the task has none")
    if len({key_of(one) for one in task.objectives}) < len(task.objectives):
        raise InputError("an objective is given twice; each must be given once")
