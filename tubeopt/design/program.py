"""A design task as a nonlinear program in the dimensions and the joint values of its poses.

Equilibria are solved inside: the unknowns are what a designer chooses, and every constraint and its exact derivative
follow from the solved poses. A design that is certified snap-free has one equilibrium for every input, so nothing can
go to another branch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from ..block.quantities import Expression, PoseNumber
from ..typing import Array
from .constraints import Points, Statement, statements
from .objectives import POSED, AnyObjective, Objective, aim
from .pose import Guess
from .requirements import Coverage, Poses, Reach, Requirement, SnapFree, SnapFreeInUse, of_kind
from .state import DesignState, FixedPose, FreePose, Layout, PoseKind, Via
from .task import DesignTask, extreme_lengths

# Requirement on task poses if no other one limits the margin.
STABLE = SnapFreeInUse(0.05, paths=False)

# Objectives whose worst number is bounded by an unknown of its own: its bounds and its size.
BOUNDED = {
    "strain": (0.0, 1.0, 1e-2),
    "margin": (-100.0, 1.0, 0.1),
    "tip_deflection": (0.0, 1.0, 1e-3),
    "tip_stiffness": (0.0, 1e6, 1.0),
    "stroke_force": (0.0, 10.0, 1e-2),
}


@dataclass(frozen=True)
class Added:
    """Worst cases that exchange has added to a task."""

    translations: tuple[tuple[float, ...], ...] = ()
    """Translations (.., n) of the certificate, m."""
    vias: tuple[Via, ...] = ()
    """Points on joint paths."""
    points: tuple[tuple[tuple[float, ...], ...], ...] = ()
    """Positions (.., 3) for each workspace box, m."""


@dataclass(frozen=True, eq=False)
class PassedDesign:
    """Design that a search has evaluated."""

    x: Array
    """Unknowns (X,), SI."""
    objective: float
    """Minimised value."""
    violation: float
    """Largest violation, in steps of its limit."""
    worst: str
    """Name of that limit; "" if none is violated."""

    @property
    def order(self) -> tuple[float, float]:
        """Sort key, the better design first."""
        return self.violation, self.objective


class Lately:
    """Last state of a search, and the best design so far, which is the result if the time limit ends the search.

    Objective and constraints are evaluated at the same x one after the other. Older states are not stored, since their
    poses started elsewhere. The memory is not sent to other processes.
    """

    def __init__(self) -> None:
        self.state: DesignState | None = None
        self.best: PassedDesign | None = None

    def __reduce__(self) -> tuple[type[Lately], tuple[()]]:
        return Lately, ()


@dataclass(frozen=True, eq=False)
class Program:
    """Task and added worst cases as a nonlinear program: unknowns, constraints, objectives."""

    task: DesignTask
    added: Added
    layout: Layout
    requirement_poses: tuple[tuple[int, ...], ...]
    """Numbers of the poses that belong to each requirement."""
    stated: tuple[tuple[Statement, ...], ...]
    """Limits of each requirement as expressions."""
    aims: dict[AnyObjective, Expression]
    """Objectives that are expressions; only "change" has none."""
    depth_pose: int | None
    """Number of the pose of the objective reach_radius."""
    targets: dict[int, tuple[float, ...]]
    """Tip position (3,) or height (1,) of each free pose by its number, m."""
    lower: Array
    """Lower bounds (X,), SI."""
    upper: Array
    """Upper bounds (X,), SI."""
    scale: Array
    """Typical changes (X,), SI."""
    elastic: bool = False
    """True if every group of rows has a slack; the sum of slacks then replaces the objective."""
    guesses: dict[PoseNumber, Guess] = field(default_factory=dict)
    lately: Lately = field(default_factory=Lately, init=False, repr=False)

    @property
    def task_poses(self) -> tuple[int, ...]:
        """Numbers of the task poses, without those on joint paths."""
        return tuple(k for k, pose in enumerate(self.layout.poses) if not isinstance(pose, Via))


def compile_task(task: DesignTask, added: Added | None = None) -> Program:
    """Lay out the unknowns of a task, and record its requirements and objectives as expressions."""
    added = Added() if added is None else added
    poses: list[PoseKind] = []
    requirement_poses: list[tuple[int, ...]] = []

    def free(count: int) -> tuple[int, ...]:
        first = sum(isinstance(pose, FreePose) for pose in poses)
        numbers = tuple(range(len(poses), len(poses) + count))
        poses.extend(FreePose(first + k) for k in range(count))
        return numbers

    targets: dict[int, tuple[float, ...]] = {}
    for requirement, points in zip(task.requirements, points_of(task.requirements, added), strict=True):
        if isinstance(requirement, Poses):
            requirement_poses.append(tuple(range(len(poses), len(poses) + len(requirement.rotations))))
            poses.extend(FixedPose(*pair) for pair in zip(requirement.rotations, requirement.translations, strict=True))
        else:
            requirement_poses.append(free(len(points)))
            targets |= dict(zip(requirement_poses[-1], points, strict=True))
    deep = [objective for objective in task.built_in if objective.kind == "reach_radius"]
    depth_pose = free(1)[0] if deep else None
    if depth_pose is not None:
        targets[depth_pose] = (float(deep[0].depth or 0.0),)
    certified = _certified(task, added)
    stated, aims = _recorded(task, added, requirement_poses, len(poses), depth_pose, certified)
    # Last, so that the numbers of the task poses stay as exchange adds points of joint paths.
    poses.extend(added.vias)
    kinds = [objective.kind for objective in task.built_in]
    auxiliary = tuple(kind for kind in BOUNDED if kind in kinds)
    layout = Layout(task.space, tuple(poses), certified, auxiliary)
    return Program(
        task, added, layout, tuple(requirement_poses), stated, aims, depth_pose, targets, *_bounds(task, layout)
    )


def _recorded(
    task: DesignTask,
    added: Added,
    requirement_poses: Sequence[tuple[int, ...]],
    count: int,
    depth_pose: int | None,
    certified: tuple[tuple[float, ...], ...],
) -> tuple[tuple[tuple[Statement, ...], ...], dict[AnyObjective, Expression]]:
    """Requirements and objectives as recorded expressions for `count` task poses and translations of the
    certificate.
    """
    space = task.space
    task_poses, all_poses = tuple(range(count)), tuple(range(count + len(added.vias)))
    stated = []
    requirements = task.requirements
    if task.has_poses and not any(isinstance(each, SnapFree | SnapFreeInUse) for each in requirements):
        requirements = (*requirements, STABLE)
    for number, (requirement, points) in enumerate(zip(requirements, points_of(requirements, added), strict=True)):
        match requirement:
            case Coverage() | Reach():
                stated.append(statements(requirement, space, requirement_poses[number], points))
            case SnapFreeInUse():
                stated.append(statements(requirement, space, all_poses))
            case _:
                stated.append(statements(requirement, space, task_poses, certified))
    aims = {}
    for objective in task.objectives:
        on_paths = isinstance(objective, Objective) and objective.kind not in POSED
        expression = aim(objective, space, all_poses if on_paths else task_poses, certified, depth_pose)
        if expression is not None:
            aims[objective] = expression
    return tuple(stated), aims


def points_of(requirements: Sequence[Requirement], added: Added) -> list[Points]:
    """Target positions of every requirement: for a box its corners, or those with the points added by exchange."""
    boxes = iter(added.points)
    out: list[Points] = []
    for requirement in requirements:
        if isinstance(requirement, Coverage):
            out.append(next(boxes, corners(requirement)))
        else:
            out.append([target.position for target in requirement.targets] if isinstance(requirement, Reach) else [])
    return out


def corners(box: Coverage) -> tuple[tuple[float, ...], ...]:
    """The eight corners of a workspace box."""
    return tuple(dict.fromkeys(product(*zip(box.lower, box.upper, strict=True))))


def _certified(task: DesignTask, added: Added) -> tuple[tuple[float, ...], ...]:
    rows: list[tuple[float, ...]] = []
    for requirement in of_kind(task.requirements, SnapFree):
        if requirement.translations is not None:
            rows.extend(requirement.translations)
        if requirement.box is not None:
            # Two opposite corners begin the exchange, which adds the worst translations inside.
            rows.extend([requirement.box[0], requirement.box[1]])
        if not rows:
            # Without translations and without a box the robot is certified at home.
            rows.append((0.0,) * task.robot.n_tubes)
    # Without duplicates: equal rows would be active twice.
    return tuple(dict.fromkeys([*rows, *added.translations]))


class _Bounds(NamedTuple):
    """Bounds and typical changes (X,) of the unknowns, SI."""

    lower: Array
    upper: Array
    scale: Array


def _bounds(task: DesignTask, layout: Layout) -> _Bounds:
    space, n, first = layout.space, layout.n, [tubes[0] for tubes in layout.carriages]
    low_tubes = np.array([tube.length for tube in space.tubes(space.start)])
    longest = extreme_lengths(task, "upper")
    high_tubes = longest["straight_length"] + longest["curved_length"]
    turns = np.array(task.robot.limits.rotations)
    # beta is minus the length of a tube behind the plate: from all of the longest possible tube to nothing. Changes
    # that matter are 1 rad and a fifth of a tube, which may have length 0.
    of_a_pose = (
        np.concatenate([turns[:, 0], -high_tubes[first]]),
        np.concatenate([turns[:, 1], np.zeros(len(first))]),
        np.concatenate([np.ones(n), np.maximum(0.2 * low_tubes[first], 1e-3)]),
    )
    auxiliary = np.reshape([BOUNDED[name] for name in layout.auxiliary], (-1, 3)).T
    parts = zip((space.lower, space.upper, space.scale), of_a_pose, auxiliary, strict=True)
    return _Bounds(*(np.concatenate([design, *[joints] * layout.free_poses, more]) for design, joints, more in parts))


def recompiled(task: DesignTask, program: Program) -> Program:
    """Program of a task with the added cases and the pose guesses of another program."""
    # A copy of the guesses: neither program may move the starts of the other.
    return replace(compile_task(task, program.added), guesses=dict(program.guesses))


def slack_name(k: int) -> str:
    """Name of the slack of the k-th group of rows, in steps of its limit."""
    return f"slack {k}"


def elastic(program: Program, may_move: Sequence[bool]) -> Program:
    """The program with a slack for every group of rows, fixed at 0 for those that may not move."""
    count = len(may_move)
    layout = replace(program.layout, auxiliary=(*program.layout.auxiliary, *(slack_name(k) for k in range(count))))
    max_slack = np.where(may_move, 1e4, 0.0)  # steps
    return replace(
        program,
        layout=layout,
        lower=np.concatenate([program.lower, np.zeros(count)]),
        upper=np.concatenate([program.upper, max_slack]),
        scale=np.concatenate([program.scale, np.ones(count)]),
        elastic=True,
        guesses=dict(program.guesses),
    )
