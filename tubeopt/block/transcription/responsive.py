"""Linearised response of an arm in equilibrium to changes of its joints, dimensions and loads.

A turn psi of the frame about world axes changes the quantities of `standing` by

    psi' = R du,     db = (R'(dm - psi x m))_xy,     dm' = n x (psi x e) - e x dn.

The equations are collocated at the points of the equilibrium. The state (phi, psi, t, m) at the end of a piece is
linear in the state at its start; conditions at plate and tip close the chain. A breakpoint that moves exposes a stretch
with other tubes, which is a jump of the rates. Without a load m, n and l are 0: phi and t close the chain, and psi
follows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from ...errors import SolveError
from ...typing import Array, Index
from .standing import Standing, cross, hat


@dataclass(frozen=True, eq=False)
class Forcing:
    """Changes by Q parameters, at fixed arc lengths."""

    base: Array
    """Change (n, Q) of the rotations alpha."""
    transmission: Array
    """Change (n, Q) of int ds / kt from clamp to plate."""
    data: Array
    """Change (P, K, 3 n, Q) of phase, kb and m at the points."""
    rate: Array
    """Change (P, K, n, Q) of 1 / kt."""
    force: Array
    """Change (P, K, 3, Q) of the force."""
    jumps: Array
    """Jump (P + 1, 2 n + 6, Q) of the state at the ends of the pieces."""
    side: int
    """Side of the moments at joints on which the jumps are: -1 towards the plate, 1 towards the tip."""


class Forced(NamedTuple):
    """Forced parts of phi', t', u and m' at the points, by columns (P, K, r, C)."""

    phi: Array
    torque: Array
    curvature: Array
    moment: Array


class SectionChange(NamedTuple):
    """Changes at the points, by columns (P, K, r, C)."""

    torque: Array
    """Change of t."""
    moment: Array
    """Change of m."""
    bending: Array
    """Change (P, K, n + 2, C) of t' above u."""
    falling: Array
    """Change of m'."""
    turning: Array | None
    """Change of phi' at fixed t; None if phi' depends on torques only."""


@dataclass(frozen=True, eq=False)
class Maps:
    """Linear maps of P pieces with r = K (n + 2) unknowns each, phi and u at the points; without a load r = K n."""

    matrix: Array
    """Equations (P, r, r) of the unknowns."""
    gathered: Array
    """State (P, 2 n + 6, r) at the end of a piece by its unknowns."""
    inner: Array
    """Unknowns (P, r, 2 n + 6) by the state at the start."""
    ends: Array
    """State (P, 2 n + 6, 2 n + 6) at the end by the state at the start."""


@dataclass(frozen=True, eq=False)
class Response:
    """Change of an arm at fixed arc lengths; further quantities are computed on first use."""

    state: Array
    """State (P + 1, 2 n + 6, Q) where pieces begin, and at the tip."""
    phi: Array
    """Rotations (P, K, n, Q) at the points."""
    psi: Array
    """Turn (P, K, 3, Q) of the frame at the points."""
    felt: Callable[[], SectionChange]
    """Returns the changes at the points."""
    across: tuple[Array, Array] | None
    """Derivatives of b by psi and by m; None without a load."""

    @cached_property
    def _felt(self) -> SectionChange:
        return self.felt()

    @property
    def torque(self) -> Array:
        """Change (P, K, n, Q) of t."""
        return self._felt.torque

    @property
    def moment(self) -> Array:
        """Change (P, K, 3, Q) of m."""
        return self._felt.moment

    @cached_property
    def bent(self) -> Array:
        """Change (P, K, 2, Q) of b."""
        if self.across is None:
            return np.zeros((*self.psi.shape[:2], 2, self.psi.shape[3]))
        by_turn, by_moment = self.across
        return np.asarray(by_turn @ self.psi + by_moment @ self.moment)

    @property
    def curvature(self) -> Array:
        """Change (P, K, 2, Q) of u."""
        return self._felt.bending[..., -2:, :]


class Responsive(Standing):
    """An arm in equilibrium, with its linearised response."""

    @property
    def size(self) -> int:
        """Length of a state: rotations, turn of the frame, torques, moment; the chain has its rows `kept`."""
        return 2 * self.n + 6

    @property
    def unknowns(self) -> int:
        """Number r of unknowns of a piece: phi at its points and, under a load, u."""
        return self.degree * (self.n if self.own == self.n else self.n + 2)

    @cached_property
    def _across(self) -> tuple[Array, Array]:
        """Derivatives of b at the points by psi and by m."""
        return self.across @ self.about_moment, self.across

    @cached_property
    def _leaning(self) -> Array:
        """Derivative (P, K, 3, 3) of m' by psi."""
        return np.asarray(hat(-self.force) @ self.about_axis)

    @cached_property
    def _by(self) -> Array:
        """Derivative (P, K, n + 2, n + 2) of M and u by theta and b at the points."""
        return self.at.by.reshape(self.pieces, self.degree, self.n + 2, self.n + 2)

    def _by_state(self, softness: float) -> tuple[Array, Array | None]:
        """Derivatives (P, K, n + 2, own) of t' and u by (phi, psi) and, under a load, (P, K, n + 2, 3) by m."""
        n = self.n
        if self.load is None:
            return self._by[..., :n], None
        by_bent = self._by[..., n:]
        if softness != 1.0:
            by_bent = by_bent.copy()
            by_bent[..., n:, :] *= softness
        out = np.empty((self.pieces, self.degree, n + 2, n + 3))
        out[..., :n] = self._by[..., :n]
        by_moment = by_bent @ self.across
        # b = R'm changes by R'(dm + m x psi): the turn of the frame acts through m.
        np.matmul(by_moment, self.about_moment, out=out[..., n:])
        if self.along is not None:
            out[..., :n, n:] -= cross(self.axis[..., None, :], self.along)
        return out, by_moment

    def _swept(self, matrix: Array, rates: Array) -> Array:
        """Integrals (P, K, r, C) of rates (P, K, r, C), by the matrices (P, K, K) of the pieces."""
        out = matrix @ rates.reshape(self.pieces, self.degree, -1)
        return np.asarray(out.reshape(rates.shape))

    def _felt(
        self, q: Array, starts: tuple[Array, Array], forced: Forced | None, softness: float = 1.0
    ) -> SectionChange:
        """Changes at the points by those of (phi, psi) there, q (P, K, own, C).

        Args:
            starts: changes of t and m where the pieces begin, (P or 1, 1, r, C).  forced: forced parts.
        """
        n, (by_state, by_moment) = self.n, self._by_state(softness)
        bending = by_state @ q
        if by_moment is None:
            moment = falling = np.zeros((self.pieces, self.degree, 3, q.shape[3]))
        else:
            falling = self._leaning @ q[..., n:, :]
            if forced is not None:
                falling += forced.moment
            moment = self._swept(self.back, falling)
            moment += starts[1]
            bending += by_moment @ moment
        if forced is not None:
            bending[..., :n, :] += forced.torque
            bending[..., n:, :] += forced.curvature
        torque = self._swept(self.back, bending[..., :n, :])
        torque += starts[0]
        turning = None if self.coupled is None else self.coupled @ q[..., :n, :]
        if forced is not None:
            turning = forced.phi if turning is None else turning + forced.phi
        return SectionChange(torque, moment, bending, falling, turning)

    def _unforced(self, softness: float) -> SectionChange:
        """`_felt` by columns of phi and u at the points, then of the state where pieces begin."""
        n, k, own, size, inner = self.n, self.degree, self.own, 2 * self.own, self.unknowns
        begin = _units(size, inner + size, inner)
        starts = begin[own : own + n], begin[own + n :]
        q = np.empty((self.pieces, k, own, inner + size))
        q[:] = _own_units(n, k, own)
        if own > n:  # psi is the integral of R u
            turned = self.frame[:, None, :, :, :2].swapaxes(2, 3)
            np.multiply(self.ahead[:, :, None, :, None], turned, out=q[..., n:, k * n : inner].reshape(-1, k, 3, k, 2))
        return self._felt(q, starts, None, softness)

    def _ended(self, felt: SectionChange, softness: float) -> tuple[Array, Array]:
        """Integrals of the rates of phi up to the points, above u there (P, r, C), and of the state (P, 2 own, C)."""
        n, own, k, count = self.n, self.own, self.degree, felt.torque.shape[-1]
        there, end = np.empty((self.pieces, self.unknowns, count)), np.empty((self.pieces, 2 * own, count))
        rates = softness * self.winding[..., None] * felt.torque
        if felt.turning is not None:
            rates += felt.turning
        parts = [(rates, slice(n)), (felt.bending[..., :n, :], slice(own, own + n))]
        if own > n:
            bends = felt.bending[..., n:, :]
            there[:, k * n :].reshape(self.pieces, k, 2, count)[:] = bends
            parts += [(self.frame[..., :2] @ bends, slice(n, own)), (felt.falling, slice(own + n, None))]
        weights = self.weights[:, None]
        for part, rows in parts:
            np.matmul(weights, part.reshape(self.pieces, k, -1), out=end[:, rows].reshape(self.pieces, 1, -1))
        np.matmul(self.ahead, rates.reshape(self.pieces, k, -1), out=there[:, : k * n].reshape(self.pieces, k, -1))
        return there, end

    def _maps(self, softness: float) -> Maps:
        """Linear maps of all pieces, softened by a factor."""
        n, k, size, inner = self.n, self.degree, 2 * self.own, self.unknowns
        there, end = self._ended(self._unforced(softness), softness)
        # A state adds itself to what it makes of phi at every point, and of itself at the end.
        next_row = inner + size + 1
        there[:, : k * n].reshape(self.pieces, k, -1)[..., inner::next_row] += 1.0
        # The state at the end is that at the beginning and the integral of its rates.
        end.reshape(self.pieces, -1)[:, inner::next_row] += 1.0
        self._past(end, 1)
        # Equations of the points: unknowns less their own integrals; eliminated piece by piece.
        matrix = -there[..., :inner]
        matrix.reshape(self.pieces, -1)[:, :: inner + 1] += 1.0
        solved = np.asarray(np.linalg.solve(matrix, there[..., inner:]))
        ends = end[..., inner:] + end[..., :inner] @ solved
        return Maps(matrix, end[..., :inner], solved, ends)

    @cached_property
    def _standing_maps(self) -> Maps:
        """Linear maps without softening."""
        return self._maps(1.0)

    def _forced_maps(self, forced: Forced) -> tuple[Array, Array]:
        """Forced phi and u at the points (P, r, C), and states at the ends of the pieces (P, 2 own, C)."""
        count, maps = forced.phi.shape[-1], self._standing_maps
        none = np.zeros((1, self.degree, self.own, count)), (np.zeros((self.n, count)), np.zeros((3, count)))
        there, end = self._ended(self._felt(*none, forced), 1.0)
        solved = np.asarray(np.linalg.solve(maps.matrix, there))
        return solved, self._past(end, 1) + maps.gathered @ solved

    def _past(self, states: Array, first: int) -> Array:
        """States (P + 1 - first, 2 own, C) at the ends of pieces from number `first`, after the moments that act there.

        They are changed in place, from the side of the plate to that of the tip.
        """
        for k, tube, moment in self.joints:
            if k >= first:
                turn = states[k - first, self.n : self.n + 3]
                states[k - first, self.own + tube] -= cross(self.end_frame[k, :, 2], moment) @ turn
        return states

    def _system(self, softness: float, ends: Array, turns: Array | None = None) -> Array:
        """Matrix of the chain, for torques and moment (own) at the plate and the states (P, 2 own) where pieces begin.

        Args:
            turns: change (P, 2 own, 3) of the states by a turn of the tip, with which a follower force turns.
        """
        n, size, own, pieces = self.n, 2 * self.own, self.own, self.pieces
        total = own + pieces * size
        matrix = np.zeros((total, total))
        matrix[: pieces * size].reshape(-1)[own :: total + 1] = 1.0
        matrix[:size, :own] = -ends[0, :, own:]
        # At the plate theta turns by the transmission times the torque, which is unknown there.
        matrix[:size, :n] -= ends[0, :, :n] * (softness * self.transmission)
        for k in range(1, pieces):
            matrix[k * size : (k + 1) * size, own + (k - 1) * size : own + k * size] = -ends[k]
        if turns is not None:
            turn = slice(total - size + n, total - size + own)
            matrix[: pieces * size, turn] -= turns.reshape(-1, 3)
        last, rows = total - size, slice(pieces * size, total)
        matrix[rows].reshape(-1)[last + own :: total + 1] = 1.0
        if own == n:
            return matrix
        tip = matrix[rows, last + n : last + own]
        if self.following:
            # A moment that turns with the tip changes by psi x m.
            tip[n:] += hat(self.tip_moment)
        elif self.tip_moment.any():
            tip[self.tip_tube] -= cross(self.end_frame[-1, :, 2], self.tip_moment)
        return matrix

    @cached_property
    def turning(self) -> Array | None:
        """Derivative (P, K, 3, 3) of m' by the turn of the tip under a follower force; None under dead forces."""
        if not (self.following and self.tip_force.any()):
            return None
        return np.asarray(self.about_axis @ hat(self.tip_force))

    def respond(self, forcing: Forcing) -> Response:
        """Response of the arm to changes.

        Raises:
            SolveError: the equilibrium is a fold.
        """
        n, own, size, count = self.n, self.own, 2 * self.own, forcing.base.shape[1]
        first = np.zeros((size, count))
        first[:n] = forcing.base + forcing.transmission * self.torque_plate_side[0][:, None]
        if not self.pieces:
            nothing = [np.zeros((0, self.degree, rows, count)) for rows in (n, 3, n + 2)]
            # Torques at the plate twist the transmissions.
            state, torque = forcing.jumps.copy(), slice(n + 3, 2 * n + 3)
            state[0, :n] += first[:n] - self.transmission[:, None] * state[0, torque]
            state[0, torque] = 0.0
            felt = SectionChange(nothing[0], nothing[1], nothing[2], nothing[1], None)
            return Response(state, nothing[0], nothing[1], lambda: felt, None)
        forced, columns = self._forced(forcing)
        maps, turned = self._standing_maps, self._turns
        inner, gained = (None, None) if forced is None else self._forced_maps(forced)
        matrix = self._system(1.0, maps.ends, None if gained is None or not turned else gained[..., :turned])
        right, jumps = np.zeros((len(matrix), count)), forcing.jumps[:, self.kept]
        if forcing.side < 0:
            self._past(jumps, 0)
        start = first + jumps[0]
        table = right[: self.pieces * size].reshape(self.pieces, size, count)
        if gained is not None:
            table[..., columns] = gained[..., turned:]
        # The known part at the plate enters the right-hand side through the first piece.
        table[0] += maps.ends[0] @ start
        table += jumps[1:]
        *_, result, singular = scipy.linalg.lapack.dgesv(matrix, right)
        if singular or not np.isfinite(result).all():
            raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
        state = np.empty((self.pieces + 1, size, count))
        state[1:] = result[own:].reshape(self.pieces, size, count)
        state[0] = start
        state[0, own:] += result[:own]
        state[0, :n] += self.transmission[:, None] * result[:n]
        q = maps.inner @ state[:-1]
        wide = None
        if forced is not None and inner is not None:
            q[..., columns] += inner[..., turned:]
            wide = Forced(*(np.zeros((*part.shape[:3], count)) for part in forced))
            for whole, part in zip(wide, forced, strict=True):
                whole[..., columns] = part[..., turned:]
            if self.turning is not None:
                turn = state[-1, n : n + 3]
                q += inner[..., :turned] @ turn
                wide.moment[:] += self.turning @ turn
        if self.load is None:
            state = self._whole(state)
            state[:, n : n + 3] = forcing.jumps[:, n : n + 3]
        return self._along(state, q, wide, 1.0)

    def _whole(self, state: Array) -> Array:
        """States (P + 1, 2 n + 6, Q) from those in the chain (P + 1, 2 own, Q): without a load psi and m are 0."""
        out = np.zeros((len(state), self.size, state.shape[2]))
        out[:, self.kept] = state
        return out

    @property
    def _turns(self) -> int:
        """Number of columns of the turn of the tip."""
        return 0 if self.turning is None else 3

    def _forced(self, forcing: Forcing) -> tuple[Forced | None, Index]:
        """Forced parts at the points by the turn of the tip and by some of the changes, and the numbers of these."""
        extra, parts = self._turns, (forcing.data, forcing.rate, forcing.force)
        if not extra and not any(part.any() for part in parts):
            return None, np.zeros(0, dtype=np.intp)
        some = [part.any((0, 1, 2)) for part in parts]
        columns: Index = np.flatnonzero(some[0] | some[1] | some[2])
        data, rate, force = (part[..., columns] for part in parts)
        by_data = self.by_data
        turning = rate * self.stretched[..., None]
        if by_data.rotation_rate is not None:
            turning += by_data.rotation_rate @ data
        forced = [turning, by_data.torque @ data, by_data.curvature @ data, -self.about_axis @ force]
        if self.turning is not None:
            # Three more columns: a follower force changes with the unknown turn of the tip.
            forced = [np.concatenate([np.zeros((*p.shape[:3], extra)), p], axis=3) for p in forced]
            forced[3][..., :extra] = self.turning
        return Forced(*forced), columns

    def _along(self, state: Array, q: Array, forced: Forced | None, softness: float) -> Response:
        """Response from states (P + 1, 2 n + 6, Q), and phi and u at the points (P, r, Q).

        Without a load the states have the jumps of psi between the pieces in place of psi.
        """
        n, k, begin = self.n, self.degree, state[:-1, None]
        phi = q[:, : k * n].reshape(self.pieces, k, n, -1)
        starts = begin[:, :, n + 3 : 2 * n + 3], begin[:, :, 2 * n + 3 :]
        if self.load is not None:
            psi = self._turned(state, q[:, k * n :].reshape(self.pieces, k, 2, -1))
            of_both = lambda: self._felt(np.concatenate([phi, psi], axis=2), starts, forced, softness)  # noqa: E731
            return Response(state, phi, psi, of_both, self._across)
        felt = self._felt(phi, starts, forced, softness)
        bends = felt.bending[..., n:, :]
        gained = self.weights[:, None] @ (self.frame[..., :2] @ bends).reshape(self.pieces, k, -1)
        state[1:, n : n + 3] += gained.reshape(self.pieces, 3, -1)
        # Without a load psi acts on nothing, so that it is summed afterwards.
        state[:, n : n + 3] = np.cumsum(state[:, n : n + 3], axis=0)
        return Response(state, phi, self._turned(state, bends), lambda: felt, None)

    def _turned(self, state: Array, bends: Array) -> Array:
        """Turn psi (P, K, 3, Q) at the points, from states and u (P, K, 2, Q)."""
        return np.asarray(state[:-1, None, self.n : self.n + 3] + self._swept(self.ahead, self.frame[..., :2] @ bends))

    def wound(self, response: Response, forcing: Forcing, piece: int) -> Array:
        """Change (K, n, Q) of phi' at the points of a piece."""
        out = self.winding[piece, ..., None] * response.torque[piece]
        out += self.stretched[piece, ..., None] * forcing.rate[piece]
        if self.coupled is not None:
            out += self.coupled[piece] @ response.phi[piece]
            by_data = self.by_data.rotation_rate
            assert by_data is not None
            out += by_data[piece] @ forcing.data[piece]
        return np.asarray(out)

    def pulled(self, pull: Array, softness: float) -> Response:
        """Mode without bending whose torque grows by `pull` (P, K, n) per length from the tip, one column."""
        n = self.n
        torque, tip_side, _ = self._inwards(-pull, np.zeros(n))
        rates, state = softness * self.rate * torque, np.zeros((self.pieces + 1, self.size, 1))
        whole = np.concatenate([softness * self.transmission * tip_side[:1], (self.weights[..., None] * rates).sum(1)])
        state[:, :n, 0], state[:, n + 3 : 2 * n + 3, 0] = np.cumsum(whole, axis=0), tip_side
        phi = state[:-1, None, :n, 0] + self.ahead @ rates
        none = np.zeros((*self.axis.shape[:2], n + 2, 1))
        felt = SectionChange(torque[..., None], none[..., :3, :], none, none[..., :3, :], None)
        return Response(state, phi[..., None], none[..., :3, :], lambda: felt, None)

    def mode(self, margin: float, *, one_of_two: bool = False) -> tuple[Response, float] | None:
        """Buckling mode of the arm softened by its margin, one column, and the factor 1 / (1 - margin).

        None if the mesh is too coarse for the mode, or if the eigenvalue is double, unless `one_of_two` modes will do.
        """
        known = margin
        for _ in range(MODE_STEPS):
            # Inverse iteration at a shift close to the eigenvalue, where the matrix is not singular: one step from any
            # start gives the mode, up to others.
            shifted = margin - SHIFT
            softness = 1 / (1 - shifted)
            maps = self._maps(softness)
            matrix = self._system(softness, maps.ends)
            angle = np.arange(len(matrix), dtype=float)
            factors, pivots, _ = scipy.linalg.lapack.dgetrf(matrix)
            # Irregular starts, so that symmetry makes none orthogonal to a mode; the second shows other modes.
            right = np.column_stack([np.cos(angle), np.sin(angle)])
            grown = scipy.linalg.lapack.dgetrs(factors, pivots, right)[0]
            size = np.abs(grown[:, 0]).max()
            result = scipy.linalg.lapack.dgetrs(factors, pivots, grown[:, 0] / size)[0]
            result /= np.abs(result).max()
            # Part of the second start that is not the first mode.
            second = np.abs(grown[:, 1] - result * ((result @ grown[:, 1]) / (result @ result))).max()
            state = self._state(result, softness)
            inner = maps.inner @ state[:-1]
            mode = self._along(state if self.own > self.n else self._whole(state), inner, None, softness)
            margin = self.quotient(mode, softness)
            # Every mode grows by one over the distance of its eigenvalue from the shift.
            if abs(margin - shifted) * size < DOUBLE * second:
                if not one_of_two:
                    return None
                break
            if second < MIXED * size:
                break
        return (mode, softness) if abs(margin - known) < SAME_MODE else None

    def _state(self, result: Array, softness: float) -> Array:
        """States (P + 1, 2 own, 1) where pieces begin, from a solution of the chain."""
        n, own = self.n, self.own
        state = np.zeros((self.pieces + 1, 2 * own, 1))
        state[1:, :, 0] = result[own:].reshape(self.pieces, 2 * own)
        state[0, own:, 0] = result[:own]
        state[0, :n, 0] = softness * self.transmission * result[:n]
        return state

    def elastic(self, mode: Response, softness: float) -> float:
        """Elastic part T of the second variation along a mode of one column, J."""
        torque, bent, held = mode.torque[..., 0], mode.bent[..., 0], mode.state[0, self.n + 3 : 2 * self.n + 3, 0]
        # int t^2 / kt + |b|^2 / K: energies by torques and moments, of an elasticity softened by the factor.
        density = (self.rate * torque**2).sum(2) + (bent**2).sum(2) / self.stiffness.sum(2)
        return float(softness**2 * ((self.weights * density).sum() + self.transmission @ held**2))

    def quotient(self, mode: Response, softness: float) -> float:
        """Ratio of the second variation to its elastic part T along a mode of one column."""
        y, psi, curved = (part[..., 0] for part in (mode.phi, mode.psi, mode.curvature))
        bending = (self.frame[..., :2] @ curved[..., None])[..., 0]
        form = (y * (self._by[..., : self.n, : self.n] @ y[..., None])[..., 0]).sum(2)
        if self.load is not None:
            # Work of the forces and moments in the second order of the turn psi.
            form -= (self.force * cross(psi, cross(psi, self.axis)) + self.moment * cross(psi, bending)).sum(2)
        return 1.0 + float((self.weights * form).sum()) / self.elastic(mode, softness)


MODE_STEPS = 4
"""Maximum number of inverse iterations, each at the quotient of the last mode."""

MIXED = 3e-7
"""Largest part of another mode in a mode; the derivative of the margin has an error of about that size."""

SAME_MODE = 1e-6
"""Largest difference of the quotient of a mode from the margin."""

SHIFT = 1e-12
"""Distance from the margin at which a mode is computed: more than round-off of the matrix, and far less than DOUBLE."""

DOUBLE = 1e-9
"""Distance of eigenvalues below which they count as double, without a unique mode and derivative."""


@lru_cache(maxsize=64)
def _own_units(n: int, degree: int, own: int) -> Array:
    """Read-only (K, own, r + 2 own): phi and psi at the points by phi there, and by the state at the start."""
    inner = degree * (n if own == n else n + 2)
    out = np.zeros((degree, own, inner + 2 * own))
    out[:, :n, : degree * n] = np.eye(degree * n).reshape(degree, n, -1)
    out[:, n:, inner + n : inner + own] = np.eye(own - n)
    return out


@lru_cache(maxsize=64)
def _units(rows: int, columns: int, first: int = 0) -> Array:
    """Read-only (rows, columns): the identity, shifted to begin at column `first`."""
    return np.eye(rows, columns, first)
