"""Two coupled tubes: the fold between the relaxed and the opposed pose, to round-off, however shallow or far it is.

With two tubes everything depends on the difference of their rotations. The equilibria then form one curve, on which
the difference phi at the outermost collocation point grows from 0, relaxed, to pi, where the tubes oppose each other
without twist. The joint rotation a(phi) that belongs to it is found by Newton's method bordered with the value of phi,
which is regular at folds too. The relaxed branch is stable while a grows, and ends where a'(phi) is 0. Opposed tubes
have the margin of the certificate, so that below 0 there is a fold, and above 0 there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from ..errors import SolveError
from ..robots.assembly import Array
from ..solution import Solution
from ..solvers.newton import NewtonResult
from ..transcription.reduced import Index, ReducedProblem, evaluate, margin, to_unknowns

STEP = 0.1
"""Step (rad) in which the curve is followed to its fold."""


@dataclass(frozen=True, eq=False)
class PairFold:
    """The first fold of two coupled tubes on the way from `start` (n,), with the first of them turned.

    turn: rad, positive.  before: the equilibrium that vanishes, after: the one on the other branch, at one joint value;
    None where that is more than a turn away.  direction (U,) in z without stiffness.
    """

    turn: float
    before: Solution
    after: Solution | None
    direction: Array


@dataclass(frozen=True, eq=False)
class _Curve:
    """The curve of equilibria; `known` holds (phi, turn, z) where it was solved."""

    problem: ReducedProblem
    tube: int
    start: Array
    read: Array
    shift: Array
    known: list[tuple[float, float, Array]]

    def rotations(self, turn: float) -> Array:
        """(n,) joint rotations with the first coupled tube turned from the relaxed pose."""
        out = self.start.copy()
        out[self.tube] += turn
        return out

    def at(self, phi: float) -> tuple[float, Array, float, Array]:
        """turn, z, d turn/d phi and dz/d phi where the rotations at the outermost point differ by phi."""
        near, turn, z = min(self.known, key=lambda point: abs(point[0] - phi))
        turn += phi - near
        for _ in range(30):
            state = evaluate(self.problem, self.rotations(turn), z)
            # The gradient depends on the turn by theta alone, and so through H - 1 = L' B V'' L.
            slope = state.hessian @ self.shift - self.shift
            matrix = np.vstack([np.column_stack([state.hessian, slope]), np.append(self.read, 1.0)])
            gap = phi - turn - float(self.read @ z)
            step = np.linalg.solve(matrix, np.column_stack([np.append(-state.gradient, gap), np.eye(len(matrix))[-1]]))
            z, turn = z + step[:-1, 0], turn + float(step[-1, 0])
            size = float(np.abs(self.problem.factor @ step[:-1, 0]).max()) + abs(float(step[-1, 0]))
            if size < 1e-12:
                break
        else:
            if size > 1e-9:
                raise SolveError("the curve of equilibria of two coupled tubes could not be followed to its fold")
        self.known.append((phi, turn, z))
        return turn, z, float(step[-1, 1]), np.asarray(step[:-1, 1])

    def solution(self, turn: float, z: Array) -> Solution:
        """The equilibrium at a point of the curve."""
        rotations = self.rotations(turn)
        state = evaluate(self.problem, rotations, z)
        return Solution(self.problem, rotations, NewtonResult(state, True, 0, 0.0), margin(self.problem, state))


def pair_fold(problem: ReducedProblem, coupled: Index, start: Array, sign: int) -> PairFold | None:
    """The fold at which two coupled tubes snap, the first of them turned to the side of `sign` from the relaxed pose
    `start` (n,); None where the opposed pose is not unstable.

    Raises:
        SolveError: Newton's method left the curve.
    """
    curve = _curve(problem, coupled, start)
    phi = 0.0
    slope = curve.at(0.0)[2]
    while slope > 0 and phi < np.pi:
        phi = min(phi + STEP, np.pi)
        slope = curve.at(sign * phi)[2]
    if slope >= 0:
        return None
    top = sign * float(brentq(lambda x: curve.at(sign * x)[2], max(phi - STEP, 0.0), phi, xtol=1e-13))
    turn, z, _, direction = curve.at(top)
    after = _across(curve, top, turn)
    return PairFold(abs(turn), curve.solution(turn, z), after, direction)


def _across(curve: _Curve, top: float, turn: float) -> Solution | None:
    """The equilibrium at the turn of the fold on the branch beyond the opposed pose, of which it is the mirror image."""
    sign = np.sign(top)
    if abs(turn) >= 2 * np.pi:
        return None
    low, high = 2 * np.pi - abs(top), 2 * np.pi
    for phi in np.linspace(abs(top), high, 2 + int((high - abs(top)) / STEP)):
        curve.at(sign * float(phi))
    phi = sign * float(brentq(lambda x: sign * (curve.at(sign * x)[0] - turn), low, high, xtol=1e-13))
    landed, z, _, _ = curve.at(phi)
    return curve.solution(landed, z)


def _curve(problem: ReducedProblem, coupled: Index, start: Array) -> _Curve:
    first, second = (int(tube) for tube in coupled)
    theta = np.zeros_like(problem.moment)
    theta[:, first] = 1.0
    shift = to_unknowns(problem, np.zeros(len(start)), theta)
    last = [int(np.flatnonzero(problem.tube == tube)[-1]) for tube in (first, second)]
    read = problem.factor[last[0]] - problem.factor[last[1]]
    return _Curve(problem, first, start, read, shift, [(0.0, 0.0, np.zeros(problem.size))])
