"""From the collocated solution to the torsion anywhere along the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...typing import Array
from .collocated import ENDS
from .mesh import Mesh
from .reduced import Evaluation, ReducedProblem


@dataclass(frozen=True, eq=False)
class Profile:
    """theta_i(s) of all tubes as one polynomial per piece.

    With x in [0, 1] along piece p of length h:
    theta = rotation + x h twist + h^2 int int M / kt + h int (g - 1) w.

    With tubes made of pieces, where kt varies: rotation is the elastic phi, `twist` the torque t = kt phi' and `moment`
    M itself. With c the mean of 1 / kt on a piece, phi = rotation + c (x h twist + h^2 int int M) + h int (1 / kt - c)
    t, of which the last is collocated.

    Attributes:
        rotation, twist: (P, n) theta and w where each piece begins.
        moment: (P, K, n) M / kt at the collocation points, 0 on pieces without.
        extra: (P, K, n) (g - 1) w there, or None for concentric tubes.
        slope: (P, K, n) (1 / kt - c) t there, with tubes made of pieces; else None.
        compliance: (P, n) c, with tubes made of pieces; else None.
    """

    rotation: Array
    twist: Array
    moment: Array
    extra: Array | None
    slope: Array | None = None
    compliance: Array | None = None

    def turned(self, h: Array, x: Array, bases: tuple[Array, Array]) -> Array:
        """phi (P, X, n) at fractions x of pieces of lengths h, of tubes made of pieces, by the Lagrange basis (X, K)
        integrated once and twice."""
        assert self.slope is not None
        assert self.compliance is not None
        length = h[:, None, None]
        even = x[:, None] * length * self.twist[:, None, :] + length**2 * (bases[1] @ self.moment)
        return np.asarray(
            self.rotation[:, None, :] + self.compliance[:, None] * even + length * (bases[0] @ self.slope)
        )


def profile(problem: ReducedProblem, rotations: Array, state: Evaluation) -> Profile:
    """theta_i(s) of a solved problem."""
    assembly = problem.assembly
    if problem.here is not None:
        return integrate_torque(problem, rotations, state.moment)
    moment = state.moment / assembly.torsional_stiffness
    return integrate(problem.mesh, rotations, assembly.transmission, moment, state.extra_twist)


def integrate(mesh: Mesh, base: Array, transmission: Array, moment: Array, extra_twist: Array | None = None) -> Profile:
    """Integrate moments M / kt (N, n) from the tip, where torsion is 0, then the twist from the base (n,).

    The columns need not be tubes: derivatives of them, any number, obey the same equations.
    """
    weights, nodes = mesh.tableau.weights, mesh.tableau.nodes
    shape = len(mesh.length), mesh.tableau.degree, len(base)
    inner = np.zeros(shape)
    inner[mesh.collocated] = moment.reshape(-1, *shape[1:])
    h = mesh.length[:, None]
    gain = h * (weights @ inner)
    twist = -np.cumsum(gain[::-1], axis=0)[::-1]
    turn = h * twist + h**2 * ((weights * (1 - nodes)) @ inner)
    extra = None
    if extra_twist is not None:
        extra = np.zeros(shape)
        extra[mesh.collocated] = extra_twist.reshape(-1, *shape[1:])
        turn += h * (weights @ extra)
    start = base + transmission * (twist[0] if len(twist) else 0.0)
    return Profile(start + np.cumsum(turn, axis=0) - turn, twist, inner, extra)


def integrate_torque(problem: ReducedProblem, base: Array, moment: Array) -> Profile:
    """Integrate moments M (N, n) from the tip, where torque is 0, then the elastic rotation from the base (n,)."""
    mesh, here = problem.mesh, problem.here
    assert here is not None
    t, h = mesh.tableau, mesh.length[:, None]
    inner = np.zeros_like(here.rate)
    inner[mesh.collocated] = moment.reshape(-1, *inner.shape[1:])
    gain = h * (t.weights @ inner)
    torque = -np.cumsum(gain[::-1], axis=0)[::-1]
    inside = torque[:, None] + h[..., None] * (t.adjoint @ inner)
    turn = h * (t.weights @ (inside * here.rate))
    mean = np.einsum("k,pki->pi", t.weights, here.rate)
    slope = inside * (here.rate - mean[:, None])
    start = base + here.transmission * (torque[0] if len(torque) else 0.0)
    return Profile(start + np.cumsum(turn, axis=0) - turn, torque, inner, None, slope, mean)


def rotations_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """theta (P, len(x), n), phi with tubes made of pieces, at fractions x of every piece."""
    t, h = problem.mesh.tableau, problem.mesh.length[:, None, None]
    if arm.slope is not None:
        bases = (t.basis(x, 1), t.basis(x, 2))
        return arm.turned(problem.mesh.length, np.array(x), bases)
    theta = arm.rotation[:, None, :] + np.array(x)[:, None] * h * arm.twist[:, None, :]
    theta += h**2 * (t.basis(x, 2) @ arm.moment)
    if arm.extra is not None:
        theta += h * (t.basis(x, 1) @ arm.extra)
    return theta


def torsion_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """theta' (P, len(x), n) at fractions x of every piece, rad/m."""
    t, h = problem.mesh.tableau, problem.mesh.length[:, None, None]
    slope: Array = arm.twist[:, None, :] + h * (t.basis(x, 1) @ arm.moment)
    if arm.extra is not None:
        slope += t.basis(x, 0) @ arm.extra
    return slope


def interpolate(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """theta (len(arc_length), n), phi with tubes made of pieces, at any arc length; constant beyond the ends."""
    mesh = problem.mesh
    if not len(mesh.length):
        return np.tile(arm.rotation.sum(0), (len(arc_length), 1))
    piece = np.clip(np.searchsorted(mesh.start, arc_length, side="right") - 1, 0, len(mesh.start) - 1)
    x = np.clip((arc_length - mesh.start[piece]) / mesh.length[piece], 0.0, 1.0)
    h = mesh.length[piece][:, None]
    if arm.slope is not None:
        assert arm.compliance is not None
        inner = np.einsum("ak,aki->ai", mesh.tableau.lagrange(x, integrals=1), arm.slope[piece])
        even = np.einsum("ak,aki->ai", mesh.tableau.lagrange(x, integrals=2), arm.moment[piece])
        even = arm.compliance[piece] * (x[:, None] * h * arm.twist[piece] + h**2 * even)
        return np.asarray(arm.rotation[piece] + even + h * inner)
    theta = arm.rotation[piece] + x[:, None] * h * arm.twist[piece]
    theta += h**2 * np.einsum("ak,aki->ai", mesh.tableau.lagrange(x, integrals=2), arm.moment[piece])
    if arm.extra is not None:
        theta += h * np.einsum("ak,aki->ai", mesh.tableau.lagrange(x, integrals=1), arm.extra[piece])
    return np.asarray(theta)


def twist_at(problem: ReducedProblem, arm: Profile, s: float) -> Array:
    """w (n,) at arc length s: theta' for concentric tubes, theta' / g in general; torque with tubes made of pieces."""
    mesh = problem.mesh
    n = arm.twist.shape[1]
    if not len(mesh.length) or s >= mesh.start[-1] + mesh.length[-1]:
        return np.zeros(n)
    p = max(0, int(np.searchsorted(mesh.start, s, side="right")) - 1)
    x = (s - mesh.start[p]) / mesh.length[p]
    inner = mesh.tableau.lagrange([x], integrals=1)[0] @ arm.moment[p]
    return np.asarray(arm.twist[p] + mesh.length[p] * inner)


@dataclass(frozen=True, eq=False)
class ArmShape:
    """The whole arm at its m = 1 + STEPS x P shape points: arc_length (m,), rotation (n, m), torsion (n, m),
    curvature (m, 2), position (m, 3), frame (m, 3, 3)."""

    arc_length: Array
    rotation: Array
    torsion: Array
    curvature: Array
    position: Array
    frame: Array


@dataclass(frozen=True, eq=False)
class Arm(ArmShape):
    """The same, and what integration and mesh get wrong.

    Attributes:
        shape_error: estimated error of the tip by the steps of the integration, m.
        defect: largest residual of the integral equation for theta on a finer quadrature, rad.
        energy: elastic energy, J.
    """

    shape_error: float
    defect: float
    energy: float


def arc_lengths(mesh: Mesh) -> Array:
    """(m,) arc length of the shape points, m."""
    inner = mesh.start[:, None] + mesh.length[:, None] * ENDS[1:]
    return np.concatenate([ENDS[:1], inner.ravel()])


def along_pieces(values: Array, pieces: int) -> Array:
    """(m, k) of values (P, 5, k) at the shape points of every piece, of which neighbours share one."""
    table = values.reshape(pieces, len(ENDS), -1)
    return np.concatenate([table[0, :1], table[:, 1:].reshape(-1, table.shape[2])])
