"""The sheet of stable equilibria around the relaxed pose, and the folds that bound it: where a robot can snap.

Tip angles name equilibria (see `stability.shooting`). Those that a robot reaches from its relaxed pose without a snap
are the connected set of stable ones around that pose, and where the set ends, at a fold, the robot snaps. Relative to
the pose F(tau) - tau has the period of a turn in each relative tip angle, so that F and the sign of det F', negative
beyond a fold, are computed on a grid over one turn and known on all turns around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from ..robots.assembly import Array, Mask
from ..transcription.reduced import Index, ReducedProblem
from .shooting import relative, relative_joints, relative_slope

TURN = 2 * np.pi

GRID = {1: 256, 2: 64, 3: 16, 4: 8}
"""Points per turn, by the number of relative tip angles."""

COARSEST_GRID = 5

MOST_NODES = 1_000_000
"""Nodes of all turns together."""

FURTHEST = 3
"""Turns of the tips around the relaxed pose at most; a fold may belong to joints that are turned further."""

OVERSHOOT = 0.3
"""How far (rad) a way goes on beyond a fold."""

APART = 0.2
"""Folds in whose directions from the relaxed pose a relative rotation differs by less than this part are one try."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A grid of M nodes over turns of the d relative tip angles around the relaxed pose, and over one turn of them, m.

    joints (M..., d): relative joint rotations, rad, from the relaxed pose.  determinant (M...): of F', 0 or less where
    the equilibrium is unstable.  node (M...): which of those in one turn.  slope (m, d, d): F' there.  centre: place
    of the relaxed pose.
    """

    joints: Array
    determinant: Array
    node: Index
    slope: Array
    centre: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Edge:
    """A fold at which the sheet ends, at about the relative joint rotations `fold` (d,) from the relaxed pose.

    way (W, d): waypoints on the sheet, from the relaxed pose to beside the fold.  beyond (d,): across the fold.
    """

    fold: Array
    way: Array
    beyond: Array


def stable_sheet(problem: ReducedProblem, coupled: Index, start: Array, unstable: Array) -> Sheet:
    """The grid around relaxed rotations `start` (n,), in which the tip angles `unstable` (B, n), each an unstable
    equilibrium, take the place of the nodes next to them: so an unstable region smaller than a cell is not missed."""
    d = len(coupled) - 1
    size = GRID.get(d, COARSEST_GRID)
    shape, origin = (size,) * d, relative(start[None], coupled)
    axis = np.arange(size) * TURN / size
    tips = np.stack(np.meshgrid(*[axis] * d, indexing="ij"), axis=-1).reshape(-1, d)
    seeds = relative(unstable, coupled) - origin
    seeds -= TURN * np.floor(seeds / TURN + 0.5 / size)
    places = np.ravel_multi_index(tuple(np.round(seeds * size / TURN).astype(int).T), shape)
    tips[places] = seeds
    angles = np.tile(start, (len(tips), 1))
    angles[:, coupled[:-1]] += tips
    joints = relative_joints(problem, coupled, angles) - origin
    slope = relative_slope(problem, coupled, angles)
    determinant = np.linalg.det(slope)
    determinant[places] = np.minimum(determinant[places], 0.0)
    turns = min(FURTHEST, int(((MOST_NODES / len(tips)) ** (1 / d) - 1) / 2))
    whole = (2 * turns + 1,) * d
    offset = np.stack(np.meshgrid(*[np.repeat(np.arange(-turns, turns + 1), size)] * d, indexing="ij"), axis=-1)
    return Sheet(
        np.tile(joints.reshape(*shape, d), (*whole, 1)) + TURN * offset,
        np.tile(determinant.reshape(shape), whole),
        np.tile(np.arange(len(tips)).reshape(shape), whole),
        slope,
        (turns * size,) * d,
    )


def edges(sheet: Sheet, allowed: Callable[[Array], Mask], most: int) -> list[Edge]:
    """Up to `most` folds that end the sheet, in different directions, the nearest to the relaxed pose first; `allowed`,
    (..., d) -> (...), admits the joint rotations of all the way to them."""
    free = (sheet.determinant > 0) & allowed(sheet.joints)
    if not free[sheet.centre]:
        return []
    labels = ndimage.label(free)[0]
    reached = labels == labels[sheet.centre]
    inner, folds = _folds(sheet, reached)
    kept = allowed(folds)
    inner, folds = inner[kept], folds[kept]
    chosen = _nearest(folds, most)
    joints = sheet.joints.reshape(-1, sheet.joints.shape[-1])
    found = []
    for way, k in zip(_ways(reached, sheet.centre, inner[chosen]), chosen, strict=True):
        slope = sheet.slope[sheet.node.ravel()[inner[k]]]
        across = _outwards(slope, folds[k] - joints[inner[k]])
        found.append(Edge(folds[k], joints[way], folds[k] + OVERSHOOT * across))
    return found


def _nearest(folds: Array, most: int) -> list[int]:
    """Rows of the folds (E, d) nearest to the relaxed pose, each in a direction of its own."""
    size = np.abs(folds).max(1, initial=0.0)
    directions: list[Array] = []
    chosen: list[int] = []
    for k in np.argsort(size, kind="stable"):
        direction = folds[k] / max(size[k], 1e-12)
        if all(np.abs(direction - other).max() > APART for other in directions):
            chosen.append(int(k))
            directions.append(direction)
        if len(chosen) == most:
            break
    return chosen


def _neighbours(shape: tuple[int, ...]) -> Array:
    """(2, P) flat nodes of a grid that are next to one another, each pair once."""
    flat = np.arange(np.prod(shape)).reshape(shape)
    pairs = []
    for axis, size in enumerate(shape):
        sides = (np.take(flat, np.arange(k, size - 1 + k), axis).ravel() for k in (0, 1))
        pairs.append(np.stack(list(sides)))
    return np.asarray(np.concatenate(pairs, axis=1))


def _folds(sheet: Sheet, reached: Mask) -> tuple[Index, Array]:
    """Flat nodes of the sheet (E,) with an unstable neighbour, and joint rotations (E, d) about where F' turns singular
    between the two."""
    determinant = sheet.determinant.ravel()
    pairs = _neighbours(reached.shape)
    inner, outer = np.concatenate([pairs, pairs[::-1]], axis=1)
    edge = reached.ravel()[inner] & (determinant[outer] <= 0)
    inner, outer = inner[edge], outer[edge]
    joints = sheet.joints.reshape(-1, sheet.joints.shape[-1])
    share = determinant[inner] / (determinant[inner] - determinant[outer])
    return inner, np.asarray(joints[inner] + share[:, None] * (joints[outer] - joints[inner]))


def _ways(reached: Mask, centre: tuple[int, ...], ends: Index) -> list[Index]:
    """Flat nodes of the shortest ways on the sheet from its centre to each of `ends`."""
    here, there = _neighbours(reached.shape)
    both = reached.ravel()[here] & reached.ravel()[there]
    graph = coo_array((np.ones(both.sum()), (here[both], there[both])), shape=(reached.size,) * 2).tocsr()
    root = int(np.ravel_multi_index(centre, reached.shape))
    before = breadth_first_order(graph, root, directed=False)[1]
    ways = []
    for end in ends:
        way = [int(end)]
        while way[-1] != root:
            way.append(int(before[way[-1]]))
        ways.append(np.array(way[::-1]))
    return ways


def _outwards(slope: Array, approach: Array) -> Array:
    """Unit vector (d,) across a fold near which F' is `slope`, to the side to which no equilibrium beside it leads."""
    across = np.linalg.svd(slope)[0][:, -1]
    return np.asarray(across if across @ approach >= 0 else -across)
