"""Derivatives of an equilibrium that touches walls, by joint values and dimensions, by the implicit function theorem.

Contact forces that stayed as they are would change the equilibrium like any other load, see `linearised.py`: point and
tangent of the arm at contact k change by p_k and t_k. But contacts stay closed, and their forces turn with the wall.
The unknowns change further, by d that minimises

    d'(H - sum lambda_k g_k'') d / 2 - d' sum lambda_k (P_k' D_k p_k - b_k c_k / g_ss + T_k' n_k e_k)

subject to n_k.(P_k d + p_k) = 0, with the symbols of `wall_contact.py`. The slope of the gap along the arm changes by
c_k = n_k.t_k + t'D_k p_k. A contact at the end of a tube does not slide, but moves with that end, by e_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..block.transcription.arm import ArmShape
from ..block.transcription.collocated import ENDS
from ..block.transcription.loaded import LoadedState
from ..block.transcription.orientation import position_slopes
from ..block.transcription.reduced import tube_turn
from ..errors import SolveError
from ..typing import Array
from .linearised import Linearised, linearise
from .result import Equilibrium
from .wall_contact import HERE, Gap, Solved, Touch, Touching, solution_of


class ContactChange(NamedTuple):
    """Change of the arm at a contact under contact forces that stay as they are."""

    place: Array
    """Change p (3, Q) of the point of the arm."""
    tangent: Array
    """Change t (3, Q) of the tangent."""
    end: Array
    """Motion e (Q,) along the arm of the contact, m; 0 unless it is at the end of a tube."""


class _Further(NamedTuple):
    """Further changes, since contacts stay closed."""

    x: Array
    """Change d (X, Q) of the unknowns."""
    forces: Array
    """Change (K, Q) of the contact forces, N."""


@dataclass(frozen=True, eq=False)
class LinearisedAmongWalls:
    """Derivatives of an equilibrium that touches walls in Q directions, computed when they are read."""

    free: Linearised
    """Derivatives under contact forces that stay as they are."""
    solved: Solved

    # --- What contacts do not change ----------------------------------------------------------------------------------

    @property
    def wrt(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.free.wrt)

    @property
    def size(self) -> int:
        """Number Q of directions."""
        return self.free.size

    @property
    def shape(self) -> ArmShape:
        """Shape of the arm."""
        return self.free.shape

    @property
    def cuts(self) -> Array:
        """Arc lengths (P + 1,) of the ends of the elements, m."""
        return self.free.cuts

    @property
    def moved(self) -> Array:
        """Motion (m, Q) along the arm of the shape points, which stay at fixed fractions of the elements, m."""
        return self.free.moved

    @property
    def total_bend(self) -> float:
        """Integral of the squared curvature, 1/m."""
        return self.free.total_bend

    # --- Contacts -----------------------------------------------------------------------------------------------------

    @cached_property
    def _state(self) -> LoadedState:
        return self.solved.state

    @property
    def _touching(self) -> Touching:
        return self.solved.touching

    def _at_contact(self, touch: Touch, gap: Gap) -> ContactChange:
        """Change of the arm at a contact, where an element begins or the arm ends."""
        free, stretch = self.free, self._touching.stretch(touch.arc_length)
        k = int(np.abs(free.cuts - touch.arc_length).argmin())
        frame, turn = free.shape.frame[(len(ENDS) - 1) * k], free.response.state[k, free.n : free.n + 3]
        place = free.position[(len(ENDS) - 1) * k].copy()
        if k == len(free.cuts) - 1:
            place -= free.pushed
        at_end = not len(gap.off) and touch.arc_length > stretch.end - HERE
        end = free.moved[(len(ENDS) - 1) * k] if at_end else np.zeros(self.size)
        place += np.outer(frame[:, 2], end)
        return ContactChange(place, np.cross(turn, frame[:, 2], axisa=0, axisc=0), end)

    @cached_property
    def _further(self) -> _Further:
        state, touches = self._state, self.solved.pressed
        turning, closing = np.zeros((len(state.x), self.size)), np.zeros((len(touches), self.size))
        rows = np.zeros((len(touches), len(state.x)))
        for k, touch in enumerate(touches):
            gap = self._touching.gap(state, touch)
            change = self._at_contact(touch, gap)
            # lambda P'n at a contact whose normal turns, that slides, or that moves with the end of its tube.
            turned = gap.place.T @ gap.wall @ change.place
            turned += gap.mixed.T @ gap.shift(gap.by_tangent @ change.tangent + gap.by_point @ change.place)
            turning += touch.force * (turned + np.outer(gap.normal @ gap.turn, change.end))
            rows[k], closing[k] = gap.by_x, -(gap.normal @ change.place)
        second = self._touching.second_variation(state, touches)
        closed = np.linalg.lstsq(rows, closing, rcond=None)[0]
        x = closed + second.response(turning - second.hessian @ closed)
        # grad of the Lagrangian stays 0: H'd - turning = A' d lambda.
        forces = np.linalg.lstsq(rows.T, second.hessian @ x - turning, rcond=None)[0]
        return _Further(x, np.asarray(forces))

    @property
    def x(self) -> Array:
        """Further change d (X, Q) of the unknowns, which keeps the contacts closed."""
        return self._further.x

    @property
    def contact_forces(self) -> Array:
        """Derivative (K, Q) of the sizes of the contact forces, base to tip, N."""
        out = self._further.forces.copy()
        for k, touch in enumerate(self.solved.pressed):
            gap = self._touching.gap(self._state, touch)
            size = float(np.linalg.norm(gap.normal))
            out[k] *= size
            if len(gap.off) == 2:
                # At an edge n = m n_1 + (1 - m) n_2 is no unit vector.
                change = self._at_contact(touch, gap)
                place, tangent = change.place + gap.place @ self.x, change.tangent + gap.turn @ self.x
                s, share = gap.shift(gap.by_tangent @ tangent + gap.by_point @ place)
                turned = np.outer(gap.by_point[1], share) + gap.wall @ (place + np.outer(gap.tangent, s))
                out[k] += touch.force * (gap.normal @ turned) / size
        return out

    @cached_property
    def _curvature(self) -> Array:
        """Further change (2 N, Q) of the curvature at the points."""
        return np.asarray(self._state.curvature_slope @ self.x)

    # --- Results ------------------------------------------------------------------------------------------------------

    @property
    def tip_position(self) -> Array:
        """Derivative (3, Q) of the tip position, m."""
        weight = self._touching.member.torsion.weight
        return np.asarray(self.free.tip_position + position_slopes(self._state.orientation, weight) @ self._curvature)

    @property
    def tip_rotation(self) -> Array:
        """Turn (3, Q) of the tip frame about world axes, rad."""
        return np.asarray(self.free.tip_rotation + self._state.orientation.turn_slope() @ self._curvature)

    @property
    def tip_rotations(self) -> Array:
        """Derivative (n, Q) of theta at the ends of the tubes, rad."""
        torsion = self._touching.member.torsion
        tip = len(torsion.mesh.length)
        rows = np.array([tube_turn(torsion, tube, tip).row for tube in range(self.free.n)])
        return np.asarray(self.free.tip_rotations + rows @ self.x[: torsion.size])

    @property
    def position(self) -> Array:
        """Derivative (m, 3, Q) of the shape points at fixed arc lengths, m; of the last one, of the tip."""
        weights = np.array([self._touching.weights(s)[0] for s in self.shape.arc_length.tolist()])
        return np.asarray(self.free.position + position_slopes(self._state.orientation, weights) @ self._curvature)

    @property
    def energy(self) -> Array:
        """Derivative (Q,) of the elastic energy, J: the contact and load forces do work on the further change."""
        return np.asarray(self.free.energy + (self._state.gradient - self._state.load_slope) @ self.x)

    @property
    def bend(self) -> Array:
        """Derivative (Q,) of `total_bend`, 1/m."""
        weighted = 2 * self._touching.member.torsion.weight[:, None] * self._state.curvature
        return np.asarray(self.free.bend + weighted.ravel() @ self._curvature)

    @property
    def margin(self) -> Array:
        """Raises SolveError: the derivative of a margin among walls is a difference of two equilibria."""
        raise SolveError("the arm touches walls; the derivative of its margin is not known")


def linearise_among_walls(
    equilibrium: Equilibrium, wrt: Sequence[str], side: int = 1, along: Array | None = None
) -> LinearisedAmongWalls:
    """Derivatives of an equilibrium that touches walls; with a contact at the tip, to side 1.

    Raises:
        InputError: an equilibrium from a file, which has no walls.
        SolveError: it is a fold.
    """
    solved = solution_of(equilibrium)
    free = replace(equilibrium, walls=None)
    # A load at the tip has no place on an arm that draws back, while a contact there moves with the tip.
    length = float(equilibrium.arc_length[-1])
    side = 1 if any(touch.arc_length > length - HERE for touch in solved.pressed) else side
    return LinearisedAmongWalls(linearise(free, wrt, side, along=along), solved)
