"""Two coupled tubes, whatever they are like along: the least margin over all rotations, with a bound that proves it,
and the fold between the relaxed and the opposed pose, however shallow or far it is.

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

With x grows the difference a(x) of the rotations at the plate, and the branch that begins in the relaxed pose is stable
while it does: its fold is where a'(x) is first 0. Opposed tubes of one curvature each have the margin of the
certificate, so that below 0 there is a fold, and above 0 there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.buffered import mapped
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

STRIDE = 0.3
"""Largest change (rad) of a rotation, at a point or at the plate, in one step towards a fold."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Two coupled tubes at N collocation points.

    tubes: which.  coupling: (N,) weight times c, J.  lag: (N,) psi, rad.  lever: (N,) how far a unit of c sin(D + psi)
    turns both at the plate, 1/J.  reach: (N, N) from which it turns D how far, 1/J.  root: (N, N) lower triangular root
    of the compliance of both tubes together.
    """

    problem: ReducedProblem
    tubes: tuple[int, int]
    coupling: Array
    lag: Array
    lever: Array
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


@dataclass(frozen=True, eq=False)
class PairFold:
    """The first fold of two coupled tubes, with the first of them turned by `turn` (rad, positive) from relaxed.

    z (U,): the equilibrium that vanishes; turned to the other side it is -z.  direction (U,): of z, without stiffness.
    beyond (U,): the equilibrium on the other branch at the same joint values, None where the turn is a whole one or
    more, so that there are several.
    """

    turn: float
    z: Array
    direction: Array
    beyond: Array | None


def pair_of(problem: ReducedProblem) -> Pair | None:
    """The two tubes of a problem that are coupled; None where there are more, or fewer."""
    # Only the difference D of two coupled tubes acts: one unknown, and one number at the tip.
    coupled = np.unique(problem.tube)
    if len(coupled) != 2:
        return None
    i, j = (int(tube) for tube in coupled)
    # A moment turns one tube forwards and the other backwards: the compliances of D add up.
    compliance = sum(problem.factor[part, part] @ problem.factor[part, part].T for part in problem.by_tube)
    lever = problem.softness[0][:, [i, j]].sum(1)
    rate = mapped(bend_rate_function(problem.assembly.n_tubes), len(problem.weight))(problem.stiffness, problem.moment)
    # A moment below 0, as tubes of one curvature may have it, is a size at half a turn.
    phase = np.pi * (problem.moment < 0) + problem.phase
    return Pair(
        problem=problem,
        tubes=(i, j),
        coupling=problem.weight * rate[0][:, i] * np.abs(problem.moment[:, j]),
        lag=phase[:, i] - phase[:, j],
        lever=lever,
        reach=lever - compliance,
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
    x = np.linspace(0.0, 2 * np.pi, 8 * FIRST)
    # Joint less tip: the torques turn both tubes between the points and the plate.
    leads = np.sin(_differences(pair, x)) @ (pair.coupling * pair.lever)
    return float(2 * np.pi + 1.1 * np.ptp(leads))


def greatest_bend(pair: Pair) -> float:
    """M: no second derivative of a Rayleigh quotient by the tip angle is larger."""
    # dD/dx = 1 + K cos(D) dD/dx and |cos| <= 1: (1 - |K|)^-1 1 bounds it.
    turn = np.abs(pair.reach * pair.coupling)
    growth = scipy.linalg.lu_factor(np.eye(len(turn)) - turn)
    first = scipy.linalg.lu_solve(growth, np.ones(len(turn)))
    second = scipy.linalg.lu_solve(growth, turn @ first**2)
    weight = np.abs(pair.coupling) * np.hypot(first**2, second)
    return float(np.linalg.eigvalsh(pair.root.T @ (weight[:, None] * pair.root))[-1])


def least_margin_of_pair(pair: Pair) -> Least:
    """The least margin of two coupled tubes over all rotations, with its bound."""
    # A function with |f''| <= M stays above the lesser end of an interval of width w by M w^2 / 8.
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


@dataclass(frozen=True, eq=False)
class _Turned:
    """Tips turned by x from the relaxed pose: D + psi (N,) and its change by x, and how far the joint is turned and how
    much further by x."""

    x: float
    d: Array
    d_slope: Array
    turn: float
    turn_slope: float

    @staticmethod
    def of(pair: Pair, x: float, near: Array) -> _Turned:
        """From D + psi (N,) close by, of tubes of one curvature each."""
        d = _settled(pair, x - pair.lag[:1], near[None])[0]
        turn, pull = pair.reach * pair.coupling, pair.coupling * pair.lever
        # D = x + K sin D: its derivative by x.
        d_slope = np.linalg.solve(np.eye(len(d)) - turn * np.cos(d), np.ones(len(d)))
        lead, ahead = float(pull @ np.sin(d)), float(pull @ (np.cos(d) * d_slope))
        return _Turned(x, d, d_slope, x + lead, 1 + ahead)

    def to(self, pair: Pair, x: float) -> _Turned:
        """Tips turned otherwise, close by."""
        return _Turned.of(pair, x, self.d + (x - self.x) * self.d_slope)


def pair_fold(pair: Pair) -> PairFold | None:
    """The first fold of two tubes of one curvature each on a turn from the relaxed pose; None where the opposed pose is
    not unstable."""
    here = _Turned.of(pair, 0.0, np.zeros(len(pair.lag)))
    while here.turn_slope >= 0:
        if here.x == np.pi:
            return None
        before = here
        # Steps shorten where joint or tubes turn much faster than the tips, so that the sign change is seen.
        here = here.to(pair, min(np.pi, here.x + STRIDE / max(1.0, here.turn_slope, float(here.d_slope.max()))))
    at = scipy.optimize.brentq(lambda x: before.to(pair, x).turn_slope, before.x, here.x, xtol=1e-13)
    fold, beyond = before.to(pair, float(at)), None
    if fold.turn < 2 * np.pi:
        # Past the opposed pose all is the mirror image of what is before it.
        mirror = scipy.optimize.brentq(lambda x: before.to(pair, x).turn + fold.turn - 2 * np.pi, 0, at, xtol=1e-13)
        beyond = -_unknowns(pair, np.sin(before.to(pair, float(mirror)).d))
    return PairFold(fold.turn, _unknowns(pair, np.sin(fold.d)), _unknowns(pair, np.cos(fold.d) * fold.d_slope), beyond)


def _unknowns(pair: Pair, pull: Array) -> Array:
    """z (U,) by which the tubes turn where they pull at each other by c times `pull` (N,)."""
    problem, moment = pair.problem, np.zeros_like(pair.problem.moment)
    moment[:, pair.tubes[0]] = pair.coupling * pull
    moment[:, pair.tubes[1]] = -pair.coupling * pull
    return np.asarray(-moment.ravel()[problem.flat] @ problem.factor)
