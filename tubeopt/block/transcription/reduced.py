"""The collocated torsion problem with everything eliminated but theta at the collocation points.

Along an arm theta_i(s) = alpha_i - int (|beta_i| + min(s, r)) M_i(r) / kt_i dr: what the boundary conditions and the
linear parts of the equations say. Collocated, theta = alpha - Gamma M(theta), with Gamma = S B of quadrature weights B
and, for Gauss points, a symmetric positive definite S / kt = L L'. In the coordinates z of theta = alpha + L z the
elastic energy of concentric tubes is  z'z / 2 + sum of weights times V(theta):  its gradient is the collocation
residual, its Hessian I + L' B V'' L has the stability margin as its smallest eigenvalue (capped at 1, which the
torsion that nothing couples always has).

Tubes off the centreline add the stretch of each tube, theta' = g w, which no energy of this form has:

    theta = alpha - Gamma M - P [(g - 1) . W M],   P, W: integration from the base and from the tip.

Tubes made of pieces are wound by their natural twist, theta = phi + int u*_z, and what the elastic torsion turns is
phi: it obeys the same equations, with the cross-section at phi + phase in place of theta, and int ds / kt in place of
s / kt. Where a tube is made of pieces, `theta` here and in `arm` is phi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

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
    """k tubes off the centreline that are curved together, at the p points where they are.

    tubes (k,), points (p,); compliance (k, p, p): Gamma of each, weights included; up_to (p, N), beyond (N, p):
    integrals from the base to these points, and over them from every point to the tip.
    """

    tubes: Index
    points: Index
    compliance: Array
    up_to: Array
    beyond: Array


def _curved_groups(assembly: Assembly) -> list[Index]:
    """Tubes that are curved together, in groups that do not act on one another but from base to tip."""
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
    """Tubes that run where some of a group are curved."""
    there = assembly.curved[:, sorted(group)].any(1)
    return set(np.flatnonzero(assembly.present[there].any(0)).tolist())


def blocks_of(assembly: Assembly, green: Array, section: Index, integrals: tuple[Array, ...]) -> list[Block]:
    """Blocks of an assembly whose N points lie on sections `section`, with min(s, r) (N, N), and P, W, weights."""
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
"""Unknowns; with more, leaving out the zeros of L saves time."""


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Where the second variation (N, n, n) goes in a (U, U) matrix: `entries` of the one and `places` in the other,
    both flat, and the `weight` of each."""

    entries: Index
    places: Index
    weight: Array


@dataclass(frozen=True, eq=False)
class ReducedProblem:
    """Numbers of one assembly on one mesh, ready for any rotations; N collocation points, U unknowns.

    What only NumPy needs is computed when it is asked for: the compiled kernels have most of it by themselves.

    Attributes:
        assembly, mesh: what is solved.
        unknown: (m, n) whether the rotation of a tube is unknown in a section.
        here: the tubes at the points that all pieces would have.
    """

    assembly: Assembly
    mesh: Mesh
    unknown: Mask
    here: Compliant

    @cached_property
    def elements(self) -> Index:
        """The pieces that have collocation points."""
        return np.flatnonzero(self.mesh.collocated)

    def _chosen(self, table: Array) -> Array:
        """Rows (N,) of the collocation points, of those of the points that all pieces would have."""
        if len(self.elements) == len(self.mesh.length):
            return table
        degree = self.mesh.tableau.degree
        return np.asarray(table[(self.elements[:, None] * degree + np.arange(degree)).ravel()])

    @cached_property
    def section(self) -> Index:
        """(N,) of the points."""
        return np.repeat(self.mesh.section[self.elements], self.mesh.tableau.degree)

    @cached_property
    def stiffness(self) -> Array:
        """(N, n) kb_i of the tubes present at the points."""
        return self._chosen(self.here.sections.stiffness)

    @cached_property
    def moment(self) -> Array:
        """(N, n) m_i of the tubes curved at the points."""
        return self._chosen(self.here.sections.moment)

    @cached_property
    def phase(self) -> Array:
        """(N, n) angle to be added to the elastic rotation for the direction of a tube's pull."""
        return self._chosen(self.here.sections.phase)

    @cached_property
    def arc_length(self) -> Array:
        """(N,) place of the points, m."""
        mesh, elements = self.mesh, self.elements
        return np.asarray((mesh.start[elements, None] + mesh.length[elements, None] * mesh.tableau.nodes).ravel())

    @cached_property
    def weight(self) -> Array:
        """(N,) quadrature weight of the points, m."""
        return np.outer(self.mesh.length[self.elements], self.mesh.tableau.weights).ravel()

    @cached_property
    def _place(self) -> tuple[Index, Index]:
        tube, point = np.nonzero(self.unknown[self.section].T)
        return point, tube

    @property
    def point(self) -> Index:
        """(U,) collocation point of each unknown; unknowns are sorted by tube, then by point."""
        return self._place[0]

    @property
    def tube(self) -> Index:
        """(U,) tube of each unknown."""
        return self._place[1]

    @cached_property
    def factor(self) -> Array:
        """(U, U) L, rad per sqrt(J)."""
        return _factor(self.mesh, self.here, self._place)

    @cached_property
    def flat(self) -> Index:
        """(U,) entry of each unknown in a flat (N, n) array."""
        return np.asarray(self.point * self.assembly.n_tubes + self.tube)

    @cached_property
    def flat_weight(self) -> Array:
        """(U,) its quadrature weight."""
        return self.weight[self.point]

    @cached_property
    def pairs(self) -> _Pairs:
        """Of unknowns at the same point."""
        (point, tube), n, count = self._place, self.assembly.n_tubes, len(self.weight)
        index = np.full((count, n), -1)
        index[point, tube] = np.arange(len(point))
        both = np.flatnonzero((index[:, :, None] >= 0) & (index[:, None, :] >= 0))
        at, row, column = np.unravel_index(both, (count, n, n))
        # CasADi stores dM_i/dtheta_j by columns, (point, j, i); `row` is i.
        places = index[at, row] * len(point) + index[at, column]
        return _Pairs((at * n + column) * n + row, places, self.weight[at])

    @cached_property
    def stretch(self) -> tuple[Array, Array, Array] | None:
        """(P, W, inverse of L) for tubes off the centreline."""
        if not self.assembly.eccentric:
            return None
        return *integrals(self.mesh, self.elements), np.asarray(np.linalg.inv(self.factor), dtype=float)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Tubes off the centreline that are curved together, for their margin."""
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
        """(N, n, U) rows of L, 0 for tubes that are not unknown at a point."""
        count, n = self.stiffness.shape
        spread = np.zeros((count * n, self.size))
        spread[self.flat] = self.factor
        return spread.reshape(count, n, -1)

    @cached_property
    def bending_softness(self) -> Array:
        """(N,) 1 / sqrt(B K)."""
        return np.asarray(1 / np.sqrt(self.weight * self.stiffness.sum(1)))

    @cached_property
    def by_tube(self) -> tuple[slice, ...]:
        """The unknowns of each tube, between which L is 0."""
        cuts = np.searchsorted(self.tube, np.arange(self.assembly.n_tubes + 1)).tolist()
        return tuple(slice(a, b) for a, b in pairwise(cuts) if b > a)

    @cached_property
    def cuts(self) -> Array:
        """(P + 1,) arc lengths where pieces begin, and of the tip, m."""
        return np.append(self.mesh.start, self.assembly.total_length)

    @cached_property
    def tip_tube(self) -> int:
        """The tube that ends last, of several the innermost, on which a moment at the tip acts."""
        return int(last_tube(self.assembly.end))

    @cached_property
    def on_pieces(self) -> tuple[Array, Array]:
        """kb_i and m_i on each piece, (P, n); raises InputError where a tube is made of pieces, which vary along it."""
        here = self.assembly.of_sections(self.mesh.section)
        return here.stiffness, here.moment

    @cached_property
    def softness(self) -> tuple[Array, Array]:
        """(N, n) and (P + 1, n) int ds / kt from where each tube is held to the points, and to the ends of pieces."""
        return ahead(self.mesh, self.here), reach(self.mesh, self.here)

    @cached_property
    def energy_parts(self) -> float:
        """Sum of the sizes of the bending energies, J. It bounds the round-off of their sum, which may be near 0."""
        rate = mapped(bend_rate_function(self.assembly.n_tubes), len(self.weight))(self.stiffness, self.moment)[0]
        return float(self.weight @ (rate * np.abs(self.moment)).sum(1))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """State of a reduced problem: `theta` (N, n), the energy (J), residual and its Jacobian in z, moments M (N, n),
    twist w = theta' / g at the points times (g - 1), as (N, n), zero for concentric tubes."""

    z: Array
    theta: Array
    energy: float
    gradient: Array
    hessian: Array
    moment: Array
    extra_twist: Array | None

    @property
    def x(self) -> Array:
        """(U,) the unknowns: all describe torsion."""
        return self.z

    @property
    def potential(self) -> float:
        """Energy that an equilibrium makes least, J: without load the elastic one."""
        return self.energy

    @property
    def torque(self) -> Array:
        """(N, n) torque per length on each tube, N."""
        return self.moment


def reduce(assembly: Assembly, mesh: Mesh, unknown: Mask | None = None) -> ReducedProblem:
    """The reduced problem: only rotations theta at collocation points are left, of coupled tubes.

    With `unknown` (m, n) it keeps the tubes that are marked there, section by section.
    """
    if unknown is None:
        # Concentric straight tubes are carried along; tubes off the centreline are stretched where the arm is curved.
        unknown = assembly.present if assembly.eccentric else assembly.curved
    return ReducedProblem(assembly, mesh, unknown, compliant(assembly, mesh))


def _factor(mesh: Mesh, here: Compliant, unknowns: tuple[Index, Index]) -> Array:
    """(U, U) L: for every tube the root of its compliance. `unknowns` are point (U,) and tube (U,) of each unknown."""
    # With theta = L z the torsional energy is |z|^2 / 2. The Hessian in z is the identity plus the coupling, so that
    # its least eigenvalue is the margin, and Newton's method needs no scaling.
    (point, tube), elements = unknowns, np.flatnonzero(mesh.collocated)
    factor, begin = np.zeros((len(point), len(point))), reach(mesh, here)[elements].T
    green = green_of(mesh.tableau, begin, mesh.length[elements], here.rate[elements].transpose(2, 0, 1))
    ends = np.searchsorted(tube, np.arange(len(begin) + 1)).tolist()  # the unknowns are sorted by tube
    for own, (first, last) in zip(green, pairwise(ends), strict=True):
        if first < last:
            mine = point[first:last]
            factor[first:last, first:last] = np.linalg.cholesky(own[mine[:, None], mine])
    return factor


def on_centreline(problem: ReducedProblem) -> ReducedProblem:
    """The same tubes without offsets on the same mesh: the problem that has an energy, and defines the margin."""
    if not problem.assembly.eccentric:
        return problem
    return reduce(without_offsets(problem.assembly), problem.mesh)


def evaluate(problem: ReducedProblem, rotations: Array, z: Array) -> Evaluation:
    """Energy, residual, Jacobian and moments at z (U,) for base rotations (n,)."""
    assembly, count = problem.assembly, len(problem.weight)
    theta = np.empty((count, assembly.n_tubes))
    theta[:] = rotations
    if count == 0:
        nothing = theta.copy()
        return Evaluation(z, theta, 0.0, z.copy(), np.zeros((0, 0)), nothing, nothing if assembly.eccentric else None)
    theta.ravel()[problem.flat] += problem.factor @ z
    balance = section_function("balance", count, assembly.n_tubes, assembly.eccentric)
    moment, stiffness, bending, *stretch = balance(
        theta + problem.phase, problem.stiffness, problem.moment, *assembly.place
    )
    moment = moment.copy()
    # theta = alpha + L z: L' B M is the gradient of the bending energy, z that of |z|^2 / 2.
    gradient = z + (moment.ravel()[problem.flat] * problem.flat_weight) @ problem.factor
    hessian = torsional_hessian(problem, stiffness)
    energy = float(z @ z) / 2 + float(problem.weight @ bending[:, 0])
    extra = None
    if problem.stretch is not None:
        extra, residual, slope = _stretch_terms(problem, moment, stiffness, stretch)
        gradient -= residual
        hessian -= slope
    return Evaluation(z, theta, energy, gradient, hessian, moment, extra)


def torsional_hessian(problem: ReducedProblem, stiffness: Array) -> Array:
    """1 + L' B (dM/dtheta) L from the output dM/dtheta of `balance`."""
    second = np.zeros(problem.size**2)
    pairs = problem.pairs
    second[pairs.places] = stiffness.ravel()[pairs.entries] * pairs.weight
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


def _stretch_terms(
    problem: ReducedProblem, moment: Array, stiffness: Array, stretch: list[Array]
) -> tuple[Array, Array, Array]:
    """(g - 1) w at the points, and what it adds to theta, with its Jacobian, both in z coordinates."""
    assert problem.stretch is not None
    up_to, beyond, inverse = problem.stretch
    kt = problem.assembly.torsional_stiffness
    count, n = moment.shape
    # w = 0 at the tip: kt w = -int M from the point to the tip, with the sums W.
    twist = -(beyond @ moment) / kt
    extra = (stretch[0] - 1) * twist
    change = up_to @ extra
    slope_g = stretch[1].reshape(count, n, n).swapaxes(1, 2)
    slope_moment = stiffness.reshape(count, n, n).swapaxes(1, 2)
    # d(change)[a, i] / d(theta)[b, j] = P_ab dg_i/dtheta_j[b] w_bi - sum_c P_ac (g - 1)_ci W_cb dM_i/dtheta_j[b] / kt_i
    direct = (slope_g * twist[:, :, None]).swapaxes(0, 1)[:, None] * up_to[:, :, None]
    # P (g - 1) W / kt of each tube: the product rule's second part without a loop over c.
    crossed = (up_to * ((stretch[0] - 1) / kt).T[:, None, :]) @ beyond
    through = crossed[:, :, :, None] * slope_moment.swapaxes(0, 1)[:, None]
    p, t = problem.point, problem.tube
    chosen = (direct - through)[t[:, None], p[:, None], p, t]
    return extra, inverse @ change[p, t], inverse @ chosen @ problem.factor


def pull_rate(problem: ReducedProblem) -> Array:
    """(P,) how much curvature a turn of all tubes can change on each piece, 1/m; see `bend_rate_function`."""
    stiffness, moment = problem.here.sections.stiffness, problem.here.sections.moment
    each = mapped(bend_rate_function(moment.shape[1]), len(moment))(stiffness, moment)[0].sum(1)
    return np.asarray(each.reshape(-1, problem.mesh.tableau.degree).max(1, initial=0.0))


def to_unknowns(problem: ReducedProblem, rotations: Array, theta: Array) -> Array:
    """z (U,) of given rotations theta (N, n) at the collocation points."""
    p, t = problem.point, problem.tube
    return whitened(problem, theta[p, t] - rotations[t])


def row_of(problem: ReducedProblem, tube: int, lever: Array) -> Array:
    """(U,) the turn of a tube at a place by z; `lever` (N,): its turn there by a torque at each point, rad/(N m)."""
    return whitened(problem, np.where(problem.tube == tube, lever[problem.point], 0.0))


def whitened(problem: ReducedProblem, turns: Array) -> Array:
    """z (U,) of turns (U,) of the unknown rotations, rad."""
    if not problem.size:
        return np.zeros(0)
    # L is triangular: z = L^-1 (theta - alpha), and torsional energy is |z|^2 / 2 again.
    return np.asarray(scipy.linalg.lapack.dtrtrs(problem.factor, turns, lower=1)[0])


def residual(problem: ReducedProblem, state: Evaluation) -> float:
    """Largest violation of the collocation equations, as an error of theta at the points, rad."""
    # The gradient is in sqrt(J): L turns it into the rotations by which the equations are missed.
    return float(abs(problem.factor @ state.gradient).max()) if problem.size else 0.0


def worst_equation(problem: ReducedProblem, state: Evaluation) -> str:
    """The most violated collocation equation in words, with its violation."""
    if not problem.size:
        return "all equations hold"
    # A NaN counts as the largest violation, since no number can be compared with it.
    violation = np.abs(problem.factor @ state.gradient)
    k = int(np.argmax(np.where(np.isfinite(violation), violation, np.inf)))
    mesh, degree = problem.mesh, problem.mesh.tableau.degree
    piece = int(np.flatnonzero(mesh.collocated)[problem.point[k] // degree])
    section = int(mesh.section[piece])
    point = (piece - int(np.argmax(mesh.section == section))) * degree + int(problem.point[k] % degree)
    place = f"tube {int(problem.tube[k]) + 1}, section {section + 1}, point {point + 1}"
    return f"torsion equation, {place}: violated by {violation[k]:.1e} rad"
