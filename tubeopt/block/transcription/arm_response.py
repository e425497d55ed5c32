"""Linearised response of an arm in equilibrium to changes of its joints, dimensions and loads.

A turn psi of the frame about world axes changes the quantities of `arm_state` by

    psi' = R du,     db = (R'(dm - psi x m))_xy,     dm' = n x (psi x e) - e x dn.

The equations are collocated at the points of the equilibrium. The state (phi, psi, t, m) at the end of an element is
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
from ...physics.shape import cross, hat
from ...typing import Array, Index
from .arm_state import ArmState
from .loaded import LoadedState, evaluate
from .loaded import unknowns as loaded_unknowns
from .reduced import torsional_hessian
from .second_variation import modes


@dataclass(frozen=True, eq=False)
class Forcing:
    """Changes of the equations by Q parameters, at fixed arc lengths."""

    alpha: Array
    """Change (n, Q) of the rotations alpha."""
    transmission: Array
    """Change (n, Q) of int ds / kt from clamp to plate."""
    data: Array
    """Change (P, K, 3 n, Q) of phase, kb and m at the points."""
    compliance: Array
    """Change (P, K, n, Q) of the torsional compliance 1 / kt."""
    force: Array
    """Change (P, K, 3, Q) of the force."""
    jumps: Array
    """Jump (P + 1, 2 n + 6, Q) of the state at the ends of the elements."""
    side: int
    """Side of the joints at which the moments jump: -1 towards the plate, 1 towards the tip."""


class Forced(NamedTuple):
    """Forced parts of phi', t', u and m' at the points, by columns (P, K, r, C)."""

    phi: Array
    torque: Array
    curvature: Array
    moment: Array


class PointChanges(NamedTuple):
    """Changes at the points, by columns (P, K, r, C)."""

    torque: Array
    """Change of the torques t."""
    moment: Array
    """Change of the bundle moment m."""
    bending: Array
    """Change (P, K, n + 2, C) of t' above u."""
    moment_rate: Array
    """Change of the moment's derivative m'."""
    twist: Array | None
    """Change of phi' at fixed t; None if phi' depends on torques only."""


class Maps(NamedTuple):
    """Linear maps of P elements from r = K (n + 2) unknowns each: phi and u at the points.

    Without a load r = K n.
    """

    matrix: Array
    """Equations (P, r, r) of the unknowns."""
    end_by_unknowns: Array
    """State (P, 2 n + 6, r) at the end of an element by its unknowns."""
    unknowns: Array
    """Unknowns (P, r, 2 n + 6) by the state at the start."""
    end: Array
    """State (P, 2 n + 6, 2 n + 6) at the end by the state at the start."""


class ResponseChain:
    """Band matrix of the equations that join the elements.

    Args:
        size: number of equations.
        lower: number of diagonals below the main one.
        upper: number of diagonals above it.
    """

    def __init__(self, size: int, lower: int, upper: int) -> None:
        self.lower, self.upper = lower, upper
        # LAPACK has entry (i, j) at lower + upper + i - j in the storage of column j: the first `lower` places are for
        # what pivoting fills in. Read with columns that are one place shorter, the storage is the matrix.
        depth = 2 * lower + upper + 1
        self._storage = np.zeros((size, depth))
        step, first = self._storage.itemsize, self._storage.itemsize * (lower + upper)
        self.entries = np.ndarray((size, size), float, self._storage, first, (step, step * (depth - 1)))
        """Matrix (size, size), to be read and written within the band only."""

    def diagonal(self, k: int) -> Array:
        """Matrix entries (i, i + k) of the k-th diagonal, ordered by column."""
        return self._storage[:, self.lower + self.upper - k]

    def solve(self, right: Array) -> Array | None:
        """Solutions (size, C) for right-hand sides (size, C); None if the matrix is singular."""
        *_, out, singular = scipy.linalg.lapack.dgbsv(self.lower, self.upper, self._storage.T, right)
        return None if singular or not np.isfinite(out).all() else np.asarray(out)


@dataclass(frozen=True, eq=False)
class Response:
    """Change of an arm at fixed arc lengths; further quantities are computed on first use."""

    state: Array
    """State (P + 1, 2 n + 6, Q) where elements begin, and at the tip."""
    phi: Array
    """Rotations (P, K, n, Q) at the points."""
    psi: Array
    """Turn (P, K, 3, Q) of the frame at the points."""
    point_changes: Callable[[], PointChanges]
    """Returns the changes at the points."""
    moment_slopes: Array | None
    """Derivative (P, K, 2, 6) of b by psi and m; None without a load."""

    @cached_property
    def _changes(self) -> PointChanges:
        return self.point_changes()

    @property
    def torque(self) -> Array:
        """Change (P, K, n, Q) of the torques t."""
        return self._changes.torque

    @property
    def moment(self) -> Array:
        """Change (P, K, 3, Q) of the bundle moment m."""
        return self._changes.moment

    @cached_property
    def bending_moment(self) -> Array:
        """Change (P, K, 2, Q) of the bending moment b."""
        if self.moment_slopes is None:
            return np.zeros((*self.psi.shape[:2], 2, self.psi.shape[3]))
        return np.asarray(self.moment_slopes[..., :3] @ self.psi + self.moment_slopes[..., 3:] @ self.moment)

    @property
    def curvature(self) -> Array:
        """Change (P, K, 2, Q) of the curvature u."""
        return self._changes.bending[..., -2:, :]


class LinearisedArm(ArmState):
    """An arm in equilibrium, with its linearised response."""

    @property
    def size(self) -> int:
        """Length of a state (phi, psi, t, m); the chain has its rows `chain_rows`."""
        return 2 * self.n + 6

    @property
    def unknowns(self) -> int:
        """Number r of unknowns of an element: phi at its points and, under a load, u."""
        return self.degree * (self.n if self.load is None else self.n + 2)

    @cached_property
    def _moment_slopes(self) -> Array:
        """Derivative (P, K, 2, 6) of b at the points by psi and m."""
        # b = R'm changes by R'(dm + m x psi): the turn of the frame acts through m.
        return np.concatenate([self.across @ self.about_moment, self.across], axis=3)

    @cached_property
    def _moment_rate_slopes(self) -> Array:
        """Derivative (P, K, 3, 3) of m' by psi."""
        return np.asarray(hat(-self.force) @ self.about_axis)

    @cached_property
    def _slopes(self) -> Array:
        """Derivative (P, K, n + 2, n + 2) of M and u by theta and b at the points."""
        return self.at.slopes.reshape(self.elements, self.degree, self.n + 2, self.n + 2)

    @cached_property
    def _bending_slopes(self) -> Array:
        """Derivatives of t' and u at the points.

        They are by phi (P, K, n + 2, n) without a load, else by (phi, psi, m) (P, K, n + 2, n + 6).
        """
        n = self.n
        if self.load is None:
            return self._slopes[..., :n]
        out = np.empty((self.elements, self.degree, n + 2, n + 6))
        out[..., :n] = self._slopes[..., :n]
        np.matmul(self._slopes[..., n:], self._moment_slopes, out=out[..., n:])
        if self.moment_density is not None:
            out[..., :n, n : n + 3] -= cross(self.axis[..., None, :], self.moment_density)
        return out

    def _integrated(self, matrix: Array, rates: Array) -> Array:
        """Integrals (P, K, r, C) of `rates` (P, K, r, C) by the integration matrices (P, K, K) of the elements."""
        out = matrix @ rates.reshape(self.elements, self.degree, -1)
        return np.asarray(out.reshape(rates.shape))

    def _point_changes(self, q: Array, starts: Array, forced: Forced | None) -> PointChanges:
        """Changes at the points for given changes of (phi, psi) there; loads do not change with phi alone.

        Args:
            q: changes (P, K, half, C) at the points.
            starts: changes (P or 1, 1, half, C) of t and m where the elements begin.
            forced: forced parts.
        """
        n, half, slopes = self.n, self.half, self._bending_slopes
        bending = slopes[..., :half] @ q
        if self.load is None:
            moment = moment_rate = np.zeros((self.elements, self.degree, 3, q.shape[3]))
        else:
            moment_rate = self._moment_rate_slopes @ q[..., n:, :]
            if forced is not None:
                moment_rate += forced.moment
            moment = self._integrated(self.back, moment_rate)
            moment += starts[:, :, n:]
            bending += slopes[..., half:] @ moment
        if forced is not None:
            bending[..., :n, :] += forced.torque
            bending[..., n:, :] += forced.curvature
        torque = self._integrated(self.back, bending[..., :n, :])
        torque += starts[:, :, :n]
        twist = None if self.twist_slopes is None else self.twist_slopes @ q[..., :n, :]
        if forced is not None:
            twist = forced.phi if twist is None else twist + forced.phi
        return PointChanges(torque, moment, bending, moment_rate, twist)

    def _integrals(self, changes: PointChanges) -> tuple[Array, Array]:
        """Integrals of phi' (with u) up to the points, (P, r, C), and of the rates of the state, (P, 2 half, C).

        The first integrates phi', and contains u after it.
        """
        n, half, k, count = self.n, self.half, self.degree, changes.torque.shape[-1]
        rates = np.empty((self.elements, k, 2 * half, count))
        np.multiply(self.twist_compliance[..., None], changes.torque, out=rates[..., :n, :])
        if changes.twist is not None:
            rates[..., :n, :] += changes.twist
        rates[..., half : half + n, :] = changes.bending[..., :n, :]
        inner = np.empty((self.elements, self.unknowns, count))
        if self.load is not None:
            curvature = changes.bending[..., n:, :]
            inner[:, k * n :].reshape(self.elements, 2, k, count)[:] = curvature.swapaxes(1, 2)
            np.matmul(self.frame[..., :2], curvature, out=rates[..., n:half, :])
            rates[..., half + n :, :] = changes.moment_rate
        phi_rates = rates[..., :n, :].reshape(self.elements, k, -1)
        np.matmul(self.ahead, phi_rates, out=inner[:, : k * n].reshape(self.elements, k, -1))
        end = self.weights[:, None] @ rates.reshape(self.elements, k, -1)
        return inner, end.reshape(self.elements, 2 * half, count)

    @cached_property
    def _maps(self) -> Maps:
        """Linear maps of all elements.

        Columns are phi and u at the points, (K, n) and (2, K), then the state where the element begins.
        """
        n, k, half, size, r = self.n, self.degree, self.half, 2 * self.half, self.unknowns
        q = np.empty((self.elements, k, half, r + size))
        q[:] = _units_at_points(n, k, half)
        if self.load is not None:
            # psi is the integral of R u: axis x or y of the frame at every point.
            axes = self.frame[..., :2].transpose(0, 2, 3, 1)[:, None].copy()
            np.multiply(self.ahead[:, :, None, None], axes, out=q[..., n:, k * n : r].reshape(-1, k, 3, 2, k))
        starts = _units(half, r + size, r + half)[None, None]
        inner, end = self._integrals(self._point_changes(q, starts, None))
        # The start of an element adds itself to phi at every point, and to the state at the end.
        next_row = r + size + 1
        inner[:, : k * n].reshape(self.elements, k, -1)[..., r::next_row] += 1.0
        end.reshape(self.elements, -1)[:, r::next_row] += 1.0
        self._turn_joint_moments(end, 1)
        # Equations of the points: unknowns less their own integrals; eliminated element by element.
        matrix = -inner[..., :r]
        matrix.reshape(self.elements, -1)[:, :: r + 1] += 1.0
        unknowns = np.asarray(np.linalg.solve(matrix, inner[..., r:]))
        return Maps(matrix, end[..., :r], unknowns, end[..., r:] + end[..., :r] @ unknowns)

    def _forced_maps(self, forced: Forced) -> tuple[Array, Array]:
        """Forced phi and u at the points (P, r, C), and states at the ends of the elements (P, 2 half, C)."""
        maps = self._maps
        none = np.zeros((1, self.degree, self.half, forced.phi.shape[-1]))
        inner, end = self._integrals(self._point_changes(none, none[:, :1], forced))
        solved = np.asarray(np.linalg.solve(maps.matrix, inner))
        return solved, self._turn_joint_moments(end, 1) + maps.end_by_unknowns @ solved

    def _turn_joint_moments(self, states: Array, first: int) -> Array:
        """States (P + 1 - first, 2 half, C) on the tip side of the moments at the ends of elements from number `first`
        on.

        They are changed in place, from the side of the plate to that of the tip.
        """
        for element, tube, moment in self.joint_moments:
            if element >= first:
                psi = states[element - first, self.n : self.n + 3]
                states[element - first, self.half + tube] -= cross(self.end_frame[element, :, 2], moment) @ psi
        return states

    def _chain(self, ends: Array, turns: Array | None = None) -> ResponseChain:
        """Equations of (t, m) at the plate (half) and the states (P, 2 half) at the ends of the elements.

        Args:
            ends: maps (P, 2 half, 2 half) from the start of an element to its end.
            turns: change (P, 2 half, 3) of the states by a turn of the tip, with which a follower force turns.
        """
        n, half, size = self.n, self.half, 2 * self.half
        total = half + self.elements * size
        chain = ResponseChain(total, 3 * half - 1, half if turns is None else total - 1)
        matrix = chain.entries
        # States at the ends of the elements.
        chain.diagonal(half)[half:] = 1.0
        # Less those at their starts by the maps; theta at the plate turns by the transmission times the torque there.
        matrix[:size, :half] = -ends[0, :, half:]
        matrix[:size, :n] -= ends[0, :, :n] * self.transmission
        for k in range(1, self.elements):
            matrix[k * size : (k + 1) * size, half + (k - 1) * size : half + k * size] = -ends[k]
        last, tip_rows = total - size, slice(total - half, total)
        if turns is not None:
            matrix[: total - half, last + n : last + half] -= turns.reshape(-1, 3)
        # At the tip t and m do not change, but with the load and the frame.
        chain.diagonal(0)[tip_rows] = 1.0
        if self.load is None:
            return chain
        by_psi = matrix[tip_rows, last + n : last + half]
        if self.follower:
            # A moment that turns with the tip changes by psi x m.
            by_psi[n:] += hat(self.tip_moment)
        elif self.tip_moment.any():
            by_psi[self.tip_tube] -= cross(self.end_frame[-1, :, 2], self.tip_moment)
        return chain

    @cached_property
    def _follower_slopes(self) -> Array | None:
        """Derivative (P, K, 3, 3) of m' by the turn of the tip under a follower force; None under dead forces."""
        if not (self.follower and self.tip_force.any()):
            return None
        return np.asarray(self.about_axis @ hat(self.tip_force))

    def respond(self, forcing: Forcing) -> Response:
        """Response of the arm to changes.

        Raises:
            SolveError: the equilibrium is a fold.
        """
        n, half, size, count = self.n, self.half, 2 * self.half, forcing.alpha.shape[1]
        start = np.zeros((size, count))
        start[:n] = forcing.alpha + forcing.transmission * self.torque_plate_side[0][:, None]
        if not self.elements:
            return self._response_without_arm(forcing.jumps, start[:n])
        forced, columns = self._forced(forcing)
        maps, turned = self._maps, 0 if self._follower_slopes is None else 3
        inner, ends = (None, None) if forced is None else self._forced_maps(forced)
        chain = self._chain(maps.end, ends[..., :turned] if ends is not None and turned else None)
        jumps = forcing.jumps[:, self.chain_rows]
        if forcing.side < 0:
            self._turn_joint_moments(jumps, 0)
        start += jumps[0]
        right = np.zeros((half + self.elements * size, count))
        table = right[:-half].reshape(self.elements, size, count)
        if ends is not None:
            table[..., columns] = ends[..., turned:]
        # The known part at the plate enters the right-hand side through the first element.
        table[0] += maps.end[0] @ start
        table += jumps[1:]
        result = chain.solve(right)
        if result is None:
            raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
        state = self._states(result)
        state[0] += start
        q = maps.unknowns @ state[:-1]
        all_forced = None
        if forced is not None and inner is not None:
            q[..., columns] += inner[..., turned:]
            all_forced = Forced(*(np.zeros((*part.shape[:3], count)) for part in forced))
            for into, part in zip(all_forced, forced, strict=True):
                into[..., columns] = part[..., turned:]
            if self._follower_slopes is not None:
                tip_turn = state[-1, n : n + 3]
                q += inner[..., :turned] @ tip_turn
                all_forced.moment[:] += self._follower_slopes @ tip_turn
        if self.load is None:
            state = self._full_states(state)
            state[:, n : n + 3] = forcing.jumps[:, n : n + 3]
        return self._response(state, q, all_forced)

    def _response_without_arm(self, jumps: Array, turn: Array) -> Response:
        """Response of an arm of length zero with tubes turned by `turn` (n, Q) at the plate."""
        n, count = self.n, turn.shape[1]
        phi, vector, bending = (np.zeros((0, self.degree, rows, count)) for rows in (n, 3, n + 2))
        # Torques at the plate twist the transmissions.
        state, torque = jumps.copy(), slice(n + 3, 2 * n + 3)
        state[0, :n] += turn - self.transmission[:, None] * state[0, torque]
        state[0, torque] = 0.0
        changes = PointChanges(phi, vector, bending, vector, None)
        return Response(state, phi, vector, lambda: changes, None)

    def _states(self, result: Array) -> Array:
        """States (P + 1, 2 half, C) where elements begin, from a solution (half + P 2 half, C) of the chain."""
        n, half = self.n, self.half
        state = np.zeros((self.elements + 1, 2 * half, result.shape[1]))
        state[1:] = result[half:].reshape(self.elements, 2 * half, -1)
        state[0, half:] = result[:half]
        state[0, :n] = self.transmission[:, None] * result[:n]
        return state

    def _full_states(self, state: Array) -> Array:
        """States (P + 1, 2 n + 6, Q) from the states of the chain (P + 1, 2 half, Q).

        Without a load psi and m are 0.
        """
        out = np.zeros((len(state), self.size, state.shape[2]))
        out[:, self.chain_rows] = state
        return out

    def _forced(self, forcing: Forcing) -> tuple[Forced | None, Index]:
        """Changes at the points forced by the turn of the tip and by some of the changes, and the numbers of these."""
        parts = forcing.data, forcing.compliance, forcing.force
        if self._follower_slopes is None and not any(part.any() for part in parts):
            return None, np.zeros(0, dtype=np.intp)
        changed = [part.any((0, 1, 2)) for part in parts]
        columns: Index = np.flatnonzero(changed[0] | changed[1] | changed[2])
        data, compliance, force = (part[..., columns] for part in parts)
        by_data = self.data_slopes
        phi = compliance * self.stretched_torque[..., None]
        if by_data.rotation_rate is not None:
            phi += by_data.rotation_rate @ data
        forced = Forced(phi, by_data.torque @ data, by_data.curvature @ data, -self.about_axis @ force)
        if self._follower_slopes is not None:
            # Three more columns: a follower force changes with the unknown turn of the tip.
            forced = Forced(*(np.concatenate([np.zeros((*part.shape[:3], 3)), part], axis=3) for part in forced))
            forced.moment[..., :3] = self._follower_slopes
        return forced, columns

    def _response(self, state: Array, q: Array, forced: Forced | None) -> Response:
        """Response from states (P + 1, 2 n + 6, Q), and phi and u at the points (P, r, Q).

        Without a load the states have the jumps of psi between the elements in place of psi.
        """
        n, k, elements = self.n, self.degree, self.elements
        phi, starts = q[:, : k * n].reshape(elements, k, n, -1), state[:-1, None, n + 3 :]
        if self.load is not None:
            psi = self._psi(state, q[:, k * n :].reshape(elements, 2, k, -1).swapaxes(1, 2))

            def at_points() -> PointChanges:
                return self._point_changes(np.concatenate([phi, psi], axis=2), starts, forced)

            return Response(state, phi, psi, at_points, self._moment_slopes)
        changes = self._point_changes(phi, starts, forced)
        curvature = changes.bending[..., n:, :]
        turns = self.weights[:, None] @ (self.frame[..., :2] @ curvature).reshape(elements, k, -1)
        state[1:, n : n + 3] += turns.reshape(elements, 3, -1)
        # Without a load psi acts on nothing, so that it is summed afterwards.
        state[:, n : n + 3] = np.cumsum(state[:, n : n + 3], axis=0)
        return Response(state, phi, self._psi(state, curvature), lambda: changes, None)

    def _psi(self, state: Array, curvature: Array) -> Array:
        """Turn psi (P, K, 3, Q) at the points, from states and changes of u (P, K, 2, Q)."""
        turns = self._integrated(self.ahead, self.frame[..., :2] @ curvature)
        return np.asarray(state[:-1, None, self.n : self.n + 3] + turns)

    def twist_change(self, response: Response, forcing: Forcing, element: int) -> Array:
        """Change (K, n, Q) of phi' at the points of an element."""
        out = self.twist_compliance[element, ..., None] * response.torque[element]
        out += self.stretched_torque[element, ..., None] * forcing.compliance[element]
        if self.twist_slopes is not None:
            out += self.twist_slopes[element] @ response.phi[element]
            by_data = self.data_slopes.rotation_rate
            assert by_data is not None
            out += by_data[element] @ forcing.data[element]
        return np.asarray(out)

    def mode(self, margin: float, *, one_of_two: bool = False) -> tuple[Response, float] | None:
        """Buckling mode, one column, and the factor 1 / (1 - margin) by which the arm is softened.

        None if the margin is that of another mesh, or if it is double, unless `one_of_two` modes will do.
        """
        n, loaded, solved = self.n, self.loaded, self.mesh.collocated
        state: LoadedState | None = None
        if loaded is not None:
            theta, curvature = (table.reshape(-1, table.shape[-1]) for table in (self.phi, self.at.curvature))
            state = evaluate(loaded, self.alpha, loaded_unknowns(loaded, self.alpha, theta, curvature))
        hessian = torsional_hessian(self.problem, self._slopes[solved, :, :n, :n]) if state is None else state.hessian
        pair = modes(hessian, symmetric=True, any_of_two=one_of_two)
        if pair is None or abs(pair.value - margin) > SAME_MODE:
            return None
        y, softness = np.zeros((self.elements, self.degree, n)), 1 / (1 - margin)
        y[solved] = (self.problem.spread @ pair.right[: self.problem.size]).reshape(-1, self.degree, n)
        if state is None:
            return self.torsion_mode(-(self._slopes[..., :n, :n] @ y[..., None])[..., 0], softness), softness
        # dm' = -n x (e x psi): the moment of the mode by its turn psi, and its torques by both.
        bent = (state.curvature_slope @ pair.right).reshape(self.elements, self.degree, 2, 1)
        psi, psi_ends = self._from_plate((self.frame[..., :2] @ bent)[..., 0], np.zeros(3))
        moment_rate = (self._moment_rate_slopes @ psi[..., None])[..., 0]
        moment, moment_ends, _ = self._from_tip(-moment_rate, np.zeros(3))
        change = np.concatenate([y, psi, moment], axis=2)[..., None]
        torque_rate = self._bending_slopes[..., :n, :] @ change
        mode = self.torsion_mode(-torque_rate[..., 0], softness)
        mode.state[:, n : n + 3, 0], mode.state[:, 2 * n + 3 :, 0] = psi_ends, moment_ends
        bending = np.concatenate([torque_rate, bent], axis=2)
        changes = PointChanges(mode.torque, moment[..., None], bending, moment_rate[..., None], None)
        return Response(mode.state, mode.phi, psi[..., None], lambda: changes, self._moment_slopes), softness

    def torsion_mode(self, decrease: Array, softness: float) -> Response:
        """Mode without bending, one column, with torques that fall by `decrease` (P, K, n) towards the tip.

        The arm is softened by a factor.
        """
        n = self.n
        torque, tip_side, _ = self._from_tip(decrease, np.zeros(n))
        phi, ends = self._from_plate(softness * self.compliance * torque, softness * self.transmission * tip_side[0])
        state, none = np.zeros((self.elements + 1, self.size, 1)), np.zeros((*self.axis.shape[:2], n + 2, 1))
        state[:, :n, 0], state[:, n + 3 : 2 * n + 3, 0] = ends, tip_side
        changes = PointChanges(torque[..., None], none[..., :3, :], none, none[..., :3, :], None)
        return Response(state, phi[..., None], none[..., :3, :], lambda: changes, None)

    def elastic(self, mode: Response, softness: float) -> float:
        """Elastic part T of the second variation along a mode of one column, J."""
        torque, b = mode.torque[..., 0], mode.bending_moment[..., 0]
        plate_torque = mode.state[0, self.n + 3 : 2 * self.n + 3, 0]
        # int t^2 / kt + |b|^2 / K: energies by torques and moments, of an elasticity softened by the factor.
        density = (self.compliance * torque**2).sum(2) + (b**2).sum(2) / self.stiffness.sum(2)
        return float(softness**2 * ((self.weights * density).sum() + self.transmission @ plate_torque**2))


SAME_MODE = 1e-6
"""Largest difference of the eigenvalue of a mode from the margin."""


@lru_cache(maxsize=64)
def _units_at_points(n: int, degree: int, half: int) -> Array:
    """Read-only (K, half, r + 2 half) derivatives of phi and psi at the points.

    The derivatives are by phi at the points and by the state at the start.
    """
    r = degree * (n if half == n else n + 2)
    out = np.zeros((degree, half, r + 2 * half))
    out[:, :n, : degree * n] = np.eye(degree * n).reshape(degree, n, -1)
    out[:, n:, r + n : r + half] = np.eye(half - n)
    return out


@lru_cache(maxsize=64)
def _units(rows: int, columns: int, first: int = 0) -> Array:
    """Read-only (rows, columns): the identity, shifted to begin at column `first`."""
    return np.eye(rows, columns, first)
