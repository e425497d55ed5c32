"""From dimensions of pieces in numbers back to tubes, and from tubes to such dimensions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev

from ..errors import InputError
from ..robots.pieces import Piece
from ..robots.series import Quantity, Series
from ..robots.tubes import Tube
from ..typing import Array
from .transcription.chain import Chain, chain_of, own_stiffness, panels
from .transcription.section_properties import CHANNELS


def tubes_at(tubes: Sequence[Tube], given: Mapping[str, Array]) -> tuple[Tube, ...]:
    """Tubes at dimensions in numbers."""
    chain = chain_of(tuple(tubes))
    laid = panels(chain, {name: ca.DM(value) for name, value in given.items()})
    width, table = (np.array(ca.DM(part)) for part in (laid.width, laid.table))
    channels = table.reshape(len(width), CHANNELS, chain.detail)
    turning = np.array([chebyshev.chebder(row) for row in channels[:, 4]]) / (width / 2)
    out = []
    for i, tube in enumerate(tubes):
        kb, kt = (float(given[name][i]) for name in ("bending_stiffness", "torsional_stiffness"))
        pieces: list[Piece] = []
        for k in np.flatnonzero(chain.owner == i).tolist():
            rows = np.flatnonzero(chain.piece == k).tolist()
            joints = np.concatenate([[0.0], np.cumsum(width[rows, 0])])
            shapes = (*(channels[rows, c] for c in range(4)), turning[rows])
            bending, torsional, x, y, z = (_quantity(joints, shape) for shape in shapes)
            own = (None if value == b else value for value, b in zip((bending, torsional), (kb, kt), strict=True))
            slots = tube.pieces[len(pieces)].slots if tube.pieces else None
            pieces.append(Piece(float(joints[-1]), (x, y, z), next(own), next(own), slots))
        out.append(_tube(tube, pieces, float(given["straight_length"][i]), (kb, kt)))
    return tuple(out)


def _quantity(joints: Array, table: Array) -> Quantity:
    rows = [chebyshev.chebtrim(row) for row in table]
    first = float(rows[0][0])
    if all(len(row) == 1 and row[0] == first for row in rows):
        return first
    return Series(tuple(joints.tolist()), tuple(tuple(row.tolist()) for row in rows))


def _tube(tube: Tube, pieces: list[Piece], straight: float, stiffness: tuple[float, float]) -> Tube:
    """A tube of these pieces."""
    bend, chain = max((piece.largest_curvature for piece in pieces), default=0.0), tuple(pieces)
    # A tube of pieces stays one, even where they are arcs about x: so do the unknowns of the block.
    if not tube.general and all(piece.plain for piece in pieces):
        bend, chain = (float(pieces[0].precurvature[0]) if pieces else tube.curvature), ()
    return remade(
        tube,
        straight_length=straight,
        curved_length=math.fsum(piece.length for piece in pieces),
        curvature=bend,
        bending_stiffness=stiffness[0],
        torsional_stiffness=stiffness[1],
        pieces=chain,
    )


def remade(tube: Tube, **own: Any) -> Tube:
    """A tube with other dimensions or pieces; a stiffness that is not changed keeps following the cross-section."""
    stiffness = ("bending_stiffness", "torsional_stiffness")
    return replace(tube, **{k: v for k, v in own.items() if k not in stiffness or v != getattr(tube, k)})


def piece_numbers(tubes: Sequence[Tube], like: Chain) -> dict[str, Array]:
    """PIECES of tubes, as changes of those behind `like`."""
    own = chain_of(tuple(tubes))
    if own.owner.tolist() != like.owner.tolist() or own.piece.tolist() != like.piece.tolist():
        raise InputError("the pieces of the tubes differ from those of the block")
    start = dict(own.start)
    first = [like.piece.tolist().index(k) for k in range(len(like.owner))]
    turned = np.arctan2(own.y, own.x)[first, 0] - np.arctan2(like.y, like.x)[first, 0]
    start["piece_plane"] = (turned + np.pi) % (2 * np.pi) - np.pi
    for name, mine, old in (("bending", own.kb, like.kb), ("torsion", own.kt, like.kt)):
        ratio = mine[first, 0] / own_stiffness(own, mine)[first] / (old[first, 0] / own_stiffness(like, old)[first])
        start[f"piece_{name}_factor"] = ratio
    return start
