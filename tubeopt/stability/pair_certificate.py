"""The least margin of two coupled tubes over all rotations, with a bound that proves it, whatever they are like along.

Two tubes have one equilibrium for every difference x of their tip angles, and every equilibrium is one of these: from
the tip, where nothing twists, the difference D(s) of their elastic rotations obeys

    D(s) = x + int_s sigma int c sin(D + psi),
    sigma = 1 / kt_1 + 1 / kt_2,  c = m_1 m_2 / sum kb,  psi = psi_1 - psi_2,

psi_i being the direction of the bend in the tube. So the least margin is the least of a function mu(x) of one angle.
Where D + psi can stay pi all along, as with planar tubes bent to the same sides, that is the certificate of all pairs
at their worst. Where it cannot, as with an S in a plain tube, or helices of unequal twist, it is more.

Above 0 it excludes every snap: the rotations at the plate grow with x, since their derivative changes its sign where a
margin is 0 and nowhere else, so that every joint value has one x. Below 0 there is a fold: some equilibrium has the
least energy, and a margin that is not below 0, and between the two mu(x) crosses 0.

mu(x) is the least over deflections y of Rayleigh quotients f(y, x), whose second derivatives by x are at most

    M = max_y  int |c| hypot(P^2, S) y^2 / T(y),     |D_x| <= P,  |D_xx| <= S,

P and S being the solutions of the linear equations with |c| in place of c cos(D + psi) and c sin(D + psi). So no f is
below its chord by more than M h^2 / 8 on an interval of length h, and mu(x) not below the lesser of its values at the
ends by more than that. Intervals are halved where this bound is below the least value that was found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.buffered import mapped
from ..block.transcription.green import ahead
from ..block.transcription.reduced import ReducedProblem
from ..physics.certificate import bend_rate_function
from ..typing import Array

TOLERANCE = 1e-7
"""How far the bound may be below the least margin that was found, as a fraction of 1 less that."""

FIRST, MOST = 32, 20000
"""Intervals to begin with, and tip angles to look at; the bound holds wherever one stops."""

SWEEPS, POLISHING = 60, 12
"""Fixed-point sweeps of the collocated equations at most, and Newton steps after them."""

SETTLED = 1e-12
"""Change (rad) at which they are solved."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Two coupled tubes at N collocation points.

    tubes: which.  coupling: (N,) weight times c, J.  lag: (N,) psi, rad.  reach: (N, N) from which c sin(D + psi) turns
    D how far, 1/J.  root: (N, N) lower triangular root of the compliance of both tubes together.
    """

    problem: ReducedProblem
    tubes: tuple[int, int]
    coupling: Array
    lag: Array
    reach: Array
    root: Array


@dataclass(frozen=True, eq=False)
class Least:
    """The least margin over all rotations. bound: proved.  margin: found, at `tip` (rad, the difference of tip angles).
    opposition: (N,) cos(D + psi) there at the points, which takes from the margin where it is negative."""

    bound: float
    margin: float
    tip: float
    opposition: Array


def pair_of(problem: ReducedProblem) -> Pair | None:
    """The two tubes of a problem that are coupled; None where there are more, or fewer, or none is made of pieces."""
    coupled = np.unique(problem.tube)
    if len(coupled) != 2 or not problem.assembly.general:
        return None
    i, j = (int(tube) for tube in coupled)
    compliance = sum(problem.factor[part, part] @ problem.factor[part, part].T for part in problem.by_tube)
    lever = ahead(problem.mesh, problem.here)
    # The precurvature of a piece is a size at a phase, so that no moment is below 0.
    rate = mapped(bend_rate_function(problem.assembly.n_tubes), len(problem.weight))(problem.stiffness, problem.moment)[
        0
    ]
    return Pair(
        problem=problem,
        tubes=(i, j),
        coupling=problem.weight * rate[:, i] * problem.moment[:, j],
        lag=problem.phase[:, i] - problem.phase[:, j],
        reach=lever[:, i] + lever[:, j] - compliance,
        root=np.asarray(np.linalg.cholesky(compliance), dtype=float),
    )


def _differences(pair: Pair, tips: Array) -> Array:
    """(B, N) D + psi at differences of tip angles (B,)."""
    return _settled(pair, tips, tips[:, None] + pair.lag)


def _settled(pair: Pair, tips: Array, d: Array) -> Array:
    """(B, N) D + psi on the collocated equations, from some guess.

    The differences at a place follow from those nearer to the tip alone (an equation of Volterra), so that putting them
    in again and again converges from anywhere, k times about as the k-th term of a cosine. What strong tubes on long
    pieces leave of it after SWEEPS is for Newton's method.
    """
    turn = pair.reach * pair.coupling
    free = tips[:, None] + pair.lag
    for _ in range(SWEEPS):
        before, d = d, free + np.sin(d) @ turn.T
        if np.abs(d - before).max(initial=0.0) < SETTLED:
            return np.asarray(d)
    for _ in range(POLISHING):
        slope = np.eye(len(turn)) - turn * np.cos(d)[:, None, :]
        step = np.linalg.solve(slope, (free + np.sin(d) @ turn.T - d)[..., None])[..., 0]
        d = d + step
        if np.abs(step).max(initial=0.0) < SETTLED:
            break
    return np.asarray(d)


def margins(pair: Pair, tips: Array) -> Array:
    """(B,) mu(x), not capped at 1."""
    return _margins(pair, np.cos(_differences(pair, tips)))


def _margins(pair: Pair, cosines: Array) -> Array:
    second = pair.root.T @ ((pair.coupling * cosines)[..., None] * pair.root)
    return np.asarray(1 + np.linalg.eigvalsh(second)[:, 0])


def farthest_fold(pair: Pair) -> float:
    """A turn of the first tube against the second (rad) on which a snap is met from any stable equilibrium, if there is
    any: the joints turn by a whole turn while the tips do, and are ahead of them by an amount that repeats."""
    problem = pair.problem
    lever = ahead(problem.mesh, problem.here)[:, list(pair.tubes)].sum(1)
    x = np.linspace(0.0, 2 * np.pi, 8 * FIRST)
    leads = np.sin(_differences(pair, x)) @ (pair.coupling * lever)
    return float(2 * np.pi + 1.1 * np.ptp(leads))


def greatest_bend(pair: Pair) -> float:
    """M: no second derivative of a Rayleigh quotient by the tip angle is larger."""
    turn = np.abs(pair.reach * pair.coupling)
    growth = scipy.linalg.lu_factor(np.eye(len(turn)) - turn)
    first = scipy.linalg.lu_solve(growth, np.ones(len(turn)))
    second = scipy.linalg.lu_solve(growth, turn @ first**2)
    weight = np.abs(pair.coupling) * np.hypot(first**2, second)
    return float(np.linalg.eigvalsh(pair.root.T @ (weight[:, None] * pair.root))[-1])


def least_margin_of_pair(pair: Pair) -> Least:
    """The least margin of two coupled tubes over all rotations, with its bound."""
    bend = greatest_bend(pair)
    x = np.linspace(0.0, 2 * np.pi, FIRST + 1)
    d = _differences(pair, x)
    values = _margins(pair, np.cos(d))
    while True:
        width = np.diff(x)
        lower = np.minimum(values[:-1], values[1:]) - bend * width**2 / 8
        least = float(values.min())
        open_ = lower < least - TOLERANCE * max(1.0, 1 - least)
        if not open_.any() or len(x) + open_.sum() > MOST:
            break
        new = (x[:-1] + x[1:])[open_] / 2
        between = _settled(pair, new, (d[:-1] + d[1:])[open_] / 2)
        order = np.argsort(x := np.concatenate([x, new]))
        values = np.concatenate([values, _margins(pair, np.cos(between))])[order]
        x, d = x[order], np.concatenate([d, between])[order]
    worst = int(np.argmin(values))
    return Least(min(1.0, float(lower.min())), min(1.0, least), float(x[worst]), np.cos(d[worst]))
