"""From the collocated solution to the whole arm: torsion anywhere, shape, energy, and what the mesh gets wrong."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..mechanics.shape import GAUSS_POINTS
from ..robots.assembly import Array
from .buffered import section_function, shape_steps
from .mesh import Mesh
from .reduced import Evaluation, ReducedProblem
from .tableau import Tableau, tableau

STEPS_PER_PIECE = 6
"""Shape points per piece of the mesh, even, since every second one gives the error estimate."""

EXTRA_POINTS = 3
"""Collocation points by which the error estimate is finer than the solution."""


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


@dataclass(frozen=True, eq=False)
class Shape:
    """Centreline at the m = 1 + STEPS_PER_PIECE x P shape points, and the estimated error of the tip, m."""

    position: Array
    frame: Array
    curvature: Array
    tip_error: float


_STEP_ENDS = tuple(float(x) for x in np.arange(1, STEPS_PER_PIECE + 1) / STEPS_PER_PIECE)


def _gauss(steps: int) -> tuple[float, ...]:
    return tuple(float(x) for x in ((np.arange(steps)[:, None] + GAUSS_POINTS) / steps).ravel())


_FINE, _COARSE = _gauss(STEPS_PER_PIECE), _gauss(STEPS_PER_PIECE // 2)
_WHERE = (0.0, *_STEP_ENDS, *_FINE, *_COARSE)
_HOME = np.r_[np.eye(3).ravel(), np.zeros(3)]


def shape(problem: ReducedProblem, arm: Profile) -> Shape:
    """Integrate the shape, twice: with all steps, and with half of them for the error estimate."""
    assembly, mesh = problem.assembly, problem.mesh
    pieces, n = len(mesh.length), assembly.n_tubes
    if not pieces:
        return Shape(np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 2)), 0.0)
    theta = rotations_at(problem, arm, _WHERE)
    count = len(_WHERE)
    stiffness = np.repeat((assembly.bending_stiffness * assembly.present)[mesh.section], count, axis=0)
    moment = np.repeat(
        (assembly.bending_stiffness * assembly.curvature * assembly.curved)[mesh.section], count, axis=0
    )
    place = (assembly.offset, assembly.offset_angle) if assembly.eccentric else ()
    function = section_function("curvature", pieces * count, n, assembly.eccentric)
    u = function(theta.reshape(-1, n), stiffness, moment, *place)[0].reshape(pieces, count, 2)
    ends, fine, coarse = np.split(u, [1 + STEPS_PER_PIECE, 1 + STEPS_PER_PIECE + len(_FINE)], axis=1)
    poses = _poses(fine, mesh.length, STEPS_PER_PIECE)
    rough = _poses(coarse, mesh.length, STEPS_PER_PIECE // 2)
    return Shape(
        position=poses[:, 9:],
        frame=poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2),
        curvature=np.concatenate([ends[0, :1], ends[:, 1:].reshape(-1, 2)]),
        # Order 6: halving the steps divides the error by 2^6.
        tip_error=float(np.abs(poses[-1, 9:] - rough[-1, 9:]).max()) / 63,
    )


def _poses(u: Array, length: Array, steps: int) -> Array:
    """(1 + P steps, 12) poses, R by columns, then p."""
    function = shape_steps(len(length) * steps)
    out = function(_HOME, u.reshape(-1, 6), np.repeat(length / steps, steps)[:, None])[0]
    return np.concatenate([_HOME[None], out])


def arc_lengths(problem: ReducedProblem) -> Array:
    """(m,) arc length of the shape points, m."""
    mesh = problem.mesh
    inner = mesh.start[:, None] + mesh.length[:, None] * np.array(_STEP_ENDS)
    return np.concatenate([[0.0], inner.ravel()])


def along(values: Array) -> Array:
    """(n, m) of values (P, 1 + STEPS_PER_PIECE, n) at the beginning and the step ends of every piece."""
    return np.concatenate([values[0, :1], values[:, 1:].reshape(-1, values.shape[2])]).T


def end_points() -> tuple[float, ...]:
    """Fractions of a piece at which its shape points lie, its beginning included."""
    return (0.0, *_STEP_ENDS)


def elastic_energy(problem: ReducedProblem, arm: Profile, state: Evaluation) -> float:
    """Bending and torsion in front of the plate, and torsion of the transmissions, J."""
    assembly, mesh = problem.assembly, problem.mesh
    free = ~mesh.collocated
    energy = state.energy
    if free.any():
        section = mesh.section[free]
        kb = assembly.bending_stiffness * assembly.present[section]
        m = kb * assembly.curvature * assembly.curved[section]
        # At most one tube is curved: sum m^2 / kb - m^2 / sum kb, whatever the rotations.
        own = (m**2 / np.where(kb > 0, kb, 1)).sum(1)
        energy += float(mesh.length[free] @ (own - (m**2).sum(1) / kb.sum(1))) / 2
    if assembly.eccentric:
        energy += _eccentric_torsion(problem, arm) - 0.5 * float(state.z @ state.z)
    return energy


def _eccentric_torsion(problem: ReducedProblem, arm: Profile) -> float:
    """int kt g w^2 / 2 with g w^2 = w (w + (g - 1) w), and the transmissions."""
    mesh, kt = problem.mesh, problem.assembly.torsional_stiffness
    w = arm.twist[:, None, :] + mesh.length[:, None, None] * (mesh.tableau.matrix @ arm.moment)
    slope = w + arm.extra if arm.extra is not None else w
    inside = np.einsum("p,k,i,pki,pki->", mesh.length, mesh.tableau.weights, kt, w, slope)
    base = arm.twist[0] if len(arm.twist) else np.zeros(len(kt))
    return 0.5 * float(inside + kt @ (problem.assembly.transmission * base**2))


def rotation_error(problem: ReducedProblem, rotations: Array, arm: Profile, margin: float) -> float:
    """Estimated largest error of theta, rad: the integral equation on a finer quadrature, divided by the margin,
    by which its inverse can amplify a defect."""
    mesh, assembly = problem.mesh, problem.assembly
    if not problem.size:
        return 0.0
    fine: Tableau = tableau("gauss", mesh.tableau.degree + EXTRA_POINTS)
    x = tuple(fine.nodes.tolist())
    theta = rotations_at(problem, arm, x)
    section = np.repeat(mesh.section[mesh.collocated], fine.degree)
    place = (assembly.offset, assembly.offset_angle) if assembly.eccentric else ()
    stiffness = (assembly.bending_stiffness * assembly.present)[section]
    natural = (assembly.bending_stiffness * assembly.curvature * assembly.curved)[section]
    moments = section_function("moment", len(section), assembly.n_tubes, assembly.eccentric)
    out = moments(theta[mesh.collocated].reshape(-1, assembly.n_tubes), stiffness, natural, *place)
    kt, h = assembly.torsional_stiffness, mesh.length[:, None, None]
    moment = np.zeros_like(theta)
    moment[mesh.collocated] = (out[0] / kt).reshape(-1, fine.degree, assembly.n_tubes)
    gain = h[:, 0] * (fine.weights @ moment)
    twist = -np.cumsum(gain[::-1], axis=0)[::-1]
    slope = twist[:, None, :] + h * (fine.matrix @ moment)
    if assembly.eccentric:
        slope[mesh.collocated] *= out[1].reshape(-1, fine.degree, assembly.n_tubes)
    turn = h[:, 0] * (fine.weights @ slope)
    start = rotations + assembly.transmission * twist[0] + np.cumsum(turn, axis=0) - turn
    defect = start[:, None, :] + h * (fine.matrix @ slope) - theta
    return float(np.abs(defect).max()) / max(min(1.0, abs(margin)), 1e-6)
