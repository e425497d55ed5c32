"""Two coupled tubes: the fold between the relaxed and the opposed pose, to round-off, however shallow or far it is.

With two tubes everything depends on the difference of their rotations. The equilibria then form one curve, on which
the difference phi at the outermost collocation point grows from 0, relaxed, to pi, where the tubes oppose each other
without twist. The joint rotation a(phi) that belongs to it is found by Newton's method bordered with the value of phi,
which is regular at folds too. The relaxed branch is stable while a grows, and ends where a'(phi) is 0. Opposed tubes
have the margin of the certificate, so that below 0 there is a fold, and above 0 there is none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.reduced import ReducedProblem, evaluate, to_unknowns
from ..errors import SolveError
from ..typing import Array, Index

STRIDE = 0.3
"""Largest change (rad) of a rotation, at a point or at the joint, in one step along the curve."""


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


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the curve, and its derivatives with respect to phi."""

    phi: float
    turn: float
    z: Array
    turn_slope: float
    z_slope: Array


@dataclass(frozen=True, eq=False)
class _Curve:
    """The curve of equilibria with the tube `tube` turned from rotations `start` (n,).

    read (U,): phi is the turn and read @ z.  shift (U,): change of z that is a turn of the tube by 1 rad everywhere.
    """

    problem: ReducedProblem
    tube: int
    start: Array
    read: Array
    shift: Array

    def solve(self, phi: float, near: _Point) -> _Point:
        """The point at phi, by Newton's method from the tangent at a point near by."""
        z = near.z + (phi - near.phi) * near.z_slope
        turn = near.turn + (phi - near.phi) * near.turn_slope
        for _ in range(30):
            state = evaluate(self.problem, self.start + turn * (np.arange(len(self.start)) == self.tube), z)
            # The gradient depends on the turn by theta alone, and so through H - 1 = L' B V'' L.
            slope = state.hessian @ self.shift - self.shift
            matrix = np.vstack([np.column_stack([state.hessian, slope]), np.append(self.read, 1.0)])
            gap = np.append(-state.gradient, phi - turn - float(self.read @ z))
            step = np.linalg.solve(matrix, np.column_stack([gap, np.arange(len(gap)) == len(z)]))
            z, turn = z + step[:-1, 0], turn + float(step[-1, 0])
            size = self.size(step[:, 0])
            if size < 1e-12:
                break
        else:
            if size > 1e-9:
                raise SolveError("the equilibria of two coupled tubes could not be followed to the fold")
        return _Point(phi, turn, z, float(step[-1, 1]), np.asarray(step[:-1, 1]))

    def points(self, here: _Point, end: float) -> Iterator[_Point]:
        """Points after `here` up to phi = end."""
        while here.phi < end:
            rate = self.size(np.append(here.z_slope, here.turn_slope))
            phi = here.phi + STRIDE / max(rate, 1.0)
            here = self.solve(end if phi > end - 1e-9 else phi, here)
            yield here

    def size(self, change: Array) -> float:
        """Largest rotation (rad) in a change of z and the turn (U + 1,)."""
        return float(np.abs(self.problem.factor @ change[:-1]).max()) + abs(float(change[-1]))


def pair_fold(problem: ReducedProblem, coupled: Index, start: Array) -> PairFold | None:
    """The fold at which two coupled tubes snap, turned from the relaxed pose `start` (n,); None where the opposed pose
    is not unstable."""
    curve, relaxed = _curve(problem, coupled, start)
    before = relaxed
    for here in curve.points(relaxed, np.pi):
        if here.turn_slope < 0:
            break
        before = here
    else:
        return None
    top = float(
        scipy.optimize.brentq(lambda phi: curve.solve(phi, before).turn_slope, before.phi, here.phi, xtol=1e-13)
    )
    fold = curve.solve(top, before)
    beyond = _beyond(curve, fold) if fold.turn < 2 * np.pi else None
    return PairFold(fold.turn, fold.z, fold.z_slope, beyond)


def _beyond(curve: _Curve, fold: _Point) -> Array:
    """z (U,) at the turn of the fold on the branch past the opposed pose, the mirror image of that before it."""
    before = fold
    for here in curve.points(fold, 2 * np.pi - fold.phi):
        before = here
    for here in curve.points(before, 2 * np.pi):
        if here.turn > fold.turn:
            break
        before = here
    phi = float(
        scipy.optimize.brentq(lambda phi: curve.solve(phi, before).turn - fold.turn, before.phi, here.phi, xtol=1e-13)
    )
    return curve.solve(phi, before).z


def _curve(problem: ReducedProblem, coupled: Index, start: Array) -> tuple[_Curve, _Point]:
    """The curve, and the relaxed pose on it."""
    first, second = (int(tube) for tube in coupled)
    alike = np.zeros_like(problem.moment)
    alike[:, first] = 1.0
    shift = to_unknowns(problem, np.zeros(len(start)), alike)
    last = [int(np.flatnonzero(problem.tube == tube)[-1]) for tube in (first, second)]
    curve = _Curve(problem, first, start, problem.factor[last[0]] - problem.factor[last[1]], shift)
    origin = _Point(0.0, 0.0, np.zeros(problem.size), 0.0, np.zeros(problem.size))
    return curve, curve.solve(0.0, origin)
