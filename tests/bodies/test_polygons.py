"""Faces with more than three corners: the surface is that of the polygons, in every kind of file."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.bodies.corridors import load_mesh, load_points
from tubeopt.bodies.polygons import Polygons
from tubeopt.typing import Array

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("manifold3d")

L = [(0, 0), (30, 0), (30, 10), (10, 10), (10, 20), (0, 20)]
"""An L, mm, counter-clockwise; its fourth corner points inwards."""

HEIGHT = 12

POINTS = [(*corner, z) for z in (0, HEIGHT) for corner in L]

FACES = [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *([k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k] for k in range(6))]
"""Of the prism above the L, outwards."""

RECTANGLES = [
    *(((x, y, z), (X, Y, z)) for z in (0, 12) for x, y, X, Y in ((0, 0, 30, 10), (0, 0, 10, 20))),
    ((0, 0, 0), (30, 0, 12)), ((30, 0, 0), (30, 10, 12)), ((10, 10, 0), (30, 10, 12)),
    ((10, 10, 0), (10, 20, 12)), ((0, 20, 0), (10, 20, 12)), ((0, 0, 0), (0, 20, 12)),
]  # fmt: skip
"""Its surface as rectangles along the axes, by two corners of each."""


def prism_distance(points: Array) -> Array:
    """(N,) distance of points (N, 3) from the prism, negative inside, mm: the least from the rectangles."""
    low, high = (np.array([each[k] for each in RECTANGLES], dtype=float) for k in (0, 1))
    beyond = np.maximum(np.maximum(low - points[:, None], points[:, None] - high), 0.0)
    x, y, z = points.T
    inside = (x > 0) & (y > 0) & (z > 0) & (z < HEIGHT) & (((x < 30) & (y < 10)) | ((x < 10) & (y < 20)))
    return np.where(inside, -1, 1) * np.linalg.norm(beyond, axis=2).min(1)


def written(path: Path, points: Any, faces: list[list[int]]) -> Path:
    """A file of polygons; the name says how it is written."""
    rows = [" ".join(repr(float(number)) for number in point) for point in points]
    table = [f"{len(face)} {' '.join(map(str, face))}" for face in faces]
    sizes = f"{len(points)} {len(faces)}"
    head = f"ply\nformat KIND\nelement vertex {len(points)}\n"
    head += "property double x\nproperty double y\nproperty double z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    match path.name:
        case "a.obj":
            rows = [f"v {row}" for row in rows] + ["f " + " ".join(f"{k + 1}//1" for k in face) for face in faces]
        case "back.obj":  # numbers that count back from the last point, which differ behind every point
            rows = [f"v {row}" for row in rows]
            for face in faces:
                rows += [
                    "f " + " ".join(str(k - rows.count("v 1 2 3") - len(points)) for k in face) + " # c",
                    "v 1 2 3",
                ]
        case "a.off":
            rows = ["OFF", f"{sizes} 0", *rows, *(f"{row} 255 0 0" for row in table)]
        case "text.ply":
            rows = [head.replace("KIND", "ascii 1.0").rstrip(), *rows, *table]
        case "a.vtk":
            cells = [f"POLYGONS {len(faces)} {sum(map(len, faces)) + len(faces)}", *table]
            rows = [
                "# vtk DataFile Version 3.0",
                "p",
                "ASCII",
                "DATASET POLYDATA",
                f"POINTS {len(points)} double",
                *rows,
            ]
            rows += cells
        case _:
            order = "<" if path.name == "little.ply" else ">"
            kind = f"binary_{path.name[:-4]}_endian 1.0"
            body = np.array(points, dtype=f"{order}f8").tobytes()
            body += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
            path.write_bytes(head.replace("KIND", kind).encode() + body)
            return path
    path.write_text("\n".join(rows) + "\n")
    return path


KINDS = ["a.obj", "back.obj", "a.off", "text.ply", "little.ply", "big.ply", "a.vtk"]


@pytest.mark.parametrize("turn", range(6))
@pytest.mark.parametrize("inwards", [False, True])
def test_a_prism_over_an_l_is_as_far_as_its_rectangles(tmp_path: Path, turn: int, inwards: bool) -> None:
    """Whichever corner a polygon begins with: of six fans of the L only two cover it and no more."""
    points = np.random.default_rng(turn).uniform([-10, -10, -10], [40, 30, 22], (400, 3))
    faces = [face[turn % len(face):] + face[: turn % len(face)] for face in FACES]  # fmt: skip
    faces = [face[::-1] for face in faces] if inwards else faces
    body = load_mesh(written(tmp_path / KINDS[turn], POINTS, faces))
    assert body.closed
    assert len(body.faces) == 2 * (6 - 2) + 6 * 2
    assert body.surface.signed_distance(points * 1e-3) == pytest.approx(prism_distance(points) * 1e-3, abs=1e-12)


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_of_file_has_the_polygons(tmp_path: Path, name: str) -> None:
    points = np.random.default_rng(1).uniform([-10, -10, -10], [40, 30, 22], (100, 3))
    for load in (load_mesh, load_points):
        body: Any = load(written(tmp_path / name, POINTS, FACES))
        if name != "back.obj" or load is load_mesh:  # it has points beside its faces
            assert body.surface.signed_distance(points * 1e-3) == pytest.approx(
                prism_distance(points) * 1e-3, abs=1e-12
            )


def test_triangles_cover_a_polygon_once(tmp_path: Path) -> None:
    """Areas of triangles are positive and add up to that of the polygon, by the shoelace formula, at any slant."""
    random = np.random.default_rng(4)
    for count in (4, 5, 9, 60):
        for _ in range(20):
            angle = np.sort(random.uniform(0, 2 * np.pi, count))
            if np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() > 3:
                continue
            flat = random.uniform(0.2, 1, count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
            space = np.column_stack([flat, np.full(count, 0.3)]) @ axes.T
            order = np.roll(np.arange(count), random.integers(count))[:: random.choice([1, -1])]
            cut = Polygons(space, order, np.array([count])).triangles(0.1)
            a, b, c = np.moveaxis(flat[cut], 1, 0)
            area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
            x, y = flat[order].T
            true = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
            assert (area * np.sign(true) > -1e-12).all()
            assert area.sum() == pytest.approx(true, rel=1e-12)


def test_a_polygon_around_a_hole_leaves_it_open() -> None:
    """A square with a hole, to which a slit of no width leads, as drawing programs write it."""
    ring = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
    points = np.column_stack([np.array(ring, dtype=float), np.zeros(10)])
    for turn in range(10):
        corner = points[Polygons(points, np.roll(np.arange(10), turn), np.array([10])).triangles(1e-2)]
        middle = corner.mean(1)[:, :2]
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
        assert area.sum() == pytest.approx(12)
        assert not ((middle > 1).all(1) & (middle < 3).all(1)).any()


SQUARE = [(0, 0, 0), (20, 0, 0), (20, 20, 0), (0, 20, 0)]


@pytest.mark.parametrize("name", ["a.obj", "a.off", "text.ply", "a.vtk"])
@pytest.mark.parametrize(
    ("points", "face", "message"),
    [
        ([*SQUARE[:3], (0, 20, 1)], [0, 1, 2, 3],
         r"face 2 is not plane: one of its 4 corners is 0\.25 mm from their plane, and at most 0\.01 mm are allowed"),
        (SQUARE, [0, 2, 1, 3], "face 2 crosses itself; its sides may meet at its corners only"),
        ([(np.sin(0.8 * np.pi * k), np.cos(0.8 * np.pi * k), 0) for k in range(5)], [0, 1, 2, 3, 4], "face 2 crosses"),
        ([*SQUARE, (10, 10, 0), (5, 15, 0)], [0, 1, 4, 3, 2, 4], "face 2 crosses"),  # in a corner that two sides share
        (SQUARE, [0, 1], "face 2 has 2 corners; it must have at least 3"),
    ],
)  # fmt: skip
def test_polygons_that_bound_no_surface(tmp_path: Path, name: str, points: Any, face: list[int], message: str) -> None:
    path = written(tmp_path / name, points, [[0, 1, 2], face])
    for load in (load_mesh, load_points):
        with pytest.raises(InputError, match=f"^{path}: {message}"):
            load(path)


def test_rounded_corners_are_plane(tmp_path: Path) -> None:
    """Coordinates to two decimals of a mm, on a slanted plane, are within the tolerance."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([60 * np.cos(angle), 60 * np.sin(angle), 17 * np.cos(angle) + 31 * np.sin(angle)], axis=1)
    body = load_mesh(written(tmp_path / "a.off", np.round(ring, 2), [list(range(12))]))
    assert len(body.faces) == 10


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.obj", "v 0 0 0\nv 9 0 0\nf 1 2 3\n", "outside its 2 points"),
        ("a.obj", "v 0 0 0\nv 9 0 0\nf -3 1 2\n", "face 1 has a corner that is no point"),
        ("a.obj", "v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\ncurv 0 1 1 2\n", "curves with knots, which are not read"),
        ("a.obj", "v 0 0 nan\nv 9 0 0\nv 0 9 0\nf 1 2 3\n", "NaN or infinite"),
        ("a.off", "4OFF\n1 0 0\n0 0 0 1\n", "it begins with '4OFF'; it must begin with OFF"),
        ("a.off", "OFF BINARY\n1 0 0\n", "it begins with 'OFF BINARY'"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n9 0 0\n0 9 0\n4 0 1 2\n", "face 1 has fewer corners than it states"),
        ("a.off", "OFF\n3 2 0\n0 0 0\n9 0 0\n0 9 0\n3 0 1 2\n", "states 3 points and 2 faces, and has 4 lines"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
                  "end_header\n1 2 3 4\n", "other numbers than its header states"),
        ("a.ply", "ply\nformat ascii 1.0\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n",
         "strips of triangles, which are not read"),
        ("a.ply", "solid", "no header of a PLY file"),
    ],
)  # fmt: skip
def test_files_that_state_something_else(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=f"^{tmp_path / name}: .*{message}"):
        load_mesh(tmp_path / name)


@pytest.mark.parametrize("kind", ["ply", "obj", "off"])
def test_triangles_are_read_as_by_trimesh(tmp_path: Path, kind: str) -> None:
    mesh = trimesh.creation.icosphere(2, 12.0)
    mesh.export(tmp_path / f"a.{kind}")
    other = trimesh.load(tmp_path / f"a.{kind}", force="mesh")
    body = load_mesh(tmp_path / f"a.{kind}")
    np.testing.assert_allclose(
        np.array(body.vertices)[np.array(body.faces)], other.triangles * 1e-3, rtol=0, atol=1e-15
    )
