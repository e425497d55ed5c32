"""From the collocated solution to the torsion anywhere along the arm."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ...robots.assembly import Assembly
from ...robots.lengthwise import CrossSections
from ...typing import Array, Index
from . import green
from .buffered import section_function
from .collocated import ENDS
from .mesh import Mesh
from .reduced import Evaluation, ReducedProblem
from .tableau import Tableau


@dataclass(frozen=True, eq=False)
class Profile:
    """theta_i(s) of all tubes as one polynomial per piece: with x in [0, 1] along piece p of length h

    theta = rotation + c (x h torque + h^2 int int moment) + h int extra.

    Where tubes have a natural twist theta is the elastic rotation phi.

    Attributes:
        rotation, torque: (P, n) theta, rad, and t = kt theta' / g, N m, where each piece begins.
        moment: (P, K, n) M at the collocation points, N, 0 on pieces without.
        compliance: (P, n) c, the mean of 1 / kt on a piece.
        extra: (P, K, n) (g / kt - c) t at the points, rad/m.
    """

    rotation: Array
    torque: Array
    moment: Array
    compliance: Array
    extra: Array


def profile(problem: ReducedProblem, rotations: Array, state: Evaluation) -> Profile:
    """theta_i(s) of a solved problem."""
    return integrate(problem, rotations, state.moment, state.extra_twist)


def integrate(problem: ReducedProblem, base: Array, moment: Array, extra_twist: Array | None = None) -> Profile:
    """Integrate moments M (N, n), N, from the tip, where torsion is 0, then the rotation from the base (n,); of tubes
    off the centreline with (g - 1) w (N, n) at the points."""
    mesh, here = problem.mesh, problem.here
    t, h = mesh.tableau, mesh.length[:, None]
    inner = np.zeros((len(h), t.degree, len(base)))
    inner[mesh.collocated] = moment.reshape(-1, *inner.shape[1:])
    gain = h * (t.weights @ inner)
    torque = -np.cumsum(gain[::-1], axis=0)[::-1]
    mean = np.asarray(t.weights @ here.rate)
    extra = (torque[:, None] + h[..., None] * (t.adjoint @ inner)) * (here.rate - mean[:, None])
    if extra_twist is not None:
        extra[mesh.collocated] += extra_twist.reshape(-1, *inner.shape[1:])
    turn = mean * (h * torque + h**2 * ((t.weights * (1 - t.nodes)) @ inner)) + h * (t.weights @ extra)
    start = base + here.transmission * (torque[0] if len(torque) else 0.0)
    return Profile(start + np.cumsum(turn, axis=0) - turn, torque, inner, mean, extra)


def pushed(problem: ReducedProblem, arm: Profile, end: Index, tube: Index, torque: Array) -> Profile:
    """The torsion with torques (R,), N m, on tubes (R,) besides: each turns its tube up to where piece `end` (R,)
    begins."""
    soft = problem.softness[1]
    rotation, twisted, extra = arm.rotation.copy(), arm.torque.copy(), arm.extra.copy()
    for e, i, push in zip(end.tolist(), tube.tolist(), torque.tolist(), strict=True):
        rotation[:, i] += push * np.minimum(soft[:-1, i], soft[e, i])
        twisted[:e, i] += push
        extra[:e, :, i] += push * (problem.here.rate[:e, :, i] - arm.compliance[:e, None, i])
    return replace(arm, rotation=rotation, torque=twisted, extra=extra)


def rotations_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """theta (P, len(x), n) at fractions x of every piece."""
    return turned_along(problem.mesh.tableau, problem.mesh.length, arm, x)


def torques_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """t (P, len(x), n) at fractions x of every piece, N m."""
    mesh = problem.mesh
    return np.asarray(arm.torque[:, None] + mesh.length[:, None, None] * (mesh.tableau.basis(x, 1) @ arm.moment))


def turned_along(t: Tableau, length: Array, arm: Profile, x: tuple[float, ...]) -> Array:
    """`rotations_at` of pieces of lengths (P,), m."""
    h = length[:, None, None]
    even: Array = np.array(x)[:, None] * h * arm.torque[:, None] + h**2 * (t.basis(x, 2) @ arm.moment)
    return arm.rotation[:, None] + arm.compliance[:, None] * even + h * (t.basis(x, 1) @ arm.extra)


def interpolate(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """theta (len(arc_length), n) at any arc length; constant beyond the ends."""
    mesh = problem.mesh
    piece, x = mesh.places(arc_length)
    h = mesh.length[piece][:, None]
    even = x[:, None] * h * arm.torque[piece] + h**2 * mesh.interpolated(arm.moment, arc_length, integrals=2)
    wound = h * mesh.interpolated(arm.extra, arc_length, integrals=1)
    return np.asarray(arm.rotation[piece] + arm.compliance[piece] * even + wound)


def torque_at(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """t (len(arc_length), n) at any arc length, N m."""
    mesh = problem.mesh
    if not len(mesh.length):
        return np.zeros((len(arc_length), arm.torque.shape[1]))
    piece, _ = mesh.places(arc_length)
    torque = arm.torque[piece] + mesh.length[piece][:, None] * mesh.interpolated(arm.moment, arc_length, integrals=1)
    return np.where((arc_length < mesh.start[-1] + mesh.length[-1])[:, None], torque, 0.0)


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections of an arm at X fractions of every piece.

    Attributes:
        elastic, rotation: (P, X, n) theta without and with the natural turn, rad.
        torsion: (P, X, n) slope of the latter, rad/m.
        rate: (P, X, n) g / kt.   moment: (P, X, n) M, N.   curvature: (P, X, 2) without a load, 1/m.
        bending: (P, X) bending energy per length, N.
    """

    elastic: Array
    rotation: Array
    torsion: Array
    rate: Array
    moment: Array
    curvature: Array
    bending: Array

    def part(self, first: int, last: int) -> Sections:
        """At some of the fractions."""
        return Sections(*(table[:, first:last] for table in vars(self).values()))


def sections_along(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Sections:
    """The cross-sections at fractions x of every piece."""
    assembly, theta, here = problem.assembly, rotations_at(problem, arm, x), sections_at(problem, x)
    function = section_function("section", len(here.phase), assembly.n_tubes, assembly.eccentric)
    given = theta.reshape(here.phase.shape) + here.phase, here.stiffness, here.moment, *assembly.place
    moment, stretch, curvature, bending = (part.copy() for part in function(*given))
    rate = (stretch / here.torsional_stiffness).reshape(theta.shape)
    return Sections(
        elastic=theta,
        rotation=theta + here.wound.reshape(theta.shape),
        torsion=rate * torques_at(problem, arm, x) + here.twist.reshape(theta.shape),
        rate=rate,
        moment=moment.reshape(theta.shape),
        curvature=curvature.reshape(*theta.shape[:2], 2),
        bending=bending.reshape(theta.shape[:2]),
    )


@lru_cache(maxsize=64)
def sections_at(problem: ReducedProblem, x: tuple[float, ...]) -> CrossSections:
    """(P X, n) cross-sections at fractions x of every piece, which do not depend on what turns the tubes."""
    return green.sections_at(problem.assembly, problem.mesh, np.array(x))


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


class Between(NamedTuple):
    """Places (S,) between points of an arm."""

    point: Index
    """(S,) the one before."""
    length: Array
    """(S,) from there to the next, m."""
    share: Array
    """(S,) of that length to the place; outside of 0 to 1 beyond the ends."""


def between(s: Array, at: Array) -> Between:
    """Where arc lengths (S,) lie between points (m,), m at least 2."""
    k = np.clip(np.searchsorted(s, at, side="right") - 1, 0, len(s) - 2)
    length = s[k + 1] - s[k]
    return Between(k, length, (at - s[k]) / length)


def arc_lengths(mesh: Mesh) -> Array:
    """(m,) arc length of the shape points, m."""
    inner = mesh.start[:, None] + mesh.length[:, None] * ENDS[1:]
    return np.concatenate([ENDS[:1], inner.ravel()])


def along_pieces(values: Array, pieces: int) -> Array:
    """(m, k) of values (P, 5, k) at the shape points of every piece, of which neighbours share one."""
    table = values.reshape(pieces, len(ENDS), -1)
    return np.concatenate([table[0, :1], table[:, 1:].reshape(-1, table.shape[2])])
