"""A design task as a nonlinear program in the dimensions and the joint values of its poses.

Equilibria are solved inside: the unknowns are what a designer chooses, and every constraint and its exact derivative
follow from the solved poses. A design that is certified snap-free has one equilibrium for every input, so nothing can
go to another branch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from ..block.quantities import Expression, PoseNumber
from ..typing import Array
from .constraints import Points, Statement, statements
from .objectives import POSED, AnyObjective, Objective, aim
from .pose import Twist
from .requirements import Coverage, Poses, Reach, Requirement, SnapFree, SnapFreeInUse, of_kind
from .state import FixedPose, FreePose, Layout, PoseKind, State, Via
from .task import DesignTask, extreme_lengths

# What task poses must keep where nothing else speaks of snapping.
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
    """What exchange has added to a task."""

    translations: tuple[tuple[float, ...], ...] = ()
    """(.., n) of the certificate, m."""
    vias: tuple[tuple[int, int, float], ...] = ()
    """Points on joint paths: first and second pose, fraction."""
    points: tuple[tuple[tuple[float, ...], ...], ...] = ()
    """Of each workspace box, m."""


@dataclass(frozen=True, eq=False)
class Reached:
    """A design on the way of a search: x (X,), its objective as minimised, its largest violation, in steps of its
    limit, and the words of that limit."""

    x: Array
    objective: float
    violation: float
    worst: str

    @property
    def order(self) -> tuple[float, float]:
        """By which the better one comes first."""
        return self.violation, self.objective


class Lately:
    """The state that was asked for last, since several ask for the same one after another, and the best design that a
    search passed, which is the answer where time ends it; left behind where a program goes to another process. Older
    states are not kept: their poses began elsewhere."""

    def __init__(self) -> None:
        self.state: State | None = None
        self.best: Reached | None = None

    def __reduce__(self) -> tuple[type[Lately], tuple[()]]:
        return Lately, ()


@dataclass(frozen=True, eq=False)
class Program:
    """A task with what exchange has added, laid out as unknowns and rows."""

    task: DesignTask
    added: Added
    layout: Layout
    own: tuple[tuple[int, ...], ...]
    """For every requirement, the poses that are its own."""
    stated: tuple[tuple[Statement, ...], ...]
    """Every requirement as expressions."""
    aims: dict[AnyObjective, Expression]
    """The objectives that are expressions."""
    depth_pose: int | None
    """That of the objective reach_radius."""
    targets: dict[int, tuple[float, ...]]
    """What the tip is to reach in every free pose: a point, or a height, m."""
    lower: Array
    """(X,) SI."""
    upper: Array
    """(X,) SI."""
    scale: Array
    """(X,) the size of a change that matters, SI."""
    elastic: bool = False
    """Whether every group of rows has a slack, of which the sum is minimised in place of the objective."""
    guesses: dict[PoseNumber, Twist] = field(default_factory=dict)
    lately: Lately = field(default_factory=Lately, init=False, repr=False)

    @property
    def task_poses(self) -> tuple[int, ...]:
        """Numbers of the task poses, without those on the way."""
        return tuple(k for k, pose in enumerate(self.layout.poses) if not isinstance(pose, Via))


def _all_requirements(task: DesignTask) -> tuple[Requirement, ...]:
    """Those of the task, and that poses be stable where nothing else says so."""
    given = task.requirements
    speaks = of_kind(given, SnapFree) + of_kind(given, SnapFreeInUse)
    return given if speaks or not task.has_poses else (*given, STABLE)


def compile_task(task: DesignTask, added: Added | None = None) -> Program:
    """Lay out the unknowns of a task, and record its requirements and objectives as expressions."""
    added = Added() if added is None else added
    poses: list[PoseKind] = []
    own: list[tuple[int, ...]] = []

    def free(count: int) -> tuple[int, ...]:
        first = sum(isinstance(pose, FreePose) for pose in poses)
        numbers = tuple(range(len(poses), len(poses) + count))
        poses.extend(FreePose(first + k) for k in range(count))
        return numbers

    targets: dict[int, tuple[float, ...]] = {}
    for one, points in zip(task.requirements, points_of(task.requirements, added), strict=True):
        if isinstance(one, Poses):
            own.append(tuple(range(len(poses), len(poses) + len(one.rotations))))
            poses.extend(FixedPose(*pair) for pair in zip(one.rotations, one.translations, strict=True))
        else:
            own.append(free(len(points)))
            targets |= dict(zip(own[-1], points, strict=True))
    deep = [one for one in task.built_in if one.kind == "reach_radius"]
    depth_pose = free(1)[0] if deep else None
    if depth_pose is not None:
        targets[depth_pose] = (float(deep[0].depth or 0.0),)
    certified = _certified(task, added)
    stated, aims = _recorded(task, added, own, (len(poses), depth_pose, certified))
    # Last, so that the numbers of the task poses stay as exchange adds points of joint paths.
    poses.extend(Via(*via) for via in added.vias)
    kinds = [one.kind for one in task.built_in]
    auxiliary = tuple(kind for kind in BOUNDED if kind in kinds)
    layout = Layout(task.space, tuple(poses), certified, auxiliary)
    lower, upper, scale = _bounds(task, layout)
    return Program(task, added, layout, tuple(own), stated, aims, depth_pose, targets, lower, upper, scale)


def _recorded(
    task: DesignTask,
    added: Added,
    own: Sequence[tuple[int, ...]],
    about: tuple[int, int | None, tuple[tuple[float, ...], ...]],
) -> tuple[tuple[tuple[Statement, ...], ...], dict[AnyObjective, Expression]]:
    """Requirements and objectives as expressions; `about` is the number of task poses, the pose of reach_radius, and
    the translations of the certificate."""
    count, depth_pose, certified = about
    pieces = [len(tube.pieces) or 1 for tube in task.space.robot_tubes]
    posed, passed = tuple(range(count)), tuple(range(count + len(added.vias)))
    stated = []
    requirements = _all_requirements(task)
    for number, (one, points) in enumerate(zip(requirements, points_of(requirements, added), strict=True)):
        match one:
            case Coverage() | Reach():
                stated.append(statements(one, pieces, own[number], points))
            case SnapFreeInUse():
                stated.append(statements(one, pieces, passed))
            case _:
                stated.append(statements(one, pieces, posed, certified))
    aims = {}
    for wanted in task.objectives:
        on_the_way = isinstance(wanted, Objective) and wanted.kind not in POSED
        found = aim(wanted, pieces, passed if on_the_way else posed, certified, depth_pose)
        if found is not None:
            aims[wanted] = found
    return tuple(stated), aims


def points_of(requirements: Sequence[Requirement], added: Added) -> list[Points]:
    """The points that the tip is to reach for every requirement: of a box its corners, or what exchange has made of
    them; () of those that ask for none."""
    boxes = iter(added.points)
    out: list[Points] = []
    for one in requirements:
        if isinstance(one, Coverage):
            out.append(next(boxes, corners(one)))
        else:
            out.append([target.position for target in one.targets] if isinstance(one, Reach) else [])
    return out


def corners(box: Coverage) -> tuple[tuple[float, ...], ...]:
    """The eight corners of a workspace box."""
    return tuple(dict.fromkeys(product(*zip(box.lower, box.upper, strict=True))))


def _certified(task: DesignTask, added: Added) -> tuple[tuple[float, ...], ...]:
    found: list[tuple[float, ...]] = []
    for one in of_kind(task.requirements, SnapFree):
        if one.translations is not None:
            found.extend(one.translations)
        if one.box is not None:
            # Two opposite corners begin the exchange, which adds the worst translations inside.
            found.extend([one.box[0], one.box[1]])
        if not found:
            # Without translations and without a box the robot is certified at home.
            found.append((0.0,) * task.robot.n_tubes)
    # Without duplicates: equal rows would be active twice.
    return tuple(dict.fromkeys([*found, *added.translations]))


def _bounds(task: DesignTask, layout: Layout) -> tuple[Array, Array, Array]:
    space, n = layout.space, layout.n
    low_tubes = np.array([tube.length for tube in space.tubes(space.start)])
    most = extreme_lengths(task, "upper")
    high_tubes = most["straight_length"] + most["curved_length"]
    turns = np.array(task.robot.limits.rotations)
    # beta is minus the length of a tube behind the plate: from all of the longest possible tube to nothing. Changes
    # that matter are 1 rad and a fifth of a tube, which may have length 0.
    of_a_pose = (
        np.concatenate([turns[:, 0], -high_tubes]),
        np.concatenate([turns[:, 1], np.zeros(n)]),
        np.concatenate([np.ones(n), np.maximum(0.2 * low_tubes, 1e-3)]),
    )
    auxiliary = np.reshape([BOUNDED[name] for name in layout.auxiliary], (-1, 3)).T
    parts = zip((space.lower, space.upper, space.scale), of_a_pose, auxiliary, strict=True)
    lower, upper, scale = (np.concatenate([own, *[joints] * layout.free_poses, more]) for own, joints, more in parts)
    return lower, upper, scale


def recompiled(task: DesignTask, near: Program) -> Program:
    """The program of a task with the added cases of another one, and what is known of its poses."""
    # A copy of the guesses: neither program may move the starts of the other.
    return replace(compile_task(task, near.added), guesses=dict(near.guesses))


def slack_name(k: int) -> str:
    """Name of the auxiliary unknown by which the k-th group of rows is eased, in steps of its limit."""
    return f"slack {k}"


def elastic(program: Program, may_move: Sequence[bool]) -> Program:
    """The program with a slack for every group of rows, fixed at 0 for those that may not move."""
    count = len(may_move)
    layout = replace(program.layout, auxiliary=(*program.layout.auxiliary, *(slack_name(k) for k in range(count))))
    most = np.where(may_move, 1e4, 0.0)  # steps
    return replace(
        program,
        layout=layout,
        lower=np.concatenate([program.lower, np.zeros(count)]),
        upper=np.concatenate([program.upper, most]),
        scale=np.concatenate([program.scale, np.ones(count)]),
        elastic=True,
        guesses=dict(program.guesses),
    )
