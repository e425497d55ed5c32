"""Inertia and damping of a loaded problem, on its mesh and its unknowns.

The motion has coordinates y = (x, alpha): the unknowns z and q of the equilibrium, and the rotations of the drives. Its
kinetic energy is a quadratic form of the rates of

    w(y) = (tangents t of the centreline at the points, z, alpha).

Velocities of the centreline are integrals of dt/dt. The rotations are linear in (z, alpha) everywhere: between the
places that z determines, a tube twists as in equilibrium, which is Guyan's reduction of a massless shaft.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from ...physics.dynamics import DryFriction, felt_bending_rate, polar_inertia
from ...robots.concentric import PAIRWISE, Friction
from ...typing import Array
from .arm import ArmShape, along_elements, arc_lengths, sections_at
from .buffered import section_function
from .collocated import ENDS
from .contact import concentrated_friction
from .loaded import LoadedProblem
from .mesh import Mesh, integrals
from .orientation import centreline, orient, stages, tangent_slopes, tangents
from .reduced import torsional_hessian

# Far below the rates of a snap, some 1e4 rad/s, so that friction is that of Coulomb during it.
CREEP = 10.0
"""Relative rotation rate (rad/s) below which friction between the tubes falls."""

TRANSMISSION_POINTS = 8
"""Quadrature points along a tube behind the plate, where the rotation is smooth."""


@dataclass(frozen=True, eq=False)
class MotionState:
    """State at coordinates y (Y,)."""

    mesh: Mesh
    curvature: Array
    """Curvature (N, 2) at the points, 1/m."""
    turns: Array
    """Coordinates (z, alpha) (U + n,)."""
    energy: float
    """Elastic energy, J."""
    gradient: Array
    """Derivative (Y,) of the elastic energy."""

    @cached_property
    def position(self) -> Array:
        """Coordinates w (W,) of the kinetic energy."""
        return np.concatenate([tangents(stages(self.mesh, self.curvature).stage).ravel(), self.turns])


class _Angles(NamedTuple):
    """Rotations of the tubes at coordinates y."""

    theta: Array
    """(P, n) rotations at the points, rad."""
    z: Array
    """Whitened unknowns of the torsion."""
    alpha: Array
    """(n,) rotations at the clamped ends, rad."""


class MotionSlopes(NamedTuple):
    """Derivatives at coordinates y (Y,)."""

    position: Array
    """Derivative (W, Y) of w."""
    stiffness: Array
    """Second derivative (X, X) of the elastic energy by x."""
    damping: Array
    """Matrix (Y, Y) of the dissipated power, which is y-rate' damping y-rate."""


@dataclass(frozen=True, eq=False)
class TubeMotion:
    """Coordinates, inertia and damping of a robot in motion, of N points and n tubes."""

    problem: LoadedProblem
    density: Array
    """Masses (n,) per length, kg/m."""
    diameters: Array
    """Outer and inner diameters (n, 2), m."""
    relaxation: Array
    """Relaxation times tau (n,), s."""
    lateral: bool = True
    """False for a bending without inertia, which then follows the rotations."""
    between: Friction | None = None
    """Friction between the tubes, or None."""

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.density)

    @cached_property
    def turn_rows(self) -> Array:
        """Derivative (N, n, U + n) of the rotations at the points by (z, alpha), also of tubes not determined by z."""
        torsion, n = self.problem.torsion, self.n_tubes
        rows = np.concatenate([self._twists(torsion.softness[0]), np.zeros((*torsion.stiffness.shape, n))], axis=2)
        rows[torsion.point, torsion.tube, : torsion.size] = torsion.factor
        rows[:, range(n), range(torsion.size, torsion.size + n)] = 1.0
        return rows

    def _twists(self, compliance: Array) -> Array:
        """Derivative (..., n, U) by z of rotations where the compliance from the clamp is (..., n), rad/(N m)."""
        torsion = self.problem.torsion
        return self._rows(np.minimum(compliance[..., None], torsion.softness[0][torsion.point, torsion.tube]))

    def _rows(self, shared: Array) -> Array:
        """Derivative (..., n, U) by z of sums of torques at the points, with factors `shared` (..., n, U)."""
        torsion = self.problem.torsion
        own = np.where(torsion.tube == np.arange(self.n_tubes)[:, None], shared, 0.0)
        if not torsion.size:
            return own
        # L is triangular, and all right sides are solved for at once.
        rows = scipy.linalg.solve_triangular(torsion.factor, own.reshape(-1, torsion.size).T, lower=True).T
        return np.asarray(rows.reshape(own.shape))

    def _compliance_at(self, arc_length: Array) -> Array:
        """Compliance (k, n) from the clamp to arc lengths (k,), or to the end of a tube that ends before, rad/(N m)."""
        assembly = self.problem.torsion.assembly
        along = np.minimum(arc_length[:, None], np.maximum(assembly.end, 0.0))
        return np.asarray(assembly.compliant(assembly.transmission + along))

    @cached_property
    def friction(self) -> DryFriction:
        """Friction between neighbouring tubes, of the relative rotations."""
        torsion, law, n, split = self.problem.torsion, self.between, self.n_tubes, self.problem.torsion.size
        none = np.zeros((0, self.problem.size + n))
        if law is None or law.trivial:
            return DryFriction(none, np.zeros(0), CREEP)
        limits = {name: np.array(law.per_pair(name, n - 1)) for name in PAIRWISE}
        point, pair = np.nonzero(torsion.assembly.present[torsion.section][:, 1:] & (limits["torque"] > 0))
        rows, capacity = (
            [self.turn_rows[point, pair + 1] - self.turn_rows[point, pair]],
            [torsion.weight[point] * limits["torque"][pair]],
        )
        for part in concentrated_friction(torsion.assembly, limits):
            turned = np.concatenate(
                [self._twists(self._compliance_at(np.array([part.arc_length])))[0], np.eye(n)], axis=1
            )
            rows.append((turned[part.pair + 1] - turned[part.pair])[None])
            capacity.append(np.array([part.capacity]))
        by_turns = np.concatenate(rows)
        table = np.zeros((len(by_turns), self.problem.size + n))
        table[:, :split], table[:, self.problem.size :] = by_turns[:, :split], by_turns[:, split:]
        return DryFriction(table, np.concatenate(capacity), CREEP)

    @cached_property
    def tip_rows(self) -> Array:
        """Derivative (n, U + n) of the rotations of the tubes at their own ends by (z, alpha)."""
        far = np.array([self.problem.torsion.assembly.total_length])
        return np.concatenate([self._twists(self._compliance_at(far))[0], np.eye(self.n_tubes)], axis=1)

    def tip_rotations(self, y: Array) -> Array:
        """Rotations (n,) of the tubes at their own ends at coordinates y (Y,), with their natural twist, rad."""
        torsion = self.problem.torsion
        z, alpha = y[: torsion.size], y[self.problem.size :]
        twist = torsion.assembly.twist_angle(np.array([torsion.assembly.total_length]))[0]
        return np.asarray(self.tip_rows @ np.concatenate([z, alpha]) + twist)

    def shape(self, y: Array) -> ArmShape:
        """Shape at coordinates y (Y,)."""
        torsion, mesh = self.problem.torsion, self.problem.mesh
        elements, s = len(mesh.length), (mesh.start[:, None] + mesh.length[:, None] * ENDS).ravel()
        theta, z, alpha = self._angles(y)
        natural = section_function("curvature", len(theta), self.n_tubes, False)(
            theta + torsion.phase, torsion.stiffness, torsion.moment
        )[0]
        curvature = self._curvature(natural, y)
        compliance, at_points = self._compliance_at(s), torsion.softness[0][torsion.point, torsion.tube]
        sections = sections_at(torsion, tuple(ENDS.tolist()))
        # The torque at s is the sum of those beyond.
        torque = self._rows(np.where(at_points > compliance[..., None], 1.0, 0.0)) @ z
        position, frame = centreline(mesh, orient(mesh, curvature), mesh.length)
        bent = mesh.tableau.lagrange(ENDS) @ curvature.reshape(elements, -1, 2)
        turned = alpha + self._twists(compliance) @ z + sections.twist_angle
        return ArmShape(
            arc_length=arc_lengths(mesh),
            rotation=along_elements(turned, elements).T.copy(),
            torsion=along_elements(torque / sections.torsional_stiffness + sections.twist, elements).T.copy(),
            curvature=along_elements(bent, elements),
            position=position,
            frame=frame,
        )

    @cached_property
    def spin(self) -> Array:
        """Inertia (U + n, U + n) of the rotations by (z, alpha), transmissions included, kg m^2 scaled as z."""
        torsion, n = self.problem.torsion, self.n_tubes
        inertia = polar_inertia(self.density, *self.diameters.T)
        present = torsion.assembly.present[torsion.section]
        weights = [(torsion.weight[:, None] * present * inertia).ravel()]
        rows = [self.turn_rows]
        nodes, node_weights = np.polynomial.legendre.leggauss(TRANSMISSION_POINTS)
        behind = (nodes[:, None] + 1) / 2 * torsion.assembly.transmission
        turned = np.broadcast_to(np.eye(n), (len(nodes), n, n))
        rows.append(np.concatenate([self._twists(torsion.assembly.compliant(behind)), turned], axis=2))
        weights.append((node_weights[:, None] / 2 * torsion.assembly.transmission * inertia).ravel())
        table = np.concatenate([part.reshape(-1, torsion.size + n) for part in rows])
        return np.asarray(table.T @ (np.concatenate(weights)[:, None] * table))

    @cached_property
    def to_points(self) -> Array:
        """Integration matrix (N, N) from the tangents to the positions of the points, m."""
        return integrals(self.problem.mesh, np.arange(len(self.problem.mesh.length)))[0]

    @cached_property
    def mass(self) -> Array:
        """Mass matrix (W, W) of w."""
        torsion = self.problem.torsion
        count, size = len(torsion.weight), len(self.spin)
        out = np.zeros((3 * count + size, 3 * count + size))
        out[3 * count :, 3 * count :] = self.spin
        if self.lateral:
            along = torsion.assembly.present[torsion.section] @ self.density
            tangent = self.to_points.T @ ((torsion.weight * along)[:, None] * self.to_points)
            out[: 3 * count, : 3 * count] = np.kron(tangent, np.eye(3))
        return out

    @cached_property
    def force(self) -> Array:
        """Dead load (W,) on w: its work is force' w, J."""
        weighted = self.problem.torsion.weight[:, None] * self.problem.force
        return np.concatenate([weighted.ravel(), np.zeros(len(self.spin))])

    def _angles(self, y: Array) -> _Angles:
        torsion = self.problem.torsion
        z, alpha = y[: torsion.size], y[self.problem.size :]
        theta = np.tile(alpha, (len(torsion.weight), 1))
        theta.ravel()[torsion.flat] += torsion.factor @ z
        return _Angles(theta, z, alpha)

    def _curvature(self, natural: Array, y: Array) -> Array:
        q = y[self.problem.torsion.size : self.problem.size]
        return np.asarray(natural + self.problem.softness[:, None] * q.reshape(-1, 2))

    def at(self, y: Array) -> MotionState:
        """State at coordinates y (Y,)."""
        torsion, n = self.problem.torsion, self.n_tubes
        theta, z, alpha = self._angles(y)
        coupling, moment, _, natural, *_ = section_function("bending", len(theta), n, False)(
            theta + torsion.phase, torsion.stiffness, torsion.moment
        )
        x, pull = y[: self.problem.size], torsion.weight[:, None] * moment
        gradient = np.concatenate([x, pull.sum(0)])
        gradient[: torsion.size] += pull.ravel()[torsion.flat] @ torsion.factor
        energy = float(x @ x) / 2 + float(torsion.weight @ coupling[:, 0])
        curvature, turns = self._curvature(natural, y), np.concatenate([z, alpha])
        return MotionState(self.problem.mesh, curvature, turns, energy, gradient)

    def slopes(self, y: Array) -> MotionSlopes:
        """Derivatives at coordinates y (Y,)."""
        problem, torsion, n = self.problem, self.problem.torsion, self.n_tubes
        theta, _, _ = self._angles(y)
        count, size = len(theta), len(y)
        _, _, stiffness, natural, slope, _ = section_function("bending", count, n, False)(
            theta + torsion.phase, torsion.stiffness, torsion.moment
        )
        slope = slope.reshape(count, n, 2).swapaxes(1, 2)
        curvature = self._curvature(natural, y)
        by_y = np.zeros((2 * count, size))
        by_y[:, : torsion.size] = (slope @ torsion.spread).reshape(2 * count, -1)
        by_y[np.arange(2 * count), torsion.size + np.arange(2 * count)] = np.repeat(problem.softness, 2)
        by_y[:, problem.size :] = slope.reshape(2 * count, n)
        orientation = orient(problem.mesh, curvature)
        tangent = (tangent_slopes(orientation.stage) @ orientation.stage_slope).reshape(3 * count, 2 * count) @ by_y
        spun = np.zeros((len(self.spin), size))
        spun[: torsion.size, : torsion.size] = np.eye(torsion.size)
        spun[torsion.size :, problem.size :] = np.eye(n)
        hessian = np.eye(problem.size)
        hessian[: torsion.size, : torsion.size] = torsional_hessian(torsion, stiffness)
        return MotionSlopes(np.concatenate([tangent, spun]), hessian, self._damping(by_y, curvature))

    def _damping(self, by_y: Array, curvature: Array) -> Array:
        """Damping (Y, Y), from the derivative (2 N, Y) of the curvature (N, 2)."""
        torsion, split, n = self.problem.torsion, self.problem.torsion.size, self.n_tubes
        count, size = len(curvature), by_y.shape[1]
        out = np.zeros((size, size))
        # z'z is the integral of kt theta'^2 of all tubes: each part of z belongs to one tube.
        out[range(split), range(split)] = self.relaxation[torsion.tube]
        bends = by_y.reshape(count, 2, size)
        for i in range(n):
            turn = np.zeros((count, size))
            turn[:, :split], turn[:, self.problem.size :] = self.turn_rows[:, i, :split], self.turn_rows[:, i, split:]
            felt = np.concatenate(felt_bending_rate((bends[:, 0], bends[:, 1]), turn, tuple(curvature.T[:, :, None])))
            stiff = np.tile(torsion.weight * torsion.stiffness[:, i] * self.relaxation[i], 2)
            out += felt.T @ (stiff[:, None] * felt)
        return out
