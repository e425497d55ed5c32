"""The surface of a distance field as facets, for pictures: a corner in every cell that it passes, at the mean of where
it crosses the cell's edges (Gibson 1998), one facet across every edge that it crosses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..typing import Array
from .distance_field import DistanceField

MOST = 72
"""Cells along the longest side at most."""


def surface_net(field: DistanceField, *, most: int = MOST) -> tuple[Array, NDArray[np.intp]]:
    """Corners (v, 3), m, and facets (f, 4) by the numbers of their corners, seen counterclockwise from where the
    distance is positive. Of a fine lattice only every so many nodes are looked at."""
    step = max(1, int(np.ceil(max(field.values.shape) / most)))
    values = field.values[::step, ::step, ::step].astype(float)
    cells = np.array(values.shape) - 1
    total, count = np.zeros((*cells, 3)), np.zeros(tuple(cells), dtype=int)
    crossings = []
    for axis in range(3):
        a, b = (np.take(values, range(k, cells[axis] + k), axis) for k in (0, 1))
        at = np.argwhere((a < 0) != (b < 0))
        low, high = a[tuple(at.T)], b[tuple(at.T)]
        place = at.astype(float)
        place[:, axis] += low / (low - high)
        beside = [k for k in range(3) if k != axis]
        corners = []
        for i, j in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
            cell = at.copy()
            cell[:, beside] += (i, j)
            corners.append(cell)
            there = ((cell >= 0) & (cell < cells)).all(1)
            np.add.at(total, tuple(cell[there].T), place[there])
            np.add.at(count, tuple(cell[there].T), 1)
        around = np.stack(corners, axis=1)
        whole = ((around >= 0) & (around < cells)).all((1, 2))
        turned = (low < 0) == (axis != 1)  # the other two axes in order are left-handed for the second
        crossings.append(np.where(turned[:, None, None], around, around[:, ::-1])[whole])
    used = count > 0
    number = np.cumsum(used).reshape(used.shape) - 1
    facets = np.concatenate(crossings)
    vertices = total[used] / count[used][:, None] * step * field.spacing
    return field.frame.placed(vertices), number[tuple(np.moveaxis(facets, 2, 0))]
