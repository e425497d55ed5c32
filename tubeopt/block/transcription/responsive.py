"""How an arm in equilibrium answers to whatever changes: the one linearisation.

A turn psi of the frame about world axes changes the rest of `standing` by

    psi' = R du,     db = (R'(dm - psi x m))_xy,     dm' = n x (psi x e) - e x dn.

These equations are collocated where the equilibrium was. The state (phi, psi, t, m) at the end of a piece is linear in
that where it begins; plate and tip close the chain. A breakpoint that moves uncovers a stretch with other tubes, which
is a jump of the rates there. Without a load m, n and l are 0: phi and t close the chain, and psi follows.
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
    """What Q parameters change at fixed arc lengths: alpha (n, Q), int ds / kt up to the plate (n, Q); at the points
    phase, kb and m (P, K, 3 n, Q), 1 / kt (P, K, n, Q) and the force (P, K, 3, Q); what the state gains between the
    pieces (P + 1, 2 n + 6, Q), and by which `side` of what acts there."""

    base: Array
    transmission: Array
    data: Array
    rate: Array
    force: Array
    jumps: Array
    side: int


class Forced(NamedTuple):
    """What is forced of phi', t', u and m' at the points, by columns (P, K, r, C)."""

    phi: Array
    torque: Array
    curvature: Array
    moment: Array


class Felt(NamedTuple):
    """Change of t and m at the points, of t' beside u (P, K, n + 2, C), of m', and of phi' at fixed t, by columns
    (P, K, r, C); None where phi' is of the torques alone."""

    torque: Array
    moment: Array
    bending: Array
    falling: Array
    turning: Array | None


@dataclass(frozen=True, eq=False)
class Maps:
    """Linear maps of P pieces: the `matrix` (P, r, r) of the equations of phi, then of u, at the points, r = K (n + 2),
    the state at the ends `gathered` (P, 2 n + 6, r) from them, and both by the state where the pieces begin, `inner`
    (P, r, 2 n + 6) and `ends` (P, 2 n + 6, 2 n + 6). Without a load u follows from phi, and r = K n."""

    matrix: Array
    gathered: Array
    inner: Array
    ends: Array


@dataclass(frozen=True, eq=False)
class Response:
    """Change of an arm at fixed arc lengths: the state (P + 1, 2 n + 6, Q) where pieces begin, and at the tip;
    phi (P, K, n, Q) and psi (P, K, 3, Q) at the points. The rest is computed when it is first read: `felt` gives what
    phi and psi make at the points, and `across` what b is by psi and m, None without a load."""

    state: Array
    phi: Array
    psi: Array
    felt: Callable[[], Felt]
    across: tuple[Array, Array] | None

    @cached_property
    def _felt(self) -> Felt:
        return self.felt()

    @property
    def torque(self) -> Array:
        """(P, K, n, Q) of t."""
        return self._felt.torque

    @property
    def moment(self) -> Array:
        """(P, K, 3, Q) of m."""
        return self._felt.moment

    @cached_property
    def bent(self) -> Array:
        """(P, K, 2, Q) of b."""
        if self.across is None:
            return np.zeros((*self.psi.shape[:2], 2, self.psi.shape[3]))
        by_turn, by_moment = self.across
        return np.asarray(by_turn @ self.psi + by_moment @ self.moment)

    @property
    def curvature(self) -> Array:
        """(P, K, 2, Q) of u."""
        return self._felt.bending[..., -2:, :]


class Responsive(Standing):
    """An arm in equilibrium, and how it answers."""

    @property
    def size(self) -> int:
        """Length of a state: rotations, turn of the frame, torques, moment. The chain is of the rows `kept`: without a
        load, of rotations and torques."""
        return 2 * self.n + 6

    @property
    def unknowns(self) -> int:
        """Unknowns r of a piece: phi at its points and, under a load, u."""
        return self.degree * (self.n if self.own == self.n else self.n + 2)

    @cached_property
    def _across(self) -> tuple[Array, Array]:
        """At the points, of b by psi and by m."""
        return self.across @ self.about_moment, self.across

    @cached_property
    def _leaning(self) -> Array:
        """(P, K, 3, 3) of m' by psi."""
        return np.asarray(hat(-self.force) @ self.about_axis)

    @cached_property
    def _by(self) -> Array:
        """(P, K, n + 2, n + 2) of M beside u by theta beside b at the points."""
        return self.at.by.reshape(self.pieces, self.degree, self.n + 2, self.n + 2)

    def _by_state(self, softness: float) -> tuple[Array, Array | None]:
        """(P, K, n + 2, own) of t' beside u by (phi, psi) and, under a load, (P, K, n + 2, 3) by m."""
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
        """(P, K, r, C) integrals of rates (P, K, r, C) by the matrices (P, K, K) of the pieces."""
        out = matrix @ rates.reshape(self.pieces, self.degree, -1)
        return np.asarray(out.reshape(rates.shape))

    def _felt(self, q: Array, starts: tuple[Array, Array], forced: Forced | None, softness: float = 1.0) -> Felt:
        """What changes of (phi, psi) at the points, by columns (P, K, own, C), and of t and m where the pieces begin
        (P or 1, 1, r, C) make there."""
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
        return Felt(torque, moment, bending, falling, turning)

    def _unforced(self, softness: float) -> Felt:
        """`_felt` by columns of phi, then of u, at the points, then of the state where the pieces begin."""
        n, k, own, size, inner = self.n, self.degree, self.own, 2 * self.own, self.unknowns
        begin = _units(size, inner + size, inner)
        starts = begin[own : own + n], begin[own + n :]
        q = np.empty((self.pieces, k, own, inner + size))
        q[:] = _own_units(n, k, own)
        if own > n:  # psi is the integral of R u
            turned = self.frame[:, None, :, :, :2].swapaxes(2, 3)
            np.multiply(self.ahead[:, :, None, :, None], turned, out=q[..., n:, k * n : inner].reshape(-1, k, 3, k, 2))
        return self._felt(q, starts, None, softness)

    def _ended(self, felt: Felt, softness: float) -> tuple[Array, Array]:
        """(P, r, C) integrals of the rates of phi up to the points, and u there, and (P, 2 own, C) of the rates of the
        state along whole pieces."""
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
        """The linear maps of all pieces."""
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
        """Of the arm as it stands."""
        return self._maps(1.0)

    def _forced_maps(self, forced: Forced) -> tuple[Array, Array]:
        """(P, r, C) of phi and u at the points and (P, 2 own, C) of the state at the ends of the pieces by what is
        forced."""
        count, maps = forced.phi.shape[-1], self._standing_maps
        none = np.zeros((1, self.degree, self.own, count)), (np.zeros((self.n, count)), np.zeros((3, count)))
        there, end = self._ended(self._felt(*none, forced), 1.0)
        solved = np.asarray(np.linalg.solve(maps.matrix, there))
        return solved, self._past(end, 1) + maps.gathered @ solved

    def _past(self, states: Array, first: int) -> Array:
        """States (P + 1 - first, 2 own, C) at the places from the `first` on, past the moments that act there: changed
        in place, from the plate's side to the tip's."""
        for k, tube, moment in self.joints:
            if k >= first:
                turn = states[k - first, self.n : self.n + 3]
                states[k - first, self.own + tube] -= cross(self.end_frame[k, :, 2], moment) @ turn
        return states

    def _system(self, softness: float, ends: Array, turns: Array | None = None) -> Array:
        """The matrix of torques and moment (own) at the plate, and of the states where pieces begin (P, 2 own);
        `turns` (P, 2 own, 3) is what a turn of the tip makes of these, with which a force turns."""
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
        """(P, K, 3, 3) change of m' by the turn of the tip, with which a force turns; None of dead forces."""
        if not (self.following and self.tip_force.any()):
            return None
        return np.asarray(self.about_axis @ hat(self.tip_force))

    def respond(self, forcing: Forcing) -> Response:
        """How the arm answers to changes.

        Raises:
            SolveError: the equilibrium is a fold.
        """
        n, own, size, count = self.n, self.own, 2 * self.own, forcing.base.shape[1]
        first = np.zeros((size, count))
        first[:n] = forcing.base + forcing.transmission * self.torque_plate_side[0][:, None]
        if not self.pieces:
            nothing = [np.zeros((0, self.degree, rows, count)) for rows in (n, 3, n + 2)]
            # What leaves the plate twists the transmissions.
            state, torque = forcing.jumps.copy(), slice(n + 3, 2 * n + 3)
            state[0, :n] += first[:n] - self.transmission[:, None] * state[0, torque]
            state[0, torque] = 0.0
            felt = Felt(nothing[0], nothing[1], nothing[2], nothing[1], None)
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
        # What is known at the plate goes to the right-hand side through the first piece.
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
        """(P + 1, 2 n + 6, Q) states of (P + 1, 2 own, Q): without a load psi and m are 0."""
        out = np.zeros((len(state), self.size, state.shape[2]))
        out[:, self.kept] = state
        return out

    @property
    def _turns(self) -> int:
        """Columns of the turn of the tip."""
        return 0 if self.turning is None else 3

    def _forced(self, forcing: Forcing) -> tuple[Forced | None, Index]:
        """What is forced at the points by the turn of the tip and by the changes that force anything there, and which
        of the changes these are."""
        extra, parts = self._turns, (forcing.data, forcing.rate, forcing.force)
        if not extra and not any(part.any() for part in parts):
            return None, np.zeros(0, dtype=np.intp)
        some = [part.any((0, 1, 2)) for part in parts]
        columns: Index = np.flatnonzero(some[0] | some[1] | some[2])
        data, rate, force = (part[..., columns] for part in parts)
        torque_by, u_by, _, phi_by = self.by_data
        turning = rate * self.stretched[..., None]
        if phi_by is not None:
            turning += phi_by @ data
        made = [turning, torque_by @ data, u_by @ data, -self.about_axis @ force]
        if self.turning is not None:
            # Three more columns: a force that turns with the tip is forced by its unknown turn.
            made = [np.concatenate([np.zeros((*p.shape[:3], extra)), p], axis=3) for p in made]
            made[3][..., :extra] = self.turning
        return Forced(*made), columns

    def _along(self, state: Array, q: Array, forced: Forced | None, softness: float) -> Response:
        """The response, of states (P + 1, 2 n + 6, Q) and phi and u at the points (P, r, Q). Without a load the states
        have, of psi, what it gains between the pieces."""
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
        """(P, K, 3, Q) psi at the points, of states and u (P, K, 2, Q)."""
        return np.asarray(state[:-1, None, self.n : self.n + 3] + self._swept(self.ahead, self.frame[..., :2] @ bends))

    def wound(self, response: Response, forcing: Forcing, piece: int) -> Array:
        """(K, n, Q) change of phi' at the points of a piece."""
        out = self.winding[piece, ..., None] * response.torque[piece]
        out += self.stretched[piece, ..., None] * forcing.rate[piece]
        if self.coupled is not None:
            out += self.coupled[piece] @ response.phi[piece]
            by_data = self.by_data[3]
            assert by_data is not None
            out += by_data[piece] @ forcing.data[piece]
        return np.asarray(out)

    def pulled(self, pull: Array, softness: float) -> Response:
        """The mode in which torques fall by (P, K, n) towards the plate, and nothing bends: one column."""
        n = self.n
        torque, tip_side, _ = self._inwards(-pull, np.zeros(n))
        rates, state = softness * self.rate * torque, np.zeros((self.pieces + 1, self.size, 1))
        whole = np.concatenate([softness * self.transmission * tip_side[:1], (self.weights[..., None] * rates).sum(1)])
        state[:, :n, 0], state[:, n + 3 : 2 * n + 3, 0] = np.cumsum(whole, axis=0), tip_side
        phi = state[:-1, None, :n, 0] + self.ahead @ rates
        none = np.zeros((*self.axis.shape[:2], n + 2, 1))
        felt = Felt(torque[..., None], none[..., :3, :], none, none[..., :3, :], None)
        return Response(state, phi[..., None], none[..., :3, :], lambda: felt, None)

    def mode(self, margin: float, *, one_of_two: bool = False) -> tuple[Response, float] | None:
        """How the arm buckles when its elasticity is softened by its margin, one column, and 1 / (1 - margin); None
        where the mesh is too coarse to show how, or two ways are equally easy and not `one_of_two` will do."""
        known = margin
        for _ in range(MODE_STEPS):
            # Beside the eigenvalue itself, where there would be nothing left to divide by.
            # Inverse iteration close to the eigenvalue: one step from any start gives the mode but for others.
            beside = margin - ASIDE
            softness = 1 / (1 - beside)
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
            # What the second start has beside the first mode.
            other = np.abs(grown[:, 1] - result * ((result @ grown[:, 1]) / (result @ result))).max()
            state = self._state(result, softness)
            inner = maps.inner @ state[:-1]
            mode = self._along(state if self.own > self.n else self._whole(state), inner, None, softness)
            margin = self.quotient(mode, softness)
            # Every mode grows by one over its distance, and is mixed into this one by as much.
            if abs(margin - beside) * size < DOUBLE * other:
                if not one_of_two:
                    return None
                break
            if other < MIXED * size:
                break
        return (mode, softness) if abs(margin - known) < SAME_MODE else None

    def _state(self, result: Array, softness: float) -> Array:
        """(P + 1, 2 own, 1) states where pieces begin, of torques and moment at the plate and what follows."""
        n, own = self.n, self.own
        state = np.zeros((self.pieces + 1, 2 * own, 1))
        state[1:, :, 0] = result[own:].reshape(self.pieces, 2 * own)
        state[0, own:, 0] = result[:own]
        state[0, :n, 0] = softness * self.transmission * result[:n]
        return state

    def elastic(self, mode: Response, softness: float) -> float:
        """The elastic part T of the second variation along a mode, one column."""
        torque, bent, held = mode.torque[..., 0], mode.bent[..., 0], mode.state[0, self.n + 3 : 2 * self.n + 3, 0]
        # int t^2 / kt + |b|^2 / K: energies by torques and moments, of an elasticity softened by the factor.
        density = (self.rate * torque**2).sum(2) + (bent**2).sum(2) / self.stiffness.sum(2)
        return float(softness**2 * ((self.weights * density).sum() + self.transmission @ held**2))

    def quotient(self, mode: Response, softness: float) -> float:
        """Second variation over its elastic part T along a mode, one column."""
        y, psi, curved = (part[..., 0] for part in (mode.phi, mode.psi, mode.curvature))
        bending = (self.frame[..., :2] @ curved[..., None])[..., 0]
        form = (y * (self._by[..., : self.n, : self.n] @ y[..., None])[..., 0]).sum(2)
        if self.load is not None:
            # Work of the forces and moments in the second order of the turn psi.
            form -= (self.force * cross(psi, cross(psi, self.axis)) + self.moment * cross(psi, bending)).sum(2)
        return 1.0 + float((self.weights * form).sum()) / self.elastic(mode, softness)


MODE_STEPS = 4
"""How often a mode is sought at most, each time at the quotient of the one before."""

MIXED = 3e-7
"""Part of another mode that a mode may have; the margin's derivative is off by about as much."""

SAME_MODE = 1e-6
"""Difference of the margin up to which a mode is that of the margin."""

ASIDE = 1e-12
"""By how much less than the margin an arm is softened to find how it buckles: more than round-off of the matrix, and
far less than DOUBLE."""

DOUBLE = 1e-9
"""Eigenvalues closer than this are one, whose mode, and so derivative, is not known."""


@lru_cache(maxsize=64)
def _own_units(n: int, degree: int, own: int) -> Array:
    """(K, own, r + 2 own) phi and psi at the points of a piece, by phi and u there, but for what u turns, and by the
    state where it begins; not to be changed."""
    inner = degree * (n if own == n else n + 2)
    out = np.zeros((degree, own, inner + 2 * own))
    out[:, :n, : degree * n] = np.eye(degree * n).reshape(degree, n, -1)
    out[:, n:, inner + n : inner + own] = np.eye(own - n)
    return out


@lru_cache(maxsize=64)
def _units(rows: int, columns: int, first: int = 0) -> Array:
    """(rows, columns) 1 in the columns from the first one on, one by one, 0 elsewhere; not to be changed."""
    return np.eye(rows, columns, first)
