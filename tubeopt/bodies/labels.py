"""Labels of voxels as a body: the arm stays within some, or away from some.

The body is the union of the closed cuboids of the voxels in which the arm may not be, so that an arm that is clear of
it touches none of them. From a corner of voxels the nearest place of a cuboid is one of its corners: on the lattice of
corners the Euclidean distance transform gives the distance from all of them exactly, with its sign on either side.
"""

from __future__ import annotations

import logging
from itertools import product
from typing import Any

import numpy as np
import scipy

from ..errors import InputError
from ..typing import Array, Mask
from .distance_field import DistanceField
from .frames import Frame
from .images import LabelImage

LOGGER = logging.getLogger(__name__)

MOST_NODES = 12_000_000
"""Nodes of a distance field at most, which take a few seconds and half a gigabyte; else voxels are taken together."""

ROUND = 2
"""Voxels around the body, or the way within it, that the lattice has beside them."""

BEYOND = 0.02
"""Length (m) by which a way that meets the border of the image goes on beyond it."""


def field_of_image(
    image: LabelImage,
    *,
    lumen: Mask | None = None,
    forbidden: Mask | None = None,
    region: tuple[Array, Array] | None = None,
    most: int = MOST_NODES,
    name: str = "image",
) -> DistanceField:
    """Distance field of the voxels that the arm must avoid, in the axes of the patient.

    Args:
        lumen: (a, b, c) voxels in which the arm must stay: all others are forbidden. At the border of the image they
            continue beyond it.
        forbidden: (a, b, c) voxels that are forbidden, in the same image.
        region: two corners (3,), m, in the axes of the patient. Everything outside their bounding box along the voxel
            axes is forbidden.
        most: maximum number of lattice nodes. Above it voxels are merged, and one forbidden voxel makes all of them
            forbidden; `.node_error` is the loss.

    Raises:
        InputError: nothing is chosen, or no voxel is left for the arm.
    """
    if lumen is None and forbidden is None:
        raise InputError(f"no label of {image.name} is chosen as lumen or forbidden; choose one of {image.labels}")
    box, padding = _box(image, lumen, forbidden, region)
    open_ended = lumen is not None or region is not None
    size = tuple(part.stop - part.start for part in box)
    free = np.ones(size, dtype=bool) if lumen is None else np.array(lumen[box])
    if forbidden is not None:
        free &= ~forbidden[box]
    if lumen is not None and not free.any():
        raise InputError(f"{image.name} has no voxel that the arm may occupy")
    if lumen is not None and region is None:
        free = np.pad(free, padding, mode="edge")
    else:
        free = np.pad(free, padding, constant_values=region is None)
    first = np.array([part.start - before for part, (before, _) in zip(box, padding, strict=True)], dtype=float)
    free, together = _coarser(free, image.spacing, most)
    spacing = image.spacing * together
    if (together > 1).any():
        cell = " x ".join(f"{each * 1e3:.3g}" for each in spacing)
        LOGGER.warning(
            f"{image.name}: the region has more than {most:.2g} voxels; distances are computed on cells of {cell} mm"
        )
    lost = float(np.linalg.norm((together - 1) * image.spacing))
    origin = image.frame.placed((first - 0.5) * image.spacing)
    return DistanceField(
        _distances(free, spacing), spacing, Frame(image.frame.axes, origin), lost, not open_ended, name
    )


def _box(
    image: LabelImage, lumen: Mask | None, forbidden: Mask | None, region: tuple[Array, Array] | None
) -> tuple[tuple[slice, ...], list[tuple[int, int]]]:
    """The part of the image that matters, and voxels to add before and after it along every axis."""
    shape = image.shape
    if region is not None:
        low, high = (np.asarray(corner, dtype=float) for corner in region)
        if not (low < high).all():
            least, most = (", ".join(f"{x * 1e3:g}" for x in corner) for corner in (low, high))
            raise InputError(f"the region goes from {least} to {most} mm; its first corner must be the lower one")
        corners = image.frame.seen(list(product(*zip(low, high, strict=True)))) / image.spacing
        low, high = corners.min(0), corners.max(0)
        begin = np.clip(np.floor(low + 0.5), 0, shape).astype(int)
        end = np.clip(np.ceil(high + 0.5), 0, shape).astype(int)
        if (end <= begin).any():
            raise InputError(f"the region is outside {image.name}; it must overlap it")
        return tuple(slice(a, b) for a, b in zip(begin.tolist(), end.tolist(), strict=True)), [(1, 1)] * 3
    chosen = lumen if lumen is not None else forbidden
    assert chosen is not None
    if not chosen.any():
        raise InputError(f"no voxel of {image.name} is chosen")
    box, padding = [], []
    for axis in range(3):
        along = np.flatnonzero(chosen.any(tuple(k for k in range(3) if k != axis)))
        a, b = max(int(along[0]) - ROUND, 0), min(int(along[-1]) + 1 + ROUND, shape[axis])
        box.append(slice(a, b))
        further = int(np.ceil(BEYOND / image.spacing[axis]))
        padding.append((further if along[0] == 0 else 0, further if along[-1] == shape[axis] - 1 else 0))
    return tuple(box), padding if lumen is not None else [(ROUND, ROUND)] * 3


def _coarser(free: Mask, spacing: Array, most: int) -> tuple[Mask, Any]:
    """Voxels taken together, as evenly as can be, until there are few enough, and how many along each axis."""
    together = np.ones(3, dtype=int)
    while np.prod(np.ceil(np.array(free.shape) / together) + 1) > most:
        together[np.argmin(together * spacing)] += 1
    if (together == 1).all():
        return free, together
    short = [(0, int(-size % k)) for size, k in zip(free.shape, together, strict=True)]
    padded = np.pad(free, short, mode="edge")
    for axis, k in enumerate(together):
        shape = [*padded.shape[:axis], padded.shape[axis] // k, k, *padded.shape[axis + 1 :]]
        padded = np.asarray(padded.reshape(shape).all(axis + 1))
    return padded, together


def _distances(free: Mask, spacing: Array) -> Array:
    """Signed distances at the corners of voxels from the cuboids of those that are not free."""
    if free.all():
        return np.full(np.array(free.shape) + 1, float(spacing.sum()))
    out = _transform(_at_corners(~free), spacing)
    if free.any():
        out -= _transform(_at_corners(free), spacing)
    else:
        out -= np.float32(np.linalg.norm(spacing))
    return out


def _at_corners(voxels: Mask) -> Mask:
    """(a + 1, b + 1, c + 1) whether a corner is one of these voxels (a, b, c)."""
    out = np.zeros(np.array(voxels.shape) + 1, dtype=bool)
    for i, j, k in product((0, 1), repeat=3):
        a, b, c = voxels.shape
        out[i : i + a, j : j + b, k : k + c] |= voxels
    return out


def _transform(mask: Mask, spacing: Array) -> Array:
    """Distance of every node from the nearest of a mask; float32, slab by slab, to bound the memory."""
    index = scipy.ndimage.distance_transform_edt(~mask, sampling=spacing, return_distances=False, return_indices=True)
    out: Array = np.empty(mask.shape, dtype=np.float32)
    b, c = np.ogrid[: mask.shape[1], : mask.shape[2]]
    for a in range(len(out)):
        square = ((index[0, a] - a) * spacing[0]) ** 2
        square += ((index[1, a] - b) * spacing[1]) ** 2
        square += ((index[2, a] - c) * spacing[2]) ** 2
        out[a] = np.sqrt(square)
    return out
