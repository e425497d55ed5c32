"""Inverse kinematics: joint values whose equilibrium, stable by a margin, has its tip at a target.

Under a load the unloaded robot is aimed so that the loaded one arrives. How a load moves the tip changes little from
one posture to the next, so that aiming by what is missed converges like a geometric series. Every answer of the way is
one of the search without load, and the load is put on it as the robot would feel it: growing from none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, TypedDict, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import renamed, typed
from ..bodies.obstacles import Obstacle
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, choice, instance
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..solvers.blas import small
from ..typing import Array
from .answer import InverseSolution
from .arm_surface import ArmSurface
from .clock import Clock
from .gauss_newton import broyden
from .goal import Goal, angle, pose_question
from .joint_path import with_a_way
from .joints import Configuration
from .multistart import Multistart, known_home
from .posture import posture_of, start_posture
from .settings import DEFAULT_OPTIONS, InverseOptions

SHOTS = 40
"""Solutions without load, and rounds of corrections of margin and clearance, in search of one under a load."""

# A fifth of what an answer may miss by.
AIM_TOLERANCE, STALLED = 2e-9, 1e-7
"""Distance, m, and angle, rad, at which the aim is good; and the miss, as a share of the arm or as an angle, below
which round-off ends the iteration."""

# With larger ratios 40 shots gain less than two digits.
AIM_GAIN, POOR_SHOTS = 0.9, 4
"""Largest ratio of successive misses of a converging iteration, and shots above it after which it does not converge."""

# Without it corrections approach the bound from below without reaching it.
AIM_ROOM = 1e-3
"""Margin, and share of the arm's length as clearance, that are required beyond what was found missing."""


class Asked(TypedDict, total=False):
    """What `inverse_kinematics` may be asked besides, with one answer or all."""

    direction: ArrayLike | None
    start: Configuration | None
    reference: Configuration | None
    min_margin: float
    limits: JointLimits | None
    weights: tuple[ArrayLike, ArrayLike] | None
    obstacles: Sequence[Obstacle]
    load: Load | None
    on_failure: str
    reachable: bool
    options: InverseOptions


@overload
def inverse_kinematics(
    robot: Robot, position: ArrayLike, *, all_solutions: Literal[False] = ..., **asked: Unpack[Asked]
) -> InverseSolution: ...


@overload
def inverse_kinematics(
    robot: Robot, position: ArrayLike, *, all_solutions: Literal[True], **asked: Unpack[Asked]
) -> list[InverseSolution]: ...


@renamed(seed="start")
@typed
@small
def inverse_kinematics(  # noqa: PLR0913
    robot: Robot,
    position: ArrayLike,
    *,
    direction: ArrayLike | None = None,
    start: Configuration | None = None,
    reference: Configuration | None = None,
    min_margin: float = 0.05,
    limits: JointLimits | None = None,
    weights: tuple[ArrayLike, ArrayLike] | None = None,
    obstacles: Sequence[Obstacle] = (),
    load: Load | None = None,
    on_failure: str = "raise",
    all_solutions: bool = False,
    reachable: bool = False,
    options: InverseOptions = DEFAULT_OPTIONS,
) -> InverseSolution | list[InverseSolution]:
    """Joint values that bring the tip to a target, in a stable equilibrium with at least `min_margin`.

    Every step of the search is a solved, stable equilibrium. `.reachable` states whether a snap-free path from the
    start, or else from home, is known; `.path` is that path.

    Args:
        position: (3,) target position of the tip, m.
        direction: (3,) target direction of the tip, of any length; None leaves it free.
        start: current configuration: a pair (rotations, translations), an Equilibrium or an InverseSolution. The search
            starts there and follows its branch; if that fails, it starts elsewhere.
        reference: configuration to stay close to; by default the start.
        min_margin: smallest allowed stability margin, in [0, 1).
        limits: range of every joint; by default `robot.limits`. The order of the tubes is kept as well.
        weights: weights of the joint distances from the reference: (n,) per rad and (n,) per m; by default 1 per rad
            and 2 per length of the longest tube.
        obstacles: bodies that the whole arm avoids by `options.clearance`.
        load: dead forces on the robot: tip, margin and clearance are those under load. Gives one solution, without a
            path.
        on_failure: "raise", or "closest" to get the closest pose to a target out of reach.
        all_solutions: return all distinct solutions found, best first: nearest to the reference if there is one, else
            the largest margin.
        reachable: search a snap-free path to every returned solution for up to 10 s: straight, through translations
            that exclude any snap, or by sampling.
        options: objective, weight of the direction, clearance, method, and so on.

    Raises:
        InputError: numbers that are missing, not finite or not allowed, limits that leave nothing, or a load without an
            energy (and so without a margin).
        SolveError: no solution was found. The message states the miss and the active constraints; `.solution` is the
            closest pose.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> found = tubeopt.inverse_kinematics(robot, [0.05, 0.03, 0.15])
        >>> found.reached, found.position_error < 1e-9
        (True, True)
    """
    check_robot(robot)
    instance("options", options, InverseOptions)
    clock = Clock(options.time_limit)
    choice("on_failure", on_failure, ("raise", "closest"))
    if load is not None and (all_solutions or reachable or on_failure != "raise"):
        raise InputError("all_solutions, reachable and on_failure 'closest' are for a robot without load")
    goal = pose_question(
        robot,
        (position, direction),
        (start, reference),
        min_margin=min_margin,
        limits=limits,
        weights=weights,
        obstacles=obstacles,
        options=options,
    )
    goal = replace(goal, clock=clock)
    if load is not None:
        return _under_load(goal, _without_load(start), load, held=reference is not None)
    found = answers_of(goal, start, every=all_solutions, on_failure=on_failure, reachable=reachable)
    return found if all_solutions else found[0]


def answers_of(
    goal: Goal,
    start: Configuration | None,
    *,
    every: bool = False,
    on_failure: str = "raise",
    reachable: bool = False,
) -> list[InverseSolution]:
    """The answer to a question, or `every` one."""
    if goal.objective == "nearest" and not goal.named:
        raise InputError("objective is 'nearest', but neither reference nor start is given; give one of them")
    if goal.direction_weight is not None and goal.direction is None:
        raise InputError("direction_weight is given without a direction; give the direction to point along")
    if goal.options.method == "nlp" and goal.overdetermined:
        raise InputError(
            "method is 'nlp', but the target has more conditions than the "
            f"{len(goal.space.lower)} independent joints of the robot; use auto or "
            "gauss_newton"
        )
    first = start_posture(goal.space, start) if start is not None else None
    search = Multistart(goal, first)
    found = (search.all() if every else search.one()) or [search.failure(on_failure)]
    if reachable:
        begin = first if first is not None else known_home(goal.space)
        found = [with_a_way(each, begin, goal) for each in found]
    return found


def _under_load(goal: Goal, start: Configuration | None, load: Load, *, held: bool) -> InverseSolution:
    """Joint values whose loaded equilibrium has its tip at a target, with margin and clearance under the load; near the
    start or, where its reference is `held`, that of the goal.

    Where the loaded arm falls short of the margin or the clearance, the unloaded one is asked for so much more.
    """
    if goal.direction_weight is not None:
        raise InputError("direction_weight is given; under load a direction is a constraint or free")
    wanted, last = goal, start
    for _ in range(SHOTS):
        last, e = _aim(wanted, last, load, held=held)
        answer = _loaded_answer(last, e, goal)
        short = goal.min_margin - e.margin
        near = goal.clearance - ArmSurface(e).clearance(goal.scene) if goal.scene.bodies else -1.0
        if short <= 0 and near <= 0:
            return answer
        floor = wanted.min_margin + max(short, 0.0) + (AIM_ROOM if short > 0 else 0.0)
        clearance = wanted.clearance + max(near, 0.0) + (AIM_ROOM * float(e.arc_length[-1]) if near > 0 else 0.0)
        if floor >= 1:
            break
        wanted = replace(wanted, min_margin=floor, options=replace(wanted.options, clearance=clearance))
    raise SolveError(
        f"the best solution under load has margin {e.margin:.3g}, and its clearance is "
        f"{1e3 * max(near, 0.0):.3g} mm too small",
        answer,
    )


def _without_load(start: Configuration | None) -> Configuration | None:
    """Where a robot is, without the load that it bears there."""
    known = getattr(start, "equilibrium", start)
    if isinstance(known, Equilibrium) and known.load is not None:
        return known.rotations, known.translations
    return start


def _aim(goal: Goal, last: Configuration | None, load: Load, *, held: bool) -> tuple[InverseSolution, Equilibrium]:
    """An answer without load whose loaded equilibrium is on target: by Broyden's method in where the unloaded tip is
    and, where it is wanted, in its direction, from as if the load moved all tips alike."""
    at, missed, poor = goal, np.inf, 0
    slope: Array = np.eye(3 if goal.direction is None else 6)
    before: Array | None = None
    step = slope[0]
    for _ in range(SHOTS):
        if isinstance(last, InverseSolution) and not held:
            here = goal.space.join(last.rotations, last.translations)
            at = replace(at, named=True, objective=at.objective or "nearest", reference=here)
        (last,) = answers_of(at, last)
        e = forward_kinematics(
            last.equilibrium.robot, last.rotations, last.translations, load=load, start=last.equilibrium
        )
        gap = goal.position - e.tip_position
        turn = 0.0 if goal.direction is None else angle(e.tip_rotation[:, 2], goal.direction)
        last_miss, missed = missed, max(float(np.linalg.norm(gap)) / float(e.arc_length[-1]), turn)
        if max(float(np.linalg.norm(gap)), turn) <= AIM_TOLERANCE:
            return last, e
        poor += missed > AIM_GAIN * last_miss
        if poor and missed <= STALLED:
            return last, e
        if poor > POOR_SHOTS:
            break
        length, off = float(e.arc_length[-1]), gap
        if goal.direction is not None:
            off = np.concatenate([gap, length * (goal.direction - e.tip_rotation[:, 2])])
        if before is not None:
            slope = broyden(slope, step, before - off)
        before, step = off, np.linalg.solve(slope, off)
        at = replace(at, position=at.position + step[:3])
        if at.direction is not None:
            along = at.direction + step[3:] / length
            at = replace(at, direction=along / np.linalg.norm(along))
    raise SolveError(
        f"the loaded robot misses the target by {1e3 * np.linalg.norm(gap):.3g} mm; iterations did not converge"
    )


def _loaded_answer(found: InverseSolution, e: Equilibrium, goal: Goal) -> InverseSolution:
    at = posture_of(goal.space, e)
    return replace(
        found,
        target_position=goal.position,
        target_direction=goal.direction,
        equilibrium=e,
        position_error=goal.position_error(at),
        direction_error=goal.direction_error(at),
        cold_start_agrees=None,
        straight_from_seed=None,
        # The way of the unloaded robot: what the loaded one does on it nobody asked.
        reachable=None,
        path=None,
    )
