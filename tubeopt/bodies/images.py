"""Images of patients from NIfTI and NRRD files, and their labels as distance fields.

The body of a label is the union of the closed cuboids of its voxels, so that an arm with clearance touches none of
them. The point of a cuboid that is nearest to a corner of voxels is itself a corner. So the Euclidean distance
transform on the lattice of corners is exact, on both sides of the surface.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy

from ..errors import InputError, choice, import_extra
from ..files.files import no_such_file
from ..typing import Array, Mask
from .distance_field import DistanceField
from .frames import AXES, Frame

LOGGER = logging.getLogger(__name__)

# Largest size of an image, bytes: a computer with 4 GB can read it.
MAX_BYTES = 1_200_000_000

# Typical sizes (m) of voxels of scans.
TYPICAL_VOXEL = 1e-5, 2e-2

# Largest cosine between orthogonal axes of an image: numbers in headers are rounded.
SKEW = 1e-3

# Tolerance between two poses in a header, in voxels.
AGREE = 0.1

# Largest number of distinct labels: scans have 12 bits and more.
MAX_LABELS = 4096

# Parts of the names of number types in NRRD -> bytes of a voxel; the first match counts.
BYTES = {("64", "long", "double"): 8, ("16", "short"): 2, ("8", "char"): 1, ("32", "int", "float"): 4}

# Words for the directions of axes -> sign in RAS.
SIGNS = {"left": -1.0, "l": -1.0, "right": 1.0, "r": 1.0, "posterior": -1.0, "p": -1.0, "anterior": 1.0, "a": 1.0}

# Units in headers, in m; the default is mm.
UNITS = {"mm": 1e-3, "meter": 1.0, "micron": 1e-6, "m": 1.0, "um": 1e-6, "unknown": 1e-3}


@dataclass(frozen=True, eq=False)
class LabelImage:
    """Image with labels or other values of voxels.

    Raises:
        InputError: no image of three dimensions, or voxels without a size.
    """

    values: Any = field(repr=False)
    """Labels or other values (a, b, c)."""
    spacing: Array
    """Sizes of a voxel (3,), m."""
    frame: Frame = field(default_factory=Frame, repr=False)
    """Frame of the voxels in the patient, RAS; its origin is the centre of the first voxel."""
    name: str = "the image"
    """Name in messages."""

    def __post_init__(self) -> None:
        spacing = np.asarray(self.spacing, dtype=float)
        if np.ndim(self.values) != 3 or min(np.shape(self.values)) < 1:
            shape = " x ".join(map(str, np.shape(self.values)))
            raise InputError(f"{self.name} has {shape or 'no'} voxels; it must be one image of three dimensions")
        if spacing.shape != (3,) or not np.isfinite(spacing).all() or (spacing <= 0).any():
            raise InputError(f"voxels of {self.name} have no size: {spacing.tolist()} m")
        if np.asarray(self.values).dtype.kind not in "buif":
            kind = np.asarray(self.values).dtype
            raise InputError(f"voxels of {self.name} are of kind {kind}; they must be one number each")
        object.__setattr__(self, "spacing", spacing)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of voxels along the axes."""
        a, b, c = np.shape(self.values)
        return a, b, c

    def holds(self, point: Array) -> bool:
        """True if a position (3,) in the patient, m, lies in one of the voxels."""
        index = self.frame.seen(point) / self.spacing
        return bool(((index >= -0.5) & (index <= np.array(self.shape) - 0.5)).all())

    @cached_property
    def labels(self) -> tuple[int, ...]:
        """Labels in the image, except 0.

        Raises:
            InputError: values that are no whole numbers, or too many different ones.
        """
        labels: set[int] = set()
        for part in self.values:  # slab by slab, to bound the memory
            if part.dtype.kind == "f":
                if not np.isfinite(part).all():
                    raise InputError(f"{self.name} has voxels that are NaN or infinite; every label must be a number")
                broken = part[part != np.rint(part)]
                if len(broken):
                    raise self._no_labels(f"values such as {broken[0]:g}")
                part = part.astype(np.int64)
            low, high = int(part.min()), int(part.max())
            if high - low < part.size:
                labels.update((low + np.flatnonzero(np.bincount(part.ravel().astype(np.int64) - low))).tolist())
            else:
                labels.update(np.unique(part).tolist())
            if len(labels) > MAX_LABELS:
                raise self._no_labels(f"more than {MAX_LABELS} values")
        return tuple(sorted(label for label in labels if label))

    def _no_labels(self, reason: str) -> InputError:
        return InputError(
            f"{self.name} is not a label image: it has {reason}; segment it first, or select voxels by a range of "
            "values"
        )

    def chosen(self, labels: Sequence[int], what: str = "label") -> Mask:
        """Mask (a, b, c) of the voxels with one of some labels.

        Raises:
            InputError: a label without voxels.
        """
        for label in labels:
            if label not in self.labels and label != 0:
                known = ", ".join(map(str, self.labels[:20])) or "none but 0"
                raise InputError(f"{what} {label} is not in {self.name}; its labels are {known}")
        return np.stack([np.isin(part, labels) for part in self.values])

    def between(self, low: float, high: float, what: str = "range") -> Mask:
        """Mask (a, b, c) of the voxels with values from `low` to `high`.

        Raises:
            InputError: there is no such voxel.
        """
        mask = np.stack([(part >= low) & (part <= high) for part in self.values])
        if not mask.any():
            smallest, largest = np.nanmin(self.values), np.nanmax(self.values)
            raise InputError(
                f"{what} {low:g} to {high:g} matches no voxel of {self.name}; its values are {smallest:g} to "
                f"{largest:g}"
            )
        return np.asarray(mask)


class LabelSegment(NamedTuple):
    """Segment of 3D Slicer in an image with layers."""

    layer: int
    value: int
    """Value of its voxels in the layer."""


@dataclass(frozen=True, eq=False)
class LayeredImage(LabelImage):
    """Overlapping segments of 3D Slicer in several layers; `.values` is the first layer."""

    layers: Any = field(kw_only=True, repr=False)
    """Values of the layers (layers, a, b, c)."""
    segments: dict[int, LabelSegment] = field(kw_only=True)
    """Segments by label."""

    @cached_property
    def labels(self) -> tuple[int, ...]:
        """Labels of the segments."""
        return tuple(sorted(self.segments))

    def chosen(self, labels: Sequence[int], what: str = "label") -> Mask:
        """Mask (a, b, c) of the voxels in some segments; label 0 selects voxels without a segment.

        Raises:
            InputError: an unknown label.
        """
        mask = np.zeros(self.shape, dtype=bool)
        for label in labels:
            if label == 0:
                mask |= ~self.chosen(self.labels)
                continue
            if label not in self.segments:
                raise InputError(
                    f"{what} {label} is not in {self.name}; its labels are {', '.join(map(str, self.labels))}"
                )
            layer, value = self.segments[label]
            mask |= self.layers[layer] == value
        return mask

    def between(self, low: float, high: float, what: str = "range") -> Mask:
        """Raise InputError: segments have no range of values."""
        raise InputError(f"{what} is given for {self.name}, which has segments; give labels: {self.labels}")


class ImageData(NamedTuple):
    """Contents of an image file."""

    values: Any
    """Values of the voxels (a, b, c), or with layers (layers, a, b, c)."""
    affine: Array
    """Map from indices to RAS (4, 4)."""
    unit: float
    """Unit of length of the map, m."""
    segments: dict[int, LabelSegment]
    """Segments by label, of an image with layers; otherwise empty."""


def read_image(path: str | PathLike[str], axes: str | None = None) -> LabelImage:
    """Image from a NIfTI (.nii, .nii.gz), FreeSurfer (.mgz, .mgh) or NRRD (.nrrd, .nhdr) file.

    Args:
        axes: axes of the voxels, RAS or LPS, with the first voxel at the origin, if the header does not state the pose
            of the image in the patient. For a NRRD file without a space: axes of its directions and its origin.

    Raises:
        InputError: no such file, a file that cannot be read, or more than one number per voxel. Axes that are not
            orthogonal, unknown or contradictory; voxels of an implausible size; nibabel or pynrrd is not installed.
    """
    if axes is not None:
        choice("axes", axes, AXES)
    file = Path(path)
    name = file.name.lower()
    if file.is_dir():
        raise InputError(
            f"{path}: this is a directory; it must be a file (convert DICOM slices with 3D Slicer or dcm2niix)"
        )
    if not file.is_file():
        raise no_such_file(path)
    if name.endswith((".nii", ".nii.gz", ".mgz", ".mgh")):
        read: Callable[[Path, str | None], ImageData] = _nifti
    elif name.endswith((".nrrd", ".nhdr")):
        read = _nrrd
    else:
        raise InputError(f"{path} is not a supported image; it must be .nii, .nii.gz, .mgz, .nrrd or .nhdr")
    try:
        data = read(file, axes)
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{path}: the image does not fit into memory; crop it, or make its voxels larger") from None
    # For a damaged file nibabel, pynrrd and zlib raise errors without a common base: ImageFileError, NRRDError,
    # zlib.error, StopIteration, KeyError and others.
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no image can be read from it: {reason}") from None
    if not data.segments:
        return _image_of(data, str(path))
    first = _image_of(data._replace(values=data.values[0]), str(path))
    return LayeredImage(
        first.values, first.spacing, first.frame, first.name, layers=data.values, segments=data.segments
    )


def _image_of(data: ImageData, name: str) -> LabelImage:
    """Image with size and frame of its voxels from the affine map."""
    affine = np.asarray(data.affine, dtype=float)
    if affine.shape != (4, 4) or not np.isfinite(affine).all():
        raise InputError(f"{name}: the header has no voxel positions")
    size = np.linalg.norm(affine[:3, :3], axis=0)
    if (size == 0).any():
        raise InputError(f"{name}: its header gives voxels no size along axis {int(np.argmin(size)) + 1}")
    axes = affine[:3, :3] / size
    skew = np.abs(axes.T @ axes - np.eye(3)).max()
    if skew > SKEW:
        angle = np.degrees(np.arcsin(min(skew, 1.0)))
        raise InputError(f"{name}: the axes of the image are {angle:.3g} deg from orthogonal; resample it")
    u, _, v = np.linalg.svd(axes)
    axes, spacing = u @ v, size * data.unit
    if spacing.min() < TYPICAL_VOXEL[0] or spacing.max() > TYPICAL_VOXEL[1]:
        mm = ", ".join(f"{each * 1e3:g}" for each in spacing)
        raise InputError(
            f"{name}: the voxels are {mm} mm; voxels of scans are {TYPICAL_VOXEL[0] * 1e3:g} to "
            f"{TYPICAL_VOXEL[1] * 1e3:g} mm; check the unit in the header"
        )
    return LabelImage(data.values, spacing, Frame(axes, affine[:3, 3] * data.unit), name)


def _check_size(shape: Sequence[int], bytes_per_voxel: int, path: Path) -> None:
    """Raise InputError for an image that has not three dimensions or is too large."""
    sizes = " x ".join(map(str, shape))
    if len(shape) != 3 or min(shape) < 1:
        raise InputError(f"{path} has {sizes or 'no'} voxels; it must be one image of three dimensions")
    size = bytes_per_voxel * math.prod(map(int, shape))
    if size > MAX_BYTES:
        raise InputError(
            f"{path} has {sizes} voxels, {size / 1e9:.3g} GB; it must have {MAX_BYTES / 1e9:g} GB at most: crop it "
            "to the region of interest, or write its labels as bytes"
        )


def _signs(path: Path, stated: str, axes: str | None) -> Array:
    """Signs (3,) that convert the axes of an image to RAS, from those in its header ("" for none) or `axes`.

    Raises:
        InputError: axes that are unknown or contradict each other.
    """
    if not stated and axes is None:
        raise InputError(
            f"{path}: its header does not say how the image lies in the patient; give the axes of its voxels (of the "
            "key image as image_axes): RAS or LPS"
        )
    if stated and axes is not None and stated != axes:
        raise InputError(f"{path}: axes is {axes}, but the header states {stated}; leave axes out, or correct the file")
    return np.array([*(SIGNS[letter] for letter in (stated or str(axes)).lower()[:2]), 1.0])


def _nifti(path: Path, axes: str | None) -> ImageData:
    nibabel = import_extra("nibabel", "anatomy", "NIfTI files")
    logging.getLogger("nibabel.global").setLevel(logging.CRITICAL + 1)  # faults of the header are reported below
    image = nibabel.load(str(path))
    shape = image.shape
    while len(shape) > 3 and shape[-1] == 1:
        shape = shape[:-1]
    header = image.header
    _check_size(shape, int(header.get_data_dtype().itemsize), path)
    unit, affine, known = "mm", np.asarray(image.affine), True
    if hasattr(header, "get_xyzt_units"):  # FreeSurfer files always have one pose, in mm
        codes = int(header["sform_code"]), int(header["qform_code"])
        known = any(codes)
        if all(codes):
            difference = np.abs(header.get_sform() - header.get_qform()).max()
            if difference > AGREE * np.linalg.norm(header.get_sform()[:3, :3], axis=0).min():
                LOGGER.warning(f"{path}: sform and qform of the header differ; the sform is used")
        unit = header.get_xyzt_units()[0]
    signs = _signs(path, "RAS" if known else "", axes)
    if not known:
        affine = np.diag([*(signs * np.asarray(header.get_zooms()[:3], dtype=float)), 1.0])
    slope, inter = image.dataobj.slope, image.dataobj.inter  # nibabel removes them from the header
    raw = np.asarray(image.dataobj.get_unscaled()).reshape(shape)
    slope, inter = 1.0 if slope is None else float(slope), 0.0 if inter is None else float(inter)
    if (slope, inter) != (1.0, 0.0):
        raw = np.stack([part.astype(np.float32) * np.float32(slope) + np.float32(inter) for part in raw])
    return ImageData(raw, affine, UNITS.get(unit, 1e-3), {})


def _segments(header: dict[str, Any], layers: int, path: Path) -> dict[int, LabelSegment]:
    """Segments of 3D Slicer in a header, by label.

    Labels are the values of the voxels. If segments of different layers have the same value, labels are the numbers of
    the segments from 1.
    """
    segments: list[LabelSegment] = []
    names: list[str] = []
    while f"Segment{len(segments)}_LabelValue" in header:
        prefix = f"Segment{len(segments)}_"
        try:
            segments.append(LabelSegment(int(header.get(f"{prefix}Layer", 0)), int(header[f"{prefix}LabelValue"])))
        except ValueError:
            raise InputError(
                f"{path}: {prefix}Layer and {prefix}LabelValue of its header must be whole numbers"
            ) from None
        names.append(str(header.get(f"{prefix}Name", f"segment {len(segments)}")))
        if not 0 <= segments[-1].layer < layers:
            raise InputError(f"{path}: {prefix}Layer is {segments[-1].layer}; it must be from 0 to {layers - 1}")
    if not segments:
        raise InputError(f"{path} has {layers} layers, but names no segments; save the segmentation with 3D Slicer")
    values = [segment.value for segment in segments]
    if len(set(values)) == len(values):
        return dict(zip(values, segments, strict=True))
    listed = ", ".join(f"{k} {name}" for k, name in enumerate(names, start=1))
    LOGGER.warning(f"{path}: segments of different layers have the same value; their labels are {listed}")
    return dict(enumerate(segments, start=1))


def _nrrd(path: Path, axes: str | None) -> ImageData:
    nrrd = import_extra("nrrd", "anatomy", "NRRD files")
    head = nrrd.read_header(str(path))
    size_of_number = next((size for names, size in BYTES.items() if any(word in head["type"] for word in names)), 1)
    sizes = [int(size) for size in head["sizes"]]
    # Layers are the first axis. A sequence of one volume has an axis without direction.
    layered = len(sizes) == 4 and sizes[0] > 1 and str((head.get("kinds") or [""])[0]).lower() == "list"
    segments = _segments(head, sizes[0], path) if layered else {}
    lost = (0,) if layered else tuple(k for k, size in enumerate(sizes) if size == 1)[: max(len(sizes) - 3, 0)]
    voxel = size_of_number * (sizes[0] if layered else 1)
    _check_size([size for k, size in enumerate(sizes) if k not in lost], voxel, path)
    values, header = nrrd.read(str(path), index_order="F")
    values, directions = values if layered else values.squeeze(lost), header.get("space directions")
    space = str(header.get("space", "")).lower()
    if directions is None:
        directions = np.diag(np.asarray(header.get("spacings", np.full(len(sizes), np.nan)), dtype=float))
        directions = np.delete(directions, lost, axis=1)
    rows = np.delete(np.asarray(directions, dtype=float), lost, axis=0)  # one per axis of the image
    if not np.isfinite(rows).all():
        raise InputError(f"{path}: the header has no voxel size or position")
    affine = np.eye(4)
    affine[:3, :3] = rows.T
    affine[:3, 3] = np.asarray(header.get("space origin", np.zeros(3)), dtype=float)
    names = space.split("-") if "-" in space else list(space)
    if space and not (len(names) == 3 and names[2] in ("superior", "s") and all(word in SIGNS for word in names[:2])):
        raise InputError(
            f"{path}: its space is {space!r}; it must be right-anterior-superior, or with left or posterior"
        )
    letters, has_directions = "".join(word[0] for word in names).upper(), header.get("space directions") is not None
    signs = _signs(path, letters if has_directions else "", axes)
    if not has_directions:
        _signs(path, letters, axes)  # for its errors
    affine[:3] *= signs[:, None]
    units = header.get("space units") or ["mm"]
    return ImageData(values, affine, UNITS.get(str(units[0]).strip('"'), 1e-3), segments)


# Largest number of nodes of a distance field, for a few seconds and half a gigabyte; otherwise voxels are merged.
MAX_NODES = 12_000_000

# Number of voxels around the body or the lumen: gradients at its border need a neighbour.
BORDER = 2

# Length (m) by which a lumen that meets the border of the image continues beyond it.
BEYOND = 0.02


def field_of_image(
    image: LabelImage,
    *,
    lumen: Mask | None = None,
    forbidden: Mask | None = None,
    region: tuple[Array, Array] | None = None,
    max_nodes: int = MAX_NODES,
    name: str = "image",
) -> DistanceField:
    """Distance field of the voxels that the arm must avoid, in the axes of the patient.

    Args:
        lumen: (a, b, c) voxels in which the arm must stay: all others are forbidden. At the border of the image they
            continue beyond it.
        forbidden: (a, b, c) voxels that are forbidden, in the same image.
        region: two corners (3,), m, in the axes of the patient. Everything outside their bounding box along the voxel
            axes is forbidden.
        max_nodes: maximum number of lattice nodes. Above it voxels are merged, and one forbidden voxel makes the whole
            cell forbidden; `.node_error` is the loss.

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
    free, merged = _coarser(free, image.spacing, max_nodes)
    spacing = image.spacing * merged
    if (merged > 1).any():
        cell = " x ".join(f"{each * 1e3:.3g}" for each in spacing)
        LOGGER.warning(
            f"{image.name}: the region has more than {max_nodes:.2g} voxels; distances are computed on cells of "
            f"{cell} mm"
        )
    lost = float(np.linalg.norm((merged - 1) * image.spacing))
    origin = image.frame.placed((first - 0.5) * image.spacing)
    return DistanceField(
        _distances(free, spacing), spacing, Frame(image.frame.axes, origin), lost, not open_ended, name
    )


def _box(
    image: LabelImage, lumen: Mask | None, forbidden: Mask | None, region: tuple[Array, Array] | None
) -> tuple[tuple[slice, ...], list[tuple[int, int]]]:
    """Relevant part of the image, and numbers of voxels to add before and after it along every axis."""
    shape = image.shape
    if region is not None:
        low, high = (np.asarray(corner, dtype=float) for corner in region)
        if not (low < high).all():
            first, second = (", ".join(f"{x * 1e3:g}" for x in corner) for corner in (low, high))
            raise InputError(f"the region goes from {first} to {second} mm; its first corner must be the lower one")
        corners = image.frame.seen(list(product(*zip(low, high, strict=True)))) / image.spacing
        low, high = corners.min(0), corners.max(0)
        start = np.clip(np.floor(low + 0.5), 0, shape).astype(int)
        stop = np.clip(np.ceil(high + 0.5), 0, shape).astype(int)
        if (stop <= start).any():
            raise InputError(f"the region is outside {image.name}; it must overlap it")
        return tuple(slice(a, b) for a, b in zip(start.tolist(), stop.tolist(), strict=True)), [(1, 1)] * 3
    chosen = lumen if lumen is not None else forbidden
    assert chosen is not None
    if not chosen.any():
        raise InputError(f"no voxel of {image.name} is chosen")
    box, padding = [], []
    for axis in range(3):
        along = np.flatnonzero(chosen.any(tuple(k for k in range(3) if k != axis)))
        a, b = max(int(along[0]) - BORDER, 0), min(int(along[-1]) + 1 + BORDER, shape[axis])
        box.append(slice(a, b))
        beyond = int(np.ceil(BEYOND / image.spacing[axis]))
        padding.append((beyond if along[0] == 0 else 0, beyond if along[-1] == shape[axis] - 1 else 0))
    return tuple(box), padding if lumen is not None else [(BORDER, BORDER)] * 3


def _coarser(free: Mask, spacing: Array, max_nodes: int) -> tuple[Mask, Any]:
    """Merge voxels to cells of similar sides until there are few enough; returns them and their numbers of voxels."""
    merged = np.ones(3, dtype=int)
    while np.prod(np.ceil(np.array(free.shape) / merged) + 1) > max_nodes:
        merged[np.argmin(merged * spacing)] += 1
    if (merged == 1).all():
        return free, merged
    missing = [(0, int(-size % k)) for size, k in zip(free.shape, merged, strict=True)]
    padded = np.pad(free, missing, mode="edge")
    for axis, k in enumerate(merged):
        shape = [*padded.shape[:axis], padded.shape[axis] // k, k, *padded.shape[axis + 1 :]]
        padded = np.asarray(padded.reshape(shape).all(axis + 1))
    return padded, merged


def _distances(free: Mask, spacing: Array) -> Array:
    """Signed distances of the corners of voxels from the cuboids of voxels that are not free, m."""
    if free.all():
        return np.full(np.array(free.shape) + 1, float(spacing.sum()))
    out = _transform(_at_corners(~free), spacing)
    if free.any():
        out -= _transform(_at_corners(free), spacing)
    else:
        out -= np.float32(np.linalg.norm(spacing))
    return out


def _at_corners(voxels: Mask) -> Mask:
    """Mask (a + 1, b + 1, c + 1) of the corners of voxels (a, b, c)."""
    out = np.zeros(np.array(voxels.shape) + 1, dtype=bool)
    for i, j, k in product((0, 1), repeat=3):
        a, b, c = voxels.shape
        out[i : i + a, j : j + b, k : k + c] |= voxels
    return out


def _transform(mask: Mask, spacing: Array) -> Array:
    """Distances of all nodes from the nearest node of a mask, m; float32, slab by slab, to bound the memory."""
    index = scipy.ndimage.distance_transform_edt(~mask, sampling=spacing, return_distances=False, return_indices=True)
    out: Array = np.empty(mask.shape, dtype=np.float32)
    b, c = np.ogrid[: mask.shape[1], : mask.shape[2]]
    for a in range(len(out)):
        square = ((index[0, a] - a) * spacing[0]) ** 2
        square += ((index[1, a] - b) * spacing[1]) ** 2
        square += ((index[2, a] - c) * spacing[2]) ** 2
        out[a] = np.sqrt(square)
    return out
