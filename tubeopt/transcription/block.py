"""The equilibrium block: unknowns and equations of one equilibrium, to be added to any nonlinear program.

Every piece of the mesh is one of `block.piece`; pieces where torsion is linear have no points. The base gives
theta(0) = alpha + |beta| w(0), the tip w = 0 for every tube (a tube that has ended feels no moment, so w = 0 at the tip
is w = 0 at its own end).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..physics.torsion import cross_section
from .collocated import Grid, Piece, Torsion, torsion_of, untwisting
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
    def grid(self) -> Grid:
        """What its pieces have in common."""
        return Grid(self.n_tubes, self.family, self.degree, self.eccentric)

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
    """Expressions of one equilibrium: torsion of every piece, and theta (n, C K) at the points of those collocated."""

    torsion: tuple[Torsion, ...]
    rotation: Any


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
    n, pieces = structure.n_tubes, structure.n_pieces
    torsion = [_piece(builder, structure, given, piece) for piece in range(pieces)]
    zero = ca.SX.zeros(n)
    theta, twist = (torsion[0].piece.theta, torsion[0].piece.twist) if torsion else (given.rotations, zero)
    names = [f"base rotation, tube {i + 1}" for i in range(n)]
    builder.constrain(names, theta - given.rotations - given.transmission * twist)
    for piece, here in enumerate(torsion):
        if structure.collocated[piece]:
            builder.constrain(_labels("torsion equation", structure, piece, True), ca.vec(here.defect))
        if piece + 1 < pieces:
            ahead = torsion[piece + 1].piece
            names = _labels("continuity of rotation", structure, piece + 1, False)
            builder.constrain(names, ahead.theta - here.end[0])
            names = _labels("continuity of torsion", structure, piece + 1, False)
            builder.constrain(names, ahead.twist - here.end[1])
        else:
            builder.constrain([f"torsion at the end, tube {i + 1}" for i in range(n)], here.end[1])
    inside = [here.piece.inner for here, points in zip(torsion, structure.collocated, strict=True) if points]
    return Block(tuple(torsion), ca.horzcat(*inside))


def _piece(builder: Builder, structure: Structure, given: BlockInput, piece: int) -> Torsion:
    """The unknowns of one piece, and its torsion."""
    n, points = structure.n_tubes, structure.collocated[piece]
    theta, twist = (builder.variable(_labels(what, structure, piece, False)) for what in ("rotation", "torsion"))
    inner = ca.SX.zeros(n, structure.degree)
    if points:
        inner = ca.reshape(builder.variable(_labels("rotation", structure, piece, True)), n, structure.degree)
    part = Piece(
        grid=structure.grid,
        theta=theta,
        twist=twist,
        inner=inner,
        stiffness=given.stiffness[:, piece],
        moment=given.moment[:, piece],
        torsional_stiffness=given.torsional_stiffness,
        length=given.length[piece],
        place=(given.offset, given.offset_angle) if structure.eccentric else (),
    )
    return torsion_of(part) if points else untwisting(part)


def _state(builder: Builder, structure: Structure, piece: int) -> tuple[Any, Any]:
    """theta and w (n, K) at the points of a piece."""
    pair = tuple(
        ca.reshape(builder.variable(_labels(what, structure, piece, True)), structure.n_tubes, structure.degree)
        for what in ("rotation", "torsion")
    )
    return pair[0], pair[1]


def add_energy(builder: Builder, structure: Structure, given: BlockInput) -> Any:
    """Add the optimal control problem behind an equilibrium: least energy over theta with control w = theta'.

    Only for concentric tubes, whose equilibria are its stationary points. `given.transmission` may be 0: a transmission
    without length stores no energy, so its idle twist is given the cost of a whole piece. Returns theta (n, C K).
    """
    n, degree = structure.n_tubes, structure.degree
    t = structure.tableau
    base = builder.variable([f"torsion of the transmission, tube {i + 1}" for i in range(n)])
    kt = given.torsional_stiffness
    scale = ca.sum1(kt) / ca.sum1(given.length)
    weight = ca.if_else(given.transmission > 0, given.transmission, ca.sum1(given.length))
    builder.minimise(ca.dot(kt * weight, base**2) / 2 / scale)
    theta = given.rotations + given.transmission * base
    inside = []
    for piece in range(structure.n_pieces):
        h = given.length[piece]
        if not structure.collocated[piece]:
            w = builder.variable(_labels("torsion", structure, piece, False))
            builder.minimise(h * ca.dot(kt, w**2) / 2 / scale)
            theta = theta + h * w
        else:
            inner, w = _state(builder, structure, piece)
            names = _labels("rotation equation", structure, piece, True)
            builder.constrain(names, ca.vec(inner - ca.repmat(theta, 1, degree) - h * w @ t.matrix.T))
            for k in range(degree):
                energy = cross_section(inner[:, k], given.stiffness[:, piece], given.moment[:, piece]).bending_energy
                builder.minimise(h * t.weights[k] * (ca.dot(kt, w[:, k] ** 2) / 2 + energy) / scale)
            inside.append(inner)
            theta = theta + h * w @ t.weights
        if piece + 1 < structure.n_pieces:
            following = builder.variable(_labels("rotation", structure, piece + 1, False))
            builder.constrain(_labels("continuity of rotation", structure, piece + 1, False), following - theta)
            theta = following
    return ca.horzcat(*inside)
