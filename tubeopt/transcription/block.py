"""The equilibrium block: unknowns and equations of one equilibrium, to be added to any nonlinear program.

On every collocated piece of length h, with Runge-Kutta matrix A and weights b,

    theta_k = theta + h sum_j A_kj g_j w_j,      w_k = w + h sum_j A_kj M_j / kt,

and the same with b to the next piece; pieces where torsion is linear have no points. The base gives
theta(0) = alpha + |beta| w(0), the tip w = 0 for every tube (a tube that has ended feels no moment, so w = 0 at the tip
is w = 0 at its own end).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..mechanics.torsion import cross_section
from .nlp import Builder
from .reduced import ReducedProblem
from .tableau import Tableau, tableau


@dataclass(frozen=True)
class Structure:
    """What makes two equilibrium blocks the same program but for numbers: the key under which it is built once."""

    n_tubes: int
    collocated: tuple[bool, ...]
    section: tuple[int, ...]
    family: str
    degree: int
    eccentric: bool

    @property
    def tableau(self) -> Tableau:
        """Collocation tableau of every collocated piece."""
        return tableau(self.family, self.degree)

    @property
    def n_pieces(self) -> int:
        """Number of pieces of the mesh."""
        return len(self.collocated)


def structure_of(problem: ReducedProblem) -> Structure:
    """Structure of a reduced problem's mesh."""
    mesh = problem.mesh
    return Structure(
        n_tubes=problem.assembly.n_tubes,
        collocated=tuple(bool(c) for c in mesh.collocated),
        section=tuple(int(s) for s in mesh.section),
        family=mesh.tableau.family,
        degree=mesh.tableau.degree,
        eccentric=problem.assembly.eccentric,
    )


@dataclass(frozen=True, eq=False)
class BlockInput:
    """Given or unknown quantities of a block, numbers or expressions.

    rotations, transmission, torsional_stiffness: (n,); length: (P,) of the pieces; stiffness, moment: (n, P) kb_i of
    the tubes present and m_i of the tubes curved on each piece; offset, offset_angle: (n,) or None.
    """

    rotations: Any
    transmission: Any
    torsional_stiffness: Any
    length: Any
    stiffness: Any
    moment: Any
    offset: Any = None
    offset_angle: Any = None


def parameters(builder: Builder, structure: Structure) -> BlockInput:
    """A block input of parameters, in the order of `parameter_values`."""
    n, pieces = structure.n_tubes, structure.n_pieces
    rotations, transmission, torsional = (builder.parameter(n) for _ in range(3))
    length = builder.parameter(pieces)
    stiffness, moment = (ca.reshape(builder.parameter(n * pieces), n, pieces) for _ in range(2))
    place = tuple(builder.parameter(n) for _ in range(2)) if structure.eccentric else (None, None)
    return BlockInput(rotations, transmission, torsional, length, stiffness, moment, *place)


def parameter_values(problem: ReducedProblem, rotations: Any) -> Any:
    """Numbers for `parameters` at the given base rotations (n,)."""
    assembly, mesh = problem.assembly, problem.mesh
    place = [assembly.offset, assembly.offset_angle] if assembly.eccentric else []
    return np.concatenate(
        [
            rotations,
            assembly.transmission,
            assembly.torsional_stiffness,
            mesh.length,
            problem.piece_stiffness.ravel(),
            problem.piece_moment.ravel(),
            *place,
        ]
    )


@dataclass(frozen=True, eq=False)
class Block:
    """Expressions of one equilibrium: theta and w where each piece begins (n, P), and at its points (n, C K)."""

    start_rotation: Any
    start_twist: Any
    rotation: Any
    twist: Any


def _labels(what: str, structure: Structure, piece: int, points: bool) -> list[str]:
    section = structure.section[piece]
    if not points:
        return [f"{what}, tube {i + 1}, section {section + 1}" for i in range(structure.n_tubes)]
    first = piece - structure.section.index(section)
    return [
        f"{what}, tube {i + 1}, section {section + 1}, point {first * structure.degree + k + 1}"
        for k in range(structure.degree)
        for i in range(structure.n_tubes)
    ]


def add_equilibrium(builder: Builder, structure: Structure, given: BlockInput) -> Block:
    """Add the unknowns and equations of one equilibrium; a square system if the input is all given."""
    n, degree = structure.n_tubes, structure.degree
    t = structure.tableau
    starts, points = [], []
    for piece in range(structure.n_pieces):
        starts.append(_state(builder, structure, piece, False))
        points.append(_state(builder, structure, piece, True) if structure.collocated[piece] else None)
    zero = ca.SX.zeros(n)
    theta, twist = starts[0] if starts else (given.rotations, zero)
    names = [f"base rotation, tube {i + 1}" for i in range(n)]
    builder.constrain(names, theta - given.rotations - given.transmission * twist)
    for piece, inner in enumerate(points):
        theta, twist = starts[piece]
        h = given.length[piece]
        if inner is None:
            end = theta + h * twist, twist
        else:
            slope, gain = _rates(structure, given, piece, *inner)
            names = _labels("rotation equation", structure, piece, True)
            builder.constrain(names, ca.vec(inner[0] - ca.repmat(theta, 1, degree) - h * slope @ t.matrix.T))
            names = _labels("torsion equation", structure, piece, True)
            builder.constrain(names, ca.vec(inner[1] - ca.repmat(twist, 1, degree) - h * gain @ t.adjoint.T))
            end = theta + h * slope @ t.weights, twist + h * gain @ t.weights
        last = piece == structure.n_pieces - 1
        if not last:
            names = _labels("continuity of rotation", structure, piece + 1, False)
            builder.constrain(names, starts[piece + 1][0] - end[0])
        names = [f"torsion at the end, tube {i + 1}" for i in range(n)]
        if not last:
            names = _labels("continuity of torsion", structure, piece + 1, False)
        builder.constrain(names, end[1] - (zero if last else starts[piece + 1][1]))
    inside = [inner for inner in points if inner is not None]
    return Block(
        start_rotation=ca.horzcat(*(s[0] for s in starts)),
        start_twist=ca.horzcat(*(s[1] for s in starts)),
        rotation=ca.horzcat(*(s[0] for s in inside)),
        twist=ca.horzcat(*(s[1] for s in inside)),
    )


def _state(builder: Builder, structure: Structure, piece: int, points: bool) -> tuple[Any, Any]:
    """theta and w where a piece begins (n, 1), or at its points (n, K)."""
    columns = structure.degree if points else 1
    pair = tuple(
        ca.reshape(builder.variable(_labels(what, structure, piece, points)), structure.n_tubes, columns)
        for what in ("rotation", "torsion")
    )
    return pair[0], pair[1]


def _rates(structure: Structure, given: BlockInput, piece: int, theta: Any, twist: Any) -> tuple[Any, Any]:
    """theta' and w' (n, K) at the points of a piece."""
    slope, gain = [], []
    for k in range(structure.degree):
        here = cross_section(
            theta[:, k], given.stiffness[:, piece], given.moment[:, piece], given.offset, given.offset_angle
        )
        slope.append(here.stretch * twist[:, k])
        gain.append(here.moment / given.torsional_stiffness)
    return ca.horzcat(*slope), ca.horzcat(*gain)


def add_energy(builder: Builder, structure: Structure, given: BlockInput) -> Block:
    """Add the optimal control problem behind an equilibrium: least energy over theta with control w = theta'.

    Only for concentric tubes, whose equilibria are its stationary points. `given.transmission` may be 0: a transmission
    without length stores no energy, so its idle twist is given the cost of a whole piece.
    """
    n, degree = structure.n_tubes, structure.degree
    t = structure.tableau
    base = builder.variable([f"torsion of the transmission, tube {i + 1}" for i in range(n)])
    kt = given.torsional_stiffness
    scale = ca.sum1(kt) / ca.sum1(given.length)
    weight = ca.if_else(given.transmission > 0, given.transmission, ca.sum1(given.length))
    builder.minimise(ca.dot(kt * weight, base**2) / 2 / scale)
    theta = given.rotations + given.transmission * base
    starts, start_twists, inside, controls = [], [], [], []
    for piece in range(structure.n_pieces):
        h = given.length[piece]
        starts.append(theta)
        if not structure.collocated[piece]:
            w = builder.variable(_labels("torsion", structure, piece, False))
            builder.minimise(h * ca.dot(kt, w**2) / 2 / scale)
            start_twists.append(w)
            theta = theta + h * w
        else:
            inner, w = _state(builder, structure, piece, True)
            names = _labels("rotation equation", structure, piece, True)
            builder.constrain(names, ca.vec(inner - ca.repmat(theta, 1, degree) - h * w @ t.matrix.T))
            for k in range(degree):
                energy = cross_section(inner[:, k], given.stiffness[:, piece], given.moment[:, piece]).bending_energy
                builder.minimise(h * t.weights[k] * (ca.dot(kt, w[:, k] ** 2) / 2 + energy) / scale)
            inside.append(inner)
            controls.append(w)
            start_twists.append(w[:, 0])
            theta = theta + h * w @ t.weights
        if piece + 1 < structure.n_pieces:
            following = builder.variable(_labels("rotation", structure, piece + 1, False))
            builder.constrain(_labels("continuity of rotation", structure, piece + 1, False), following - theta)
            theta = following
    return Block(ca.horzcat(*starts), ca.horzcat(*start_twists), ca.horzcat(*inside), ca.horzcat(*controls))
