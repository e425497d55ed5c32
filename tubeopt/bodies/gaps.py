"""The largest gap between neighbouring points: the longest edge of the shortest tree that joins them all."""

from __future__ import annotations

import numpy as np
import scipy

from ..typing import Array

NEIGHBOURS = 8
"""Of each point, from which the tree is made first."""

MOST = 200_000_000
"""Distances that are computed at most to join what the nearest neighbours leave apart."""


def largest_gap(points: Array) -> float | None:
    """The least d, m, for which points (N, 3) are joined by steps no longer than d; 0 for one point.

    It is no less than that: the tree is made of the nearest neighbours of each point, and the parts that these leave
    are joined at their nearest points. None where that takes too long.
    """
    points = np.unique(points, axis=0)
    if len(points) < 2:
        return 0.0
    count = min(NEIGHBOURS + 1, len(points))
    tree = scipy.spatial.cKDTree(points)
    far, near = (each[:, 1:] for each in tree.query(points, k=count))
    row = np.repeat(np.arange(len(points)), count - 1)
    graph = scipy.sparse.csr_array((far.ravel(), (row, near.ravel())), shape=(len(points),) * 2)
    longest = float(scipy.sparse.csgraph.minimum_spanning_tree(graph).data.max())
    _, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    spent = 0
    while (size := np.bincount(part)).size and (size > 0).sum() > 1:
        smallest = int(np.where(size > 0, size, len(points) + 1).argmin())
        mine = part == smallest
        spent += len(points)
        if spent > MOST:
            return None
        apart = np.asarray(scipy.spatial.cKDTree(points[mine]).query(points[~mine])[0])
        nearest = int(np.argmin(apart))
        longest = max(longest, float(apart[nearest]))
        part[mine] = part[~mine][nearest]
    return longest
