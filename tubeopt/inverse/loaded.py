"""Inverse kinematics under a load: the unloaded robot is aimed so that the loaded one arrives.

How a load moves the tip changes little from one posture to the next, so that aiming by what is missed converges like a
geometric series. Every answer of the way is one of the search without load, and the load is put on it as the robot
would feel it: growing from none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..robots.load import Load
from ..typing import Array
from .answer import InverseOptions, InverseSolution
from .goal import angle
from .joints import Configuration
from .outline import Outline

Search = Callable[[Array, Array | None, InverseSolution | None, float, InverseOptions], InverseSolution]
"""Answer without load to position, direction, the answer before, least margin, options."""


def under_load(
    search: Search, target: tuple[Array, Array | None], load: Load, min_margin: float, options: InverseOptions
) -> InverseSolution:
    """Joint values whose loaded equilibrium has its tip at a target, with margin and clearance under the load.

    Where the loaded arm falls short of the margin or the clearance, the unloaded one is asked for so much more.

    Raises:
        InputError: a load without an energy, so without a margin; a direction that is a cost.
        SolveError: no unloaded answer; a load that the robot does not bear there; aiming that does not converge.
    """
    if not load.has_energy:
        raise InputError("load has a moment or turns with the tip, so no margin: no answer is known to be stable")
    if options.direction_weight is not None:
        raise InputError("direction_weight is given; under load a direction is held or left free")
    floor, clearance, last, room = min_margin, options.clearance, None, options.solver.aim_room
    for _ in range(options.solver.shots):
        asked = replace(options, clearance=clearance)
        found, e = _aim(search, target, load, (last, floor, asked))
        answer = _answer(found, e, target)
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


def without_load(seed: Configuration | None) -> Configuration | None:
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
    at, along, missed, solver = position, direction, np.inf, options.solver
    for _ in range(solver.shots):
        last = search(at, along, last, floor, options)
        e = forward_kinematics(
            last.equilibrium.robot, last.rotations, last.translations, load=load, guess=last.equilibrium
        )
        gap = position - e.tip_position
        turn = 0.0 if direction is None else angle(e.tip_rotation[:, 2], direction)
        before, missed = missed, max(float(np.linalg.norm(gap)) / float(e.arc_length[-1]), turn)
        if max(float(np.linalg.norm(gap)), turn) <= solver.aim_tolerance:
            return last, e
        if missed > solver.aim_gain * before:
            if missed <= solver.aim_stalled:
                return last, e
            break
        at = at + gap
        if direction is not None and along is not None:
            along = along + direction - e.tip_rotation[:, 2]
            along = along / np.linalg.norm(along)
    raise SolveError(
        f"the loaded robot misses the target by {1e3 * np.linalg.norm(gap):.3g} mm, and aiming does not help"
    )


def _answer(found: InverseSolution, e: Equilibrium, target: tuple[Array, Array | None]) -> InverseSolution:
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
