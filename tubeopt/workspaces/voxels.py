"""Workspaces as voxels: tips in each, the overlap of two workspaces, and the placement that makes it largest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ..arguments import renamed, typed
from ..bodies.frames import Frame, base_frame
from ..display import Displayed
from ..errors import InputError, finite, positive
from ..solvers.time_limit import TIME_LIMIT, limited
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
    """(V,) numbers of patches of the sphere of tip directions, out of `PATCHES`."""
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
        """(V,) fraction of all directions of the tip: the service sphere of Kumar and Waldron (1981).

        A lower bound, since a voxel of few samples cannot show many directions.
        """
        return self.directions / PATCHES

    @property
    def surface(self) -> Mask:
        """(V,) True if one of the six neighbours has no tip."""
        return on_surface(self.index)


def on_surface(index: Keys) -> Mask:
    """(V,) True for cubes (V, 3) with a neighbour that is not in the set."""
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
    """(count,) True for rows, from `first` on, in the first half of the samples; for a grid, in a random half."""
    if workspace.method == "grid":  # whose first half is on one side
        # Seeded by the row, so that every pass over the table draws the same half.
        return np.asarray(np.random.default_rng(first).random(count) < 0.5)
    return np.arange(first, first + count) < (len(workspace) + 1) // 2


def default_size(workspace: Workspace) -> float:
    """Edge (m) of voxels that give about `PER_VOXEL` samples each in the bounding box."""
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
    """Voxels that collect tips in chunks."""

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


# --- overlap of two workspaces ----------------------------------------------------------------------------------------


# The overlap of voxels has steps, so that no gradient helps. Five unknowns have 25 individuals.
MAX_GENERATIONS, INDIVIDUALS = 25, 5
"""Maximum number of generations of differential evolution, and individuals per unknown."""


@dataclass(frozen=True, eq=False)
class SharedWorkspace(Displayed):
    """Voxels that the tips of two robots both reach."""

    size: float
    """Edge of the voxels, m."""
    volumes: Array
    """(2,) volumes of the workspaces, m^3."""
    shared: float
    """Volume that both reach, m^3."""
    positions: Array
    """(V, 3) centres of the voxels that both reach, in the frame that the robots share, m."""
    bases: tuple[Frame, Frame]
    """Frames of the base plates."""

    @property
    def value(self) -> float:
        """Volume that both reach, m^3."""
        return self.shared

    @property
    def fraction(self) -> float:
        """Fraction of the smaller workspace that the other robot also reaches."""
        return float(self.shared / self.volumes.min())


@typed
def shared_workspace(
    workspaces: Sequence[Workspace], bases: Sequence[Frame], *, size: float | None = None, min_margin: float = 0.0
) -> SharedWorkspace:
    """Overlap of the workspaces of two robots with their plates in two frames.

    Contact between the arms is not considered; see `plan_arms`.

    Args:
        size: edge of the voxels, m; by default as in `voxels`. With few samples in each, voxels are missed, and the
            overlap is too small.
        min_margin: only configurations at least as stable count.

    Raises:
        InputError: not two workspaces and two frames, a size that is not greater than 0, no sample with the margin.
    """
    if len(workspaces) != 2 or len(bases) != 2:
        raise InputError(f"there are {len(workspaces)} workspaces and {len(bases)} bases; there must be two of each")
    tips = [_tips(each, finite("min_margin", min_margin)) for each in workspaces]
    edge = max(default_size(each) for each in workspaces) if size is None else positive("size", size)
    return _shared(tips, (bases[0], bases[1]), edge)


def _tips(workspace: Workspace, min_margin: float) -> Array:
    require_samples(workspace)
    tips = np.asarray(workspace.tip_position[has_margin(workspace.table, min_margin)])
    if not len(tips):
        raise InputError(f"no sample of the workspace has a margin of {min_margin:g}")
    return tips


def _shared(tips: Sequence[Array], bases: tuple[Frame, Frame], size: float) -> SharedWorkspace:
    first, second = (np.unique(keys_of(cells(base.placed(tip), size))) for base, tip in zip(bases, tips, strict=True))
    shared = index_of(np.intersect1d(first, second, assume_unique=True))
    volumes = np.array([len(first), len(second)]) * size**3
    return SharedWorkspace(size, volumes, len(shared) * size**3, np.asarray((shared + 0.5) * size), bases)


@renamed(least_distance="min_distance", most_distance="max_distance", most_tilt="max_tilt")
@typed
@limited
def place_pair(
    workspaces: Sequence[Workspace],
    *,
    min_distance: float,
    max_distance: float,
    max_tilt: float = np.pi / 4,
    size: float | None = None,
    min_margin: float = 0.0,
    seed: int = 0,
    time_limit: float = TIME_LIMIT,
) -> SharedWorkspace:
    """Place two robots so that the overlap of their workspaces is largest.

    They are side by side along x, symmetric about the origin, each tilted in the plane of x and z and turned about its
    own axis.

    Args:
        min_distance, max_distance: limits of the distance between the middles of the plates, m.
        max_tilt: largest angle of each from z, rad.
        seed: seed of differential evolution, which finds distance, two tilts and two turns.
        time_limit: s, on the clock.

    Raises:
        InputError: as `shared_workspace`; distances that leave nothing.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    if not 0 < finite("min_distance", min_distance) <= finite("max_distance", max_distance):
        raise InputError(
            f"the distance of the base plates is {min_distance * 1e3:g} to "
            f"{max_distance * 1e3:g} mm; the first must be greater than 0 and at most the "
            "second"
        )
    edge = shared_workspace(workspaces, (Frame(), Frame()), size=size, min_margin=min_margin).size
    tips = [_tips(each, finite("min_margin", min_margin)) for each in workspaces]
    tilt = positive("max_tilt", max_tilt, zero=True)

    def bases(x: Array) -> tuple[Frame, Frame]:
        frames = []
        for side, lean, turn in ((-1, x[1], x[3]), (1, x[2], x[4])):
            frames.append(base_frame([side * x[0] / 2, 0, 0], [-side * np.sin(lean), 0, np.cos(lean)], turn))
        return frames[0], frames[1]

    best = scipy.optimize.differential_evolution(
        lambda x: -_shared(tips, bases(x), edge).shared,
        [(min_distance, max_distance), (-tilt, tilt), (-tilt, tilt), (-np.pi, np.pi), (-np.pi, np.pi)],
        maxiter=MAX_GENERATIONS,
        popsize=INDIVIDUALS,
        tol=1e-3,
        rng=seed,
        polish=False,
    )
    return _shared(tips, bases(best.x), edge)
