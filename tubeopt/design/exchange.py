"""Requirements with infinitely many cases, by exchange: solve, find the worst omitted cases, add them, repeat."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..block.custom import CustomRequirement
from ..block.quantities import recorded
from ..equilibrium.bundle import Bundled
from ..equilibrium.kinematics import to_equilibrium
from ..equilibrium.member import Point
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import BundleRobot
from ..solvers.sampling import sobol
from ..stability import find_equilibria, follow, worst_certificate
from ..typing import Array
from .evaluation import robot_at, state_at, violation
from .parameters import Free
from .pose import Guess, Twist
from .program import Added, Program, compile_task, corners
from .requirements import Coverage, Reach, Requirement, SnapFree, SnapFreeInUse, Target, of_kind
from .solve import to_feasibility, with_joints
from .state import FreePose, Via
from .task import DesignedRobot, DesignTask

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Smallest and largest translations (n,), m."""

# Rows of a joint path between two task poses. `follow` finds snaps between rows; the least margin is read at rows
# only, and the tolerance on the margin of paths (1e-3) covers what 16 rows leave out.
PATH_POINTS = 16

# Every point adds a task pose with 2 n unknowns. The points farthest out of reach bring in their neighbours, so that
# more than a few at once make the program larger and no better.
POINTS_PER_ROUND = 3

# Steps of a limit, a thousandth of what a designer changes: a point missed by less counts as reached.
UNREACHED = 1e-3


@dataclass(frozen=True, eq=False)
class CheckedMotion:
    """Motion of a robot along the straight joint path between two task poses."""

    first: int
    """Number of the pose at the start."""
    second: int
    """Number of the pose at the end."""
    fraction: Array
    """Fractions (W,) of the path."""
    margin: Array
    """Margins (W,) at the fractions of the path."""
    equilibria: Sequence[Equilibrium]
    """Equilibria (W,) at the fractions of the path."""
    snap: float | None
    """Fraction of the path before the robot snaps; None without a snap."""


def motions(program: Program, robot: DesignedRobot, x: Array) -> list[CheckedMotion]:
    """Quasi-static motions through the task poses in order; after a snap the next motion starts anew."""
    state = state_at(program, x)
    poses = program.task_poses
    fraction = np.linspace(0.0, 1.0, PATH_POINTS + 1)
    motions_between = []
    start: Equilibrium | None = None
    for first, second in pairwise(poses):
        ends = zip(state.joint_values(first), state.joint_values(second), strict=True)
        rotations, translations = (np.outer(1 - fraction, a) + np.outer(fraction, b) for a, b in ends)
        path = follow(robot, rotations, translations, start=start)
        # The row before the snap and the fraction of the step after it, as a fraction of the whole path.
        snap = (path.snaps[0].index + path.snaps[0].fraction) / PATH_POINTS if path.snaps else None
        margin = np.array([e.margin for e in path.equilibria])
        motions_between.append(CheckedMotion(first, second, fraction, margin, path.equilibria, snap))
        start = None if path.snaps else path.equilibria[-1]
    return motions_between


# Cached: exchange and the final check search the same box of the same robot.
@lru_cache(maxsize=16)
def worst_in_box(robot: ConcentricRobot, box: Box) -> tuple[float, tuple[float, ...]]:
    """Smallest certificate over a box of translations, and the translations (n,) with it."""
    worst = worst_certificate(robot, *box).certificate
    return worst.margin, tuple(worst.translations.tolist())


def certified_at(program: Program, robot: DesignedRobot) -> tuple[tuple[float, ...], ...]:
    """Translations of the certificates of a design: those of the program, and the worst ones of each box."""
    boxes = [each.box for each in of_kind(program.task.requirements, SnapFree) if each.box is not None]
    worst = [worst_in_box(robot, box)[1] for box in boxes] if isinstance(robot, ConcentricRobot) else []
    return tuple(dict.fromkeys([*program.layout.certified, *worst]))


class WorstCases(NamedTuple):
    """Worst cases that a design violates."""

    added: Added
    """Cases of its program, and the violated ones."""
    description: str
    """Description of the violated cases; "" without any."""


def worst_cases(program: Program, x: Array) -> WorstCases:
    """Worst cases that the optimum x (X,) of a program violates, among those that its requirements cover."""
    robot = robot_at(program, x)
    added, descriptions = program.added, []
    # If the margin is the objective, the value that the design claims must hold in the omitted cases too.
    claimed = float(x[program.layout.column("margin")]) if "margin" in program.layout.auxiliary else -np.inf
    for certificate in of_kind(program.task.requirements, SnapFree):
        if certificate.box is not None and isinstance(robot, ConcentricRobot):
            margin, row = worst_in_box(robot, certificate.box)
            if margin < max(certificate.required_margin, claimed) - certificate.tolerance:
                added = replace(added, translations=(*added.translations, row))
                descriptions.append(f"certificate {margin:.4f} in the box")
    for use in of_kind(program.task.requirements, SnapFreeInUse):
        if use.paths:
            min_margin = use.margin if program.layout.certified else max(use.margin, claimed)
            vias = _weak_points(program, robot, x, min_margin - use.tolerance)
            added = replace(added, vias=(*added.vias, *vias))
            descriptions += [f"{len(vias)} points on joint paths"] if vias else []
    boxes = of_kind(program.task.requirements, Coverage)
    if boxes:
        tables = list(added.points) or [corners(box) for box in boxes]
        for k, box in enumerate(boxes):
            missed = _missed(program, x, box)
            # Points that the program has already stay missed by its tolerance: adding them again would never end.
            new = [point for point in missed if point not in tables[k]][:POINTS_PER_ROUND]
            tables[k] = (*tables[k], *new)
            descriptions += [f"{len(missed)} points of the workspace box"] if new else []
        added = replace(added, points=tuple(tables))
    return WorstCases(added, ", ".join(descriptions))


def _weak_points(program: Program, robot: DesignedRobot, x: Array, min_margin: float) -> list[Via]:
    """Worst point of each joint path with a margin below `min_margin`.

    The pose that this point becomes starts from the equilibrium found there.
    """
    vias: list[Via] = []
    for motion in motions(program, robot, x):
        if motion.snap is not None:
            if isinstance(robot, BundleRobot):
                fraction, equilibrium = _untwisted_saddle(robot, motion, motion.snap)
            else:
                fraction, equilibrium = _inside_fold(robot, motion, motion.snap)
        elif motion.margin.min() < min_margin:
            k = int(np.argmin(motion.margin))
            fraction, equilibrium = float(motion.fraction[k]), motion.equilibria[k]
        else:
            continue
        # The number of the pose that this point becomes: exchange appends it to all poses.
        program.guesses[len(program.layout.poses) + len(vias)] = guess_of(equilibrium)
        vias.append(Via(motion.first, motion.second, fraction))
    return vias


def _inside_fold(robot: ConcentricRobot, motion: CheckedMotion, snap: float) -> tuple[float, Equilibrium]:
    """Fraction of a snapping motion between its two folds, and the saddle there, the equilibrium of smallest margin.

    The robot leaves its branch at one fold in forward motion, and at another fold in backward motion. In the middle
    between them the saddle is farthest from both. A design in which it has a positive margin has no folds there.
    """
    start, end = motion.equilibria[0], motion.equilibria[-1]
    # Moved back from its new branch, the robot leaves that one at the other fold.
    rotations, translations = [end.rotations, start.rotations], [end.translations, start.translations]
    back = follow(robot, rotations, translations, start=end).snaps
    t = snap if not back else 0.5 * (snap + 1.0 - back[-1].fraction)
    joints = (a + t * (b - a) for a, b in ((start.rotations, end.rotations), (start.translations, end.translations)))
    return t, min(find_equilibria(robot, *joints), key=lambda e: e.margin)


def _untwisted_saddle(robot: BundleRobot, motion: CheckedMotion, snap: float) -> tuple[float, Equilibrium]:
    """Fraction of a snapping motion of a bundle, and the equilibrium of smallest margin found along it.

    Between two folds lies a saddle, in which tubes are wound up less than in the states on either side: Newton's
    method from tubes without torsion ends there.
    """
    k = int(snap * PATH_POINTS)
    found = [(float(motion.fraction[k]), motion.equilibria[k])]
    start, end = motion.equilibria[0], motion.equilibria[-1]
    for t in motion.fraction.tolist():
        joints = (
            a + t * (b - a) for a, b in ((start.rotations, end.rotations), (start.translations, end.translations))
        )
        rotations, translations = joints
        with suppress(SolveError):
            member = Bundled.cold(robot, rotations, tuple(translations.tolist()))
            point = Point.solved_near(
                member, member.untwisted(), "there is no equilibrium close to tubes without torsion"
            )
            found.append((t, to_equilibrium(point, "tubes without torsion")))
    return min(found, key=lambda pair: pair[1].margin)


def guess_of(equilibrium: Equilibrium) -> Guess:
    """Guess of a pose close to an equilibrium."""
    if not equilibrium.robot.fixed_sections:
        return equilibrium
    length = max(float(equilibrium.tube_end.max()), 1e-300)
    return Twist(equilibrium.point / length, equilibrium.point_rotation - equilibrium.rotations)


def _missed(program: Program, x: Array, box: Coverage) -> list[tuple[float, ...]]:
    """Sobol points (3,) of a workspace box that the robot at x cannot reach, the farthest out of reach first."""
    if not box.samples:
        return []
    points = np.array(box.lower) + sobol(3, box.samples) * (np.array(box.upper) - np.array(box.lower))
    missed = []
    for k, point in enumerate(points.tolist()):
        distance = reachable(program, x, tuple(point), box.tolerance, seed=k)
        if distance > UNREACHED:
            missed.append((distance, tuple(point)))
    return [point for _, point in sorted(missed, reverse=True)]


def reachable(program: Program, x: Array, point: tuple[float, ...], tolerance: float, *, seed: int = 0) -> float:
    """Smallest violation, in steps of the limits, of any configuration of the robot at x that reaches a point.

    All requirements that apply to any pose count.
    """
    robot = robot_at(program, x)
    length = robot.tubes[0].straight_length
    fixed = (Free("straight_length", (0,), length, length),)  # no dimension may change, but a task has one that is free
    target = Target((point[0], point[1], point[2]), tolerance)
    requirements = tuple(
        replace(each, paths=False) if isinstance(each, SnapFreeInUse) else each
        for each in program.task.requirements
        if not isinstance(each, Coverage | Reach | SnapFree) and _applies_to_any_pose(each, robot.n_tubes)
    )
    pose_program = compile_task(DesignTask(robot, fixed, (Reach((target,)), *requirements), ordered=False))
    best = np.inf
    # A local search that fails proves nothing, so that it gets two more starts.
    for attempt_number in range(3):
        random = np.random.default_rng([seed, attempt_number])
        start = with_joints(pose_program, pose_program.layout.space.start, random)
        best = min(best, violation(pose_program, to_feasibility(pose_program, start)))
        # Guesses of a search that failed would start the next one on the same branch.
        pose_program.guesses.clear()
        if best <= UNREACHED:
            break
    return best


def _applies_to_any_pose(requirement: Requirement, n: int) -> bool:
    """False for a custom requirement that refers to task poses by number."""
    if not isinstance(requirement, CustomRequirement):
        return True
    try:
        # Recorded for one pose, an expression raises if it names a second one.
        return bool(recorded(requirement.expression, n, 1, requirement.description, (1,) * n).quantities)
    except InputError:
        return False


def carry(old: Program, added: Added, x: Array, seed: int = 0) -> tuple[Program, Array]:
    """Program with more cases, and x in its layout; new poses start at the best of random joint values."""
    new = compile_task(old.task, added)
    # With the same poses only translations of the certificate are new, and x keeps its layout.
    if new.layout.poses == old.layout.poses:
        new.guesses.update(old.guesses)
        return new, x.copy()
    start = with_joints(new, x[: old.layout.designs], np.random.default_rng([seed, len(new.layout.poses)]))
    first_via_old, first_via_new = len(old.task_poses), len(new.task_poses)
    pairs = [
        # strict=False: a box that got points has more poses than before, the old ones first.
        *(
            pair
            for before, after in zip(old.requirement_poses, new.requirement_poses, strict=True)
            for pair in zip(before, after, strict=False)
        ),
        *([(old.depth_pose, new.depth_pose)] if old.depth_pose is not None and new.depth_pose is not None else []),
        *((first_via_old + k, first_via_new + k) for k in range(len(added.vias))),
    ]
    for before, after in pairs:
        new_pose = new.layout.poses[after]
        if isinstance(new_pose, FreePose):
            old_pose = old.layout.poses[before]
            assert isinstance(old_pose, FreePose)
            for a, b in zip(old.layout.joints(old_pose), new.layout.joints(new_pose), strict=True):
                start[b] = x[a]
        if before in old.guesses:
            new.guesses[after] = old.guesses[before]
    for name in old.layout.auxiliary:
        start[new.layout.column(name)] = x[old.layout.column(name)]
    return new, np.clip(start, new.lower, new.upper)
