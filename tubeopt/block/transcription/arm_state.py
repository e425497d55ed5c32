"""An arm in equilibrium, with a load or without.

Along the arm the elastic rotations phi of the tubes, their torques t, the frame R and the moment m on the
cross-section, in world axes, obey

    phi' = t / kt,   t' = M(theta, b) - l.e,   R' = R hat(u),   m' = -e x n - l,
    b = (R'm)_xy,    u = (b + sum a_i) / sum kb_i,    e = R e3,    theta = phi + phase,

with the force n on the cross-section and the moment l per length, of which the axial part acts on the outermost tube.
Of eccentric tubes phi' = g t / kt, with the stretch g, and no load acts on them.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ...physics.shape import hat
from ...typing import Array, Index
from .arm import ArmShape, frames_at_points
from .buffered import bent_function, section_function
from .collocated import SHAPE_STEPS
from .loaded import LoadedProblem
from .reduced import ReducedProblem

# --- Cross-sections that carry a bending moment -----------------------------------------------------------------------


class SectionInputs(NamedTuple):
    """Arguments of the functions of cross-sections, at X points."""

    theta: Array
    """Rotations (X, n), rad."""
    stiffness: Array
    """Bending stiffnesses kb (X, n), N m^2."""
    natural_moment: Array
    """Moments m_i = kb_i kappa_i (X, n) that straighten the tubes, N m."""
    bending_moment: Array
    """Moment b (X, 2) on the cross-section, in its axes, N m."""


class SectionValues(NamedTuple):
    """Cross-sections at X points."""

    torque: Array
    """Torque per length M (X, n), N."""
    curvature: Array
    """Curvature u (X, 2), 1/m."""
    stretch: Array
    """Stretch g (X, n), 1 of concentric tubes."""


class Sections(NamedTuple):
    """Cross-sections at X points with their derivatives by theta and b."""

    torque: Array
    """Torque per length M (X, n), N."""
    curvature: Array
    """Curvature u (X, 2), 1/m."""
    stretch: Array
    """Stretch g (X, n), 1 of concentric tubes."""
    slopes: Array
    """Derivative (X, n + 2, n + 2) of M above u."""
    stretch_slopes: Array | None
    """Derivative (X, n, n) of the stretch of eccentric tubes by theta, else None."""


class SectionDataSlopes(NamedTuple):
    """Derivatives of cross-sections at X points by kb and m (2 n)."""

    torque: Array
    """Derivative (X, n, 2 n) of the torsional moments M."""
    curvature: Array
    """Derivative (X, 2, 2 n) of the curvature u."""
    stretch: Array | None
    """Derivative (X, n, 2 n) of the stretch of eccentric tubes, else None."""


class SectionEnergy(NamedTuple):
    """Bending energy per length at X points."""

    value: Array
    """Energy (X,), N."""
    slopes: Array
    """Derivative (X, 3 n + 2) of the energy by theta, kb, m and b."""


Offsets = tuple[()] | tuple[Array, Array]
"""Offsets (n,) of eccentric tubes from the centreline, m, and their angles (n,), rad; () of concentric tubes."""


def values_of(inputs: SectionInputs, offsets: Offsets) -> SectionValues:
    """Cross-sections without derivatives."""
    count, n = inputs.theta.shape
    if offsets:
        torque, stretch, curvature, _ = section_function("section", count, n, True)(*inputs[:3], *offsets)
        return SectionValues(torque.copy(), curvature.copy(), stretch.copy())
    values = bent_function("section", count, n)(*inputs)[0].copy()
    return SectionValues(values[:, :n], values[:, n:], np.ones((count, n)))


def sections_of(inputs: SectionInputs, offsets: Offsets) -> Sections:
    """Cross-sections with derivatives."""
    count, n = inputs.theta.shape
    if offsets:
        all_of = _eccentric_sections(inputs, offsets)
        # Eccentric tubes have no bending moment b.
        slopes = np.zeros((count, n + 2, n + 2))
        slopes[:, :n, :n], slopes[:, n:, :n] = all_of.torque_slopes[..., :n], all_of.curvature_slopes[..., :n]
        return Sections(all_of.torque, all_of.curvature, all_of.stretch, slopes, all_of.stretch_slopes[..., :n])
    values, slopes = (part.copy() for part in bent_function("linear", count, n)(*inputs))
    slopes = slopes.reshape(count, n + 2, n + 2)
    return Sections(values[:, :n], values[:, n:], np.ones((count, n)), slopes, None)


def data_slopes_of(inputs: SectionInputs, offsets: Offsets) -> SectionDataSlopes:
    """Derivatives of cross-sections by kb and m."""
    count, n = inputs.theta.shape
    if offsets:
        of = _eccentric_sections(inputs, offsets)
        return SectionDataSlopes(of.torque_slopes[..., n:], of.curvature_slopes[..., n:], of.stretch_slopes[..., n:])
    slopes = bent_function("linear_data", count, n)(*inputs)[0].copy().reshape(count, n + 2, 2 * n)
    return SectionDataSlopes(slopes[:, :n], slopes[:, n:], None)


def energy_of(inputs: SectionInputs, offsets: Offsets) -> SectionEnergy:
    """Bending energy per length with its derivatives."""
    count, n = inputs.theta.shape
    if offsets:
        of = _eccentric_sections(inputs, offsets)
        return SectionEnergy(of.energy[:, 0], np.concatenate([of.energy_slopes[:, 0], np.zeros((count, 2))], axis=1))
    energy, slopes = (part.copy() for part in bent_function("energy", count, n)(*inputs))
    return SectionEnergy(energy[:, 0], slopes)


class _EccentricSections(NamedTuple):
    """Cross-sections of eccentric tubes at X points, with their derivatives (X, r, 3 n) by theta, kb and m."""

    torque: Array
    stretch: Array
    curvature: Array
    energy: Array
    torque_slopes: Array
    stretch_slopes: Array
    curvature_slopes: Array
    energy_slopes: Array


def _eccentric_sections(inputs: SectionInputs, offsets: Offsets) -> _EccentricSections:
    count, n = inputs.theta.shape
    out = [part.copy() for part in section_function("linear", count, n, True)(*inputs[:3], *offsets)]
    # CasADi stores (r, 3 n) by columns.
    slopes = [
        part.reshape(count, 3 * n, value.shape[1]).swapaxes(1, 2) for value, part in zip(out[:4], out[4:], strict=True)
    ]
    return _EccentricSections(*out[:4], *slopes)


class FromTip(NamedTuple):
    """Quantities (r,) integrated from the tip of an arm of P elements."""

    points: Array
    """Values (P, K, r) at the points."""
    tip_side: Array
    """Values (P + 1, r) at the ends of the elements, on the side of the tip."""
    plate_side: Array
    """Values (P + 1, r) at the ends of the elements, on the side of the plate."""


class FromPlate(NamedTuple):
    """Quantities (r,) integrated from the plate of an arm of P elements."""

    points: Array
    """Values (P, K, r) at the points."""
    ends: Array
    """Values (P + 1, r) at the ends of the elements."""


class JointMoment(NamedTuple):
    """Moment that acts where two elements meet."""

    element: int
    """Number of the element that begins at the moment."""
    tube: int
    """Number of the tube that the part of the moment along the arm twists."""
    moment: Array
    """Moment (3,), N m."""


class DataSlopes(NamedTuple):
    """Derivatives by phase, kb and m (3 n) at the points, at fixed torques."""

    torque: Array
    """Derivative (P, K, n, 3 n) of the torsional moments M."""
    curvature: Array
    """Derivative (P, K, 2, 3 n) of the curvature u."""
    rotation_rate: Array | None
    """Derivative (P, K, n, 3 n) of phi' of eccentric tubes, else None."""


class ArmState:
    """An arm in equilibrium: n tubes, P elements with K points each.

    Args:
        problem: torsion problem, on the mesh of the arm.
        alpha: rotations (n,) at the clamps, rad.
        phi: elastic rotations (N, n) at the collocation points of the problem.
        shape: shape of the arm.
        loaded: problem under a load, or None.
        straight: True if rotations of straight tubes are needed; they follow from the torques.
    """

    def __init__(
        self,
        problem: ReducedProblem,
        alpha: Array,
        phi: Array,
        shape: ArmShape,
        *,
        loaded: LoadedProblem | None = None,
        straight: bool = True,
    ) -> None:
        self.problem, self.loaded, self.alpha, self.shape = problem, loaded, alpha, shape
        self.mesh, self.tableau, self.length = problem.mesh, problem.mesh.tableau, problem.mesh.length
        self.n = problem.assembly.n_tubes
        self.elements, self.degree = len(self.length), self.tableau.degree
        self.cuts, self.tip_tube = problem.cuts, problem.tip_tube
        points, sections = (self.elements, self.degree), problem.compliant.sections
        self.phase, self.stiffness, self.natural_moment = (
            part.reshape(*points, self.n) for part in (sections.phase, sections.stiffness, sections.moment)
        )
        self.compliance, self.transmission = problem.compliant.rate, problem.compliant.transmission
        """Torsional compliance 1 / kt (P, K, n), and int ds / kt (n,) from clamp to plate."""
        assembly = problem.assembly
        self.offsets: Offsets = (assembly.offset, assembly.offset_angle) if assembly.eccentric else ()
        self.h = self.length[:, None, None]
        self.weights = self.length[:, None] * self.tableau.weights
        self.frame, self.end_frame = frames_at_points(self.tableau, self.length, shape), shape.frame[::SHAPE_STEPS]
        self.axis = self.frame[..., 2]
        self.across, self.about_axis = self.frame[..., :2].swapaxes(2, 3), hat(self.axis)
        """Matrices of a -> (R'a)_xy (P, K, 2, 3) and a -> e x a (P, K, 3, 3)."""
        self._set_load(loaded)
        self._set_moments()
        table = phi.reshape(-1, self.degree, self.n)
        if len(table) < self.elements:
            # Elements without collocation points have no rotations yet: theirs follow from the torques below.
            table = np.zeros((*points, self.n))
            table[self.mesh.collocated] = phi.reshape(-1, self.degree, self.n)
        self.theta = table + self.phase
        if straight or not self.mesh.collocated.all():
            # Rotations of straight tubes are no unknowns of the problem. The torques do not depend on them, and give
            # the rotations of all tubes, at which the cross-sections are evaluated.
            values = values_of(self.section_inputs, self.offsets)
            self._set_torques(values.torque, values.stretch)
            self.theta = self.phi + self.phase
            self.at = sections_of(self.section_inputs, self.offsets)
        else:
            self.at = sections_of(self.section_inputs, self.offsets)
            self._set_torques(self.at.torque, self.at.stretch)

    def _set_load(self, loaded: LoadedProblem | None) -> None:
        """Set the forces, moments per length on the tubes, and moments where elements meet."""
        points = self.elements, self.degree
        self.load = None if loaded is None else loaded.load
        # Without a load the chain of elements has rotations and torques only; frame and moment follow.
        self.half = self.n if loaded is None else self.n + 3
        """Length of (phi, psi), and of (t, m), in the chain."""
        self.chain_rows = _chain_rows(self.n, self.half)
        self.follower = self.load is not None and self.load.frame == "tip"
        self.tip_force = self.tip_moment = np.zeros(3)
        self.joint_moments: list[JointMoment] = []
        self.moment_density: Array | None = None
        """Moments per length l (P, K, n, 3) on the tubes, N."""
        self.moment_jumps: Array | None = None
        """Jumps (P + 1, n + 3) of (t, m) by moments where elements meet, N m."""
        if loaded is None:
            self.force = np.zeros((*points, 3))
            return
        self.force = loaded.force.reshape(*points, 3)
        self.tip_force, self.tip_moment = np.array(loaded.load.force), np.array(loaded.load.moment)
        if self.follower:
            tip_frame = self.shape.frame[-1]
            self.tip_force, self.tip_moment = tip_frame @ self.tip_force, tip_frame @ self.tip_moment
            # A follower force at the tip acts on the whole arm; the problem has the other forces.
            self.force = self.force + self.tip_force
        couples = loaded.couples
        if couples is None:
            return
        if len(couples.point):
            self.moment_density = couples.along.reshape(*points, self.n, 3)
        if len(couples.joint) > 1:
            acting = zip(couples.joint.tolist(), couples.tube.tolist(), couples.moment, strict=False)
            self.joint_moments = [JointMoment(*each) for each in acting][1:]
            self.moment_jumps = np.zeros((self.elements + 1, self.half))
            for element, tube, moment in self.joint_moments:
                self.moment_jumps[element, self.n :] += moment
                # The part of a moment along the arm twists one tube, the rest bends all of them.
                self.moment_jumps[element, tube] += moment @ self.end_frame[element, :, 2]

    def _set_moments(self) -> None:
        """Set the moment m at the points and on both sides of the ends of the elements, and b at the points."""
        points = self.elements, self.degree
        if self.load is None:
            none = np.zeros((self.elements + 1, 3))
            self.moment, self.moment_tip_side, self.moment_plate_side = np.zeros((*points, 3)), none, none
            self.bending_moment = np.zeros((*points, 2))
            return
        # m' = -e x n - l: from the plate towards the tip the moment decreases by e x n + l.
        decrease = (self.about_axis @ self.force[..., None])[..., 0]
        if self.moment_density is not None:
            decrease += self.moment_density.sum(2)
        jumps = None if self.moment_jumps is None else self.moment_jumps[:, self.n :]
        self.moment, self.moment_tip_side, self.moment_plate_side = self._from_tip(decrease, self.tip_moment, jumps)
        self.bending_moment = (self.across @ self.moment[..., None])[..., 0]

    def _set_torques(self, torque_rate: Array, stretch: Array) -> None:
        """Set torques t and rotations phi at the points and at the ends of the elements.

        They follow from M and g (P K, n).
        """
        points = self.compliance.shape
        self.twist_compliance = self.compliance * stretch.reshape(points)
        """Derivative g / kt (P, K, n) of phi' by the torque."""
        decrease = -torque_rate.reshape(points)
        if self.moment_density is not None:
            decrease += (self.moment_density @ self.axis[..., None])[..., 0]
        tip = np.zeros(self.n)
        if self.load is not None:
            tip[self.tip_tube] = self.tip_moment @ self.end_frame[-1, :, 2]
        jumps = None if self.moment_jumps is None else self.moment_jumps[:, : self.n]
        self.torque, self.torque_tip_side, self.torque_plate_side = self._from_tip(decrease, tip, jumps)
        self.stretched_torque = self.torque * stretch.reshape(points)
        """Torques times stretch, g t (P, K, n), N m."""
        # Between clamp and plate a tube twists by t int ds / kt.
        at_plate = self.alpha + self.transmission * self.torque_plate_side[0]
        self.phi, self.phi_ends = self._from_plate(self.compliance * self.stretched_torque, at_plate)

    def _from_plate(self, rates: Array, start: Array) -> FromPlate:
        """Quantities (r,) integrated from their values `start` (r,) at the plate, with rates (P, K, r)."""
        integrals = self._from_start @ rates
        ends = start + _beyond(self.elements)[::-1, ::-1] @ integrals[:, -1]
        return FromPlate(ends[:-1, None] + integrals[:, :-1], ends)

    def _from_tip(self, decrease: Array, tip: Array, jumps: Array | None = None) -> FromTip:
        """Quantities (r,) integrated from their values at the tip towards the plate.

        Args:
            decrease: rates (P, K, r) at which they decrease towards the tip.
            tip: values (r,) there.
            jumps: jumps (P + 1, r) where elements meet, or None.
        """
        integrals = self._from_start_adjoint @ decrease
        plate_side = tip_side = _beyond(self.elements) @ integrals[:, -1] + tip
        if jumps is not None:
            # A moment between elements acts on all that lies nearer to the plate.
            plate_side = plate_side + np.cumsum(jumps[::-1], axis=0)[::-1]
            tip_side = plate_side - jumps
        return FromTip(tip_side[:-1, None] - integrals[:, :-1], tip_side, plate_side)

    @cached_property
    def about_moment(self) -> Array:
        """Matrices (P, K, 3, 3) of the cross product a -> m x a with the bundle moment m."""
        return hat(self.moment)

    @cached_property
    def _from_start(self) -> Array:
        """Integration (P, K + 1, K) from the start of an element to its points and its end, for phi and psi."""
        return np.asarray(self.h * self.tableau.integration)

    @cached_property
    def _from_start_adjoint(self) -> Array:
        """The adjoint integration (P, K + 1, K), for t and m."""
        return np.asarray(self.h * self.tableau.adjoint_integration)

    @property
    def ahead(self) -> Array:
        """Integration (P, K, K) up to the points, for phi and psi."""
        return self._from_start[:, :-1]

    @property
    def back(self) -> Array:
        """Integration (P, K, K) up to the points, for t and m."""
        return self._from_start_adjoint[:, :-1]

    @property
    def section_inputs(self) -> SectionInputs:
        """Arguments of the cross-sections at the P K points."""
        theta, kb, m = (table.reshape(-1, self.n) for table in (self.theta, self.stiffness, self.natural_moment))
        return SectionInputs(theta, kb, m, self.bending_moment.reshape(-1, 2))

    @cached_property
    def twist_slopes(self) -> Array | None:
        """Derivative (P, K, n, n) of phi' by phi at fixed torques; None for concentric tubes."""
        if self.at.stretch_slopes is None:
            return None
        return (self.compliance * self.torque)[..., None] * self.at.stretch_slopes.reshape(*self.torque.shape, self.n)

    @cached_property
    def data_slopes(self) -> DataSlopes:
        """Derivatives of cross-sections by phase, kb and m."""
        n, points = self.n, (self.elements, self.degree)
        by_data, by_phase = data_slopes_of(self.section_inputs, self.offsets), self.at.slopes[..., :n]
        torque = np.concatenate([by_phase[:, :n], by_data.torque], axis=2).reshape(*points, n, 3 * n)
        curvature = np.concatenate([by_phase[:, n:], by_data.curvature], axis=2).reshape(*points, 2, 3 * n)
        if self.twist_slopes is None:
            return DataSlopes(torque, curvature, None)
        assert by_data.stretch is not None
        twist = (self.compliance * self.torque)[..., None] * by_data.stretch.reshape(*points, n, 2 * n)
        return DataSlopes(torque, curvature, np.concatenate([self.twist_slopes, twist], axis=3))

    @cached_property
    def energy_slopes(self) -> Array:
        """Derivative (P, K, 3 n + 2) of the elastic energy per length by theta, kb, m and b at fixed torques."""
        out = energy_of(self.section_inputs, self.offsets).slopes.reshape(self.elements, self.degree, 3 * self.n + 2)
        if self.twist_slopes is not None:
            # Torsion has the energy t phi' / 2, and phi' depends on theta, kb and m through g.
            rotation_rate = self.data_slopes.rotation_rate
            assert rotation_rate is not None
            out[..., : 3 * self.n] += (self.torque[..., None, :] @ rotation_rate)[..., 0, :] / 2
        return out


@lru_cache(maxsize=16)
def _chain_rows(n: int, half: int) -> Index:
    """Rows of the state (2 n + 6,) in the chain of elements; without a load, of rotations and torques only."""
    return np.concatenate([np.arange(half), n + 3 + np.arange(half)])


@lru_cache(maxsize=64)
def _beyond(elements: int) -> Array:
    """Matrix (P + 1, P), 1 if an element lies beyond an end of an element, else 0."""
    return np.triu(np.ones((elements + 1, elements)))
