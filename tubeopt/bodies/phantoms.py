"""Synthetic anatomy for examples, tests and benchmarks: a bronchial tree, a ventricle, a kidney.

Each is a union of balls whose centres and radii vary linearly along segments. The base plate is at the origin, with z
into the patient; the lumen continues behind the plate. Sizes are rounded values of adults from anatomy books; no scan
was used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ..errors import positive
from ..typing import Array
from .frames import Frame
from .images import LabelImage
from .obstacles import RoundCone, as_points, nearest_distance

# Labels of the images.
LUMEN, TARGET = 1, 2

# Length (m) by which images are larger than the lumen.
BORDER = 2e-3

Stretch = tuple[tuple[float, float, float], tuple[float, float, float], float, float]
"""Start, end, start radius, end radius; mm."""


@dataclass(frozen=True)
class Phantom:
    """Lumen of a synthetic patient, in mm."""

    name: str
    stretches: tuple[Stretch, ...]
    target: int
    """Number of stretches at the end that are the target."""
    landmarks: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    def depth(self, points: ArrayLike, stretches: tuple[Stretch, ...] | None = None) -> Array:
        """Largest depth (...) of points (..., 3) in a ball of the union, m; outside, minus the distance from it."""
        array = as_points(points) * 1e3
        cones = [RoundCone(*stretch) for stretch in (self.stretches if stretches is None else stretches)]
        return -nearest_distance(cones, array) * 1e-3

    def image(self, voxel: float = 5e-4, frame: Frame | None = None) -> LabelImage:
        """Label image with LUMEN and TARGET.

        Args:
            voxel: size of the voxels, m.
            frame: axes of the image; by default those of the base plate.
        """
        positive("voxel", voxel)
        frame = frame or Frame()
        ends = frame.seen(np.array([stretch[:2] for stretch in self.stretches]) * 1e-3)
        radius = np.array([max(stretch[2:]) for stretch in self.stretches]) * 1e-3
        border = radius.max() + BORDER
        low = ends.min((0, 1)) - border
        count = np.ceil((ends.max((0, 1)) + border - low) / voxel).astype(int)
        labels = np.zeros(count, dtype=np.uint8)
        for k, stretch in enumerate(self.stretches):
            first = ((ends[k].min(0) - radius[k] - low) / voxel).astype(int)
            last = np.ceil((ends[k].max(0) + radius[k] - low) / voxel).astype(int) + 1
            box = tuple(slice(*pair) for pair in zip(first, np.minimum(last, count), strict=True))
            label = TARGET if k >= len(self.stretches) - self.target else LUMEN
            b, c = np.meshgrid(*(np.arange(side.start, side.stop) for side in box[1:]), indexing="ij")
            for a in range(box[0].start, box[0].stop):  # slab by slab, to bound the memory
                points = frame.placed(low + voxel * np.stack([np.full_like(b, a), b, c], axis=-1))
                labels[a][box[1:]][self.depth(points, (stretch,)) > 0] = label
        return LabelImage(labels, np.full(3, voxel), Frame(frame.axes, frame.placed(low)), self.name)


def bronchial_tree() -> Phantom:
    """Trachea, main bronchi and four lobar bronchi; the target is the end of one on the right.

    Diameters fall by 2^(-1/3) and more from generation to generation (Weibel 1963).
    """
    carina, left, right = (0.0, 0.0, 42.0), (-22.0, 0.0, 72.0), (17.0, 0.0, 68.0)
    return Phantom(
        "bronchial tree",
        (
            ((0.0, 0.0, -14.0), carina, 8.5, 8.0),
            (carina, left, 6.5, 5.5),
            (carina, right, 7.0, 6.0),
            (left, (-42.0, 8.0, 90.0), 4.8, 3.8),
            (left, (-26.0, -6.0, 100.0), 4.8, 4.0),
            (right, (40.0, -6.0, 82.0), 5.0, 4.0),
            (right, (22.0, 6.0, 98.0), 5.2, 4.5),
            ((22.0, 6.0, 98.0), (23.0, 7.5, 106.0), 4.5, 4.0),
        ),
        1,
        {"carina": carina, "right main bronchus": right, "left main bronchus": left},
    )


def ventricle() -> Phantom:
    """Straight tract to a lateral ventricle, from its frontal horn to its atrium and towards the foramen."""
    horn, body, atrium = (0.0, 0.0, 55.0), (0.0, -14.0, 72.0), (4.0, -34.0, 80.0)
    return Phantom(
        "ventricle",
        (
            ((0.0, 0.0, -10.0), horn, 4.0, 4.0),
            (horn, body, 8.0, 9.0),
            (body, atrium, 9.0, 8.0),
            (horn, (6.0, 2.0, 76.0), 7.0, 3.5),
            (body, (4.0, -24.0, 78.0), 9.0, 7.0),
        ),
        1,
        {"horn": horn, "atrium": atrium, "foramen": (6.0, 2.0, 76.0)},
    )


def kidney() -> Phantom:
    """Straight access to the renal pelvis, and three calyces with neck and cup; the target is the upper cup."""
    pelvis, upper, middle, lower = (0.0, 0.0, 50.0), (18.0, 0.0, 76.0), (2.0, 6.0, 80.0), (-18.0, -4.0, 74.0)
    return Phantom(
        "kidney",
        (
            ((0.0, 0.0, -10.0), (0.0, 0.0, 40.0), 4.0, 4.5),
            ((0.0, 0.0, 40.0), pelvis, 4.5, 10.0),
            (pelvis, middle, 5.0, 3.5),
            (middle, (2.0, 7.0, 84.0), 5.5, 6.0),
            (pelvis, lower, 5.0, 3.5),
            (lower, (-20.0, -4.5, 78.0), 5.5, 6.0),
            (pelvis, upper, 5.0, 3.8),
            (upper, (20.0, 0.0, 79.0), 5.5, 6.0),
        ),
        1,
        {"pelvis": pelvis, "upper calyx": upper, "middle calyx": middle, "lower calyx": lower},
    )


# All of them, by name.
PHANTOMS = {"bronchial tree": bronchial_tree, "ventricle": ventricle, "kidney": kidney}
