"""One piece of an arm as CasADi expressions: the collocated torsion, the pose that it adds, its energy.

On a piece of length h that begins at rotations theta and torsions w (per length of the tube), with Runge-Kutta matrix
A, weights b, and A~ the adjoint of A (itself for Gauss points),

    theta_k = theta + h sum_j A_kj g_j w_j,      w_k = w + h sum_j A~_kj M_j / kt,

and the same with b to the end of the piece. The rotations theta_k inside are the unknowns; w_k follows. Every other
module has the equations, the energy, the shape and all their derivatives from here.

Of tubes made of pieces theta is the elastic rotation, to which the natural turn is added where a tube pulls; their
torsional stiffness is kt of the tube over an ease c that varies, so that c stands beside g: theta' = g c w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ...physics.shape import GAUSS_POINTS, magnus_quaternion, rotation_matrix
from ...physics.torsion import CrossSection, bent_anyhow, section_functions, symbolic_section
from .chain import Local, local, width
from .tableau import Tableau, tableau

STEPS = 4
"""Steps of the shape per piece, as those of `forward_kinematics`."""

ENDS = np.arange(STEPS + 1) / STEPS
"""Fractions of a piece at which its shape points lie, its beginning included."""

THROUGH_ENDS = np.linalg.inv(np.vander(ENDS, increasing=True))
"""(5, 5) powers of a fraction by this: weights of the values at ENDS in the polynomial through them."""


@dataclass(frozen=True)
class Grid:
    """What makes the pieces of two arms the same functions but for numbers: tubes, collocation, offsets, and of tubes
    made of pieces the `detail`, coefficients of what varies along them (0: nothing does); whether they bear a load."""

    n_tubes: int
    family: str = "gauss"
    degree: int = 6
    eccentric: bool = False
    detail: int = 0
    loaded: bool = False

    @property
    def tableau(self) -> Tableau:
        """Collocation tableau of every piece."""
        return tableau(self.family, self.degree)

    @property
    def stretched(self) -> bool:
        """Whether theta' is another one than w."""
        return self.eccentric or self.detail > 0


@dataclass(frozen=True, eq=False)
class Piece:
    """Symbols or numbers of one piece.

    theta, twist: (n,) where it begins.  inner: (n, K) theta at its points.  stiffness, moment: (n,) kb_i of the tubes
    present, m_i of the tubes curved.  torsional_stiffness: (n,).  length: h.  place: offset and angle (n,), or nothing.
    along: what varies along tubes made of pieces, as `panel.local` reads it, in place of stiffness and moment.
    """

    grid: Grid
    """Its points, and what is modelled there."""
    theta: Any
    twist: Any
    inner: Any
    stiffness: Any
    moment: Any
    torsional_stiffness: Any
    length: Any
    place: tuple[Any, ...] = ()
    along: Any = None

    @property
    def data(self) -> list[Any]:
        """What is given of the piece."""
        if self.along is not None:
            return [self.torsional_stiffness, self.length, self.along]
        return [self.stiffness, self.moment, self.torsional_stiffness, self.length, *self.place]

    @property
    def arguments(self) -> list[Any]:
        """What the functions of this module take, in order."""
        return [self.theta, self.twist, self.inner, *self.data]

    def local(self, x: Any) -> Local:
        """The tubes at the fraction x of this piece."""
        if self.along is None:
            return Local(self.stiffness, self.moment)
        return local(self.along, self.torsional_stiffness, self.grid.detail, x)

    def section(self, theta: Any, x: Any) -> CrossSection:
        """The cross-section at the fraction x of this piece, at rotations (n,)."""
        here = self.local(x)
        return symbolic_section(theta + here.wound, here.stiffness, here.moment, *self.place)

    def balance(self, theta: Any, x: Any) -> Any:
        """M, dM/dtheta (n, n), where theta' is another than w g c, of eccentric tubes dg/dtheta (n, n): at the fraction
        x."""
        here, n = self.local(x), self.grid.n_tubes
        if self.along is not None:
            moment, slope = bent_anyhow(n)(theta + here.wound, here.stiffness, here.moment)
            return [moment, slope, here.ease]
        functions = section_functions(n, bool(self.place))
        moment, slope, _, *stretch = functions["balance"](theta, here.stiffness, here.moment, *self.place)
        return [moment, slope, *stretch]


@dataclass(frozen=True, eq=False)
class LoadedPiece(Piece):
    """A piece of tubes on the centreline that bears a load.

    bend: (2,) bending moment where it begins, N m.  bent: (2, K) at its points.  push: (3, K) force on the
    cross-sections there, N, in the frame in which the piece begins.
    """

    bend: Any = None
    bent: Any = None
    push: Any = None

    @property
    def data(self) -> list[Any]:
        """What is given of the piece."""
        return [*super().data, self.bend, ca.vec(self.bent), ca.vec(self.push)]

    def section(self, theta: Any, x: Any) -> CrossSection:
        """The cross-section at the fraction x, where the moment is that between its points."""
        moment = ca.horzcat(self.bend, self.bent) @ ca.vertcat(*_between([0.0, *self.grid.tableau.nodes.tolist()], x))
        here = self.local(x)
        return symbolic_section(theta + here.wound, here.stiffness, here.moment, load=moment)


def _between(nodes: list[float], x: Any) -> list[Any]:
    """Weights at x of values at the nodes, whose polynomial is meant."""
    weights = []
    for k, own in enumerate(nodes):
        weight: Any = 1.0
        for other in nodes[:k] + nodes[k + 1 :]:
            # Lagrange's formula: few nodes, and x may be a symbol.
            weight = weight * (x - other) / (own - other)
        weights.append(weight)
    return weights


def symbols(grid: Grid) -> Piece:
    """A piece of symbols."""
    n = grid.n_tubes
    theta, twist, kb, m, kt, d, phi = (ca.SX.sym(s, n) for s in ("theta", "w", "kb", "m", "kt", "d", "phi"))
    place = (d, phi) if grid.eccentric else ()
    inner = ca.SX.sym("inner", n, grid.degree)
    along = ca.SX.sym("along", width(n, grid.detail)) if grid.detail else None
    inputs = grid, theta, twist, inner, kb, m, kt, ca.SX.sym("h"), place, along
    if not grid.loaded:
        return Piece(*inputs)
    return LoadedPiece(
        *inputs, ca.SX.sym("bend", 2), ca.SX.sym("bent", 2, grid.degree), ca.SX.sym("push", 3, grid.degree)
    )


@dataclass(frozen=True, eq=False)
class Torsion:
    """theta and w of a piece as polynomials: `twist` (n, K) at its points, `gain` (n, K) M / kt and `extra` (n, K)
    (g c - 1) w there, `defect` (n, K) of the collocated equations, `end` theta and w (n,) where the piece ends."""

    piece: Piece
    twist: Any
    gain: Any
    extra: Any
    defect: Any
    end: tuple[Any, Any]

    def rotation(self, x: Any) -> Any:
        """theta (n, len(x)) at fractions x of the piece, numbers or symbols."""
        piece, at = self.piece, ca.vec(x) if isinstance(x, ca.SX) else ca.DM(x)
        # theta + h x w + h^2 int int M / kt, with the polynomial of M through the points.
        theta = ca.repmat(piece.theta, 1, at.numel()) + piece.length * piece.twist @ at.T
        theta += piece.length**2 * self.gain @ _lagrange(piece.grid, x, 2).T
        if piece.grid.stretched:
            theta += piece.length * self.extra @ _lagrange(piece.grid, x, 1).T
        return theta

    def torsion(self, x: Any) -> Any:
        """w (n, len(x)) at fractions x of the piece."""
        turned = self.piece.length * self.gain @ _lagrange(self.piece.grid, x, 1).T
        return ca.repmat(self.piece.twist, 1, turned.shape[1]) + turned

    def curvature(self, x: Any) -> Any:
        """u (2, len(x)) at fractions x of the piece."""
        theta = self.rotation(x)
        return ca.horzcat(*(self.piece.section(theta[:, k], x[k]).curvature for k in range(theta.shape[1])))


def _lagrange(grid: Grid, x: Any, integrals: int) -> Any:
    """`Tableau.lagrange` at numbers, or at symbols by powers of x."""
    if not isinstance(x, ca.SX):
        return grid.tableau.lagrange(x, integrals=integrals)
    at = ca.vec(x)
    # A polynomial of this degree is fixed by as many values: it is exact in powers of x.
    nodes = np.linspace(0.0, 1.0, grid.degree + integrals)
    powers = np.linalg.solve(np.vander(nodes, increasing=True), grid.tableau.lagrange(nodes, integrals=integrals))
    return ca.horzcat(*(at**k for k in range(len(nodes)))) @ ca.DM(powers)


def torsion_of(piece: Piece) -> Torsion:
    """The collocated torsion of a piece."""
    t, h, count = piece.grid.tableau, piece.length, piece.grid.degree
    sections = [piece.section(piece.inner[:, k], x) for k, x in enumerate(t.nodes)]
    gain = ca.horzcat(*(here.moment / piece.torsional_stiffness for here in sections))
    # w takes the adjoint A~, which makes the equations those of a least collocated energy.
    twist = ca.repmat(piece.twist, 1, count) + h * gain @ t.adjoint.T
    eases = [piece.local(x).ease for x in t.nodes]
    stretch = ca.horzcat(*(ca.SX(here.stretch * ease) for here, ease in zip(sections, eases, strict=True)))
    slope = stretch * twist
    defect = piece.inner - ca.repmat(piece.theta, 1, count) - h * slope @ t.matrix.T
    end = piece.theta + h * slope @ t.weights, piece.twist + h * gain @ t.weights
    return Torsion(piece, twist, gain, slope - twist, defect, end)


def bending_of(torsion: Torsion) -> tuple[Any, Any]:
    """The collocated bending moment of a piece that bears a load: defect (2, K), moment (2,) where the piece ends.

    m_x' = -u_y t + nu_y,  m_y' = u_x t - nu_x  with the torque t of all tubes and the force nu in the frame there.
    """
    piece, t = torsion.piece, torsion.piece.grid.tableau
    assert isinstance(piece, LoadedPiece)
    felt = [(here.curvature, torque, nu) for here, torque, nu in felt_of(torsion)]
    # m' = -u x m - e_3 x nu in the moving frame, its x and y.
    rates = [ca.vertcat(nu[1] - u[1] * torque, u[0] * torque - nu[0]) for u, torque, nu in felt]
    rate = piece.length * ca.horzcat(*rates)
    defect = piece.bent - ca.repmat(piece.bend, 1, len(rates)) - rate @ t.matrix.T
    return defect, piece.bend + rate @ t.weights


def felt_of(torsion: Torsion) -> list[tuple[CrossSection, Any, Any]]:
    """At the points of a piece that bears a load: cross-section, torque of all tubes, force (3,) in the frame there."""
    piece, t = torsion.piece, torsion.piece.grid.tableau
    assert isinstance(piece, LoadedPiece)
    turn, before, felt = ca.SX([1, 0, 0, 0]), 0.0, []
    for k, x in enumerate(t.nodes.tolist()):
        u = torsion.curvature(before + (x - before) * GAUSS_POINTS)
        # From point to point: the frame turns by at most the bend of one piece, so one step is enough.
        turn, _ = magnus_quaternion(turn, ca.SX.zeros(3), u, piece.length * (x - before))
        before, nu = x, rotation_matrix(turn).T @ piece.push[:, k]
        felt.append((piece.section(piece.inner[:, k], x), ca.dot(piece.torsional_stiffness, torsion.twist[:, k]), nu))
    return felt


def energy_of(torsion: Torsion) -> Any:
    """Elastic energy of the piece, J: int kt g c w^2 / 2 + bending, g c w^2 = w (w + (g c - 1) w)."""
    piece, t = torsion.piece, torsion.piece.grid.tableau
    total: Any = 0.0
    for k, b in enumerate(t.weights.tolist()):
        w = torsion.twist[:, k]
        bending = piece.section(piece.inner[:, k], t.nodes[k]).bending_energy
        total += b * (ca.dot(piece.torsional_stiffness, w * (w + torsion.extra[:, k])) / 2 + bending)
    return piece.length * total


def motion_of(piece: Piece, twist: Any) -> tuple[Any, Any, Any]:
    """A piece of concentric tubes whose torsion `twist` (n, K) at its points is a control: defect (n, K) of theta,
    theta (n,) where it ends, elastic energy, J."""
    t, h = piece.grid.tableau, piece.length
    extra = twist * (ca.horzcat(*(ca.SX.ones(piece.grid.n_tubes) * piece.local(x).ease for x in t.nodes)) - 1)
    slope = twist + extra
    defect = piece.inner - ca.repmat(piece.theta, 1, piece.grid.degree) - h * slope @ t.matrix.T
    # As a control, w is independent of M: the gain that would change it along the piece is 0.
    free = Torsion(piece, twist, ca.SX.zeros(*twist.shape), extra, defect, (piece.theta, twist))
    return defect, piece.theta + h * slope @ t.weights, energy_of(free)


def shape_of(torsion: Torsion, fraction: Any = 1.0, *, steps: int = STEPS) -> list[tuple[Any, Any, Any]]:
    """(quaternion (4,), position (3,), fraction) relative to where the piece begins, after each of `steps` up to
    `fraction` of it, which may be a symbol."""
    turn, shift = ca.SX([1, 0, 0, 0]), ca.SX.zeros(3)
    out = []
    step = fraction / steps
    for k in range(steps):
        x = (k + GAUSS_POINTS) / steps
        u = torsion.curvature(fraction * ca.SX(ca.DM(x)) if isinstance(fraction, ca.SX) else fraction * x)
        turn, shift = magnus_quaternion(turn, shift, u, torsion.piece.length * step)
        out.append((turn, shift, (k + 1) * step))
    return out


def softened_fields(grid: Grid, length: Any, softness: tuple[Any, ...], end: Any, inner: Any) -> tuple[Any, Any]:
    """A Jacobi field of a piece of softened tubes, collocated as its torsion is.

    The fields y, v are those of d theta and d w at the state of the piece, with torsional stiffness (1 - margin) kt
    where w changes: y' = g c v + w (dg/dtheta) y,  v' = (dM/dtheta) y / ((1 - margin) kt). With y = 1, v = 0 at the
    tip, det y > 0 along the arm and det(y - |beta| v) > 0 at the plate if and only if the margin is larger.

    Args:
        softness: (n, n K) (dM/dtheta) / ((1 - margin) kt) at the points; of eccentric tubes also (n, n K) w dg/dtheta,
            and of these and of tubes made of pieces (n, K) g c.
        end: (2n,) y above v where the piece ends.  inner: (n, K) y at its points.

    Returns:
        (2n,) y above v where the piece begins; (n, K) defect of the collocated equations.
    """
    t, n, count = grid.tableau, grid.n_tubes, grid.degree
    gain, *stretching = softness
    y, v = end[:n], end[n:]
    gained = _at_points(gain, inner)
    # Backwards from the end: the integral from a point to the end has the weights b - a_kj.
    slope = ca.repmat(v, 1, count) - length * gained @ (t.weights - t.adjoint).T
    if stretching:
        slope = stretching[-1] * slope
    if len(stretching) > 1:
        slope += _at_points(stretching[0], inner)
    defect = inner - ca.repmat(y, 1, count) + length * slope @ (t.weights - t.matrix).T
    return ca.vertcat(y - length * slope @ t.weights, v - length * gained @ t.weights), defect


def _at_points(matrices: Any, columns: Any) -> Any:
    """(n, K) products of matrices (n, n K), side by side, with columns (n, K)."""
    n = columns.shape[0]
    return ca.horzcat(*(matrices[:, k * n : (k + 1) * n] @ columns[:, k] for k in range(columns.shape[1])))
