"""Collocated equilibrium of tubes of fixed own length beside the centreline of a sheath: the minimum of an energy.

Tube i runs at the offset o_i = d_i (cos phi_i, sin phi_i) in a frictionless channel of a sheath that neither twists
nor stretches on its centreline. It ends, and begins to curve, at fixed places of its own arc length: on the centreline
these boundaries move. Between boundaries lie sections, of elements of equal length h. Unknowns are, at the Gauss
points, the turns p = h theta' of the tubes and the turn kappa = h u of the centreline, and the twist rate w of each
transmission:

    theta = alpha + |beta| w + sum b p,      E = sum b e(theta, p, kappa, h) + sum |beta| kt w^2 / 2 - F . r(tip),

with e of `physics.torsion.bundle_energy`. The own length of a tube in an element is h + d a.kappa, so that the lengths
h follow from kappa by linear equations, one for each boundary:

    sum over the sections before it, sum b (h + d_i a_i.kappa) = own length of tube i up to there.

So E has no constraints but h > 0 and g > 0. It contains the axial force of each tube, N = kb (kappa_0^2 - |v|^2) / 2 -
kt w^2 / 2 - lambda, with its own curvature v and twist w. The constants lambda are the multipliers of these equations.
At its end lambda g = psi g + (energy per length that the other tubes lose, since their curvature jumps there), with the
density psi of the tube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from ...physics.shape import rotation_matrix_function, tangent_forms, world_turns
from ...physics.torsion import bundle_energy
from ...typing import Array, Index, Mask
from .arm import ArmShape, along_elements
from .buffered import mapped
from .collocated import ENDS
from .mesh import Mesh
from .orientation import adjoint, orient, second_derivative, tangent_slopes, tangents
from .tableau import Tableau, tableau

SAME_PLACE = 1e-9
"""Difference (m) of offsets and of own lengths below which boundaries of tubes are one."""

ELEMENT = 0.025
"""Largest length (m) of an element: estimated errors of the thesis robot are then about 1e-11 rad."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """n tubes at joint translations, in front of the plate."""

    bending_stiffness: Array
    """kb (n,), N m^2."""
    torsional_stiffness: Array
    """kt (n,), N m^2."""
    curvature: Array
    """kappa_0 (n,) of the curved parts, 1/m."""
    offset: Array
    """d (n,), m."""
    angle: Array
    """phi (n,), rad."""
    transmission: Array
    """|beta| (n,), length from where a tube is held to the plate, m."""
    transition: Array
    """Own arc length (n,) from the plate to where the curve begins, m; negative behind the plate."""
    end: Array
    """Own arc length (n,) from the plate to the end, m."""
    sheath: float = 0.0
    """Bending stiffness of the sheath, N m^2."""

    @cached_property
    def levers(self) -> Array:
        """d a (n, 2): stretch of a tube by the curvature, m."""
        return np.asarray(self.offset[:, None] * np.column_stack([np.sin(self.angle), -np.cos(self.angle)]))


class Boundary(NamedTuple):
    """End of a section."""

    own: float
    """Own arc length of its tubes from the plate, of a place of the sheath its arc length, m."""
    tubes: tuple[int, ...]
    """Tubes that end or begin to curve there, side by side at one offset; none for a place of the sheath."""
    end: bool = False
    """True for ends of tubes."""


def boundaries(bundle: Bundle, places: Sequence[float] = ()) -> list[Boundary]:
    """Boundaries in front of the plate, in no order; `places` are arc lengths of the sheath, m."""
    out = [Boundary(s, ()) for s in places]
    for end, own in ((False, bundle.transition), (True, bundle.end)):
        left = [i for i in range(len(own)) if own[i] > SAME_PLACE and (end or bundle.curvature[i])]
        while left:
            first = left[0]
            apart = np.abs(bundle.levers[left] - bundle.levers[first]).max(1) + np.abs(own[left] - own[first])
            same = tuple(i for i, gap in zip(left, apart.tolist(), strict=True) if gap <= SAME_PLACE)
            out.append(Boundary(float(own[first]), same, end))
            left = [i for i in left if i not in same]
    return out


class Start(NamedTuple):
    """Boundaries in their order, and sections of constant curvature between them."""

    order: tuple[Boundary, ...]
    length: Array
    """Lengths (m,) of the sections, m."""
    curvature: Array
    """Curvature (m, 2), 1/m."""


def natural_start(bundle: Bundle, rotations: Array, places: Sequence[float] = ()) -> Start:
    """Arm of untwisted tubes, marched from the plate: each section ends at the first boundary that its tubes reach."""
    left = boundaries(bundle, places)
    n = len(rotations)
    done, arc, order, lengths, curvatures = np.zeros(n), 0.0, [], [], []
    direction = np.column_stack([np.cos(rotations), np.sin(rotations)])
    while any(b.end for b in left):
        present, curved = _tubes_at(bundle, left)
        kb = bundle.bending_stiffness * present
        u = (kb * bundle.curvature * curved) @ direction / (kb.sum() + bundle.sheath)
        stretch = 1 + bundle.levers @ u
        to_go = [(b.own - done[b.tubes[0]]) / stretch[b.tubes[0]] if b.tubes else b.own - arc for b in left]
        k = int(np.argmin(to_go))
        h = max(to_go[k], 0.0)
        order.append(left.pop(k))
        lengths.append(h)
        curvatures.append(u)
        done, arc = done + stretch * h, arc + h
    return Start(tuple(order), np.array(lengths), np.array(curvatures).reshape(-1, 2))


def _tubes_at(bundle: Bundle, ahead: Sequence[Boundary]) -> tuple[Mask, Mask]:
    """Tubes (n,) that are present, and those that are curved, where the boundaries `ahead` are still to come."""
    n = len(bundle.end)
    ends = {i for b in ahead if b.end for i in b.tubes}
    transitions = {i for b in ahead if not b.end for i in b.tubes}
    present = np.array([i in ends for i in range(n)])
    return present, present & np.array([i not in transitions for i in range(n)])


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Energy of a bundle with its boundaries in one order; N points, P elements, m sections, U unknowns.

    Unknowns x are whitened: p and w by the torsional energy, kappa by the bending energy of the start.
    """

    bundle: Bundle
    order: tuple[Boundary, ...]
    nominal: Array
    """Lengths (m,) of the elements of each section in the start, m. They scale the unknowns."""
    count: Index
    """Numbers (m,) of elements of the sections."""
    tableau: Tableau
    force: tuple[tuple[float, tuple[float, float, float]], ...] = ()
    """Dead forces: arc length (m) of a place of the sheath, infinity for the tip, and force (3,), N."""

    @cached_property
    def _of_sections(self) -> tuple[Mask, Mask]:
        rows = [_tubes_at(self.bundle, self.order[k:]) for k in range(len(self.order))]
        return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])

    @cached_property
    def section(self) -> Index:
        """Section (P,) of each element."""
        return np.repeat(np.arange(len(self.order)), self.count)

    @cached_property
    def point_section(self) -> Index:
        """Section (N,) of each point."""
        return np.repeat(self.section, self.tableau.degree)

    @cached_property
    def weight(self) -> Array:
        """Quadrature weights (N,) on elements of length 1."""
        return np.tile(self.tableau.weights, len(self.section))

    @cached_property
    def present(self) -> Mask:
        """Mask (N, n) of the tubes that are there."""
        return np.asarray(self._of_sections[0][self.point_section])

    @cached_property
    def stiffness(self) -> Array:
        """kb (N, n) of the tubes that are there."""
        return self.bundle.bending_stiffness * self.present

    @cached_property
    def twisting(self) -> Array:
        """kt (N, n) of the tubes that are there."""
        return self.bundle.torsional_stiffness * self.present

    @cached_property
    def natural_moment(self) -> Array:
        """m (N, n) of the tubes that are curved there, N m."""
        return self.bundle.bending_stiffness * self.bundle.curvature * self._of_sections[1][self.point_section]

    @cached_property
    def held(self) -> Index:
        """Tubes with a transmission behind the plate. Its twist rate is an unknown."""
        return np.flatnonzero((self.bundle.transmission > SAME_PLACE) & self.present.any(0))

    @cached_property
    def turning(self) -> tuple[Index, Index]:
        """Tube and point of each unknown p."""
        tube, point = np.nonzero(self.present.T)
        return tube, point

    @property
    def split(self) -> int:
        """Number of unknowns p and w, which precede those of bending."""
        return len(self.turning[0]) + len(self.held)

    @property
    def size(self) -> int:
        """Number U of unknowns."""
        return self.split + 2 * len(self.weight)

    @cached_property
    def scale(self) -> Array:
        """Factors (U,) from whitened unknowns to p, w and kappa: each has the energy x^2 / 2 by itself."""
        tube, point = self.turning
        h = self.nominal[self.point_section]
        bending = self.stiffness.sum(1) + self.bundle.sheath
        return np.concatenate(
            [
                np.sqrt(h[point] / (self.weight[point] * self.bundle.torsional_stiffness[tube])),
                1 / np.sqrt(self.bundle.transmission[self.held] * self.bundle.torsional_stiffness[self.held]),
                np.repeat(np.sqrt(h / (self.weight * bending)), 2),
            ]
        )

    @cached_property
    def lengths_by_boundaries(self) -> Array:
        """Inverse (m, m) of the map from element lengths h to the lengths up to the boundaries."""
        m = len(self.order)
        return np.asarray(np.linalg.inv(np.tril(np.ones((m, m))) * self.count))

    @cached_property
    def lengths_by_bend(self) -> Array:
        """Derivative (m, 2 N) of the lengths h by kappa: longer tubes on the outside of the bend end earlier."""
        before = self.point_section <= np.arange(len(self.order))[:, None]
        lever = np.array([self.bundle.levers[b.tubes[0]] if b.tubes else np.zeros(2) for b in self.order])
        longer = (before * self.weight)[:, :, None] * lever[:, None]
        return np.asarray(-self.lengths_by_boundaries @ longer.reshape(len(self.order), -1))

    def lengths(self, x: Array) -> Array:
        """Lengths h (m,) of the elements of each section at unknowns x, m."""
        straight = self.lengths_by_boundaries @ np.array([b.own for b in self.order])
        return np.asarray(straight + self.lengths_by_bend @ (self.scale * x)[self.split :])

    @cached_property
    def local(self) -> Array:
        """Derivative (N, 2 n + 3, U) of theta, p, kappa and h at the points by x."""
        (tube, point), n, count, k = self.turning, len(self.bundle.end), len(self.weight), self.tableau.degree
        element = np.arange(count) // k
        # Sums of p up to each point: whole elements before it, and the collocation matrix in its own.
        up_to = np.where(element < element[:, None], self.weight, 0.0)
        up_to += np.kron(np.eye(len(self.section)), self.tableau.matrix)
        out, own = np.zeros((count, 2 * n + 3, self.size)), np.arange(len(tube))
        out[:, tube, own] = up_to[:, point]
        out[point, n + tube, own] = 1.0
        out[:, self.held, len(tube) + np.arange(len(self.held))] = self.bundle.transmission[self.held]
        for axis in range(2):
            out[np.arange(count), 2 * n + axis, self.split + axis + 2 * np.arange(count)] = 1.0
        out[:, -1, self.split :] = self.lengths_by_bend[self.point_section]
        return out * self.scale

    def transmission_twist(self, x: Array) -> Array:
        """Rotations of the held tubes at the plate by the twist of their transmissions, rad."""
        own = slice(self.split - len(self.held), self.split)
        return np.asarray(self.bundle.transmission[self.held] * (self.scale * x)[own])

    def unknowns(self, turn: Array, bend: Array, twist: Array) -> Array:
        """Unknowns (U,) by p (N, n), kappa (N, 2), and rotations of the held tubes at the plate, rad."""
        tube, point = self.turning
        rate = twist / self.bundle.transmission[self.held]
        return np.asarray(np.concatenate([turn[point, tube], rate, bend.ravel()]) / self.scale)

    @cached_property
    def tip_rows(self) -> Array:
        """Derivative (n, U) of the rotations at the ends of the tubes by x."""
        (tube, point), own = self.turning, np.arange(len(self.turning[0]))
        out = np.zeros((len(self.bundle.end), self.size))
        out[tube, own] = self.weight[point]
        out[self.held, len(own) + np.arange(len(self.held))] = self.bundle.transmission[self.held]
        return out * self.scale

    def place(self, s: float) -> int:
        """Section that ends at a place of the sheath; the last one for the tip."""
        return next((k for k, b in enumerate(self.order) if not b.tubes and b.own == s), len(self.order) - 1)

    @cached_property
    def ahead(self) -> Array:
        """Sum (N, 3) of the forces beyond each point, N."""
        out = np.zeros((len(self.weight), 3))
        for s, force in self.force:
            out[self.point_section <= self.place(s)] += force
        return out


@dataclass(frozen=True, eq=False)
class BundleState:
    """State of a bundle problem."""

    x: Array
    """Unknowns (U,)."""
    energy: float
    """Potential energy, J: elastic energy less work. Infinite where a section or a tube has no length."""
    work: float
    """Work of the forces from an arm with all points at the plate, J."""
    gradient: Array
    """Gradient (U,) of the potential energy."""
    hessian: Array
    """Hessian (U, U)."""
    theta: Array
    """Rotations (N, n), rad; of absent tubes those at their ends."""
    turn: Array
    """p (N, n), rad."""
    bend: Array
    """kappa (N, 2), rad."""
    h: Array
    """Lengths (N,) of the elements, m."""
    length: Array
    """Lengths g (N, n) of the tubes in an element, m."""
    elastic_hessian: Array
    """Hessian (U, U) of the elastic energy."""
    by_local: Array
    """Derivative (N, 2 n + 3) of the energy at the points by theta, p, kappa and h."""
    local_hessian: Array
    """Second derivative (N, 2 n + 3, 2 n + 3) by them."""
    work_by_length: Array
    """Derivative (m,) of the work by the lengths h, at fixed kappa."""
    mixed: Array
    """Second derivative (m, 2 N) of the work by the lengths h and by kappa; empty without forces."""


def arm_mesh(problem: BundleProblem) -> Mesh:
    """Elements of length 1, on which the turn of the centreline is kappa."""
    count = len(problem.section)
    ones = np.ones(count)
    return Mesh(problem.tableau, np.arange(count, dtype=float), ones, problem.section, np.ones(count, dtype=bool))


def evaluate(problem: BundleProblem, rotations: Array, x: Array) -> BundleState:
    """Potential energy with gradient and Hessian at x (U,), for base rotations (n,)."""
    bundle, n, count = problem.bundle, len(rotations), len(problem.weight)
    local = problem.local @ x
    local[:, :n] += rotations
    local[:, -1] = problem.lengths(x)[problem.point_section]
    theta, turn, bend, h = local[:, :n], local[:, n : 2 * n], local[:, 2 * n : -1], local[:, -1]
    length = h[:, None] + bend @ bundle.levers.T
    if h.min() <= 0 or length[problem.present].min() <= 0:
        # No such arm: a step of Newton's method that leads here is shortened.
        none = np.full(problem.size, np.nan)
        return BundleState(
            x, np.inf, 0.0, none, np.diag(none), theta, turn, bend, h, length, none, none, none, none, none
        )
    offset, angle, sheath = np.broadcast_arrays(bundle.offset, bundle.angle, bundle.sheath)
    inputs = problem.stiffness, problem.twisting, problem.natural_moment, offset, angle, sheath[:1]
    energy, by_local, second, _ = (part.copy() for part in mapped(bundle_energy(n), count)(local, *inputs))
    second = second.reshape(count, 2 * n + 3, 2 * n + 3)
    flat = problem.local.reshape(-1, problem.size)
    gradient = (problem.weight[:, None] * by_local).ravel() @ flat
    hessian = flat.T @ ((problem.weight[:, None, None] * second) @ problem.local).reshape(-1, problem.size)
    total = float(problem.weight @ energy[:, 0])
    transmissions = slice(problem.split - len(problem.held), problem.split)
    total += float(x[transmissions] @ x[transmissions]) / 2
    gradient[transmissions] += x[transmissions]
    hessian[transmissions, transmissions] += np.eye(len(problem.held))
    work, by_length, mixed, elastic = 0.0, np.zeros(len(problem.order)), np.zeros((0, 0)), hessian
    if problem.force:
        bending, scale = slice(problem.split, problem.size), problem.scale[problem.split :]
        at, elastic = _work(problem, bend, h), hessian.copy()
        work, by_length, mixed = at.value, at.by_length, at.mixed
        gradient[bending] -= scale * at.slope
        hessian[bending, bending] -= scale[:, None] * at.second * scale
    geometry = theta, turn, bend, h, length
    return BundleState(x, total - work, work, gradient, hessian, *geometry, elastic, by_local, second, by_length, mixed)


class _Work(NamedTuple):
    """Work of the forces, sum b h n.t, J, with its derivatives by kappa as h follows it."""

    value: float
    slope: Array
    """Derivative (2 N,)."""
    second: Array
    """Second derivative (2 N, 2 N)."""
    by_length: Array
    """Derivative (m,) by h at fixed kappa."""
    mixed: Array
    """Second derivative (m, 2 N) by h and kappa as independent quantities."""


def _work(problem: BundleProblem, bend: Array, h: Array) -> _Work:
    mesh, count, m = arm_mesh(problem), len(h), len(problem.order)
    orientation = orient(mesh, bend)
    weighted = (problem.weight * h)[:, None] * problem.ahead
    # n.t = Q' (sum n_i T_i) Q, as in `loaded.evaluate`; here the lengths h change with kappa, too.
    forms = (2 * weighted @ tangent_forms().reshape(3, 16)).reshape(count, 4, 4)
    first = adjoint(mesh, orientation, (forms @ orientation.stage[:, :, None])[:, :, 0])
    pull = problem.weight * (problem.ahead * tangents(orientation.stage)).sum(1)
    by_length = np.bincount(problem.point_section, pull, m).astype(float)
    slopes = (problem.ahead[:, None] @ (tangent_slopes(orientation.stage) @ orientation.stage_slope))[:, 0]
    mixed = np.zeros((m, 2 * count))
    np.add.at(mixed, problem.point_section, problem.weight[:, None] * slopes)
    across = mixed.T @ problem.lengths_by_bend
    second = second_derivative(orientation, first, forms) + across + across.T
    slope = first.gradient.ravel() + by_length @ problem.lengths_by_bend
    return _Work(float(pull @ h), slope, second, by_length, mixed)


class PlaceSlopes(NamedTuple):
    """Pose of the centreline where a section ends, with derivatives."""

    position: Array
    """Position (3,), m."""
    by_x: Array
    """Derivative (6, U) of the position, and of the turn of the frame about world axes, by x."""
    by_length: Array
    """Derivative (3, m) of the position by the lengths h of elements, at fixed kappa."""


def place_slopes(problem: BundleProblem, state: BundleState, section: int) -> PlaceSlopes:
    """Pose of the centreline where a section ends."""
    orientation = orient(arm_mesh(problem), state.bend)
    weight = problem.weight * (problem.point_section <= section)
    tangent, by_x = tangents(orientation.stage), np.zeros((6, problem.size))
    by_length = np.zeros((len(problem.order), 3))
    np.add.at(by_length, problem.point_section, weight[:, None] * tangent)
    slopes = tangent_slopes(orientation.stage) @ orientation.stage_slope
    bending, end = slice(problem.split, problem.size), int(np.searchsorted(problem.section, section, side="right"))
    by_x[:3, bending] = np.tensordot(weight * state.h, slopes, 1) + by_length.T @ problem.lengths_by_bend
    by_x[3:, bending] = 2 * (world_turns() @ orientation.start[end]) @ orientation.start_slope[end]
    return PlaceSlopes((weight * state.h) @ tangent, by_x * problem.scale, by_length.T)


def margin_form(problem: BundleProblem, state: BundleState) -> Array:
    """Second variation (U, U) relative to that of tubes without coupling; its least eigenvalue is the margin.

    Bending is counted from the curvature that minimises the elastic energy at given rotations, relative to its own
    elastic stiffness: without a load it then leaves the torsion, and without offsets it is the form of `loaded`.
    """
    tube, point = problem.turning
    split, stiffness = problem.split, problem.bundle.torsional_stiffness
    untwisted = np.ones(split)
    untwisted[: len(tube)] = (
        np.sqrt(state.length[point, tube] / (problem.weight[point] * stiffness[tube])) / problem.scale[: len(tube)]
    )
    bending, coupling = state.elastic_hessian[split:, split:], state.elastic_hessian[split:, :split]
    factor = np.linalg.cholesky(bending)
    basis = np.zeros((problem.size, problem.size))
    basis[:split, :split] = np.diag(untwisted)
    basis[split:, :split] = -scipy.linalg.cho_solve((factor, True), coupling) * untwisted
    basis[split:, split:] = np.linalg.inv(factor).T
    return np.asarray(basis.T @ state.hessian @ basis)


def problem_at(
    bundle: Bundle,
    start: Start,
    *,
    degree: int = 6,
    refinement: int = 0,
    force: tuple[tuple[float, tuple[float, float, float]], ...] = (),
) -> BundleProblem:
    """Problem with the boundaries of a start in their order; elements are halved `refinement` times."""
    count = np.maximum(1, np.ceil(start.length / ELEMENT - SAME_PLACE)).astype(np.intp) * 2**refinement
    nominal = np.maximum(start.length, 10 * SAME_PLACE) / count
    return BundleProblem(bundle, start.order, nominal, count, tableau("gauss", degree), force)


def start_unknowns(problem: BundleProblem, start: Start) -> Array:
    """Unknowns (U,) of untwisted tubes with the curvature of a start."""
    bend = (start.curvature * (start.length / problem.count)[:, None])[problem.point_section]
    return problem.unknowns(np.zeros(problem.present.shape), bend, np.zeros(len(problem.held)))


def opened(problem: BundleProblem, x: Array, least: float) -> Array:
    """Unknowns closest to x (U,) for which no element is shorter than `least`, m."""
    h = problem.lengths(x)
    short = np.flatnonzero(h < least)
    if not len(short):
        return x
    rows = problem.lengths_by_bend[short] * problem.scale[problem.split :]
    out = x.copy()
    out[problem.split :] += np.linalg.lstsq(rows, least - h[short], rcond=None)[0]
    return out


def exchanged(problem: BundleProblem, state: BundleState, section: int) -> Start:
    """Start with the boundaries at both ends of a vanishing section exchanged."""
    order = list(problem.order)
    order[section - 1], order[section] = order[section], order[section - 1]
    ends = np.flatnonzero(np.diff(problem.point_section, append=-1))
    h = state.h[ends] * problem.count
    return Start(tuple(order), h, state.bend[ends] / state.h[ends, None])


# --- Arm, and arms as starts ------------------------------------------------------------------------------------------


def bundle_arm(problem: BundleProblem, rotations: Array, state: BundleState) -> ArmShape:
    """Shape of the arm at ENDS of its elements."""
    (count, n), k = state.theta.shape, problem.tableau.degree
    pieces = count // k
    orientation, at = orient(arm_mesh(problem), state.bend), tuple(ENDS.tolist())
    values, integrals = problem.tableau.basis(at, 0), problem.tableau.basis(at, 1)
    h = state.h.reshape(pieces, k)[:, :1, None]
    turn, tangent = state.turn.reshape(pieces, k, n), tangents(orientation.stage).reshape(pieces, k, 3)
    base = rotations.copy()
    base[problem.held] += problem.transmission_twist(state.x)
    ends = np.cumsum(problem.tableau.weights @ turn, axis=0)
    start = base + np.concatenate([np.zeros((1, n)), ends[:-1]])
    # Q' = (u_x Omega_x + u_y Omega_y) Q / 2 at the points, integrated by their polynomial; |Q| = 1 at the ends only.
    rate = (orientation.rate @ orientation.stage[:, :, None] / 2).reshape(pieces, k, 4)
    quaternion = orientation.start[:-1, None] + integrals @ rate
    quaternion[:, -1] = orientation.start[1:]
    quaternion /= np.linalg.norm(quaternion, axis=2, keepdims=True)
    offset = h * (integrals @ tangent)
    foot = np.cumsum(np.concatenate([np.zeros((1, 3)), offset[:-1, -1]]), axis=0)
    s = np.cumsum(np.concatenate([[0.0], h[:-1, 0, 0]]))[:, None] + h[:, 0] * ENDS
    frame = mapped(rotation_matrix_function(), pieces * len(ENDS))(quaternion.reshape(-1, 4))[0]
    return ArmShape(
        arc_length=along_elements(s, pieces)[:, 0],
        rotation=along_elements(start[:, None] + integrals @ turn, pieces).T.copy(),
        torsion=along_elements(values @ turn / h, pieces).T.copy(),
        curvature=along_elements(values @ state.bend.reshape(pieces, k, 2) / h, pieces),
        position=along_elements(foot[:, None] + offset, pieces),
        frame=along_elements(frame, pieces).reshape(-1, 3, 3).swapaxes(1, 2).copy(),
    )


def refined(problem: BundleProblem, state: BundleState, degree: int) -> tuple[BundleProblem, Array]:
    """Problem with another degree on the same elements, and the unknowns of a state there."""
    finer = replace(problem, tableau=tableau("gauss", degree))
    basis, k = problem.tableau.lagrange(finer.tableau.nodes), problem.tableau.degree

    def moved(values: Array) -> Array:
        table = basis @ values.reshape(-1, k, values.shape[1])
        return table.reshape(-1, values.shape[1])

    return finer, finer.unknowns(moved(state.turn), moved(state.bend), problem.transmission_twist(state.x))


def sampled(bundle: Bundle, arm: ArmShape, places: Sequence[float] = ()) -> Start:
    """Boundaries of a bundle on the centreline of another arm, in their order there."""
    s = arm.arc_length
    middle = (arm.curvature[1:] + arm.curvature[:-1]) / 2
    own = s[:, None] + np.concatenate(
        [np.zeros((1, len(bundle.end))), np.cumsum(np.diff(s)[:, None] * middle, 0) @ bundle.levers.T]
    )

    def reached(b: Boundary) -> float:
        if not b.tubes:
            return b.own
        along = own[:, b.tubes[0]]
        return float(np.interp(b.own, along, s) + max(b.own - along[-1], 0.0))

    order = sorted(boundaries(bundle, places), key=reached)
    last = max(k for k, b in enumerate(order) if b.end)
    ends = np.array([0.0, *map(reached, order[: last + 1])])
    bend = np.column_stack([np.interp((ends[1:] + ends[:-1]) / 2, s, part) for part in arm.curvature.T])
    return Start(tuple(order[: last + 1]), np.diff(ends), bend)


def sampled_unknowns(problem: BundleProblem, start: Start, arm: ArmShape, twist: Array) -> Array:
    """Unknowns (U,) with the curvature of another arm, its torsion, and the `twist` (n,) of its transmissions, rad."""
    h = start.length / problem.count
    begin = np.cumsum(np.concatenate([[0.0], np.repeat(h, problem.count)[:-1]]))
    s = (begin[:, None] + np.repeat(h, problem.count)[:, None] * problem.tableau.nodes).ravel()
    here = h[problem.point_section, None]
    turn, bend = (
        np.column_stack([np.interp(s, arm.arc_length, row) for row in rows]) * here
        for rows in (arm.torsion, arm.curvature.T)
    )
    return problem.unknowns(turn, bend, twist[problem.held])
