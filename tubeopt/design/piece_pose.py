"""A solved pose of a design of pieces: tip, centreline and margin, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from ..block.transcription.reduced import to_unknowns
from ..equilibrium.general_change import Change, together
from ..equilibrium.general_derivatives import Linearised
from ..equilibrium.general_motion import GeneralMotion
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import Solution, to_equilibrium
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import Tube
from ..solvers.newton import newton
from ..stability.certificate import worst_case
from ..stability.pair_certificate import least_margin_of_pair, pair_of
from ..stability.shooting import profiles, to_base
from ..typing import Array


class PiecePose:
    """A solved pose, as `pose.Pose`, with derivatives (L,) by rotations, translations, and what `changes` lists."""

    def __init__(
        self, solved: Solution, tubes: Sequence[Tube], changes: Callable[[Linearised], Sequence[Change]]
    ) -> None:
        self.solved, self.problem, self.margin = solved, solved.problem, solved.margin
        self._tubes, self._changes = tuple(tubes), changes

    @cached_property
    def _equilibrium(self) -> Equilibrium:
        assembly = self.problem.assembly
        straight = np.array([tube.straight_length for tube in self._tubes])
        shift = tuple((straight - assembly.transmission).tolist())
        return to_equilibrium(ConcentricRobot(self._tubes), self.solved, shift, ("newton", "guess", 0.0))

    @cached_property
    def derivatives(self) -> GeneralMotion:
        """Derivatives at fixed arc lengths."""
        return GeneralMotion(self._equilibrium, more=self._changes)

    @property
    def position(self) -> Array:
        """(m, 3) of the shape points, m."""
        return self._equilibrium.position

    @property
    def frame(self) -> Array:
        """(m, 3, 3) Bishop frame at the shape points."""
        return self._equilibrium.frame

    @property
    def arc_length(self) -> Array:
        """(m,) of the shape points, m."""
        return self._equilibrium.arc_length

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
            found = newton(self.problem, rotations, to_unknowns(self.problem, rotations, theta))
            if found.converged:
                solved = Solution(self.problem, rotations, found, least.margin)
                slope = PiecePose(solved, self._tubes, self._changes).margin_slope
                return least.margin, np.concatenate([np.zeros(2 * len(self._tubes)), slope[2 * len(self._tubes) :]])
        here = Linearised(self.solved, self._equilibrium)
        changed = here.certificate(value, mode, together(self._changes(here)))
        return value, np.concatenate([np.zeros(2 * len(self._tubes)), changed])
