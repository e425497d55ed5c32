"""Distance and gradient of a mesh's field, held against the nearest of all triangles at a million random points.

What they are held against shares nothing with the field: places of triangles in closed form, inside and outside by the
winding number.

Usage: OPENBLAS_NUM_THREADS=1 python -m benchmarks.distance_field [--points 1000000]
"""

from __future__ import annotations

import argparse

import numpy as np
import trimesh

from tubeopt.bodies.corridors import MeshObstacle
from tubeopt.bodies.solids import field_of_mesh
from tubeopt.typing import Array, Mask

CHUNK = 20_000
"""Points at once."""

DISTINCT = 1e-9
"""Distance (m) of places that are two, and by which the second must be farther for the distance to have a gradient."""

Corners = tuple[Array, Array, Array]
"""Of triangles, (N, 3) each."""


def nearest(p: Array, corners: Corners) -> Array:
    """(N, 3) nearest places of triangles to points (N, 3), pair by pair: the foot, or the nearest of the sides."""
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    foot = p - ((p - a) * normal).sum(1, keepdims=True) * normal
    inside, best, position = np.ones(len(p), dtype=bool), np.full(len(p), np.inf), foot.copy()
    for u, v in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(v - u, foot - u) * normal).sum(1) >= 0
        along = np.clip(((p - u) * (v - u)).sum(1) / ((v - u) ** 2).sum(1), 0, 1)[:, None]
        reached = u + along * (v - u)
        far = ((p - reached) ** 2).sum(1)
        position[far < best] = reached[far < best]
        best = np.minimum(best, far)
    return np.asarray(np.where(inside[:, None], foot, position))


def within(p: Array, corners: Corners) -> Mask:
    """(N,) whether points (N, 3) lie within a closed surface, by its winding number (van Oosterom and Strackee)."""
    turns = np.zeros(len(p))
    for a, b, c in zip(*corners, strict=True):
        x, y, z = a - p, b - p, c - p
        i, j, k = (np.linalg.norm(each, axis=1) for each in (x, y, z))
        mixed = i * j * k + (x * y).sum(1) * k + (y * z).sum(1) * i + (z * x).sum(1) * j
        turns += np.arctan2((x * np.cross(y, z)).sum(1), mixed) / (2 * np.pi)
    return np.asarray(turns > 0.5)


def exactly(p: Array, corners: Corners) -> tuple[Array, Array, Mask]:
    """(N,) signed distances of points (N, 3), (N, 3) their gradients, and (N,) whether these exist."""
    middle = sum(corners) / 3
    size = np.max([np.linalg.norm(each - middle, axis=1) for each in corners], axis=0)
    gap = np.linalg.norm(p[:, None] - middle, axis=2)
    row, face = np.nonzero(gap - size <= gap.min(1)[:, None] + 1e-5)
    position = nearest(p[row], (corners[0][face], corners[1][face], corners[2][face]))
    far = np.linalg.norm(p[row] - position, axis=1)
    order = np.lexsort((far, row))
    row, position, far = row[order], position[order], far[order]
    first = np.searchsorted(row, np.arange(len(p)))
    other = np.linalg.norm(position - position[first][row], axis=1) > DISTINCT
    second = np.minimum.reduceat(np.where(other, far - far[first][row], np.inf), first)
    sign = np.where(within(p, corners), -1.0, 1.0)
    gradient = (p - position[first]) / far[first, None] * sign[:, None]
    return sign * far[first], gradient, np.asarray(second > DISTINCT)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    count = parser.parse_args().points
    torus = trimesh.creation.torus(0.012, 0.005, major_sections=24, minor_sections=12)
    corners: Corners = tuple(torus.vertices[torus.faces[:, k]].view(np.ndarray) for k in range(3))
    mesh = MeshObstacle(tuple(map(tuple, torus.vertices.tolist())), tuple(map(tuple, torus.faces.tolist())))
    field, random = field_of_mesh(mesh, keep="out", cell=5e-4), np.random.default_rng(11)
    smallest, largest, off, exist = np.inf, -np.inf, [], []
    for _ in range(0, count, CHUNK):
        p = random.uniform(-0.02, 0.02, (CHUNK, 3)) * [1.0, 1.0, 0.5]
        distance, gradient, exists = exactly(p, corners)
        short = distance - field.signed_distance(p)
        smallest, largest = min(smallest, short.min()), max(largest, short.max())
        off.append(np.linalg.norm(field.gradient(p) - gradient, axis=1))
        exist.append(exists)
    away, known = np.concatenate(off), np.concatenate(exist)
    print(f"{len(away)} points, {len(torus.faces)} triangles: {smallest * 1e3:.4f} to {largest * 1e3:.4f} mm less than")
    print(f"their distance, where the bound is {field.error * 1e3:.4f} mm; the gradient, which exists at {known.sum()}")
    print(f"of them, is off by {away[known].max():.2g} at most, and by 1 % or more at {(away >= 0.01).sum()} of all")


if __name__ == "__main__":
    main()
