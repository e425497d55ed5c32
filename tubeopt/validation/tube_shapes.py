"""Shapes that the precurvature of a real tube has along its curved part.

- The heated shape: straight ends, and ramps next to them.
- A learned change of the precurvature u*_x and u*_y, a polynomial in arc length without a mean. Its mean about x is
  that of the curvature, its mean about y turns the tube. A natural twist u*_z of its own would be no more: to turn the
  frame of a round tube along its length changes u*_x and u*_y only.

Both make an ordinary tube of pieces: its energy, margin, snaps and certificate are those of any robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, legendre

from ..errors import InputError
from ..robots.pieces import Piece, Series, at, bent_along, part_of
from ..robots.tubes import Tube
from ..typing import Array

DEGREES = 6
"""Largest degree of the polynomials of a learned change: waves as short as a third of the curved part."""

MODES = 2 * DEGREES
"""Numbers of a learned change: of degree 1, 2, ... about x, then about y."""

# Lengths of pieces closer than this, m, are one: far below any dead length, far above round-off.
SAME_LENGTH = 1e-9

# (DEGREES + 1, DEGREES + 1) Chebyshev coefficients, in columns, of Legendre polynomials of root mean square 1.
TO_CHEBYSHEV = np.column_stack(
    [
        np.pad(chebyshev.poly2cheb(legendre.leg2poly([0.0] * j + [math.sqrt(2 * j + 1)])), (0, DEGREES - j))
        for j in range(DEGREES + 1)
    ]
)


class TubeShape(NamedTuple):
    """Precurvature of the curved part of a tube that was heated."""

    bend: float
    """Curvature about x between the ramps, without the learned change, 1/m."""
    dead: float
    """Length of the straight part at either end, m."""
    fade: float
    """Length of the ramp next to it, m."""
    learned: Array
    """(MODES,) learned change: the root mean square of every polynomial along the curved part, 1/m."""

    def pieces(self, length: float) -> tuple[Piece, ...]:
        """Pieces of a curved part of this length, m.

        Raises:
            InputError: straight ends and ramps are longer than the curved part.
        """
        return with_learned(heated_pieces(length, self.bend, self.dead, self.fade), self.learned)


def heated_pieces(length: float, curvature: float, dead: float, fade: float) -> tuple[Piece, ...]:
    """Pieces of a curved part with straight ends of length `dead` and linear ramps of length `fade` next to them, m.

    Raises:
        InputError: straight ends and ramps are longer than the curved part.
    """
    if dead + fade > length / 2:
        raise InputError(
            f"dead length and fade are {1e3 * dead:g} and {1e3 * fade:g} mm; together they must be at most half the "
            f"curved length of {1e3 * length:g} mm"
        )
    ramp, rest = (curvature / 2, curvature / 2), length - 2 * (dead + fade)
    parts = [
        (dead, 0.0),
        (fade, Series((0.0, fade), (ramp,)) if fade else 0.0),
        (rest, curvature),
        (fade, Series((0.0, fade), ((ramp[0], -ramp[1]),)) if fade else 0.0),
        (dead, 0.0),
    ]
    return tuple(Piece(part, (bend, 0.0, 0.0)) for part, bend in parts if part > 0)


def with_learned(pieces: Sequence[Piece], learned: Array) -> tuple[Piece, ...]:
    """Pieces of a curved part with a learned change (MODES,) added along it."""
    if not learned.any():
        return tuple(pieces)
    return bent_along(pieces, *(tuple((TO_CHEBYSHEV[:, 1:] @ part).tolist()) for part in np.split(learned, 2)))


def shape_of(tube: Tube, *, learned: bool = False) -> TubeShape | None:
    """Shape of a tube made of the pieces of a `TubeShape`; None for other tubes.

    Args:
        learned: whether a change along the tube is known to be a learned one. Otherwise it is as drawn.
    """
    pieces = tube.pieces
    if len(pieces) not in (1, 3, 5):
        return None
    middle = len(pieces) // 2
    mean, change = _polynomials(pieces, middle) if learned else (bend_of(pieces), np.zeros(MODES))
    first, second = (*(piece.length for piece in pieces[:middle]), 0.0, 0.0)[:2]
    # Of three pieces the outer ones are straight ends, or ramps.
    for dead, fade in ((first, second), (second, first)):
        shape = TubeShape(mean, dead, fade, change)
        try:
            again = shape.pieces(tube.curved_length)
        except InputError:
            continue
        if len(again) == len(pieces) and all(map(_alike, again, pieces)):
            return shape
    return None


def _alike(a: Piece, b: Piece) -> bool:
    """True if two pieces are the same but for round-off."""
    bare = replace(a, length=b.length, precurvature=b.precurvature) == b
    return bare and np.allclose(_samples(a), _samples(b), rtol=1e-9, atol=SAME_LENGTH)


def _samples(piece: Piece) -> list[float]:
    """Length of a piece, and its precurvature at places along it."""
    return [piece.length, *(at(q, s) for q in piece.precurvature for s in np.linspace(0, piece.length, 5).tolist())]


def bend_of(pieces: Sequence[Piece]) -> float:
    """Precurvature of the middle piece about x, 1/m; NaN if it varies or has another direction."""
    x, *others = pieces[len(pieces) // 2].precurvature
    return float(x) if isinstance(x, float) and not any(others) else math.nan


def _polynomials(pieces: Sequence[Piece], middle: int) -> tuple[float, Array]:
    """Mean about x, 1/m, and learned change (MODES,), of the polynomials of the middle piece along the whole."""
    length, before = pieces[middle].length, math.fsum(piece.length for piece in pieces[:middle])
    total = math.fsum(piece.length for piece in pieces)
    ends = 2 * np.array([-before, total - before]) / length - 1
    means, change = [], []
    for quantity in pieces[middle].precurvature[:2]:
        panels = quantity.coefficients if isinstance(quantity, Series) else ((quantity,),)
        if len(panels) > 1 or len(panels[0]) > DEGREES + 1:
            return math.nan, np.zeros(MODES)
        coefficients = np.pad(np.array(panels[0]), (0, DEGREES + 1 - len(panels[0])))
        mean, *rest = np.linalg.solve(TO_CHEBYSHEV, part_of(coefficients, ends))
        means.append(float(mean))
        change.append(rest)
    return means[0], np.concatenate(change)
