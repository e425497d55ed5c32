"""Scan or photo of a tube, and its scale: pixels to millimetres of the plane in which the tube lies.

A scan has its scale from its resolution. A photo has it from four marks at the corners of a printed rectangle: they
determine the map between image and sheet, with its tilt. The focal length then determines the camera's position, and
with it the map to the plane of the tube's axis, which is half a diameter above the sheet.
"""

from __future__ import annotations

import io
import math
import warnings
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
import scipy

from ...errors import InputError
from ...files.files import read_bytes
from ...files.units import TO_MM
from ...typing import Array

SHEET_MARKS = 0.240, 0.170
"""Distances of the marks of the printed sheet along its length and width, m: they fit A4 and Letter."""

MARK_RADII = 2e-3, 4e-3, 6e-3
"""Radii of a mark, m: of the black dot, and inside and outside of the black ring around it."""

SCAN_DPI = 90.0, 10000.0
"""Resolutions of scanners, dots per inch."""

NO_RESOLUTION = 72.0, 96.0
"""Resolutions that programs write where they know none."""

USUAL_FOCAL, FOCAL_RANGE = 30e-3, 0.5
"""Focal length of a camera that notes none, m on 35 mm film, and its relative error."""

NOTED_RANGE = 0.1
"""Relative error of a noted focal length."""

FILM_DIAGONAL = 43.27e-3
"""Diagonal of a picture on 35 mm film, m."""

MARK_PIXELS = 1600
"""Pixels along the longer side of the image in which marks are searched."""

MIN_DOT = 20
"""Smallest number of pixels of the dot of a mark in this image."""


@dataclass(frozen=True, eq=False)
class TubePhoto:
    """Scan or photo of a tube."""

    name: str
    """Name of the file, without its folder."""
    grey: Array
    """(rows, columns) brightness, 0 to 1."""
    dpi: float | None = None
    """Resolution noted in the file, dots per inch."""
    camera: bool = False
    """True if the file has notes of a camera, such as an exposure time."""
    focal_length: float | None = None
    """Focal length noted in the file, m on 35 mm film."""


def load_photo(path: str | PathLike[str]) -> TubePhoto:
    """Load a PNG, JPEG or TIFF with its resolution and focal length, upright.

    Raises:
        InputError: no such file, or no picture in it.
    """
    from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

    content = read_bytes(path)
    try:
        # Pillow warns from half of its limit on, which scans at 1200 dpi exceed.
        with (
            warnings.catch_warnings(action="ignore", category=Image.DecompressionBombWarning),
            Image.open(io.BytesIO(content)) as image,
        ):
            # Notes of a PNG may come after its pixels.
            image.load()
            noted = image.getexif().get_ifd(ExifTags.IFD.Exif)
            dpi = image.info.get("dpi", (0.0, 0.0))
            upright = ImageOps.exif_transpose(image)
    except UnidentifiedImageError:
        raise InputError(f"{path}: this is no picture that can be read; it must be a PNG, JPEG or TIFF") from None
    except Image.DecompressionBombError:
        raise InputError(
            f"{path}: the picture has more than {2 * (Image.MAX_IMAGE_PIXELS or 0) / 1e6:.0f} million pixels; it must "
            "have fewer: cut it to the tube, or scan at a lower resolution"
        ) from None
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: the picture cannot be read: {error}") from None
    if upright.mode in ("RGBA", "LA", "PA", "P"):
        # Transparent parts are paper.
        upright = Image.alpha_composite(Image.new("RGBA", upright.size, "white"), upright.convert("RGBA"))
    deep = upright.mode.startswith("I") or upright.mode == "F"
    grey: Array = np.asarray(upright if deep else upright.convert("L"), dtype=float)
    brightest = float(grey.max()) if deep else 255.0
    focal = noted.get(ExifTags.Base.FocalLengthIn35mmFilm)
    cameras = ExifTags.Base.ExposureTime, ExifTags.Base.FNumber, ExifTags.Base.FocalLength
    return TubePhoto(
        Path(path).name,
        grey / max(brightest, 1e-9),
        # PNG has pixels per metre: 72 dpi comes back as 72.009.
        round(float(dpi[0]), 1) if float(dpi[0]) > 0 else None,
        any(tag in noted for tag in cameras),
        float(focal) / TO_MM if focal else None,
    )


@dataclass(frozen=True, eq=False)
class PhotoScale:
    """Map between the pixels of an image and the plane of a tube's axis."""

    to_pixels: Array
    """(3, 3) homography: points of the sheet or of the scanner's glass (m) to pixels (column, row)."""
    size: tuple[float, float] | None
    """Sides of the rectangle of marks, m; None for a scan."""
    focal: float | None = None
    """Focal length, pixels; None for a scan."""
    middle: tuple[float, float] = (0.0, 0.0)
    """Pixel (column, row) on the camera's axis."""
    focal_range: float = 0.0
    """Relative error of the focal length."""

    @property
    def pitch(self) -> float:
        """Size of a pixel in the middle of the sheet, m."""
        centre = np.zeros(2) if self.size is None else np.multiply(self.size, 0.5)
        a, b, c = mapped(self.to_pixels, centre + np.array([[0.0, 0.0], [1e-3, 0.0], [0.0, 1e-3]]))
        return 1e-3 / math.sqrt(abs(float(np.linalg.det(np.array([b - a, c - a])))))

    @property
    def tilt(self) -> float:
        """Angle between the camera's axis and the normal of the sheet, rad; 0 for a scan."""
        return 0.0 if self.focal is None else math.acos(min(1.0, abs(self._pose(self.focal)[2, 2])))

    def raised(self, points: Array, height: float, factor: float = 1.0) -> Array:
        """(N, 2) points of the sheet as points of the plane `height` (m) above it, seen in the same pixels.

        Args:
            factor: factor on the focal length.
        """
        if self.focal is None:
            return points
        return unmapped(self._raised(height, factor * self.focal), mapped(self.to_pixels, points))

    def lowered(self, points: Array, height: float) -> Array:
        """Inverse of `raised`."""
        if self.focal is None:
            return points
        return unmapped(self.to_pixels, mapped(self._raised(height, self.focal), points))

    def _raised(self, height: float, focal: float) -> Array:
        """(3, 3) homography from the plane `height` above the sheet to pixels."""
        x, y, away, origin = self._pose(focal).T
        return np.asarray(self._camera(focal) @ np.column_stack([x, y, origin - height * away]))

    def _camera(self, focal: float) -> Array:
        """(3, 3) camera matrix with square pixels."""
        return np.array([[focal, 0.0, self.middle[0]], [0.0, focal, self.middle[1]], [0.0, 0.0, 1.0]])

    def _pose(self, focal: float) -> Array:
        """(3, 4) rotation and translation (m) of the sheet in the camera's axes; its normal points away from it."""
        columns = np.linalg.solve(self._camera(focal), self.to_pixels)
        columns *= np.sign(columns[2, 2]) * 2 / (np.linalg.norm(columns[:, 0]) + np.linalg.norm(columns[:, 1]))
        normal = np.cross(columns[:, 0], columns[:, 1])
        return np.column_stack([columns[:, :2], normal / np.linalg.norm(normal), columns[:, 2]])


def mapped(homography: Array, points: Array) -> Array:
    """(N, 2) points under a homography."""
    full = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(full[:, :2] / full[:, 2:])


def unmapped(homography: Array, points: Array) -> Array:
    """(N, 2) points under the inverse of a homography."""
    return mapped(np.asarray(np.linalg.inv(homography), dtype=float), points)


def scale_of(photo: TubePhoto, dpi: float | None = None, marks: tuple[float, float] = SHEET_MARKS) -> PhotoScale:
    """Scale of a photo: of a given resolution, of four marks, or of the resolution in the file, in this order.

    Args:
        dpi: resolution of a scan, dots per inch.
        marks: distances of the marks, m.

    Raises:
        InputError: fewer than four marks, and no resolution.
    """
    if dpi is not None:
        return _scan_scale(dpi)
    found = find_marks(photo.grey)
    if len(found) >= 4:
        return _marks_scale(photo, found[:4], marks)
    usable = photo.dpi is not None and SCAN_DPI[0] <= photo.dpi <= SCAN_DPI[1] and photo.dpi not in NO_RESOLUTION
    if photo.dpi is not None and usable and not photo.camera and not len(found):
        return _scan_scale(photo.dpi)
    seen = f"{len(found)} of 4 marks were found" if len(found) else "no marks were found"
    noted = "no resolution" if photo.dpi is None else f"{photo.dpi:g} dpi, which is not that of a scanner"
    if photo.camera:
        noted = "notes of a camera, which say nothing of the size"
    raise InputError(
        f"{photo.name}: {seen}, and the file has {noted}; take the photo on the sheet of `tubeopt mold sheet` with all "
        "four marks in it, or give the resolution of a scan (dpi)"
    )


def _scan_scale(dpi: float) -> PhotoScale:
    if not SCAN_DPI[0] <= dpi <= SCAN_DPI[1]:
        raise InputError(f"dpi is {dpi:g}; it must be {SCAN_DPI[0]:g} to {SCAN_DPI[1]:g}, as resolutions of scans are")
    return PhotoScale(np.diag([dpi / 0.0254, dpi / 0.0254, 1.0]), None)


def _marks_scale(photo: TubePhoto, found: Array, marks: tuple[float, float]) -> PhotoScale:
    """Scale from the four marks, (4, 2) pixels, in any order."""
    from_middle = found - found.mean(axis=0)
    corners = found[np.argsort(np.arctan2(from_middle[:, 1], from_middle[:, 0]))]
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    # The longer sides of the image are those of the rectangle; which of the two comes first does not matter.
    if (sides[0] + sides[2] > sides[1] + sides[3]) != (marks[0] > marks[1]):
        corners = np.roll(corners, 1, axis=0)
    wide, tall = marks
    sheet = np.array([(0.0, 0.0), (wide, 0.0), (wide, tall), (0.0, tall)])
    rows = []
    for (x, y), (u, v) in zip(sheet, corners, strict=True):
        rows += [(x, y, 1, 0, 0, 0, -u * x, -u * y), (0, 0, 0, x, y, 1, -v * x, -v * y)]
    solution = np.linalg.solve(np.array(rows, dtype=float), corners.ravel())
    height, width = photo.grey.shape
    focal = (photo.focal_length or USUAL_FOCAL) / FILM_DIAGONAL * math.hypot(height, width)
    sure = NOTED_RANGE if photo.focal_length else FOCAL_RANGE
    to_pixels = np.append(solution, 1.0).reshape(3, 3)
    return PhotoScale(to_pixels, marks, focal, (0.5 * (width - 1), 0.5 * (height - 1)), sure)


def find_marks(grey: Array) -> Array:
    """(N, 2) centres (column, row) of the marks in an image, the largest first: rings with a dot in the middle."""
    factor = max(1, round(max(grey.shape) / MARK_PIXELS))
    small = shrunk(grey, factor)
    # Paper around the marks is brighter, whatever the light: marks are smaller than an eighth of the image.
    window = max(small.shape) // 8
    paper = scipy.ndimage.grey_closing(small, size=(window, window))
    labels, _ = scipy.ndimage.label(small < 0.6 * paper)
    area = np.bincount(labels.ravel())
    area[0] = 0
    index = np.flatnonzero(area >= MIN_DOT)
    if len(index) < 2:
        return np.empty((0, 2))
    centre = np.array(scipy.ndimage.center_of_mass(labels > 0, labels, index))
    found = scipy.ndimage.find_objects(labels)
    area, boxes = area[index], [found[k - 1] for k in index]
    marks = []
    for a, b in scipy.spatial.cKDTree(centre).query_pairs(r=window / 8):
        ring, dot = (a, b) if area[a] > area[b] else (b, a)
        tall, wide = (part.stop - part.start for part in boxes[ring])
        inner, middle, outer = (1.0 * r * r for r in MARK_RADII)
        ratio = area[ring] / area[dot] / ((outer - middle) / inner)
        fills = area[ring] / (0.25 * math.pi * tall * wide) / (1 - middle / outer)
        apart = float(np.linalg.norm(centre[ring] - centre[dot]))
        if apart < 0.08 * min(tall, wide) and 0.4 < ratio < 2.5 and 0.5 < fills < 1.7:
            marks.append(
                (area[ring], *_refined(grey, factor, 0.5 * (centre[ring] + centre[dot]), 0.5 * tall, wide / 2))
            )
    return np.array([mark[1:] for mark in sorted(marks, reverse=True)]).reshape(-1, 2)


def _refined(grey: Array, factor: int, centre: Array, tall: float, wide: float) -> tuple[float, float]:
    """Centre (column, row) of a mark in the whole image: the middle of its darkness."""
    row, column = (centre + 0.5) * factor - 0.5
    reach = 1.25 * factor * np.array([tall, wide])
    top, left = (max(0, math.floor(x)) for x in np.array([row, column]) - reach)
    part = grey[top : math.ceil(row + reach[0]) + 1, left : math.ceil(column + reach[1]) + 1]
    bright, dark = np.percentile(part, 90), np.percentile(part, 10)
    weight = np.clip((0.75 * bright + 0.25 * dark - part) / (bright - dark), 0.0, None)
    y, x = scipy.ndimage.center_of_mass(weight)
    return left + float(x), top + float(y)


def shrunk(grey: Array, factor: int) -> Array:
    """Image with the means of blocks of `factor` x `factor` pixels."""
    rows, columns = (size // factor for size in grey.shape)
    blocks = grey[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(1, 3)))
