"""The least margin of tubes off the centreline that search finds: over the rotations of each segment's tips."""

from __future__ import annotations

import numpy as np
import scipy

from ..block.transcription.buffered import mapped
from ..block.transcription.march import march_function
from ..block.transcription.offset_margin import softenings
from ..block.transcription.reduced import ReducedProblem, to_unknowns
from ..block.transcription.second_variation import margin
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import DEFAULT_DISCRETISATION, Solution, reduced_problem, to_equilibrium
from ..errors import SolveError
from ..robots.robot import Robot
from ..solvers.newton import newton
from ..solvers.sampling import sobol
from ..typing import Array, Index
from .eccentric_certificate import Untwisted, segments_of, softest_untwisted
from .settings import SnapSearch

STEPS = 4
"""Steps of Runge and Kutta's method per interval between collocation points."""


def least_margin(robot: Robot, shift: tuple[float, ...], effort: SnapSearch) -> tuple[Equilibrium, int]:
    """The equilibrium with the least margin that was found, and the number of local searches.

    Every segment is searched for itself: tips of its own tubes over a turn each, those of the others as in its softest
    untwisted shape, from which one local search begins.

    Raises:
        SolveError: the equilibrium that was found cannot be solved again, at a fold.
    """
    problem = reduced_problem(robot, shift, DEFAULT_DISCRETISATION)
    best, tips, searches = np.inf, np.zeros(robot.n_tubes), 0
    for base, tubes in _places(problem):
        unit = sobol(len(tubes), effort.segment_samples)
        samples = np.repeat(base[None], len(unit), axis=0)
        samples[:, tubes] = 2 * np.pi * unit
        values = [_margin(problem, theta) for theta in shoot(problem, samples)[1]]
        for start in (base, samples[int(np.argmin(values))]):
            found = scipy.optimize.minimize(
                lambda own, base=base, tubes=tubes: _margin(problem, shoot(problem, _with(base, tubes, own))[1][0]),
                start[tubes],
                method="Nelder-Mead",
                options={"xatol": 1e-6, "fatol": 1e-10},
            )
            searches += 1
            if found.fun < best:
                best, tips = float(found.fun), _with(base, tubes, found.x)[0]
    rotations, theta = (part[0] for part in shoot(problem, tips[None]))
    result = newton(problem, rotations, to_unknowns(problem, rotations, theta))
    if not result.converged:
        raise SolveError("the worst equilibrium found is a fold (margin 0), which Newton cannot solve again")
    solution = Solution(problem, rotations, result, margin(problem, result.state))
    return to_equilibrium(robot, solution, shift, ("newton", "search for the least margin", 0.0)), searches


def untwisted_tips(n: int, shape: Untwisted, bends: Array) -> tuple[Array, int]:
    """(n,) rotations of an untwisted shape, and its odd tube: one tube of the segment against the two others, the tubes
    of all other segments curving to one side. bends (n,): signs of the precurvatures."""
    tips = np.where(bends < 0, np.pi, 0.0) + shape.outer_direction
    tips[list(shape.segment.tubes)] += shape.direction - shape.outer_direction
    odd = shape.segment.tubes[2]
    tips[odd] += np.pi
    return tips, odd


def _places(problem: ReducedProblem) -> list[tuple[Array, Index]]:
    """Where to search: tips (n,) to begin at, and the tubes that turn."""
    assembly = problem.assembly
    segments = segments_of(assembly)
    if segments is None:
        curved = np.flatnonzero(assembly.curved.any(0))
        return [(np.zeros(assembly.n_tubes), curved)] if len(curved) else []
    bends = np.sign(assembly.curvature)
    return [
        (untwisted_tips(assembly.n_tubes, softest_untwisted(segment), bends)[0], np.array(segment.tubes))
        for segment in segments
    ]


def _with(base: Array, tubes: Index, own: Array) -> Array:
    tips = base.copy()
    tips[tubes] = own
    return tips[None]


def _margin(problem: ReducedProblem, theta: Array) -> float:
    return 1.0 - float(softenings(problem, theta).max(initial=0.0))


def shoot(problem: ReducedProblem, tips: Array) -> tuple[Array, Array]:
    """Joint rotations (B, n) and theta (B, N, n) at the collocation points of the equilibria with tip angles (B, n)."""
    mesh, assembly = problem.mesh, problem.assembly
    count, n = tips.shape
    nodes, degree = mesh.tableau.nodes, mesh.tableau.degree
    lengths = np.repeat(-np.diff([1.0, *nodes[::-1], 0.0]) / STEPS, STEPS)
    march = mapped(march_function(n, True, False, len(lengths)), count)
    theta, twist, at = tips, np.zeros_like(tips), len(problem.weight)
    out = np.empty((count, at, n))
    for p in range(len(mesh.length) - 1, -1, -1):
        if not mesh.collocated[p]:
            theta = theta - mesh.length[p] * twist
            continue
        tubes = assembly.torsional_stiffness, problem.piece_stiffness[p], problem.piece_moment[p]
        place = assembly.offset, assembly.offset_angle
        ends = march(theta, twist, 0.0, mesh.length[p] * lengths, *tubes, *place)
        theta, twist, values = ends[0].copy(), ends[1].copy(), ends[3].reshape(count, -1, n)
        at -= degree
        out[:, at : at + degree] = values[:, STEPS : STEPS * (degree + 1) : STEPS][:, ::-1]
    return theta - assembly.transmission * twist, out
