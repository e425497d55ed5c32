"""All equilibria of a robot under a load: a search whose result is counted.

The equations are x - f(x) = 0 in whitened rotations and bending. What tubes and load make of them, f, is bounded: by
moments of precurvature, forces times the length of the arm, and moments, whether there is an energy or not. So no
equilibrium of x - s f(x), 0 <= s <= 1, is farther away than the bound, and the degree is that of x, 1: the signs of the
determinants add up to 1 over all equilibria. Where there is an energy, they are (-1)^index.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import scipy

from ..equilibrium.answer import sample_rotation, to_equilibrium
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.loaded import Loaded, LoadedPoint
from ..equilibrium.member import Member, Place, Point
from ..equilibrium.problem import check_load
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..robots.load import Load
from ..robots.robot import Robot
from ..typing import Array
from .certificate import snap_free_certificate
from .folds import NUDGE, slide
from .settings import DEFAULT_EQUILIBRIA_SEARCH, EquilibriaSearch


def loaded_equilibria(
    robot: Robot,
    rotations: Array,
    translations: tuple[float, ...],
    load: Load,
    plain: list[Equilibrium],
    search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH,
) -> list[Equilibrium]:
    """All equilibria under a load, lowest potential energy first, without an energy largest margin first; `plain` are
    those without load.

    Newton's method starts at every equilibrium without load and at twisted and bent arms from a Sobol sequence, twice
    as many in every round. From every unstable equilibrium that was found the robot falls. The search ends where a
    round finds nothing new and the degree is 1; where there is an energy, one of them is stable, too.
    """
    check_load(robot, load, translations)
    member = Loaded.of(robot, rotations, translations, load)
    bounded, force = load.tip_force_only, float(np.linalg.norm(load.force))
    if bounded and snap_free_certificate(robot, translations, max_force=force) > search.certain:
        return [forward_kinematics(robot, rotations, translations, load=load)]
    found: list[LoadedPoint] = []
    explored: set[int] = set()
    for equilibrium in plain:
        theta = sample_rotation(equilibrium, member.problem.torsion.arc_length)
        add(found, member, member.unknowns(theta), search.same)
    sequence, count = scipy.stats.qmc.Sobol(robot.n_tubes + 4, seed=0), search.loaded_starts
    while count <= search.most_loaded_starts:
        starts = _starts(member, sequence.random(count), search.largest_twist)
        new = sum(add(found, member, x, search.same) for x in starts)
        new += _descend(found, member, explored, search.same)
        # Where there is a least energy, a set without a stable equilibrium is not all.
        if not new and degree(found) == 1 and (not member.descends or any(point.margin > 0 for point in found)):
            points = sorted(found, key=lambda point: point.state.potential if member.descends else -point.margin)
            return [to_equilibrium(point, "search from many starts") for point in points]
        count *= 2
    raise SolveError(
        f"{len(found)} equilibria were found with degree {degree(found)} instead of 1: one "
        "is missing, or joint values and load are at a fold"
    )


def _starts(member: Loaded, samples: Array, twist: float) -> list[Array]:
    """Unknowns of arms whose tubes are twisted and which are bent linearly in arc length."""
    problem, n, load = member.problem, len(member.rotations), member.problem.load
    torsion = problem.torsion
    length = torsion.assembly.total_length
    s = torsion.arc_length[:, None] / length
    stiffness = torsion.stiffness.sum(1)
    push = np.linalg.norm(problem.force, axis=1) + np.linalg.norm(load.force) * (load.frame == "tip")
    couple = 0.0 if problem.couples is None else np.linalg.norm(problem.couples.moment, axis=1).sum()
    most = np.minimum(2 * np.sqrt(push / stiffness), push * length / stiffness)[:, None]
    most += (couple / stiffness)[:, None]
    twist += couple * problem.tip_lever
    starts = []
    for sample in 2 * samples - 1:
        x = member.unknowns(member.rotations + twist * sample[:n] * s)
        bent = 2 * most * (sample[n : n + 2] * (1 - s) + sample[n + 2 :] * s)
        x[torsion.size :] = (bent / problem.softness[:, None]).ravel()
        starts.append(x)
    return starts


def add(found: list[Any], member: Member[Any], x: Array, same: float) -> bool:
    """Solve from x; whether that is an equilibrium which was not known."""
    result = member.solve(x, iterations=30)
    if not result.converged:
        return False
    if any(member.turn(result.state, result.state.x - known.state.x) < same for known in found):
        return False
    found.append(Point.of(member, result, 1.0))
    return True


def _descend(found: list[LoadedPoint], member: Loaded, explored: set[int], same: float) -> int:
    """Fall from unstable equilibria to both sides of their unstable directions; how many new ones that finds. Where one
    goes that flutters is not known."""
    new = 0
    for k, point in enumerate(list(found)):
        if k in explored or point.margin >= 0:
            continue
        explored.add(k)
        values, vectors = (np.linalg.eigh if member.descends else np.linalg.eig)(point.state.hessian)
        for direction in vectors.real.T[(values.real < 0) & (values.imag == 0)]:
            push = NUDGE / member.turn(point.state, direction) * direction
            for side in (push, -push):
                landed = slide(member, point.state.x + side)
                new += landed.converged and add(found, member, landed.state.x, same)
    return new


def degree(found: Iterable[Place]) -> int:
    """Topological degree, the sum of the signs of the Jacobians' determinants, (-1)^index where there is an energy.

    It is 1 for a complete set, since the equations deform into those without coupling.
    """
    return int(sum(np.linalg.slogdet(each.state.hessian)[0] for each in found))
