"""How well the air conducts heat between a round tube and the groove in which it lies, by a solution in the plane.

The thermal model has shells of mold around the tube behind an even gap of air. A groove is square, wider than the tube,
and the tube lies on its floor and against a wall; the mold beyond conducts some three times (board) to a thousand times
(steel) as well as air. Heat flows in the plane across the tube, steady,

    div(k grad T) = 0,   T = 1 on the tube,  0 on a circle far away,  k that of air within the groove, else of the mold,

by linear finite elements on rays from the tube's axis. The even gap is the one that makes the model's total resistance
to heat that of this solution. Where a tube touches a wall that conducts well, nearly all heat takes that way; a board
spreads it first, so that it hardly matters there where the tube lies.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ...typing import Array

STANDOFF = 10e-6
"""Air between the tube and what it lies on, m: the roughness of a milled face, and oxide; assumed."""

FAR = 4.0
"""Least radius of the circle far away, in diameters of the tube: what tells a square from a circle dies out before."""

RAYS, AIR_RINGS, MOLD_RINGS = 240, 8, 24
GRADING = 3.0
"""How much finer the rings of the mold are at the groove than far away, as a logarithm."""

LEAST_PLAY = 1e-3
"""Least air on any side, in diameters of the tube, for which the elements are fine enough."""


@dataclass(frozen=True)
class Lie:
    """Where a tube lies in the cross-section of its groove: air at the right wall, lid, left wall and floor, m."""

    right: float
    top: float
    left: float
    bottom: float

    @classmethod
    def leaning(cls, diameter: float, width: float, depth: float, standoff: float = STANDOFF) -> Lie:
        """On the floor and against one wall, as a bent tube lies that is pressed into its groove."""
        side, up = min(standoff, 0.5 * (width - diameter)), min(standoff, 0.5 * (depth - diameter))
        return cls(width - diameter - side, depth - diameter - up, side, up)


@functools.lru_cache(maxsize=256)
def even_gap(diameter: float, lie: Lie, ratio: float) -> float:
    """Even gap of air (m) around a tube that conducts to the mold as much as the air of its groove does.

    Air nearer than `LEAST_PLAY` diameters counts as that.

    Args:
        diameter: of the tube, m. ratio: of the mold's conductivity to that of air.
    """
    air = [max(x / diameter, LEAST_PLAY) for x in (lie.right, lie.top, lie.left, lie.bottom)]
    sides = [0.5 + x for x in air]
    angle, wall = _rays(sides)
    # The same elements filled with mold alone say what they make of it, so that their error cancels.
    resistance, alone = (_resistance(angle, wall, k, ratio) for k in (1.0, ratio))
    return float(math.pi * diameter * (resistance - alone))


def _rays(sides: list[float]) -> tuple[Array, Array]:
    """(n,) angles from 0 to 2 pi, dense where air is thin, with the corners, and (n,) ways to the wall in diameters."""
    right, top, left, bottom = sides
    corners = [(right, top), (-left, top), (-left, -bottom), (right, -bottom)]
    dense = np.linspace(0.0, 2 * math.pi, 16 * RAYS + 1)
    weight = 1 / np.minimum(_wall(dense, sides) - 0.5, 0.3) + 2.0
    share = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(dense))])
    spread = np.interp(np.linspace(0.0, share[-1], RAYS, endpoint=False), share, dense)
    exact = np.mod([math.atan2(y, x) for x, y in corners], 2 * math.pi)
    angle = np.unique(np.concatenate([spread, exact]))
    # A ray that nearly coincides with a corner would make slivers.
    apart = np.abs(angle[:, None] - exact).min(1)
    angle = angle[(apart == 0) | (apart > 1e-4)]
    return angle, _wall(angle, sides)


def _wall(angle: Array, sides: list[float]) -> Array:
    right, top, left, bottom = sides
    x, y = np.cos(angle), np.sin(angle)
    across = np.where(x > 0, right, left) / np.maximum(np.abs(x), 1e-12)
    along = np.where(y > 0, top, bottom) / np.maximum(np.abs(y), 1e-12)
    return np.minimum(across, along)


def _resistance(angle: Array, wall: Array, air: float, mold: float) -> float:
    """Between the tube, of diameter 1, and the circle far away, for these conductivities."""
    inner = 0.5 + np.linspace(0.0, 1.0, AIR_RINGS + 1)[:, None] * (wall - 0.5)
    outward = np.expm1(GRADING * np.linspace(0.0, 1.0, MOLD_RINGS + 1)[1:]) / math.expm1(GRADING)
    far = max(FAR, 2 * float(wall.max()))
    radius = np.vstack([inner, wall + outward[:, None] * (far - wall)])
    place = np.stack([radius * np.cos(angle), radius * np.sin(angle)])
    number = np.arange(radius.size).reshape(radius.shape)
    after = np.roll(number, -1, axis=1)
    corners = [grid.ravel() for grid in (number[:-1], number[1:], after[1:], after[:-1])]
    conductivity = np.repeat([air, mold], [AIR_RINGS * len(angle), MOLD_RINGS * len(angle)])
    first, second = (
        _triangles(place.reshape(2, -1), [corners[k] for k in triangle], conductivity)
        for triangle in ((0, 1, 2), (0, 2, 3))
    )
    stiffness = first + second
    field = np.zeros(radius.size)
    field[number[0]] = 1.0
    free = number[1:-1].ravel()
    matrix = stiffness[free]
    field[free] = scipy.sparse.linalg.spsolve(matrix[:, free].tocsc(), -(matrix @ field))
    return 1 / float(field @ (stiffness @ field))


def _triangles(place: Array, nodes: list[NDArray[np.intp]], conductivity: Array) -> scipy.sparse.csr_array:
    """Stiffness of linear triangles with corners at `place` (2, N)."""
    x, y = (np.array([axis[node] for node in nodes]) for axis in place)
    slope = np.stack([np.roll(y, -1, 0) - np.roll(y, -2, 0), np.roll(x, -2, 0) - np.roll(x, -1, 0)])
    twice = np.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))
    pairs = list(itertools.product(range(3), repeat=2))
    values = [conductivity * (slope[:, a] * slope[:, b]).sum(0) / (2 * twice) for a, b in pairs]
    rows, columns = (np.concatenate([nodes[pair[side]] for pair in pairs]) for side in (0, 1))
    return scipy.sparse.csr_array((np.concatenate(values), (rows, columns)), shape=(place.shape[1],) * 2)
