"""From the collocated solution to the torsion anywhere along the arm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...robots.assembly import Assembly
from ...typing import Array, Index
from .collocated import ENDS
from .green import sections_at
from .mesh import Mesh
from .reduced import Evaluation, ReducedProblem
from .tableau import Tableau


@dataclass(frozen=True, eq=False)
class Profile:
    """theta_i(s) of all tubes as one polynomial per piece: with x in [0, 1] along piece p of length h

    theta = rotation + c (x h twist + h^2 int int moment) + h int extra.

    Attributes:
        rotation, twist: (P, n) theta and w where each piece begins.
        moment: (P, K, n) M / kt at the collocation points, 0 on pieces without.
        extra: (P, K, n) (g - 1) w there, or None for concentric tubes.
        compliance: (P, n) c; None is 1.

    With tubes made of pieces, where kt varies, theta is the elastic phi, `twist` the torque t = kt phi', `moment` M
    itself, c the mean of 1 / kt on a piece, and `extra` (1 / kt - c) t.
    """

    rotation: Array
    twist: Array
    moment: Array
    extra: Array | None
    compliance: Array | None = None


def profile(problem: ReducedProblem, rotations: Array, state: Evaluation) -> Profile:
    """theta_i(s) of a solved problem."""
    return integrate(problem, rotations, state.moment, state.extra_twist)


def integrate(problem: ReducedProblem, base: Array, moment: Array, extra_twist: Array | None = None) -> Profile:
    """Integrate moments M (N, n) from the tip, where torsion is 0, then the twist from the base (n,)."""
    mesh, assembly, here = problem.mesh, problem.assembly, problem.here
    t, h = mesh.tableau, mesh.length[:, None]
    inner = np.zeros((len(h), t.degree, len(base)))
    own = moment if assembly.general else moment / assembly.torsional_stiffness
    inner[mesh.collocated] = own.reshape(-1, *inner.shape[1:])
    gain = h * (t.weights @ inner)
    twist = -np.cumsum(gain[::-1], axis=0)[::-1]
    turn = h * twist + h**2 * ((t.weights * (1 - t.nodes)) @ inner)
    held, extra, mean = assembly.transmission, None, None
    if assembly.general:
        held, mean = here.transmission, np.einsum("k,pki->pi", t.weights, here.rate)
        extra = (twist[:, None] + h[..., None] * (t.adjoint @ inner)) * (here.rate - mean[:, None])
        turn *= mean
    elif extra_twist is not None:
        extra = np.zeros_like(inner)
        extra[mesh.collocated] = extra_twist.reshape(-1, *inner.shape[1:])
    if extra is not None:
        turn += h * (t.weights @ extra)
    start = base + held * (twist[0] if len(twist) else 0.0)
    return Profile(start + np.cumsum(turn, axis=0) - turn, twist, inner, extra, mean)


def rotations_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """theta (P, len(x), n), phi with tubes made of pieces, at fractions x of every piece."""
    return turned_along(problem.mesh.tableau, problem.mesh.length, arm, x)


def torsion_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """theta' (P, len(x), n) at fractions x of every piece, rad/m; torque with tubes made of pieces."""
    return twisted_along(problem.mesh.tableau, problem.mesh.length, arm, x)


def turned_along(t: Tableau, length: Array, arm: Profile, x: tuple[float, ...]) -> Array:
    """`rotations_at` of pieces of lengths (P,), m."""
    h = length[:, None, None]
    even: Array = np.array(x)[:, None] * h * arm.twist[:, None] + h**2 * (t.basis(x, 2) @ arm.moment)
    if arm.compliance is not None:
        even *= arm.compliance[:, None]
    if arm.extra is not None:
        even += h * (t.basis(x, 1) @ arm.extra)
    return even + arm.rotation[:, None]


def twisted_along(t: Tableau, length: Array, arm: Profile, x: tuple[float, ...]) -> Array:
    """`torsion_at` of pieces of lengths (P,), m."""
    slope: Array = arm.twist[:, None] + length[:, None, None] * (t.basis(x, 1) @ arm.moment)
    if arm.extra is not None and arm.compliance is None:
        slope += t.basis(x, 0) @ arm.extra
    return slope


def interpolate(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """theta (len(arc_length), n), phi with tubes made of pieces, at any arc length; constant beyond the ends."""
    mesh = problem.mesh
    piece, x = _places(mesh, arc_length)
    h = mesh.length[piece][:, None]
    theta = x[:, None] * h * arm.twist[piece] + h**2 * _inside(mesh, arm.moment, (piece, x), 2)
    if arm.compliance is not None:
        theta *= arm.compliance[piece]
    if arm.extra is not None:
        theta += h * _inside(mesh, arm.extra, (piece, x), 1)
    return np.asarray(theta + arm.rotation[piece])


def twist_at(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """w (len(arc_length), n) at any arc length: theta' for concentric tubes, theta' / g in general; torque with tubes
    made of pieces."""
    mesh = problem.mesh
    if not len(mesh.length):
        return np.zeros((len(arc_length), arm.twist.shape[1]))
    piece, x = _places(mesh, arc_length)
    twist = arm.twist[piece] + mesh.length[piece][:, None] * _inside(mesh, arm.moment, (piece, x), 1)
    return np.where((arc_length < mesh.start[-1] + mesh.length[-1])[:, None], twist, 0.0)


def _places(mesh: Mesh, arc_length: Array) -> tuple[Index, Array]:
    """The pieces in which arc lengths lie, and how far inside, 0 to 1."""
    piece = np.clip(np.searchsorted(mesh.start, arc_length, side="right") - 1, 0, len(mesh.start) - 1)
    return piece, np.clip((arc_length - mesh.start[piece]) / mesh.length[piece], 0.0, 1.0)


def _inside(mesh: Mesh, values: Array, places: tuple[Index, Array], integrals: int) -> Array:
    """(S, n) at places: polynomials through values (P, K, n), integrated from where pieces begin as if of length 1."""
    piece, x = places
    return np.asarray(np.einsum("ak,aki->ai", mesh.tableau.lagrange(x, integrals=integrals), values[piece]))


def tubes_along(torsion: ReducedProblem, profile: Profile) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """theta and theta' (P, 5, n) at the shape points, and what the functions of a cross-section take there."""
    ends, n, here = tuple(ENDS.tolist()), torsion.assembly.n_tubes, sections_at(torsion.assembly, torsion.mesh, ENDS)
    theta, slope = (along(torsion, profile, ends) for along in (rotations_at, torsion_at))
    slope = slope.reshape(-1, n)
    if torsion.assembly.general:
        slope = slope / here.torsional_stiffness
    pull = (theta.reshape(-1, n) + here.phase, here.stiffness, here.moment)
    return theta + here.wound.reshape(theta.shape), (slope + here.twist).reshape(theta.shape), pull


@dataclass(frozen=True, eq=False)
class ArmShape:
    """The whole arm at its m = 1 + STEPS x P shape points."""

    arc_length: Array
    """(m,) m."""
    rotation: Array
    """(n, m) theta_i(s), rad; beyond a tube's end constant."""
    torsion: Array
    """(n, m) its derivative, rad/m; beyond a tube's end 0."""
    curvature: Array
    """(m, 2) curvature vector in the Bishop frame, 1/m."""
    position: Array
    """(m, 3) of the centreline, m."""
    frame: Array
    """(m, 3, 3) its Bishop frame."""


@dataclass(frozen=True, eq=False)
class CollocationPoints:
    """The N collocation points of an equilibrium: where a warm start begins."""

    point: Array
    """(N,) arc length, m."""
    point_rotation: Array
    """(N, n) theta_i of the tubes that are coupled there, rad; their base rotation for the others."""
    point_curvature: Array = field(default_factory=lambda: np.zeros(0))
    """(N, 2) curvature under load, 1/m; empty without one."""


@dataclass(eq=False, slots=True)
class Found:
    """An equilibrium as a solver found it; not frozen, since it is made in every solve."""

    arm: ArmShape
    tip_rotations: Array
    """(n,) theta_i at each tube's own end, rad."""
    section_start: Array
    """(k,) arc length of the breakpoints in front of the plate, m."""
    tube_end: Array
    """(n,) arc length of each tube's end, m."""
    points: CollocationPoints
    margin: float
    energy: float
    """Elastic, J."""
    residual: float
    """Largest violation of the equations, rad."""
    errors: tuple[float, float, float]
    """Estimated, of theta (rad), of the tip (m) and of the margin."""
    iterations: int
    index: int = 0
    """Unstable directions."""
    work: float = 0.0
    """Of dead loads, J."""
    compliance: Array | None = None
    """(6, 6) of the tip; None where nothing tells it yet."""
    base_wrench: Array | None = None
    """(6,) on the plate, likewise."""

    @staticmethod
    def of(arm: ArmShape, assembly: Assembly, **rest: Any) -> Found:
        """That of an arm of tubes that are placed."""
        ends = np.maximum(assembly.end, 0.0)
        tips = arm.rotation[np.arange(len(ends)), np.searchsorted(arm.arc_length, ends - 1e-12)]
        return Found(arm, tips, assembly.start, ends, **rest)


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
