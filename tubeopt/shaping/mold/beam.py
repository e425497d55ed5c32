"""A straight tube held along a curve by single supports: a beam between them, which touches them or does not.

The tube's centreline lies w to the left of the wanted curve, with the curvature

    kappa_0 + w'' + kappa_0^2 w    to first order in w,

and it takes the least bending energy, that of a straight elastic tube whose ends slide in clamps along the curve's
tangents: by length of the wanted curve the integrand is (kappa_0 + w'' + kappa_0^2 w / 2)^2, for what lies inside of a
bend is shorter. A support pushes to one side only, without friction. Cubic elements; of the
supports those that push are found as the non-negative solution of a linear complementarity problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from ...typing import Array
from .settings import DEFAULT_MOLD

_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, eq=False)
class Held:
    """How a tube lies between its supports."""

    arc_length: Array
    """(N,) along the wanted curve, m."""
    offset: Array
    """(N,) of the tube from it, to the left, m."""
    curvature: Array
    """(N,) of the tube, 1/m."""
    wanted: Array
    """(N,) of the curve, 1/m."""
    force: Array
    """(M,) with which each support pushes, over the tube's bending stiffness, 1/m^2; 0 where it does not touch."""


def held_between(
    lengths: Array,
    curvatures: Array,
    places: Array,
    sides: Array,
    rooms: Array,
    *,
    element: float = DEFAULT_MOLD.pegs.element,
) -> Held:
    """The tube along a chain of pieces of one curvature each, clamped at both ends.

    Args:
        lengths, curvatures: (P,) of the pieces, m, and positive to the left, 1/m.
        places: (M,) arc lengths of the supports, m, within the chain. sides: (M,) 1 for those on the left, -1.
        rooms: (M,) way from the wanted curve's tube to each, m; negative where it reaches into it.
        element: greatest length of one, m.
    """
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    nodes = _nodes(ends, places, element)
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    kappa = curvatures[np.clip(np.searchsorted(ends, middle) - 1, 0, len(lengths) - 1)]
    rows, weight, index = _rows(np.diff(nodes), kappa)
    count = 2 * len(nodes)
    which = np.repeat(np.arange(rows.shape[0] * rows.shape[1]), 4)
    at = (which, np.repeat(index, rows.shape[1], axis=0).ravel())
    matrix = scipy.sparse.csr_array((rows.ravel(), at), shape=(which[-1] + 1, count))
    free = np.arange(2, count - 2)
    inner = matrix[:, free]
    reduced = (inner.T @ scipy.sparse.diags_array(weight) @ inner).tocsc()
    load = (matrix.T @ (weight * np.repeat(kappa, len(_PLACES))))[free]
    touched = 2 * np.searchsorted(nodes, np.round(places, 9)) - 2
    pushed = np.zeros((len(free), len(places)))
    pushed[touched, np.arange(len(places))] = sides
    solved = scipy.sparse.linalg.splu(reduced).solve(np.column_stack([-load, -pushed]))
    force = _forces(pushed.T @ solved, rooms)
    w = np.zeros(count)
    w[free] = solved[:, 0] + solved[:, 1:] @ force
    return _shape(nodes, w, kappa, force)


def _nodes(ends: Array, places: Array, element: float) -> Array:
    fixed = np.unique(np.round(np.concatenate([ends, places]), 9))
    parts = [np.linspace(a, b, max(2, int(np.ceil((b - a) / element)) + 1))[:-1] for a, b in pairwise(fixed)]
    return np.append(np.concatenate(parts), fixed[-1])


def _rows(h: Array, kappa: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """(E, G, 4) rows of w'' + kappa^2 w / 2 at the Gauss points, (E G,) their weights, (E, 4) unknowns of elements."""
    second, zeroth = _hermite(_PLACES, h)
    rows = second + 0.5 * kappa[:, None, None] ** 2 * zeroth
    index = 2 * np.arange(len(h))[:, None] + np.arange(4)
    return rows, (0.5 * h[:, None] * _WEIGHTS).ravel(), index


def _hermite(places: Array, h: Array) -> tuple[Array, Array]:
    """(E, G, 4) second derivatives and values of the cubic shapes of displacement and slope at places in -1 to 1."""
    x, h = 0.5 * (1 + places)[None, :], h[:, None]
    one = np.ones_like(h * x)
    value = np.stack(
        [
            one * (1 - 3 * x**2 + 2 * x**3),
            h * (x - 2 * x**2 + x**3),
            one * (3 * x**2 - 2 * x**3),
            h * (x**3 - x**2),
        ],
        axis=-1,
    )
    second = np.stack(
        [(12 * x - 6) / h**2, (6 * x - 4) / h, (6 - 12 * x) / h**2, (6 * x - 2) / h],
        axis=-1,
    )
    return second, value


def _forces(answer: Array, rooms: Array) -> Array:
    """(M,) of supports that push or leave a gap: room - side * w >= 0 where the force is 0. `answer`: (M, 1 + M) side
    times w there, without forces and for each force of 1."""
    if not len(rooms):
        return np.zeros(0)
    gap, give = rooms - answer[:, 0], -answer[:, 1:]
    # Supports at one place, one on either side, share what they bear: a little give of their own decides how.
    values, vectors = np.linalg.eigh(0.5 * (give + give.T))
    root = np.sqrt(np.maximum(values, 1e-9 * values[-1]))
    return np.asarray(scipy.optimize.nnls(root[:, None] * vectors.T, -(vectors.T @ gap) / root)[0])


def _shape(nodes: Array, w: Array, kappa: Array, force: Array) -> Held:
    h = np.diff(nodes)
    places = np.linspace(-1.0, 1.0, 5)[:-1]
    second, value = _hermite(places, h)
    local = np.stack([w[:-2:2], w[1:-2:2], w[2::2], w[3::2]], axis=-1)
    offset, bent = np.einsum("egk,ek->eg", value, local), np.einsum("egk,ek->eg", second, local)
    wanted = np.repeat(kappa[:, None], len(places), axis=1)
    s = nodes[:-1, None] + 0.5 * (1 + places) * h[:, None]
    curvature = wanted + bent + wanted**2 * offset
    return Held(s.ravel(), offset.ravel(), curvature.ravel(), wanted.ravel(), force)
