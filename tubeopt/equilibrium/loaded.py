"""Equilibria under a load by the compiled kernel, and what a wrench does to an equilibrium."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..block.transcription.arm import Found, arc_lengths
from ..block.transcription.collocated import STEPS
from ..block.transcription.loaded import LoadedProblem, base_wrench, compliance
from ..block.transcription.loaded_arm import compliance_along
from ..errors import InputError, finite
from ..robots.load import Load, PointLoad
from ..robots.order import SAME_END, twisted_tube
from ..robots.robot import Robot
from ..solvers.compiled.binding import solve_compiled, solve_many_compiled
from ..solvers.compiled.loaded import solve_loaded_compiled, solve_many_loaded_compiled
from ..solvers.settings import NEWTON, Newton
from ..typing import Array, Mask
from .answer import answered, at_points, point_of
from .continuation import small_motion
from .load_problem import LOADED_DISCRETISATION, check_load, loaded_rules
from .member import Loaded, LoadedPoint, Point, interpolate
from .result import Equilibrium
from .solving import sample_arms, sample_rotation


def compiled(start: Equilibrium, there: Loaded, tolerance: float, began: float, settings: Newton) -> Equilibrium | None:
    """The stable equilibrium under a dead load by the compiled kernel: grown from `start`, which bears none, or a small
    change of it, which bears one; None where the kernel declines, or no mesh is fine enough."""
    robot, rotations, shift, load = there.robot, there.rotations, there.translations, there.load
    if not (load.has_energy and start.margin > 0):
        return None
    problem, turn = there.problem, rotations - start.rotations
    given: tuple[Array, Array | None]
    if start.load is None:
        if turn.any() or not np.array_equal(start.translations, shift):
            return None
        given, word = (sample_rotation(start, problem.torsion.arc_length), None), "the load before, from none"
    elif small_motion(turn, shift - start.translations, float(start.arc_length[-1])):
        given, word = at_points(start, problem), "guess"
    else:
        return None
    found = solve_loaded_compiled(loaded_rules(robot, shift, load), (rotations, turn), given, start.margin)
    refinement = 0
    while found is not None and _too_coarse(found, problem, tolerance, settings):
        refinement += 1
        if refinement > settings.loaded_refinements:
            return None
        coarse, rules = problem, loaded_rules(robot, shift, load, refinement)
        problem, points = rules.problem, found.points
        known = [points.point_rotation - coarse.wound, points.point_curvature]
        table = interpolate(coarse, np.concatenate(known, axis=1), problem)
        given = table[:, : len(turn)], table[:, len(turn) :]
        found = solve_loaded_compiled(rules, (rotations, 0 * turn), given, found.margin)
    if found is None:
        return None
    d = replace(LOADED_DISCRETISATION, refinement=refinement)
    return answered(Loaded(robot, problem, rotations, shift, d), found, word, began)


def grow_many(
    robot: Robot, rotations: Array, translations: Array, load: Load, tolerance: float
) -> tuple[Array, Array, Mask] | None:
    """Equilibria at rotations (M, n) and translations (n,) under a load, by the compiled kernels.

    Rows of tip position (3), tip frame (9), tip rotations (n), margin, residual, errors of theta and tip, energy; the
    compliances (M, 6, 6); and (M,) which are fine: grown from an equilibrium without load, and on a mesh fine enough.
    None where there is no kernel for them.
    """
    shift = tuple(translations.tolist())
    check_load(robot, load, shift)
    first = solve_compiled(robot, rotations[0], translations) if load.has_energy else None
    if first is None:
        return None
    s = first["arc_length"][: int(first["pieces"]) * STEPS + 1].copy()
    arms = np.zeros((len(rotations), 2, len(s), robot.n_tubes))
    unloaded = solve_many_compiled(robot, rotations, np.tile(translations, (len(rotations), 1)), arms)
    assert unloaded is not None
    rules = loaded_rules(robot, shift, load)
    problem, n = rules.problem, robot.n_tubes
    length = problem.torsion.assembly.total_length
    theta = sample_arms(robot, translations, s, arms, problem.torsion.arc_length)
    ends = np.searchsorted(arc_lengths(problem.mesh), np.maximum(problem.torsion.assembly.end, 0.0) - 1e-12)
    found = solve_many_loaded_compiled(rules, rotations, (theta, unloaded[0][:, n + 12]), ends.astype(np.int64))
    if found is None:
        return None
    table, compliance, declined = found
    coarse = np.maximum(table[:, n + 14], table[:, n + 15] / length) > tolerance
    return table[:, :-1], compliance, ~(unloaded[1] | declined | coarse | (table[:, -1] > NEWTON.margin_tolerance))


def _too_coarse(found: Found, problem: LoadedProblem, tolerance: float, settings: Newton) -> bool:
    theta, tip, margin = found.errors
    return margin > settings.margin_tolerance or max(theta, tip / problem.torsion.assembly.total_length) > tolerance


def compliance_of(equilibrium: Equilibrium) -> Array:
    """(6, 6) change of the tip by a small dead wrench there; see `Equilibrium.compliance`."""
    point = point_of(equilibrium, Load())
    return compliance(point.member.problem, point.state)


def compliance_at(equilibrium: Equilibrium, arc_length: float, tube: int | None) -> Array:
    """(6, 6) change of a place of the arm by a small dead wrench there; see `Equilibrium.compliance_at`."""
    if equilibrium.load is not None and not equilibrium.load.has_energy:
        raise InputError("the load has a moment or turns with the tip; compliance is then told at the tip only")
    point = point_of(equilibrium, Load())
    assembly, length = point.member.problem.torsion.assembly, float(equilibrium.arc_length[-1])
    if not 0 <= finite("arc_length", arc_length) <= length * (1 + 1e-12):
        raise InputError(f"arc_length is {arc_length:g} m; it must be on the arm, between 0 and {length:g} m")
    here = np.flatnonzero(assembly.end >= arc_length - SAME_END)
    chosen = twisted_tube(assembly.end, arc_length) if tube is None else tube
    if chosen not in here:
        raise InputError(f"tube is {tube}; tubes {', '.join(map(str, here))} are at {arc_length:g} m")
    # Where a wrench acts the curvature jumps: elements end there.
    load = equilibrium.load or Load()
    cut = replace(load, points=(*load.points, PointLoad(min(arc_length, length))))
    there = Loaded.of(equilibrium.robot, point.member.rotations, point.member.translations, cut)
    failure = "the equilibrium is a fold (margin 0), where the compliance is infinite"
    found: LoadedPoint = Point.near(there, there.carried(point), failure)
    return compliance_along(there.problem, found.state, min(arc_length, length), chosen)


def base_wrench_of(equilibrium: Equilibrium) -> Array:
    """(6,) what the load puts on the plate; see `Equilibrium.base_wrench`."""
    if equilibrium.load is None:
        return np.zeros(6)
    point = point_of(equilibrium)
    return base_wrench(point.member.problem, point.state)
