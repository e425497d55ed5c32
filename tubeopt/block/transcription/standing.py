"""An arm in equilibrium, with a load or without.

Along the arm the elastic rotations phi of the tubes, their torques t, the frame R and the moment m on the
cross-section, in world axes, obey

    phi' = t / kt,   t' = M(theta, b) - l.e,   R' = R hat(u),   m' = -e x n - l,
    b = (R'm)_xy,    u = (b + sum a_i) / sum kb_i,    e = R e3,    theta = phi + phase,

with the force n on the cross-section and the moment l per length, of which the axial part acts on the outermost tube.
Of eccentric tubes phi' = g t / kt, with the stretch g, and no load acts on them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ...typing import Array, Index
from .arm import ArmShape, frames_at_points
from .buffered import bent_function, section_function
from .collocated import STEPS
from .loaded import LoadedProblem
from .reduced import ReducedProblem

# --- Cross-sections that carry a bending moment -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections at X points, with their derivatives by theta and b."""

    values: Array
    """Torque per length above curvature (X, n + 2)."""
    energy: Array
    """Bending energy per length (X,)."""
    by: Array
    """Derivative (X, n + 2, n + 2) of the values."""
    by_energy: Array
    """Derivative (X, n + 2) of the energy."""
    stretch: Array
    """Stretch (X, n)."""
    by_stretch: Array | None = None
    """Derivative (X, n, n) of the stretch of eccentric tubes by theta, else None."""

    @property
    def torque(self) -> Array:
        """Torque per length (X, n), N."""
        return self.values[:, :-2]

    @property
    def curvature(self) -> Array:
        """Curvature (X, 2), 1/m."""
        return self.values[:, -2:]

    @property
    def by_torque(self) -> Array:
        """Derivative (X, n, n + 2) of the torque."""
        return self.by[:, :-2]

    @property
    def by_curvature(self) -> Array:
        """Derivative (X, 2, n + 2) of the curvature."""
        return self.by[:, -2:]


SectionInputs = tuple[Array, Array, Array, Array]
"""theta, kb, m (X, n) and b (X, 2) at X points."""


class SectionValues(NamedTuple):
    """Cross-sections at X points, without derivatives."""

    torque: Array
    """Torque per length (X, n), N."""
    curvature: Array
    """Curvature (X, 2), 1/m."""
    energy: Array
    """Bending energy per length (X,), N."""
    stretch: Array
    """Stretch (X, n)."""


def values_of(inputs: SectionInputs, offsets: tuple[Array, ...]) -> SectionValues:
    """Cross-sections without derivatives; arguments as of `sections_of`."""
    count, n = inputs[0].shape
    if offsets:
        torque, stretch, curvature, energy = section_function("section", count, n, True)(*inputs[:3], *offsets)
        return SectionValues(torque.copy(), curvature.copy(), energy[:, 0].copy(), stretch.copy())
    values, energy = bent_function("section", count, n)(*inputs)
    values = values.copy()
    return SectionValues(values[:, :n], values[:, n:], energy[:, 0].copy(), np.ones((count, n)))


def sections_of(inputs: SectionInputs, offsets: tuple[Array, ...]) -> Sections:
    """Cross-sections with bending moments b; `offsets` are offset and angle (n,) of eccentric tubes, or ()."""
    count, n = inputs[0].shape
    if offsets:
        values, (torque, stretch, curvature, energy) = _eccentric_sections(inputs, offsets)
        # Eccentric tubes have no bending moment b.
        by, by_energy = np.zeros((count, n + 2, n + 2)), np.zeros((count, n + 2))
        by[:, :n, :n], by[:, n:, :n], by_energy[:, :n] = torque[..., :n], curvature[..., :n], energy[:, 0, :n]
        stacked = np.concatenate([values[0], values[2]], axis=1)
        return Sections(stacked, values[3][:, 0], by, by_energy, values[1], stretch[..., :n])
    stacked, energy, by, by_energy = (part.copy() for part in bent_function("linear", count, n)(*inputs))
    return Sections(stacked, energy[:, 0], by.reshape(count, n + 2, n + 2), by_energy, np.ones((count, n)))


def by_data_of(inputs: SectionInputs, offsets: tuple[Array, ...]) -> tuple[Array, ...]:
    """Derivatives (X, n, 2 n), (X, 2, 2 n), (X, 2 n) of torque, curvature and energy by kb and m.

    Of eccentric tubes also that (X, n, 2 n) of the stretch.
    """
    count, n = inputs[0].shape
    if offsets:
        torque, stretch, curvature, energy = (by[..., n:] for by in _eccentric_sections(inputs, offsets)[1])
        return torque, curvature, energy[:, 0], stretch
    by, by_energy = (part.copy() for part in bent_function("linear_data", count, n)(*inputs))
    by = by.reshape(count, n + 2, 2 * n)
    return by[:, :n], by[:, n:], by_energy


def _eccentric_sections(inputs: SectionInputs, offsets: tuple[Array, ...]) -> tuple[list[Array], list[Array]]:
    """Torque, stretch, curvature and energy (X, r), and their derivatives (X, r, 3 n) by theta, kb and m."""
    count, n = inputs[0].shape
    out = [part.copy() for part in section_function("linear", count, n, True)(*inputs[:3], *offsets)]
    # CasADi stores (r, 3 n) by columns.
    by = [
        part.reshape(count, 3 * n, value.shape[1]).swapaxes(1, 2) for value, part in zip(out[:4], out[4:], strict=True)
    ]
    return out[:4], by


_HAT = np.array([[0.0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]])
"""Matrix (3, 9) from a to the matrix of b -> a x b, by rows."""


def hat(a: Array) -> Array:
    """Matrices (..., 3, 3) of b -> a x b, of vectors a (..., 3)."""
    return np.asarray((a @ _HAT).reshape(*a.shape, 3))


def cross(a: Array, b: Array) -> Array:
    """Cross product (..., 3) of vectors."""
    return np.asarray((hat(a) @ b[..., None])[..., 0])


class FromTip(NamedTuple):
    """Quantities (r,) integrated from the tip of an arm of P pieces."""

    points: Array
    """Values (P, K, r) at the points."""
    tip_side: Array
    """Values (P + 1, r) at the ends of the pieces, on the side of the tip."""
    plate_side: Array
    """Values (P + 1, r) there, on the side of the plate."""


class DataSlopes(NamedTuple):
    """Derivatives by phase, kb and m (3 n) at the points, at fixed torques."""

    torque: Array
    """Derivative (P, K, n, 3 n) of M."""
    curvature: Array
    """Derivative (P, K, 2, 3 n) of u."""
    energy: Array
    """Derivative (P, K, 3 n) of the elastic energy per length."""
    rotation_rate: Array | None
    """Derivative (P, K, n, 3 n) of phi' of eccentric tubes, else None."""


class Standing:
    """An arm in equilibrium: n tubes, P pieces with K points each.

    Args:
        problem: torsion problem, on the mesh of the arm.
        base: rotations (n,) at the clamps, rad.
        solved: elastic rotations (N, n) at the collocation points of the problem.
        shape: shape of the arm.
        burden: problem under a load, or None.
        straight: True if rotations of straight tubes are needed; they follow from the torques.
    """

    def __init__(
        self,
        problem: ReducedProblem,
        base: Array,
        solved: Array,
        shape: ArmShape,
        *,
        burden: LoadedProblem | None = None,
        straight: bool = True,
    ) -> None:
        self.problem, self.base, self.shape = problem, base, shape
        self.mesh, self.t, self.length = problem.mesh, problem.mesh.tableau, problem.mesh.length
        self.n = problem.assembly.n_tubes
        self.pieces, self.degree = len(self.length), self.t.degree
        # Without a load the state has rotations and torques only; frame and moment follow.
        self.own = self.n if burden is None else self.n + 3
        self.kept = _kept(self.n, self.own)
        self.h = self.length[:, None, None]
        self.weights = self.length[:, None] * self.t.weights
        self.cuts, self.tip_tube = problem.cuts, problem.tip_tube
        self.sections = sections = problem.here.sections
        points = self.pieces, self.degree
        self.phase, self.stiffness, self.moments = (
            part.reshape(*points, self.n) for part in (sections.phase, sections.stiffness, sections.moment)
        )
        self.rate, self.transmission = problem.here.rate, problem.here.transmission
        placed = problem.assembly
        self.offsets = (placed.offset, placed.offset_angle) if placed.eccentric else ()
        self.frame = frames_at_points(self.t, self.length, shape)
        self.axis = self.frame[..., 2]
        self.across, self.about_axis = self.frame[..., :2].swapaxes(2, 3), hat(self.axis)
        self.end_frame = shape.frame[::STEPS]
        self._load(burden)
        self._moments()
        theta = solved.reshape(-1, self.degree, self.n)
        if len(theta) < self.pieces:
            # Pieces without points have no solved rotations; theirs follow from the torques below.
            theta = np.zeros((*points, self.n))
            theta[self.mesh.collocated] = solved.reshape(-1, self.degree, self.n)
        self.theta = theta + self.phase
        # The rotations of straight tubes are no unknowns. Torques first: they give the rotations of all tubes, at which
        # the cross-sections are evaluated.
        if straight or not self.mesh.collocated.all():
            values = values_of(self.tables, self.offsets)
            self._torques(values.torque, values.stretch)
            self.theta = self.phi + self.phase
            self.at = sections_of(self.tables, self.offsets)
        else:
            self.at = sections_of(self.tables, self.offsets)
            self._torques(self.at.torque, self.at.stretch)

    def _load(self, burden: LoadedProblem | None) -> None:
        """Set the forces, moments per length on the tubes, and moments at joints."""
        points = self.pieces, self.degree
        self.load = None if burden is None else burden.load
        self.following = self.load is not None and self.load.frame == "tip"
        self.tip_force = self.tip_moment = np.zeros(3)
        self.force = np.zeros((*points, 3)) if burden is None else burden.force.reshape(*points, 3)
        self.joints: list[tuple[int, int, Array]] = []
        """Piece that begins at the moment, the tube it acts on, and the moment (3,)."""
        self.along = self.kicks = None
        if burden is None:
            return
        inputs = np.array(burden.load.force), np.array(burden.load.moment)
        tip = self.shape.frame[-1]
        self.tip_force, self.tip_moment = (tip @ part if self.following else part for part in inputs)
        if self.following:
            # A follower force at the tip acts on the whole arm; the problem has the other forces.
            self.force = self.force + self.tip_force
        couples = burden.couples
        if couples is not None and len(couples.point):
            self.along = couples.along.reshape(*points, self.n, 3)
        if couples is not None and len(couples.joint) > 1:
            self.joints = [*zip(couples.joint.tolist(), couples.tube.tolist(), couples.moment, strict=False)][1:]
            self.kicks = np.zeros((self.pieces + 1, self.own))
            for k, tube, moment in self.joints:
                self.kicks[k, self.n :] += moment
                # The part of a moment along the arm twists one tube, the rest bends all of them.
                self.kicks[k, tube] += moment @ self.end_frame[k, :, 2]

    def _moments(self) -> None:
        """Set the moment m at the points, and on both sides of the ends of the pieces."""
        if self.load is None:
            none = np.zeros((self.pieces + 1, 3))
            self.moment, self.moment_tip_side, self.moment_plate_side = np.zeros(self.axis.shape), none, none
            self.bent = np.zeros((*self.axis.shape[:2], 2))
            return
        # m' = -e x n: from the plate towards the tip the moment falls by e x n.
        fall = (self.about_axis @ self.force[..., None])[..., 0]
        if self.along is not None:
            fall += self.along.sum(2)
        self.moment, self.moment_tip_side, self.moment_plate_side = self._inwards(
            fall, self.tip_moment, slice(self.n, None)
        )
        self.bent = (self.across @ self.moment[..., None])[..., 0]

    def _inwards(self, fall: Array, tip: Array, kicked: slice | None = None) -> FromTip:
        """Quantities (r,) integrated from their values at the tip towards the plate.

        Args:
            fall: decrease (P, K, r) per length towards the tip.  tip: values (r,) there.
            kicked: columns of the moments that act between pieces; None without these.
        """
        beyond = _beyond(self.pieces)
        plate_side = tip_side = beyond @ (self.weights[:, None] @ fall)[:, 0] + tip
        if self.kicks is not None and kicked is not None:
            # A moment between pieces is felt by all that lies nearer to the plate.
            plate_side = plate_side + np.cumsum(self.kicks[::-1, kicked], axis=0)[::-1]
            tip_side = plate_side - self.kicks[:, kicked]
        return FromTip(tip_side[:-1, None] - self.back @ fall, tip_side, plate_side)

    @cached_property
    def about_moment(self) -> Array:
        """Matrices (P, K, 3, 3) of a -> m x a."""
        return hat(self.moment)

    @cached_property
    def back(self) -> Array:
        """Integration (P, K, K) up to the points, for t and m."""
        return np.asarray(self.h * self.t.adjoint)

    @cached_property
    def ahead(self) -> Array:
        """Integration (P, K, K) up to the points, for phi and psi."""
        return np.asarray(self.h * self.t.matrix)

    @property
    def tables(self) -> SectionInputs:
        """theta, kb, m (P K, n) and b (P K, 2) at the points."""
        theta, kb, m = (table.reshape(-1, self.n) for table in (self.theta, self.stiffness, self.moments))
        return theta, kb, m, self.bent.reshape(-1, 2)

    def _torques(self, gained: Array, stretch: Array) -> None:
        """Set torques t and rotations phi, at the points and at the ends of the pieces, from M and g (P K, n)."""
        stretch = stretch.reshape(self.rate.shape)
        self.winding = self.rate * stretch
        """Derivative g / kt (P, K, n) of phi' by the torque."""
        fall = -gained.reshape(self.pieces, self.degree, self.n)
        if self.along is not None:
            fall += (self.along @ self.axis[..., None])[..., 0]
        tip = np.zeros(self.n)
        if self.load is not None:
            tip[self.tip_tube] = self.tip_moment @ self.end_frame[-1, :, 2]
        self.torque, self.torque_tip_side, self.torque_plate_side = self._inwards(fall, tip, slice(self.n))
        self.stretched = self.torque * stretch
        """Torque times stretch, g t (P, K, n), N m."""
        turning = self.rate * self.stretched
        # Between clamp and plate a tube twists by t int ds / kt.
        first = self.base + self.transmission * self.torque_plate_side[0]
        self.phi_ends = first + _beyond(self.pieces)[::-1, ::-1] @ (self.weights[:, None] @ turning)[:, 0]
        self.phi = self.phi_ends[:-1, None] + self.ahead @ turning

    @cached_property
    def coupled(self) -> Array | None:
        """Derivative (P, K, n, n) of phi' by phi at fixed torques; None for concentric tubes."""
        if self.at.by_stretch is None:
            return None
        return (self.rate * self.torque)[..., None] * self.at.by_stretch.reshape(*self.rate.shape, self.n)

    @cached_property
    def by_energy(self) -> Array:
        """Derivative (P, K, n + 2) of the elastic energy per length by theta and b at fixed torques."""
        out = self.at.by_energy.reshape(self.pieces, self.degree, self.n + 2)
        if self.coupled is None:
            return out
        # Torsion has the energy t phi' / 2, and phi' depends on phi through g.
        stretched = (self.torque[..., None, :] @ self.coupled)[..., 0, :] / 2
        return np.concatenate([out[..., : self.n] + stretched, out[..., self.n :]], axis=2)

    @cached_property
    def by_data(self) -> DataSlopes:
        """Derivatives of cross-sections by phase, kb and m."""
        n, points = self.n, (self.pieces, self.degree)
        own = by_data_of(self.tables, self.offsets)
        turned = self.at.by_torque, self.at.by_curvature, self.by_energy.reshape(-1, n + 2)
        out = [np.concatenate([a[..., :n], b], axis=-1) for a, b in zip(turned, own[:3], strict=True)]
        torque, curvature, energy = out[0].reshape(*points, n, -1), out[1].reshape(*points, 2, -1), out[2]
        energy = energy.reshape(*points, -1)
        if self.coupled is None:
            return DataSlopes(torque, curvature, energy, None)
        stretched = (self.rate * self.torque)[..., None] * own[3].reshape(*points, n, -1)
        energy[..., n:] += (self.torque[..., None, :] @ stretched)[..., 0, :] / 2
        return DataSlopes(torque, curvature, energy, np.concatenate([self.coupled, stretched], axis=-1))


@lru_cache(maxsize=16)
def _kept(n: int, own: int) -> Index:
    """Rows of the state (2 n + 6,) in the chain of pieces; without a load, of rotations and torques only."""
    return np.concatenate([np.arange(own), n + 3 + np.arange(own)])


@lru_cache(maxsize=64)
def _beyond(pieces: int) -> Array:
    """Matrix (P + 1, P), 1 if a piece lies beyond an end of a piece, else 0."""
    return np.triu(np.ones((pieces + 1, pieces)))
