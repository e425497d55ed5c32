"""Centreline of a tube in a scan or photo, to a fraction of a pixel.

1. The image is mapped to the plane of the sheet, so that a pixel has one size everywhere.
2. Lines thinner than 5 mm are separated from paper, gradients and wide objects by a closing of the grey values.
3. The longest curved line is the tube. Its pixels are ordered by their distance along the line from one end.
4. At every station the profile across the tube is read from the image. Its edges lie where the brightness is halfway
   between tube and paper; the middle of both edges is a point of the centreline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from ...errors import InputError
from ...typing import Array
from .photo import MARK_RADII, PhotoScale, TubePhoto, mapped, shrunk

MAX_WIDTH = 5e-3
"""Width of a line, m, above which it is no tube."""

SEARCH_PITCH = 0.12e-3
"""Size of the pixels, m, in which the tube is searched."""

MIN_LENGTH = 8e-3
"""Length of a line, m, below which it is no tube."""

NOISE_FACTOR = 6.0
"""Contrast of a line over the noise of the image."""

MIN_CONTRAST = 0.04
"""Smallest contrast of a line."""

STATION = 0.3e-3
"""Distance of the stations along the centreline, m."""

MAX_EDGE = 1.0e-3
"""Distance, m, between the points of an edge at a quarter and three quarters of the contrast, in focus."""


@dataclass(frozen=True, eq=False)
class TubeTrace:
    """Centreline of a tube in the plane of the sheet."""

    points: Array
    """(N, 2) points in order along the tube, m."""
    width: float
    """Median width of the tube in the image, m."""
    edge: float
    """Median width of its edges, from a quarter to three quarters of the contrast, m."""
    dark: bool
    """True if the tube is darker than the paper."""
    others: int = 0
    """Number of straight lines that were left out."""


@dataclass(frozen=True, eq=False)
class _Flat:
    """Image in the plane of the sheet."""

    grey: Array
    pitch: float
    """Size of a pixel, m."""
    origin: Array
    """(2,) point of the pixel (0, 0), m."""


def trace_tube(photo: TubePhoto, scale: PhotoScale) -> TubeTrace:
    """Trace the tube in a photo.

    Raises:
        InputError: no tube, several ones, only a straight one, or one out of focus.
    """
    flat = _flattened(photo, scale)
    lines = [(line, dark) for dark in (True, False) for line in _lines(flat, dark)]
    traces = [trace for line, dark in lines if (trace := _trace(flat, line, dark)) is not None]
    if not traces:
        where = "between the marks" if scale.size is not None else "in the image"
        raise InputError(
            f"{photo.name}: no tube was found {where}; there must be one line, {1e3 * MIN_LENGTH:g} mm long or more, "
            f"thinner than {1e3 * MAX_WIDTH:g} mm, with paper around it"
        )
    curved = [trace for trace in traces if _sagitta(trace.points) > max(0.35 * trace.width, 2 * flat.pitch)]
    if not curved:
        raise InputError(f"{photo.name}: the only line that was found is straight; it must be a curved tube")
    curved.sort(key=lambda trace: -_length(trace.points))
    if len(curved) > 1 and _length(curved[1].points) > 0.3 * _length(curved[0].points):
        raise InputError(
            f"{photo.name}: {len(curved)} curved lines were found, {1e3 * _length(curved[0].points):.0f} and "
            f"{1e3 * _length(curved[1].points):.0f} mm long; there must be one tube, with nothing across it"
        )
    tube = curved[0]
    if tube.edge > MAX_EDGE:
        raise InputError(
            f"{photo.name}: the tube is out of focus: its edges are {1e3 * tube.edge:.3g} mm wide; they must be at "
            f"most {1e3 * MAX_EDGE:g} mm"
        )
    return TubeTrace(tube.points, tube.width, tube.edge, tube.dark, len(traces) - len(curved))


def _flattened(photo: TubePhoto, scale: PhotoScale) -> _Flat:
    """Image in the plane of the sheet: of a scan as it is, of a photo what lies between the marks."""
    pitch = scale.pitch
    if scale.size is None:
        return _Flat(photo.grey, pitch, np.zeros(2))
    inset = 1.5 * MARK_RADII[-1]
    columns, rows = (np.arange(inset, side - inset, pitch) for side in scale.size)
    x, y = np.meshgrid(columns, rows)
    at = mapped(scale.to_pixels, np.column_stack([x.ravel(), y.ravel()]))
    grey = scipy.ndimage.map_coordinates(photo.grey, at[:, ::-1].T, order=1, mode="nearest").reshape(x.shape)
    return _Flat(grey, pitch, np.array([inset, inset]))


def _lines(flat: _Flat, dark: bool) -> list[Array]:
    """Rough centrelines (N, 2) of lines, in order along them, in pixels (row, column)."""
    factor = max(1, round(SEARCH_PITCH / flat.pitch))
    pitch = factor * flat.pitch
    grey = shrunk(flat.grey, factor) * (1 if dark else -1)
    window = max(3, round(MAX_WIDTH / pitch))
    contrast = scipy.ndimage.grey_closing(scipy.ndimage.gaussian_filter(grey, 0.7), size=(window, window)) - grey
    noise = 1.48 * float(np.median(np.abs(contrast - np.median(contrast))))
    mask = contrast > np.median(contrast) + max(MIN_CONTRAST, NOISE_FACTOR * noise)
    # A highlight along the tube divides it.
    mask = scipy.ndimage.binary_closing(mask, iterations=max(1, round(0.25e-3 / pitch)))
    labels, _ = scipy.ndimage.label(mask, np.ones((3, 3)))
    lines = []
    for k, box in enumerate(scipy.ndimage.find_objects(labels), start=1):
        extent = max(part.stop - part.start for part in box) * pitch
        if extent < 0.6 * MIN_LENGTH:
            continue
        cells = np.argwhere(labels[box] == k) + np.array([box[0].start, box[1].start])
        order = _along(cells)
        length = float(order.max())
        if length * pitch < MIN_LENGTH or len(cells) > length * (MAX_WIDTH / pitch) or len(cells) > 0.15 * length**2:
            continue
        bins = (order / max(3.0, 0.5 * len(cells) / length)).astype(int)
        count = np.maximum(np.bincount(bins), 1)
        middle = np.column_stack([np.bincount(bins, cells[:, axis]) / count for axis in (0, 1)])[np.bincount(bins) > 0]
        lines.append((middle + 0.5) * factor - 0.5)
    return lines


def _along(cells: Array) -> Array:
    """(N,) distances of the pixels (N, 2) of a line from one of its ends, along the line, in pixels."""
    index = {(int(row), int(column)): k for k, (row, column) in enumerate(cells)}
    near = [(0, 1, 1.0), (1, 0, 1.0), (1, 1, 2**0.5), (1, -1, 2**0.5)]
    links = [
        (k, other, step)
        for (row, column), k in index.items()
        for down, right, step in near
        if (other := index.get((row + down, column + right))) is not None
    ]
    start, end, weight = (np.array(part) for part in zip(*links, strict=True))
    graph = scipy.sparse.coo_array((weight, (start, end)), shape=(len(cells), len(cells))).tocsr()
    # The pixel that is farthest from any pixel is an end.
    far = int(np.argmax(scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=0)))
    return np.asarray(scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=far))


def _trace(flat: _Flat, line: Array, dark: bool) -> TubeTrace | None:
    """Centreline from a rough one by the edges of the profile; None if what it follows is no tube."""
    points = line
    for _ in range(3):
        points = _resampled(_smooth(points, 2e-3 / flat.pitch), STATION / flat.pitch)
        if len(points) < 12:
            return None
        profile = _profiles(flat, points, dark)
        if profile is None:
            return None
        points, width, edge = profile
    # Against the blur of the image a tube is wider than a pixel.
    if len(points) < 12 or width < 1.5:
        return None
    metres = flat.origin + points[:, ::-1] * flat.pitch
    return TubeTrace(metres, width * flat.pitch, edge * flat.pitch, dark)


class _Centreline(NamedTuple):
    """Tube in an image, in pixels."""

    points: Array
    """(N, 2) points on its centreline."""
    width: float
    """Median width."""
    edge: float
    """Median width of its edges."""


def _profiles(flat: _Flat, points: Array, dark: bool) -> _Centreline | None:
    """Centreline from profiles across a curve (N, 2) near it; None without a tube of even width."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    reach, step = 0.8 * MAX_WIDTH / flat.pitch, 0.25
    across = np.arange(-reach, reach + step, step)
    at = points[:, None] + across[:, None] * normal[:, None]
    grey = scipy.ndimage.map_coordinates(flat.grey, at.reshape(-1, 2).T, order=1, mode="nearest").reshape(at.shape[:2])
    # Noise is averaged along the tube, over less than its curve can turn.
    depth = scipy.ndimage.gaussian_filter1d(grey, 1.0, axis=0) * (-1 if dark else 1)
    near = np.abs(across) < 0.5 * reach
    peak = np.where(near, depth, -np.inf).argmax(axis=1)
    results = np.full((len(points), 4), np.nan)
    for k, (row, top) in enumerate(zip(depth, peak, strict=True)):
        results[k] = _edges(across, row, int(top))
    middle, width, edge, contrast = results.T
    known = np.isfinite(middle)
    if known.sum() < 0.5 * len(points):
        return None
    # Where something touches or crosses the tube, its width and contrast are others.
    usual, strong = np.median(width[known]), np.median(contrast[known])
    good = known & (np.abs(width - usual) < 0.25 * usual) & (contrast > 0.5 * strong)
    if good.sum() < 0.5 * len(points):
        return None
    centred = points[good] + middle[good, None] * normal[good]
    return _Centreline(centred, float(np.median(width[good])), float(np.median(edge[good])))


class _Profile(NamedTuple):
    """Tube in one profile across it, in pixels, and its contrast."""

    middle: float
    width: float
    edge: float
    """Width of the sharper edge."""
    contrast: float


def _edges(across: Array, depth: Array, top: int) -> _Profile:
    """Tube in a profile; NaN without a tube."""
    nothing = _Profile(np.nan, np.nan, np.nan, np.nan)
    paper = float(np.percentile(depth, 20))
    contrast = float(depth[top]) - paper
    crossings = []
    for side in (slice(top, None), slice(top, None, -1)):
        x, y = across[side], (depth[side] - paper) / contrast if contrast > 0 else depth[side]
        below = np.flatnonzero(y < 0.25)
        if contrast <= 0 or not len(below):
            return nothing
        # The last crossing before paper: a highlight lies within the tube.
        part = [np.flatnonzero(y[: below[0] + 1] >= level) for level in (0.25, 0.5, 0.75)]
        ends = []
        for level, above in zip((0.25, 0.5, 0.75), part, strict=True):
            i = int(above[-1])
            ends.append(x[i] + (x[i + 1] - x[i]) * (y[i] - level) / (y[i] - y[i + 1]))
        crossings.append(ends)
    right, left = crossings
    # The shadow that a tube casts widens one edge; blur widens both.
    edge = min(right[0] - right[2], left[2] - left[0])
    return _Profile(0.5 * (right[1] + left[1]), right[1] - left[1], edge, contrast)


def _smooth(points: Array, length: float) -> Array:
    """Points along a curve, smoothed over a length; the ends keep their place."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    sigma = min(length / max(float(np.median(steps)), 1e-9), len(points) / 8)
    # Mirrored at its ends, a curve keeps them and its direction there.
    pad = min(len(points) - 1, int(4 * sigma) + 1)
    before, after = 2 * points[0] - points[pad:0:-1], 2 * points[-1] - points[-2 : -pad - 2 : -1]
    return np.asarray(scipy.ndimage.gaussian_filter1d(np.vstack([before, points, after]), sigma, axis=0)[pad:-pad])


def _resampled(points: Array, step: float) -> Array:
    """Points at even distances along a curve."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    even = np.linspace(0.0, along[-1], max(2, round(along[-1] / step) + 1))
    return np.column_stack([np.interp(even, along, points[:, axis]) for axis in (0, 1)])


def _length(points: Array) -> float:
    """Length of a polyline."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _sagitta(points: Array) -> float:
    """Largest distance of a curve from its chord."""
    chord = points[-1] - points[0]
    from_start = points - points[0]
    return float(np.abs(from_start[:, 0] * chord[1] - from_start[:, 1] * chord[0]).max() / np.linalg.norm(chord))
