"""A tube as its mold holds it, and as it comes out: spring-back of every curvature, shrinkage of the length (SI)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev

from ...errors import InputError
from ...robots.pieces import Piece
from ...robots.series import Quantity, Series, breaks_of, on_panels, times, values, vary, zeros
from ...robots.tubes import Tube
from ...typing import Array
from .springback import Springback

ORDER = 24
"""Degree of the polynomials by which a curvature that springs back unevenly is drawn."""

PLANAR = 1e-9
"""Part of the largest curvature that may point out of the plane of a planar bend."""


_NODES = chebyshev.chebpts1(ORDER + 1)
_INTERPOLATE = np.linalg.inv(chebyshev.chebvander(_NODES, ORDER))


def tube_in_mold(tube: Tube, back: Springback) -> Tube:
    """The tube as its mold holds it: every curvature that springs back to the tube's, the curved part longer by what
    it shrinks. The natural twist is as given, since trials of planar bends say nothing about it."""
    return _changed(tube, back.mold, 1 / (1 - back.shrinkage), even=back.slope == 0)


def tube_from_mold(held: Tube, back: Springback) -> Tube:
    """The tube that comes out of a mold that holds it so: the reverse of `tube_in_mold`."""
    return _changed(held, back.obtained, 1 - back.shrinkage, even=back.slope == 0)


def _changed(tube: Tube, curve: Callable[[float], float], factor: float, *, even: bool) -> Tube:
    """The tube with another curvature in place of each, and its curved part `factor` times as long."""
    largest = curve(tube.curvature)
    if not tube.general:
        return replace(tube, curvature=largest, curved_length=tube.curved_length * factor)
    chain = tuple(_changed_piece(piece, curve, factor, even=even) for piece in tube.pieces)
    length = math.fsum(piece.length for piece in chain)
    return replace(tube, curved_length=length, curvature=max(piece.largest_curvature for piece in chain), pieces=chain)


def _changed_piece(piece: Piece, curve: Callable[[float], float], factor: float, *, even: bool) -> Piece:
    x, y, z = piece.precurvature

    def gain(size: float) -> float:
        # The limit of a curvature that vanishes, where 0 / 0 would stand.
        size = max(size, 1e-9)
        return curve(size) / size

    if even or not vary((x, y)):
        at = 1.0 if even else float(np.hypot(x, y))
        x, y = times(x, gain(at)), times(y, gain(at))
    else:
        breaks = _smooth_stretches(x, y, piece.length)
        own = x, y

        def bent(quantity: Quantity, s: Array) -> Array:
            sizes = np.hypot(values(own[0], s), values(own[1], s))
            return np.asarray(values(quantity, s) * np.array([gain(size) for size in sizes]))

        x, y = (0.0 if q == 0.0 else _fitted(partial(bent, q), breaks) for q in own)
    return replace(piece, precurvature=(x, y, z)).stretched(factor)


def _smooth_stretches(x: Quantity, y: Quantity, length: float) -> list[float]:
    """Arc lengths between which the size of the curvature is smooth: it has a corner where the bend changes side."""
    breaks = breaks_of([x, y], length)
    found = set(breaks.tolist())
    for quantity in (x, y):
        for (low, high), coefficients in zip(pairwise(breaks), on_panels(quantity, breaks), strict=True):
            inside = zeros(coefficients, 1e-7)
            found |= {float((low + high) / 2 + r * (high - low) / 2) for r in inside}
    return sorted(found)


def _fitted(function: Callable[[Array], Array], breaks: list[float]) -> Series:
    """A function that is smooth between breaks as polynomials to round-off."""
    low, high = np.array(breaks[:-1]), np.array(breaks[1:])
    scale = float(np.abs(function(np.linspace(0.0, breaks[-1], 200))).max())
    ends, table = [0.0], []
    stack = [(a, b, 0) for a, b in zip(low[::-1], high[::-1], strict=True)]
    while stack:
        a, b, depth = stack.pop()
        c = _INTERPOLATE @ function((a + b) / 2 + _NODES * (b - a) / 2)
        if depth < 8 and (np.abs(c[-3:]) > 1e-12 * scale).any():
            stack += [((a + b) / 2, b, depth + 1), (a, (a + b) / 2, depth + 1)]
            continue
        ends.append(float(b))
        table.append(tuple(chebyshev.chebtrim(c, 1e-15 * scale).tolist()))
    return Series(tuple(ends), tuple(table))


def bend_direction(tube: Tube) -> tuple[float, float] | None:
    """The line of the cross-section (unit, in its right half) along which all precurvature lies, or None."""
    if tube.curvature == 0 or tube.curved_length == 0:
        return 1.0, 0.0
    u = np.vstack([_sampled(piece) for piece in tube.chain])
    sizes = np.hypot(u[:, 0], u[:, 1])
    largest = float(sizes.max())
    ex, ey = u[int(sizes.argmax()), :2] / largest
    if ex < 0 or (ex == 0 and ey < 0):
        ex, ey = -ex, -ey
    out_of_plane = np.abs(u[:, 0] * ey - u[:, 1] * ex).max()
    if out_of_plane > PLANAR * largest or np.abs(u[:, 2]).max() > PLANAR * largest:
        return None
    return (1.0, 0.0) if abs(ey) <= PLANAR else (float(ex), float(ey))


def _sampled(piece: Piece) -> Array:
    """(N, 3) u* of a piece, dense in every panel."""
    breaks = breaks_of(piece.precurvature, piece.length)
    s = np.unique(np.concatenate([np.linspace(a, b, 3 * ORDER) for a, b in pairwise(breaks)]))
    return np.column_stack([values(q, s) for q in piece.precurvature])


def signed_curvature(tube: Tube) -> list[tuple[float, Array]]:
    """Of a planar tube: per panel of its curved part the length (m) and Chebyshev coefficients of the curvature (1/m),
    positive about the bend direction."""
    direction = bend_direction(tube)
    if direction is None:
        raise InputError("the tube is a space curve; a plate supports planar bends only")
    out: list[tuple[float, Array]] = []
    for piece in tube.chain:
        x, y, _ = piece.precurvature
        breaks = breaks_of([x, y], piece.length)
        panels = zip(np.diff(breaks), on_panels(x, breaks), on_panels(y, breaks), strict=True)
        for length, cx, cy in panels:
            both = chebyshev.chebadd(direction[0] * cx, direction[1] * cy)
            out.append((float(length), np.asarray(both, dtype=float)))
    return out
