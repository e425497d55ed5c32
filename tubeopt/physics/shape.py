"""Shape of an arm from its curvature: a Magnus integrator of order 6 on SE(3).

The pose T = (R, p) of the Bishop frame obeys T' = T xi with the twist xi = (u_x, u_y, 0; 0, 0, 1). Each step is the
exponential of the Magnus series at three Gauss points (Iserles, Munthe-Kaas, Norsett, Zanna, Acta Numerica 9 (2000);
Blanes, Casas, Oteo, Ros, Phys. Rep. 470 (2009), eq. (257), here for right multiplication), exact for an arc of constant
curvature.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

SERIES_TERMS = 9
"""Terms of the exponential series: for a rotation of 2 rad the first omitted one is 4^9 / 20! = 1e-13."""

GAUSS_POINTS = np.array([0.5 - np.sqrt(15) / 10, 0.5, 0.5 + np.sqrt(15) / 10])
"""Gauss points of a step of length 1."""


def _bracket(a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
    """Negative Lie bracket of two twists (omega, v), since the pose is multiplied from the right."""
    return ca.cross(b[0], a[0]), ca.cross(b[0], a[1]) + ca.cross(b[1], a[0])


def _combine(*terms: tuple[float, tuple[Any, Any]]) -> tuple[Any, Any]:
    """Linear combination of twists, from pairs (coefficient, twist)."""
    return sum(c * t[0] for c, t in terms), sum(c * t[1] for c, t in terms)


def exponential(omega: Any, v: Any) -> tuple[Any, Any]:
    """Exponential (R, p) of a twist of at most 2 rad, to round-off.

    (1 - cos x) / x^2 and (x - sin x) / x^3 are power series, which have no cancellation and no branch.
    """
    x = ca.dot(omega, omega)
    b, c = _series(x, 2), _series(x, 3)
    # R = 1 + sin(t) / t [w] + b [w]^2 and p = v + b [w] v + c [w]^2 v, with sin(t) / t = 1 - t^2 c.
    hat = ca.skew(omega)
    square = hat @ hat
    return ca.DM.eye(3) + (1 - x * c) * hat + b * square, v + b * (hat @ v) + c * (square @ v)


def _series(x: Any, k: int) -> Any:
    """Series sum_j (-x)^j / (2 j + k)!, by Horner's rule."""
    total: Any = 0.0
    for j in reversed(range(SERIES_TERMS)):
        total = 1.0 / math.factorial(2 * j + k) - x * total
    return total


def _magnus(curvature: Any, length: Any) -> tuple[Any, Any]:
    """Twist (omega, v) of a step of `length`, m, with `curvature` (2, 3), 1/m, at the three GAUSS_POINTS."""
    twist = [(ca.vertcat(curvature[:, k], 0), ca.vertcat(0, 0, 1)) for k in range(3)]
    # Taylor coefficients about the middle: a_k = h^k xi^(k - 1) / (k - 1)!, by differences.
    a1 = _combine((length, twist[1]))
    a2 = _combine((np.sqrt(15) / 3 * length, twist[2]), (-np.sqrt(15) / 3 * length, twist[0]))
    a3 = _combine((10 / 3 * length, twist[2]), (-20 / 3 * length, twist[1]), (10 / 3 * length, twist[0]))
    c1 = _bracket(a1, a2)
    c2 = _combine((-1 / 60, _bracket(a1, _combine((2, a3), (1, c1)))))
    # Omega = a_1 + a_3 / 12 + [-20 a_1 - a_3 + C_1, a_2 + C_2] / 240, with three brackets for order 6.
    last = _bracket(_combine((-20, a1), (-1, a3), (1, c1)), _combine((1, a2), (1, c2)))
    return _combine((1, a1), (1 / 12, a3), (1 / 240, last))


def magnus_step(rotation: Any, position: Any, curvature: Any, length: Any) -> tuple[Any, Any]:
    """Pose after a step of `length`, m, with `curvature` (2, 3), 1/m, at the three GAUSS_POINTS."""
    rotation_step, shift = exponential(*_magnus(curvature, length))
    return rotation @ rotation_step, position + rotation @ shift


def magnus_quaternion(quaternion: Any, position: Any, curvature: Any, length: Any) -> tuple[Any, Any]:
    """`magnus_step` of a pose with a unit quaternion (4,), scalar first; the step preserves its norm.

    The state has 7 numbers instead of 12. The arguments are `SX` symbols, since a cached function is expanded.
    """
    rotated, moved = _quaternion_step().call([quaternion, position, curvature, length])
    return rotated, moved


@lru_cache(maxsize=1)
def _quaternion_step() -> ca.Function:
    quaternion, position = ca.SX.sym("q", 4), ca.SX.sym("p", 3)
    curvature, length = ca.SX.sym("u", 2, 3), ca.SX.sym("h")
    omega, v = _magnus(curvature, length)
    # (cos(t / 2), sin(t / 2) w / t) as series in t^2 / 4: no branch at t = 0.
    quarter = ca.dot(omega, omega) / 4
    step = ca.vertcat(_series(quarter, 0), _series(quarter, 1) * omega / 2)
    _, shift = exponential(omega, v)
    ends = [quaternion_product(quaternion, step), position + rotation_matrix(quaternion) @ shift]
    return ca.Function("quaternion_step", [quaternion, position, curvature, length], ends)


def quaternion_product(a: Any, b: Any) -> Any:
    """Product a b of quaternions (4,), scalar first."""
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:], b[1:]), a[0] * b[1:] + b[0] * a[1:] + ca.cross(a[1:], b[1:]))


def rotation_matrix(quaternion: Any) -> Any:
    """Rotation matrix (3, 3) of a unit quaternion (4,), scalar first."""
    w, v = quaternion[0], quaternion[1:]
    return (w**2 - ca.dot(v, v)) * ca.DM.eye(3) + 2 * v @ v.T + 2 * w * ca.skew(v)


@lru_cache(maxsize=1)
def quaternion_rates() -> NDArray[np.float64]:
    """Matrices Omega (2, 4, 4) of the rate of the quaternion Q of the Bishop frame.

    Q' = (u_x Omega_x + u_y Omega_y) Q / 2.
    """
    q, u = ca.SX.sym("q", 4), ca.SX.sym("u", 2)
    # u has components in the moving frame, so it multiplies from the right: Q' = Q (0, u) / 2.
    product = quaternion_product(q, ca.vertcat(0, u, 0))
    return np.array([ca.evalf(ca.jacobian(ca.jacobian(product, u)[:, j], q)).full() for j in range(2)])


@lru_cache(maxsize=1)
def frame_forms() -> NDArray[np.float64]:
    """Symmetric matrices T (3, 3, 4, 4) with R_ij = Q' T_ij Q for the frame R of a unit quaternion Q."""
    q = ca.SX.sym("q", 4)
    # R_ij is quadratic in Q: half of its Hessian is the matrix of the form.
    frame = rotation_matrix(q)
    return np.array([[ca.evalf(ca.hessian(frame[i, j], q)[0]).full() / 2 for j in range(3)] for i in range(3)])


@lru_cache(maxsize=1)
def tangent_forms() -> NDArray[np.float64]:
    """Symmetric matrices T (3, 4, 4) with the tangent (R e3)_i = Q' T_i Q of a unit quaternion Q."""
    return frame_forms()[:, 2].copy()


@lru_cache(maxsize=1)
def world_turns() -> NDArray[np.float64]:
    """Matrices Z (3, 4, 4) of rotations about world axes: dpsi_i = 2 (Z_i Q)' dQ for a unit quaternion Q."""
    q, e = ca.SX.sym("q", 4), ca.SX.sym("e", 3)
    # World axes multiply from the left: dQ = (0, dpsi) Q / 2, and the Z_i Q are orthonormal.
    product = quaternion_product(ca.vertcat(0, e), q)
    return np.array([ca.evalf(ca.jacobian(ca.jacobian(product, e)[:, i], q)).full() for i in range(3)])


@lru_cache(maxsize=1)
def rotation_matrix_function() -> ca.Function:
    """Function from a unit quaternion (4,) to the rotation matrix (3, 3)."""
    q = ca.SX.sym("q", 4)
    return ca.Function("rotation_matrix", [q], [ca.densify(rotation_matrix(q))])


@lru_cache(maxsize=1)
def carry_function() -> ca.Function:
    """Function (pose (12,), u (6,), h) -> pose after a step of length h.

    A pose is R by columns and p; u are the curvatures (u_x, u_y) at the three GAUSS_POINTS, one after the other.
    """
    pose, u, h = ca.SX.sym("pose", 12), ca.SX.sym("u", 6), ca.SX.sym("h")
    rotation, position = magnus_step(ca.reshape(pose[:9], 3, 3), pose[9:], ca.reshape(u, 2, 3), h)
    return ca.Function("carry", [pose, u, h], [ca.vertcat(ca.vec(rotation), position)], {"cse": True})


# --- Cross products ---------------------------------------------------------------------------------------------------

HAT = np.array([[0.0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]])
"""Matrix (3, 9) from a to the matrix of b -> a x b, by rows."""


def hat(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrices (..., 3, 3) of b -> a x b, of vectors a (..., 3)."""
    return np.asarray((a @ HAT).reshape(*a.shape, 3))


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross product (..., 3) of vectors."""
    return np.asarray((hat(a) @ b[..., None])[..., 0])
