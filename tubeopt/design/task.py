"""A design task: where it starts, what is free, what must hold, what is wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..block.custom import CustomObjective, CustomRequirement
from ..display import Displayed
from ..errors import InputError, instance, items
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import slots_unknown
from ..typing import Array
from .objectives import KINDS, POSED, AnyObjective, Objective, key_of
from .order import Place, check_order, ordered_places
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
from .settings import DEFAULT_SOLVER, DesignSolver


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
