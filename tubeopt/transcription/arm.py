"""From the collocated solution to the whole arm: torsion anywhere, shape, energy, and what the mesh gets wrong."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..typing import Array
from .buffered import piece_chain
from .mesh import Mesh
from .piece import COARSE_STEPS, ENDS, STEPS
from .reduced import Evaluation, ReducedProblem
from .tableau import tableau


@dataclass(frozen=True, eq=False)
class Profile:
    """theta_i(s) of all tubes as one polynomial per piece.

    With x in [0, 1] along piece p of length h:
    theta = rotation + x h twist + h^2 int int M / kt + h int (g - 1) w.

    Attributes:
        rotation, twist: (P, n) theta and w where each piece begins.
        moment: (P, K, n) M / kt at the collocation points, 0 on pieces without.
        extra: (P, K, n) (g - 1) w there, or None for concentric tubes.
    """

    rotation: Array
    twist: Array
    moment: Array
    extra: Array | None


def profile(problem: ReducedProblem, rotations: Array, state: Evaluation) -> Profile:
    """theta_i(s) of a solved problem."""
    assembly = problem.assembly
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


@lru_cache(maxsize=64)
def _basis(points: tuple[float, ...], family: str, degree: int, integrals: int) -> Array:
    return tableau(family, degree).lagrange(points, integrals=integrals)


def rotations_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """theta (P, len(x), n) at fractions x of every piece."""
    t, h = problem.mesh.tableau, problem.mesh.length[:, None, None]
    theta = arm.rotation[:, None, :] + np.array(x)[:, None] * h * arm.twist[:, None, :]
    theta += h**2 * (_basis(x, t.family, t.degree, 2) @ arm.moment)
    if arm.extra is not None:
        theta += h * (_basis(x, t.family, t.degree, 1) @ arm.extra)
    return theta


def torsion_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """theta' (P, len(x), n) at fractions x of every piece, rad/m."""
    t, h = problem.mesh.tableau, problem.mesh.length[:, None, None]
    slope: Array = arm.twist[:, None, :] + h * (_basis(x, t.family, t.degree, 1) @ arm.moment)
    if arm.extra is not None:
        slope += _basis(x, t.family, t.degree, 0) @ arm.extra
    return slope


def interpolate(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """theta (len(arc_length), n) at any arc length; constant beyond the ends."""
    mesh = problem.mesh
    if not len(mesh.length):
        return np.tile(arm.rotation.sum(0), (len(arc_length), 1))
    piece = np.clip(np.searchsorted(mesh.start, arc_length, side="right") - 1, 0, len(mesh.start) - 1)
    x = np.clip((arc_length - mesh.start[piece]) / mesh.length[piece], 0.0, 1.0)
    h = mesh.length[piece][:, None]
    theta = arm.rotation[piece] + x[:, None] * h * arm.twist[piece]
    theta += h**2 * np.einsum("ak,aki->ai", mesh.tableau.lagrange(x, integrals=2), arm.moment[piece])
    if arm.extra is not None:
        theta += h * np.einsum("ak,aki->ai", mesh.tableau.lagrange(x, integrals=1), arm.extra[piece])
    return np.asarray(theta)


def twist_at(problem: ReducedProblem, arm: Profile, s: float) -> Array:
    """w (n,) at arc length s: theta' for concentric tubes, theta' / g in general."""
    mesh = problem.mesh
    n = arm.twist.shape[1]
    if not len(mesh.length) or s >= mesh.start[-1] + mesh.length[-1]:
        return np.zeros(n)
    p = max(0, int(np.searchsorted(mesh.start, s, side="right")) - 1)
    x = (s - mesh.start[p]) / mesh.length[p]
    inner = mesh.tableau.lagrange([x], integrals=1)[0] @ arm.moment[p]
    return np.asarray(arm.twist[p] + mesh.length[p] * inner)


@dataclass(frozen=True, eq=False)
class Arm:
    """The whole arm at its m = 1 + STEPS x P shape points, and what integration and mesh get wrong.

    Attributes:
        arc_length (m,), rotation (n, m), torsion (n, m), curvature (m, 2), position (m, 3), frame (m, 3, 3).
        shape_error: estimated error of the tip by the steps of the integration, m.
        defect: largest residual of the integral equation for theta on a finer quadrature, rad.
        energy: elastic energy, J.
    """

    arc_length: Array
    rotation: Array
    torsion: Array
    curvature: Array
    position: Array
    frame: Array
    shape_error: float
    defect: float
    energy: float


_HOME = np.tile(np.concatenate([np.eye(3).ravel(), np.zeros(3)]), 2)


def evaluate_arm(problem: ReducedProblem, rotations: Array, state: Evaluation, torsion: Profile) -> Arm:
    """Everything along the arm, from the solved state and its torsion profile."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    pieces = len(mesh.length)
    if not pieces:
        still, zero = rotations[:, None].copy(), np.zeros((1, 3))
        return Arm(np.zeros(1), still, np.zeros((n, 1)), zero[:, :2], zero, np.eye(3)[None], 0.0, 0.0, 0.0)
    eccentric, t = problem.assembly.eccentric, mesh.tableau
    chain = piece_chain(pieces, n, eccentric, t.family, t.degree)
    given = [_HOME, torsion.rotation, torsion.twist, torsion.moment.reshape(-1, n)]
    given += [problem.piece_stiffness, problem.piece_moment]
    given += [problem.assembly.torsional_stiffness, mesh.length[:, None]]
    if eccentric:
        assert torsion.extra is not None
        given += [torsion.extra.reshape(-1, n), problem.assembly.offset, problem.assembly.offset_angle]
    end, theta, slope, u, poses, defects, bending = chain(*given)
    return Arm(
        arc_length=arc_lengths(mesh),
        rotation=_along(theta, pieces).T,
        torsion=_along(slope, pieces).T,
        curvature=_along(u, pieces),
        position=np.concatenate([_HOME[None, 9:12], poses[:, 9:]]),
        frame=np.concatenate([np.eye(3)[None], poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)]),
        # Order 6: steps half as long divide the error by 2^6.
        shape_error=float(np.linalg.norm(end[-1, 9:12] - end[-1, 21:])) / ((STEPS / COARSE_STEPS) ** 6 - 1),
        defect=_defect(problem, defects.reshape(pieces, 2, n)) if problem.size else 0.0,
        energy=_energy(problem, torsion, state, bending[:, 0]),
    )


def arc_lengths(mesh: Mesh) -> Array:
    """(m,) arc length of the shape points, m."""
    inner = mesh.start[:, None] + mesh.length[:, None] * ENDS[1:]
    return np.concatenate([ENDS[:1], inner.ravel()])


def _along(values: Array, pieces: int) -> Array:
    """(m, k) of values (P x 5, k) at the shape points of every piece, of which neighbours share one."""
    table = values.reshape(pieces, len(ENDS), -1)
    return np.concatenate([table[0, :1], table[:, 1:].reshape(-1, values.shape[1])])


def _energy(problem: ReducedProblem, torsion: Profile, state: Evaluation, bending: Array) -> float:
    """Bending and torsion in front of the plate, and torsion of the transmissions, J."""
    mesh = problem.mesh
    # Where at most one tube is curved, bending does not depend on the rotations: one point tells it.
    energy = state.energy + float(mesh.length @ (bending * ~mesh.collocated))
    if problem.assembly.eccentric:
        energy += _eccentric_torsion(problem, torsion) - 0.5 * float(state.z @ state.z)
    return energy


def _eccentric_torsion(problem: ReducedProblem, torsion: Profile) -> float:
    """int kt g w^2 / 2 with g w^2 = w (w + (g - 1) w), and the transmissions."""
    mesh, kt = problem.mesh, problem.assembly.torsional_stiffness
    w = torsion.twist[:, None, :] + mesh.length[:, None, None] * (mesh.tableau.matrix @ torsion.moment)
    slope = w if torsion.extra is None else w + torsion.extra
    inside = np.einsum("p,k,i,pki,pki->", mesh.length, mesh.tableau.weights, kt, w, slope)
    return 0.5 * float(inside + kt @ (problem.assembly.transmission * torsion.twist[0] ** 2))


def _defect(problem: ReducedProblem, defects: Array) -> float:
    """Bound of what the defects (P, 2, n) of all pieces change in theta: inside each, and by a twist w gained too much,
    which turns all that lies nearer to the base."""
    mesh = problem.mesh
    lever = problem.assembly.transmission + (mesh.start + mesh.length)[:, None]
    wrong = (defects[:, 0] + defects[:, 1] * lever)[mesh.collocated]
    return float(wrong.sum(0).max())
