"""Scans and photos of tubes, made by casting a ray for every pixel, and how well `measure_tube` measures them.

    python -m benchmarks.tube_photos --count 30 --first 0 [--compared]

measures that many of a series of random pictures and prints each radius with its interval. With `--compared` the marks
of the print were measured, and the scanner compared with a ruler, both to 0.1 % (one standard deviation). The renderer
shares no code with the measurement. `--out DIR` saves the picture of an example.
"""

from __future__ import annotations

import argparse
import io
import math
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage
from scipy.spatial import cKDTree

from tubeopt import InputError
from tubeopt.shaping import load_photo, measure_tube
from tubeopt.show.plots.tube_photo import plot_measured_tube
from tubeopt.typing import Array

MARKS = 240.0, 170.0
RADII = 2.0, 4.0, 6.0
FILM = 43.27
"""Diagonal of 35 mm film, mm."""


@dataclass
class Scene:
    """A tube on paper; lengths in mm, angles in rad."""

    radius: float = 60.0
    angle: float = 1.0
    diameter: float = 1.5
    leads: tuple[float, float] = (0.0, 0.0)
    fades: tuple[float, float] = (0.0, 0.0)
    place: tuple[float, float] = (120.0, 85.0)
    """Middle of the tube's box."""
    turned: float = 0.0
    tube: float = 0.25
    """Brightness of the tube, of its highlight, and of the paper."""
    highlight: float = 0.0
    paper: float = 0.9
    print_scale: float = 1.0
    """Size of the print, or of the scanner's pixels, over what it should be."""
    dpi: float | None = None
    """Resolution of a scan; None for a photo."""
    distance: float = 330.0
    tilt: float = 0.0
    tilt_towards: float = 0.0
    rolled: float = 0.0
    film_focal: float = 26.0
    pixels: tuple[int, int] = (1500, 2000)
    distortion: float = 0.0
    """Radial distortion at the corner of the picture."""
    noted_focal: bool = True
    blur: float = 0.8
    """Standard deviation, pixels."""
    noise: float = 0.01
    gradient: tuple[float, float] = (0.0, 0.0)
    shadow: float = 0.0
    """Depth of a soft shadow over a part of the sheet."""
    cast: float = 0.0
    """Depth of the shadow that the tube casts beside itself."""
    ruler: bool = False
    waviness: float = 0.0
    """Deviation of the tube from its ideal shape."""
    marks: tuple[int, ...] = (0, 1, 2, 3)
    seed: int = 0
    more: list[Scene] = field(default_factory=list)
    """Further tubes."""

    def centreline(self) -> Array:
        """(N, 2) points, mm: leads, ramps of the curvature, and the bend between them."""
        return self._shape()[0]

    @property
    def drawn_radius(self) -> float:
        """Radius of the bend as it is drawn, with its waves, mm: of the circle through its points."""
        points, bend = self._shape()
        x, y = (points[bend] - points[bend].mean(axis=0)).T
        a, b, c = np.linalg.lstsq(np.column_stack([x, y, np.ones(len(x))]), x * x + y * y, rcond=None)[0]
        return math.sqrt(c + (a * a + b * b) / 4)

    def _shape(self) -> tuple[Array, Array]:
        """(N, 2) points, mm, and the mask of those on the bend."""
        ramp, bend = self.fades, self.radius * self.angle
        ends = np.cumsum([0, self.leads[0], ramp[0], bend, ramp[1], self.leads[1]])
        s = np.linspace(0, ends[-1], max(400, int(40 * ends[-1])))
        # Corners of the curvature, apart from each other where a part has no length.
        kappa = np.interp(s, ends + 1e-9 * np.arange(6), [0, 0, 1, 1, 0, 0]) / self.radius
        theta = np.cumsum(kappa) * s[1]
        curve = np.column_stack([np.cumsum(np.cos(theta)), np.cumsum(np.sin(theta))]) * s[1]
        random = np.random.default_rng(self.seed + 7)
        waves = sum(
            random.normal() * np.sin(2 * math.pi * k * s / ends[-1] + random.uniform(0, 6.3)) / k for k in range(1, 6)
        )
        curve += self.waviness * np.asarray(waves)[:, None] * np.column_stack([-np.sin(theta), np.cos(theta)])
        c, d = math.cos(self.turned), math.sin(self.turned)
        curve = curve @ np.array([[c, d], [-d, c]])
        middle = 0.5 * (curve.min(axis=0) + curve.max(axis=0))
        return curve - middle + self.place, (s >= ends[2]) & (s <= ends[3])


def render(scene: Scene, size: tuple[float, float] = (90.0, 110.0)) -> Array:
    """Picture (rows, columns), 0 to 1; `size`: height and width of a scan, mm."""
    if scene.dpi is not None:
        rows, columns = (round(side / 25.4 * scene.dpi) for side in size)
    else:
        rows, columns = scene.pixels
    v, u = np.mgrid[0:rows, 0:columns].astype(float)
    if scene.dpi is not None:
        pitch = 25.4 / scene.dpi * scene.print_scale
        paper = axis = np.column_stack([u.ravel(), v.ravel()]) * pitch
    else:
        paper, axis = _seen(scene, u.ravel(), v.ravel(), rows, columns)
        pitch = float(np.median(np.linalg.norm(np.diff(paper[:columns], axis=0), axis=1)))
    shade = np.full(len(paper), scene.paper)
    if scene.dpi is None:
        _draw_marks(scene, paper, shade, pitch)
    if scene.ruler:
        _draw_ruler(scene, paper, shade, pitch)
    for tube in (scene, *scene.more):
        curve, half = tube.centreline(), tube.diameter / 2
        if scene.cast:
            # Soft, beside the tube, away from the light.
            near, beside = _distances(paper, curve + 0.6 * tube.diameter)
            shade[near] *= 1 - scene.cast * np.exp(-0.5 * (beside / (1.2 * half)) ** 2)
        near, across = _distances(axis, curve)
        metal = tube.tube + tube.highlight * np.exp(-((across / (0.25 * half)) ** 2))
        part = _covered(across - half, pitch)
        shade[near] = part * metal + (1 - part) * shade[near]
    middle = np.array(MARKS) / 2
    light = 1 + (paper - middle) @ np.array(scene.gradient) / 100
    random = np.random.default_rng(scene.seed)
    if scene.shadow:
        direction = random.uniform(0, 2 * math.pi)
        along = (paper - scene.place) @ [math.cos(direction), math.sin(direction)] - random.uniform(-20, 20)
        light *= 1 - scene.shadow / (1 + np.exp(-along / 6.0))
    picture = ndimage.gaussian_filter((shade * light).reshape(rows, columns), scene.blur)
    return np.clip(picture + random.normal(0, scene.noise, picture.shape), 0, 1)


def _distances(points: Array, curve: Array) -> tuple[Array, Array]:
    """Indices of the points (N, 2) that are near a curve, and their distances from it."""
    box = (points > curve.min(axis=0) - 6) & (points < curve.max(axis=0) + 6)
    near = np.flatnonzero(box.all(axis=1))
    distance = cKDTree(curve).query(points[near], distance_upper_bound=6)[0]
    known = np.isfinite(distance)
    return near[known], distance[known]


def _covered(distance: Array, pitch: float) -> Array:
    """Part of a pixel that an edge covers, at a distance of its middle from the edge, negative inside."""
    return np.clip(0.5 - distance / pitch, 0, 1)


def _seen(scene: Scene, u: Array, v: Array, rows: int, columns: int) -> tuple[Array, Array]:
    """(N, 2) points of the paper and of the plane of the tube's axis, mm, that the camera sees in pixels."""
    focal = scene.film_focal / FILM * math.hypot(rows, columns)
    x, y = (u - (columns - 1) / 2) / focal, (v - (rows - 1) / 2) / focal
    corner = (0.5 * FILM / scene.film_focal) ** 2
    bent = 1 + scene.distortion * (x * x + y * y) / corner
    rays = np.column_stack([x * bent, y * bent, np.ones(len(x))])
    c, s = math.cos(scene.rolled), math.sin(scene.rolled)
    roll = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    # The camera looks at the middle of the sheet from a point that is tilted about an axis in the sheet.
    k = np.array([math.cos(scene.tilt_towards), math.sin(scene.tilt_towards), 0.0])
    hat = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    tilt = np.eye(3) + math.sin(scene.tilt) * hat + (1 - math.cos(scene.tilt)) * hat @ hat
    turn = tilt @ roll
    rays = rays @ turn.T
    middle = np.array([MARKS[0] / 2, MARKS[1] / 2, 0.0])
    eye = middle - scene.distance * turn @ [0, 0, 1]
    # z points away from the camera, into the table.
    planes = []
    for z in (0.0, -scene.diameter / 2):
        t = (z - eye[2]) / rays[:, 2]
        planes.append((eye + t[:, None] * rays)[:, :2])
    return planes[0], planes[1]


def _draw_marks(scene: Scene, paper: Array, shade: Array, pitch: float) -> None:
    middle = np.array(MARKS) / 2
    corners = np.array([(0, 0), (MARKS[0], 0), MARKS, (0, MARKS[1])])
    for corner in corners[list(scene.marks)]:
        r = np.linalg.norm(paper - (middle + scene.print_scale * (corner - middle)), axis=1) / scene.print_scale
        part = _covered(r - RADII[0], pitch) + _covered(np.abs(r - 5.0) - 1.0, pitch)
        shade *= 1 - part * (1 - 0.08 / scene.paper)


def _draw_ruler(scene: Scene, paper: Array, shade: Array, pitch: float) -> None:
    """A wooden ruler with lines every millimetre, across a corner of the sheet."""
    c, s = math.cos(0.3), math.sin(0.3)
    x, y = (paper - [20.0, 128.0]) @ [c, s], (paper - [20.0, 128.0]) @ [-s, c]
    body = (x > 0) & (x < 120) & (y > 0) & (y < 28)
    shade[body] = 0.7
    long = np.where(np.round(x) % 10 == 0, 7.0, 3.5)
    lines = body & (y < long)
    shade[lines] -= 0.55 * _covered(np.abs(x[lines] - np.round(x[lines])) - 0.12, pitch)
    shade[body & (y < 0.25)] = 0.35


def save(scene: Scene, path: Path, *, noted_dpi: bool = True) -> Path:
    """Save a picture with what a scanner or phone notes in it."""
    picture = (render(scene) * 255).round().astype(np.uint8)
    # Slightly coloured, as pictures are.
    colours = np.stack([picture, (picture * 0.985).astype(np.uint8), (picture * 0.95).astype(np.uint8)], axis=-1)
    image = Image.fromarray(colours)
    if scene.dpi is not None:
        image.save(path, dpi=(scene.dpi, scene.dpi)) if noted_dpi else image.save(path)
        return path
    notes = image.getexif()
    extra = notes.get_ifd(0x8769)
    extra[0x829A] = 0.01
    if scene.noted_focal:
        extra[0xA405] = round(scene.film_focal)
    content = io.BytesIO()
    image.save(content, format="JPEG" if path.suffix == ".jpg" else "PNG", exif=notes, quality=90)
    path.write_bytes(content.getvalue())
    return path


def random_scene(k: int) -> Scene:
    """The k-th of a series of scenes: even ones are photos, odd ones scans."""
    random = np.random.default_rng([50, k])
    radius = math.exp(random.uniform(math.log(15), math.log(120)))
    # As long as fits the sheet and is worth to be measured.
    angle = min(random.uniform(0.6, 2.6), random.uniform(50, 110) / radius + 0.25)
    photo = k % 2 == 0
    lead = random.uniform(0, 20, 2) * (random.random(2) < 0.7)
    dark = random.random() < 0.7
    scene = Scene(
        radius=radius,
        angle=angle,
        diameter=random.uniform(0.6, 2.5),
        leads=(lead[0], lead[1]),
        fades=tuple(random.uniform(0, 6, 2) * (lead > 0)),
        turned=random.uniform(0, 2 * math.pi),
        tube=random.uniform(0.1, 0.45) if dark else 0.92,
        highlight=random.uniform(0, 0.4) if dark else 0.0,
        paper=random.uniform(0.75, 0.95) if dark else random.uniform(0.25, 0.5),
        print_scale=1 + random.normal(0, 0.0022),
        noise=random.uniform(0.003, 0.02),
        gradient=tuple(random.normal(0, 0.08, 2)),
        shadow=random.uniform(0, 0.35),
        cast=random.uniform(0, 0.25) if photo else random.uniform(0, 0.1),
        waviness=random.uniform(0, 0.02),
        seed=k,
    )
    if photo:
        scene.ruler = bool(random.random() < 0.5) and dark
        scene.place = (120 + random.uniform(-15, 15), (62 if scene.ruler else 85) + random.uniform(-5, 5))
        scene.tilt, scene.tilt_towards = math.radians(random.uniform(0, 15)), random.uniform(0, 2 * math.pi)
        scene.rolled = random.uniform(-0.15, 0.15)
        scene.film_focal = random.uniform(24, 52)
        scene.noted_focal = bool(random.random() < 0.6)
        scene.distance = 330 / 26 * scene.film_focal * random.uniform(1.0, 1.15)
        scene.distortion = random.normal(0, 0.002)
        scene.blur = random.uniform(0.5, 1.5)
    else:
        scene.dpi = float(random.choice([200, 300, 400]))
        scene.place = (55.0, 45.0)
        scene.blur = random.uniform(0.4, 2.0) * scene.dpi / 300
    return scene


EXAMPLE = Scene(
    radius=60, angle=1.3, leads=(20, 15), fades=(4, 4), place=(125, 70), turned=0.3, tilt=0.2, tilt_towards=0.8,
    distance=360, ruler=True, shadow=0.25, noise=0.002, seed=3,
)  # fmt: skip
"""Photo in the picture of the docs."""


def known_scale(scene: Scene) -> dict[str, Any]:
    """Arguments of `measure_tube` for a scale that was compared, with an error of 0.1 %."""
    factor = scene.print_scale * (1 + np.random.default_rng([51, scene.seed]).normal(0, 1e-3))
    if scene.dpi is not None:
        return {"dpi": scene.dpi / factor, "scale_error": 0.002}
    return {"marks": (1e-3 * factor * MARKS[0], 1e-3 * factor * MARKS[1]), "scale_error": 0.002}


def main(first: int, count: int, compared: bool, out: Path | None) -> None:
    """Measure pictures of the series, print every radius with its interval, and save the picture of the example."""
    hits, widths = 0, []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(first, first + count):
            scene = random_scene(k)
            path = save(scene, Path(folder) / f"tube_{k}.{'jpg' if scene.dpi is None else 'png'}")
            try:
                measured = measure_tube(load_photo(path), **(known_scale(scene) if compared else {}))
            except InputError as error:
                print(f"{k:3d}  refused: {error}")
                continue
            low, high = (1e3 * end for end in measured.interval)
            hit = low < scene.drawn_radius < high
            hits += hit
            widths.append(measured.half_width / measured.radius)
            print(
                f"{k:3d}  {'photo' if scene.dpi is None else 'scan '}  {scene.diameter:.1f} mm  "
                f"{scene.drawn_radius:7.2f} mm: {1e3 * measured.radius:7.2f} ({low:.2f} to {high:.2f})"
                f"{'' if hit else '  missed'}",
                flush=True,
            )
        if out is not None:
            measured = measure_tube(load_photo(save(EXAMPLE, Path(folder) / "photo.jpg")))
            plot_measured_tube(measured, out / "mold_measured_tube.png")
    if widths:
        print(
            f"{hits} of {count} in their intervals of 95 %, {count - len(widths)} refused; half-width "
            f"{np.median(widths):.2%} of the radius (median)"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=30, help="number of pictures")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--compared", action="store_true", help="the scale was measured")
    parser.add_argument("--out", type=Path, default=None, help="directory for a picture")
    arguments = parser.parse_args()
    main(arguments.first, arguments.count, arguments.compared, arguments.out)
