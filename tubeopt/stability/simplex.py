"""Nelder and Mead's method from many starts in step: an evaluation of many points costs little more than one of one."""

from __future__ import annotations

from collections.abc import Callable, Generator

import numpy as np

from ..solvers.time_limit import check_time
from ..typing import Array

Search = Generator[Array, float, tuple[Array, float]]
"""Yields points (d,), is sent their values, returns the best point and its value."""

FIRST, FIRST_AT_ZERO = 0.05, 0.00025
"""Sides of the first simplex: shares of the start's coordinates, and of those that are 0."""

PATIENCE = 200
"""Times the number of unknowns: iterations after which a search ends where it is."""


def minimise_together(
    values: Callable[[Array], Array], starts: Array, *, x: float, f: float
) -> list[tuple[Array, float]]:
    """The local minima (d,) and their values that simplices from `starts` (S, d) shrink to.

    Args:
        values: of points (B, d) -> (B,).
        x, f: a simplex whose other corners lie within `x` of its best, by coordinate, and whose values do within `f`,
            has shrunk.
    """
    searches = dict(enumerate(_search(start, x, f) for start in starts))
    points = {k: next(search) for k, search in searches.items()}
    ends: dict[int, tuple[Array, float]] = {}
    while points:
        check_time()
        told = values(np.array(list(points.values())))
        for (k, search), value in zip([(k, searches[k]) for k in points], told, strict=True):
            try:
                points[k] = search.send(float(value))
            except StopIteration as end:
                ends[k] = end.value
                del points[k]
    return [ends[k] for k in range(len(starts))]


def _search(start: Array, x: float, f: float) -> Search:
    """One simplex; its values are asked for one by one."""
    d = len(start)
    simplex = np.tile(start, (d + 1, 1))
    for i in range(d):
        simplex[i + 1, i] = start[i] * (1 + FIRST) if start[i] else FIRST_AT_ZERO
    value = np.empty(d + 1)
    for i in range(d + 1):
        value[i] = yield simplex[i].copy()
    for _ in range(PATIENCE * d):
        order = np.argsort(value, kind="stable")
        simplex, value = simplex[order], value[order]
        if np.abs(simplex[1:] - simplex[0]).max() <= x and np.abs(value[1:] - value[0]).max() <= f:
            break
        middle, away = simplex[:-1].mean(0), simplex[:-1].mean(0) - simplex[-1]
        reflected = yield middle + away
        # The reflected point, or another on its line: farther out, or on this or that side of the middle.
        tried, best = middle + away, reflected
        if reflected < value[0]:
            farther = yield middle + 2 * away
            if farther < reflected:
                tried, best = middle + 2 * away, farther
        elif reflected >= value[-2]:
            tried = middle + (0.5 if reflected < value[-1] else -0.5) * away
            best = yield tried
            if best >= value[-1] or best > reflected:
                for i in range(1, d + 1):
                    simplex[i] = simplex[0] + 0.5 * (simplex[i] - simplex[0])
                    value[i] = yield simplex[i].copy()
                continue
        simplex[-1], value[-1] = tried, best
    k = int(np.argmin(value))
    return simplex[k], float(value[k])
