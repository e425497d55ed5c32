"""Orientation of an arm from its curvature: Gauss collocation of the unit quaternion, linear in it.

Q' = Q o u / 2 with Q o u = (u_x Omega_x + u_y Omega_y) Q. At the K points of an element of length h

    Q_a = Q_start + h sum_b A_ab Q_b o u_b / 2,        Q_end = Q_start + h sum_b b_b Q_b o u_b / 2.

At the ends of elements |Q| = 1 exactly, since Gauss collocation preserves quadratic invariants; inside, Q is not
normalised. The equations are linear in Q and in u, so that first and second derivatives are products of one inverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...physics.shape import frame_forms, quaternion_rates, rotation_matrix_function, tangent_forms, world_turns
from ...typing import Array
from .arm import along_elements, cumulate
from .buffered import mapped
from .collocated import ENDS
from .mesh import Mesh

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Orientation:
    """Quaternions along P elements with K points each, N = P K in all, and their derivatives by the curvature."""

    start: Array
    """Orientation Q (P + 1, 4) as quaternions at the starts of the elements, and at the tip."""
    stage: Array
    """Orientation Q (N, 4) as quaternions at the points."""
    rate: Array
    """Matrices (N, 4, 4) of Q -> Q o u."""
    inverse: Array
    """Inverse (P, 4 K, 4 K) of the equations of each element."""
    stage_by_start: Array
    """Derivative (P, 4 K, 4) of Q at the points by Q at the start of their element."""
    end_by_start: Array
    """Derivative (P, 4, 4) of Q at the end of each element by Q at its start."""
    stage_slope: Array
    """Derivative (N, 4, 2 N) of `stage` by the curvature (N, 2)."""
    start_slope: Array
    """Derivative (P + 1, 4, 2 N) of `start` by the curvature (N, 2)."""

    def turn_slope(self, element: int = -1) -> Array:
        """Derivative (3, 2 N) of the turn about world axes by the curvature, where an element begins; at the tip -1."""
        return np.asarray(2 * (world_turns() @ self.start[element]) @ self.start_slope[element])


class Stages(NamedTuple):
    """Quaternions along the arm without their derivatives; fields as of `Orientation`."""

    start: Array
    stage: Array
    rate: Array
    inverse: Array
    stage_by_start: Array
    end_by_start: Array
    increment: Array
    """Matrix (P, 4, 4 K) of Q at the end of each element, less that at its start, by Q at its points."""


def stages(mesh: Mesh, curvature: Array) -> Stages:
    """Quaternions from the identity at the plate, with curvature (N, 2) at the points of all elements of a mesh."""
    elements, k = len(mesh.length), mesh.tableau.degree
    half = mesh.length / 2
    omega = quaternion_rates()
    rate = (curvature @ omega.reshape(2, 16)).reshape(-1, 4, 4)
    weighted = mesh.tableau.matrix[:, :, None, None] * rate.reshape(elements, 1, k, 4, 4)
    system = -half[:, None, None] * weighted.transpose(0, 1, 3, 2, 4).reshape(elements, 4 * k, 4 * k)
    system[:, np.arange(4 * k), np.arange(4 * k)] += 1.0
    inverse = np.asarray(np.linalg.inv(system), dtype=float)
    stage_by_start = inverse.reshape(elements, 4 * k, k, 4).sum(2)
    # Q_end - Q_start as a row by the stages: h b_b (Q_b o u_b) / 2.
    increment = (half[:, None, None, None] * mesh.tableau.weights[:, None, None]) * rate.reshape(elements, k, 4, 4)
    increment = increment.transpose(0, 2, 1, 3).reshape(elements, 4, 4 * k)
    end_by_start = np.eye(4) + increment @ stage_by_start
    start = np.empty((elements + 1, 4))
    start[0] = IDENTITY
    for e in range(elements):
        start[e + 1] = end_by_start[e] @ start[e]
    stage = (stage_by_start @ start[:-1, :, None]).reshape(-1, 4)
    return Stages(start, stage, rate, inverse, stage_by_start, end_by_start, increment)


def orient(mesh: Mesh, curvature: Array) -> Orientation:
    """Orientation as of `stages`, with its derivatives by the curvature (N, 2)."""
    elements, k = len(mesh.length), mesh.tableau.degree
    half, omega = mesh.length / 2, quaternion_rates()
    start, stage, rate, inverse, stage_by_start, end_by_start, increment = stages(mesh, curvature)
    # Derivatives by the curvature of the same element, at its points and at its end.
    rate_slope = (omega @ stage.T).transpose(2, 1, 0)
    by_stage = rate_slope.reshape(elements, 1, k, 4, 2).swapaxes(2, 3)
    right = half[:, None, None, None, None] * mesh.tableau.matrix[:, None, :, None] * by_stage
    local = inverse @ right.reshape(elements, 4 * k, 2 * k)
    direct = half[:, None, None, None] * mesh.tableau.weights[:, None]
    direct = direct * rate_slope.reshape(elements, k, 4, 2).swapaxes(1, 2)
    local_end = direct.reshape(elements, 4, 2 * k) + increment @ local
    # Derivatives by the curvature of the elements before it, through Q at its start.
    stage_slope = np.zeros((elements, 4 * k, 2 * elements * k))
    start_slope = np.zeros((elements + 1, 4, 2 * elements * k))
    for e in range(elements):
        element = slice(2 * e * k, 2 * (e + 1) * k)
        before = slice(0, 2 * e * k)
        stage_slope[e, :, before] = stage_by_start[e] @ start_slope[e, :, before]
        stage_slope[e, :, element] = local[e]
        start_slope[e + 1, :, before] = end_by_start[e] @ start_slope[e, :, before]
        start_slope[e + 1, :, element] = local_end[e]
    return Orientation(
        start=start,
        stage=stage,
        rate=rate,
        inverse=inverse,
        stage_by_start=stage_by_start,
        end_by_start=end_by_start,
        stage_slope=stage_slope.reshape(-1, 4, 2 * elements * k),
        start_slope=start_slope,
    )


@dataclass(frozen=True, eq=False)
class Adjoint:
    """Derivatives of W, a sum of functions of the orientation Q at the points."""

    gradient: Array
    """Derivative (N, 2) of W by the curvature."""
    mixed: Array
    """Second derivatives (N, 2, 4) of W by the curvature and by Q, both at the same point."""
    base: Array
    """Derivative (4,) of W by Q at the plate."""


def adjoint(mesh: Mesh, orientation: Orientation, by_stage: Array) -> Adjoint:
    """Derivatives of W by one sweep from tip to plate, from derivatives `by_stage` (N, 4) by Q at the points."""
    elements, k = len(mesh.length), mesh.tableau.degree
    half, weights = mesh.length / 2, mesh.tableau.weights
    local = by_stage.reshape(elements, 4 * k)
    local_start = (local[:, None, :] @ orientation.stage_by_start)[:, 0]
    by_start = np.zeros((elements + 1, 4))
    for e in reversed(range(elements)):
        by_start[e] = local_start[e] + by_start[e + 1] @ orientation.end_by_start[e]
    by_rate = by_start[1:, None, None, :] @ orientation.rate.reshape(elements, k, 4, 4)
    right = local + (half[:, None, None] * weights[:, None] * by_rate[:, :, 0]).reshape(elements, 4 * k)
    multiplier = (right[:, None, :] @ orientation.inverse).reshape(elements, k, 4)
    costate = mesh.tableau.matrix.T @ multiplier + weights[:, None] * by_start[1:, None, :]
    costate = (half[:, None, None] * costate).reshape(-1, 4)
    # (N, 2, 4): the first axis of the matrices is summed over.
    mixed = (costate @ quaternion_rates().swapaxes(0, 1).reshape(4, 8)).reshape(-1, 2, 4)
    gradient = (mixed @ orientation.stage[:, :, None])[:, :, 0]
    return Adjoint(gradient, mixed, by_start[0])


def second_derivative(orientation: Orientation, first: Adjoint, forms: Array) -> Array:
    """Second derivative (2 N, 2 N) of W by the curvature; `forms` (N, 4, 4) are those by Q at the points."""
    count = len(orientation.stage)
    size = 2 * count
    direct = (forms @ orientation.stage_slope).reshape(4 * count, size)
    mixed = (first.mixed @ orientation.stage_slope).reshape(size, size)
    out = orientation.stage_slope.reshape(4 * count, size).T @ direct + mixed
    return np.asarray(out + mixed.T)


def moment_work(orientation: Orientation, moments: Array) -> tuple[Array, Array]:
    """Virtual work of moments (N, 3) that act beyond the points, per turn of the frame there by the curvature.

    It is (R'm)_xy (N, 2), with its derivative (2 N, 2 N) by the curvature.
    """
    stage, count = orientation.stage, len(orientation.stage)
    forms = (moments @ frame_forms()[:, :2].reshape(3, 32)).reshape(count, 8, 4)
    half = (forms @ stage[:, :, None]).reshape(count, 2, 4)
    return (half @ stage[:, :, None])[:, :, 0], (2 * half @ orientation.stage_slope).reshape(2 * count, -1)


def tangents(stage: Array) -> Array:
    """Tangents (N, 3) R e3 = Q' T Q of quaternions (N, 4), which need not be normalised."""
    return np.asarray(((stage @ tangent_forms()) * stage).sum(2).T)


def tangent_slopes(stage: Array) -> Array:
    """Derivative (N, 3, 4) of `tangents` by Q."""
    return np.asarray(2 * (stage @ tangent_forms()).swapaxes(0, 1))


def position_slopes(orientation: Orientation, weight: Array) -> Array:
    """Derivative (..., 3, 2 N) by the curvature of positions, integrals of the tangent with weights (..., N)."""
    count = len(orientation.stage)
    by_u = tangent_slopes(orientation.stage) @ orientation.stage_slope
    return np.asarray((weight @ by_u.reshape(count, -1)).reshape(*weight.shape[:-1], 3, -1))


class Centreline(NamedTuple):
    """Centreline at ENDS of the elements."""

    position: Array
    """Positions (m, 3), m."""
    frame: Array
    """Bishop frames (m, 3, 3)."""


def centreline(mesh: Mesh, orientation: Orientation, length: Array) -> Centreline:
    """Centreline with an orientation that was found on a mesh, of elements that are `length` (P,) long, m."""
    t, elements = mesh.tableau, len(length)
    tangent = tangents(orientation.stage).reshape(elements, t.degree, 3)
    # Q' = (u_x Omega_x + u_y Omega_y) Q / 2 at the points, integrated by their polynomial.
    rate = (orientation.rate @ orientation.stage[:, :, None] / 2).reshape(elements, t.degree, 4)
    turned = mesh.length[:, None, None] * (t.basis(tuple(ENDS.tolist()), 1) @ rate)
    quaternion = orientation.start[:-1, None] + turned
    quaternion[:, -1] = orientation.start[1:]
    # Collocation preserves the norm at the ends of elements only.
    quaternion /= np.linalg.norm(quaternion, axis=2, keepdims=True)
    frame = mapped(rotation_matrix_function(), elements * len(ENDS))(quaternion.reshape(-1, 4))[0]
    frames = along_elements(frame, elements).reshape(-1, 3, 3).swapaxes(1, 2).copy()
    return Centreline(cumulate(t, length[:, None, None] * tangent), frames)
