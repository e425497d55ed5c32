"""Equilibria by the compiled kernels: one, and those along a family.

A function returns None, or stops, where a kernel declines: there is none for the robot, no stable equilibrium is close
by, or no mesh is fine enough. The general solver then goes on.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..block.transcription.arm import Found
from ..block.transcription.loaded import LoadedProblem
from ..robots.robot import Robot
from ..solvers.compiled.binding import Start, solve_compiled
from ..solvers.compiled.loaded import solve_loaded_compiled
from ..solvers.settings import LARGEST_RATIO, LARGEST_TWIST
from ..typing import Array
from .answer import answered, at_points, built, largest_error
from .continuation import Family, Milestone, largest_twist, shortest_arm, small_motion
from .loaded import Loaded
from .method import Asked
from .problem import DEFAULT_DISCRETISATION, LOADED_DISCRETISATION, LOADED_REFINEMENTS, loaded_rules
from .result import Equilibrium, Statistics

# Close to a fold the general solver bends its steps to the branch, where the kernel only halves them: seven halvings
# cost the kernel less than one step of the general solver, more would be spent on a branch that ends.
SHORTEST_COMPILED = 1 / 128
"""Fraction of the longest step along a path below which the general solver takes over from the compiled kernel."""


def unloaded(
    robot: Robot, rotations: Array, translations: Array, guess: Equilibrium | None, asked: Asked
) -> Equilibrium | None:
    """The stable equilibrium without a load at joint values: from tubes without torsion, or by a small motion from a
    guess; on the usual mesh or, where that is too coarse, on one twice as fine."""
    if _tied(robot):
        _check_translations(robot, tuple(translations.tolist()))
    start, most = None, LARGEST_TWIST
    if guess is not None:
        turn, arm, points = rotations - guess.rotations, guess.arm, guess.points
        length = max(float(arm.arc_length[-1]), shortest_arm(robot))
        if guess.margin <= 0 or not small_motion(turn, translations - guess.translations, length):
            return None
        along = arm.arc_length, arm.rotation, arm.torsion, points.point, points.point_rotation
        start, most = Start(*along, turn, guess.translations), largest_twist(guess.margin)
    for refinement in (0, 1):
        solved = solve_compiled(robot, rotations, translations, start, refinement)
        if solved is None or solved.largest_change > most:
            return None
        if start is not None and solved.contraction > LARGEST_RATIO:
            return None
        found = solved.found
        length = float(found.arm.arc_length[-1])
        if largest_error(*found.errors[:2], length, even=robot.even) > asked.tolerance:
            continue
        statistics = Statistics(
            method="newton",
            iterations=found.iterations,
            elements=solved.elements,
            degree=DEFAULT_DISCRETISATION.degree,
            start="tubes without torsion" if start is None else "guess",
            seconds=time.perf_counter() - asked.began - solved.loading,
            refinement=refinement,
            loading=solved.loading,
        )
        return built(robot, (rotations, translations), found, statistics)
    return None


@lru_cache(maxsize=64)
def _tied(robot: Robot) -> bool:
    """Whether tubes move together."""
    return len(robot.moving_together) < robot.n_tubes


@lru_cache(maxsize=256)
def _check_translations(robot: Robot, shift: tuple[float, ...]) -> None:
    """Raise InputError where tubes that move together are moved apart; the kernel sees the tubes only."""
    robot.assembly(np.array(shift))


def loaded(start: Equilibrium, there: Loaded, asked: Asked) -> Equilibrium | None:
    """The stable equilibrium under a dead load: grown from `start`, which bears none, or a small change of it, which
    bears one."""
    robot, rotations, shift, load = there.robot, there.rotations, there.translations, there.load
    if not (load.has_energy and start.margin > 0):
        return None
    problem, turn = there.problem, rotations - start.rotations
    if start.load is None:
        word, close = "the load before, from none", not turn.any() and np.array_equal(start.translations, shift)
    else:
        word, close = "guess", small_motion(turn, shift - start.translations, float(start.arc_length[-1]))
    if not close:
        return None
    given = at_points(start, problem)
    margin = start.margin
    coarse: Found | None = None
    for refinement in range(LOADED_REFINEMENTS + 1):
        rules = loaded_rules(robot, shift, load, refinement)
        if coarse is not None:
            known = [coarse.points.point_rotation - problem.wound, coarse.points.point_curvature]
            table = problem.mesh.interpolated(np.concatenate(known, axis=1), rules.problem.torsion.arc_length)
            given, turn, margin = (table[:, : len(turn)], table[:, len(turn) :]), 0 * turn, coarse.margin
        problem, coarse = rules.problem, solve_loaded_compiled(rules, (rotations, turn), given, margin)
        if coarse is None:
            return None
        if not _too_coarse(coarse, problem, asked):
            d = replace(LOADED_DISCRETISATION, refinement=refinement)
            return answered(Loaded(robot, problem, rotations, shift, d), coarse, word, asked.began)
    return None


def _too_coarse(found: Found, problem: LoadedProblem, asked: Asked) -> bool:
    theta, tip, margin = found.errors
    error = float(largest_error(theta, tip, problem.torsion.assembly.total_length))
    return margin > asked.method.newton.margin_tolerance or error > asked.tolerance


def nearby(family: Family, guess: Equilibrium, t: float, asked: Asked) -> Equilibrium | None:
    """The stable equilibrium at t of a family on the branch of `guess`, a small change away; None as well close to a
    fold."""
    if family.load is not None:
        return loaded(guess, family.under_load(t), asked)
    rotations, translations = family.path.at(t)
    found = unloaded(family.path.robot, rotations, translations, guess, asked)
    return found if found is not None and found.margin > 0 else None


def along(family: Family, start: Milestone, asked: Asked | None = None) -> Iterator[Milestone]:
    """Equilibria after `start` as far as t = 1, or to where the kernel declines even short steps."""
    longest = family.path.largest_step()
    if longest < 1.0:
        longest *= 1 - 1e-9  # a round-off may make a step longer than the kernel takes
    here, step = start, longest
    if family.load is not None and start.pose.load is None and family.path.moves:
        # Where joints move, the kernel goes on from an equilibrium under a load, if it is zero.
        first = nearby(family, start.pose, start.t, asked or Asked())
        if first is None:
            return
        here = Milestone(start.t, first)
    while here.t < 1.0:
        t = 1.0 if here.t + step >= 1 - 1e-12 else here.t + step
        pose = nearby(family, here.pose, t, asked or Asked())
        if pose is not None:
            here, step = Milestone(t, pose), min(2 * step, longest)
            yield here
            continue
        step /= 2
        if step < longest * SHORTEST_COMPILED:
            return
