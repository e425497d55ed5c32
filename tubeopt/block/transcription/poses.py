"""Frames at the points of the pieces of an arm, and integrals up to its shape points."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...typing import Array
from .arm import ArmShape
from .collocated import ENDS
from .tableau import Tableau, tableau


@lru_cache(maxsize=16)
def hermite(family: str, degree: int) -> Array:
    """(K, 9) values at the points of the polynomial with given values at ENDS and slopes at ENDS but the first."""
    x, power = tableau(family, degree).nodes, np.arange(2 * len(ENDS) - 1)
    rates = power * ENDS[1:, None] ** np.maximum(power - 1, 0)
    conditions = np.concatenate([ENDS[:, None] ** power, rates])
    return np.asarray(np.linalg.solve(conditions.T, (x[:, None] ** power).T).T)


def frames_at_points(t: Tableau, length: Array, shape: ArmShape) -> Array:
    """(P, K, 3, 3) frames at the points of pieces of lengths (P,), from those at the shape points: polynomials through
    those of a piece, with the slopes R hat(u) there (where it begins, u is another one's)."""
    pieces, count = len(length), 2 * len(ENDS) - 1
    index = shape_points(pieces)
    frame, step = shape.frame[index], length[:, None, None, None]
    turning = (shape.curvature[index] @ _HAT).reshape(frame.shape)
    frames = np.concatenate([frame, step * (frame @ turning)[:, 1:]], 1)
    inside = hermite(t.family, t.degree) @ frames.reshape(pieces, count, 9)
    return np.asarray(inside.reshape(pieces, t.degree, 3, 3))


_HAT = np.array([[0.0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0]])
"""hat(u) by rows from (u_x, u_y)."""


@lru_cache(maxsize=64)
def shape_points(pieces: int) -> NDArray[np.intp]:
    """(P, 5) which of the shape points lie at ENDS of every piece."""
    steps = len(ENDS) - 1
    return np.asarray(np.arange(pieces)[:, None] * steps + np.arange(steps + 1), dtype=np.intp)


_ENDS = tuple(ENDS.tolist())


def cumulate(t: Tableau, values: Array) -> Array:
    """Integrals (m, ...) from the plate to every shape point of values (P, K, ...) at the points, per piece."""
    flat = values.reshape(*values.shape[:2], int(np.prod(values.shape[2:])))
    inner = (t.basis(_ENDS, 1) @ flat).reshape(len(flat), len(ENDS), *values.shape[2:])
    ends = np.concatenate([np.zeros((1, *inner.shape[2:])), np.cumsum(inner[:, -1], axis=0)])
    table = ends[:-1, None] + inner[:, 1:]
    return np.concatenate([ends[:1], table.reshape(-1, *table.shape[2:])])
