"""Elastic energy over two tip angles: its stationary points are the equilibria."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem, evaluate, on_centreline, row_of
from ..display import Displayed
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from ..equilibrium.result import Equilibrium
from ..errors import InputError, finite_array
from ..robots.robot import Robot, joint_values
from ..solvers.blas import small
from ..solvers.newton import damped_newton, torsional_turn
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array
from .equilibria import find_equilibria


@dataclass(frozen=True, eq=False)
class EnergyMap(Displayed):
    """Least elastic energy with the tips of two tubes held at given angles; its stationary points are equilibria."""

    tubes: tuple[int, int]
    """Tubes of the two axes, from 0; their tips are fixed."""
    first: Array
    """(N,) tip angles of the first of `tubes`, rad."""
    second: Array
    """(N,) of the second."""
    energy: Array
    """(N, N), rows by `first`, J."""
    equilibria: tuple[Equilibrium, ...]
    """All equilibria."""


@typed
@small
@limited
def energy_map(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    tubes: tuple[int, int] = (0, 1),
    samples: int = 61,
    window: ArrayLike | None = None,
    time_limit: float = TIME_LIMIT,
) -> EnergyMap:
    """Energy over the tip angles of two tubes at given joint values.

    All other unknowns (torsion inside, tips of other tubes) minimise the energy; the minimum is followed from point to
    point.

    Args:
        tubes: the two tubes with fixed tips, from 0.   samples: points per axis.
        window: (2, 2) smallest and largest tip angle of each tube, rad; by default around all equilibria.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of joint values; tubes that are the same, do not exist, or have no coupled part; a
            window that is not two ranges.
        SolveError: the equilibria at these joint values are not complete.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> tubeopt.energy_map(robot, [1.0, 0.0], samples=11).energy.shape
        (11, 11)
    """
    alpha, shift = joint_values(robot, rotations, translations)
    problem = on_centreline(reduced_problem(robot, tuple(shift.tolist()), DEFAULT_DISCRETISATION))
    for tube in tubes:
        if tube not in problem.tube:
            raise InputError(f"tubes is {tubes}; each must be a tube, from 0, that is coupled to another one")
    if tubes[0] == tubes[1]:
        raise InputError(f"tubes is {tubes}; they must be two different tubes")
    result = find_equilibria(robot, alpha, shift)
    tips = np.array([e.tip_rotations for e in result])[:, list(tubes)]
    first, second = (np.linspace(low, high, samples) for low, high in _window(tips, window))
    holds = [_hold(problem, tube) for tube in tubes]
    # Held is the elastic rotation; what natural twist adds to it is known.
    ends = np.maximum(problem.assembly.end, 0.0)[list(tubes)]
    wound = problem.assembly.wound(ends)[[0, 1], list(tubes)]
    base = alpha[list(tubes)] + wound
    energy = np.empty((samples, samples))
    row = np.zeros(problem.size)
    for i in range(samples):
        z = row
        for j in range(samples):
            z, energy[i, j] = _held_minimum(problem, alpha, z, holds, (first[i] - base[0], second[j] - base[1]))
            if j == 0:
                row = z
    return EnergyMap(tubes, first, second, energy, tuple(result))


def _window(tips: Array, window: ArrayLike | None) -> Array:
    """(2, 2) ranges of two tip angles: as given, or around `tips` (k, 2)."""
    if window is not None:
        ranges = finite_array("window", window, 2)
        if ranges.shape != (2, 2) or not np.isfinite(ranges).all() or not (ranges[:, 0] < ranges[:, 1]).all():
            raise InputError(f"window is {window!r}; it must be two ranges, (least, largest) tip angle in rad each")
        return ranges
    low, high = tips.min(0), tips.max(0)
    reach = np.maximum(0.6 * (high - low), np.radians(60))
    return np.column_stack([low - reach, high + reach])


def _hold(problem: ReducedProblem, tube: int) -> tuple[Array, float]:
    """The tip angle of a tube given z: alpha + a . z + d zeta, with zeta a further coordinate of unit stiffness.

    (a, d) is the next row of the Cholesky factor when the tube's end joins the collocation points.
    """
    # theta(end) responds to the moment at a point by how soft the tube is up to there, which the integral has exactly.
    inside, ends = problem.softness
    places = np.append(problem.mesh.start, problem.assembly.total_length)
    whole = ends[int(np.abs(places - problem.assembly.end[tube]).argmin()), tube]
    a = row_of(problem, tube, inside[:, tube])
    return a, float(np.sqrt(max(whole - a @ a, 1e-30)))


class _Held(NamedTuple):
    """Unknowns, and the energy with both tips held."""

    z: Array
    energy: float
    gradient: Array
    hessian: Array


def _held_minimum(
    problem: ReducedProblem,
    rotations: Array,
    z: Array,
    holds: Sequence[tuple[Array, float]],
    twists: tuple[float, float],
) -> tuple[Array, float]:
    """Where the energy is least with both tips held, z (U,), and that energy."""

    def held(at: Array) -> _Held:
        state = evaluate(problem, rotations, at)
        energy, gradient, hessian = state.energy, state.gradient, state.hessian
        for (a, d), twist in zip(holds, twists, strict=True):
            zeta = (twist - float(a @ at)) / d
            energy += zeta**2 / 2
            gradient = gradient - a * (zeta / d)
            hessian = hessian + np.outer(a, a) / d**2
        return _Held(at, energy, gradient, hessian)

    end = damped_newton(held(z), lambda here, step: held(here.z + step), lambda _, step: torsional_turn(problem, step))[
        0
    ]
    return end.z, end.energy
