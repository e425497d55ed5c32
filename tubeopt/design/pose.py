"""A solved pose of a design: shape and margin, and their derivatives by joint values, by dimensions of the tubes and by
what is free of their pieces.

Places along the arm are fixed *within* the pieces of its mesh, which move along with the breakpoints: there the shape,
and the strain of a tube, are smooth in all lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..block.transcription.arm import ArmShape
from ..block.transcription.postprocess import evaluate_arm
from ..block.transcription.responsive import Responsive
from ..equilibrium.directions import Change, Directions
from ..equilibrium.linearised import Linearised
from ..equilibrium.member import PlainPoint, Point, Unloaded
from ..equilibrium.problem import reduced_assembly
from ..errors import SolveError
from ..robots.assembly import assemble
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import Tube
from ..stability.certificate import worst_case, worst_of_pair
from ..typing import Array


@dataclass(frozen=True, eq=False)
class Twist:
    """Twist theta - alpha (m, n) of a solved pose at fractions (m,) of the arm: a guess for the next one."""

    fraction: Array
    twist: Array


class _Draft(ConcentricRobot):
    """Tubes that a design tries, which need not nest yet."""

    def __post_init__(self) -> None:
        pass


def _placed(tubes: Sequence[Tube], rotations: Array, translations: Array) -> Unloaded:
    """The problem of tubes at joint values, which is not kept: a design tries others every time."""
    assembly = assemble(tubes, translations)
    problem = reduced_assembly(assembly)
    return Unloaded(_Draft(tuple(tubes)), problem, rotations, tuple(translations.tolist()))


def solve_pose(tubes: Sequence[Tube], rotations: Array, translations: Array, guess: Twist | None = None) -> PlainPoint:
    """The equilibrium near `guess`, or the one that descent reaches from tubes without torsion."""
    member = _placed(tubes, rotations, translations)
    problem = member.problem
    if guess is not None and len(guess.fraction) and problem.size:
        fraction = problem.arc_length / max(problem.assembly.total_length, 1e-300)
        twist = np.column_stack([np.interp(fraction, guess.fraction, column) for column in guess.twist.T])
        result = member.solve(member.unknowns(rotations + twist), iterations=12)
        if result.converged:
            return Point.of(member, result)
    result = member.descend(np.zeros(problem.size))
    if not result.converged:
        raise SolveError("no equilibrium was found at a pose of the design")
    return Point.of(member, result)


def without_solving(tubes: Sequence[Tube], translations: Array) -> PlainPoint:
    """The problem at given translations, for what does not depend on the rotations: the certificate."""
    member = _placed(tubes, np.zeros(len(tubes)), translations)
    return Point(0.0, member, member.at(np.zeros(member.problem.size)), 1.0)


def moving(rows: Array) -> tuple[Array, Array]:
    """(L, Q) the directions of rows (L, X) in which anything changes, and (Q, X) the unknowns of these: derivatives
    along them, times the second, are those by all unknowns."""
    columns = np.flatnonzero(rows.any(0))
    return rows[:, columns], np.eye(rows.shape[1])[columns]


class Pose:
    """A solved pose: values at once; derivatives where they are asked for, (.., L) by what `wrt` names of PARAMETERS,
    n columns each, then by what `more` says that changes; or by the directions `along` (L, Q) in place of these.

    n tubes, m shape points.
    """

    def __init__(
        self,
        solved: PlainPoint,
        wrt: Sequence[str] = (),
        more: Callable[[Directions], Sequence[Change]] | None = None,
        along: Array | None = None,
    ) -> None:
        self.solved, self.problem, self.margin = solved, solved.member.problem, solved.margin
        self.wrt, self.more, self.along = tuple(wrt), more, along

    @cached_property
    def arm(self) -> ArmShape:
        """The shape."""
        solved = self.solved
        return evaluate_arm(self.problem, solved.member.rotations, solved.state, solved.torsion)

    @property
    def twist(self) -> Twist:
        """Guess for a pose close by."""
        length = max(self.problem.assembly.total_length, 1e-300)
        return Twist(self.problem.arc_length / length, self.solved.state.theta - self.solved.member.rotations)

    @cached_property
    def derivatives(self) -> Linearised:
        """Derivatives at fixed arc lengths."""
        tubes = self.solved.member.robot.tubes
        return Linearised(self._standing, tubes, self.margin, self.wrt, more=self.more, along=self.along)

    @cached_property
    def by_joints(self) -> Linearised:
        """Derivatives by the joint values, tube by tube."""
        return Linearised(self._standing, self.solved.member.robot.tubes, self.margin)

    @cached_property
    def _standing(self) -> Responsive:
        return Responsive(self.problem, self.solved.member.rotations, self.solved.state.theta, self.arm)

    @property
    def shape_slopes(self) -> tuple[Array, Array, Array]:
        """(m, 3, L) change of position and of frame (turn vector), (m, L) of arc length, at the shape points."""
        of = self.derivatives
        position = of.position + self.arm.frame[:, :, 2, None] * of.moved[:, None]
        position[-1] = of.tip_position
        return position, of.turned, of.moved

    @cached_property
    def certificate(self) -> tuple[float, Array]:
        """mu_cert at this pose's translations, and its change (L,), at given rotations.

        Where two tubes of pieces do better than at their worst it is the margin of the equilibrium that has the least.
        """
        value, mode, _ = worst_case(self.problem)
        worst = worst_of_pair(self.solved.member, value)
        if worst is not None:
            return worst.margin, Pose(worst, self.wrt, self.more, self.along).derivatives.one_margin
        return value, self.derivatives.certificate(value, mode)
