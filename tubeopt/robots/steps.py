"""Tubes along which everything goes in steps: straight parts, arcs, helices, each with constant stiffnesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError, positive
from ..typing import Array
from .concentric import ConcentricRobot
from .pieces import Piece
from .series import Quantity, Series
from .tubes import Tube, stretches

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""By which means along a step are taken."""


@dataclass(frozen=True, eq=False)
class Steps:
    """n tubes of up to C stretches; shorter chains are filled up with stretches without length.

    cuts: (n, C) where stretches end, from the held end, m; the first is the straight part.  bending, torsional,
    curvature, phase, twist: (n, C) EI, GJ, |u*_xy|, the direction of that in the tube's own frame, and u*_z.
    wound: (n, C) natural turn where stretches begin.
    """

    cuts: Array
    bending: Array
    torsional: Array
    curvature: Array
    phase: Array
    twist: Array
    wound: Array

    @property
    def compliance(self) -> Array:
        """(n, C) int ds / GJ from the held end to where stretches begin, 1/(N m)."""
        lengths = np.diff(self.cuts, axis=1, prepend=0.0)
        return np.cumsum(lengths / self.torsional, axis=1) - lengths / self.torsional


def steps_of(tubes: Sequence[Tube], what: str) -> Steps:
    """The stretches of tubes; `what` says for whom anything else is too much.

    Raises:
        InputError: curvature, twist or stiffness varies along a piece.
    """
    rows = []
    for i, tube in enumerate(tubes, start=1):
        chain = stretches(tube)
        if tube.straight_length == 0:
            chain = [(0.0, (0.0, 0.0, 0.0), *chain[0][2:]), *chain]
        for _, u, bending, torsional in chain:
            if any(isinstance(q, Series) for q in (*u, bending, torsional)):
                raise InputError(
                    f"tube {i} has a piece that varies along its length; {what} takes straight pieces, arcs and "
                    "helices of constant stiffness: `in_steps` (steps_mm of a plan) makes such of it"
                )
        rows.append([(length, *u, bending, torsional) for length, u, bending, torsional in chain])
    most = max(2, *(len(row) for row in rows))
    table = np.array([[*row, *[(0.0, *row[-1][1:])] * (most - len(row))] for row in rows], dtype=float)
    length, x, y, z, bending, torsional = table.transpose(2, 0, 1)
    wound = np.cumsum(length * z, axis=1) - length * z
    return Steps(np.cumsum(length, axis=1), bending, torsional, np.hypot(x, y), np.arctan2(y, x), z, wound)


def in_steps(robot: ConcentricRobot, longest: float) -> ConcentricRobot:
    """The robot with every piece that varies along its length cut into equal steps, of at most `longest` (m), each with
    the mean precurvature, bending stiffness and torsional compliance of where it is.

    What is found of it is about that robot. Its tips are off by the square of the step: how far, forward kinematics of
    both tells.

    Raises:
        InputError: `longest` is not above 0, or a tube in steps is none.

    Examples:
        >>> import numpy as np, tubeopt
        >>> varying = tubeopt.Piece(0.06, lambda s: 8 + 100 * s)
        >>> robot = tubeopt.ConcentricRobot((tubeopt.Tube.of_pieces(1e-3, 0.8e-3, [varying]),))
        >>> rough = tubeopt.in_steps(robot, 5e-3)
        >>> len(rough.tubes[0].pieces)
        12
        >>> tips = [tubeopt.forward_kinematics(one, [0.0]).tip_position for one in (robot, rough)]
        >>> round(float(np.linalg.norm(tips[1] - tips[0])) * 1e6, 1)
        12.3
    """
    positive("longest step", longest)
    return replace(robot, tubes=tuple(_tube_in_steps(tube, longest) for tube in robot.tubes))


def _tube_in_steps(tube: Tube, longest: float) -> Tube:
    pieces = [part for piece in tube.pieces for part in _piece_in_steps(piece, longest)]
    if len(pieces) == len(tube.pieces):
        return tube
    return replace(tube, curvature=max(piece.largest_curvature for piece in pieces), pieces=tuple(pieces))


def _piece_in_steps(piece: Piece, longest: float) -> list[Piece]:
    parts = *piece.precurvature, piece.bending_stiffness, piece.torsional_stiffness
    if not any(isinstance(part, Series) for part in parts):
        return [piece]
    count = max(2, int(np.ceil(piece.length / longest - 1e-9)))
    places = (np.arange(count)[:, None] + (NODES + 1) / 2) * (piece.length / count)
    x, y, z, kb = (_means(part, places) for part in parts[:4])
    kt = _means(piece.torsional_stiffness, places, -1)
    return [
        replace(piece, length=piece.length / count, precurvature=u, bending_stiffness=b, torsional_stiffness=t)
        for u, b, t in zip(zip(x, y, z, strict=True), kb, kt, strict=True)
    ]


def _means(quantity: Quantity | None, places: Array, power: int = 1) -> list[Any]:
    """Mean of a quantity, or of its reciprocal, in every step."""
    if not isinstance(quantity, Series):
        return [quantity] * len(places)
    means: list[Any] = ((quantity(places) ** power @ WEIGHTS / 2) ** power).tolist()
    return means
