"""Files of a mandrel: the solid (STL, mm); of a turned one the table of rotation and feed (CSV) and its G-code.

Feed is along the axis from the chuck's end, rotation about it. The tool is a ball-nose end mill that points at it.
"""

from __future__ import annotations

import io
import math
import re
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from ...errors import SolveError
from ...files.csv_file import to_csv
from ...files.files import left_out_where_missing, write_text
from ...files.units import TO_MM
from ...typing import Array
from .files import manifold, trimesh, write_solid
from .gcode import check_duration
from .mandrel import Cylinder, Mandrel

TOLERANCE = 1e-5
"""Greatest distance (m) of the groove in a file from the curve."""

COLUMNS = ("arc_length_mm", "feed_mm", "rotation_deg", "tip_radius_mm")
SIDES = 720
"""Corners of a turned mandrel."""

FINE = 1e-4
"""Distance (m) of places along the leads, where feed and rotation are not proportional."""


def write_mandrel(mandrel: Mandrel, directory: str | PathLike[str]) -> list[Path]:
    """Write mandrel.stl, and of a turned one mandrel.csv and mandrel.nc; return the paths.

    The solid is left out with a warning where manifold3d or trimesh is not installed.

    Raises:
        InputError: a file cannot be written.
        SolveError: what was written lies more than 10 um from the curve when it is read back.
    """
    out = Path(directory)
    paths = []
    with left_out_where_missing():
        paths.append(write_solid(_solid(mandrel), out / "mandrel.stl", "mandrel", partial(solid_off_curve, mandrel)))
    if isinstance(mandrel.body, Cylinder):
        rows = rotation_table(mandrel) * np.array([TO_MM, TO_MM, 180 / math.pi, TO_MM])
        table, text = to_csv(COLUMNS, [[f"{x:.5f}" for x in row] for row in rows]), mandrel_gcode(mandrel)
        read = np.loadtxt(io.StringIO(table), delimiter=",", skiprows=1)[:, 1:]
        for path, content, rows in ((out / "mandrel.csv", table, read), (out / "mandrel.nc", text, read_rotary(text))):
            if words := _table_off_curve(mandrel, rows):
                raise SolveError(f"{path}: {words}")
            write_text(path, content)
            paths.append(path)
    return paths


def rotation_table(mandrel: Mandrel) -> Array:
    """(N, 4) of a turned one: arc length along the bend, feed (m), rotation (rad), radius of the tool's tip (m)."""
    fine = mandrel.winding.lengthened(0.0, FINE)
    feed, y, z = fine.points.T
    angle = np.unwrap(np.arctan2(z, y))
    return np.column_stack([fine.arc_length, feed, angle - angle[fine.bend.start], np.hypot(y, z) - mandrel.width / 2])


def mandrel_gcode(mandrel: Mandrel) -> str:
    """The groove for a 4th axis: X along it, A about it (deg), Z the tip's distance from it; inverse time feed."""
    table, milling = rotation_table(mandrel), mandrel.spec.milling
    assert isinstance(mandrel.body, Cylinder)
    outer = mandrel.body.radius
    passes = math.ceil(mandrel.width / milling.step_down - 1e-9)
    check_duration("mandrel.nc", passes * float(table[-1, 0] - table[0, 0]) / milling.feed)
    safe = f"G0 Z{(outer + mandrel.width + milling.safe_height) * TO_MM:.4f}"
    lines = [
        f"(mandrel of tube {mandrel.number}: cylinder {2 * outer * TO_MM:.4f} mm, ball-nose end mill "
        f"{mandrel.width * TO_MM:g} mm)",
        "(X from the chuck's end, Z from the axis, A of the tool about the work)",
        "G21 G90 G94",
        safe,
        f"M3 S{milling.spindle * 60:.0f}",
    ]
    for k in range(1, passes + 1):
        tip = np.maximum(table[:, 3], outer - mandrel.width * k / passes)
        x, a = table[0, 1] * TO_MM, math.degrees(table[0, 2])
        lines += [
            safe,
            f"G0 X{x:.4f} A{a:.5f}",
            f"G1 Z{tip[0] * TO_MM:.4f} F{milling.plunge_feed * TO_MM * 60:.1f}",
            "G93",
        ]
        for before, here, z in zip(table[:-1], table[1:], tip[1:], strict=True):
            rate = 60 * milling.feed / (here[0] - before[0])
            lines.append(f"G1 X{here[1] * TO_MM:.4f} A{math.degrees(here[2]):.5f} Z{z * TO_MM:.4f} F{rate:.2f}")
        lines.append("G94")
    return "\n".join([*lines, safe, "M5", "M30", ""])


def read_rotary(text: str) -> Array:
    """(N, 3) feed (mm), rotation (deg), radius of the tip (mm) of the last, deepest pass of a program."""
    last = text.rsplit("G93", 1)[-1]
    rows = re.findall(r"^G1 X([-\d.]+) A([-\d.]+) Z([-\d.]+)", last, re.MULTILINE)
    return np.array([[float(x) for x in row] for row in rows])


def off_curve(mandrel: Mandrel, places: Array, away: float = 0.0) -> str:
    """What is wrong with a groove, in words, where places of it (N, 3), m, of which some is to lie `away` (m) from each
    of the bend, are off by more than 10 um."""
    near = scipy.spatial.KDTree(places).query(mandrel.winding.points[mandrel.winding.bend])[0]
    off = float(np.abs(near - away).max())
    return f"the groove lies {off * 1e6:.3g} um from the curve" if off > TOLERANCE else ""


def solid_off_curve(mandrel: Mandrel, mesh: Any) -> str:
    """`off_curve` of a solid, a mesh in mm: the groove's bottom lies half a width from the bend everywhere."""
    return off_curve(mandrel, np.asarray(mesh.vertices) / TO_MM, mandrel.width / 2)


def _table_off_curve(mandrel: Mandrel, rows: Array) -> str:
    """`off_curve` of a table of feed (mm), rotation (deg) and radius of the tip (mm)."""
    feed, angle, tip = rows[:, 0] / TO_MM, np.radians(rows[:, 1]), rows[:, 2] / TO_MM + mandrel.width / 2
    return off_curve(mandrel, np.column_stack([feed, tip * np.cos(angle), tip * np.sin(angle)]))


def _solid(mandrel: Mandrel) -> Any:
    library, w, body = manifold().Manifold, mandrel.winding, mandrel.body
    sagitta = mandrel.spec.solver.sagitta
    if isinstance(body, Cylinder):
        solid = library.cylinder(body.length * TO_MM, body.radius * TO_MM, -1.0, SIDES).rotate((0.0, 90.0, 0.0))
        radial = w.points * np.array([0.0, 1.0, 1.0])
        away = np.linalg.norm(radial, axis=1)
        heights = np.maximum(body.radius + mandrel.width - away, mandrel.width)
        return solid - channel(w.points, w.tangents, radial / away[:, None], heights, mandrel.width / 2, sagitta)
    solid = library.cube(tuple(x * TO_MM for x in body.size))
    beyond = w.lengthened(10 * mandrel.width)
    ups = np.tile([0.0, 0.0, 1.0], (len(beyond.points), 1))
    heights = np.maximum(body.size[2] - beyond.points[:, 2], 0.0) + mandrel.width
    return solid - channel(beyond.points, beyond.tangents, ups, heights, mandrel.width / 2, sagitta)


def channel(points: Array, tangents: Array, ups: Array, heights: Array, radius: float, sagitta: float) -> Any:
    """The manifold3d solid swept along `points` (N, 3), m: half a circle below, walls that rise along `ups`.

    Args:
        tangents, ups: (N, 3) unit; ups may lean along the curve.
        heights: (N,) of the walls above the points, m.
        radius: of the circle, m: that of the groove. sagitta: by which its chords leave it at most, m.
    """
    across = np.cross(tangents, ups)
    across /= np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(across, tangents)
    count = max(8, math.ceil(math.pi / (2 * math.acos(1 - sagitta / radius))))
    angle = np.linspace(0.0, math.pi, 2 * math.ceil(count / 2) + 1)
    round_ = np.cos(angle)[:, None] * across[:, None] - np.sin(angle)[:, None] * up[:, None]
    below = points[:, None] + radius * round_
    lift = heights[:, None] * ups
    rings = np.concatenate([below, (below[:, -1] + lift)[:, None], (below[:, 0] + lift)[:, None]], axis=1)
    n, m = rings.shape[:2]
    grid = np.arange(n * m).reshape(n, m)
    a, b = grid[:-1], np.roll(grid[:-1], -1, axis=1)
    c, d = grid[1:], np.roll(grid[1:], -1, axis=1)
    sides = np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    fan = np.column_stack([np.zeros(m - 2, int), np.arange(1, m - 1), np.arange(2, m)])
    faces = np.vstack([sides, grid[0][fan][:, ::-1], grid[-1][fan]])
    corners = rings.reshape(-1, 3) * TO_MM
    if trimesh().Trimesh(corners, faces, process=False).volume < 0:
        faces = faces[:, ::-1]
    library = manifold()
    mesh = library.Mesh(vert_properties=corners.astype(np.float32), tri_verts=np.ascontiguousarray(faces, np.uint32))
    return library.Manifold(mesh)
