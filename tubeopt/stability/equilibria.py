"""Every equilibrium at given joint values, stable and unstable."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import qmc

from ..equilibrium import Equilibrium
from ..errors import SolveError, vector
from ..robots.assembly import Array
from ..robots.robot import Robot
from ..solution import DEFAULT_DISCRETISATION, Solution, reduced_problem, to_equilibrium
from ..solvers.newton import newton
from ..transcription.reduced import (
    Index,
    ReducedProblem,
    evaluate,
    margin,
    on_centreline,
    residual,
    to_unknowns,
)
from .shooting import profiles, relative, relative_joints, relative_slope, to_base

TURN = 2 * np.pi

FIRST_GRID = {1: 96, 2: 40}
"""Points per turn of the coarsest grid, by the number of relative tip angles."""

FINEST_GRID = {1: 6144, 2: 640}

RANDOM_STARTS = 4096
"""Starting points for four tubes and more."""

SIDES = (0.1, 0.2, 0.4)
"""How far to either side of a fold, rad of tip angle, a pair of equilibria is looked for."""

SAME = 1e-5
"""Equilibria whose rotations differ by less (rad) everywhere are one."""


def find_equilibria(robot: Robot, rotations: ArrayLike, translations: ArrayLike | None = None) -> list[Equilibrium]:
    """All equilibria at given joint values, the lowest energy first.

    For up to three tubes with curved parts in front of the plate the search is systematic: the joint rotations are
    computed for tip angles on a grid over one turn of each relative angle (the others follow by symmetry, see
    `stability.shooting`), every cell that may hold a solution is solved, and the grid is refined until the set no
    longer changes and its topological degree, the sum of (-1)^index, is 1, as it must be. For more tubes the starting
    points are a Sobol sequence, and the degree is the only check. For tubes off the centreline the search is that of
    the same tubes on it, and of folds nearby; each equilibrium is solved with the offsets, and the degree is theirs.

    Args:
        rotations, translations: (n,) rad and m; translations default to home. Rotations are not wrapped.

    Raises:
        InputError: wrong number of joint values, one that is not finite, a tube out of its actuator.
        SolveError: the degree of the set that was found is not 1: an equilibrium is missing, or the joint values are
            a fold.
    """
    alpha = vector("rotations", rotations, robot.n_tubes)
    home = robot.home_translations if translations is None else translations
    shift = tuple(vector("translations", home, robot.n_tubes).tolist())
    problem = reduced_problem(robot, shift, DEFAULT_DISCRETISATION)
    found = all_solutions(problem, alpha)
    equilibria = [to_equilibrium(robot, s, shift, ("newton", "search over tip angles", 0.0)) for s in found]
    return sorted(equilibria, key=lambda e: e.energy)


def all_solutions(problem: ReducedProblem, rotations: Array) -> list[Solution]:
    """All solutions of a reduced problem; raises SolveError where their degree is not 1.

    For tubes off the centreline see `_with_offsets`.
    """
    if problem.assembly.eccentric:
        return _with_offsets(problem, rotations)
    found, settled = _search(problem, rotations)
    if not settled:
        raise SolveError(_incomplete(len(found), degree(found)))
    return found


def _search(problem: ReducedProblem, rotations: Array) -> tuple[list[Solution], bool]:
    """Solutions from ever finer grids of tip angles, until no more are found and their degree is 1; whether so."""
    free = _coupled_tubes(problem)
    if len(free) < 2:
        return _solve(problem, rotations, rotations[None]), True
    found: list[Solution] = []
    for starts in _starts(problem, rotations, free):
        before = len(found)
        found = _merge([*found, *_solve(problem, rotations, starts)])
        if len(found) == before and degree(found) == 1:
            return found, True
    return found, False


def _with_offsets(problem: ReducedProblem, rotations: Array) -> list[Solution]:
    """All solutions for tubes off the centreline.

    The search is done on the centreline, where turning all joints turns the whole; each equilibrium is then solved with
    the offsets. These also move the folds, where a pair comes or goes: so there are starts too at tip angles that
    nearly bring the joints, on the centreline, to where they should be. How nearly, the residual tells that the
    solutions leave there.
    """
    centred = on_centreline(problem)
    free = _coupled_tubes(centred)
    found = _solve_from(problem, rotations, [s.result.state.theta for s in _search(centred, rotations)[0]])
    reach = 2 * max((_left(centred, rotations, s.result.state.theta) for s in found), default=0.0)
    for finer in (2, 4):
        if reach and len(free) - 1 in FIRST_GRID:
            tips = _almost(centred, rotations, free, finer * FIRST_GRID[len(free) - 1], reach)
            found = _merge([*found, *_solve_from(problem, rotations, profiles(centred, tips) if len(tips) else [])])
        if degree(found) == 1:
            return found
    raise SolveError(_incomplete(len(found), degree(found)))


def _left(problem: ReducedProblem, rotations: Array, theta: Array) -> float:
    """What rotations (N, n) leave in the equations of a problem, rad."""
    return residual(problem, evaluate(problem, rotations, to_unknowns(problem, rotations, theta)))


def _incomplete(count: int, degree: int) -> str:
    why = f"of degree {degree} instead of 1" if degree != 1 else "more of them on every finer grid"
    return f"{count} equilibria were found, {why}: one is missing, or the joint values are at a fold, where two are one"


def _solve_from(problem: ReducedProblem, rotations: Array, profiles: Iterable[Array]) -> list[Solution]:
    """Newton on the collocation equations from rotations (N, n) at their points, one after the other."""
    out = []
    for theta in profiles:
        result = newton(problem, rotations, to_unknowns(problem, rotations, theta))
        if result.converged:
            out.append(Solution(problem, rotations, result, margin(problem, result.state)))
    return _merge(out)


def degree(solutions: list[Solution]) -> int:
    """Topological degree, the sum of the signs of the Jacobians' determinants, (-1)^index on the centreline.

    It is 1 for a complete set, since the equations deform into those without coupling.
    """
    return int(sum(np.linalg.slogdet(s.result.state.hessian)[0] for s in solutions))


def _coupled_tubes(problem: ReducedProblem) -> Index:
    """Tubes whose rotation is coupled to that of another one."""
    return np.unique(problem.tube)


def _starts(problem: ReducedProblem, rotations: Array, free: Index) -> Iterator[Array]:
    """Tip angles (B, n) from which to solve, from ever finer grids."""
    dimension = len(free) - 1
    if dimension in FIRST_GRID:
        size = FIRST_GRID[dimension]
        while size <= FINEST_GRID[dimension]:
            yield _candidates(problem, rotations, free, size)
            size *= 2
        return
    for power in range(int(np.log2(RANDOM_STARTS)) - 2, int(np.log2(RANDOM_STARTS)) + 3):
        unit = qmc.Sobol(dimension, rng=power).random_base2(power)
        tips = np.tile(rotations, (len(unit), 1))
        tips[:, free[:-1]] = unit * TURN
        yield _shoot(problem, rotations, free, tips)


def _candidates(problem: ReducedProblem, rotations: Array, free: Index, size: int) -> Array:
    """Tip angles of every cell of a grid that may hold a solution, after a few Newton steps."""
    return _shoot(problem, rotations, free, _cells(problem, rotations, free, size, 0.0))


def _cells(problem: ReducedProblem, rotations: Array, free: Index, size: int, reach: float) -> Array:
    """Tip angles in the middle of every cell of a grid that may bring the joints within `reach` (rad) of where they
    should be."""
    dimension = len(free) - 1
    axis = np.arange(size) * TURN / size
    mesh = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), axis=-1)
    tips = np.tile(rotations, (size**dimension, 1))
    tips[:, free] = 0.0
    tips[:, free[:-1]] = mesh.reshape(-1, dimension)
    turned = relative_joints(problem, free, tips).reshape(*mesh.shape)
    # What is left to the wanted relative rotations: continuous along the grid, in turns.
    gap = (turned - relative(rotations[None], free)[0]) / TURN
    corners = np.stack([_corner(gap, offset) for offset in itertools.product((0, 1), repeat=dimension)])
    low, high = corners.min(0), corners.max(0)
    # A cell is a candidate if in every component some whole number of turns lies in its range, widened by half of
    # it, since the function bends inside the cell.
    slack = (high - low) / 2 + reach / TURN + 1e-9
    hit = (np.floor(high + slack) >= np.ceil(low - slack)).all(-1)
    cells = np.argwhere(hit)
    start = np.tile(rotations, (len(cells), 1))
    start[:, free] = 0.0
    start[:, free[:-1]] = (cells + 0.5) * TURN / size
    return start


def _almost(problem: ReducedProblem, rotations: Array, free: Index, size: int, reach: float) -> Array:
    """Tip angles to either side of those that bring the joints within `reach` (rad) of where they should be, but not
    there: of folds nearby."""
    tips = _cells(problem, rotations, free, size, reach)
    for _ in range(12):
        if not len(tips):
            return tips
        gap, slope = _gap(problem, rotations, free, tips), relative_slope(problem, free, tips)
        # Levenberg's steps come to rest where the joints come closest.
        square = slope @ slope.swapaxes(1, 2) + reach**2 * np.eye(len(free) - 1)
        _move(tips, free, -(slope.swapaxes(1, 2) @ np.linalg.solve(square, gap[:, :, None]))[:, :, 0])
    gap = np.abs(_gap(problem, rotations, free, tips)).max(1)
    tips = tips[(gap > 1e-6) & (gap < reach)]
    tips = tips[np.unique(np.round(tips[:, free] / SIDES[0]), axis=0, return_index=True)[1]]
    if not len(tips):
        return np.asarray(tips)
    soft = np.linalg.svd(relative_slope(problem, free, tips))[2][:, -1]
    sides = np.concatenate([tips] * 2 * len(SIDES))
    sides[:, free[:-1]] += np.concatenate([sign * side * soft for side in SIDES for sign in (-1, 1)])
    return _unwound(problem, rotations, free, sides, np.inf)


def _move(tips: Array, free: Index, step: NDArray[np.floating[Any]]) -> None:
    """A step of the relative tip angles, held to a fraction of a turn: from a steep place it may leave for anywhere."""
    size = np.abs(step).max(1)
    tips[:, free[:-1]] += step * np.minimum(1.0, 0.5 / np.maximum(size, 1e-12))[:, None]


def _corner(gap: Array, offset: tuple[int, ...]) -> Array:
    """The grid shifted by one cell in some directions, continued past a turn."""
    out = gap
    for axis, step in enumerate(offset):
        if step:
            out = np.roll(out, -1, axis=axis)
            # One turn of a tip turns its own joint by one.
            out.swapaxes(0, axis)[-1, ..., axis] += 1.0
    return out


def _shoot(problem: ReducedProblem, rotations: Array, free: Index, tips: Array) -> Array:
    """Newton steps on the relative tip angles; then tip angles, unwound, whose joints are as wanted. Drops what does
    not get close."""
    for _ in range(8):
        if not len(tips):
            return tips
        gap = _gap(problem, rotations, free, tips)
        slope = relative_slope(problem, free, tips)
        _move(tips, free, np.linalg.solve(slope + 1e-12 * np.eye(len(free) - 1), -gap[:, :, None])[:, :, 0])
    return _unwound(problem, rotations, free, tips, 1e-2)


def _gap(problem: ReducedProblem, rotations: Array, free: Index, tips: Array) -> Array:
    """(B, d) how far the relative joint rotations are from where they should be, up to whole turns."""
    gap = relative_joints(problem, free, tips) - relative(rotations[None], free)
    return np.asarray(gap - TURN * np.round(gap / TURN))


def _unwound(problem: ReducedProblem, rotations: Array, free: Index, tips: Array, close: float) -> Array:
    """Tip angles whose joints are `close` (rad) to where they should be, without whole turns and without doubles."""
    base = to_base(problem, tips)
    gap = relative(base, free) - relative(rotations[None], free)
    turns = np.round(gap / TURN)
    kept = np.abs(gap - TURN * turns).max(1) < close
    tips, base, turns = tips[kept], base[kept], turns[kept]
    tips[:, free[:-1]] -= TURN * turns
    base[:, free[:-1]] -= TURN * turns
    # Turn everything so that the outermost joint is where it should be.
    tips[:, free] += (rotations[free[-1]] - base[:, free[-1]])[:, None]
    keys = np.round(tips[:, free] / 1e-4).astype(np.int64)
    return np.asarray(tips[np.unique(keys, axis=0, return_index=True)[1]])


def _solve(problem: ReducedProblem, rotations: Array, tips: Array) -> list[Solution]:
    """Newton on the collocation equations from each set of tip angles."""
    return _solve_from(problem, rotations, profiles(problem, tips)) if len(tips) else []


def _merge(solutions: list[Solution]) -> list[Solution]:
    """Solutions without doubles."""
    out: list[Solution] = []
    for candidate in solutions:
        theta = candidate.result.state.theta
        if all(np.abs(theta - kept.result.state.theta).max(initial=0.0) > SAME for kept in out):
            out.append(candidate)
    return out
