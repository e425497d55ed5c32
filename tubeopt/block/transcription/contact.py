"""Where neighbouring tubes rub: their relative rotations as linear functions of the whitened unknowns.

With theta = alpha + L z at the collocation points, the rotation of a tube in the next one around it at row r is

    phi_r = alpha_outer - alpha_inner + P_r x,     x = (z, y),

and friction of capacity D_r = B_a tau bears the torque lam_r, |lam_r| <= D_r. Concentrated friction (at the plate, at a
jump of curvature, where a tube ends) acts between the points. What rotation the unknowns z leave open there is the
conditional compliance of that place given the points; it is whitened too, into unknowns y that no bending energy sees:
the energy is E(z) + y'y / 2.

Under a load the arm also bends by q (see `loaded`): x = (z, q, y), and an equilibrium makes E(z, q) - W + y'y / 2
least. The rows stay as they are, since bending changes no rotation of one tube in another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ...robots.assembly import ROUND_OFF, Assembly
from ...robots.concentric import PAIRWISE, Friction
from ...robots.load import Load
from ...typing import Array, Index, Mask
from . import loaded
from .arm import Profile, integrate, pushed
from .loaded import LoadedProblem, LoadedState, Loading, load_problem
from .mesh import loaded_mesh, make_mesh, piece_counts
from .reduced import Evaluation, ReducedProblem, evaluate, reduce, to_unknowns

DEGREE = 6
"""Collocation points of a piece."""

PIECES = 4
"""Least number of pieces along which two tubes rub: the kink of the torsion where slip ends lies inside one."""

LOOSE = 1e-11
"""Part of a compliance that is round-off: what the points leave open by less, they tell."""


@dataclass(frozen=True, eq=False)
class Contact:
    """R rows of friction of an assembly; X unknowns x, of which the last Y turn M tubes at places between the points.

    Attributes:
        problem: the torsion, with the rotation of every tube that rubs unknown.   friction: as given.
        loading, loaded: a load, and the same torsion with the bending under it; None without load.
        rows: (R, X) relative rotation by the unknowns, rad per sqrt(J).
        capacity: (R,) N m.   arc_length: (R,) m.
        pair: (R,) the inner tube.   point: (R,) collocation point, -1 for concentrated friction.
        place, tube: (M,) arc length, m, and tube, of the rotations between the points.
        known: (M, U) these by z.   loose: (M, Y) by y.
    """

    problem: ReducedProblem
    friction: Friction
    loading: Loading | None
    loaded: LoadedProblem | None
    rows: Array
    capacity: Array
    arc_length: Array
    pair: Index
    point: Index
    place: Array
    tube: Index
    known: Array
    loose: Array

    @property
    def elastic_size(self) -> int:
        """Number of unknowns (z, q) of torsion and bending, ahead of the Y others."""
        return self.problem.size if self.loaded is None else self.loaded.size

    @property
    def load(self) -> Load | None:
        """The load on the tubes."""
        return None if self.loading is None else self.loading.load

    def turn_of(self, step: Array) -> float:
        """Largest turn (rad) by a step in x: of a tube, or of the arm if its curvature changed alike all along it."""
        torsion, bending, rest = np.split(step, [self.problem.size, self.elastic_size])
        turns = [self.problem.factor @ torsion, self.known @ torsion + self.loose @ rest]
        if self.loaded is not None:
            length = self.problem.assembly.total_length
            turns.append(length * np.repeat(self.loaded.softness, 2) * bending)
        return float(np.abs(np.concatenate(turns)).max(initial=0.0))


def make_contact(assembly: Assembly, friction: Friction, loading: Loading | None = None) -> Contact:
    """The rows of friction of concentric tubes under a load or none, on a mesh fine enough for both."""
    n = assembly.n_tubes
    capacities = {name: np.array(friction.per_pair(name, n - 1)) for name in PAIRWISE}
    # (m, n - 1) sections in which a pair touches that rubs anywhere.
    rub = np.sum(list(capacities.values()), axis=0) > 0
    touching = assembly.present[:, 1:] & rub
    unknown = assembly.curved & (assembly.coupled | (loading is not None))[:, None]
    unknown[:, 1:] |= touching
    unknown[:, :-1] |= touching
    problem = _problem(assembly, friction, touching, unknown, loading)
    under_load = None if loading is None else load_problem(problem, loading.load, loading.density)
    bending = 0 if under_load is None else under_load.size - problem.size
    index = np.full((len(problem.weight), n), -1)
    index[problem.point, problem.tube] = np.arange(problem.size)
    spots = _spots(assembly, capacities)
    place, tube = _between(spots)
    known, loose = _open(problem, place, tube)
    held = np.zeros((problem.size, bending + loose.shape[1]))
    by_x = np.block([[problem.factor, held], [known, np.zeros((len(known), bending)), loose]])
    section = np.repeat(problem.mesh.section[problem.mesh.collocated], DEGREE)
    pair, point = np.nonzero((assembly.present[:, 1:] & (capacities["torque"] > 0))[section].T)
    rows = by_x[index[point, pair + 1]] - by_x[index[point, pair]]
    whole: tuple[list[Any], ...] = (
        [rows],
        [capacities["torque"][pair] * problem.weight[point]],
        [problem.arc_length[point]],
        [pair],
        [point],
    )
    for s, i, most in spots:
        outer, inner = (problem.size + int(np.flatnonzero((place == s) & (tube == j))[0]) for j in (i + 1, i))
        row = by_x[outer] - by_x[inner]
        if row @ row > 0:  # tubes that are held at the plate itself turn as their drives do, whatever rubs
            for column, value in zip(whole, (row, most, s, i, -1), strict=True):
                column.append(np.array([value]))
    rows, capacity, arc_length, pair, point = (np.concatenate(column) for column in whole)
    return Contact(
        problem, friction, loading, under_load, rows, capacity, arc_length, pair, point, place, tube, known, loose
    )


def _problem(
    assembly: Assembly, friction: Friction, rubs: Mask, unknown: Mask, loading: Loading | None
) -> ReducedProblem:
    """The torsion with the rotations `unknown` (m, n), in sections that are cut finer where pairs rub (m, n - 1)."""
    overlap = assembly.length @ rubs
    longest = np.min(np.where(rubs, overlap / (PIECES * 2.0**friction.refinement), np.inf), axis=1, initial=np.inf)
    counts = np.maximum(piece_counts(assembly), np.ceil(assembly.length / longest - 1e-9).astype(np.intp))
    if loading is not None:
        return reduce(assembly, loaded_mesh(assembly, np.maximum(counts, loading.counts), degree=DEGREE), unknown)
    mesh = make_mesh(assembly, counts, degree=DEGREE)
    return reduce(assembly, replace(mesh, collocated=(unknown.sum(1) > 0)[mesh.section]), unknown)


def _spots(assembly: Assembly, capacities: dict[str, Array]) -> list[tuple[float, int, float]]:
    """Arc length, inner tube and capacity (N m) of all that rubs at one place."""
    result: dict[tuple[float, int], float] = {}

    def add(s: float, pair: int, most: float) -> None:
        if most > 0:
            result[s, pair] = result.get((s, pair), 0.0) + most

    for i in range(assembly.n_tubes - 1):
        end = float(assembly.end[i + 1])
        if end <= ROUND_OFF:
            continue
        add(0.0, i, capacities["plate"][i])
        cuts = zip(assembly.breakpoints, assembly.breakpoint_tubes, strict=True)
        for s in {s for s, j in cuts if j in (i, i + 1) and ROUND_OFF < s < end - ROUND_OFF}:
            add(_nearest(assembly, s), i, capacities["jumps"][i])
        add(_nearest(assembly, end), i, capacities["ends"][i])
    return [(s, i, most) for (s, i), most in result.items()]


def _nearest(assembly: Assembly, s: float) -> float:
    """The end of a section at arc length s, of which breakpoints that are one keep a single one."""
    ends = np.append(assembly.start, assembly.total_length)
    return float(ends[np.argmin(np.abs(ends - s))])


def _between(spots: list[tuple[float, int, float]]) -> tuple[Array, Index]:
    """Places, m, and tubes of the rotations that concentrated friction works on, by tube."""
    both = sorted({(j, s) for s, i, _ in spots for j in (i, i + 1)})
    return np.array([s for _, s in both]), np.array([j for j, _ in both], dtype=np.intp)


def _open(problem: ReducedProblem, place: Array, tube: Index) -> tuple[Array, Array]:
    """Rotations (M,) of tubes at ends of pieces by z, and by unknowns of their own for what z leaves open."""
    known, columns = np.zeros((len(place), problem.size)), []
    soft_points, soft_ends = problem.softness
    ends = np.append(problem.mesh.start, problem.assembly.total_length)
    for j in np.unique(tube):
        mine, unknowns = np.flatnonzero(tube == j), np.flatnonzero(problem.tube == j)
        own = np.array([soft_ends[np.argmin(np.abs(ends - s)), j] for s in place[mine]])
        crossed = np.minimum(own[:, None], soft_points[problem.point[unknowns], j])
        factor = problem.factor[np.ix_(unknowns, unknowns)]
        known[np.ix_(mine, unknowns)] = scipy.linalg.solve_triangular(factor, crossed.T, lower=True).T
        rest = np.minimum(own[:, None], own) - known[mine] @ known[mine].T
        values, vectors = np.linalg.eigh(rest)
        kept = values > LOOSE * max(float(own.max()), 1e-300)
        part = np.zeros((len(place), int(kept.sum())))
        part[mine] = vectors[:, kept] * np.sqrt(values[kept])
        columns.append(part)
    return known, np.concatenate([np.zeros((len(place), 0)), *columns], axis=1)


@dataclass(frozen=True, eq=False)
class Rubbing:
    """State of a contact at unknowns x, without friction: `elastic` is that of the tubes, by (z, q); energy is that of
    x less the work of a load, J, with its gradient and Hessian; `turned` (R,) are the relative rotations, rad."""

    x: Array
    elastic: Evaluation | LoadedState
    energy: float
    gradient: Array
    hessian: Array
    turned: Array

    @property
    def torsion(self) -> Evaluation:
        """State of tubes that bear no load."""
        assert isinstance(self.elastic, Evaluation)
        return self.elastic


def evaluate_contact(contact: Contact, rotations: Array, x: Array) -> Rubbing:
    """Energy, its derivatives, and relative rotations at x (U + Y,) for base rotations (n,)."""
    own, y = np.split(x, [contact.elastic_size])
    elastic: Evaluation | LoadedState
    if contact.loaded is None:
        elastic = evaluate(contact.problem, rotations, own)
    else:
        elastic = loaded.evaluate(contact.loaded, rotations, own)
    gradient, hessian = elastic.gradient, elastic.hessian
    if len(y):
        gradient = np.concatenate([gradient, y])
        hessian = scipy.linalg.block_diag(hessian, np.eye(len(y)))
    turned = (rotations[contact.pair + 1] - rotations[contact.pair]) + contact.rows @ x
    return Rubbing(x, elastic, elastic.potential + float(y @ y) / 2, gradient, hessian, turned)


def rubbing_profile(contact: Contact, rotations: Array, state: Rubbing, torque: Array) -> Profile:
    """theta_i(s) of a solved contact whose rows bear torques (R,), N m."""
    problem, moment = contact.problem, state.elastic.torque.copy()
    inside = np.flatnonzero(contact.point >= 0)
    point, pair, per_length = contact.point[inside], contact.pair[inside], torque[inside]
    per_length = per_length / problem.weight[point]
    np.add.at(moment, (point, pair + 1), per_length)
    np.add.at(moment, (point, pair), -per_length)
    spots = np.flatnonzero(contact.point < 0)
    ends = np.append(problem.mesh.start, problem.assembly.total_length)
    end = np.argmin(np.abs(ends - contact.arc_length[spots, None]), axis=1)
    inner, push = contact.pair[spots], torque[spots]
    both = np.concatenate([inner + 1, inner]), np.concatenate([-push, push])
    return pushed(problem, integrate(problem, rotations, moment), np.tile(end, 2), *both)


def unknowns_of(contact: Contact, rotations: Array, points: Array, between: Array, bent: Array | None = None) -> Array:
    """x (X,) of elastic rotations at the collocation points (N, n) and at the places between them (M,); under a load
    also of `bent` (N, 2), the curvature at the points beyond that without load, 1/m."""
    z = to_unknowns(contact.problem, rotations, points)
    parts = [z]
    if contact.loaded is not None:
        assert bent is not None
        parts.append((bent / contact.loaded.softness[:, None]).ravel())
    if contact.loose.shape[1]:
        rest = between - rotations[contact.tube] - contact.known @ z
        parts.append(np.asarray(np.linalg.lstsq(contact.loose, rest, rcond=None)[0], dtype=float))
    return np.concatenate(parts)


def bent_of(contact: Contact, x: Array) -> Array | None:
    """(N, 2) curvature beyond that without load at the collocation points, 1/m; None without a load."""
    if contact.loaded is None:
        return None
    return contact.loaded.softness[:, None] * x[contact.problem.size : contact.elastic_size].reshape(-1, 2)
