"""Radius of a tube from a scan or photo, with its 95 % interval."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...display import Displayed
from ...errors import InputError, positive, vector
from ...files.field_metadata import POSITIVE, Range, unit
from ...files.units import TO_MM
from ...typing import Array
from .arc_fit import FittedArc, fit_arc
from .photo import SHEET_MARKS, PhotoScale, TubePhoto, scale_of
from .tube_trace import TubeTrace, trace_tube

MIN_ANGLE = math.radians(4.0)
"""Angle of a bend, rad, below which a radius says little."""

MARK_RANGE = 0.05, 1.0
"""Distances of marks on a sheet, m."""

HEIGHT_RANGE = 0.2
"""Relative error of the height of the tube's axis above the sheet, taken as half its width in the image."""

UNEVEN = 0.01
"""Half-width of the interval from deviations, relative to the radius, above which a remark reports it."""


@dataclass(frozen=True)
class RadiusErrors:
    """Contributions to the 95 % interval of a radius: half-widths as fractions of the radius."""

    fit: Annotated[float, unit("percent"), "half-width from deviations of the centreline from a circle"]
    scale: Annotated[float, unit("percent"), "half-width from print, paper and lens, or from the resolution"]
    camera: Annotated[float, unit("percent"), "half-width from the height of the tube above the sheet, as photographed"]
    blur: Annotated[float, unit("percent"), "half-width from blur, which moves the line towards the centre"]

    @property
    def total(self) -> float:
        """Half-width of the interval, as a fraction of the radius."""
        return math.hypot(self.fit, self.scale, self.camera, self.blur)


@dataclass(frozen=True, eq=False)
class MeasuredTube(Displayed):
    """Radius of a tube measured in a scan or photo."""

    photo: TubePhoto
    """Scan or photo."""
    scale: PhotoScale
    """Scale of the photo."""
    trace: TubeTrace
    """Centreline in the plane of the sheet."""
    arc: FittedArc
    """Circle through the bend, in the plane of the tube's axis."""
    height: float
    """Height of the tube's axis above the sheet, m."""
    errors: RadiusErrors
    """Contributions to the interval."""
    mold_radius: float | None = None
    """Radius of the mold in which the tube was set, m; None if not given."""

    @property
    def radius(self) -> float:
        """Radius of the bend, m."""
        return self.arc.radius

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval of the radius, m."""
        return self.radius * self.errors.total

    @property
    def standard_error(self) -> float:
        """Standard error of the radius, m: that of a normal distribution with this interval."""
        return self.half_width / 1.96

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the radius, m."""
        return self.radius - self.half_width, self.radius + self.half_width

    @property
    def angle(self) -> float:
        """Angle of the bend, rad."""
        return self.arc.length / self.radius

    @property
    def scale_source(self) -> str:
        """Source of the scale, as text."""
        if self.scale.size is None:
            return f"resolution of {0.0254 / self.scale.pitch:.4g} dpi"
        return " x ".join(f"{side * TO_MM:g}" for side in self.scale.size) + " mm between marks"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the measurement."""
        results = []
        if self.trace.others:
            results.append(f"{self.trace.others} straight line(s) in the image were left out")
        if self.errors.fit > UNEVEN:
            results.append(
                f"the bend determines the radius to {100 * self.errors.fit:.2g} % only: it is short, or no circle"
            )
        if self.scale.focal is not None and self.photo.focal_length is None:
            results.append("the file has no focal length (35 mm film); a usual one was taken")
        return tuple(results)


def measure_tube(
    photo: TubePhoto,
    *,
    dpi: Annotated[float | None, POSITIVE] = None,
    marks: Annotated[tuple[float, float], unit("mm")] = SHEET_MARKS,
    scale_error: Annotated[float, unit("percent"), Range(minimum=0.0, maximum=0.2)] = 0.005,
    mold_radius: Annotated[float | None, unit("mm"), POSITIVE] = None,
) -> MeasuredTube:
    """Measure the radius of the tube in a scan or photo.

    Args:
        dpi: resolution of a scan, dots per inch; default that of the file, if there are no marks.
        marks: measured distances of the marks along the sheet and across it, m.
        scale_error: error of the scale that 95 % of prints or scans keep, with the lens and the flatness of the sheet.
            0.5 % is a usual printer; measured marks have less.
        mold_radius: radius of the mold of this tube, to save the result as a trial, m.

    Raises:
        InputError: no scale, no tube, several tubes, a tube out of focus, or one with too little bend.
    """
    wide, tall = (positive("marks", float(side)) for side in vector("marks", marks, 2, "length and width"))
    if not all(MARK_RANGE[0] <= side <= MARK_RANGE[1] for side in (wide, tall)):
        raise InputError(
            f"marks are {TO_MM * wide:g} x {TO_MM * tall:g} mm; both must be {TO_MM * MARK_RANGE[0]:g} to "
            f"{TO_MM * MARK_RANGE[1]:g} mm"
        )
    scale = scale_of(photo, dpi, (wide, tall))
    trace = trace_tube(photo, scale)
    height = 0.5 * trace.width if scale.focal is not None else 0.0
    arc = fit_arc(scale.raised(trace.points, height))
    if arc.length < MIN_ANGLE * arc.radius:
        raise InputError(
            f"{photo.name}: the tube bends by {math.degrees(arc.length / arc.radius):.2g} deg; it must be at least "
            f"{math.degrees(MIN_ANGLE):g} deg for a radius"
        )
    sigma = trace.edge / 1.35
    errors = RadiusErrors(
        arc.half_width / arc.radius,
        scale_error,
        _camera_error(scale, trace.points, height, arc),
        sigma**2 / (2 * arc.radius**2),
    )
    return MeasuredTube(photo, scale, trace, arc, height, errors, mold_radius)


def _camera_error(scale: PhotoScale, points: Array, height: float, arc: FittedArc) -> float:
    """Error of the radius, relative, from the camera's distance and the height of the tube."""
    if scale.focal is None:
        return 0.0

    def size(raised: float, factor: float) -> float:
        used = scale.raised(points, raised, factor)[arc.used]
        return float(np.linalg.norm(used - used.mean(axis=0)))

    known = size(height, 1.0)
    from_focal = size(height, 1 + scale.focal_range) - size(height, 1 / (1 + scale.focal_range))
    from_height = HEIGHT_RANGE * (size(0.0, 1.0) - known)
    return math.hypot(0.5 * from_focal, from_height) / known
