"""Tubes along which everything goes in steps: straight parts, arcs, helices, each with constant stiffnesses.

A piece that varies along its length is cut into equal steps, each with the mean precurvature, bending stiffness and
torsional compliance of where it is. Its curve is off by no more than about |du*/ds| L h^2 / 12 in steps of h.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..typing import Array
from .pieces import Piece
from .series import Quantity, Series, values, vary
from .tubes import Tube, stretches

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""By which means along a step are taken."""

LEAST_STEPS, MOST_STEPS, OFF = 4, 12, 5e-5
"""Steps of a piece that varies; share of its length by which its curve may be off where fewer than the most do."""


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


def steps_of(tubes: Sequence[Tube]) -> Steps:
    """The stretches of tubes; of those that vary along a piece, to some 0.01 % of their length."""
    rows = []
    for tube in map(_in_steps, tubes):
        chain = stretches(tube)
        if tube.straight_length == 0:
            chain = [(0.0, (0.0, 0.0, 0.0), *chain[0][2:]), *chain]
        rows.append([(length, *u, bending, torsional) for length, u, bending, torsional in chain])
    most = max(2, *(len(row) for row in rows))
    table = np.array([[*row, *[(0.0, *row[-1][1:])] * (most - len(row))] for row in rows], dtype=float)
    length, x, y, z, bending, torsional = table.transpose(2, 0, 1)
    wound = np.cumsum(length * z, axis=1) - length * z
    return Steps(np.cumsum(length, axis=1), bending, torsional, np.hypot(x, y), np.arctan2(y, x), z, wound)


def varies(tubes: Sequence[Tube]) -> bool:
    """Whether anything varies along a piece of a tube."""
    return any(vary((*u, *stiff)) for tube in tubes for _, u, *stiff in stretches(tube))


def _in_steps(tube: Tube) -> Tube:
    pieces = [part for piece in tube.pieces for part in _steps(piece)]
    if len(pieces) == len(tube.pieces):
        return tube
    return replace(tube, curvature=max(piece.largest_curvature for piece in pieces), pieces=tuple(pieces))


def _steps(piece: Piece) -> list[Piece]:
    parts = *piece.precurvature, piece.bending_stiffness, piece.torsional_stiffness
    if not vary(parts):
        return [piece]
    count = _count(piece)
    places = (np.arange(count)[:, None] + (NODES + 1) / 2) * (piece.length / count)
    x, y, z, kb = (_means(part, places) for part in parts[:4])
    kt = _means(piece.torsional_stiffness, places, -1)
    return [
        replace(piece, length=piece.length / count, precurvature=u, bending_stiffness=b, torsional_stiffness=t)
        for u, b, t in zip(zip(x, y, z, strict=True), kb, kt, strict=True)
    ]


def _count(piece: Piece) -> int:
    """Steps of a piece that varies."""
    s = np.linspace(0.0, piece.length, 8 * MOST_STEPS + 1)
    x, y, z = (values(q, s) for q in piece.precurvature)
    turned = np.hypot(x, y).max() * np.ptp(z) / 2
    fast = float(np.hypot(np.gradient(x, s), np.gradient(y, s)).max() + turned)
    return int(np.clip(np.ceil(piece.length * np.sqrt(fast / (12 * OFF))), LEAST_STEPS, MOST_STEPS))


def _means(quantity: Quantity | None, places: Array, power: int = 1) -> list[Any]:
    """Mean of a quantity, or of its reciprocal, in every step."""
    if not isinstance(quantity, Series):
        return [quantity] * len(places)
    means: list[Any] = ((quantity(places) ** power @ WEIGHTS / 2) ** power).tolist()
    return means
