"""Orientation of an arm from its curvature: Gauss collocation of the unit quaternion, linear in it.

Q' = Q o u / 2 with Q o u = (u_x Omega_x + u_y Omega_y) Q. At the K points of an element of length h

    Q_a = Q_begin + h sum_b A_ab Q_b o u_b / 2,        Q_end = Q_begin + h sum_b b_b Q_b o u_b / 2,

which keeps |Q| = 1 at the ends of elements exactly, since Gauss points keep quadratic invariants; inside, Q is not
normalised. Everything is linear in Q and in u, so that first and second derivatives are products of one inverse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...physics.shape import quaternion_rates, tangent_forms
from ...typing import Array
from .mesh import Mesh

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Orientation:
    """Quaternions along P elements with K points each, N = P K in all, and how they change with the curvature there.

    begin: (P + 1, 4) where the elements begin, and at the tip.  stage: (N, 4) at the points.
    rate: (N, 4, 4) matrix of Q -> Q o u.  inverse: (P, 4 K, 4 K) of the equations of an element.
    spread: (P, 4 K, 4) of the points by the beginning.  carried: (P, 4, 4) of the end by the beginning.
    stage_slope: (N, 4, 2 N), begin_slope: (P + 1, 4, 2 N) by the curvature (N, 2) at the points.
    """

    begin: Array
    stage: Array
    rate: Array
    inverse: Array
    spread: Array
    carried: Array
    stage_slope: Array
    begin_slope: Array


def orient(mesh: Mesh, curvature: Array) -> Orientation:
    """Orientation from the identity at the plate, with curvature (N, 2) at the points of all pieces of a mesh."""
    pieces, k = len(mesh.length), mesh.tableau.degree
    half = mesh.length / 2
    omega = quaternion_rates()
    rate = (curvature @ omega.reshape(2, 16)).reshape(-1, 4, 4)
    weighted = mesh.tableau.matrix[:, :, None, None] * rate.reshape(pieces, 1, k, 4, 4)
    system = -half[:, None, None] * weighted.transpose(0, 1, 3, 2, 4).reshape(pieces, 4 * k, 4 * k)
    system[:, np.arange(4 * k), np.arange(4 * k)] += 1.0
    inverse = np.asarray(np.linalg.inv(system), dtype=float)
    spread = inverse.reshape(pieces, 4 * k, k, 4).sum(2)
    # Row of the end: h b_b (Q_b o u_b) / 2.
    gather = (half[:, None, None, None] * mesh.tableau.weights[:, None, None]) * rate.reshape(pieces, k, 4, 4)
    gather = gather.transpose(0, 2, 1, 3).reshape(pieces, 4, 4 * k)
    carried = np.eye(4) + gather @ spread
    begin = np.empty((pieces + 1, 4))
    begin[0] = IDENTITY
    for e in range(pieces):
        begin[e + 1] = carried[e] @ begin[e]
    stage = (spread @ begin[:-1, :, None]).reshape(-1, 4)
    # How Q at a point answers to the curvature at the points of its own element, then of those before it.
    turned = (omega @ stage.T).transpose(2, 1, 0)
    by_stage = turned.reshape(pieces, 1, k, 4, 2).swapaxes(2, 3)
    column = half[:, None, None, None, None] * mesh.tableau.matrix[:, None, :, None] * by_stage
    own = inverse @ column.reshape(pieces, 4 * k, 2 * k)
    ending = half[:, None, None, None] * mesh.tableau.weights[:, None] * turned.reshape(pieces, k, 4, 2).swapaxes(1, 2)
    leaving = ending.reshape(pieces, 4, 2 * k) + gather @ own
    slope = np.zeros((pieces, 4 * k, 2 * pieces * k))
    reach = np.zeros((pieces + 1, 4, 2 * pieces * k))
    for e in range(pieces):
        block = slice(2 * e * k, 2 * (e + 1) * k)
        before = slice(0, 2 * e * k)
        slope[e, :, before] = spread[e] @ reach[e, :, before]
        slope[e, :, block] = own[e]
        reach[e + 1, :, before] = carried[e] @ reach[e, :, before]
        reach[e + 1, :, block] = leaving[e]
    return Orientation(begin, stage, rate, inverse, spread, carried, slope.reshape(-1, 4, 2 * pieces * k), reach)


@dataclass(frozen=True, eq=False)
class Adjoint:
    """Derivatives of W, a sum of functions of Q at the points: by the curvature, and by Q at the plate.

    gradient: (N, 2).  mixed: (N, 2, 4) second derivatives by the curvature and by Q, both at the same point.
    base: (4,) dW/dQ at the plate.
    """

    gradient: Array
    mixed: Array
    base: Array


def adjoint(mesh: Mesh, of: Orientation, stage: Array) -> Adjoint:
    """One sweep from the tip to the plate; `stage` (N, 4) are the derivatives of W by Q at the points."""
    pieces, k = len(mesh.length), mesh.tableau.degree
    half, weights = mesh.length / 2, mesh.tableau.weights
    local = stage.reshape(pieces, 4 * k)
    driven = (local[:, None, :] @ of.spread)[:, 0]
    carried = np.zeros((pieces + 1, 4))
    for e in reversed(range(pieces)):
        carried[e] = driven[e] + carried[e + 1] @ of.carried[e]
    pulled = carried[1:, None, None, :] @ of.rate.reshape(pieces, k, 4, 4)
    right = local + (half[:, None, None] * weights[:, None] * pulled[:, :, 0]).reshape(pieces, 4 * k)
    multiplier = (right[:, None, :] @ of.inverse).reshape(pieces, k, 4)
    felt = mesh.tableau.matrix.T @ multiplier + weights[:, None] * carried[1:, None, :]
    felt = (half[:, None, None] * felt).reshape(-1, 4)
    # (N, 2, 4): the first axis of the matrices is summed over.
    mixed = (felt @ quaternion_rates().swapaxes(0, 1).reshape(4, 8)).reshape(-1, 2, 4)
    gradient = (mixed @ of.stage[:, :, None])[:, :, 0]
    return Adjoint(gradient, mixed, carried[0])


def second_derivative(of: Orientation, swept: Adjoint, forms: Array) -> Array:
    """(2 N, 2 N) derivative of the gradient of W by the curvature; `forms` (N, 4, 4) are that by Q at the points."""
    count = len(of.stage)
    size = 2 * count
    bent = (forms @ of.stage_slope).reshape(4 * count, size)
    crossed = (swept.mixed @ of.stage_slope).reshape(size, size)
    out = of.stage_slope.reshape(4 * count, size).T @ bent + crossed
    return np.asarray(out + crossed.T)


def tangents(stage: Array) -> Array:
    """(N, 3) Q' T Q: R e3, of quaternions (N, 4) that need not be normalised."""
    return np.asarray(((stage @ tangent_forms()) * stage).sum(2).T)


def tangent_slopes(stage: Array) -> Array:
    """(N, 3, 4) derivative of `tangents` by Q."""
    return np.asarray(2 * (stage @ tangent_forms()).swapaxes(0, 1))
