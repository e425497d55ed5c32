"""Inverse kinematics: joint values whose equilibrium, stable by a margin, has its tip at a target.

Under a load the unloaded robot is aimed so that the loaded one arrives. How a load moves the tip changes little from
one posture to the next, so that aiming by what is missed converges like a geometric series. Every answer of the way is
one of the search without load, and the load is put on it as the robot would feel it: growing from none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, TypedDict, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from ..bodies.obstacles import Obstacle
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, choice, instance, vector
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..solvers.parallel.blas import small
from ..typing import Array
from .answer import InverseSolution
from .clock import Clock
from .goal import Goal, angle, pose_question, unit_vector
from .joints import Configuration
from .multistart import Multistart, known_home
from .outline import Outline
from .posture import seed_posture
from .settings import DEFAULT_OPTIONS, InverseOptions
from .way import with_a_way

Search = Callable[[Array, Array | None, InverseSolution | None, float, InverseOptions], InverseSolution]
"""Answer without load to position, direction, the answer before, least margin, options."""


class Asked(TypedDict, total=False):
    """What `inverse_kinematics` may be asked besides, with one answer or all."""

    direction: ArrayLike | None
    seed: Configuration | None
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


@small
def inverse_kinematics(  # noqa: PLR0913
    robot: Robot,
    position: ArrayLike,
    *,
    direction: ArrayLike | None = None,
    seed: Configuration | None = None,
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

    Every step of the search is a solved, stable equilibrium. How the robot gets there from where it is, is another
    question: `.reachable` tells whether a way without a snap is known from the seed, or else from home; `.way` is it.

    Args:
        position: (3,) of the tip, m.
        direction: (3,) along which the tip shall point, of any length; None leaves it free.
        seed: where the robot is: a pair (rotations, translations), an Equilibrium or an InverseSolution. The search
            starts there and follows its branch; where that leads nowhere, it starts elsewhere.
        reference: configuration to stay close to; by default the seed.
        min_margin: least stability margin, in [0, 1).
        limits: range of every joint; by default `robot.limits`. The order of the tubes is kept as well.
        weights: of the joints' distances from the reference: (n,) per rad and (n,) per m; by default 1 per rad and 2
            per length of the longest tube.
        obstacles: bodies that the whole arm keeps away from, by `options.clearance`.
        load: forces that push on the robot and keep their direction: tip, margin and clearance are those under it,
            grown from none. One answer; whether a way leads there is not told.
        on_failure: "raise", or "closest" to get the closest pose where the target is out of reach.
        all_solutions: return all distinct answers that are found, best first: nearest to the reference where there is
            one, else the largest margin.
        reachable: find a way without a snap to every answer that is returned, or say that none was found: straight, by
            translations that exclude any snap, or by sampling, for up to 10 s.
        options: objective, direction as a cost, clearance, method, and the like.

    Raises:
        InputError: numbers that are missing, not finite or not allowed; limits that leave nothing; a load without an
            energy, and so without a margin.
        SolveError: no answer was found; the message says by how far the target is missed and what holds the robot,
            `.solution` is the closest pose.

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
    kept: dict[str, Any] = {"min_margin": min_margin, "limits": limits, "weights": weights, "obstacles": obstacles}
    choice("on_failure", on_failure, ("raise", "closest"))
    if load is not None:
        if all_solutions or reachable or on_failure != "raise":
            raise InputError("all_solutions, reachable and on_failure 'closest' are for a robot without load")

        def without(
            at: Array, along: Array | None, last: InverseSolution | None, floor: float, asked: InverseOptions
        ) -> InverseSolution:
            start = _without_load(seed) if last is None else last
            goal = pose_question(robot, (at, along), (start, reference), options=asked, **{**kept, "min_margin": floor})
            return _answers(goal, start, clock)[0]

        towards = None if direction is None else unit_vector("direction", direction)
        return _under_load(
            without, (vector("position", position, 3, "x, y, z in m"), towards), load, min_margin, options
        )
    goal = pose_question(robot, (position, direction), (seed, reference), options=options, **kept)
    found = _answers(goal, seed, clock, every=all_solutions, on_failure=on_failure, reachable=reachable)
    return found if all_solutions else found[0]


def _answers(
    goal: Goal,
    seed: Configuration | None,
    clock: Clock,
    *,
    every: bool = False,
    on_failure: str = "raise",
    reachable: bool = False,
) -> list[InverseSolution]:
    """The answer to a question in the time that a clock leaves, or `every` one."""
    if goal.objective == "nearest" and not goal.named:
        raise InputError("objective is 'nearest', but neither reference nor seed is given; give one of them")
    if goal.direction_weight is not None and goal.direction is None:
        raise InputError("direction_weight is given without a direction; give the direction to point along")
    if goal.options.method == "nlp" and goal.overdetermined:
        raise InputError(
            f"method is 'nlp', but the target asks for more than the {len(goal.space.lower)} independent joints of the "
            "robot can choose; use auto or gauss_newton"
        )
    first = seed_posture(goal.space, seed) if seed is not None else None
    goal = replace(goal, clock=clock)
    search = Multistart(goal, first)
    found = (search.all() if every else search.one()) or [search.failure(on_failure)]
    if reachable:
        begin = first if first is not None else known_home(goal.space)
        found = [with_a_way(each, begin, goal) for each in found]
    return found


def _under_load(
    search: Search, target: tuple[Array, Array | None], load: Load, min_margin: float, options: InverseOptions
) -> InverseSolution:
    """Joint values whose loaded equilibrium has its tip at a target, with margin and clearance under the load.

    Where the loaded arm falls short of the margin or the clearance, the unloaded one is asked for so much more.
    """
    if not load.has_energy:
        raise InputError("load has a moment or turns with the tip, so no margin: no answer is known to be stable")
    if options.direction_weight is not None:
        raise InputError("direction_weight is given; under load a direction is held or left free")
    floor, clearance, last, room = min_margin, options.clearance, None, options.solver.aim.room
    for _ in range(options.solver.aim.shots):
        asked = replace(options, clearance=clearance)
        found, e = _aim(search, target, load, (last, floor, asked))
        answer = _loaded_answer(found, e, target)
        short = min_margin - e.margin
        near = options.clearance - Outline(e).clearance(found.scene) if found.scene.bodies else -1.0
        if short <= 0 and near <= 0:
            return answer
        floor += max(short, 0.0) + (room if short > 0 else 0.0)
        clearance += max(near, 0.0) + (room * float(e.arc_length[-1]) if near > 0 else 0.0)
        if floor >= 1:
            break
        last = found
    raise SolveError(
        f"under the load the margin is {e.margin:.3g} and the clearance {1e3 * max(near, 0.0):.3g} mm too small at the "
        "best answer that was found",
        answer,
    )


def _without_load(seed: Configuration | None) -> Configuration | None:
    """Where a robot is, without the load that it bears there."""
    known = getattr(seed, "equilibrium", seed)
    if isinstance(known, Equilibrium) and known.load is not None:
        return known.rotations, known.translations
    return seed


def _aim(
    search: Search,
    target: tuple[Array, Array | None],
    load: Load,
    question: tuple[InverseSolution | None, float, InverseOptions],
) -> tuple[InverseSolution, Equilibrium]:
    """An answer without load whose loaded equilibrium is on target."""
    (position, direction), (last, floor, options) = target, question
    at, along, missed, solver = position, direction, np.inf, options.solver.aim
    for _ in range(solver.shots):
        last = search(at, along, last, floor, options)
        e = forward_kinematics(
            last.equilibrium.robot, last.rotations, last.translations, load=load, guess=last.equilibrium
        )
        gap = position - e.tip_position
        turn = 0.0 if direction is None else angle(e.tip_rotation[:, 2], direction)
        before, missed = missed, max(float(np.linalg.norm(gap)) / float(e.arc_length[-1]), turn)
        if max(float(np.linalg.norm(gap)), turn) <= solver.tolerance:
            return last, e
        if missed > solver.gain * before:
            if missed <= solver.stalled:
                return last, e
            break
        at = at + gap
        if direction is not None and along is not None:
            along = along + direction - e.tip_rotation[:, 2]
            along = along / np.linalg.norm(along)
    raise SolveError(
        f"the loaded robot misses the target by {1e3 * np.linalg.norm(gap):.3g} mm, and aiming does not help"
    )


def _loaded_answer(found: InverseSolution, e: Equilibrium, target: tuple[Array, Array | None]) -> InverseSolution:
    position, direction = target
    return replace(
        found,
        target_position=position,
        target_direction=direction,
        equilibrium=e,
        position_error=float(np.linalg.norm(e.tip_position - position)),
        direction_error=float("nan") if direction is None else angle(e.tip_rotation[:, 2], direction),
        cold_start_agrees=None,
        straight_from_seed=None,
        # The way of the unloaded robot: what the loaded one does on it nobody asked.
        reachable=None,
        way=None,
    )
