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

So E has no constraints but h > 0 and g > 0. Where it falls towards h = 0 with the boundaries at both ends of a section
in either order, they stay together: the section is held at the length HELD. E contains the axial force of each tube,
N = kb (kappa_0^2 - |v|^2) / 2 - kt w^2 / 2 - lambda, with its own curvature v and twist w. The constants lambda are the
multipliers of these equations. At its end lambda g = psi g + (energy per length that the other tubes lose, since their
curvature jumps there), with the density psi of the tube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from ...physics.shape import frame_forms, hat, rotation_matrix_function
from ...physics.torsion import bundle_energy
from ...robots.load import FORCE, MOMENT, Load, Stretch
from ...typing import Array, Index, Mask
from .arm import ArmShape, along_elements
from .buffered import mapped
from .collocated import ENDS
from .mesh import Mesh, SectionNeeds, whole_elements
from .orientation import (
    adjoint,
    centreline,
    moment_work,
    orient,
    position_slopes,
    second_derivative,
    tangent_slopes,
    tangents,
)
from .tableau import Tableau, tableau

SAME_PLACE = 1e-9
"""Difference (m) of offsets and of own lengths below which boundaries of tubes are one."""

HELD = 1e-12
"""Length (m) of the sections between boundaries that stay together."""

FELT = 1e-8
"""Length (m) as which a held section counts in the size of a step: its own would hide an unsettled curvature."""

VANISHING = 1e-10
"""Length (m) of an element below which its section counts as vanishing."""

CLOSING = 1e-4
"""Length (m) of an element below which a step that closes its section leads to an exchange."""

TO_BOUNDARY = 0.5
"""Fraction of the way to a section or a tube without length that a step may go."""


# Torsion is the derivative of a polynomial here; of concentric tubes it is integrated from the torques.
FINER, FINER_UNDER_LOAD = 3.0, 3.0
"""Number of elements for each one of concentric tubes: errors of the thesis robot are then about 1e-11 rad."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """n tubes at joint translations, in front of the plate."""

    bending_stiffness: Array
    """Bending stiffnesses kb (n,), N m^2."""
    torsional_stiffness: Array
    """Torsional stiffnesses kt (n,), N m^2."""
    curvature: Array
    """Precurvatures kappa_0 (n,) of the curved parts, 1/m."""
    offset: Array
    """Distances d (n,) of the tubes from the centreline, m."""
    angle: Array
    """Directions phi (n,) of the offsets in the cross-section, rad."""
    transmission: Array
    """Lengths |beta| (n,) from the clamped ends of the tubes to the plate, m."""
    transition: Array
    """Own arc length (n,) from the plate to where the curve begins, m; negative behind the plate."""
    end: Array
    """Own arc length (n,) from the plate to the end, m."""
    sheath: float = 0.0
    """Bending stiffness of the sheath, N m^2."""
    rigid_length: float = 0.0
    """Length of the rigid part of the sheath at the plate, m."""
    rigid_from: float = np.inf
    """Arc length of the sheath from which on it is rigid, m."""

    def is_rigid(self, passed: Sequence[Boundary]) -> bool:
        """True if the sheath is rigid directly behind the boundaries `passed`, seen from the plate."""
        places = np.array([b.arc_length for b in passed if b.of_sheath])
        begun, over = (bool((np.abs(places - s) <= SAME_PLACE).any()) for s in (self.rigid_from, self.rigid_length))
        return begun or (self.rigid_length > SAME_PLACE and not over)

    @cached_property
    def beyond_rigid_length(self) -> Bundle:
        """The same tubes with the plate at the end of the rigid part, since tubes are straight behind both."""
        if not self.rigid_length:
            return self
        return replace(
            self,
            transmission=self.transmission + self.rigid_length,
            transition=self.transition - self.rigid_length,
            end=self.end - self.rigid_length,
            rigid_length=0.0,
            rigid_from=self.rigid_from - self.rigid_length,
        )

    @cached_property
    def levers(self) -> Array:
        """Levers d a (n, 2) of the tubes, m: stretch of a tube per curvature."""
        return np.asarray(self.offset[:, None] * np.column_stack([np.sin(self.angle), -np.cos(self.angle)]))


class Boundary(NamedTuple):
    """End of a section."""

    arc_length: float
    """Own arc length of its tubes from the plate, of a place of the sheath its arc length, m."""
    tubes: tuple[int, ...] = ()
    """Tubes that end or begin to curve at the boundary, side by side at one offset."""
    ends: tuple[int, ...] = ()
    """Tubes that end at the boundary."""
    of_sheath: bool = False
    """True for a place of the sheath: the force on a cross-section jumps, or a rigid part begins or ends."""

    @property
    def key(self) -> tuple[object, ...]:
        """Name that stays the same when tubes move."""
        return self.tubes, self.ends, self.arc_length if self.of_sheath else None


def boundaries(bundle: Bundle, places: Sequence[float] = ()) -> list[Boundary]:
    """Boundaries in front of the plate, in no order; `places` are arc lengths of the sheath, m.

    Where the sheath is rigid at the plate, as behind the plate, it makes no difference where tubes begin to curve.
    """
    n, centre = len(bundle.end), np.zeros(2)
    rigid = [s for s in (bundle.rigid_length, bundle.rigid_from) if SAME_PLACE < s < np.inf]
    # Tube or None, own length, stretch by curvature, end.
    left: list[tuple[int | None, float, Array, bool]] = []
    left += [(i, float(bundle.transition[i]), bundle.levers[i], False) for i in range(n) if bundle.curvature[i]]
    left += [(i, float(bundle.end[i]), bundle.levers[i], True) for i in range(n)]
    left = [one for one in left if one[1] > bundle.rigid_length + SAME_PLACE]
    left = [(None, s, centre, False) for s in (*places, *rigid) if s > SAME_PLACE] + left
    out = []
    while left:
        _, s, lever, _ = left[0]
        # Boundaries at one offset never pass each other by bending.
        same = [one for one in left if abs(one[1] - s) + float(np.abs(one[2] - lever).max()) <= SAME_PLACE]
        tubes = tuple(sorted({i for i, *_ in same if i is not None}))
        ends = tuple(i for i, _, _, end in same if end and i is not None)
        out.append(Boundary(s, tubes, ends, any(i is None for i, *_ in same)))
        left = [one for one in left if not any(one is other for other in same)]
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
    order: list[Boundary] = []
    done, arc, lengths, curvatures = np.zeros(n), 0.0, [], []
    direction = np.column_stack([np.cos(rotations), np.sin(rotations)])
    while any(b.ends for b in left):
        present, curved = tubes_at(bundle, left)
        kb = bundle.bending_stiffness * present
        u = (kb * bundle.curvature * curved) @ direction / (kb.sum() + bundle.sheath)
        u *= not bundle.is_rigid(order)
        stretch = 1 + bundle.levers @ u
        to_go = [
            (b.arc_length - done[b.tubes[0]]) / stretch[b.tubes[0]] if b.tubes else b.arc_length - arc for b in left
        ]
        k = int(np.argmin(to_go))
        h = max(to_go[k], 0.0)
        order.append(left.pop(k))
        lengths.append(h)
        curvatures.append(u)
        done, arc = done + stretch * h, arc + h
    return Start(tuple(order), np.array(lengths), np.array(curvatures).reshape(-1, 2))


def tubes_at(bundle: Bundle, ahead: Sequence[Boundary]) -> tuple[Mask, Mask]:
    """Masks (n,) of the tubes that are present, and of those that are curved, between the plate and the boundaries
    `ahead`.
    """
    n = len(bundle.end)
    ends = {i for b in ahead for i in b.ends}
    transitions = {i for b in ahead for i in b.tubes if i not in b.ends}
    present = np.array([i in ends for i in range(n)])
    return present, present & np.array([i not in transitions for i in range(n)])


def tubes_of_sections(bundle: Bundle, order: Sequence[Boundary]) -> tuple[Mask, Mask]:
    """Masks (m, n) of the tubes that are present, and of those that are curved, in sections up to each boundary."""
    present, curved = zip(*(tubes_at(bundle, order[k:]) for k in range(len(order))), strict=True)
    return np.array(present), np.array(curved)


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Energy of a bundle with its boundaries in one order; N points, P elements, m sections, U unknowns.

    Unknowns x are whitened: p and the rotations at the plate by the torsional energy, kappa by the bending energy of
    the start. Where sections are held, kappa is orthogonal to what changes their lengths.
    """

    bundle: Bundle
    order: tuple[Boundary, ...]
    nominal: Array
    """Lengths (m,) of the elements of each section in the start, m. They scale the unknowns."""
    count: Index
    """Numbers (m,) of elements of the sections."""
    tableau: Tableau
    load: Load | None = None
    """External load at the factor 1, or None."""
    density: tuple[float, ...] = ()
    """Masses (n,) per own length of the tubes, kg/m; empty without gravity."""
    held: tuple[int, ...] = ()
    """Sections between boundaries that stay together."""

    @property
    def n(self) -> int:
        """Number n of tubes."""
        return len(self.bundle.end)

    @cached_property
    def _of_sections(self) -> tuple[Mask, Mask]:
        present, curved = tubes_of_sections(self.bundle, self.order)
        if self.bundle.rigid_length > SAME_PLACE:
            # Energy of straightening counts beyond the rigid part only, as it does in front of the plate.
            curved[: 1 + self.boundary_at(self.bundle.rigid_length)] = False
        return present, curved

    @cached_property
    def bends(self) -> Mask:
        """Mask (2 N,) of the turns kappa that are free: those where the sheath is not rigid."""
        rigid = np.array([self.bundle.is_rigid(self.order[:k]) for k in range(len(self.order))])
        return np.repeat(~rigid[self.point_section], 2)

    @cached_property
    def section(self) -> Index:
        """Number of the section (P,) of each element."""
        return np.repeat(np.arange(len(self.order)), self.count)

    @cached_property
    def point_section(self) -> Index:
        """Number of the section (N,) of each point."""
        return np.repeat(self.section, self.tableau.degree)

    @cached_property
    def in_section(self) -> Array:
        """Matrix (m, N) that sums over the points of each section."""
        return np.asarray(self.point_section == np.arange(len(self.order))[:, None], dtype=float)

    @cached_property
    def mesh(self) -> Mesh:
        """Elements of length 1, on which the turn of the centreline is kappa."""
        ones = np.ones(len(self.section))
        return Mesh(self.tableau, np.arange(len(ones), dtype=float), ones, self.section, ones > 0)

    @cached_property
    def weight(self) -> Array:
        """Quadrature weights (N,) on elements of length 1."""
        return np.tile(self.tableau.weights, len(self.section))

    @cached_property
    def present(self) -> Mask:
        """Mask (N, n) of the tubes that are there."""
        return np.asarray(self._of_sections[0][self.point_section])

    @cached_property
    def curved(self) -> Mask:
        """Mask (N, n) of the tubes that are curved at the points."""
        return np.asarray(self._of_sections[1][self.point_section])

    @cached_property
    def stiffness(self) -> Array:
        """Bending stiffnesses kb (N, n) of the tubes present at the points, N m^2."""
        return self.bundle.bending_stiffness * self.present

    @cached_property
    def inputs(self) -> tuple[Array, ...]:
        """Inputs of `bundle_energy` that are independent of x."""
        bundle = self.bundle
        moment = bundle.bending_stiffness * bundle.curvature * self.curved
        place = np.broadcast_arrays(bundle.offset, bundle.angle)
        return self.stiffness, bundle.torsional_stiffness * self.present, moment, *place, np.array([bundle.sheath])

    @cached_property
    def up_to(self) -> Array:
        """Integrals (N, N) over elements of length 1 up to each point, weighted."""
        k = self.tableau.degree
        element = np.arange(len(self.weight)) // k
        whole = np.where(element < element[:, None], self.weight, 0.0)
        return np.asarray(whole + np.kron(np.eye(len(self.section)), self.tableau.matrix))

    @cached_property
    def turned(self) -> Array:
        """Rotations (N, N + 1) of a tube at the points by its p there and by its rotation at the plate."""
        return np.column_stack([self.up_to, np.ones(len(self.weight))])

    @cached_property
    def rows(self) -> Index:
        """Torsional unknowns in a table (n, N + 1) of p at the points and of the rotation at the plate."""
        sprung = (self.bundle.transmission > SAME_PLACE) & self.present.any(0)
        return np.flatnonzero(np.column_stack([self.present.T, sprung]))

    @cached_property
    def sprung(self) -> Index:
        """Tubes with a transmission behind the plate, for which the rotations at the plate are unknown."""
        return np.flatnonzero((self.bundle.transmission > SAME_PLACE) & self.present.any(0))

    @cached_property
    def sprung_rows(self) -> Index:
        """Indices of the unknown rotations at the plate."""
        return np.flatnonzero(self.rows % (len(self.weight) + 1) == len(self.weight))

    @property
    def split(self) -> int:
        """Number of torsional unknowns, which precede those of bending."""
        return len(self.rows)

    @property
    def size(self) -> int:
        """Number U of unknowns."""
        return self.split + int(self.bend_map.shape[1])

    @cached_property
    def scale(self) -> Array:
        """Factors (split,) from whitened unknowns to p and the rotations at the plate; each has the energy x^2 / 2."""
        per_stiffness = np.append(self.nominal[self.point_section] / self.weight, 0.0) + np.zeros((self.n, 1))
        per_stiffness[:, -1] = self.bundle.transmission
        return np.sqrt(per_stiffness / self.bundle.torsional_stiffness[:, None]).ravel()[self.rows]

    @cached_property
    def lengths_by_boundaries(self) -> Array:
        """Inverse (m, m) of the map from element lengths h to the lengths up to the boundaries."""
        m = len(self.order)
        return np.asarray(np.linalg.inv(np.tril(np.ones((m, m))) * self.count))

    @cached_property
    def before(self) -> Array:
        """Weights (m, N) of the sum over the elements in front of each boundary."""
        return np.asarray((self.point_section <= np.arange(len(self.order))[:, None]) * self.weight)

    def at_boundaries(self, lever: Array) -> Array:
        """Values (m, ...) at the boundaries of a quantity (n, ...) of the tubes; 0 at places of the sheath."""
        return np.array([lever[b.tubes[0]] if b.tubes else np.zeros(lever.shape[1:]) for b in self.order])

    @cached_property
    def lengths_by_bend(self) -> Array:
        """Derivative (m, 2 N) of the lengths h by kappa: longer tubes on the outside of the bend end earlier."""
        longer = self.before[:, :, None] * self.at_boundaries(self.bundle.levers)[:, None]
        return np.asarray(-self.lengths_by_boundaries @ longer.reshape(len(self.order), -1))

    @cached_property
    def straight(self) -> Array:
        """Lengths h (m,) of the elements of each section of a straight arm, m."""
        return np.asarray(self.lengths_by_boundaries @ np.array([b.arc_length for b in self.order]))

    @cached_property
    def _bend_scale(self) -> Array:
        """Factors (2 N,) of kappa: the energy of each is x^2 / 2."""
        stiffness = self.stiffness.sum(1) + self.bundle.sheath
        return np.repeat(np.sqrt(self.nominal[self.point_section] / (self.weight * stiffness)), 2)

    @cached_property
    def _bending(self) -> tuple[Array, Array, Array]:
        """Derivative (2 N, U - split) of kappa by x, its inverse, and kappa (2 N,) at x = 0."""
        scale, free = self._bend_scale, np.eye(len(self.bends))[:, self.bends]
        if not self.held:
            return scale[:, None] * free, free.T / scale, np.zeros(len(scale))
        # Held lengths are linear in kappa: kappa is a sum of what they determine and of what they leave free.
        fixed = self.lengths_by_bend[[*self.held]] * scale * self.bends
        desired = HELD - self.straight[[*self.held]]
        free = free @ scipy.linalg.null_space(fixed[:, self.bends])
        start = scale * np.linalg.lstsq(fixed, desired, rcond=None)[0]
        return scale[:, None] * free, free.T / scale, start

    @property
    def bend_map(self) -> Array:
        """Derivative (2 N, U - split) of kappa by x."""
        return self._bending[0]

    def held_bend(self, longer: Array) -> Array:
        """Change (2 N, Q) of kappa at constant unknowns if the lengths of a straight arm change by (m, Q), m."""
        if not self.held:
            return np.zeros((2 * len(self.weight), longer.shape[1]))
        rows, scale = self.lengths_by_bend[[*self.held]], self._bend_scale * self.bends
        return scale[:, None] * np.linalg.lstsq(rows * scale, -longer[[*self.held]], rcond=None)[0]

    def bend(self, x: Array) -> Array:
        """Turns kappa (2 N,) of the centreline in the elements, at unknowns x (U,), rad."""
        by_x, _, start = self._bending
        return np.asarray(start + by_x @ x[self.split :])

    def lengths_of(self, bend: Array) -> Array:
        """Lengths h (m,) of the elements of each section at kappa (2 N,), m."""
        return np.asarray(self.straight + self.lengths_by_bend @ bend)

    def lengths(self, x: Array) -> Array:
        """Lengths h (m,) of the elements of each section at unknowns x, m."""
        return self.lengths_of(self.bend(x))

    def torsion(self, x: Array) -> tuple[Array, Array]:
        """Turns p (N, n) of the tubes, and their rotations (n,) at the plate by the twist of the transmissions, rad."""
        table = np.zeros((self.n, len(self.weight) + 1))
        table.ravel()[self.rows] = self.scale * x[: self.split]
        return table[:, :-1].T, table[:, -1]

    def unknowns(self, turn: Array, bend: Array, twist: Array) -> Array:
        """Unknowns (U,) closest to p (N, n), kappa (2 N,), and rotations (n,) at the plate, rad."""
        table = np.column_stack([turn.T, twist]).ravel()[self.rows]
        _, inverse, start = self._bending
        return np.concatenate([table / self.scale, inverse @ (bend - start)])

    def push(self, step: Array) -> Array:
        """Changes (N, 2 n + 3) of theta, p, kappa and h at the points by a step (U,)."""
        turn, twist = self.torsion(step)
        bend = self.bend_map @ step[self.split :]
        h = (self.lengths_by_bend @ bend)[self.point_section]
        return np.column_stack([self.up_to @ turn + twist, turn, bend.reshape(-1, 2), h])

    def adjoint_sums(self, table: Array) -> Array:
        """Sums (U, Q) of a table (N, 2 n + 3, Q) times the derivatives of theta, p, kappa and h by x."""
        count, _, q = table.shape
        by_turn = (self.turned.T @ table[:, : self.n].reshape(count, -1)).reshape(count + 1, self.n, q)
        by_turn[:-1] += table[:, self.n : 2 * self.n]
        bend = table[:, 2 * self.n : -1].reshape(2 * count, q) + self.lengths_by_bend.T @ (
            self.in_section @ table[:, -1]
        )
        torsion = self.scale[:, None] * by_turn.swapaxes(0, 1).reshape(-1, q)[self.rows]
        return np.concatenate([torsion, self.bend_map.T @ bend])

    def rotation_rows(self, section: int) -> Array:
        """Derivative (n, U) of the rotations of the tubes by x, where a section or a tube before it ends."""
        table = np.zeros((self.n, self.n, len(self.weight) + 1))
        table[np.arange(self.n), np.arange(self.n)] = np.append(self.weight * (self.point_section <= section), 1.0)
        out = np.zeros((self.n, self.size))
        out[:, : self.split] = table.reshape(self.n, -1)[:, self.rows] * self.scale
        return out

    @cached_property
    def tip_rows(self) -> Array:
        """Derivative (n, U) of the rotations at the ends of the tubes by x."""
        return self.rotation_rows(len(self.order) - 1)

    @property
    def tip_tube(self) -> int:
        """Tube that ends last; of several, the first."""
        return self.order[-1].ends[0]

    def boundary_at(self, s: float) -> int:
        """Section that ends at an arc length of the sheath; the last one at and beyond the tip."""
        return next(
            (k for k, b in enumerate(self.order) if b.of_sheath and abs(b.arc_length - s) <= SAME_PLACE),
            len(self.order) - 1,
        )


@dataclass(frozen=True, eq=False)
class BundleState:
    """State of a bundle problem."""

    problem: BundleProblem
    x: Array
    """Unknowns (U,)."""
    factor: float
    """Factor of the load."""
    energy: float
    """Potential energy, J: elastic energy less work. Infinite where a section or a tube has no length."""
    work: float
    """Work of the load from an arm with all points at the plate, J; NaN for a load without an energy."""
    gradient: Array
    """Gradient (U,) of the potential energy, or the equations for loads without an energy."""
    hessian: Array
    """Derivative (U, U) of `gradient` by x."""
    theta: Array
    """Rotations (N, n) of the tubes at the points, rad; for absent tubes, at their ends."""
    turn: Array
    """Turns p = h theta' (N, n) of the tubes, rad."""
    bend: Array
    """Turns kappa = h u (N, 2) of the centreline, rad."""
    h: Array
    """Lengths (N,) of the elements, m."""
    length: Array
    """Lengths g (N, n) of the tubes in an element, m."""
    elastic_hessian: Array
    """Hessian (U, U) of the elastic energy."""
    by_local: Array
    """Derivative (N, 2 n + 3) of the elastic energy at the points by theta, p, kappa and h."""
    local_hessian: Array
    """Second derivative (N, 2 n + 3, 2 n + 3) of the elastic energy by theta, p, kappa and h."""
    by_bend: Array
    """Gradient (2 N,) by kappa, as h follows it."""
    loading: Work | None = None
    """Work of the load at the factor 1."""

    @property
    def potential(self) -> float:
        """Elastic energy less work, J."""
        return self.energy

    @property
    def load_slope(self) -> Array:
        """Derivative (U,) of `gradient` by the factor of the load."""
        if self.loading is None:
            return np.zeros(len(self.x))
        return -self.loading.by_x(self.problem)


class VanishingError(Exception):
    """Raised if a step makes the length of a section vanish."""

    def __init__(self, state: BundleState, section: int) -> None:
        super().__init__()
        self.state, self.section = state, section


def evaluate(problem: BundleProblem, rotations: Array, x: Array, factor: float = 1.0) -> BundleState:
    """Potential energy with gradient and Hessian at x (U,), for base rotations (n,) and `factor` times the load."""
    n, count = problem.n, len(problem.weight)
    (turn, twist), bend = problem.torsion(x), problem.bend(x)
    theta = rotations + problem.up_to @ turn + twist
    h = problem.lengths_of(bend)[problem.point_section]
    bend = bend.reshape(-1, 2)
    length = h[:, None] + bend @ problem.bundle.levers.T
    geometry = theta, turn, bend, h, length
    if not (h.min() > 0 and length[problem.present].min() > 0):
        # No such arm: a step of Newton's method that leads here is shortened.
        none = np.full(problem.size, np.nan)
        singular = np.full((problem.size, problem.size), np.nan)
        return BundleState(problem, x, factor, np.inf, 0.0, none, singular, *geometry, singular, none, none, none)
    local = np.column_stack([theta, turn, bend, h])
    energy, by_local, second, _ = (part.copy() for part in mapped(bundle_energy(n), count)(local, *problem.inputs))
    second = second.reshape(count, 2 * n + 3, 2 * n + 3)
    weighted = problem.weight[:, None] * by_local
    gradient, hessian = problem.adjoint_sums(weighted[..., None])[:, 0], _hessian(problem, second)
    by_bend = weighted[:, 2 * n : -1].ravel() + problem.lengths_by_bend.T @ (problem.in_section @ weighted[:, -1])
    spring = x[problem.sprung_rows]
    total = float(problem.weight @ energy[:, 0]) + float(spring @ spring) / 2
    gradient[problem.sprung_rows] += spring
    hessian[problem.sprung_rows, problem.sprung_rows] += 1.0
    elastic, work, loading = hessian, 0.0, None
    if problem.load is not None:
        loading = work_of(problem, bend, h, length)
        work, elastic = factor * loading.value, hessian.copy()
        gradient -= factor * loading.by_x(problem)
        hessian -= factor * loading.by_xx(problem)
        by_bend -= factor * loading.by_bend(problem)
    derivatives = gradient, hessian, *geometry, elastic, by_local, second, by_bend
    potential = total - (work if np.isfinite(work) else 0.0)
    return BundleState(problem, x, factor, potential, work, *derivatives, loading)


def _hessian(problem: BundleProblem, second: Array) -> Array:
    """Hessian (U, U) of the elastic energy from second derivatives (N, 2 n + 3, 2 n + 3) at the points.

    theta is the sum of p up to a point and of the rotation at the plate, h is the same in all points of a section.
    """
    n, split, count = problem.n, problem.split, len(problem.weight)
    turned = problem.turned
    at = (problem.weight[:, None, None] * second).transpose(1, 2, 0)
    angle, rate, bend = slice(0, n), slice(n, 2 * n), slice(2 * n, 2 * n + 2)
    torsion = turned.T @ (at[angle, angle, :, None] * turned)
    mixed = turned.T * at[angle, rate, None, :]
    torsion[..., :-1] += mixed
    torsion[:, :, :-1] += mixed.transpose(1, 0, 3, 2)
    points = np.arange(count)
    torsion[:, :, points, points] += at[rate, rate]
    out = np.empty((problem.size, problem.size))
    table = torsion.transpose(0, 2, 1, 3).reshape(n * (count + 1), -1)
    out[:split, :split] = table[np.ix_(problem.rows, problem.rows)] * problem.scale[:, None] * problem.scale
    # By the torsion, then by kappa directly and through h.
    direct = turned.T * at[angle, bend, None, :]
    direct[:, :, points, points] += at[rate, bend]
    by_h = turned.T @ (at[angle, -1, :, None] * problem.in_section.T)
    by_h[:, :-1] += at[rate, -1, :, None] * problem.in_section.T
    cross = direct.transpose(0, 2, 3, 1).reshape(n * (count + 1), -1)[problem.rows]
    cross += by_h.reshape(n * (count + 1), -1)[problem.rows] @ problem.lengths_by_bend
    out[:split, split:] = (problem.scale[:, None] * cross) @ problem.bend_map
    out[split:, :split] = out[:split, split:].T
    bending, both = np.zeros((count, 2, count, 2)), np.zeros((count, 2, len(problem.order)))
    bending[points, :, points] = at[bend, bend].transpose(2, 0, 1)
    both[points, :, problem.point_section] = at[bend, -1].T
    across = both.reshape(2 * count, -1) @ problem.lengths_by_bend
    whole = bending.reshape(2 * count, -1) + across + across.T
    whole += problem.lengths_by_bend.T @ ((problem.in_section @ at[-1, -1])[:, None] * problem.lengths_by_bend)
    out[split:, split:] = problem.bend_map.T @ whole @ problem.bend_map
    return out


# --- Work of the load -------------------------------------------------------------------------------------------------

# Dead forces do the work
#
#     W = sum b h n.t + sum b rho_i g_i G.(R o_i),      n = F + int_s^S f ds + sum rho_i (S_i - sigma_i) G,
#
# with the forces F beyond a point, the forces f per length of the sheath, and the weight of the tubes beyond it, of the
# own lengths S_i, sigma_i of them up to the point. Forces f beyond the last tube act on the tip. The second term is the
# moment of the weight about the centreline. Orientation is a function of kappa; n, h and g are functions of kappa, h
# and S. A dead moment m does the virtual work m.dpsi + m.t dtheta with the turn of the frame, sum b R (dkappa, 0), and
# the rotation of the tube that ends last; elsewhere than at the tip the sheath, which does not twist, takes m.t.
# Moments per length beyond the last tube act on the tip.


@dataclass(frozen=True, eq=False)
class Work:
    """Work of a load, with derivatives by kappa (2 N), lengths h (m) and own lengths (n) as independent quantities."""

    value: float
    """Work, J."""
    first: Array
    """Virtual work (2 N + m + n,): first derivative of the work."""
    second: Array
    """Derivative (2 N + m + n, 2 N + m + n) of `first`."""
    torsional: Array
    """Virtual work (U,) of moments on the rotations of tubes."""
    torsional_slope: Array
    """Derivative (U, 2 N) of it by kappa."""
    wrench: Array
    """Force (N) and moment about the plate's centre (N m) on the plate (6,)."""

    def by_bend(self, problem: BundleProblem) -> Array:
        """Derivative (2 N,) of the work by kappa, as h follows it."""
        size, m = 2 * len(problem.weight), len(problem.order)
        return np.asarray(self.first[:size] + self.first[size : size + m] @ problem.lengths_by_bend)

    def by_x(self, problem: BundleProblem) -> Array:
        """Derivative (U,) of the work by x."""
        out = self.torsional.copy()
        out[problem.split :] += self.by_bend(problem) @ problem.bend_map
        return out

    def by_xx(self, problem: BundleProblem) -> Array:
        """Second derivative (U, U) of the work by x."""
        size, m, split = 2 * len(problem.weight), len(problem.order), problem.split
        follow = np.concatenate([np.eye(size), problem.lengths_by_bend]) @ problem.bend_map
        out = np.zeros((problem.size, problem.size))
        out[split:, split:] = follow.T @ self.second[: size + m, : size + m] @ follow
        out[:, split:] += self.torsional_slope @ problem.bend_map
        return out


class Spread(NamedTuple):
    """Force per length of a sheath, with its integral and derivative, as Chebyshev series."""

    force: np.polynomial.Chebyshev
    beyond: np.polynomial.Chebyshev
    slope: np.polynomial.Chebyshev


@lru_cache(maxsize=64)
def _spread(load: Load, length: float, axis: int) -> Spread:
    """Component of the distributed load, a function of arc length, up to `length`, m."""
    force = np.polynomial.Chebyshev.interpolate(lambda s: load.per_length(s)[:, axis], 32, domain=[0.0, length])
    whole = force.integ()
    return Spread(force, whole(length) - whole, force.deriv())


def _distributed(problem: BundleProblem, s: Array, kind: slice = FORCE) -> tuple[Array, Array, Array]:
    """Forces, or moments, (N, 3) per length, those beyond the points, and the derivative of the first."""
    load, length = problem.load, float(problem.bundle.end.max())
    assert load is not None
    along, zero = load.distributed, np.zeros((len(s), 3))
    if along is None:
        return zero, zero, zero
    if callable(along):
        parts = [_spread(load, length, axis) for axis in range(6)[kind]]
        f, d, slope = (np.column_stack([one[k](s) for one in parts]) for k in range(3))
        return f, d, slope
    stretches: Any = along if isinstance(along[0], Stretch) else (Stretch(0.0, length, along),)
    beyond = zero.copy()
    for part in stretches:
        ahead = np.maximum(min(part.end, length) - np.maximum(s, part.start), 0.0)
        beyond += ahead[:, None] * np.array((*part.force, *part.moment)[kind])
    return load.per_length(s)[:, kind] * (s < length)[:, None], beyond, zero


def work_of(problem: BundleProblem, bend: Array, h: Array, length: Array) -> Work:
    """Work of the load at kappa (N, 2), lengths h (N,) and lengths g (N, n) of the tubes."""
    load, bundle, mesh, weight = problem.load, problem.bundle, problem.mesh, problem.weight
    assert load is not None
    count, m, n, levers = len(h), len(problem.order), problem.n, problem.bundle.levers
    up_to, size = problem.up_to, 2 * count + m + n
    orientation = orient(mesh, bend)
    stage, tip = orientation.stage, rotation_matrix_function()(orientation.start[-1]).full()
    density = np.array(problem.density) if problem.density else np.zeros(n)
    gravity, centre = np.array(load.gravity or (0.0, 0.0, 0.0)), _centres(bundle)
    # Derivatives of h and g at the points, and of the own lengths up to them, by kappa, h and S.
    by_h, by_g = np.zeros((count, size)), np.zeros((n, count, size))
    by_h[:, 2 * count : 2 * count + m] = problem.in_section.T
    by_g[:] = by_h
    for axis in range(2):
        by_g[:, np.arange(count), 2 * np.arange(count) + axis] = levers[:, axis, None]
    by_g *= problem.present.T[:, :, None]
    per_length, ahead, per_length_slope = _distributed(problem, up_to @ h)
    own_length = np.maximum(bundle.end, 0.0)
    ahead = ahead + ((own_length - up_to @ (length * problem.present)) @ density)[:, None] * gravity
    by_weight = -(up_to @ np.tensordot(density, by_g, 1))
    by_weight[:, 2 * count + m :] += density
    moments, total = np.zeros((count, 3)), np.zeros(6)
    for part in load.acting:
        turns = load.frame == "tip" and part.at == np.inf
        tip_force, tip_moment = (tip @ value if turns else np.array(value) for value in (part.force, part.moment))
        beyond = problem.point_section <= problem.boundary_at(part.at)
        ahead[beyond] += tip_force
        moments[beyond] += tip_moment
        total += np.concatenate([tip_force, tip_moment])
    # W = sum c.t + sum G.(R e), c = b h n, e = sum b rho_i g_i o_i: derivatives of c and e.
    by_s = up_to @ by_h
    by_n = by_weight[:, None] * gravity[:, None] - per_length[..., None] * by_s[:, None]
    # A load on the whole sheath reaches as far as the longest tube.
    last = int(np.argmax(bundle.end))
    by_n[:, :, 2 * count + m + last] += _distributed(problem, bundle.end[[last]] * (1 - 1e-12))[0]
    c = (weight * h)[:, None] * ahead
    by_c = weight[:, None, None] * (by_h[:, None] * ahead[..., None] + h[:, None, None] * by_n)
    e = weight[:, None] * ((density * length * problem.present) @ centre)
    by_e = weight[:, None, None] * np.einsum("i,ias,ic->acs", density, by_g, centre)
    kinds = frame_forms()
    forms = 2 * (c @ kinds[:, 2].reshape(3, 16) + e @ np.tensordot(gravity, kinds[:, :2], 1).reshape(2, 16))
    forms = forms.reshape(count, 4, 4)
    adjoined = adjoint(mesh, orientation, (forms @ stage[:, :, None])[:, :, 0])
    t, across = tangents(stage), ((stage @ np.tensordot(gravity, kinds[:, :2], 1)) * stage[None]).sum(2).T
    slope_t = (tangent_slopes(stage) @ orientation.stage_slope).reshape(3 * count, -1)
    slope_across = 2 * (stage @ np.tensordot(gravity, kinds[:, :2], 1)).swapaxes(0, 1) @ orientation.stage_slope
    first = t.ravel() @ by_c.reshape(-1, size) + across.ravel() @ by_e.reshape(-1, size)
    second = np.zeros((size, size))
    mixed = (weight[:, None] * by_h).T @ (t[:, None] @ by_n)[:, 0]
    bent = (weight * h * (per_length_slope * t).sum(1))[:, None] * by_s
    second += mixed + mixed.T - by_s.T @ bent
    turned = slope_t.T @ by_c.reshape(-1, size) + slope_across.reshape(2 * count, -1).T @ by_e.reshape(-1, size)
    second[: 2 * count] += turned
    second[:, : 2 * count] += turned.T
    first[: 2 * count] += adjoined.gradient.ravel()
    second[: 2 * count, : 2 * count] += second_derivative(orientation, adjoined, forms)
    value = float((c * t).sum() + (e * across).sum())
    frames = (stage @ kinds.reshape(9, 4, 4) * stage).sum(2).T.reshape(count, 3, 3)
    total[:3] += _distributed(problem, np.zeros(1))[1][0] + (own_length @ density) * gravity
    total[3:] += np.cross(t, c).sum(0) + np.cross((frames[:, :, :2] @ e[..., None])[..., 0], gravity).sum(0)
    torsional, torsional_slope = np.zeros(problem.size), np.zeros((problem.size, 2 * count))
    if not load.has_energy:
        value = np.nan
        spread, rest, spread_slope = _distributed(problem, up_to @ h, MOMENT)
        total[3:] += _distributed(problem, np.zeros(1), MOMENT)[1][0]
        turned, turned_slope = moment_work(orientation, weight[:, None] * (moments + rest))
        first[: 2 * count] += turned.ravel()
        second[: 2 * count, : 2 * count] += turned_slope
        # Points of a mesh that moves by ds turn by u ds more than the sheath does at a fixed place.
        local, local_slope = moment_work(orientation, weight[:, None] * spread)
        slid = (local * bend).sum(1)
        by_slid = (moment_work(orientation, weight[:, None] * spread_slope)[0] * bend).sum(1)[:, None] * by_s
        by_slid[:, : 2 * count] += (bend[..., None] * local_slope.reshape(count, 2, -1)).sum(1)
        by_slid[np.arange(count)[:, None], np.arange(2 * count).reshape(count, 2)] += local
        first -= slid @ by_s
        second -= by_s.T @ by_slid
        across_frame = weight[:, None, None] * frames[:, :, :2].swapaxes(1, 2)
        second[: 2 * count] -= ((across_frame @ spread[..., None]) * by_s[:, None]).reshape(2 * count, -1)
        ending = _distributed(problem, bundle.end[[last]] * (1 - 1e-12), MOMENT)[0][0]
        second[: 2 * count, 2 * count + m + last] += (across_frame @ ending).ravel()
        row, end = problem.tip_rows[problem.tip_tube], orientation.start[-1]
        torsional += (tip_moment @ tip[:, 2]) * row
        if load.frame == "world":
            slope = tangent_slopes(end[None])[0] @ orientation.start_slope[-1]
            torsional_slope += np.outer(row, tip_moment @ slope)
        else:
            # Virtual work of a load that turns with the tip.
            turn, reach = orientation.turn_slope(), t.T @ (weight[:, None] * by_h)
            reach[:, : 2 * count] += np.tensordot(weight * h, slope_t.reshape(count, 3, -1), 1)
            second[:, : 2 * count] -= reach.T @ hat(tip_force) @ turn
            second[: 2 * count, : 2 * count] -= turn.T @ hat(tip_moment) @ turn
    return Work(value, first, second, torsional, torsional_slope, total)


def work_second_change(state: BundleState, left: Array, right: Array) -> Array:
    """Gradient (2 N + m + n,) of the second variation of the work along directions (U,), by kappa, h and own lengths.

    It is symmetric in `right` and in what it is differentiated by: one central difference along `right`.
    """
    problem, count = state.problem, 2 * len(state.problem.weight)
    along = np.zeros(count + len(problem.order) + problem.n)
    by_left, by_right = problem.bend_map @ left[problem.split :], problem.bend_map @ right[problem.split :]
    along[:count], along[count : -problem.n] = by_left, problem.lengths_by_bend @ by_left
    # A step that turns the arm by as much balances truncation and round-off, at a relative error of 1e-10.
    step = 1e-5 / max(float(np.abs(np.cumsum(by_right.reshape(-1, 2), axis=0)).max()), 1e-300)
    out = np.zeros_like(along)
    for way in (1, -1):
        bend = state.bend + way * step * by_right.reshape(-1, 2)
        h = problem.lengths_of(bend.ravel())[problem.point_section]
        work = work_of(problem, bend, h, h[:, None] + bend @ problem.bundle.levers.T)
        out += way * along @ work.second / (2 * step)
        out[:count] += way * left @ work.torsional_slope / (2 * step)
    return out


def _centres(bundle: Bundle) -> Array:
    """Places (n, 2) of the tubes in the cross-section, m."""
    return np.asarray(bundle.offset[:, None] * np.column_stack([np.cos(bundle.angle), np.sin(bundle.angle)]))


class PlaceSlopes(NamedTuple):
    """Pose of the centreline where a section ends, with derivatives."""

    position: Array
    """Position (3,) of the end of the section, m."""
    by_x: Array
    """Derivative (6, U) of the position, and of the turn of the frame about world axes, by x."""
    by_length: Array
    """Derivative (3, m) of the position by the lengths h of elements, at fixed kappa."""
    by_bend: Array
    """Derivative (6, 2 N) of position and turn by kappa, as h follows it."""
    frame: Array
    """Bishop frame (3, 3)."""


def place_slopes(state: BundleState, section: int) -> PlaceSlopes:
    """Pose of the centreline where a section ends."""
    problem = state.problem
    orientation = orient(problem.mesh, state.bend)
    weight = problem.weight * (problem.point_section <= section)
    tangent, by_x = tangents(orientation.stage), np.zeros((6, problem.size))
    by_length = (problem.in_section @ (weight[:, None] * tangent)).T
    end = int(np.searchsorted(problem.section, section, side="right"))
    by_bend = np.concatenate(
        [
            position_slopes(orientation, weight * state.h) + by_length @ problem.lengths_by_bend,
            orientation.turn_slope(end),
        ]
    )
    by_x[:, problem.split :] = by_bend @ problem.bend_map
    frame = rotation_matrix_function()(orientation.start[end]).full()
    return PlaceSlopes((weight * state.h) @ tangent, by_x, by_length, by_bend, frame)


def cross_section_slopes(state: BundleState, section: int, tube: int | None) -> Array:
    """Derivative (6, U) by x where a section ends: of the position, and of the rotation of a tube about world axes.

    The rotation is that of the sheath, which does not twist, if `tube` is None.
    """
    pose = place_slopes(state, section)
    out = pose.by_x.copy()
    if tube is not None:
        out[3:] += np.outer(pose.frame[:, 2], state.problem.rotation_rows(section)[tube])
    return out


# --- Second variation -------------------------------------------------------------------------------------------------


def margin_form(state: BundleState) -> Array:
    """Second variation relative to that of tubes without coupling; its least eigenvalue is the margin.

    Bending is counted from the curvature that minimises the elastic energy at given rotations, relative to its own
    elastic stiffness. Without a load this leaves the torsion (split, split); with one it is (U, U), and without offsets
    the form of `loaded`.
    """
    basis = margin_basis(state)
    return np.asarray(basis.T @ state.hessian @ basis)


def margin_basis(state: BundleState) -> Array:
    """Matrix (U, F) from coordinates of `margin_form` to unknowns: (U, split) without a load, (U, U) with one."""
    basis = _relative(state)
    return basis[:, : state.problem.split] if state.loading is None else basis


class BundleMode(NamedTuple):
    """Direction of the unknowns for a vector of the margin's form."""

    unknowns: Array
    """Change (U,) of the unknowns."""
    relaxed: Array
    """Change (U,) with the same torsion, and the bending that minimises the elastic energy; equal without a load."""


def mode_of(state: BundleState, vector: Array) -> BundleMode:
    """Direction of the unknowns for a vector of `margin_form`; T of it is the square of the vector."""
    basis, split = _relative(state), state.problem.split
    # Columns of torsion have the bending that minimises the elastic energy.
    return BundleMode(basis[:, : len(vector)] @ vector, basis[:, :split] @ vector[:split])


def _relative(state: BundleState) -> Array:
    """Matrix (U, U) from relative coordinates of torsion and bending to unknowns."""
    problem = state.problem
    split, stiffness = problem.split, problem.bundle.torsional_stiffness
    untwisted = np.column_stack(
        [(state.length / (problem.weight[:, None] * stiffness)).T, problem.bundle.transmission / stiffness]
    )
    untwisted = np.sqrt(untwisted.ravel()[problem.rows]) / problem.scale
    bending, coupling = state.elastic_hessian[split:, split:], state.elastic_hessian[split:, :split]
    factor = np.linalg.cholesky(bending)
    basis = np.zeros((problem.size, problem.size))
    basis[:split, :split] = np.diag(untwisted)
    basis[split:, :split] = -scipy.linalg.cho_solve((factor, True), coupling) * untwisted
    basis[split:, split:] = scipy.linalg.solve_triangular(factor, np.eye(len(factor)), lower=True).T
    return basis


# --- Sections that vanish ---------------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def _needs(bundle: Bundle, order: tuple[Boundary, ...]) -> SectionNeeds:
    """Needs of the sections that end at boundaries in their order."""
    present, curved = tubes_of_sections(bundle, order)
    kb = bundle.bending_stiffness * present
    return SectionNeeds.of_even(kb, kb * bundle.curvature * curved, bundle.torsional_stiffness, bundle.sheath)


def element_counts(
    bundle: Bundle,
    order: tuple[Boundary, ...],
    length: Array,
    refinement: int,
    load: Load | None,
    density: tuple[float, ...],
) -> Index:
    """Numbers (m,) of elements of sections with lengths (m,), halved `refinement` times."""
    needs = _needs(bundle, order)
    if load is None:
        need = FINER * needs.unloaded(length)
    else:
        own = np.maximum(bundle.end, 0.0)
        bounds = load.bounds(float(own.max()), float(own @ np.array(density)) if density else 0.0)
        need = FINER_UNDER_LOAD * needs.loaded(length, float(own.max()), *bounds)
    return np.asarray(whole_elements(need) * 2**refinement)


def problem_at(
    bundle: Bundle,
    start: Start,
    *,
    degree: int = 6,
    refinement: int = 0,
    load: Load | None = None,
    density: tuple[float, ...] = (),
) -> BundleProblem:
    """Problem with the boundaries of a start in their order; elements are halved `refinement` times."""
    count = element_counts(bundle, start.order, start.length, refinement, load, density)
    nominal = np.maximum(start.length, HELD) / count
    held = tuple(np.flatnonzero(start.length < 2 * HELD).tolist())
    return BundleProblem(bundle, start.order, nominal, count, tableau("gauss", degree), load, density, held)


def start_unknowns(problem: BundleProblem, start: Start) -> Array:
    """Unknowns (U,) of untwisted tubes with the curvature of a start."""
    bend = (start.curvature * (start.length / problem.count)[:, None])[problem.point_section]
    return problem.unknowns(np.zeros(problem.present.shape), bend.ravel(), np.zeros(problem.n))


def _shortened(problem: BundleProblem, turn: Array, bend: Array, sections: Sequence[int], length: float) -> None:
    """Overwrite p (N, n) and kappa (N, 2) of short sections: rates of the section before them, times their length."""
    rate_of, h = np.column_stack([turn, bend]), problem.lengths_of(bend.ravel())
    for k in sections:
        in_section = problem.point_section == k
        neighbour = (
            np.flatnonzero(problem.point_section == k - 1)[-1] if k else np.flatnonzero(problem.point_section == 1)[0]
        )
        rate = rate_of[neighbour] / max(h[problem.point_section[neighbour]], length)
        turn[in_section], bend[in_section] = length * rate[:-2], length * rate[-2:]


def opened(problem: BundleProblem, x: Array, least: float) -> Array:
    """Unknowns (U,) close to x in which every element of a free section is at least `least` long, m."""
    out, short = x, np.zeros(0, dtype=np.intp)
    # Lengths that are opened take from those of other sections: these may then be too short, too.
    while len(problem.order) > 1:
        found = np.setdiff1d(np.flatnonzero(problem.lengths(out) < least * (1 - 1e-6)), [*problem.held, *short])
        if not len(found):
            break
        short = np.union1d(short, found)
        out = _opened(problem, x, short, least)
    return out


def _opened(problem: BundleProblem, x: Array, short: Index, least: float) -> Array:
    """Unknowns (U,) close to x in which every element of the sections `short` has the length `least`, m."""
    (turn, twist), bend, h = problem.torsion(x), problem.bend(x).reshape(-1, 2), problem.lengths(x)
    turn = turn.copy()
    # A section that was held has rates of its own. With those of another one its first step might close it again.
    held = [k for k in short.tolist() if abs(h[k] - HELD) < HELD / 2]
    _shortened(problem, turn, bend, np.setdiff1d(short, held).tolist(), least)
    for k in held:
        in_section = problem.point_section == k
        turn[in_section] *= least / HELD
        bend[in_section] *= least / HELD
    out = problem.unknowns(turn, bend.ravel(), twist)
    others = np.repeat(~np.isin(problem.point_section, short), 2)
    rows = (problem.lengths_by_bend[short] * others) @ problem.bend_map
    out[problem.split :] += np.linalg.lstsq(rows, least - problem.lengths(out)[short], rcond=None)[0]
    return out


def rearranged(state: BundleState, order: tuple[Boundary, ...], held: tuple[int, ...]) -> tuple[BundleProblem, Array]:
    """Problem with other held sections and another order of boundaries, and the unknowns of a state in it."""
    known, turn, bend = state.problem, state.turn.copy(), state.bend.copy()
    nominal = known.nominal.copy()
    nominal[[*held]] = HELD
    _shortened(known, turn, bend, [k for k in held if k not in known.held], HELD)
    problem = replace(known, order=order, held=held, nominal=nominal)
    return problem, problem.unknowns(turn, bend.ravel(), known.torsion(state.x)[1])


def exchanged(state: BundleState, section: int, *, hold: bool) -> tuple[BundleProblem, Array]:
    """Problem with the boundaries at both ends of a vanishing section exchanged, and the unknowns of a state in it."""
    order, held = list(state.problem.order), set(state.problem.held) - {section}
    order[section - 1], order[section] = order[section], order[section - 1]
    return rearranged(state, tuple(order), tuple(sorted(held | ({section} if hold else set()))))


def together(held: Sequence[int]) -> list[list[int]]:
    """Held sections in groups of successive ones, in order: the boundaries at their ends are all at one place."""
    out: list[list[int]] = []
    for section in held:
        if out and section == out[-1][-1] + 1:
            out[-1].append(section)
        else:
            out.append([section])
    return out


def holding_forces(state: BundleState) -> Array:
    """Derivative (len(held),) of the energy by the lengths of held sections, N; if it is negative, the section would
    grow.
    """
    rows = state.problem.lengths_by_bend[[*state.problem.held]]
    return np.asarray(np.linalg.lstsq(rows.T, state.by_bend, rcond=None)[0])


def length_forces(state: BundleState) -> Array:
    """Derivatives (m,) of the potential energy by the own lengths up to the boundaries, N."""
    problem, count = state.problem, 2 * len(state.problem.weight)
    by_length = problem.in_section @ (problem.weight * state.by_local[:, -1])
    if state.loading is not None:
        by_length = by_length - state.factor * state.loading.first[count : count + len(problem.order)]
    return np.asarray(by_length @ problem.lengths_by_boundaries)


# --- Arm, and arms as starts ------------------------------------------------------------------------------------------


def bundle_arm(rotations: Array, state: BundleState) -> ArmShape:
    """Shape of the arm at ENDS of its elements."""
    problem = state.problem
    (count, n), k = state.theta.shape, problem.tableau.degree
    pieces = count // k
    at = tuple(ENDS.tolist())
    values, integrals = problem.tableau.basis(at, 0), problem.tableau.basis(at, 1)
    h, turn = state.h.reshape(pieces, k)[:, 0], state.turn.reshape(pieces, k, n)
    base = rotations + problem.torsion(state.x)[1]
    ends = np.cumsum(problem.tableau.weights @ turn, axis=0)
    start = base + np.concatenate([np.zeros((1, n)), ends[:-1]])
    s = (np.cumsum(h) - h)[:, None] + h[:, None] * ENDS
    position, frame = centreline(problem.mesh, orient(problem.mesh, state.bend), h)
    return ArmShape(
        arc_length=along_elements(s, pieces)[:, 0],
        rotation=along_elements(start[:, None] + integrals @ turn, pieces).T.copy(),
        torsion=along_elements(values @ turn / h[:, None, None], pieces).T.copy(),
        curvature=along_elements(values @ state.bend.reshape(pieces, k, 2) / h[:, None, None], pieces),
        position=position,
        frame=frame,
    )


def carried(problem: BundleProblem, state: BundleState) -> Array:
    """Unknowns (U,) of a problem with the torsion and curvature of a state of another problem at the
    same arc lengths.
    """
    known, twist = state.problem, state.problem.torsion(state.x)[1]
    same = known.order == problem.order
    if same and np.array_equal(known.count, problem.count) and known.tableau is problem.tableau:
        return problem.unknowns(state.turn, state.bend.ravel(), twist)
    h = (known.lengths(state.x) * known.count if same else problem.nominal * problem.count) / problem.count
    elements = h[problem.section]
    first = np.cumsum(elements) - elements
    s = (first[:, None] + elements[:, None] * problem.tableau.nodes).ravel()
    old = known.lengths(state.x)[known.section]
    mesh = replace(known.mesh, start=np.cumsum(old) - old, length=old)
    rates = mesh.interpolated(np.column_stack([state.turn, state.bend]) / state.h[:, None], s)
    rates *= h[problem.point_section, None]
    return problem.unknowns(rates[:, :-2], rates[:, -2:].ravel(), twist)


def followed(state: BundleState, bundle: Bundle, places: Sequence[float] = ()) -> Start:
    """Boundaries of a bundle in order, close to a state of the same tubes at other translations or places."""
    known = state.problem
    known_arc_lengths = np.cumsum(known.lengths(state.x) * known.count).tolist()
    ends = {b.key: arc_length for b, arc_length in zip(known.order, known_arc_lengths, strict=True)}
    s, tube_lengths = known.up_to @ state.h, known.up_to @ state.length

    def reached(b: Boundary) -> float:
        if b.key in ends or not b.tubes:
            return float(ends.get(b.key, b.arc_length))
        along = tube_lengths[:, b.tubes[0]]
        return float(np.interp(b.arc_length, [0.0, *along], [0.0, *s]) + max(b.arc_length - along[-1], 0.0))

    order = ordered(bundle, sorted(boundaries(bundle, places), key=reached))
    last = max(k for k, b in enumerate(order) if b.ends)
    order = order[: last + 1]
    length = np.diff([0.0, *np.maximum.accumulate([reached(b) for b in order])])
    return Start(tuple(order), length, np.zeros((len(order), 2)))


def ordered(bundle: Bundle, order: Sequence[Boundary]) -> list[Boundary]:
    """Boundaries with those at equal offsets sorted by their own lengths, in the same positions of the list."""
    out = list(order)
    lever = np.array([bundle.levers[b.tubes[0]] if b.tubes else np.zeros(2) for b in order])
    for k in range(len(out)):
        same = np.flatnonzero(np.abs(lever - lever[k]).max(1) <= SAME_PLACE).tolist()
        for number, b in zip(same, sorted((order[i] for i in same), key=lambda b: b.arc_length), strict=True):
            out[number] = b
    return out


def moved_order(problem: BundleProblem, bundle: Bundle, places: Sequence[float]) -> tuple[Boundary, ...]:
    """Boundaries of a problem at other translations, in the same order; empty if other boundaries exist there."""
    now = {b.key: b for b in boundaries(bundle, places)}
    length = float((problem.nominal * problem.count).sum())
    if ((bundle.transmission > SAME_PLACE) != (problem.bundle.transmission > SAME_PLACE)).any():
        return ()
    if {b.key for b in problem.order} != {key for key, b in now.items() if b.tubes or b.arc_length < length}:
        return ()
    order = [now[b.key] for b in problem.order]
    return tuple(order) if ordered(bundle, order) == order else ()


def solved_order(bundle: Bundle, places: Sequence[float], ends: Array, tube_lengths: Array) -> tuple[Boundary, ...]:
    """Boundaries in order, from their places (m,) on the centreline and own lengths (m, n) of the tubes there, m."""

    def reached(b: Boundary) -> float:
        if not b.tubes:
            return b.arc_length
        to_go = b.arc_length - tube_lengths[:, b.tubes[0]]
        k = int(np.argmin(np.abs(to_go)))
        return float(ends[k] + to_go[k])

    return tuple(sorted(boundaries(bundle, places), key=reached)[: len(ends)])
