"""Friction between neighbouring tubes: their relative rotations, linear in the whitened unknowns.

With theta = alpha + L z at the collocation points, the rotation of a tube in the next one around it at row r is

    phi_r = alpha_outer - alpha_inner + P_r x,     x = (z, y),

and friction of capacity D_r = B_a tau transmits a torque lam_r, |lam_r| <= D_r. Concentrated friction (at the plate, at
jumps of curvature, at ends of tubes) acts between the points. The rotation there that z does not determine has the
conditional compliance of that place given the points. It is whitened too, into unknowns y on which the coupling energy
does not depend: the energy is E(z) + y'y / 2.

Under a load the arm also bends by q (see `loaded`): x = (z, q, y), and an equilibrium is a minimum of
E(z, q) - W + y'y / 2. The rows stay the same, since bending changes no relative rotation.

In a bundle every tube rubs in its channel: in the tube around it, or in the sheath, which does not twist. Bending moves
a tube along its channel. So the slip at a place is phi(x) less the rotation that the material there had before, and a
torque does virtual work on the change of rotation of the material, d phi - w d sigma, with the twist w of the tube and
its own length sigma up to the place. The rows follow x.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from ...physics.torsion import passed_moment_function
from ...robots.assembly import LENGTH_ROUND_OFF, Assembly
from ...robots.concentric import PAIRWISE, Friction
from ...robots.load import Load
from ...typing import Array, Index, Mask
from . import bundle, loaded
from .arm import Profile, integrate, pushed
from .buffered import mapped
from .bundle import HELD, BundleProblem, BundleState, margin_basis
from .loaded import LoadedProblem, LoadedState, Loading, load_problem
from .mesh import element_counts, loaded_mesh, make_mesh
from .reduced import Evaluation, ReducedProblem, evaluate, reduce, to_unknowns, tube_turn

DEGREE = 6
"""Collocation points of an element of the mesh."""

ELEMENTS = 4
"""Minimum number of elements along the overlap of two tubes: torsion has a kink, inside an element, where slip ends."""

NEGLIGIBLE_COMPLIANCE = 1e-11
"""Fraction of a compliance that is round-off: a smaller conditional compliance counts as 0."""


@dataclass(frozen=True, eq=False)
class Contact:
    """R rows of friction, linear in X unknowns x = (z, q, y); the last Y unknowns rotate tubes at M points."""

    problem: ReducedProblem
    """Torsion problem with the rotation of every tube with friction as an unknown."""
    friction: Friction
    """Friction between neighbouring tubes."""
    loading: Loading | None
    """External load, or None."""
    loaded: LoadedProblem | None
    """Problem of `problem` with bending under the load; None without a load."""
    rows: Array
    """Derivative (R, X) of the relative rotations by the unknowns, rad per sqrt(J)."""
    capacity: Array
    """Largest friction torques (R,), N m."""
    constant: Array
    """Part (R,) of these that does not depend on bending moments, N m."""
    growth: Array
    """Change (R,) of these per bending moment that the pair passes on at the row."""
    arc_length: Array
    """Arc lengths (R,) of the rows, m."""
    pair: Index
    """Inner tube (R,) of each pair."""
    point: Index
    """Collocation points (R,); -1 for concentrated friction."""
    concentrated_at: Array
    """Arc lengths (M,) of concentrated friction, m."""
    tube: Index
    """Tubes (M,) that concentrated friction acts on."""
    rotation_by_z: Array
    """Derivatives (M, U) by z of the rotations at the concentrated friction."""
    rotation_by_y: Array
    """Derivatives (M, Y) by y of the rotations at the concentrated friction."""
    linear = True
    """True if rows and capacities do not change with the unknowns."""

    @property
    def elastic_size(self) -> int:
        """Number of unknowns (z, q) of torsion and bending, which come before y."""
        return self.problem.size if self.loaded is None else self.loaded.size

    @property
    def load(self) -> Load | None:
        """External load, or None."""
        return None if self.loading is None else self.loading.load

    def largest_rotation(self, step: Array) -> float:
        """Largest rotation by a step in x, rad: of a tube, or of the arm as if its curvature changed uniformly."""
        z, q, y = np.split(step, [self.problem.size, self.elastic_size])
        rotations = [self.problem.factor @ z, self.rotation_by_z @ z + self.rotation_by_y @ y]
        if self.loaded is not None:
            length = self.problem.assembly.total_length
            rotations.append(length * np.repeat(self.loaded.softness, 2) * q)
        return float(np.abs(np.concatenate(rotations)).max(initial=0.0))

    def evaluate(self, rotations: Array, x: Array) -> ContactState:
        """State at base rotations (n,) and unknowns x (X,), without friction."""
        return evaluate_contact(self, rotations, x)

    def moved(self, rotations: Array, state: ContactState, step: Array) -> ContactState:
        """State after a step (X,)."""
        return self.evaluate(rotations, state.x + step)

    def renewed(self, state: ContactState) -> tuple[ContactState, Array]:
        """State from which slips are measured, and its relative rotations (R,)."""
        return state, state.relative_rotations

    def form(self, state: ContactState) -> tuple[Array, Array]:
        """Second variation and the rows in its coordinates. Its smallest eigenvalue is the margin."""
        return state.hessian, self.rows

    def round_off(self, state: ContactState) -> float:
        """Sum of the parts of the energy (J), which may cancel."""
        work = 0.0 if self.loaded is None else abs(state.elastic.potential - state.elastic.energy)
        return float(self.problem.energy_parts + abs(state.energy) + work)


LEAST_CAPACITY = 1e-15
"""Friction torque of a row (N m) where no bending moment presses two tubes together: a capacity cannot be 0."""


def pressed(contact: Contact, theta: Array, bending: Array | None = None) -> Contact:
    """Contact with the capacities of the bending moments at rotations (N, n) and bending (N, 2), 1/m, of its points.

    The contact itself, if its capacities do not depend on moments.
    """
    if not contact.growth.any():
        return contact
    problem, n = contact.problem, contact.problem.assembly.n_tubes
    load = np.zeros((len(theta), 2)) if bending is None else bending * problem.stiffness.sum(1)[:, None]
    data = theta + problem.phase, problem.stiffness, problem.moment, load
    moment = mapped(passed_moment_function(n), len(theta))(*data)[0]
    capacity = contact.constant + contact.growth * moment[contact.point, contact.pair]
    return replace(contact, capacity=np.maximum(capacity, LEAST_CAPACITY))


def largest_capacity(contact: Contact) -> Array:
    """Largest friction torques (R,) of any state without a load, N m.

    Tubes around a contact carry S_out - K_out u, with S = sum m_j e_j and u = (S_in + S_out) / K: this
    is (K_in S_out - K_out S_in) / K, which is largest if the two sums are straight and point in opposite directions.
    """
    if not contact.growth.any():
        return contact.capacity
    stiffness, moment = contact.problem.stiffness, np.abs(contact.problem.moment)
    (k_in, s_in), (k_out, s_out) = (
        [np.cumsum(part[:, ::step], axis=1)[:, ::step] for part in (stiffness, moment)] for step in (1, -1)
    )
    total = stiffness.sum(1)[:, None]
    passed = (k_in[:, :-1] * s_out[:, 1:] + k_out[:, 1:] * s_in[:, :-1]) / total
    capacity: Array = contact.constant + contact.growth * passed[contact.point, contact.pair]
    return np.maximum(capacity, LEAST_CAPACITY)


class Concentrated(NamedTuple):
    """Concentrated friction of a pair of tubes at one arc length."""

    arc_length: float
    pair: int
    """Inner tube."""
    capacity: float
    """Largest friction torque, N m."""


def make_contact(assembly: Assembly, friction: Friction, loading: Loading | None = None) -> Contact:
    """Friction rows of concentric tubes, with or without load, on a mesh fine enough for both."""
    n = assembly.n_tubes
    capacities = {name: np.array(friction.per_pair(name, n - 1)) for name in PAIRWISE}
    # (m, n - 1) sections in which a pair with friction touches.
    touching = assembly.present[:, 1:] & (np.sum(list(capacities.values()), axis=0) > 0)
    unknown = assembly.curved & (assembly.coupled | (loading is not None))[:, None]
    unknown[:, 1:] |= touching
    unknown[:, :-1] |= touching
    problem = _problem(assembly, friction, touching, unknown, loading)
    under_load = None if loading is None else load_problem(problem, loading.load, loading.density)
    bending = 0 if under_load is None else under_load.size - problem.size
    index = np.full((len(problem.weight), n), -1)
    index[problem.point, problem.tube] = np.arange(problem.size)
    concentrated = concentrated_friction(assembly, capacities)
    ends = sorted({(tube, part.arc_length) for part in concentrated for tube in (part.pair, part.pair + 1)})
    arc_length, tube = np.array([s for _, s in ends]), np.array([j for j, _ in ends], dtype=np.intp)
    by_z, by_y = _rotations_between(problem, arc_length, tube)
    zeros = np.zeros((problem.size, bending + by_y.shape[1]))
    by_x = np.block([[problem.factor, zeros], [by_z, np.zeros((len(by_z), bending)), by_y]])
    section = np.repeat(problem.mesh.section[problem.mesh.collocated], DEGREE)
    along = capacities["torque"] + capacities["by_moment"] > 0
    pair, point = np.nonzero((assembly.present[:, 1:] & along)[section].T)
    rows, acting = [by_x[index[point, pair + 1]] - by_x[index[point, pair]]], []
    for part in concentrated:
        inner, outer = (problem.size + ends.index((j, part.arc_length)) for j in (part.pair, part.pair + 1))
        row = by_x[outer] - by_x[inner]
        # Tubes clamped at the plate itself follow their drives: friction there has no effect.
        if row @ row > 0:
            rows.append(row[None])
            acting.append(part)
    constant = np.append(capacities["torque"][pair] * problem.weight[point], [part.capacity for part in acting])
    return Contact(
        problem=problem,
        friction=friction,
        loading=loading,
        loaded=under_load,
        rows=np.concatenate(rows),
        capacity=constant,
        constant=constant,
        growth=np.append(capacities["by_moment"][pair] * problem.weight[point], np.zeros(len(acting))),
        arc_length=np.append(problem.arc_length[point], [part.arc_length for part in acting]),
        pair=np.append(pair, np.array([part.pair for part in acting], dtype=np.intp)),
        point=np.append(point, np.full(len(acting), -1)),
        concentrated_at=arc_length,
        tube=tube,
        rotation_by_z=by_z,
        rotation_by_y=by_y,
    )


def _problem(
    assembly: Assembly, friction: Friction, touching: Mask, unknown: Mask, loading: Loading | None
) -> ReducedProblem:
    """Torsion with `unknown` (m, n) rotations, on a mesh that is finer where pairs are `touching` (m, n - 1)."""
    overlap = assembly.length @ touching
    longest = np.min(
        np.where(touching, overlap / (ELEMENTS * 2.0**friction.refinement), np.inf), axis=1, initial=np.inf
    )
    counts = np.maximum(element_counts(assembly), np.ceil(assembly.length / longest - 1e-9).astype(np.intp))
    if loading is not None:
        return reduce(assembly, loaded_mesh(assembly, np.maximum(counts, loading.counts), degree=DEGREE), unknown)
    mesh = make_mesh(assembly, counts, degree=DEGREE)
    return reduce(assembly, replace(mesh, collocated=(unknown.sum(1) > 0)[mesh.section]), unknown)


def concentrated_friction(assembly: Assembly, capacities: dict[str, Array]) -> list[Concentrated]:
    """Concentrated friction of all pairs; capacities at the same arc length are added."""
    total: dict[tuple[float, int], float] = {}

    def add(s: float, pair: int, capacity: float) -> None:
        if capacity > 0:
            total[s, pair] = total.get((s, pair), 0.0) + capacity

    for i in range(assembly.n_tubes - 1):
        end = float(assembly.end[i + 1])
        if end <= LENGTH_ROUND_OFF:
            continue
        add(0.0, i, capacities["plate"][i])
        cuts = zip(assembly.breakpoints, assembly.breakpoint_tubes, strict=True)
        for s in {s for s, j in cuts if j in (i, i + 1) and LENGTH_ROUND_OFF < s < end - LENGTH_ROUND_OFF}:
            add(_nearest(assembly, s), i, capacities["jumps"][i])
        add(_nearest(assembly, end), i, capacities["ends"][i])
    return [Concentrated(s, pair, capacity) for (s, pair), capacity in total.items()]


def _nearest(assembly: Assembly, s: float) -> float:
    """End of the section closest to arc length s: breakpoints that coincide within round-off are merged."""
    ends = np.append(assembly.start, assembly.total_length)
    return float(ends[np.argmin(np.abs(ends - s))])


def _rotations_between(problem: ReducedProblem, arc_length: Array, tube: Index) -> tuple[Array, Array]:
    """Rotations of tubes at M ends of elements: derivatives (M, U) by z, and (M, Y) by unknowns y of their own.

    Compliances of a rod are those of Brownian motion: the covariance of rotations at two places is the compliance up to
    the nearer one. So z conditions the rotations at the places, and y whitens their conditional covariance.
    """
    by_z, columns = np.zeros((len(arc_length), problem.size)), []
    for j in np.unique(tube).tolist():
        at_tube = np.flatnonzero(tube == j)
        turns = [tube_turn(problem, j, int(np.argmin(np.abs(problem.cuts - s)))) for s in arc_length[at_tube]]
        by_z[at_tube], compliance = [turn.row for turn in turns], np.array([turn.compliance for turn in turns])
        conditional = np.minimum(compliance[:, None], compliance) - by_z[at_tube] @ by_z[at_tube].T
        values, vectors = np.linalg.eigh(conditional)
        positive = values > NEGLIGIBLE_COMPLIANCE * max(float(compliance.max()), 1e-300)
        by_y = np.zeros((len(arc_length), int(positive.sum())))
        by_y[at_tube] = vectors[:, positive] * np.sqrt(values[positive])
        columns.append(by_y)
    return by_z, np.concatenate([np.zeros((len(arc_length), 0)), *columns], axis=1)


@dataclass(frozen=True, eq=False)
class ContactState:
    """State of a contact at unknowns x, without friction."""

    contact: Contact | BundleContact
    x: Array
    """Unknowns (X,)."""
    elastic: Any
    """State of the tubes, by (z, q): an `Evaluation`, a `LoadedState` or a `BundleState`."""
    energy: float
    """Energy less the work of the load, J."""
    gradient: Array
    """Gradient (X,) of the energy."""
    hessian: Array
    """Hessian (X, X) of the energy."""
    relative_rotations: Array
    """Rotations (R,) of the outer tube relative to the inner one, rad; of a bundle since the last state."""
    rows: Array
    """Derivative (R, X) of the relative rotations by the unknowns, rad per sqrt(J)."""
    capacity: Array
    """Largest friction torques (R,), N m."""
    rows_by_bend: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Derivative (R, 2 N) of the relative rotations in a bundle by kappa, as h follows it."""

    @property
    def torsion(self) -> Evaluation:
        """State of tubes without external load."""
        assert isinstance(self.elastic, Evaluation)
        return self.elastic


def evaluate_contact(contact: Contact, rotations: Array, x: Array) -> ContactState:
    """Energy, its derivatives, and relative rotations at x (X,) for base rotations (n,)."""
    elastic_x, y = np.split(x, [contact.elastic_size])
    elastic: Evaluation | LoadedState
    if contact.loaded is None:
        elastic = evaluate(contact.problem, rotations, elastic_x)
    else:
        elastic = loaded.evaluate(contact.loaded, rotations, elastic_x)
    gradient, hessian = elastic.gradient, elastic.hessian
    if len(y):
        gradient = np.concatenate([gradient, y])
        hessian = scipy.linalg.block_diag(hessian, np.eye(len(y)))
    relative = (rotations[contact.pair + 1] - rotations[contact.pair]) + contact.rows @ x
    energy = elastic.potential + float(y @ y) / 2
    return ContactState(contact, x, elastic, energy, gradient, hessian, relative, contact.rows, contact.capacity)


def contact_profile(contact: Contact, rotations: Array, state: ContactState, torque: Array) -> Profile:
    """Torsion along the tubes of a solved contact with friction torques (R,), N m."""
    problem, moment = contact.problem, state.elastic.torque.copy()
    at_points = np.flatnonzero(contact.point >= 0)
    point, pair = contact.point[at_points], contact.pair[at_points]
    per_length = torque[at_points] / problem.weight[point]
    np.add.at(moment, (point, pair + 1), per_length)
    np.add.at(moment, (point, pair), -per_length)
    concentrated = np.flatnonzero(contact.point < 0)
    ends = np.append(problem.mesh.start, problem.assembly.total_length)
    end = np.argmin(np.abs(ends - contact.arc_length[concentrated, None]), axis=1)
    inner, at_end = contact.pair[concentrated], torque[concentrated]
    tubes, torques = np.concatenate([inner + 1, inner]), np.concatenate([-at_end, at_end])
    return pushed(problem, integrate(problem, rotations, moment), np.tile(end, 2), tubes, torques)


def unknowns_of(
    contact: Contact, rotations: Array, points: Array, end_rotations: Array, bending: Array | None = None
) -> Array:
    """Unknowns x (X,) for elastic rotations at the collocation points (N, n) and at the M points between them.

    Under a load `bending` (N, 2) is the curvature at the points less that without load, 1/m.
    """
    z = to_unknowns(contact.problem, rotations, points)
    parts = [z]
    if contact.loaded is not None:
        assert bending is not None
        parts.append((bending / contact.loaded.softness[:, None]).ravel())
    if contact.rotation_by_y.shape[1]:
        residual = end_rotations - rotations[contact.tube] - contact.rotation_by_z @ z
        parts.append(np.asarray(np.linalg.lstsq(contact.rotation_by_y, residual, rcond=None)[0], dtype=float))
    return np.concatenate(parts)


def bending_of(contact: Contact, x: Array) -> Array | None:
    """Curvature (N, 2) at the collocation points less that without load, 1/m; None without a load."""
    if contact.loaded is None:
        return None
    return contact.loaded.softness[:, None] * x[contact.problem.size : contact.elastic_size].reshape(-1, 2)


# --- Tubes in the channels of a sheath --------------------------------------------------------------------------------

SHEATH = -1
"""Number of the sheath among the outer tubes of pairs."""


@dataclass(frozen=True, eq=False)
class Material:
    """Rotations of the material of all tubes in a state of a bundle."""

    state: BundleState
    rotations: Array
    """Base rotations (n,), rad."""
    translations: Array
    """Translations (n,), m."""

    def rotation(self, tube: Index, place: Array) -> Array:
        """Rotations (R,) of tubes (R,), rad, at places (R,) on them: own length from the plate at home, m."""
        problem, t = self.state.problem, self.state.problem.tableau
        count, bundle = len(problem.section), problem.bundle
        turn, length = (part.reshape(count, t.degree, -1) for part in (self.state.turn, self.state.length))
        length = np.where(problem.present.reshape(length.shape), length, 0.0)
        twist = problem.torsion(self.state.x)[1]
        along = np.cumsum(np.einsum("k,pkn->pn", t.weights, length), axis=0)
        reached = self.rotations + twist + np.cumsum(np.einsum("k,pkn->pn", t.weights, turn), axis=0)
        to_place = place + self.translations[tube]
        # The first element that reaches the place; beyond the end of a tube, its last one.
        beyond = (along[:, tube] < np.minimum(to_place, along[-1, tube] - HELD)).sum(0)
        element = np.minimum(beyond, count - 1)
        first = np.where(element > 0, along[element - 1, tube], 0.0)
        base = np.where(element > 0, reached[element - 1, tube], (self.rotations + twist)[tube])
        g, p = length[element, :, tube], turn[element, :, tube]
        x = np.clip(to_place - first, 0.0, None) / np.maximum(g @ t.weights, HELD)
        for _ in range(3):  # g varies by a percent in an element
            x = x - ((t.lagrange(x, integrals=1) * g).sum(1) - (to_place - first)) / (t.lagrange(x) * g).sum(1)
        inside = base + (t.lagrange(x, integrals=1) * p).sum(1)
        # Behind the plate the twist is constant; a tube clamped at the plate has no rotation there.
        per_length = np.divide(twist, bundle.transmission, out=np.zeros(len(twist)), where=bundle.transmission > 0)
        behind = np.maximum(to_place, -bundle.transmission[tube])
        return np.asarray(np.where(to_place < 0, (self.rotations + twist)[tube] + behind * per_length[tube], inside))


class Place(NamedTuple):
    """Places of R rows of friction on the mesh of a bundle."""

    inner: Index
    """Tubes (R,) that rub in what is around them."""
    outer: Index
    """Tubes (R,) around them, or SHEATH."""
    point: Index
    """Points (R,); -1 for concentrated friction."""
    up_to: Array
    """Weights (R, N) of the integrals up to the places."""
    at: Array
    """Weights (R, N) that interpolate to the places."""
    torque: Array
    """Largest torque (R,): per own length of the inner tube, N, or at places, N m."""


@dataclass(frozen=True, eq=False)
class BundleContact:
    """Rows of friction of the tubes of a bundle in their channels, as `Contact` has for nested tubes."""

    problem: BundleProblem
    friction: Friction
    pairs: tuple[tuple[int, int], ...]
    """Pairs (n,) of each tube and the tube around it, or SHEATH."""
    rotations: Array
    """Base rotations (n,), rad."""
    translations: Array
    """Translations (n,), m."""
    before: Material
    """State from which slips are measured."""
    advanced: Callable[[BundleState, Array], BundleState]
    """Returns the state after a step; boundaries may have another order or stay together there."""
    linear = False
    """True if rows and capacities do not change with the unknowns."""

    @cached_property
    def place(self) -> Place:
        """Places of the rows."""
        problem, n, friction = self.problem, self.problem.n, self.friction
        count, degree = len(problem.weight), problem.tableau.degree
        torque, plate, jumps, ends = (
            np.array(friction.per_pair(name, n)) for name in ("torque", "plate", "jumps", "ends")
        )
        long = ~np.isin(problem.point_section, [*problem.held])
        inner, outer = [], []
        point, up_to, at, limit = [], [], [], []

        def add(pair: tuple[int, int], where: int, whole: Array, here: Array, largest: float) -> None:
            if largest > 0:
                inner.append(pair[0])
                outer.append(pair[1])
                point.append(where)
                up_to.append(whole)
                at.append(here)
                limit.append(largest)

        def around(i: int, outside: int, k: int) -> tuple[int, int]:
            return (i, outside) if outside >= 0 and problem.present[k, outside] else (i, SHEATH)

        unit = np.eye(count)
        for i, outside in self.pairs:
            for k in np.flatnonzero(long & problem.present[:, i]).tolist():
                add(around(i, outside, k), k, problem.up_to[k], unit[k], float(torque[i]))
            if not problem.present[0, i]:
                continue
            # A tube clamped at the plate itself follows its drive there.
            if i in problem.sprung or (outside in problem.sprung and problem.present[0, outside]):
                add(around(i, outside, 0), -1, np.zeros(count), unit[0], float(plate[i]))
            for section, boundary in enumerate(problem.order):
                whole = problem.weight * (problem.point_section <= section)
                last = int(np.flatnonzero(problem.point_section == section)[-1])
                here = np.zeros(count)
                here[last + 1 - degree : last + 1] = problem.tableau.basis((1.0,), 0)[0]
                pair = around(i, outside, last)
                if problem.present[last, i] and {i, pair[1]} & set(boundary.tubes):
                    ending = (i if pair[1] == SHEATH else pair[1]) in boundary.ends
                    add(pair, -1, whole, here, float(ends[i] if ending else jumps[i]))
        shape = (-1, count)
        return Place(
            np.array(inner, dtype=np.intp),
            np.array(outer, dtype=np.intp),
            np.array(point, dtype=np.intp),
            np.reshape(up_to, shape),
            np.reshape(at, shape),
            np.array(limit),
        )

    @property
    def pair(self) -> Index:
        """Inner tubes (R,) of the rows."""
        return self.place.inner

    @property
    def load(self) -> Load | None:
        """External load, or None."""
        return self.problem.load

    def largest_rotation(self, step: Array) -> float:
        """Largest rotation by a step in x, rad: of a tube, or of the arm."""
        change, n = self.problem.push(step), self.problem.n
        arm = self.problem.up_to @ change[:, -3:-1]
        return max(float(np.abs(change[:, :n]).max()), float(np.abs(arm).max()))

    def evaluate(self, rotations: Array, x: Array) -> ContactState:
        """State at base rotations (n,) and unknowns x (X,), without friction."""
        return self.of(rotations, bundle.evaluate(self.problem, rotations, x))

    def moved(self, rotations: Array, state: ContactState, step: Array) -> ContactState:
        """State after a step (X,), of another contact if sections vanish."""
        elastic = self.advanced(state.elastic, step)
        contact = self if elastic.problem is self.problem else replace(self, problem=elastic.problem)
        return contact.of(rotations, elastic)

    def renewed(self, state: ContactState) -> tuple[ContactState, Array]:
        """State from which slips are measured, and its relative rotations (R,)."""
        material, none = Material(state.elastic, self.rotations, self.translations), np.zeros(len(state.rows))
        contact = replace(self, problem=state.elastic.problem, before=material)
        return replace(state, contact=contact, relative_rotations=none), none

    def of(self, rotations: Array, elastic: BundleState) -> ContactState:
        """State of a contact from that of the tubes."""
        problem, place = self.problem, self.place
        inner, outer, up_to = place.inner, place.outer, place.up_to
        rows, n = len(inner), problem.n
        parts = self, elastic.x, elastic, elastic.energy, elastic.gradient, elastic.hessian
        if not np.isfinite(elastic.energy):
            return ContactState(*parts, np.zeros(rows), np.full((rows, problem.size), np.nan), np.ones(rows))
        base = rotations + problem.torsion(elastic.x)[1]
        length = np.where(problem.present, elastic.length, 0.0)
        slip, stretch = np.zeros(rows), np.zeros((rows, n))
        table = np.zeros((rows, n, len(problem.weight) + 1))
        row, integral = np.arange(rows), np.column_stack([up_to, np.ones(rows)])
        for sign, every in ((-1.0, inner), (1.0, outer)):
            on = np.flatnonzero(every >= 0)
            tube = every[on]
            theta = base[tube] + (up_to[on] * elastic.turn.T[tube]).sum(1)
            sigma = (up_to[on] * length.T[tube]).sum(1)
            was = self.before.rotation(tube, sigma - self.translations[tube])
            slip[on] += sign * (theta - was)
            twist = (place.at[on] * elastic.turn.T[tube]).sum(1) / (place.at[on] * length.T[tube]).sum(1)
            stretch[on, tube] = sign * twist
            table[row[on], tube] = sign * integral[on]
        # d sigma = integral of dh + d a.dkappa.
        by_bend = up_to[:, :, None] * (stretch @ problem.bundle.levers)[:, None]
        along = stretch.sum(1)[:, None] * ((up_to @ problem.in_section.T) @ problem.lengths_by_bend)
        by_torsion = table.reshape(rows, -1)[:, problem.rows] * problem.scale
        by_kappa = -by_bend.reshape(rows, -1) - along
        by_x = np.hstack([by_torsion, by_kappa @ problem.bend_map])
        at_points = place.point >= 0
        covered = (problem.weight[:, None] * length)[place.point, inner]
        return ContactState(*parts, slip, by_x, place.torque * np.where(at_points, covered, 1.0), by_kappa)

    def form(self, state: ContactState) -> tuple[Array, Array]:
        """Second variation and the rows in its coordinates. Its smallest eigenvalue is the margin."""
        basis = margin_basis(state.elastic)
        return basis.T @ state.hessian @ basis, state.rows @ basis

    def round_off(self, state: ContactState) -> float:
        """Sum of the parts of the energy (J), which may cancel."""
        return abs(state.energy) + 2 * abs(float(state.elastic.work))
