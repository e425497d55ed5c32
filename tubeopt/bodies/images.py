"""Images of patients: NIfTI and NRRD files as labels, or values, of voxels in the patient, and labels as a body.

Such a body is the union of the closed cuboids of the voxels in which the arm may not be, so that an arm that is clear
of it touches none of them. From a corner of voxels the nearest place of a cuboid is one of its corners: on the lattice
of corners the Euclidean distance transform gives the distance from all of them exactly, with its sign on either side.
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
from typing import Any

import numpy as np
import scipy

from ..errors import InputError, choice, extra
from ..files.files import no_such_file
from ..typing import Array, Mask
from .distance_field import DistanceField
from .frames import AXES, Frame

LOGGER = logging.getLogger(__name__)

# Bytes of the voxels of an image at most: what a machine with 4 GB can read.
MOST_BYTES = 1_200_000_000

# Sizes (m) that voxels of scans have.
USUAL = 1e-5, 2e-2

# Cosine between axes of an image up to which they count as square to each other: rounding of the numbers in a header.
SKEW = 1e-3

# Fraction of a voxel by which two headers may differ: less moves no label.
AGREE = 0.1

# Distinct values above which an image is not one of labels: scans have 12 bits and more.
MOST_LABELS = 4096

# Of a voxel, by what is in the names that NRRD has for its kinds of numbers; the first that fits.
BYTES = {("64", "long", "double"): 8, ("16", "short"): 2, ("8", "char"): 1, ("32", "int", "float"): 4}

# Directions of the axes of a NRRD file, by those of RAS.
SIGNS = {"left": -1.0, "l": -1.0, "right": 1.0, "r": 1.0, "posterior": -1.0, "p": -1.0, "anterior": 1.0, "a": 1.0}

# Names of units in headers, in m; where none is given it is mm.
UNITS = {"mm": 1e-3, "meter": 1.0, "micron": 1e-6, "m": 1.0, "um": 1e-6, "unknown": 1e-3}


@dataclass(frozen=True, eq=False)
class LabelImage:
    """Values of voxels.

    Raises:
        InputError: no image of three dimensions, or voxels without a size.
    """

    values: Any = field(repr=False)
    """(a, b, c) labels, or other values."""
    spacing: Array
    """(3,) sizes of a voxel, m."""
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
        """Voxels along each axis."""
        a, b, c = np.shape(self.values)
        return a, b, c

    def holds(self, place: Array) -> bool:
        """True if a position (3,) in the patient, m, lies in one of the voxels."""
        index = self.frame.seen(place) / self.spacing
        return bool(((index >= -0.5) & (index <= np.array(self.shape) - 0.5)).all())

    @cached_property
    def labels(self) -> tuple[int, ...]:
        """The labels there are, but 0.

        Raises:
            InputError: numbers that are not whole, or too many of them.
        """
        found: set[int] = set()
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
                found.update((low + np.flatnonzero(np.bincount(part.ravel().astype(np.int64) - low))).tolist())
            else:
                found.update(np.unique(part).tolist())
            if len(found) > MOST_LABELS:
                raise self._no_labels(f"more than {MOST_LABELS} values")
        return tuple(sorted(value for value in found if value))

    def _no_labels(self, why: str) -> InputError:
        return InputError(
            f"{self.name} is not a label image: it has {why}; segment it first, or select voxels by a range of values"
        )

    def chosen(self, labels: Sequence[int], what: str = "label") -> Mask:
        """(a, b, c) voxels that have one of some labels.

        Raises:
            InputError: a label that no voxel has.
        """
        for label in labels:
            if label not in self.labels and label != 0:
                known = ", ".join(map(str, self.labels[:20])) or "none but 0"
                raise InputError(f"{what} {label} is not in {self.name}; its labels are {known}")
        return np.stack([np.isin(part, labels) for part in self.values])

    def between(self, low: float, high: float, what: str = "range") -> Mask:
        """(a, b, c) mask of the voxels with values from `low` to `high`.

        Raises:
            InputError: there is no such voxel.
        """
        found = np.stack([(part >= low) & (part <= high) for part in self.values])
        if not found.any():
            least, most = np.nanmin(self.values), np.nanmax(self.values)
            raise InputError(
                f"{what} {low:g} to {high:g} matches no voxel of {self.name}; its values are {least:g} to {most:g}"
            )
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class LayeredImage(LabelImage):
    """Segments of 3D Slicer that overlap: several layers of labels; `.values` is the first one."""

    layers: Any = field(kw_only=True, repr=False)
    """(layers, a, b, c) labels."""
    segments: dict[int, tuple[int, int]] = field(kw_only=True)
    """Label -> layer and value there."""

    @cached_property
    def labels(self) -> tuple[int, ...]:
        """The labels of the segments."""
        return tuple(sorted(self.segments))

    def chosen(self, labels: Sequence[int], what: str = "label") -> Mask:
        """(a, b, c) voxels in one of some segments; label 0 is where no segment is.

        Raises:
            InputError: a label of no segment.
        """
        found = np.zeros(self.shape, dtype=bool)
        for label in labels:
            if label == 0:
                found |= ~self.chosen(self.labels)
                continue
            if label not in self.segments:
                raise InputError(
                    f"{what} {label} is not in {self.name}; its labels are {', '.join(map(str, self.labels))}"
                )
            layer, value = self.segments[label]
            found |= self.layers[layer] == value
        return found

    def between(self, low: float, high: float, what: str = "range") -> Mask:
        """A range of values means nothing for segments: raises InputError."""
        raise InputError(f"{what} is given for {self.name}, which has segments; give labels: {self.labels}")


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
        read: Callable[[Path, str | None], tuple[Any, Array, float, dict[int, tuple[int, int]]]] = _nifti
    elif name.endswith((".nrrd", ".nhdr")):
        read = _nrrd
    else:
        raise InputError(f"{path} is not a supported image; it must be .nii, .nii.gz, .mgz, .nrrd or .nhdr")
    try:
        values, affine, length, segments = read(file, axes)
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{path}: the image does not fit into memory; crop it, or make its voxels larger") from None
    # Of a damaged file nibabel, pynrrd and zlib raise errors that share no base: ImageFileError, NRRDError, zlib.error,
    # StopIteration, KeyError and others.
    except Exception as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no image can be read from it: {words}") from None
    if not segments:
        return _placed(values, affine, length, str(path))
    first = _placed(values[0], affine, length, str(path))
    return LayeredImage(first.values, first.spacing, first.frame, first.name, layers=values, segments=segments)


def _placed(values: Any, affine: Array, length: float, name: str) -> LabelImage:
    """The image from the affine map (4, 4) of its indices to RAS, in units of `length` m."""
    affine = np.asarray(affine, dtype=float)
    if affine.shape != (4, 4) or not np.isfinite(affine).all():
        raise InputError(f"{name}: the header has no voxel positions")
    size = np.linalg.norm(affine[:3, :3], axis=0)
    if (size == 0).any():
        raise InputError(f"{name}: its header gives voxels no size along axis {int(np.argmin(size)) + 1}")
    axes = affine[:3, :3] / size
    skew = np.abs(axes.T @ axes - np.eye(3)).max()
    if skew > SKEW:
        lean = np.degrees(np.arcsin(min(skew, 1.0)))
        raise InputError(f"{name}: the axes of the image are {lean:.3g} deg from orthogonal; resample it")
    u, _, v = np.linalg.svd(axes)
    axes, spacing = u @ v, size * length
    if spacing.min() < USUAL[0] or spacing.max() > USUAL[1]:
        mm = ", ".join(f"{each * 1e3:g}" for each in spacing)
        raise InputError(
            f"{name}: the voxels are {mm} mm; voxels of scans are {USUAL[0] * 1e3:g} to "
            f"{USUAL[1] * 1e3:g} mm; check the unit in the header"
        )
    return LabelImage(values, spacing, Frame(axes, affine[:3, 3] * length), name)


def _check_size(shape: Sequence[int], each: int, path: Path) -> None:
    """Raise InputError for what has not three dimensions, or does not fit; `each` bytes per voxel."""
    sizes = " x ".join(map(str, shape))
    if len(shape) != 3 or min(shape) < 1:
        raise InputError(f"{path} has {sizes or 'no'} voxels; it must be one image of three dimensions")
    size = each * math.prod(map(int, shape))
    if size > MOST_BYTES:
        raise InputError(
            f"{path} has {sizes} voxels, {size / 1e9:.3g} GB; it must have {MOST_BYTES / 1e9:g} GB at most: crop it "
            "to the region of interest, or write its labels as bytes"
        )


def _signs(path: Path, stated: str, axes: str | None) -> Array:
    """(3,) signs that bring the axes of an image to RAS, from what its header states, "" for nothing, or else `axes`.

    Raises:
        InputError: neither says anything, or they contradict each other.
    """
    if not stated and axes is None:
        raise InputError(
            f"{path}: its header does not say how the image lies in the patient; give the axes of its voxels (of the "
            "key image as image_axes): RAS or LPS"
        )
    if stated and axes is not None and stated != axes:
        raise InputError(f"{path}: axes is {axes}, but the header states {stated}; leave axes out, or correct the file")
    return np.array([*(SIGNS[letter] for letter in (stated or str(axes)).lower()[:2]), 1.0])


def _nifti(path: Path, axes: str | None) -> tuple[Any, Array, float, dict[int, tuple[int, int]]]:
    """Values, affine map to RAS, the unit of length in m, and no segments."""
    nibabel = extra("nibabel", "anatomy", "NIfTI files")
    logging.getLogger("nibabel.global").setLevel(logging.CRITICAL + 1)  # what it has to say is said below
    image = nibabel.load(str(path))
    shape = image.shape
    while len(shape) > 3 and shape[-1] == 1:
        shape = shape[:-1]
    header = image.header
    _check_size(shape, int(header.get_data_dtype().itemsize), path)
    unit, affine, known = "mm", np.asarray(image.affine), True
    if hasattr(header, "get_xyzt_units"):  # which those of FreeSurfer have not, nor another place than one in mm
        known = _has_place(header, path)
        unit = header.get_xyzt_units()[0]
    signs = _signs(path, "RAS" if known else "", axes)
    if not known:
        affine = np.diag([*(signs * np.asarray(header.get_zooms()[:3], dtype=float)), 1.0])
    slope, inter = image.dataobj.slope, image.dataobj.inter  # which the header of a loaded image has no more
    raw = np.asarray(image.dataobj.get_unscaled()).reshape(shape)
    slope, inter = 1.0 if slope is None else float(slope), 0.0 if inter is None else float(inter)
    if (slope, inter) != (1.0, 0.0):
        raw = np.stack([part.astype(np.float32) * np.float32(slope) + np.float32(inter) for part in raw])
    return raw, affine, UNITS.get(unit, 1e-3), {}


def _has_place(header: Any, path: Path) -> bool:
    """Whether a header of NIfTI says the place of the image; a warning where it says two."""
    said = int(header["sform_code"]), int(header["qform_code"])
    if all(said):
        off = np.abs(header.get_sform() - header.get_qform()).max()
        if off > AGREE * np.linalg.norm(header.get_sform()[:3, :3], axis=0).min():
            LOGGER.warning(f"{path}: sform and qform of the header differ; the sform is used")
    return any(said)


def _segments(about: dict[str, Any], layers: int, path: Path) -> dict[int, tuple[int, int]]:
    """Label -> layer and value of the segments that 3D Slicer names in a header; their numbers from 1, in the order of
    the file, where segments of different layers have the same value."""
    found: list[tuple[int, int]] = []
    names: list[str] = []
    while f"Segment{len(found)}_LabelValue" in about:
        own = f"Segment{len(found)}_"
        try:
            found.append((int(about.get(f"{own}Layer", 0)), int(about[f"{own}LabelValue"])))
        except ValueError:
            raise InputError(f"{path}: {own}Layer and {own}LabelValue of its header must be whole numbers") from None
        names.append(str(about.get(f"{own}Name", f"segment {len(found)}")))
        if not 0 <= found[-1][0] < layers:
            raise InputError(f"{path}: {own}Layer is {found[-1][0]}; it must be from 0 to {layers - 1}")
    if not found:
        raise InputError(f"{path} has {layers} layers, but names no segments; save the segmentation with 3D Slicer")
    values = [value for _, value in found]
    if len(set(values)) == len(values):
        return dict(zip(values, found, strict=True))
    listed = ", ".join(f"{k} {name}" for k, name in enumerate(names, start=1))
    LOGGER.warning(f"{path}: segments of different layers have the same value; their labels are {listed}")
    return dict(enumerate(found, start=1))


def _nrrd(path: Path, axes: str | None) -> tuple[Any, Array, float, dict[int, tuple[int, int]]]:
    """Values, affine map to RAS, the unit of length in m, and the segments of layers, which are the first axis then."""
    nrrd = extra("nrrd", "anatomy", "NRRD files")
    about = nrrd.read_header(str(path))
    each = next((size for words, size in BYTES.items() if any(word in about["type"] for word in words)), 1)
    sizes = [int(size) for size in about["sizes"]]
    # A sequence of one volume has an axis that lies nowhere.
    layered = len(sizes) == 4 and sizes[0] > 1 and str((about.get("kinds") or [""])[0]).lower() == "list"
    segments = _segments(about, sizes[0], path) if layered else {}
    lost = (0,) if layered else tuple(k for k, size in enumerate(sizes) if size == 1)[: max(len(sizes) - 3, 0)]
    voxel = each * (sizes[0] if layered else 1)
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
    words = space.split("-") if "-" in space else list(space)
    if space and not (len(words) == 3 and words[2] in ("superior", "s") and all(word in SIGNS for word in words[:2])):
        raise InputError(
            f"{path}: its space is {space!r}; it must be right-anterior-superior, or with left or posterior"
        )
    letters, lies = "".join(word[0] for word in words).upper(), header.get("space directions") is not None
    signs = _signs(path, letters if lies else "", axes)
    if not lies:
        _signs(path, letters, axes)
    affine[:3] *= signs[:, None]
    units = header.get("space units") or ["mm"]
    return values, affine, UNITS.get(str(units[0]).strip('"'), 1e-3), segments


# Nodes of a distance field at most, which take a few seconds and half a gigabyte; else voxels are taken together.
MOST_NODES = 12_000_000

# Voxels around the body, or the path within it, that the lattice has in addition: gradients at its border need a
# neighbour.
ROUND = 2

# Length (m) by which a way that meets the border of the image goes on beyond it.
BEYOND = 0.02


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
