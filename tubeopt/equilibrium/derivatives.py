"""Derivatives of an equilibrium of tubes off the centreline by the implicit function theorem: of the tip, of any point
of the arm, of energy and margin, with respect to joint values and to every dimension and stiffness of the tubes.

What moves along the arm is taken at fixed arc lengths; a breakpoint that moves uncovers a stretch on which another
cross-section takes over, which is a jump of the rates there. The pose follows from d phi = int R du ds and
dp = int R du x (p(L) - p) ds. Concentric tubes: `linearised`.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..block.transcription.buffered import section_function
from ..block.transcription.collocated import ENDS
from ..block.transcription.linear import cross, cumulate, poses_at_points
from ..robots.assembly import ROUND_OFF
from ..typing import Array
from .arm_change import ArmChange
from .linearised import FLAT
from .offset import offset_change


class Derivatives(ArmChange):
    """Derivatives of one equilibrium with respect to Q parameters, computed where they are asked for."""

    @cached_property
    def tip_rotations(self) -> Array:
        """(n, Q) of theta at each tube's own end."""
        n = self.arm.n_tubes
        ends = np.clip(self.assembly.end, 0.0, self.cuts[-1])
        index = np.argmin(np.abs(self.cuts - ends[:, None]), axis=1)
        return self.per_tube(self.response.end[index, np.arange(n)])

    # --- shape --------------------------------------------------------------------------------------------------------

    @cached_property
    def bent(self) -> Array:
        """(P, K, 2, Q) change of u at the points, by carriages."""
        n, slope = self.arm.n_tubes, self.slopes.curvature_slope
        change = slope[..., :n] @ self.response.inner
        if self.reshaped:
            change += slope[..., n:] @ self.data[:, None, : 2 * n]
        return np.asarray(change)

    @cached_property
    def _poses(self) -> tuple[Array, Array]:
        """Frames (P, K, 3, 3) and positions (P, K, 3) at the points."""
        arm = self.arm
        return poses_at_points(arm.tableau, arm.length, (arm.frame, arm.position, arm.curvature))

    @property
    def _turning(self) -> Array:
        """(P, K, 3, Q) change of the turn at the points, per piece."""
        return np.asarray(self.arm.length[:, None, None, None] * (self._poses[0][..., :2] @ self.bent))

    @cached_property
    def _turns(self) -> Array:
        """(J, 3) turns of all that lies beyond the jumps."""
        frame = self.arm.frame[self.jumps.index * (len(ENDS) - 1)]
        return np.asarray((frame[:, :, :2] @ self.gains[1][:, :, None])[..., 0])

    @cached_property
    def _tip(self) -> tuple[Array, Array]:
        """(3, Q) change of tip position and of tip rotation (turn vector), by carriages."""
        (frame, position), end = self._poses, self.arm.position[-1]
        across = frame[..., :2] * (self.arm.length[:, None] * self.arm.tableau.weights)[..., None, None]
        levers = np.concatenate([across, cross(across, end - position)], axis=-2)
        out = levers.swapaxes(0, 2).swapaxes(1, 2).reshape(6, -1) @ self.bent.reshape(-1, self.size)
        if len(self.jumps):
            behind = end - self.arm.position[self.jumps.index * (len(ENDS) - 1)]
            jumps = self._turns[..., None]
            out += np.concatenate([jumps, cross(jumps, behind)], axis=1)[..., 0].T @ self.jumps.spread
        return out[3:] + self.pushed, out[:3]

    @property
    def pushed(self) -> Array:
        """(3, Q) motion of the tip with the parameters that push it out, or that alone hold it there."""
        out = np.zeros((3, self.size))
        whole = self.assembly.total_length
        longest = {i for i, end in enumerate(self.assembly.end.tolist()) if abs(end - whole) <= ROUND_OFF}
        for column, _, tubes in self.movers:
            mine = longest.intersection(tubes)
            if mine and (self.side > 0 or (mine == longest and self.arm.n_pieces)):
                out[:, column] = self.arm.frame[-1][:, 2]
        return out

    @property
    def tip_position(self) -> Array:
        """(3, Q) of the tip, m."""
        return self.per_tube(self._tip[0])

    @property
    def tip_rotation(self) -> Array:
        """(3, Q) turn vector of the tip frame in the plate frame, rad."""
        return self.per_tube(self._tip[1])

    @cached_property
    def position(self) -> Array:
        """(m, 3, Q) of the shape points at fixed arc lengths; the last one is the tip, which moves along."""
        t, rate = self.arm.tableau, self._turning
        out = cross(cumulate(t, rate), self.arm.position) - cumulate(t, cross(rate, self._poses[1]))
        for column, index, gain in zip(self.jumps.column, self.jumps.index, self._turns, strict=True):
            k = index * (len(ENDS) - 1)
            out[k:, :, column] += cross(gain[:, None], self.arm.position[k:] - self.arm.position[k])[..., 0]
        out[-1] = self._tip[0]
        return self.per_tube(out)

    @property
    def total_bend(self) -> float:
        """int |u|^2 ds along the arm, 1/m."""
        weights = self.arm.length[:, None] * self.arm.tableau.weights
        return float((weights * (self.slopes.curvature**2).sum(2)).sum())

    @cached_property
    def bend(self) -> Array:
        """(Q,) of int |u|^2 ds, 1/m."""
        weights, at = self.arm.length[:, None] * self.arm.tableau.weights, self.slopes
        out = 2 * np.einsum("px,pxa,pxaq->q", weights, at.curvature, self.bent)
        return self.per_tube(out + self.gains[3] @ self.jumps.spread)

    # --- energy and margin --------------------------------------------------------------------------------------------

    @cached_property
    def energy(self) -> Array:
        """(Q,) of the elastic energy, J."""
        arm, at, n = self.arm, self.slopes, self.arm.n_tubes
        t, kt, h = arm.tableau, arm.torsional_stiffness, arm.length[:, None, None]
        base, first = arm.twist[:1].sum(0), self.first("torsional_stiffness")
        out = self.gains[2] @ self.jumps.spread
        weights, w = h * t.weights[:, None], arm.twist[:, None] + h * (t.adjoint @ at.rate)
        stretch, pull = weights * kt * at.stretch * w, weights * at.bending_slope
        pull += ((weights * kt * w**2 / 2)[..., None, :] @ at.stretch_slope)[..., 0, :]
        out += _total(stretch, self.twist_change) + _total(pull[..., :n], self.response.inner)
        if self.reshaped:
            by_data = np.concatenate([pull[..., n:], weights * at.stretch * w**2 / 2], axis=2).sum(1)
            out += _total(by_data, self.data)
        out += (kt * base**2 / 2) @ self.transmitted + (kt * arm.transmission * base) @ self.response.end[0, n:]
        if first is not None:
            out[first : first + n] += arm.transmission * base**2 / 2
        return self.per_tube(out)

    @cached_property
    def margin(self) -> Array:
        """(Q,) of the margin; NaN where it is a double eigenvalue."""
        if not self.arm.n_pieces:
            return self.per_tube(-self._softened @ self.jumps.spread)
        # With no coupling that softens it stays at its greatest value, 1.
        return self.per_tube(np.zeros(self.size) if self.value >= FLAT else offset_change(self, self.problem()))

    @property
    def _softened(self) -> Array:
        """(J,) by how much the margin of an arm of length zero falls per length of what leaves the plate: the largest
        eigenvalue of -V'' over the stiffness kt / |beta| of the transmissions, which alone twist there, or 0."""
        jumps, n, place = self.jumps, self.arm.n_tubes, self.arm.place
        theta = jumps.twice(self.arm.states[0])
        slope = section_function("balance", len(theta), n, True)(theta, jumps.solid, jumps.moment, *place)[1]
        root = np.sqrt(self.arm.transmission / self.arm.torsional_stiffness)
        second = -root[:, None] * jumps.gain(slope.reshape(-1, n, n)) * root
        symmetric = (second + second.swapaxes(1, 2)) / 2
        return np.asarray(np.linalg.eigvalsh(symmetric).max(1, initial=0.0))


def _total(weights: Array, change: Array) -> Array:
    """(Q,) sum of weights (...) times changes (..., Q)."""
    return np.asarray(weights.reshape(-1) @ change.reshape(weights.size, change.shape[-1]))
