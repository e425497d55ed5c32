"""Requirements with endlessly many cases, by exchange: solve, find the worst cases left out, add them, repeat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ..block.custom import CustomRequirement
from ..block.quantities import recorded
from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..robots.concentric import ConcentricRobot
from ..solvers.sampling import sobol
from ..stability import find_equilibria, follow, worst_certificate
from ..typing import Array
from .evaluation import robot_at, state_at, violation
from .parameters import Free
from .pose import Twist
from .program import Added, Program, compile_task, corners
from .requirements import Coverage, Reach, Requirement, SnapFree, SnapFreeInUse, Target, of_kind
from .solve import to_feasibility, with_joints
from .state import FreePose
from .task import DesignTask

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Least and greatest translations."""

# Rows of a joint path between two task poses. `follow` finds snaps between rows; the least margin is read at rows
# only, and the tolerance on the margin of paths (1e-3) covers what 16 rows leave out.
PATH_POINTS = 16

# Every point adds a task pose with 2 n unknowns. The points farthest out of reach bring in their neighbours, so that
# more than a few at once make the program larger and no better.
POINTS_PER_ROUND = 3


@dataclass(frozen=True, eq=False)
class Motion:
    """A robot moved from the `first` to the `second` of two task poses."""

    first: int
    second: int
    fraction: Array
    """(W,) of the step."""
    margin: Array
    """(W,) at these."""
    equilibria: Sequence[Equilibrium]
    """(W,) at these."""
    snap: float | None
    """The fraction at which it snaps; None where it does not."""


def motions(program: Program, robot: ConcentricRobot, x: Array) -> list[Motion]:
    """The robot moved through its task poses in order, slowly; after a snap it goes on from the next pose anew."""
    state = state_at(program, x)
    joints = [state.joint_values(k) for k in program.task_poses]
    count = PATH_POINTS
    share = np.linspace(0.0, 1.0, count + 1)
    out = []
    start: Equilibrium | None = None
    for a in range(len(joints) - 1):
        rows = [np.outer(1 - share, joints[a][j]) + np.outer(share, joints[a + 1][j]) for j in range(2)]
        path = follow(robot, rows[0], rows[1], start=start)
        # The row before the snap and the share of the step after it, as a fraction of the whole path.
        snap = (path.snaps[0].index + path.snaps[0].fraction) / count if path.snaps else None
        margin = np.array([e.margin for e in path.equilibria])
        numbers = program.task_poses[a], program.task_poses[a + 1]
        out.append(Motion(*numbers, share, margin, path.equilibria, snap))
        start = None if path.snaps else path.equilibria[-1]
    return out


# Kept: exchange and the final check ask for the same box of the same robot.
@lru_cache(maxsize=16)
def worst_in_box(robot: ConcentricRobot, box: Box) -> tuple[float, tuple[float, ...]]:
    """Least certificate over a box of translations, and where."""
    worst = worst_certificate(robot, *box).certificate
    return worst.margin, tuple(worst.translations.tolist())


def certified_at(program: Program, robot: ConcentricRobot) -> tuple[tuple[float, ...], ...]:
    """Translations at which a design is certified: those in the program, and the worst of a box."""
    boxes = [one.box for one in of_kind(program.task.requirements, SnapFree) if one.box is not None]
    return tuple(dict.fromkeys([*program.layout.certified, *(worst_in_box(robot, box)[1] for box in boxes)]))


def violations(program: Program, x: Array) -> tuple[Added, str]:
    """What is to be added to a program whose optimum is x, and in a word why; nothing and "" where all cases hold."""
    robot = robot_at(program, x)
    added, why = program.added, []
    # Where the margin is what is wanted, what the design claims must hold in the cases left out too.
    promised = float(x[program.layout.column("margin")]) if "margin" in program.layout.auxiliary else -np.inf
    for one in of_kind(program.task.requirements, SnapFree):
        if one.box is not None:
            margin, row = worst_in_box(robot, one.box)
            if margin < max(one.floor, promised) - one.tolerance:
                added = replace(added, translations=(*added.translations, row))
                why.append(f"certificate {margin:.4f} in the box")
    for one in of_kind(program.task.requirements, SnapFreeInUse):
        if one.paths:
            wanted = one.margin if program.layout.certified else max(one.margin, promised)
            vias = _weak_points(program, robot, x, wanted - one.tolerance)
            added = replace(added, vias=(*added.vias, *vias))
            why += [f"{len(vias)} points on joint paths"] if vias else []
    boxes = of_kind(program.task.requirements, Coverage)
    if boxes:
        tables = list(added.points) or [corners(box) for box in boxes]
        for k, box in enumerate(boxes):
            missed = _missed(program, x, box)
            # Points that the program has already stay missed by its tolerance: adding them again would never end.
            new = [point for point in missed if point not in tables[k]][:POINTS_PER_ROUND]
            tables[k] = (*tables[k], *new)
            why += [f"{len(missed)} points of the workspace box"] if new else []
        added = replace(added, points=tuple(tables))
    return added, ", ".join(why)


def _weak_points(program: Program, robot: ConcentricRobot, x: Array, least: float) -> list[tuple[int, int, float]]:
    """Points of joint paths where the margin is below `least`, the worst of each; poses there begin in what was
    found."""
    out = []
    for motion in motions(program, robot, x):
        if motion.snap is not None:
            fraction, found = _inside_fold(robot, motion)
        elif motion.margin.min() < least:
            k = int(np.argmin(motion.margin))
            fraction, found = float(motion.fraction[k]), motion.equilibria[k]
        else:
            continue
        out.append((motion.first, motion.second, fraction))
        # The number of the pose that this point becomes: exchange appends it to all poses.
        program.guesses[len(program.layout.poses) + len(out) - 1] = twist_of(found)
    return out


def _inside_fold(robot: ConcentricRobot, motion: Motion) -> tuple[float, Equilibrium]:
    """A fraction of a path that snaps, and the equilibrium there with the least margin: the saddle between branches.

    Going forth the robot leaves its branch at one fold, coming back at another; half-way between them the saddle is
    farthest from both. A design in which it has a positive margin has no folds there.
    """
    assert motion.snap is not None
    joints = [np.concatenate([e.rotations, e.translations]) for e in (motion.equilibria[0], motion.equilibria[-1])]

    def at(t: float) -> tuple[Array, Array]:
        rotations, translations = np.split(joints[0] + t * (joints[1] - joints[0]), 2)
        return rotations, translations

    there, here = at(1.0), at(0.0)
    # Moved back from its new branch, the robot leaves that one at the other fold.
    back = follow(robot, [there[0], here[0]], [there[1], here[1]], start=motion.equilibria[-1]).snaps
    t = motion.snap if not back else 0.5 * (motion.snap + 1.0 - back[-1].fraction)
    candidates = find_equilibria(robot, *at(t))
    return t, min(candidates, key=lambda e: e.margin)


def twist_of(equilibrium: Equilibrium) -> Twist:
    """Where a pose near an equilibrium begins."""
    length = max(float(equilibrium.tube_end.max()), 1e-300)
    return Twist(equilibrium.point / length, equilibrium.point_rotation - equilibrium.rotations)


def _missed(program: Program, x: Array, box: Coverage) -> list[tuple[float, ...]]:
    """Sobol points of a workspace box that the robot at x cannot reach under the task's other requirements, the
    farthest out of reach first."""
    if not box.samples:
        return []
    unit = sobol(3, box.samples)
    points = np.array(box.lower) + unit * (np.array(box.upper) - np.array(box.lower))
    missed = []
    for k, point in enumerate(points.tolist()):
        gap = reachable(program, x, tuple(point), box.tolerance, seed=k)
        if gap > 1e-3:
            missed.append((gap, tuple(point)))
    return [point for _, point in sorted(missed, reverse=True)]


def reachable(program: Program, x: Array, point: tuple[float, ...], tolerance: float, *, seed: int = 0) -> float:
    """How far, in steps of the limits, the robot at x stays from reaching a point within what poses must keep."""
    robot = robot_at(program, x)
    held = robot.tubes[0].straight_length
    fixed = (Free("straight_length", (0,), held, held),)  # no dimension may change, but a task has one that is free
    target = Target((point[0], point[1], point[2]), tolerance)
    keep = tuple(
        replace(one, paths=False) if isinstance(one, SnapFreeInUse) else one
        for one in program.task.requirements
        if not isinstance(one, Coverage | Reach | SnapFree) and _of_one_pose(one, program.task.robot.n_tubes)
    )
    alone = compile_task(DesignTask(robot, fixed, (Reach((target,)), *keep), ordered=False))
    best = np.inf
    # A local search that fails proves nothing, so that it gets two more starts.
    for attempt_number in range(3):
        random = np.random.default_rng([seed, attempt_number])
        begin = with_joints(alone, alone.layout.space.start, random)
        best = min(best, violation(alone, to_feasibility(alone, begin)))
        # Guesses of a search that failed would start the next one on the same branch.
        alone.guesses.clear()
        if best <= 1e-3:
            break
    return best


def _of_one_pose(one: Requirement, n: int) -> bool:
    """Whether a requirement can be asked of any pose: an own one that speaks of poses by number says nothing of it."""
    if not isinstance(one, CustomRequirement):
        return True
    try:
        # Recorded for one pose, an expression raises if it names a second one.
        return bool(recorded(one.expression, n, 1, one.words, (1,) * n).quantities)
    except InputError:
        return False


def carry(old: Program, added: Added, x: Array, seed: int = 0) -> tuple[Program, Array]:
    """The program with more cases, and x in its layout; poses that are new begin from the best of many."""
    new = compile_task(old.task, added)
    # With the same poses only translations of the certificate are new, and x keeps its layout.
    if new.layout.poses == old.layout.poses:
        new.guesses.update(old.guesses)
        return new, x.copy()
    out = with_joints(new, x[: old.layout.designs], np.random.default_rng([seed, len(new.layout.poses)]))
    first_old, first_new = len(old.task_poses), len(new.task_poses)
    pairs = [
        # strict=False: a box that got points has more poses than before, the old ones first.
        *(pair for before, after in zip(old.own, new.own, strict=True) for pair in zip(before, after, strict=False)),
        *([(old.depth_pose, new.depth_pose)] if old.depth_pose is not None and new.depth_pose is not None else []),
        *((first_old + k, first_new + k) for k in range(len(added.vias))),
    ]
    for before, after in pairs:
        there = new.layout.poses[after]
        if isinstance(there, FreePose):
            here = old.layout.poses[before]
            assert isinstance(here, FreePose)
            for a, b in zip(old.layout.joints(here), new.layout.joints(there), strict=True):
                out[b] = x[a]
        if before in old.guesses:
            new.guesses[after] = old.guesses[before]
    for name in old.layout.auxiliary:
        out[new.layout.column(name)] = x[old.layout.column(name)]
    return new, np.clip(out, new.lower, new.upper)
