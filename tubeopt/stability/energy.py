"""Elastic energy as a function of two tip angles; its stationary points are the equilibria."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem, evaluate, on_centreline, tube_turn
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
    """Smallest elastic energy with the tips of two tubes fixed at given angles."""

    tubes: tuple[int, int]
    """Tubes with fixed tips, from 0."""
    first: Array
    """(N,) tip angles of the first of `tubes`, rad."""
    second: Array
    """(N,) tip angles of the second of `tubes`, rad."""
    energy: Array
    """(N, N) energy, J; row i at `first[i]`."""
    equilibria: tuple[Equilibrium, ...]
    """All equilibria at the joint values of the map: the stationary points."""


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
    """Energy as a function of the tip angles of two tubes at fixed joint values.

    All other unknowns (torsion inside, tips of other tubes) minimise the energy. Each minimisation starts from the
    minimum of the point before.

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
    equilibria = find_equilibria(robot, alpha, shift)
    tips = np.array([e.tip_rotations for e in equilibria])[:, list(tubes)]
    first, second = (np.linspace(low, high, samples) for low, high in _window(tips, window))
    tip_maps = [_tip_map(problem, tube) for tube in tubes]
    # Fixed is the elastic rotation; natural twist adds a known angle.
    ends = np.maximum(problem.assembly.end, 0.0)[list(tubes)]
    natural_twist = problem.assembly.twist_angle(ends)[[0, 1], list(tubes)]
    base = alpha[list(tubes)] + natural_twist
    energy = np.empty((samples, samples))
    row_start = np.zeros(problem.size)
    for i in range(samples):
        z = row_start
        for j in range(samples):
            minimum = _minimum_with_fixed_tips(problem, alpha, z, tip_maps, (first[i] - base[0], second[j] - base[1]))
            z, energy[i, j] = minimum.z, minimum.energy
            if j == 0:
                row_start = z
    return EnergyMap(tubes, first, second, energy, tuple(equilibria))


def _window(tips: Array, window: ArrayLike | None) -> Array:
    """(2, 2) ranges of two tip angles: the argument `window`, or ranges around `tips` (k, 2)."""
    if window is not None:
        ranges = finite_array("window", window, 2)
        if ranges.shape != (2, 2) or not np.isfinite(ranges).all() or not (ranges[:, 0] < ranges[:, 1]).all():
            raise InputError(f"window is {window!r}; it must be two ranges, (least, largest) tip angle in rad each")
        return ranges
    low, high = tips.min(0), tips.max(0)
    reach = np.maximum(0.6 * (high - low), np.radians(60))
    return np.column_stack([low - reach, high + reach])


class _TipMap(NamedTuple):
    """Tip angle of a tube: alpha + a . z + d zeta, with zeta a further coordinate of unit stiffness.

    (a, d) is the next row of the Cholesky factor of the compliance when the tube's end joins the collocation points.
    """

    a: Array
    """Row (U,) of the derivative of one tip angle by the unknowns."""
    d: float
    """Diagonal entry."""


def _tip_map(problem: ReducedProblem, tube: int) -> _TipMap:
    # theta(end) responds to the moment at a point by the compliance up to there, which the integral has exactly.
    turn = tube_turn(problem, tube, int(np.argmin(np.abs(problem.cuts - float(problem.assembly.end[tube])))))
    return _TipMap(turn.row, math.sqrt(max(turn.rest, 1e-30)))


class _FixedTips(NamedTuple):
    """Energy with both tips fixed, and its derivatives, at unknowns z."""

    z: Array
    energy: float
    gradient: Array
    hessian: Array


def _minimum_with_fixed_tips(
    problem: ReducedProblem,
    rotations: Array,
    z: Array,
    tip_maps: Sequence[_TipMap],
    twists: tuple[float, float],
) -> _FixedTips:
    """Minimum of the energy with both tips fixed at `twists` relative to their joints, from z (U,)."""

    def evaluated(z: Array) -> _FixedTips:
        state = evaluate(problem, rotations, z)
        energy, gradient, hessian = state.energy, state.gradient, state.hessian
        for (a, d), twist in zip(tip_maps, twists, strict=True):
            # zeta is determined by z: its energy zeta^2 / 2 is added.
            zeta = (twist - float(a @ z)) / d
            energy += zeta**2 / 2
            gradient = gradient - a * (zeta / d)
            hessian = hessian + np.outer(a, a) / d**2
        return _FixedTips(z, energy, gradient, hessian)

    return damped_newton(
        evaluated(z), lambda state, step: evaluated(state.z + step), lambda _, step: torsional_turn(problem, step)
    )[0]
