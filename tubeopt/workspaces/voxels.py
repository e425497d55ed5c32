"""Workspace as voxels: number, directions and largest margin of the tips in each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arguments import typed
from ..errors import InputError, positive
from ..typing import Array, Mask
from .sampling import Workspace, has_margin, require_samples

Words = NDArray[np.uint64]
Keys = NDArray[np.int64]

# They are bits of one word of 64.
PATCHES = 64
"""Number of patches of equal area on the sphere of directions: 8 bands of height by 8 sectors."""

# The smallest number at which the stated uncertainty, half of the voxels on the surface, contained the volume of three
# robots of the library for 1,000 to 100,000 samples. With 12, voxels that no sample hits made the volume too small by
# up to 1.4 times that uncertainty, with 8 by up to 1.8 times; with 50 the uncertainty is 1.5 times larger.
PER_VOXEL = 15
"""Samples per voxel of the bounding box, on average, at the default edge."""

# Three indices of 21 bits are one key of 63: a million voxels to either side of the plate along each axis.
_BITS = 21
_HALF = 1 << (_BITS - 1)


@dataclass(frozen=True, eq=False)
class Voxels:
    """V cubes with at least one tip; cube i spans index[i] * size to (index[i] + 1) * size."""

    size: float
    """Edge of a cube, m."""
    samples: int
    """Total number of tips."""
    index: Keys
    """(V, 3) indices along x, y and z."""
    count: Keys
    """(V,) numbers of tips."""
    early: Keys
    """(V,) numbers of tips from the first half of the samples; of a grid, from a random half."""
    directions: Keys
    """(V,) numbers of patches of the sphere of directions, out of `PATCHES`, in which tips point."""
    margin: Array
    """(V,) largest stability margin of a tip."""

    def __len__(self) -> int:
        return len(self.index)

    @property
    def centres(self) -> Array:
        """(V, 3) centres of the voxels, m."""
        return np.asarray((self.index + 0.5) * self.size)

    @property
    def dexterity(self) -> Array:
        """(V,) fraction of all directions in which tips point: the service sphere of Kumar and Waldron (1981).

        A lower bound, since a voxel of few samples cannot show many directions.
        """
        return self.directions / PATCHES

    @property
    def surface(self) -> Mask:
        """(V,) True if one of the six neighbours has no tip."""
        return on_surface(self.index)


def on_surface(index: Keys) -> Mask:
    """(V,) True for cubes (V, 3) with a neighbour that is not one of them."""
    steps = np.vstack([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
    return np.asarray(np.any([~np.isin(keys_of(index + step), keys_of(index)) for step in steps], axis=0))


@typed
def voxels(workspace: Workspace, size: float | None = None, *, min_margin: float = 0.0) -> Voxels:
    """Sort the tips of a workspace into cubes; memory grows with the cubes, not with the samples.

    Args:
        size: edge, m; by default a round number for about 15 samples per voxel of the bounding box.
        min_margin: only configurations at least as stable count.

    Raises:
        InputError: a size that is not positive, or so small that indices overflow; no sample is that stable.
    """
    require_samples(workspace)
    edge = default_size(workspace) if size is None else positive("size", size)
    store = Store(edge)
    for first, table in workspace.chunks():
        rows = has_margin(table, min_margin)
        early = in_first_half(workspace, first, len(table))
        store.add(table[rows, -7:-4], table[rows, -4:-1], table[rows, -1], early[rows])
    if not len(store.keys):
        raise InputError(f"min_margin is {min_margin:g}; no sample has this margin")
    return store.voxels()


def in_first_half(workspace: Workspace, first: int, count: int) -> Mask:
    """(count,) True for rows from `first` on that are in the first half of the samples; of a grid, in a random half."""
    if workspace.method == "grid":  # whose first half is on one side
        # Seeded by the row, so that every pass over the table draws the same half.
        return np.asarray(np.random.default_rng(first).random(count) < 0.5)
    return np.arange(first, first + count) < (len(workspace) + 1) // 2


def default_size(workspace: Workspace) -> float:
    """Edge (m) at which the voxels of the bounding box have about `PER_VOXEL` samples each."""
    low, high, count = np.full(3, np.inf), np.full(3, -np.inf), 0
    for _, table in workspace.chunks():
        tips = table[has_margin(table, -np.inf), -7:-4]
        if len(tips):
            low, high, count = np.minimum(low, tips.min(0)), np.maximum(high, tips.max(0)), count + len(tips)
    return size_for(high - low, count)


def size_for(extent: Array, count: int) -> float:
    """Default edge (m) for a number of samples over an extent (3,), m."""
    longest = float(extent.max())
    if longest <= 0:
        return 1e-3
    # Volume of the bounding box, m^3. A flat workspace gets a thickness of a thousandth of its length, so that voxels
    # are counted on its face.
    volume = float(np.prod(np.maximum(extent, longest / 1000)))
    # At most 500 voxels along the longest side, however many samples there are, to bound the memory.
    edge = max((volume * PER_VOXEL / count) ** (1 / 3), longest / 500)
    # Ten round numbers per decade: with 1, 2, 5 the samples per voxel would differ by up to 4 times from `PER_VOXEL`.
    steps = np.array([m * 10.0**e for e in range(-7, 1) for m in (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)])
    return float(steps[np.argmin(np.abs(np.log(steps / edge)))])


class Store:
    """Voxels to which tips are added in chunks."""

    def __init__(self, size: float) -> None:
        self.size = size
        self.keys: Keys = np.zeros(0, np.int64)
        self.count, self.early = self.keys.copy(), self.keys.copy()
        self.patches: Words = np.zeros(0, np.uint64)
        self.margin: Array = np.zeros(0)

    def add(self, tips: Array, directions: Array, margin: Array, early: Mask) -> None:
        """Add tips (B, 3) with their directions (B, 3) and margins (B,)."""
        # Old voxels first: sorting is stable, so that they and the new tips are reduced together.
        keys = np.concatenate([self.keys, keys_of(cells(tips, self.size))])
        ones = np.ones(len(tips), np.int64)
        # One bit per patch: directions are joined by `or`, and counted by their bits.
        word = np.left_shift(np.uint64(1), patch_of(directions).astype(np.uint64))
        order = np.argsort(keys, kind="stable")
        self.keys, starts = np.unique(keys[order], return_index=True)
        self.count = _reduce(np.add, [self.count, ones], order, starts)
        self.early = _reduce(np.add, [self.early, early.astype(np.int64)], order, starts)
        self.patches = _reduce(np.bitwise_or, [self.patches, word], order, starts)
        self.margin = _reduce(np.maximum, [self.margin, margin], order, starts)

    def voxels(self) -> Voxels:
        """Voxels of all added tips."""
        directions, samples = np.bitwise_count(self.patches).astype(np.int64), int(self.count.sum())
        return Voxels(self.size, samples, index_of(self.keys), self.count, self.early, directions, self.margin)


def _reduce(function: np.ufunc, parts: Iterable[NDArray[Any]], order: Keys, starts: Keys) -> NDArray[Any]:
    values = np.concatenate(list(parts))[order]
    return np.asarray(function.reduceat(values, starts)) if len(values) else values


def cells(points: Array, size: float) -> Keys:
    """(B, 3) index of the cube of each point (B, 3)."""
    index = np.floor(points / size)
    if len(index) and np.abs(index).max() >= _HALF:
        raise InputError(f"size is {size:g} m; it must be at least a millionth of the workspace's size")
    return index.astype(np.int64)


def keys_of(index: Keys) -> Keys:
    """(V,) unique number of each cube (V, 3)."""
    # Shifted to be positive, or the bits of one axis would reach into those of the next.
    x, y, z = (index + _HALF).T
    return np.asarray((x << (2 * _BITS)) | (y << _BITS) | z)


def index_of(keys: Keys) -> Keys:
    """(V, 3) cubes with the numbers `keys_of` (V,)."""
    mask = (1 << _BITS) - 1
    return np.column_stack([keys >> (2 * _BITS), (keys >> _BITS) & mask, keys & mask]) - _HALF


def patch_of(directions: Array) -> Keys:
    """(B,) number of the patch of equal area of each unit vector (B, 3) (Archimedes: equal heights)."""
    x, y, z = directions.T
    # Bands of equal height have equal area; z = 1 itself belongs to the last.
    band = np.clip(((z + 1) * 4).astype(np.int64), 0, 7)
    sector = np.clip(((np.arctan2(y, x) / (2 * np.pi) + 0.5) * 8).astype(np.int64), 0, 7)
    return np.asarray(8 * band + sector)
