"""A solved pose of a design: shape and margin, and their derivatives by joint values and by dimensions of the tubes, or
by what is free of their pieces.

Places along the arm are fixed *within* the pieces of its mesh, which move along with the breakpoints: there the shape,
and the strain of a tube, are smooth in all lengths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription.collocated import ENDS
from ..block.transcription.mesh import Mesh
from ..equilibrium.answer import to_equilibrium
from ..equilibrium.arm_change import PARAMETERS
from ..equilibrium.derivatives import Derivatives
from ..equilibrium.general_derivatives import Change, Linearised, together
from ..equilibrium.general_motion import GeneralMotion
from ..equilibrium.margin import AtSolution, AtWorst
from ..equilibrium.member import PlainPoint, Point, Unloaded
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import reduced_assembly
from ..equilibrium.state import arm_of
from ..errors import SolveError
from ..robots.assembly import ROUND_OFF, Assembly, assemble
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import Tube
from ..solvers.newton import descend
from ..stability.certificate import worst_case
from ..stability.pair import least_margin_of_pair, pair_of
from ..stability.shooting import profiles, to_base
from ..typing import Array, Of


@dataclass(frozen=True, eq=False)
class Twist:
    """Twist theta - alpha (m, n) of a solved pose at fractions (m,) of the arm: a guess for the next one."""

    fraction: Array
    twist: Array


def twist_at(solved: PlainPoint) -> Twist:
    """Guess for a pose close by."""
    problem = solved.member.problem
    length = max(problem.assembly.total_length, 1e-300)
    return Twist(problem.arc_length / length, solved.state.theta - solved.member.rotations)


class _Draft(ConcentricRobot):
    """Tubes that a design tries, which need not nest yet."""

    def __post_init__(self) -> None:
        pass


def _placed(tubes: Sequence[Tube], rotations: Array, translations: Array) -> Unloaded:
    """The problem of tubes at joint values, which is not kept: a design tries others every time."""
    problem = reduced_assembly(assemble(tubes, translations))
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
    result = descend(problem, rotations, np.zeros(problem.size))
    if not result.converged:
        raise SolveError("no equilibrium was found at a pose of the design")
    return Point.of(member, result)


def without_solving(tubes: Sequence[Tube], translations: Array) -> PlainPoint:
    """The problem at given translations, for what does not depend on the rotations: the certificate."""
    member = _placed(tubes, np.zeros(len(tubes)), translations)
    return Point(0.0, member, member.at(np.zeros(member.problem.size)), 1.0)


def mesh_slopes(assembly: Assembly, mesh: Mesh) -> tuple[Array, Array]:
    """(P, 7 n) change of where the pieces begin and of their lengths, by `block.derivatives.PARAMETERS`."""
    n, m = assembly.n_tubes, assembly.n_sections
    cuts = np.zeros((m + 1, len(PARAMETERS) * n))
    shift, longer = (PARAMETERS.index(name) * n for name in ("translations", "curved_length"))
    for k, cut in enumerate(assembly.start + assembly.length, start=1):
        near = np.abs(np.stack([assembly.transition, assembly.end], axis=1).ravel() - cut) <= 2 * ROUND_OFF
        tube, at_end = divmod(int(np.argmax(near)), 2)
        cuts[k, shift + tube] = 1.0
        cuts[k, longer + tube] = at_end
    count = np.bincount(mesh.section, minlength=m)
    rank = np.arange(len(mesh.section)) - np.repeat(np.cumsum(count) - count, count)
    length = (np.diff(cuts, axis=0) / count[:, None])[mesh.section]
    return cuts[mesh.section] + rank[:, None] * length, length


class Pose:
    """A solved pose: values at once, derivatives by PARAMETERS (L = 7 n columns) where they are asked for.

    n tubes, P pieces, m = 4 P + 1 shape points.
    """

    def __init__(self, solved: PlainPoint) -> None:
        self.solved, self.problem, self.margin = solved, solved.member.problem, solved.margin
        self.arc_length = arms.arc_lengths(self.problem.mesh)

    @cached_property
    def derivatives(self) -> Derivatives:
        """Derivatives at fixed arc lengths."""
        carriages = tuple((i,) for i in range(self.problem.assembly.n_tubes))
        return Derivatives(arm_of(self.solved), carriages, wrt=PARAMETERS, margin=self.margin)

    @property
    def position(self) -> Array:
        """(m, 3) of the shape points, m."""
        return self.derivatives.arm.position

    @property
    def frame(self) -> Array:
        """(m, 3, 3) Bishop frame at the shape points."""
        return self.derivatives.arm.frame

    @property
    def theta(self) -> Array:
        """(P x 5, n) theta at ENDS of every piece."""
        return self.derivatives.along[0].reshape(-1, self.problem.assembly.n_tubes)

    @property
    def bend(self) -> Array:
        """(P x 5, 2) curvature there, 1/m."""
        return self.derivatives.along[2].reshape(-1, 2)

    @cached_property
    def _moved(self) -> Array:
        """(P, 5, L) change of the arc length of ENDS of every piece."""
        start, length = mesh_slopes(self.problem.assembly, self.problem.mesh)
        return start[:, None] + ENDS[:, None] * length[:, None]

    @cached_property
    def bend_slopes(self) -> tuple[Array, Array]:
        """(P x 5, n, L) of `theta` and (P x 5, 2, L) of `bend`."""
        of, moved = self.derivatives, self._moved[:, :, None]
        _, slope, _, turned = of.along
        theta, bend = of.along_change
        theta, bend = theta + slope[..., None] * moved, bend + turned[..., None] * moved
        return theta.reshape(-1, *theta.shape[2:]), bend.reshape(-1, *bend.shape[2:])

    @cached_property
    def shape_slopes(self) -> tuple[Array, Array, Array]:
        """(m, 3, L) change of position and of frame (turn vector), (m, L) of arc length, at the shape points."""
        of = self.derivatives
        arc = np.concatenate([np.zeros((1, of.size)), self._moved[:, 1:].reshape(-1, of.size)])
        position = of.position + self.frame[:, :, 2, None] * arc[:, None]
        position[-1] = of.tip_position
        turn = np.zeros_like(position)
        bend = of.along[2][:, 1:].reshape(-1, 2)
        rate = (self.frame[1:, :, :2] @ bend[..., None])[..., 0]
        turn[1:] = of.turn_ahead[1:] + rate[..., None] * arc[1:, None]
        return position, turn, arc

    @property
    def tip_slope(self) -> Array:
        """(3, L) change of the tip's position."""
        return self.derivatives.tip_position

    @property
    def tip_turn(self) -> Array:
        """(3, L) change of the tip's frame (turn vector)."""
        rate = self.frame[-1][:, :2] @ self.bend[-1]
        return np.asarray(self.derivatives.turn_ahead[-1] + rate[:, None] * self._moved[-1, -1])

    @cached_property
    def margin_slope(self) -> Array:
        """(L,) change of the margin; of a double eigenvalue, that of one mode."""
        return self.derivatives.quotient(self.margin, AtSolution(), one_of_two=True)

    @cached_property
    def certificate(self) -> tuple[float, Array]:
        """mu_cert at this pose's translations, and its change (L,); of a double eigenvalue, that of one mode."""
        value = worst_case(self.problem)[0]
        return value, self.derivatives.quotient(value, AtWorst(), one_of_two=True)


class PiecePose:
    """A solved pose of a design of pieces, as `Pose`, with derivatives (L,) by rotations, translations, and what
    `changes` lists."""

    def __init__(
        self, solved: PlainPoint, tubes: Sequence[Tube], changes: Callable[[Linearised], Sequence[Change]]
    ) -> None:
        self.solved, self.problem, self.margin = solved, solved.member.problem, solved.margin
        self._tubes, self._changes = tuple(tubes), changes

    position, frame, arc_length = Of[Array]("_equilibrium"), Of[Array]("_equilibrium"), Of[Array]("_equilibrium")

    @cached_property
    def _equilibrium(self) -> Equilibrium:
        return to_equilibrium(self.solved, "guess")

    @cached_property
    def derivatives(self) -> GeneralMotion:
        """Derivatives at fixed arc lengths."""
        return GeneralMotion(self._equilibrium, more=self._changes)

    @property
    def shape_slopes(self) -> tuple[Array, Array, Array]:
        """(m, 3, L) change of position and of frame (turn vector), (m, L) of arc length, at the shape points."""
        return self.derivatives.shape

    @property
    def tip_slope(self) -> Array:
        """(3, L) change of the tip's position."""
        return self.derivatives.tip_position

    @property
    def tip_turn(self) -> Array:
        """(3, L) change of the tip's frame (turn vector)."""
        return self.derivatives.tip_rotation

    @property
    def margin_slope(self) -> Array:
        """(L,) change of the margin; NaN of a double eigenvalue."""
        return self.derivatives.margin

    @cached_property
    def certificate(self) -> tuple[float, Array]:
        """mu_cert at this pose's translations, and its change (L,), nought with the joints.

        Where two tubes do better than at their worst it is the margin of the equilibrium that has the least. At that
        one the margin does not change with the rotations, so its change with the pieces at given ones is that of the
        least.
        """
        value, mode, _ = worst_case(self.problem)
        pair = pair_of(self.problem)
        least = None if pair is None else least_margin_of_pair(pair)
        if pair is not None and least is not None and least.bound > value + 1e-6:  # else they are the same
            tips = np.zeros((1, len(self._tubes)))
            tips[0, pair.tubes[0]] = least.tip
            rotations = to_base(self.problem, tips)[0]
            theta = profiles(self.problem, tips)[0]
            member = replace(self.solved.member, rotations=rotations)
            found = member.solve(member.unknowns(theta))
            if found.converged:
                solved = Point(0.0, member, found.state, least.margin)
                slope = PiecePose(solved, self._tubes, self._changes).margin_slope
                return least.margin, np.concatenate([np.zeros(2 * len(self._tubes)), slope[2 * len(self._tubes) :]])
        here = Linearised(self.solved, self._equilibrium)
        changed = here.certificate(value, mode, together(self._changes(here)))
        return value, np.concatenate([np.zeros(2 * len(self._tubes)), changed])
