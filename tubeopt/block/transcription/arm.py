"""The arm of a collocated solution: torsion at any arc length, shape, energy, and errors of mesh and integration."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...physics.shape import GAUSS_POINTS, HAT, carry_function
from ...robots.assembly import Assembly
from ...robots.lengthwise import CrossSections
from ...typing import Array, Index
from . import mesh as meshes
from .buffered import chained, section_function
from .collocated import ENDS, SHAPE_STEPS
from .mesh import INWARDS, Mesh, reach
from .reduced import Evaluation, ReducedProblem
from .tableau import Tableau, tableau


@dataclass(frozen=True, eq=False)
class Profile:
    """Rotations theta_i(s) of all tubes as one polynomial per element.

    With x in [0, 1] along element p of length h

    theta = rotation + c (x h torque + h^2 int int moment) + h int extra.

    For tubes with natural twist theta is the elastic rotation phi.

    Attributes:
        rotation, torque: theta, rad, and t = kt theta' / g, N m, where each element begins, (P, n).
        moment: M (P, K, n) at the collocation points, N, 0 on elements without.
        compliance: c (P, n), the mean of 1 / kt on an element, 1/(N m^2).
        extra: (g / kt - c) t (P, K, n) at the points, rad/m.
    """

    rotation: Array
    torque: Array
    moment: Array
    compliance: Array
    extra: Array


def profile(problem: ReducedProblem, rotations: Array, state: Evaluation) -> Profile:
    """Torsion along the arm of a solved problem."""
    return integrate(problem, rotations, state.moment, state.extra_twist)


def integrate(problem: ReducedProblem, base: Array, moment: Array, extra_twist: Array | None = None) -> Profile:
    """Torsion along the arm: moments integrated from the tip, then rotations from the base.

    Args:
        base: rotations (n,) at the clamps, rad.  moment: M (N, n) at the points, N.
        extra_twist: (g - 1) w (N, n) of eccentric tubes at the points, rad/m.
    """
    mesh, points = problem.mesh, problem.compliant
    t, h = mesh.tableau, mesh.length[:, None]
    inner = np.zeros((len(h), t.degree, len(base)))
    inner[mesh.collocated] = moment.reshape(-1, *inner.shape[1:])
    gain = h * (t.weights @ inner)
    # t = 0 at the tip and t' = M: t where an element begins is minus the integral of M from there to the tip.
    torque = -np.cumsum(gain[::-1], axis=0)[::-1]
    mean = np.asarray(t.weights @ points.rate)
    extra = (torque[:, None] + h[..., None] * (t.adjoint @ inner)) * (points.rate - mean[:, None])
    if extra_twist is not None:
        extra[mesh.collocated] += extra_twist.reshape(-1, *inner.shape[1:])
    # Integrated twice, int_0^1 (1 - x) M dx: a moment at x twists only the part beyond it.
    turn = mean * (h * torque + h**2 * ((t.weights * (1 - t.nodes)) @ inner)) + h * (t.weights @ extra)
    start = base + points.transmission * (torque[0] if len(torque) else 0.0)
    return Profile(start + np.cumsum(turn, axis=0) - turn, torque, inner, mean, extra)


def pushed(problem: ReducedProblem, arm: Profile, end: Index, tube: Index, torque: Array) -> Profile:
    """Torsion with additional torques (R,), N m, each on a tube (R,) at the start of an element `end` (R,)."""
    soft = problem.softness[1]
    rotation, twisted, extra = arm.rotation.copy(), arm.torque.copy(), arm.extra.copy()
    for e, i, push in zip(end.tolist(), tube.tolist(), torque.tolist(), strict=True):
        # A torque turns every point by int ds / kt up to the nearer of the point and where it acts.
        rotation[:, i] += push * np.minimum(soft[:-1, i], soft[e, i])
        twisted[:e, i] += push
        extra[:e, :, i] += push * (problem.compliant.rate[:e, :, i] - arm.compliance[:e, None, i])
    return replace(arm, rotation=rotation, torque=twisted, extra=extra)


def rotations_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """Rotations theta (P, len(x), n) at fractions x of every element, rad."""
    return turned_along(problem.mesh.tableau, problem.mesh.length, arm, x)


def torques_at(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Array:
    """Torques t (P, len(x), n) at fractions x of every element, N m."""
    mesh = problem.mesh
    return np.asarray(arm.torque[:, None] + mesh.length[:, None, None] * (mesh.tableau.basis(x, 1) @ arm.moment))


def turned_along(t: Tableau, length: Array, arm: Profile, x: tuple[float, ...]) -> Array:
    """Rotations theta (P, len(x), n) at fractions x of elements of lengths (P,), m, from the torques along them."""
    h = length[:, None, None]
    even: Array = np.array(x)[:, None] * h * arm.torque[:, None] + h**2 * (t.basis(x, 2) @ arm.moment)
    return arm.rotation[:, None] + arm.compliance[:, None] * even + h * (t.basis(x, 1) @ arm.extra)


def interpolate(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """Rotations theta (S, n) at arc lengths (S,), rad; constant beyond the ends."""
    mesh = problem.mesh
    element, x = mesh.locate(arc_length)
    h = mesh.length[element][:, None]
    even = x[:, None] * h * arm.torque[element] + h**2 * mesh.interpolated(arm.moment, arc_length, integrals=2)
    twist_angle = h * mesh.interpolated(arm.extra, arc_length, integrals=1)
    return np.asarray(arm.rotation[element] + arm.compliance[element] * even + twist_angle)


def torque_at(problem: ReducedProblem, arm: Profile, arc_length: Array) -> Array:
    """Torques t (S, n) at arc lengths (S,), N m; 0 beyond the tip."""
    mesh = problem.mesh
    if not len(mesh.length):
        return np.zeros((len(arc_length), arm.torque.shape[1]))
    element, _ = mesh.locate(arc_length)
    torque = arm.torque[element] + mesh.length[element][:, None] * mesh.interpolated(
        arm.moment, arc_length, integrals=1
    )
    return np.where((arc_length < mesh.start[-1] + mesh.length[-1])[:, None], torque, 0.0)


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections of an arm at X fractions of every element.

    Attributes:
        elastic, rotation: theta (P, X, n) without and with the natural turn, rad.
        torsion: derivative (P, X, n) of `rotation`, rad/m.
        rate: g / kt (P, X, n).   moment: M (P, X, n), N.   curvature: (P, X, 2) without a load, 1/m.
        bending: bending energy (P, X) per length, N.
    """

    elastic: Array
    rotation: Array
    torsion: Array
    rate: Array
    moment: Array
    curvature: Array
    bending: Array

    def part(self, first: int, last: int) -> Sections:
        """Cross-sections at the fractions from number `first` up to `last`."""
        return Sections(*(table[:, first:last] for table in vars(self).values()))


def sections_along(problem: ReducedProblem, arm: Profile, x: tuple[float, ...]) -> Sections:
    """Cross-sections at fractions x of every element."""
    assembly, theta, points = problem.assembly, rotations_at(problem, arm, x), sections_at(problem, x)
    function = section_function("section", len(points.phase), assembly.n_tubes, assembly.eccentric)
    inputs = theta.reshape(points.phase.shape) + points.phase, points.stiffness, points.moment, *assembly.offsets
    moment, stretch, curvature, bending = (part.copy() for part in function(*inputs))
    rate = (stretch / points.torsional_stiffness).reshape(theta.shape)
    return Sections(
        elastic=theta,
        rotation=theta + points.twist_angle.reshape(theta.shape),
        torsion=rate * torques_at(problem, arm, x) + points.twist.reshape(theta.shape),
        rate=rate,
        moment=moment.reshape(theta.shape),
        curvature=curvature.reshape(*theta.shape[:2], 2),
        bending=bending.reshape(theta.shape[:2]),
    )


@lru_cache(maxsize=64)
def sections_at(problem: ReducedProblem, x: tuple[float, ...]) -> CrossSections:
    """Cross-sections (P X, n) at fractions x of every element; they are independent of the rotations."""
    return meshes.sections_at(problem.assembly, problem.mesh, np.array(x))


@dataclass(frozen=True, eq=False)
class ArmShape:
    """Shape of an arm at its m = 1 + SHAPE_STEPS x P shape points."""

    arc_length: Array
    """Arc lengths (m,), m."""
    rotation: Array
    """Rotations theta (n, m) of the tubes, rad; constant beyond the end of a tube."""
    torsion: Array
    """Derivative (n, m) of the rotations, rad/m; 0 beyond the end of a tube."""
    curvature: Array
    """Curvature (m, 2) in the Bishop frame, 1/m."""
    position: Array
    """Positions (m, 3) of the centreline, m."""
    frame: Array
    """Bishop frames (m, 3, 3)."""


@dataclass(frozen=True, eq=False)
class CollocationPoints:
    """The N collocation points of an equilibrium, the start of a warm solve."""

    point: Array
    """Arc lengths (N,), m."""
    point_rotation: Array
    """Rotations theta (N, n) of the tubes coupled at the points, rad; base rotations of the others."""
    point_curvature: Array = field(default_factory=lambda: np.zeros(0))
    """Curvature (N, 2) under load, 1/m; empty without a load."""


class Errors(NamedTuple):
    """Estimated discretisation errors of a solved point."""

    theta: float
    """Largest error of a rotation, rad."""
    tip: float
    """Error of the tip position, m."""
    margin: float


@dataclass(eq=False, slots=True)
class ArmSolution:
    """Result of a solver; not frozen, since one is created in every solve."""

    arm: ArmShape
    tip_rotations: Array
    """Rotations theta (n,) at the end of each tube, rad."""
    section_start: Array
    """Arc lengths (k,) of the breakpoints in front of the plate, m."""
    tube_end: Array
    """Arc lengths (n,) of the ends of the tubes, m."""
    points: CollocationPoints
    margin: float
    energy: float
    """Elastic energy, J."""
    residual: float
    """Largest violation of the equations, rad."""
    errors: Errors
    iterations: int
    index: int = 0
    """Number of unstable directions."""
    work: float = 0.0
    """Work of dead loads, J."""
    compliance: Array | None = None
    """Compliance (6, 6) of the tip; None if it is not computed yet."""
    base_wrench: Array | None = None
    """Force and moment (6,) on the plate; None if not computed yet."""

    @staticmethod
    def of(arm: ArmShape, assembly: Assembly, **results: Any) -> ArmSolution:
        """Solution with the shape of an arm and further results."""
        ends = np.maximum(assembly.end, 0.0)
        tips = arm.rotation[np.arange(len(ends)), np.searchsorted(arm.arc_length, ends - 1e-12)]
        return ArmSolution(arm, tips, assembly.start, ends, **results)


@dataclass(frozen=True, eq=False)
class Arm(ArmShape):
    """Shape of an arm, with the errors of integration and mesh.

    Attributes:
        shape_error: estimated error of the tip by the steps of the integration, m.
        defect: defect of the equation for theta on a finer quadrature, largest sum along a tube, rad.
        energy: elastic energy, J.
    """

    shape_error: float
    defect: float
    energy: float


class Between(NamedTuple):
    """Positions of S arc lengths relative to neighbouring shape points of an arm."""

    point: Index
    """Shape point (S,) before each."""
    length: Array
    """Distance (S,) from that point to the next, m."""
    fraction: Array
    """Fraction (S,) of that distance; below 0 or above 1 beyond the ends."""


def between(s: Array, at: Array) -> Between:
    """Positions of arc lengths (S,) between shape points (m,), m at least 2."""
    # `np.clip` takes longer than the two.
    k = np.minimum(np.maximum(s.searchsorted(at, side="right") - 1, 0), len(s) - 2)
    length = s[k + 1] - s[k]
    return Between(k, length, (at - s[k]) / length)


def cubic(start: Any, end: Any, start_slope: Any, end_slope: Any, x: Any, length: Any = 1.0) -> Any:
    """Cubic Hermite interpolation at fractions x of a length."""
    y = 1 - x
    ends = y * y * (1 + 2 * x) * start + x * x * (3 - 2 * x) * end
    return ends + x * y * y * (start_slope * length) - x * x * y * (end_slope * length)


def arc_lengths(mesh: Mesh) -> Array:
    """Arc lengths (m,) of the shape points, m."""
    inner = mesh.start[:, None] + mesh.length[:, None] * ENDS[1:]
    return np.concatenate([ENDS[:1], inner.ravel()])


def along_elements(values: Array, elements: int) -> Array:
    """Values (m, k) at the shape points, from values (P, 5, k) at those of every element; neighbours share one."""
    table = values.reshape(elements, len(ENDS), -1)
    return np.concatenate([table[0, :1], table[:, 1:].reshape(-1, table.shape[2])])


# --- Frames at the points ---------------------------------------------------------------------------------------------


@lru_cache(maxsize=16)
def hermite(family: str, degree: int) -> Array:
    """Matrix (K, 9) to the points from values at ENDS and slopes at all of ENDS but the first, by one polynomial."""
    x, power = tableau(family, degree).nodes, np.arange(2 * len(ENDS) - 1)
    # Slopes of the monomials; that at 0 is left out, since u may jump there.
    rates = power * ENDS[1:, None] ** np.maximum(power - 1, 0)
    conditions = np.concatenate([ENDS[:, None] ** power, rates])
    return np.asarray(np.linalg.solve(conditions.T, (x[:, None] ** power).T).T)


def frames_at_points(t: Tableau, length: Array, shape: ArmShape) -> Array:
    """Frames (P, K, 3, 3) at the points of elements of lengths (P,), from those at the shape points.

    They are interpolated by a polynomial with the slopes R hat(u) at all shape points of an element but the first.
    """
    elements, count = len(length), 2 * len(ENDS) - 1
    index = shape_points(elements)
    frame, step = shape.frame[index], length[:, None, None, None]
    turning = (shape.curvature[index] @ HAT[:2]).reshape(frame.shape)
    frames = np.concatenate([frame, step * (frame @ turning)[:, 1:]], 1)
    inside = hermite(t.family, t.degree) @ frames.reshape(elements, count, 9)
    return np.asarray(inside.reshape(elements, t.degree, 3, 3))


@lru_cache(maxsize=64)
def shape_points(elements: int) -> NDArray[np.intp]:
    """Indices (P, 5) of the shape points at ENDS of every element."""
    steps = len(ENDS) - 1
    return np.asarray(np.arange(elements)[:, None] * steps + np.arange(steps + 1), dtype=np.intp)


_ENDS = tuple(ENDS.tolist())


def cumulate(t: Tableau, values: Array) -> Array:
    """Integrals (m, ...) from the plate to every shape point, of values (P, K, ...) at the points of every element."""
    flat = values.reshape(*values.shape[:2], int(np.prod(values.shape[2:])))
    inner = (t.basis(_ENDS, 1) @ flat).reshape(len(flat), len(ENDS), *values.shape[2:])
    ends = np.concatenate([np.zeros((1, *inner.shape[2:])), np.cumsum(inner[:, -1], axis=0)])
    table = ends[:-1, None] + inner[:, 1:]
    return np.concatenate([ends[:1], table.reshape(-1, *table.shape[2:])])


# --- Whole arm: shape, energy, error of the mesh ----------------------------------------------------------------------

COARSE_STEPS = SHAPE_STEPS // 2
"""Steps per element of the coarser integration of the shape, which estimates the error."""

EXTRA_QUADRATURE_POINTS = 3
"""Number of additional collocation points in the check of the mesh."""

SUBSTEPS = 2
"""Magnus steps between shape points of tubes that vary along a piece: natural twist rotates the curvature."""


def gauss_fractions(steps: int) -> Array:
    """Gauss points of the Magnus steps in an element, as fractions (3 steps,) of its length, 0 to 1."""
    return np.asarray(((np.arange(steps)[:, None] + GAUSS_POINTS) / steps).ravel())


ROUGHER = np.vander(GAUSS_POINTS, 6) @ np.linalg.inv(np.vander(gauss_fractions(2)))
"""Matrix (3, 6) from the curvature at the points of two steps to that at the points of one step over both."""

SHAPE_RATIO = (SHAPE_STEPS // COARSE_STEPS) ** 6 - 1
"""Ratio of the difference of both integrations, of order 6, to the error of the finer one."""

_HOME = np.concatenate([np.eye(3).ravel(), np.zeros(3)])


def evaluate_arm(problem: ReducedProblem, rotations: Array, state: Evaluation, torsion: Profile) -> Arm:
    """Arm of a solved state and its torsion; rotations include the natural turn."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    elements = len(mesh.length)
    if not elements:
        still, zero = rotations[:, None] + problem.assembly.twist_angle(np.zeros(1)).T, np.zeros((1, 3))
        return Arm(
            arc_length=np.zeros(1),
            rotation=still,
            torsion=np.zeros((n, 1)),
            curvature=zero[:, :2],
            position=zero,
            frame=np.eye(3)[None],
            shape_error=0.0,
            defect=0.0,
            energy=0.0,
        )
    at_ends, finer, *inside = _sections(problem, torsion, steps := _steps(problem))
    length = np.repeat(mesh.length / steps, steps)
    u = np.zeros((elements, steps.max() * len(GAUSS_POINTS), 2))
    for part in inside:
        with_steps = steps == part.curvature.shape[1] // len(GAUSS_POINTS)
        u[with_steps, : part.curvature.shape[1]] = part.curvature[with_steps]
    u = u.reshape(elements, -1, len(GAUSS_POINTS), 2)[np.arange(steps.max()) < steps[:, None]]
    turn, position = _poses(u, length)
    # One step for two from the same curvatures: no further cross-sections, and an estimate of the error.
    rough = _poses(ROUGHER @ u.reshape(-1, 2 * len(GAUSS_POINTS), 2), 2 * length[::2])[1][-1]
    first = np.cumsum(steps) - steps
    ends = np.append(0, (first[:, None] + steps[:, None] // SHAPE_STEPS * np.arange(1, SHAPE_STEPS + 1)).ravel())
    # The state has the energy of the collocated elements.
    energy = state.energy + float((mesh.length * (finer.bending @ _finer(mesh).weights))[~mesh.collocated].sum())
    if problem.assembly.eccentric:
        # |z|^2 / 2 is int t^2 / (2 kt); with stretch it is int g t^2 / (2 kt).
        energy += torsional_energy(problem, torsion) - float(state.z @ state.z) / 2
    return Arm(
        arc_length=arc_lengths(mesh),
        rotation=along_elements(at_ends.rotation, elements).T,
        torsion=along_elements(at_ends.torsion, elements).T,
        curvature=along_elements(at_ends.curvature, elements),
        position=position[ends],
        frame=turn[ends],
        shape_error=float(np.linalg.norm(position[-1] - rough)) / SHAPE_RATIO,
        defect=_defect(problem, torsion, finer) if problem.size else 0.0,
        energy=energy,
    )


def torsional_energy(problem: ReducedProblem, torsion: Profile) -> float:
    """Torsional energy int g t^2 / (2 kt), J, transmissions included."""
    mesh = problem.mesh
    torque = torsion.torque[:, None, :] + mesh.length[:, None, None] * (mesh.tableau.matrix @ torsion.moment)
    slope = torsion.compliance[:, None] * torque + torsion.extra
    inside = np.einsum("p,k,pki,pki->", mesh.length, mesh.tableau.weights, torque, slope)
    return 0.5 * float(inside + problem.compliant.transmission @ torsion.torque[0] ** 2)


def _steps(problem: ReducedProblem) -> NDArray[np.intp]:
    """Number of Magnus steps (P,) on every element."""
    mesh = problem.mesh
    steady = problem.assembly.steady(*(mesh.start + mesh.length * x for x in (INWARDS / 2, 1 - INWARDS / 2)))
    return np.where(steady, SHAPE_STEPS, SUBSTEPS * SHAPE_STEPS)


def _finer(mesh: Mesh) -> Tableau:
    """Mesh with a finer quadrature, to check the quadrature of a mesh."""
    return tableau("gauss", mesh.tableau.degree + EXTRA_QUADRATURE_POINTS)


def _sections(problem: ReducedProblem, torsion: Profile, steps: NDArray[np.intp]) -> list[Sections]:
    """Cross-sections at ENDS, at the points of the finer quadrature, and at the points of each number of `steps`."""
    fractions = [ENDS, _finer(problem.mesh).nodes, *(gauss_fractions(k) for k in sorted(set(steps.tolist())))]
    joined = sections_along(problem, torsion, tuple(np.concatenate(fractions).tolist()))
    return [joined.part(b - len(x), b) for x, b in zip(fractions, accumulate(map(len, fractions)), strict=True)]


def _poses(u: Array, lengths: Array) -> tuple[Array, Array]:
    """Frames (S + 1, 3, 3) and positions (S + 1, 3) between steps of lengths (S,), for u (S, 3, 2) inside the steps."""
    poses = chained(carry_function(), len(lengths))(_HOME, u.reshape(-1, 6), lengths[:, None])[0]
    poses = np.concatenate([_HOME[None], poses])
    return poses[:, :9].reshape(-1, 3, 3).swapaxes(1, 2), poses[:, 9:]


def _defect(problem: ReducedProblem, torsion: Profile, points: Sections) -> float:
    """Error of theta, rad, from a quadrature with EXTRA_QUADRATURE_POINTS more points.

    It has a part inside each element, and one by the error of the torque, which twists the tube up to there.
    """
    mesh, finer = problem.mesh, _finer(problem.mesh)
    h = mesh.length[:, None, None]
    gain = h * points.moment
    torque = torsion.torque[:, None] + finer.matrix @ gain
    inner = np.abs(torsion.rotation[:, None] + h * (finer.matrix @ (points.rate * torque)) - points.elastic).max(1)
    # An error of the torque twists its tube from the clamp to that element.
    gained = np.abs(finer.weights @ gain - h[:, 0] * (mesh.tableau.weights @ torsion.moment))
    return float((inner + gained * reach(mesh, problem.compliant)[1:]).sum(0).max(initial=0.0))
