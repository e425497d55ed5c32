"""Two coupled tubes of any precurvature: smallest margin over all rotations, with proof, and the first fold.

*One unknown.* The equilibria of two tubes are a family of one parameter, the difference x of their tip angles. From the
tip, where torsion is 0, the difference D(s) of their elastic rotations obeys the Volterra equation

    D(s) = x + int_s sigma int c sin(D + psi),
    sigma = 1 / kt_1 + 1 / kt_2,  c = m_1 m_2 / sum kb,  psi = psi_1 - psi_2,

with psi_i the direction of the precurvature in tube i. So the smallest margin is the minimum of a function mu(x) of one
angle. Where D + psi can stay at pi all along, as for planar tubes that curve to one side, it is the certificate of all
pairs at their worst. Where it cannot, as for an S-shaped tube or helices of unequal pitch, it is larger.

*Theorem.* Two tubes can snap if and only if this minimum is negative. Above 0 the difference a(x) of the rotations at
the plate grows with x, since a'(x) changes sign only where a margin is 0, so that every joint value has one x. Below 0
there is a fold: the equilibrium of smallest energy has a margin of at least 0, and mu(x) crosses 0 between the two.

*Lower bound.* mu(x) is the minimum over deflections y of Rayleigh quotients f(y, x), with second derivatives

    |f_xx| <= M = max_y  int |c| hypot(P^2, S) y^2 / T(y),     |D_x| <= P,  |D_xx| <= S,

where P and S solve the linear equations with |c| in place of c cos(D + psi) and c sin(D + psi). On an interval of
length h no f is more than M h^2 / 8 below its chord, so mu(x) is at least the smaller of its values at the ends less
that. Intervals are halved until this bound is within `TOLERANCE` of the smallest value.

*First fold.* The branch from the relaxed pose is stable while a(x) grows; it ends where a'(x) is first 0. For tubes of
one curvature each the opposed pose x = pi has the margin of the certificate: below 0 there is a fold, above 0 none.
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
"""Distance of the bound below the smallest margin, as a fraction of 1 - margin, that ends the halving of intervals."""

FIRST_INTERVALS = 32
"""Number of intervals of the first grid over a turn."""

MAX_TIPS = 20000
"""Maximum number of tip angles; the bound holds wherever the halving stops."""

MAX_SWEEPS = 60
"""Maximum number of fixed-point sweeps of the collocated equations."""

MAX_NEWTON = 12
"""Maximum number of Newton steps after the sweeps."""

SOLVED = 1e-12
"""Change (rad) that ends the solve of the collocated equations."""

MAX_TURN = 0.3
"""Largest change (rad) of a rotation, at a point or at the plate, in one step towards a fold."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Equations of two coupled tubes at N collocation points: D = x + reach @ (coupling sin(D + psi))."""

    problem: ReducedProblem
    tubes: tuple[int, int]
    """Numbers of the two tubes, from 0."""
    coupling: Array
    """(N,) quadrature weight times the coupling c, J."""
    psi: Array
    """(N,) difference of the directions of the precurvatures, rad."""
    lever: Array
    """(N,) change of the difference at the plate per unit of c sin(D + psi) at a point, 1/J."""
    reach: Array
    """(N, N) change of the difference D at a point per unit of c sin(D + psi) at another, 1/J."""
    root: Array
    """(N, N) Cholesky factor of the compliance of both tubes together."""


@dataclass(frozen=True, eq=False)
class PairMinimum:
    """Smallest margin of a pair over all rotations."""

    bound: float
    """Proved lower bound on the margin."""
    margin: float
    """Smallest computed margin."""
    tip: float
    """Difference x of the tip angles at the smallest margin, rad."""
    opposition: Array
    """(N,) cos(D + psi) at the minimum; the coupling reduces the margin at negative values."""


@dataclass(frozen=True, eq=False)
class PairFold:
    """First fold of two coupled tubes on a rotation from the relaxed pose."""

    turn: float
    """Rotation of the first tube relative to the second, rad, positive."""
    z: Array
    """(U,) unknowns of the equilibrium that vanishes; -z for a rotation in the other direction."""
    direction: Array
    """(U,) null vector of the second variation."""
    beyond: Array | None
    """(U,) unknowns of the equilibrium on the other branch; None from a full turn on, with several branches."""


def pair_of(problem: ReducedProblem) -> Pair | None:
    """Equations of the coupled tubes of a problem; None unless these are two."""
    coupled = np.unique(problem.tube)
    if len(coupled) != 2:
        return None
    i, j = (int(tube) for tube in coupled)
    # A moment turns one tube forwards and the other backwards, so that their compliances add up in D.
    compliance = sum(problem.factor[part, part] @ problem.factor[part, part].T for part in problem.by_tube)
    lever = problem.softness[0][:, [i, j]].sum(1)
    rate = mapped(bend_rate_function(problem.assembly.n_tubes), len(problem.weight))(problem.stiffness, problem.moment)
    # Negative precurvature is positive precurvature in the opposite direction.
    phase = np.pi * (problem.moment < 0) + problem.phase
    return Pair(
        problem=problem,
        tubes=(i, j),
        coupling=problem.weight * rate[0][:, i] * np.abs(problem.moment[:, j]),
        psi=phase[:, i] - phase[:, j],
        lever=lever,
        reach=lever - compliance,
        root=np.asarray(np.linalg.cholesky(compliance), dtype=float),
    )


def _differences(pair: Pair, tips: Array) -> Array:
    """(B, N) angles D + psi between the natural bends at differences of tip angles (B,), rad."""
    return _solve(pair, tips, tips[:, None] + pair.psi)


def _solve(pair: Pair, tips: Array, guess: Array) -> Array:
    """(B, N) angles D + psi between the natural bends at differences of tip angles (B,), rad.

    Fixed-point iteration: D at a point depends only on D nearer to the tip (Volterra), so it converges from every
    guess, with an error after k sweeps like the k-th term of the series of a cosine. Collocation keeps this only up to
    stiff tubes on long pieces; Newton's method finishes these.
    """
    gain = pair.reach * pair.coupling
    untwisted, d = tips[:, None] + pair.psi, guess
    for _ in range(MAX_SWEEPS):
        before, d = d, untwisted + np.sin(d) @ gain.T
        if np.abs(d - before).max(initial=0.0) < SOLVED:
            return np.asarray(d)
    for _ in range(MAX_NEWTON):
        jacobian = np.eye(len(gain)) - gain * np.cos(d)[:, None, :]
        step = np.linalg.solve(jacobian, (untwisted + np.sin(d) @ gain.T - d)[..., None])[..., 0]
        d = d + step
        if np.abs(step).max(initial=0.0) < SOLVED:
            break
    return np.asarray(d)


def margins(pair: Pair, tips: Array) -> Array:
    """(B,) margins mu(x) at tip-angle differences (B,), not capped at 1."""
    return _margins(pair, np.cos(_differences(pair, tips)))


def _margins(pair: Pair, cosines: Array) -> Array:
    """(B,) margins mu at cosines cos(D + psi) (B, N)."""
    second = pair.root.T @ ((pair.coupling * cosines)[..., None] * pair.root)
    return np.asarray(1 + np.linalg.eigvalsh(second)[:, 0])


def farthest_fold(pair: Pair) -> float:
    """Rotation (rad) of the first tube against the second that crosses a fold from any stable equilibrium.

    Only where a fold exists. While the tips turn once, so do the joints; a(x) - x is periodic, and its range is the
    distance beyond one turn.
    """
    x = np.linspace(0.0, 2 * np.pi, 8 * FIRST_INTERVALS)
    wind_up = np.sin(_differences(pair, x)) @ (pair.coupling * pair.lever)
    # 10 % more, since the range is sampled.
    return float(2 * np.pi + 1.1 * np.ptp(wind_up))


def quotient_curvature_bound(pair: Pair) -> float:
    """Upper bound M on the second derivative of every Rayleigh quotient with respect to the tip angle."""
    # D_x = 1 + K cos(D) D_x and |cos| <= 1, so that (1 - |K|)^-1 1 bounds D_x; likewise D_xx.
    gain = np.abs(pair.reach * pair.coupling)
    growth = scipy.linalg.lu_factor(np.eye(len(gain)) - gain)
    p = scipy.linalg.lu_solve(growth, np.ones(len(gain)))
    s = scipy.linalg.lu_solve(growth, gain @ p**2)
    weight = np.abs(pair.coupling) * np.hypot(p**2, s)
    return float(np.linalg.eigvalsh(pair.root.T @ (weight[:, None] * pair.root))[-1])


def least_margin_of_pair(pair: Pair) -> PairMinimum:
    """Smallest margin of two coupled tubes over all rotations, by branch and bound over one turn of x."""
    curvature = quotient_curvature_bound(pair)
    x = np.linspace(0.0, 2 * np.pi, FIRST_INTERVALS + 1)
    d = _differences(pair, x)
    values = _margins(pair, np.cos(d))
    while True:
        # |f_xx| <= M: on an interval of width h, f is at least its smaller end less M h^2 / 8.
        lower = np.minimum(values[:-1], values[1:]) - curvature * np.diff(x) ** 2 / 8
        smallest = float(values.min())
        undecided = lower < smallest - TOLERANCE * max(1.0, 1 - smallest)
        if not undecided.any() or len(x) + undecided.sum() > MAX_TIPS:
            break
        middle = (x[:-1] + x[1:])[undecided] / 2
        d_middle = _solve(pair, middle, (d[:-1] + d[1:])[undecided] / 2)
        order = np.argsort(x := np.concatenate([x, middle]))
        values = np.concatenate([values, _margins(pair, np.cos(d_middle))])[order]
        x, d = x[order], np.concatenate([d, d_middle])[order]
    worst = int(np.argmin(values))
    return PairMinimum(min(1.0, float(lower.min())), min(1.0, smallest), float(x[worst]), np.cos(d[worst]))


@dataclass(frozen=True, eq=False)
class _Shot:
    """Equilibrium of a pair whose tips are turned by x from the relaxed pose, for tubes of one curvature each."""

    x: float
    d: Array
    """Angle D + psi (N,) between the natural bends, rad."""
    d_x: Array
    """(N,) derivative of the difference D of the rotations with respect to x."""
    a: float
    """Rotation of the joint from the relaxed pose, rad."""
    a_x: float
    """Derivative of `a` with respect to x; 0 at a fold."""

    @staticmethod
    def at(pair: Pair, x: float, guess: Array) -> _Shot:
        """Equilibrium at x, from a guess of D + psi (N,)."""
        d = _solve(pair, x - pair.psi[:1], guess[None])[0]
        lever = pair.coupling * pair.lever
        # D = x + K sin(D + psi), differentiated with respect to x.
        d_x = np.linalg.solve(np.eye(len(d)) - pair.reach * pair.coupling * np.cos(d), np.ones(len(d)))
        return _Shot(x, d, d_x, x + float(lever @ np.sin(d)), 1 + float(lever @ (np.cos(d) * d_x)))

    def to(self, pair: Pair, x: float) -> _Shot:
        """Equilibrium at another x close by, predicted along the tangent."""
        return _Shot.at(pair, x, self.d + (x - self.x) * self.d_x)


def pair_fold(pair: Pair) -> PairFold | None:
    """First fold of two tubes of one curvature each on a rotation from the relaxed pose, where a'(x) = 0.

    None if a grows up to the opposed pose x = pi, which then is stable.
    """
    shot = _Shot.at(pair, 0.0, np.zeros(len(pair.psi)))
    while shot.a_x >= 0:
        if shot.x == np.pi:
            return None
        before = shot
        # Shorter steps where joint or tubes turn faster than the tips: neither turns by more than MAX_TURN.
        shot = shot.to(pair, min(np.pi, shot.x + MAX_TURN / max(1.0, shot.a_x, float(shot.d_x.max()))))
    x_fold = scipy.optimize.brentq(lambda x: before.to(pair, x).a_x, before.x, shot.x, xtol=1e-13)
    fold, beyond = before.to(pair, float(x_fold)), None
    if fold.a < 2 * np.pi:
        # Beyond the opposed pose the branch is the mirror image: a(2 pi - x) = 2 pi - a(x), with the tubes at -D.
        mirror = scipy.optimize.brentq(lambda x: before.to(pair, x).a + fold.a - 2 * np.pi, 0, x_fold, xtol=1e-13)
        beyond = -_unknowns(pair, np.sin(before.to(pair, float(mirror)).d))
    return PairFold(fold.a, _unknowns(pair, np.sin(fold.d)), _unknowns(pair, np.cos(fold.d) * fold.d_x), beyond)


def _unknowns(pair: Pair, torque: Array) -> Array:
    """(U,) unknowns z of tubes that act on each other with the torque c times `torque` (N,)."""
    problem, moment = pair.problem, np.zeros_like(pair.problem.moment)
    moment[:, pair.tubes[0]] = pair.coupling * torque
    moment[:, pair.tubes[1]] = -pair.coupling * torque
    return np.asarray(-moment.ravel()[problem.flat] @ problem.factor)
