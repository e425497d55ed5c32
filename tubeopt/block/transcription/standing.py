"""An arm in equilibrium, with a load or without, and how it answers to whatever changes: the one linearisation.

Along the arm the elastic rotations phi of the tubes, their torques t, the frame R and the moment m on the
cross-section, in world axes, obey

    phi' = t / kt,   t' = M(theta, b) - l.e,   R' = R hat(u),   m' = -e x n - l,
    b = (R'm)_xy,    u = (b + sum a_i) / sum kb_i,    e = R e3,    theta = phi + phase,

with the force n on the cross-section and the moment l per length, whose part along the arm the outermost tube feels. A
turn psi of the frame about world axes changes the rest by

    psi' = R du,     db = (R'(dm - psi x m))_xy,     dm' = n x (psi x e) - e x dn.

These equations are collocated where the equilibrium was. The state (phi, psi, t, m) at the end of a piece is linear in
that where it begins; plate and tip close the chain. A breakpoint that moves uncovers a stretch with other tubes, which
is a jump of the rates there. Without a load m, n and l are 0: phi and t close the chain, and psi follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from ...errors import SolveError
from ...robots.load import Load
from ...robots.order import last_tube
from ...typing import Array, Index
from .arm import ArmShape
from .buffered import bent_function
from .collocated import STEPS
from .couples import Couples
from .linear import poses_at_points
from .reduced import ReducedProblem

_HAT = np.array([[0.0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]])
"""The matrix of b -> a x b by rows, from a."""


def hat(a: Array) -> Array:
    """(..., 3, 3) matrices of b -> a x b of vectors a (..., 3)."""
    return np.asarray((a @ _HAT).reshape(*a.shape, 3))


def cross(a: Array, b: Array) -> Array:
    """(..., 3) cross product of vectors."""
    return np.asarray((hat(a) @ b[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class Burden:
    """A load on an arm: the force (N, 3) on the cross-sections, N, but for what turns with the tip, and its moments."""

    load: Load
    force: Array
    couples: Couples | None


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections at X places: torque (X, n) and bending energy (X,) per length, curvature (X, 2), and their
    derivatives (X, n, c), (X, 2, c), (X, c) by theta and b, c = n + 2."""

    torque: Array
    curvature: Array
    energy: Array
    by_torque: Array
    by_curvature: Array
    by_energy: Array


def sections_of(theta: Array, stiffness: Array, moment: Array, bent: Array) -> Sections:
    """Cross-sections of tubes (X, n) that bear bending moments (X, 2)."""
    count, n = theta.shape
    out = bent_function("linear", count, n)(theta, stiffness, moment, bent)
    torque, curvature, energy = (part.copy() for part in out[:3])
    return Sections(torque, curvature, energy[:, 0], *_by_rows(out[3:], n + 2))


def by_data_of(theta: Array, stiffness: Array, moment: Array, bent: Array) -> tuple[Array, Array, Array]:
    """Derivatives (X, n, 2 n), (X, 2, 2 n), (X, 2 n) of torque, curvature and energy there by kb and m."""
    count, n = theta.shape
    return _by_rows(bent_function("linear_data", count, n)(theta, stiffness, moment, bent), 2 * n)


def _by_rows(parts: list[Array], columns: int) -> tuple[Array, Array, Array]:
    """Derivatives (X, n, c), (X, 2, c), (X, c), of which CasADi stores (rows, c) by columns."""
    by = [part.reshape(-1, columns, part.shape[1]).swapaxes(1, 2).copy() for part in parts]
    return by[0], by[1], by[2][:, 0]


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


@dataclass(frozen=True, eq=False)
class Maps:
    """Linear maps of P pieces: the `matrix` (P, r, r) of the equations of (phi, psi) at the points, r = K (n + 3), the
    state at the ends `gathered` (P, 2 n + 6, r) from them, and both by the state where the pieces begin, `inner`
    (P, r, 2 n + 6) and `ends` (P, 2 n + 6, 2 n + 6)."""

    matrix: Array
    gathered: Array
    inner: Array
    ends: Array


@dataclass(frozen=True, eq=False)
class Response:
    """Change of an arm at fixed arc lengths: the state (P + 1, 2 n + 6, Q) just behind the places between the pieces;
    phi (P, K, n, Q), psi, m (P, K, 3, Q), t (P, K, n, Q), b (P, K, 2, Q) and u (P, K, 2, Q) at the points."""

    state: Array
    phi: Array
    psi: Array
    moment: Array
    torque: Array
    bent: Array
    curvature: Array


class Standing:
    """An arm in equilibrium: n tubes, P pieces with K points each.

    Args:
        problem: of the rotations, on the mesh of the arm.
        base: (n,) rotations, rad.
        solved: (N, n) elastic rotations at the collocation points of the problem.
        shape: of the arm.
        burden: what acts on it, None for nothing.
        straight: whether it matters where straight tubes would bend to.
    """

    def __init__(
        self,
        problem: ReducedProblem,
        base: Array,
        solved: Array,
        shape: ArmShape,
        *,
        burden: Burden | None = None,
        straight: bool = True,
    ) -> None:
        self.problem, self.base, self.shape = problem, base, shape
        self.mesh, self.t, self.length = problem.mesh, problem.mesh.tableau, problem.mesh.length
        self.n = problem.assembly.n_tubes
        self.pieces, self.degree = len(self.length), self.t.degree
        self.own = self.n if burden is None else self.n + 3
        self.kept = np.r_[: self.own, self.n + 3 : self.n + 3 + self.own]
        self.h = self.length[:, None, None]
        self.weights = self.length[:, None] * self.t.weights
        self.cuts = np.append(self.mesh.start, problem.assembly.total_length)
        self.sections = sections = problem.here.sections
        points = self.pieces, self.degree
        self.phase, self.stiffness, self.moments = (
            part.reshape(*points, self.n) for part in (sections.phase, sections.stiffness, sections.moment)
        )
        self.rate, self.transmission = problem.here.rate, problem.here.transmission
        self.frame, self.position = poses_at_points(self.t, self.length, (shape.frame, shape.position, shape.curvature))
        self.axis = self.frame[..., 2]
        self.end_frame = shape.frame[::STEPS]
        self._load(burden)
        self._moments()
        theta = np.zeros((*points, self.n))
        theta[self.mesh.collocated] = solved.reshape(-1, self.degree, self.n)
        self.theta = theta + self.phase
        self._torques(bent_function("torque", self.pieces * self.degree, self.n)(*self._tables)[0].copy())
        # Of tubes that are straight here theta is not solved for, but follows.
        if straight or not self.mesh.collocated.all():
            self.theta = self.phi + self.phase
        self.at = sections_of(*self._tables)

    # --- what stands --------------------------------------------------------------------------------------------------

    def _load(self, burden: Burden | None) -> None:
        """Forces, moments per length and on which tubes, moments at joints."""
        points = self.pieces, self.degree
        self.load = None if burden is None else burden.load
        self.following = self.load is not None and self.load.frame == "tip"
        given = (np.zeros(3),) * 2 if self.load is None else (np.array(self.load.force), np.array(self.load.moment))
        tip = self.shape.frame[-1]
        self.tip_force, self.tip_moment = (tip @ part if self.following else part for part in given)
        self.force = np.zeros((*points, 3))
        if burden is not None:
            self.force += burden.force.reshape(self.force.shape) + self.following * self.tip_force
        self.tip_tube = int(last_tube(self.problem.assembly.end))
        self.along: Array | None = None
        self.felt = np.zeros(self.phase.shape)
        self.joints: list[tuple[int, int, Array]] = []
        """Piece that begins at the moment, the tube it acts on, and the moment (3,)."""
        couples = None if burden is None else burden.couples
        if couples is not None:
            count = len(couples.joint)
            if len(couples.point):
                along = np.zeros((self.pieces * self.degree, 3))
                along[couples.point] = couples.moment[count:] / self.problem.weight[couples.point, None]
                self.felt.reshape(-1, self.n)[couples.point, couples.tube[count:]] = 1.0
                self.along = along.reshape(*points, 3)
            each = couples.joint.tolist(), couples.tube[:count].tolist(), couples.moment[:count]
            self.joints = [*zip(*each, strict=True)][1:]

    def _moments(self) -> None:
        """The moment m at the points, and just ahead of and just behind the places between the pieces, world axes."""
        kicks = np.zeros((self.pieces + 1, 3))
        if self.load is None:
            self.moment, self.moment_behind, self.moment_ahead = np.zeros(self.axis.shape), kicks, kicks
            self.bent = np.zeros((*self.axis.shape[:2], 2))
            return
        fall = cross(self.axis, self.force)
        if self.along is not None:
            fall += self.along
        for k, _, moment in self.joints:
            kicks[k] += moment
        self.moment, self.moment_behind, self.moment_ahead = self._inwards(fall, kicks, self.tip_moment)
        self.bent = (self.frame[..., :2].swapaxes(2, 3) @ self.moment[..., None])[..., 0]

    def _inwards(self, fall: Array, kicks: Array, tip: Array) -> tuple[Array, Array, Array]:
        """Integral from the tip of what falls (P, K, r) towards it, and at places (P + 1, r): at the points, behind and
        ahead of these places."""
        whole = (self.weights[..., None] * fall).sum(1)
        ahead = np.zeros_like(kicks)
        ahead[:-1] = np.cumsum(whole[::-1], axis=0)[::-1]
        ahead += tip + np.cumsum(kicks[::-1], axis=0)[::-1]
        behind = ahead - kicks
        return behind[:-1, None] - self.h * (self.t.adjoint @ fall), behind, ahead

    @property
    def _tables(self) -> tuple[Array, Array, Array, Array]:
        """theta, kb, m (P K, n) and b (P K, 2)."""
        theta, kb, m = (table.reshape(-1, self.n) for table in (self.theta, self.stiffness, self.moments))
        return theta, kb, m, self.bent.reshape(-1, 2)

    def _torques(self, gained: Array) -> None:
        """Torques t and rotations phi at the points, and between the pieces as `_moments`, from M (P K, n)."""
        fall = -gained.reshape(self.pieces, self.degree, self.n)
        if self.along is not None:
            fall += self.felt * (self.along * self.axis).sum(2)[..., None]
        kicks = np.zeros((self.pieces + 1, self.n))
        for k, tube, moment in self.joints:
            kicks[k, tube] += moment @ self.end_frame[k, :, 2]
        tip = np.zeros(self.n)
        tip[self.tip_tube] = self.tip_moment @ self.end_frame[-1, :, 2]
        self.torque, self.torque_behind, self.torque_ahead = self._inwards(fall, kicks, tip)
        turning = self.rate * self.torque
        whole = (self.weights[..., None] * turning).sum(1)
        first = self.base + self.transmission * self.torque_ahead[0]
        self.phi_ends = first + np.concatenate([np.zeros((1, self.n)), np.cumsum(whole, axis=0)])
        self.phi = self.phi_ends[:-1, None] + self.h * (self.t.matrix @ turning)

    # --- linear maps --------------------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Length of a state: rotations, turn of the frame, torques, moment. The chain is of the rows `kept`: without a
        load, of rotations and torques."""
        return 2 * self.n + 6

    @cached_property
    def _slopes(self) -> tuple[Array, ...]:
        """At the points: of b by psi and by m, of t' by psi, of m' by psi."""
        across = self.frame[..., :2].swapaxes(2, 3)
        twisting = np.zeros((*self.phi.shape, 3))
        if self.along is not None:
            twisting = -self.felt[..., None] * cross(self.axis, self.along)[..., None, :]
        leaning = (self.force * self.axis).sum(2)[..., None, None] * np.eye(3)
        return across @ hat(self.moment), across, twisting, leaning - self.axis[..., None] * self.force[..., None, :]

    @cached_property
    def _by(self) -> tuple[Array, ...]:
        """At the points: of M by theta and by b, of u by theta."""
        n, points = self.n, (self.pieces, self.degree)
        at = self.at.by_torque, self.at.by_curvature
        torque, curvature = (part.reshape(*points, *part.shape[1:]) for part in at)
        return torque[..., :n], torque[..., n:], curvature[..., :n]

    @cached_property
    def by_data(self) -> tuple[Array, Array, Array]:
        """At the points, of M (P, K, n, 3 n), u (P, K, 2, 3 n) and the energy (P, K, 3 n), by phase, kb and m."""
        n, points = self.n, (self.pieces, self.degree)
        own = by_data_of(*self._tables)
        turned = self.at.by_torque, self.at.by_curvature, self.at.by_energy
        out = [np.concatenate([a[..., :n], b], axis=-1) for a, b in zip(turned, own, strict=True)]
        return out[0].reshape(*points, n, -1), out[1].reshape(*points, 2, -1), out[2].reshape(*points, -1)

    def _swept(self, matrix: Array, rates: Array) -> Array:
        """(P, K, r, C) integrals of rates (P, K, r, C) by a matrix (K, K) of the tableau."""
        out = matrix @ rates.reshape(self.pieces, self.degree, -1)
        out *= self.h
        return np.asarray(out.reshape(rates.shape))

    def _felt(
        self, q: Array, starts: tuple[Array, Array], forcing: tuple[Array, ...] | None
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """What changes of (phi, psi) at the points, by columns (P, K, n + 3, C), and of t and m where the pieces begin
        (P or 1, 1, r, C) make there of t, m, b, of t' and m', and of u at fixed b."""
        n, (torque_by_phi, torque_by_bent, u_by_phi) = self.n, self._by
        phi, shape = q[..., :n, :], (self.pieces, self.degree)
        twisted, turned = torque_by_phi @ phi, u_by_phi @ phi
        if self.load is None:
            moment, bent = (np.zeros((*shape, rows, q.shape[3])) for rows in (3, 2))
            falling = moment
        else:
            (by_turn, across, twisting, leaning), psi = self._slopes, q[..., n:, :]
            falling = leaning @ psi
            if forcing is not None:
                falling += forcing[3]
            moment = self._swept(self.t.adjoint, falling)
            moment += starts[1]
            bent = across @ moment
            bent += by_turn @ psi
            twisted += torque_by_bent @ bent
            if self.along is not None:
                twisted += twisting @ psi
        if forcing is not None:
            twisted += forcing[1]
            turned += forcing[2]
        torque = self._swept(self.t.adjoint, twisted)
        torque += starts[0]
        return torque, moment, bent, twisted, falling, turned

    @cached_property
    def _unforced(self) -> tuple[Array, ...]:
        """`_felt` by columns of (phi, psi) at the points, then of the state where the pieces begin."""
        own, size, inner = self.own, 2 * self.own, self.degree * self.own
        table = np.zeros((inner, inner + size))
        table.ravel()[:: inner + size + 1] = 1.0
        begin = np.zeros((size, inner + size))
        begin[:, inner:] = np.eye(size)
        q = table.reshape(1, self.degree, own, -1)
        return self._felt(q, (begin[own : own + self.n], begin[own + self.n :]), None)

    def _ended(self, felt: tuple[Array, ...], turned: Array | None, softness: float) -> tuple[Array, Array]:
        """(P, K own, C) integrals of the rates of (phi, psi) up to the points and (P, 2 own, C) of those of the state
        along whole pieces, from `_felt` and what is forced of phi'."""
        (torque, _, bent, twisted, falling, bending), n, own, k = felt, self.n, self.own, self.degree
        count = torque.shape[-1]
        rates, end = np.empty((self.pieces, k, own, count)), np.empty((self.pieces, 2 * own, count))
        np.multiply(torque, softness * self.rate[..., None], out=rates[..., :n, :])
        if turned is not None:
            rates[..., :n, :] += turned
        parts = [(rates, slice(own)), (twisted, slice(own, own + n))]
        if own > n:
            np.matmul(self.frame[..., :2], bent * (softness * self._give) + bending, out=rates[..., n:, :])
            parts.append((falling, slice(own + n, None)))
        weights = self.weights[:, None]
        for part, rows in parts:
            np.matmul(weights, part.reshape(self.pieces, k, -1), out=end[:, rows].reshape(self.pieces, 1, -1))
        return self._swept(self.t.matrix, rates).reshape(self.pieces, k * own, count), end

    def _maps(self, softness: float) -> Maps:
        """The linear maps of all pieces."""
        own, size, inner = self.own, 2 * self.own, self.degree * self.own
        there, end = self._ended(self._unforced, None, softness)
        table = there.reshape(self.pieces, self.degree, own, -1)
        table[..., inner:] += np.eye(own, size)
        matrix = -there[..., :inner]
        matrix.reshape(self.pieces, -1)[:, :: inner + 1] += 1.0
        solved = np.asarray(np.linalg.solve(matrix, there[..., inner:]))
        ends = end[..., inner:] + np.eye(size) + end[..., :inner] @ solved
        return Maps(matrix, end[..., :inner], solved, ends)

    @cached_property
    def _standing_maps(self) -> Maps:
        """Of the arm as it stands."""
        return self._maps(1.0)

    def _forced_maps(self, forcing: tuple[Array, ...]) -> tuple[Array, Array]:
        """(P, K own, C) of (phi, psi) at the points and (P, 2 own, C) of the state at the ends of the pieces by
        what is forced."""
        count, maps = forcing[0].shape[-1], self._standing_maps
        none = np.zeros((1, self.degree, self.own, count)), (np.zeros((self.n, count)), np.zeros((3, count)))
        there, end = self._ended(self._felt(*none, forcing), forcing[0], 1.0)
        solved = np.asarray(np.linalg.solve(maps.matrix, there))
        return solved, end + maps.gathered @ solved

    @cached_property
    def _give(self) -> Array:
        """(P, K, 1, 1) of u by b: one over the bending stiffness of all tubes."""
        return np.asarray(1 / self.stiffness.sum(2))[..., None, None]

    def _kicked(self) -> Array | None:
        """(P + 1, 2 n + 6, 2 n + 6) the state just behind a place by that just ahead of it; None where no moment acts
        between pieces."""
        if not self.joints:
            return None
        out = np.tile(np.eye(self.size), (self.pieces + 1, 1, 1))
        for k, tube, moment in self.joints:
            out[k, self.n + 3 + tube, self.n : self.n + 3] -= cross(self.end_frame[k, :, 2], moment)
        return out

    def _system(self, softness: float, ends: Array, turns: Array | None = None) -> Array:
        """The matrix of torques and moment (own) at the plate, and of the states behind the places (P, 2 own);
        `turns` (P, 2 own, 3) is what a turn of the tip makes of these, with which a force turns."""
        n, size, own, pieces = self.n, 2 * self.own, self.own, self.pieces
        total = own + pieces * size
        matrix = np.zeros((total, total))
        kicks = self._kicked()
        maps = ends if kicks is None else kicks[1:] @ ends
        first = np.zeros((size, own))
        first[own:] = np.eye(own)
        first[range(n), range(n)] = softness * self.transmission
        matrix[: pieces * size].reshape(-1)[own :: total + 1] = 1.0
        matrix[:size, :own] = -maps[0] @ first
        for k in range(1, pieces):
            matrix[k * size : (k + 1) * size, own + (k - 1) * size : own + k * size] = -maps[k]
        if turns is not None:
            turn = slice(total - size + n, total - size + own)
            matrix[: pieces * size, turn] -= (turns if kicks is None else kicks[1:] @ turns).reshape(-1, 3)
        last, rows = total - size, slice(pieces * size, total)
        matrix[rows, last + own :] = np.eye(own)
        if own == n:
            return matrix
        tip = matrix[rows, last + n : last + own]
        if self.following:
            tip[n:] += hat(self.tip_moment)
        else:
            tip[self.tip_tube] -= cross(self.end_frame[-1, :, 2], self.tip_moment)
        return matrix

    @cached_property
    def turning(self) -> Array | None:
        """(P, K, 3, 3) change of m' by the turn of the tip, with which a force turns; None of dead forces."""
        if not (self.following and self.tip_force.any()):
            return None
        return np.asarray(hat(self.axis) @ hat(self.tip_force))

    def respond(self, forcing: Forcing) -> Response:
        """How the arm answers to changes.

        Raises:
            SolveError: the equilibrium is a fold.
        """
        n, own, size, count = self.n, self.own, 2 * self.own, forcing.base.shape[1]
        first = np.zeros((size, count))
        first[:n] = forcing.base + forcing.transmission * self.torque_ahead[0][:, None]
        if not self.pieces:
            nothing = [np.zeros((0, self.degree, rows, count)) for rows in (n, 3, 3, n, 2, 2)]
            state = forcing.jumps.copy()
            state[0, self.kept] += first
            return Response(state, *nothing)
        forced, columns = self._forced(forcing)
        maps, turned = self._standing_maps, self._turns
        inner, gained = (None, None) if forced is None else self._forced_maps(forced)
        matrix = self._system(1.0, maps.ends, None if gained is None or not turned else gained[..., :turned])
        right, kicks = np.zeros((len(matrix), count)), self._kicked()
        jumps = forcing.jumps[:, self.kept]
        if kicks is not None and forcing.side < 0:
            jumps = kicks @ jumps
        start = first + jumps[0]
        table = right[: self.pieces * size].reshape(self.pieces, size, count)
        if gained is not None:
            table[..., columns] = gained[..., turned:]
        table[0] += maps.ends[0] @ start
        if kicks is not None:
            table[:] = kicks[1:] @ table
        table += jumps[1:]
        *_, found, singular = scipy.linalg.lapack.dgesv(matrix, right)
        if singular or not np.isfinite(found).all():
            raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
        state = np.empty((self.pieces + 1, size, count))
        state[1:] = found[own:].reshape(self.pieces, size, count)
        state[0] = start
        state[0, own:] += found[:own]
        state[0, :n] += self.transmission[:, None] * found[:n]
        q = maps.inner @ state[:-1]
        wide = None
        if forced is not None and inner is not None:
            q[..., columns] += inner[..., turned:]
            wide = tuple(np.zeros((*part.shape[:3], count)) for part in forced)
            for whole, part in zip(wide, forced, strict=True):
                whole[..., columns] = part[..., turned:]
            if self.turning is not None:
                turn = state[-1, n : n + 3]
                q += inner[..., :turned] @ turn
                wide[3][:] += self.turning @ turn
        if self.load is None:
            state = self._whole(state)
            state[:, n : n + 3] = forcing.jumps[:, n : n + 3]
        return self._along(state, q, wide, 1.0)

    def _whole(self, state: Array) -> Array:
        """(P + 1, 2 n + 6, Q) states of the rows `kept`."""
        out = np.zeros((len(state), self.size, state.shape[2]))
        out[:, self.kept] = state
        return out

    @property
    def _turns(self) -> int:
        """Columns of the turn of the tip."""
        return 0 if self.turning is None else 3

    def _forced(self, forcing: Forcing) -> tuple[tuple[Array, ...] | None, Index]:
        """What is forced of phi', t', u and m' at the points, by columns (P, K, r, C) of the turn of the tip and of
        the changes that force anything there, and which of the changes these are."""
        some = [part.any((0, 1, 2)) for part in (forcing.data, forcing.rate, forcing.force)]
        columns: Index = np.flatnonzero(some[0] | some[1] | some[2])
        extra = self._turns
        if not len(columns) and not extra:
            return None, columns
        data, rate, force = (part[..., columns] for part in (forcing.data, forcing.rate, forcing.force))
        torque_by, u_by, _ = self.by_data
        parts = [rate * self.torque[..., None], torque_by @ data, u_by @ data, -hat(self.axis) @ force]
        if self.turning is not None:
            parts = [np.concatenate([np.zeros((*p.shape[:3], extra)), p], axis=3) for p in parts]
            parts[3][..., :extra] = self.turning
        return tuple(parts), columns

    def _along(self, state: Array, q: Array, forced: tuple[Array, ...] | None, softness: float) -> Response:
        """The response, of states (P + 1, 2 n + 6, Q) and (phi, psi) at the points (P, K own, Q). Without a load the
        states have, of psi, what it gains between the pieces."""
        n, begin = self.n, state[:-1, None]
        q = q.reshape(self.pieces, self.degree, self.own, -1)
        starts = begin[:, :, n + 3 : 2 * n + 3], begin[:, :, 2 * n + 3 :]
        torque, moment, bent, _, _, turned = self._felt(q, starts, forced)
        if self.load is not None:
            bending = turned + softness * self._give * bent
            return Response(state, q[..., :n, :], q[..., n:, :], moment, torque, bent, bending)
        rates = self.frame[..., :2] @ turned
        state[1:, n : n + 3] += (self.weights[:, None] @ rates.reshape(self.pieces, self.degree, -1)).reshape(
            self.pieces, 3, -1
        )
        state[:, n : n + 3] = np.cumsum(state[:, n : n + 3], axis=0)
        psi = state[:-1, None, n : n + 3] + self._swept(self.t.matrix, rates)
        return Response(state, q, psi, moment, torque, bent, turned)

    def pulled(self, pull: Array, softness: float) -> Response:
        """The mode in which torques fall by (P, K, n) towards the plate, and nothing bends: one column."""
        n, none = self.n, np.zeros((*self.axis.shape, 1))
        torque, behind, _ = self._inwards(-pull, np.zeros((self.pieces + 1, n)), np.zeros(n))
        rates, state = softness * self.rate * torque, np.zeros((self.pieces + 1, self.size, 1))
        whole = np.concatenate([softness * self.transmission * behind[:1], (self.weights[..., None] * rates).sum(1)])
        state[:, :n, 0], state[:, n + 3 : 2 * n + 3, 0] = np.cumsum(whole, axis=0), behind
        phi = state[:-1, None, :n, 0] + self.h * (self.t.matrix @ rates)
        return Response(state, phi[..., None], none, none, torque[..., None], none[..., :2, :], none[..., :2, :])

    def mode(self, margin: float, *, one_of_two: bool = False) -> tuple[Response, float] | None:
        """How the arm buckles when its elasticity is softened by its margin, one column, and 1 / (1 - margin); None
        where the mesh is too coarse to show how, or two ways are equally easy and not `one_of_two` will do."""
        known = margin
        for _ in range(MODE_STEPS):
            # Beside the eigenvalue itself, where there would be nothing left to divide by.
            beside = margin - ASIDE
            softness = 1 / (1 - beside)
            maps = self._maps(softness)
            matrix = self._system(softness, maps.ends)
            angle = np.arange(len(matrix), dtype=float)
            factors, pivots, _ = scipy.linalg.lapack.dgetrf(matrix)
            right = np.column_stack([np.cos(angle), np.sin(angle)])
            grown = scipy.linalg.lapack.dgetrs(factors, pivots, right)[0]
            size = np.abs(grown[:, 0]).max()
            found = scipy.linalg.lapack.dgetrs(factors, pivots, grown[:, 0] / size)[0]
            found /= np.abs(found).max()
            other = np.abs(grown[:, 1] - found * ((found @ grown[:, 1]) / (found @ found))).max()
            state = self._state(found, softness)
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

    def _state(self, found: Array, softness: float) -> Array:
        """(P + 1, 2 own, 1) behind all places, of torques and moment at the plate and what follows."""
        n, own = self.n, self.own
        state = np.zeros((self.pieces + 1, 2 * own, 1))
        state[1:, :, 0] = found[own:].reshape(self.pieces, 2 * own)
        state[0, own:, 0] = found[:own]
        state[0, :n, 0] = softness * self.transmission * found[:n]
        return state

    def elastic(self, mode: Response, softness: float) -> float:
        """The elastic part T of the second variation along a mode, one column."""
        torque, bent, held = mode.torque[..., 0], mode.bent[..., 0], mode.state[0, self.n + 3 : 2 * self.n + 3, 0]
        density = (self.rate * torque**2).sum(2) + (bent**2).sum(2) / self.stiffness.sum(2)
        return float(softness**2 * ((self.weights * density).sum() + self.transmission @ held**2))

    def quotient(self, mode: Response, softness: float) -> float:
        """Second variation over its elastic part T along a mode, one column."""
        y, psi, curved = (part[..., 0] for part in (mode.phi, mode.psi, mode.curvature))
        bending = (self.frame[..., :2] @ curved[..., None])[..., 0]
        form = np.einsum("pki,pkij,pkj->pk", y, self._by[0], y)
        form -= (self.force * cross(psi, cross(psi, self.axis)) + self.moment * cross(psi, bending)).sum(2)
        return 1.0 + float((self.weights * form).sum()) / self.elastic(mode, softness)


MODE_STEPS = 4
"""How often a mode is sought at most, each time at the quotient of the one before."""

MIXED = 3e-7
"""Part of another mode that a mode may have."""

SAME_MODE = 1e-6
"""Difference of the margin up to which a mode is that of the margin."""

ASIDE = 1e-12
"""By how much less than the margin an arm is softened to find how it buckles."""

DOUBLE = 1e-9
"""Eigenvalues closer than this are one, whose mode, and so derivative, is not known."""
