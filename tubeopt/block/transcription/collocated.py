"""Element of an arm as CasADi expressions: collocated torsion, change of pose, elastic energy.

On an element of length h that begins at rotations theta and torsions w (per length of the tube), with Runge-Kutta
matrix A, weights b, and A~ the adjoint of A (itself for Gauss points),

    theta_k = theta + h sum_j A_kj g_j w_j,      w_k = w + h sum_j A~_kj M_j / kt,

and with b in place of A at the end of the element. The rotations theta_k inside are the unknowns; w_k follows.
Equations, energy, shape and all their derivatives elsewhere are generated from these expressions.

Of tubes made of pieces, theta is the elastic rotation; the natural turn is added to it for the direction of the
precurvature. Their torsional stiffness is kt / c with a compliance ratio c that varies: theta' = g c w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ...physics.shape import GAUSS_POINTS, magnus_quaternion, rotation_matrix
from ...physics.torsion import CrossSection, bent_anyhow, jacobi_rates, section_functions, symbolic_section
from .chain import LocalTubes, column_length, local_tubes
from .tableau import Tableau, tableau

SHAPE_STEPS = 4
"""Steps of the shape per element, as many as in `forward_kinematics`."""

ENDS = np.arange(SHAPE_STEPS + 1) / SHAPE_STEPS
"""Shape points of an element as fractions of its length, its start included."""

THROUGH_ENDS = np.linalg.inv(np.vander(ENDS, increasing=True))
"""Matrix (5, 5): powers of a fraction times it are the weights of the values at ENDS, in their polynomial."""


@dataclass(frozen=True)
class Grid:
    """Structure of an element: elements with equal grids share their functions."""

    n_tubes: int
    family: str = "gauss"
    degree: int = 6
    eccentric: bool = False
    detail: int = 0
    """Number of coefficients a channel of tubes made of pieces; 0 for tubes of one curvature."""
    loaded: bool = False

    @property
    def tableau(self) -> Tableau:
        """Collocation tableau of every element."""
        return tableau(self.family, self.degree)

    @property
    def stretched(self) -> bool:
        """True if theta' differs from w."""
        return self.eccentric or self.detail > 0


@dataclass(frozen=True, eq=False)
class Element:
    """Symbols or numbers of one element.

    theta, twist: rotations and torsion (n,) where it begins.  inner: theta (n, K) at its points.
    stiffness, moment: kb of the tubes present, m of the tubes curved, (n,).  torsional_stiffness: (n,).  length: h, m.
    offsets: offset and angle (n,) of eccentric tubes, or ().
    along: column of coefficients of tubes made of pieces, see `local_tubes`; replaces stiffness and moment.
    """

    grid: Grid
    """Structure of the element."""
    theta: Any
    twist: Any
    inner: Any
    stiffness: Any
    moment: Any
    torsional_stiffness: Any
    length: Any
    offsets: tuple[Any, ...] = ()
    along: Any = None

    @property
    def data(self) -> list[Any]:
        """Constants of the element in the argument order of the functions."""
        if self.along is not None:
            return [self.torsional_stiffness, self.length, self.along]
        return [self.stiffness, self.moment, self.torsional_stiffness, self.length, *self.offsets]

    @property
    def arguments(self) -> list[Any]:
        """Arguments of the functions of an element, in order."""
        return [self.theta, self.twist, self.inner, *self.data]

    def local(self, x: Any) -> LocalTubes:
        """The tubes at the fraction x of this element."""
        if self.along is None:
            return LocalTubes(self.stiffness, self.moment)
        return local_tubes(self.along, self.torsional_stiffness, self.grid.detail, x)

    def section(self, theta: Any, x: Any) -> CrossSection:
        """Cross-section at the fraction x of this element and rotations (n,)."""
        tubes = self.local(x)
        return symbolic_section(theta + tubes.natural_turn, tubes.stiffness, tubes.moment, *self.offsets)

    def balance(self, theta: Any, x: Any) -> Any:
        """Torsional moments M (n,) and dM/dtheta (n, n) at the fraction x of the element.

        If theta' differs from w, also theta' / w (n,); of eccentric tubes also its derivative by theta (n, n).
        """
        tubes, n = self.local(x), self.grid.n_tubes
        if self.along is not None:
            moment, slope = bent_anyhow(n)(theta + tubes.natural_turn, tubes.stiffness, tubes.moment)
            return [moment, slope, tubes.compliance_ratio]
        functions = section_functions(n, bool(self.offsets))
        moment, slope, _, *stretch = functions["balance"](theta, tubes.stiffness, tubes.moment, *self.offsets)
        return [moment, slope, *stretch]


@dataclass(frozen=True, eq=False)
class LoadedElement(Element):
    """An element of concentric tubes under a load."""

    moment_start: Any = None
    """Bending moment (2,) where it begins, N m."""
    moment_inside: Any = None
    """Bending moment (2, K) at its points, N m."""
    force: Any = None
    """Force (3, K) on the cross-sections at its points, N, in the frame where it begins."""

    @property
    def data(self) -> list[Any]:
        """Constants of the element, then its bending moments and forces."""
        return [*super().data, self.moment_start, ca.vec(self.moment_inside), ca.vec(self.force)]

    def section(self, theta: Any, x: Any) -> CrossSection:
        """Cross-section at the fraction x, with the bending moment interpolated there."""
        nodes = [0.0, *self.grid.tableau.nodes.tolist()]
        weights = []
        for k, node in enumerate(nodes):
            # Lagrange's formula, since x may be a symbol.
            weight: Any = 1.0
            for other in nodes[:k] + nodes[k + 1 :]:
                weight = weight * (x - other) / (node - other)
            weights.append(weight)
        load = ca.horzcat(self.moment_start, self.moment_inside) @ ca.vertcat(*weights)
        tubes = self.local(x)
        return symbolic_section(theta + tubes.natural_turn, tubes.stiffness, tubes.moment, load=load)


def symbolic_element(grid: Grid) -> Element:
    """Element with symbols for all fields."""
    n = grid.n_tubes
    theta, twist, kb, m, kt, d, gamma = (ca.SX.sym(s, n) for s in ("theta", "w", "kb", "m", "kt", "d", "gamma"))
    offsets = (d, gamma) if grid.eccentric else ()
    inner = ca.SX.sym("inner", n, grid.degree)
    along = ca.SX.sym("along", column_length(n, grid.detail)) if grid.detail else None
    fields = grid, theta, twist, inner, kb, m, kt, ca.SX.sym("h"), offsets, along
    if not grid.loaded:
        return Element(*fields)
    moments = ca.SX.sym("moment_start", 2), ca.SX.sym("moment_inside", 2, grid.degree)
    return LoadedElement(*fields, *moments, ca.SX.sym("force", 3, grid.degree))


@dataclass(frozen=True, eq=False)
class Torsion:
    """Rotations theta and torsion w of the tubes of an element, as polynomials."""

    element: Element
    twist: Any
    """Torsion w (n, K) at the points, rad/m."""
    gain: Any
    """Slope w' = M / kt (n, K) of the torsion at the points, rad/m^2."""
    extra: Any
    """Difference theta' - w = (g c - 1) w (n, K) at the points, rad/m."""
    defect: Any
    """Defect (n, K) of the collocated equations, rad."""
    end: tuple[Any, Any]
    """Rotations theta and torsion w (n,) at the end of the element."""

    def rotation(self, x: Any) -> Any:
        """Rotations theta (n, len(x)) at fractions x of the element, numbers or symbols."""
        element, at = self.element, ca.vec(x) if isinstance(x, ca.SX) else ca.DM(x)
        # theta + h x w + h^2 int int M / kt, with the polynomial of M through the points.
        theta = ca.repmat(element.theta, 1, at.numel()) + element.length * element.twist @ at.T
        theta += element.length**2 * self.gain @ _lagrange(element.grid, x, 2).T
        if element.grid.stretched:
            theta += element.length * self.extra @ _lagrange(element.grid, x, 1).T
        return theta

    def torsion(self, x: Any) -> Any:
        """Torsion w (n, len(x)) at fractions x of the element."""
        turned = self.element.length * self.gain @ _lagrange(self.element.grid, x, 1).T
        return ca.repmat(self.element.twist, 1, turned.shape[1]) + turned

    def curvature(self, x: Any) -> Any:
        """Curvature u (2, len(x)) at fractions x of the element."""
        theta = self.rotation(x)
        return ca.horzcat(*(self.element.section(theta[:, k], x[k]).curvature for k in range(theta.shape[1])))


def _lagrange(grid: Grid, x: Any, integrals: int) -> Any:
    """`Tableau.lagrange` at fractions x, numbers or symbols."""
    if not isinstance(x, ca.SX):
        return grid.tableau.lagrange(x, integrals=integrals)
    at = ca.vec(x)
    # At symbols by powers of x, exactly: a polynomial is given by as many values as it has coefficients.
    nodes = np.linspace(0.0, 1.0, grid.degree + integrals)
    powers = np.linalg.solve(np.vander(nodes, increasing=True), grid.tableau.lagrange(nodes, integrals=integrals))
    return ca.horzcat(*(at**k for k in range(len(nodes)))) @ ca.DM(powers)


def torsion_of(element: Element) -> Torsion:
    """The collocated torsion of an element."""
    t, h, count = element.grid.tableau, element.length, element.grid.degree
    sections = [element.section(element.inner[:, k], x) for k, x in enumerate(t.nodes)]
    gain = ca.horzcat(*(section.moment / element.torsional_stiffness for section in sections))
    # With the adjoint A~ for w the collocated equations are those of minimal collocated energy.
    twist = ca.repmat(element.twist, 1, count) + h * gain @ t.adjoint.T
    ratios = [element.local(x).compliance_ratio for x in t.nodes]
    stretch = ca.horzcat(*(ca.SX(section.stretch * c) for section, c in zip(sections, ratios, strict=True)))
    slope = stretch * twist
    defect = element.inner - ca.repmat(element.theta, 1, count) - h * slope @ t.matrix.T
    end = element.theta + h * slope @ t.weights, element.twist + h * gain @ t.weights
    return Torsion(element, twist, gain, slope - twist, defect, end)


def bending_of(torsion: Torsion) -> tuple[Any, Any]:
    """Collocated bending moment of an element under a load: defect (2, K), and moment (2,) where the element ends.

    m_x' = -u_y t + nu_y,  m_y' = u_x t - nu_x  with the torque t of all tubes and the force nu in the local frame.
    """
    element, t = torsion.element, torsion.element.grid.tableau
    assert isinstance(element, LoadedElement)
    rates = []
    for section, torque, nu in loaded_points(torsion):
        # m' = -u x m - e_3 x nu in the moving frame, its x and y.
        u = section.curvature
        rates.append(ca.vertcat(nu[1] - u[1] * torque, u[0] * torque - nu[0]))
    rate = element.length * ca.horzcat(*rates)
    defect = element.moment_inside - ca.repmat(element.moment_start, 1, len(rates)) - rate @ t.matrix.T
    return defect, element.moment_start + rate @ t.weights


class LoadedPoint(NamedTuple):
    """A collocation point of an element under a load."""

    section: CrossSection
    torque: Any
    """Torque of all tubes, N m."""
    force: Any
    """Force (3,) on the cross-section in its own frame, N."""


def loaded_points(torsion: Torsion) -> list[LoadedPoint]:
    """Collocation points of an element under a load."""
    element, t = torsion.element, torsion.element.grid.tableau
    assert isinstance(element, LoadedElement)
    turn, before, points = ca.SX([1, 0, 0, 0]), 0.0, []
    for k, x in enumerate(t.nodes.tolist()):
        u = torsion.curvature(before + (x - before) * GAUSS_POINTS)
        # From point to point: the frame turns by at most the bend of one element, so one step is enough.
        turn, _ = magnus_quaternion(turn, ca.SX.zeros(3), u, element.length * (x - before))
        before, force = x, rotation_matrix(turn).T @ element.force[:, k]
        torque = ca.dot(element.torsional_stiffness, torsion.twist[:, k])
        points.append(LoadedPoint(element.section(element.inner[:, k], x), torque, force))
    return points


def energy_of(torsion: Torsion) -> Any:
    """Elastic energy of the element, J: int kt g c w^2 / 2 + bending.

    It uses g c w^2 = w (w + (g c - 1) w).
    """
    element, t = torsion.element, torsion.element.grid.tableau
    total: Any = 0.0
    for k, b in enumerate(t.weights.tolist()):
        w = torsion.twist[:, k]
        bending = element.section(element.inner[:, k], t.nodes[k]).bending_energy
        total += b * (ca.dot(element.torsional_stiffness, w * (w + torsion.extra[:, k])) / 2 + bending)
    return element.length * total


class ControlledTorsion(NamedTuple):
    """Element with its torsion as a control."""

    defect: Any
    """Defect (n, K) of theta' = c w."""
    end: Any
    """Rotations theta (n,) at the end of the element, rad."""
    energy: Any
    """Elastic energy, J."""


def controlled_torsion(element: Element, twist: Any) -> ControlledTorsion:
    """An element of concentric tubes with the torsion `twist` (n, K) at its points as a control."""
    t, h = element.grid.tableau, element.length
    ratios = [ca.SX.ones(element.grid.n_tubes) * element.local(x).compliance_ratio for x in t.nodes]
    extra = twist * (ca.horzcat(*ratios) - 1)
    slope = twist + extra
    defect = element.inner - ca.repmat(element.theta, 1, element.grid.degree) - h * slope @ t.matrix.T
    # As a control, w is independent of M: the gain that would change it along the element is 0.
    free = Torsion(element, twist, ca.SX.zeros(*twist.shape), extra, defect, (element.theta, twist))
    return ControlledTorsion(defect, element.theta + h * slope @ t.weights, energy_of(free))


class RelativePose(NamedTuple):
    """Pose at a fraction of an element, relative to its start."""

    turn: Any
    """Rotation as a quaternion (4,)."""
    shift: Any
    """Position (3,) relative to the start of the element, m."""
    fraction: Any


def shape_of(torsion: Torsion, fraction: Any = 1.0, *, steps: int = SHAPE_STEPS) -> list[RelativePose]:
    """Poses after each of `steps` Magnus steps from the start of an element to `fraction` of it, a number or symbol."""
    turn, shift = ca.SX([1, 0, 0, 0]), ca.SX.zeros(3)
    out = []
    step = fraction / steps
    for k in range(steps):
        x = (k + GAUSS_POINTS) / steps
        u = torsion.curvature(fraction * ca.SX(ca.DM(x)) if isinstance(fraction, ca.SX) else fraction * x)
        turn, shift = magnus_quaternion(turn, shift, u, torsion.element.length * step)
        out.append(RelativePose(turn, shift, (k + 1) * step))
    return out


def softened(element: Element, theta: Any, w: Any, x: Any, margin: Any) -> tuple[Any, ...]:
    """Coefficients of `jacobi_rates` of tubes softened by `margin`, at the fraction x of an element with theta, w.

    Softening multiplies kt where w changes, with the state kept: the definition of the margin.
    """
    _, slope, *stretch = element.balance(theta, x)
    gain = ca.diag(1 / ((1 - margin) * element.torsional_stiffness)) @ slope
    return gain, *stretch[:1], *(ca.diag(w) @ by_theta for by_theta in stretch[1:])


def softened_fields(grid: Grid, length: Any, softness: tuple[Any, ...], end: Any, inner: Any) -> tuple[Any, Any]:
    """Jacobi field of an element of softened tubes, collocated like its torsion.

    From y = 1, v = 0 at the tip, det y > 0 along the arm and det(y - |beta| v) > 0 at the plate if and only if the
    margin is larger.

    Args:
        softness: coefficients `softened`, side by side for all points.
        end: y above v (2n,) where the element ends.  inner: y (n, K) at its points.

    Returns:
        y above v (2n,) where the element begins, and the defect (n, K) of the collocated equations.
    """
    t, n, count = grid.tableau, grid.n_tubes, grid.degree
    at_points = list(zip(*(ca.horzsplit(part, part.shape[1] // count) for part in softness), strict=True))
    y, v = end[:n], end[n:]

    def rates(v: Any) -> list[Any]:
        """y' and v' (n, K) at the points, where v is (n, K)."""
        columns = [jacobi_rates(inner[:, k], v[:, k], *at) for k, at in enumerate(at_points)]
        return [ca.horzcat(*part) for part in zip(*columns, strict=True)]

    # v' depends on y only. Backwards from the end: the integral from a point to the end has the weights b - a_kj.
    at_end = ca.repmat(v, 1, count)
    v_rate = rates(at_end)[1]
    y_rate = rates(at_end - length * v_rate @ (t.weights - t.adjoint).T)[0]
    defect = inner - ca.repmat(y, 1, count) + length * y_rate @ (t.weights - t.matrix).T
    return ca.vertcat(y - length * y_rate @ t.weights, v - length * v_rate @ t.weights), defect
