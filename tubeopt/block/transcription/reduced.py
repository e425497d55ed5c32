"""The collocated torsion problem, with theta at the collocation points as the only unknowns.

Along an arm theta_i(s) = alpha_i - int (|beta_i| + min(s, r)) M_i(r) / kt_i dr, by the boundary conditions and the
linear parts of the equations. Collocated, theta = alpha - Gamma M(theta), with Gamma = S B of quadrature weights B
and, for Gauss points, a symmetric positive definite S / kt = L L'. In the coordinates z of theta = alpha + L z the
elastic energy of concentric tubes is  z'z / 2 + sum of weights times V(theta):  its gradient is the collocation
residual, and the smallest eigenvalue of its Hessian I + L' B V'' L is the stability margin, at most 1, the eigenvalue
of uncoupled torsion.

Eccentric tubes add the stretch of each tube, theta' = g w, which has no energy of this form:

    theta = alpha - Gamma M - P [(g - 1) . W M],   P, W: integration from the base and from the tip.

Tubes made of pieces have a natural twist, theta = phi + int u*_z. The elastic rotation phi obeys the same equations,
with the cross-section at phi + phase in place of theta, and int ds / kt in place of s / kt. Of tubes made of pieces
`theta` in this module and in `arm` is phi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from ...physics.certificate import bend_rate_function
from ...robots.assembly import Assembly, without_offsets
from ...robots.order import last_tube
from ...typing import Array, Index, Mask
from .buffered import mapped, section_function
from .mesh import Compliant, Mesh, ahead, compliant, green_of, integrals, reach

# --- Tubes off the centreline that are curved together ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Block:
    """Group of k eccentric tubes that are curved together, at the p points where they are curved."""

    tubes: Index
    """Tubes (k,) that the block couples."""
    points: Index
    """Collocation points (p,) of the block."""
    compliance: Array
    """Gamma (k, p, p) of each tube, with quadrature weights."""
    up_to: Array
    """Integration (p, N) from the base to the points of the block."""
    beyond: Array
    """Integration (N, p) over the points of the block, from every point to the tip."""


def _curved_groups(assembly: Assembly) -> list[Index]:
    """Groups of tubes that are curved in the same sections; groups affect each other in one direction only."""
    groups: list[set[int]] = []
    for row in assembly.curved:
        mine = set(np.flatnonzero(row).tolist())
        if mine:
            # Groups that share a tube are one: a union as in connected components of a graph.
            groups = [g for g in groups if not g & mine] + [mine.union(*(g for g in groups if g & mine))]
    acts = [_present(assembly, group) for group in groups]
    for k, group in enumerate(groups):
        # Two groups that act on one another leave no block triangular form: all tubes are one block.
        if any(acts[k] & other and acts[j] & group for j, other in enumerate(groups) if j != k):
            return [np.array(sorted(set().union(*groups)), dtype=np.intp)]
    return [np.array(sorted(group), dtype=np.intp) for group in groups]


def _present(assembly: Assembly, group: set[int]) -> set[int]:
    """Tubes that are present where some tube of a group is curved."""
    curved = assembly.curved[:, sorted(group)].any(1)
    return set(np.flatnonzero(assembly.present[curved].any(0)).tolist())


def blocks_of(assembly: Assembly, green: Array, section: Index, integrals: tuple[Array, ...]) -> list[Block]:
    """Blocks of an assembly with N points.

    Args:
        green: min(s, r) (N, N) of the points.  section: section (N,) of each point.  integrals: P, W and weights.
    """
    up_to, beyond, weight = integrals
    blocks = []
    for tubes in _curved_groups(assembly):
        points = np.flatnonzero(assembly.curved[section][:, tubes].any(1))
        chosen = green[np.ix_(points, points)]
        length = assembly.transmission[tubes][:, None, None] + chosen
        compliance = length * weight[points] / assembly.torsional_stiffness[tubes][:, None, None]
        blocks.append(Block(tubes, points, compliance, up_to[points], beyond[:, points]))
    return blocks


LARGE = 60
"""Smallest number of unknowns for which skipping the zeros of L saves time."""


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Matrix (U, U) built from second derivatives (N, n, n) at the points."""

    entries: Index
    """Flat indices in the second derivatives."""
    positions: Index
    """Flat indices in the matrix."""
    weight: Array
    """Quadrature weight of each entry."""


@dataclass(frozen=True, eq=False)
class ReducedProblem:
    """Torsion problem of one assembly on one mesh, for any rotations; N collocation points, U unknowns.

    Properties are computed on first use: the compiled kernels need few of them.

    Attributes:
        assembly, mesh: tubes, and elements of the arm.
        unknown: True (m, n) if the rotation of a tube is unknown in a section.
        here: torsional compliance of the tubes at the points of all elements.
    """

    assembly: Assembly
    mesh: Mesh
    unknown: Mask
    compliant: Compliant

    @cached_property
    def elements(self) -> Index:
        """Elements with collocation points."""
        return np.flatnonzero(self.mesh.collocated)

    def _chosen(self, table: Array) -> Array:
        """Rows (N,) for the collocation points of a table for the points of all elements."""
        if len(self.elements) == len(self.mesh.length):
            return table
        degree = self.mesh.tableau.degree
        return np.asarray(table[(self.elements[:, None] * degree + np.arange(degree)).ravel()])

    @cached_property
    def section(self) -> Index:
        """Number of the section (N,) of each point."""
        return np.repeat(self.mesh.section[self.elements], self.mesh.tableau.degree)

    @cached_property
    def stiffness(self) -> Array:
        """Bending stiffnesses kb (N, n) of the tubes present at the points, N m^2."""
        return self._chosen(self.compliant.sections.stiffness)

    @cached_property
    def moment(self) -> Array:
        """Moments m (N, n), bending stiffness times precurvature, of the tubes curved at the points, N m."""
        return self._chosen(self.compliant.sections.moment)

    @cached_property
    def phase(self) -> Array:
        """Angle (N, n) from the elastic rotation to the direction of the precurvature, rad."""
        return self._chosen(self.compliant.sections.phase)

    @cached_property
    def arc_length(self) -> Array:
        """Arc lengths (N,) of the points, m."""
        mesh, elements = self.mesh, self.elements
        return np.asarray((mesh.start[elements, None] + mesh.length[elements, None] * mesh.tableau.nodes).ravel())

    @cached_property
    def weight(self) -> Array:
        """Quadrature weights (N,) of the points, m."""
        return np.outer(self.mesh.length[self.elements], self.mesh.tableau.weights).ravel()

    @cached_property
    def _place(self) -> tuple[Index, Index]:
        tube, point = np.nonzero(self.unknown[self.section].T)
        return point, tube

    @property
    def point(self) -> Index:
        """Collocation point (U,) of each unknown; unknowns are sorted by tube, then by point."""
        return self._place[0]

    @property
    def tube(self) -> Index:
        """Tube (U,) of each unknown."""
        return self._place[1]

    @cached_property
    def factor(self) -> Array:
        """Factor L (U, U), rad per sqrt(J)."""
        return _factor(self.mesh, self.compliant, self._place)

    @cached_property
    def flat(self) -> Index:
        """Index (U,) of each unknown in a flat (N, n) array."""
        return np.asarray(self.point * self.assembly.n_tubes + self.tube)

    @cached_property
    def flat_weight(self) -> Array:
        """Quadrature weight (U,) of each unknown."""
        return self.weight[self.point]

    @cached_property
    def pairs(self) -> _Pairs:
        """Indices of pairs of unknowns at the same point."""
        (point, tube), n, count = self._place, self.assembly.n_tubes, len(self.weight)
        index = np.full((count, n), -1)
        index[point, tube] = np.arange(len(point))
        both = np.flatnonzero((index[:, :, None] >= 0) & (index[:, None, :] >= 0))
        at, row, column = np.unravel_index(both, (count, n, n))
        # CasADi stores dM_i/dtheta_j by columns, (point, j, i); `row` is i.
        positions = index[at, row] * len(point) + index[at, column]
        return _Pairs((at * n + column) * n + row, positions, self.weight[at])

    @cached_property
    def stretch(self) -> tuple[Array, Array, Array] | None:
        """Integration matrices P and W, and the inverse of the factor L, for eccentric tubes; else None."""
        if not self.assembly.eccentric:
            return None
        return *integrals(self.mesh, self.elements), np.asarray(np.linalg.inv(self.factor), dtype=float)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Groups of eccentric tubes that are curved together, for their margin."""
        if self.stretch is None:
            return ()
        mesh, elements = self.mesh, self.elements
        green = green_of(mesh.tableau, mesh.start[elements], mesh.length[elements])
        return tuple(blocks_of(self.assembly, green, self.section, (*self.stretch[:2], self.weight)))

    @property
    def size(self) -> int:
        """Number of unknowns U."""
        return len(self.point)

    @cached_property
    def spread(self) -> Array:
        """Rows (N, n, U) of L, 0 for tubes without an unknown at a point."""
        count, n = self.stiffness.shape
        spread = np.zeros((count * n, self.size))
        spread[self.flat] = self.factor
        return spread.reshape(count, n, -1)

    @cached_property
    def bending_softness(self) -> Array:
        """Root 1 / sqrt(B K) (N,) of the weighted bending compliance at the points; B are the quadrature weights."""
        return np.asarray(1 / np.sqrt(self.weight * self.stiffness.sum(1)))

    @cached_property
    def by_tube(self) -> tuple[slice, ...]:
        """Unknowns of each tube; L is block diagonal in them."""
        cuts = np.searchsorted(self.tube, np.arange(self.assembly.n_tubes + 1)).tolist()
        return tuple(slice(a, b) for a, b in pairwise(cuts) if b > a)

    @cached_property
    def cuts(self) -> Array:
        """Arc lengths (P + 1,) where elements begin, and of the tip, m."""
        return np.append(self.mesh.start, self.assembly.total_length)

    @cached_property
    def tip_tube(self) -> int:
        """Index of the tube that carries a moment at the tip: it ends last, and of several is the innermost."""
        return int(last_tube(self.assembly.end))

    @cached_property
    def on_elements(self) -> tuple[Array, Array]:
        """Bending stiffnesses kb and moments m (P, n) on each element; raises InputError for tubes made of pieces."""
        sections = self.assembly.of_sections(self.mesh.section)
        return sections.stiffness, sections.moment

    @cached_property
    def softness(self) -> tuple[Array, Array]:
        """Compliances int ds / kt from the clamp of each tube to the points (N, n), and to the ends of elements.

        The second array is (P + 1, n).
        """
        return ahead(self.mesh, self.compliant), reach(self.mesh, self.compliant)

    @cached_property
    def energy_parts(self) -> float:
        """Sum of absolute bending energies, J; it bounds the round-off of the energy, which may be near 0."""
        rate = mapped(bend_rate_function(self.assembly.n_tubes), len(self.weight))(self.stiffness, self.moment)[0]
        return float(self.weight @ (rate * np.abs(self.moment)).sum(1))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """State of a reduced problem."""

    z: Array
    """Unknowns (U,)."""
    theta: Array
    """Rotations (N, n) at the points, rad."""
    energy: float
    """Elastic energy of the collocated elements, J."""
    gradient: Array
    """Residual (U,); of concentric tubes the gradient of the energy."""
    hessian: Array
    """Derivative (U, U) of the residual."""
    moment: Array
    """Torsional moment per length M (N, n), N."""
    extra_twist: Array | None
    """Additional twist (g - 1) w (N, n) of eccentric tubes, rad/m, else None."""

    @property
    def x(self) -> Array:
        """Unknowns (U,), all of torsion."""
        return self.z

    @property
    def potential(self) -> float:
        """Energy with a minimum at stable equilibria, J: without load the elastic energy."""
        return self.energy

    @property
    def torque(self) -> Array:
        """Torque per length (N, n) on each tube, N."""
        return self.moment


def reduce(assembly: Assembly, mesh: Mesh, unknown: Mask | None = None) -> ReducedProblem:
    """Reduced problem of an assembly on a mesh.

    Args:
        unknown: True (m, n) for tubes whose rotation is unknown in a section; by default those that are coupled.
    """
    if unknown is None:
        # Straight concentric tubes follow; eccentric tubes are stretched where the arm is curved.
        unknown = assembly.present if assembly.eccentric else assembly.curved
    return ReducedProblem(assembly, mesh, unknown, compliant(assembly, mesh))


def _factor(mesh: Mesh, compliant: Compliant, unknowns: tuple[Index, Index]) -> Array:
    """Factor L (U, U): Cholesky factors of the compliances of the tubes; `unknowns` are their points and tubes (U,)."""
    # With theta = L z the torsional energy is |z|^2 / 2. The Hessian in z is the identity plus the coupling, so that
    # its smallest eigenvalue is the margin, and Newton's method needs no scaling.
    (point, tube), elements = unknowns, np.flatnonzero(mesh.collocated)
    factor, start = np.zeros((len(point), len(point))), reach(mesh, compliant)[elements].T
    green = green_of(mesh.tableau, start, mesh.length[elements], compliant.rate[elements].transpose(2, 0, 1))
    ends = np.searchsorted(tube, np.arange(len(start) + 1)).tolist()  # the unknowns are sorted by tube
    for block, (first, last) in zip(green, pairwise(ends), strict=True):
        if first < last:
            mine = point[first:last]
            factor[first:last, first:last] = np.linalg.cholesky(block[mine[:, None], mine])
    return factor


def on_centreline(problem: ReducedProblem) -> ReducedProblem:
    """The problem of the same tubes without offsets on the same mesh, which has an energy."""
    if not problem.assembly.eccentric:
        return problem
    return reduce(without_offsets(problem.assembly), problem.mesh)


def evaluate(problem: ReducedProblem, rotations: Array, z: Array) -> Evaluation:
    """State at unknowns z (U,) for base rotations (n,)."""
    assembly, count = problem.assembly, len(problem.weight)
    theta = np.empty((count, assembly.n_tubes))
    theta[:] = rotations
    if count == 0:
        nothing = theta.copy()
        return Evaluation(
            z=z,
            theta=theta,
            energy=0.0,
            gradient=z.copy(),
            hessian=np.zeros((0, 0)),
            moment=nothing,
            extra_twist=nothing if assembly.eccentric else None,
        )
    theta.ravel()[problem.flat] += problem.factor @ z
    balance = section_function("balance", count, assembly.n_tubes, assembly.eccentric)
    # M, dM/dtheta and V of the cross-sections, from kb and m of their tubes.
    torque, torque_slope, bending, *stretch = balance(
        theta + problem.phase, problem.stiffness, problem.moment, *assembly.offsets
    )
    torque = torque.copy()
    # theta = alpha + L z: L' B M is the gradient of the bending energy, z that of |z|^2 / 2.
    gradient = z + (torque.ravel()[problem.flat] * problem.flat_weight) @ problem.factor
    hessian = torsional_hessian(problem, torque_slope)
    energy = float(z @ z) / 2 + float(problem.weight @ bending[:, 0])
    extra = None
    if problem.stretch is not None:
        at = EccentricSections.of(problem, torque, torque_slope, *stretch)
        extra, residual, slope = _stretch_terms(problem, at)
        gradient -= residual
        hessian -= slope
    return Evaluation(z, theta, energy, gradient, hessian, torque, extra)


def torsional_hessian(problem: ReducedProblem, stiffness: Array) -> Array:
    """Hessian 1 + L' B (dM/dtheta) L (U, U), from the output dM/dtheta of `balance`."""
    second = np.zeros(problem.size**2)
    pairs = problem.pairs
    second[pairs.positions] = stiffness.ravel()[pairs.entries] * pairs.weight
    table = second.reshape(problem.size, problem.size)
    if problem.size < LARGE:
        hessian = problem.factor.T @ table @ problem.factor
    else:
        hessian = np.empty_like(table)
        # L is 0 between tubes, so each block of L' B V'' L needs the factors of its two tubes only.
        for j in problem.by_tube:
            turned = table[:, j] @ problem.factor[j, j]
            for i in problem.by_tube:
                hessian[i, j] = problem.factor[i, i].T @ turned[i]
    hessian.ravel()[:: problem.size + 1] += 1.0
    return np.asarray(hessian)


class _StretchTerms(NamedTuple):
    """Terms of the stretch of eccentric tubes."""

    extra: Array
    """Rotation rate due to stretch, (g - 1) w (N, n), rad/m."""
    change: Array
    """Change of the unknowns z (U,) by it."""
    slope: Array
    """Derivative (U, U) of that change by z."""


class EccentricSections(NamedTuple):
    """Cross-sections of eccentric tubes in equilibrium at N points."""

    slope: Array
    """Derivative dM_i/dtheta_j (N, i, j) of the torsional moments."""
    g: Array
    """Stretch (N, n)."""
    g_slope: Array
    """Derivative dg_i/dtheta_j (N, i, j)."""
    twist: Array
    """Torsion w (N, n), rad/m."""

    @staticmethod
    def of(problem: ReducedProblem, moment: Array, slope: Array, g: Array, g_slope: Array) -> EccentricSections:
        """Cross-sections from outputs of `balance`."""
        assert problem.stretch is not None
        # CasADi stores dM_i/dtheta_j by columns, (point, j, i).
        slope, g_slope = (part.reshape(*moment.shape, -1).swapaxes(1, 2) for part in (slope, g_slope))
        # w = -W M / kt, since torsion vanishes at the tip.
        twist = -(problem.stretch[1] @ moment) / problem.assembly.torsional_stiffness
        return EccentricSections(slope, g, g_slope, twist)

    def rotation_by_torque(self, problem: ReducedProblem, block: Block) -> Array:
        """Rotation Gamma + P (g - 1) W / kt (k, p, p) by a torque: directly, and by the stretch of its tube."""
        extra = ((self.g - 1) / problem.assembly.torsional_stiffness).T[block.tubes]
        return np.asarray(block.compliance + (block.up_to * extra[:, None, :]) @ block.beyond)


def eccentric_sections(problem: ReducedProblem, theta: Array) -> EccentricSections:
    """Cross-sections at rotations theta (N, n) of the points."""
    balance = section_function("balance", len(problem.weight), problem.assembly.n_tubes, True)
    outputs = balance(theta, problem.stiffness, problem.moment, *problem.assembly.offsets)
    moment, slope, _, g, g_slope = (part.copy() for part in outputs)
    return EccentricSections.of(problem, moment, slope, g, g_slope)


def _stretch_terms(problem: ReducedProblem, at: EccentricSections) -> _StretchTerms:
    """Terms of the stretch of eccentric tubes."""
    assert problem.stretch is not None
    up_to, beyond, inverse = problem.stretch
    extra = (at.g - 1) * at.twist
    change = up_to @ extra
    # d(change)[a, i] / d(theta)[b, j] = P_ab dg_i/dtheta_j[b] w_bi - sum_c P_ac (g - 1)_ci W_cb dM_i/dtheta_j[b] / kt_i
    direct = (at.g_slope * at.twist[:, :, None]).swapaxes(0, 1)[:, None] * up_to[:, :, None]
    # P (g - 1) W / kt of each tube: the product rule's second part without a loop over c.
    crossed = (up_to * ((at.g - 1) / problem.assembly.torsional_stiffness).T[:, None, :]) @ beyond
    through = crossed[:, :, :, None] * at.slope.swapaxes(0, 1)[:, None]
    p, t = problem.point, problem.tube
    chosen = (direct - through)[t[:, None], p[:, None], p, t]
    return _StretchTerms(extra, inverse @ change[p, t], inverse @ chosen @ problem.factor)


def pull_rate(problem: ReducedProblem) -> Array:
    """Largest change (P,) of curvature per turn of all tubes on each element, 1/m; see `bend_rate_function`."""
    stiffness, moment = problem.compliant.sections.stiffness, problem.compliant.sections.moment
    each = mapped(bend_rate_function(moment.shape[1]), len(moment))(stiffness, moment)[0].sum(1)
    return np.asarray(each.reshape(-1, problem.mesh.tableau.degree).max(1, initial=0.0))


def to_unknowns(problem: ReducedProblem, rotations: Array, theta: Array) -> Array:
    """Unknowns z (U,) of rotations theta (N, n) at the collocation points."""
    p, t = problem.point, problem.tube
    return whitened(problem, theta[p, t] - rotations[t])


class TubeTurn(NamedTuple):
    """Rotation of a tube at a place."""

    tube: int
    row: Array
    """Derivative (U,) by z."""
    compliance: float
    """Rotation by a unit torque there, rad/(N m)."""

    @property
    def rest(self) -> float:
        """Part of that rotation that z does not determine, rad/(N m)."""
        return self.compliance - float(self.row @ self.row)


@lru_cache(maxsize=64)
def tube_turn(problem: ReducedProblem, tube: int, element: int) -> TubeTurn:
    """Rotation of a tube where an element begins; the number of elements is the tip."""
    point_compliance, end_compliance = problem.softness
    end = float(end_compliance[element, tube])
    # A torque twists its tube up to where it acts, and no farther.
    turns = np.where(problem.tube == tube, np.minimum(point_compliance[:, tube], end)[problem.point], 0.0)
    return TubeTurn(tube, whitened(problem, turns), end)


def whitened(problem: ReducedProblem, turns: Array) -> Array:
    """Unknowns z (U,) that change the rotations by `turns` (U,), rad."""
    if not problem.size:
        return np.zeros(0)
    # L is triangular: z = L^-1 (theta - alpha), and torsional energy is |z|^2 / 2 again.
    return np.asarray(scipy.linalg.lapack.dtrtrs(problem.factor, turns, lower=1)[0])


def residual(problem: ReducedProblem, state: Evaluation) -> float:
    """Largest residual of the collocation equations, as an error of theta at the points, rad."""
    # The gradient is in sqrt(J): L converts it to errors of rotations.
    return float(abs(problem.factor @ state.gradient).max()) if problem.size else 0.0


def worst_equation(problem: ReducedProblem, state: Evaluation) -> str:
    """Name of the most violated collocation equation, with its violation."""
    if not problem.size:
        return "all equations are satisfied"
    # A NaN counts as the largest violation, since no number can be compared with it.
    violation = np.abs(problem.factor @ state.gradient)
    k = int(np.argmax(np.where(np.isfinite(violation), violation, np.inf)))
    mesh, degree = problem.mesh, problem.mesh.tableau.degree
    element = int(np.flatnonzero(mesh.collocated)[problem.point[k] // degree])
    section = int(mesh.section[element])
    point = (element - int(np.argmax(mesh.section == section))) * degree + int(problem.point[k] % degree)
    location = f"tube {int(problem.tube[k]) + 1}, section {section + 1}, point {point + 1}"
    return f"torsion equation, {location}: violated by {violation[k]:.1e} rad"
