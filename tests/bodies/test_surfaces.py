"""Open surfaces and clouds of points: the distance from triangles, not from their corners, and what is said of it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy
import yaml

import tubeopt
from tests.command_line import CRL, Run
from tubeopt import InputError
from tubeopt.bodies.corridors import MeshObstacle, load_mesh, load_points
from tubeopt.bodies.obstacles import scene_of
from tubeopt.bodies.solids import field_of_mesh, field_of_points, field_of_surface, largest_gap
from tubeopt.runs.surroundings_file import load_anatomy
from tubeopt.show.plan_report import ARMS
from tubeopt.show.viewer.view import load_bodies
from tubeopt.typing import Array, Index

trimesh = pytest.importorskip("trimesh")

RNG = np.random.default_rng(7)

WALL = ((-1, -1, -1), (1, 1, -1), (1, 1, 1), (-1, -1, 1))
"""Corners of a box between which a wall divides it, in halves of its sides."""


def to_triangle(point: Array, corners: Array) -> float:
    """Distance of a point from a triangle: the least of |p - sum w c| over weights w >= 0 that sum to 1, of all faces,
    sides and corners."""
    best = np.linalg.norm(corners - point, axis=1).min()
    for chosen in ((0, 1), (1, 2), (2, 0), (0, 1, 2)):
        first, *others = corners[list(chosen)]
        axes = np.array(others) - first
        weight = np.linalg.lstsq(axes.T, point - first, rcond=None)[0]
        if (weight >= 0).all() and weight.sum() <= 1:
            best = min(best, np.linalg.norm(first + weight @ axes - point))
    return float(best)


def surface(vertices: Any, faces: Any) -> MeshObstacle:
    return MeshObstacle(tuple(map(tuple, np.asarray(vertices).tolist())), tuple(map(tuple, np.asarray(faces).tolist())))


def cup() -> tuple[Array, Index]:
    """A ball of 30 mm without its top, a triangle that is a segment, and a point alone as a triangle without area."""
    ball = trimesh.creation.icosphere(1, 0.015)
    faces = np.array(ball.faces)[ball.triangles_center[:, 2] < 5e-3]
    more = np.array([[0, 0, 0.03], [0.01, 0, 0.03], [0.02, 0, 0.03], [-0.02, 0.01, 0.04]])
    k = len(ball.vertices)
    return np.concatenate([ball.vertices, more]), np.concatenate([faces, [[k, k + 1, k + 2], [k + 3, k + 3, k + 3]]])


def test_the_distance_from_an_open_surface_is_that_from_its_nearest_triangle() -> None:
    vertices, faces = cup()
    body = surface(vertices, faces)
    assert not body.closed
    points = RNG.uniform(-0.03, 0.05, (120, 3))
    true = np.array([min(to_triangle(point, vertices[face]) for face in faces) for point in points])
    assert body.surface.signed_distance(points) == pytest.approx(true, abs=1e-12)
    assert (true > 0).all()
    away = 1e-7 * body.gradient(points)
    assert body.surface.signed_distance(points + away) - true == pytest.approx(1e-7, abs=1e-9)
    fields = field_of_mesh(body, cell=2e-3), field_of_surface(body, 2e-3, cell=2e-3), body.lattice
    for field, thick in zip(fields, (0.0, 2e-3, 0.0), strict=True):
        report = field.signed_distance(points)
        outside = true > thick
        assert (report[outside] <= (true - thick)[outside]).all()
        inside = (np.abs(field.frame.seen(points) / field.spacing - (np.array(field.values.shape) - 1) / 2)
                  <= (np.array(field.values.shape) - 1) / 2).all(1)  # fmt: skip
        assert ((true - thick) - report)[inside & outside].max() <= field.error
        assert (field.at_most(points) >= true - thick).all()


def test_nothing_slips_between_the_corners_of_a_triangle(tmp_path: Path) -> None:
    """A sheet of two triangles, 80 mm wide, whose corners alone are 40 mm and more from the arm that goes through."""
    sheet = np.array([[-40, -40, 0], [40, -40, 0], [40, 40, 0], [-40, 40, 0]], dtype=float)
    mesh = trimesh.Trimesh(sheet + np.array([0, 0, 30]), [[0, 1, 2], [0, 2, 3]], process=False)
    position = np.array([3e-3, -2e-3, 30e-3])
    for name in ("sheet.ply", "sheet.obj", "sheet.stl", "sheet.off"):
        mesh.export(tmp_path / name)
        result = load_points(tmp_path / name)
        assert isinstance(result, MeshObstacle)
        assert result.signed_distance(position) == pytest.approx(0, abs=1e-12)
        written: dict[str, Any]
        for written in ({"points": [{"file": name, "radius_mm": 1, "axes": "RAS", "cell_mm": 4}]},
                        {"meshes": [{"file": name, "axes": "RAS", "cell_mm": 4}]}):  # fmt: skip
            (tmp_path / "a.yaml").write_text(yaml.safe_dump({"anatomy": written}))
            (body,) = load_anatomy(tmp_path / "a.yaml").bodies
            assert body.signed_distance(position) <= 0
            assert "open surface" in scene_of([body]).stands_for[0]
    robot = tubeopt.load_robot(CRL)
    shift = np.array([robot.home_translations * 0 + [-0.033, -0.092, -0.096], robot.home_translations])
    through = tubeopt.verify_trajectory(
        robot, [0.0, 1.0], np.zeros((2, 3)), shift, obstacles=[load_mesh(tmp_path / "sheet.stl")]
    )
    assert not through.holds
    assert through.clearance_from == ("the 2 triangles of sheet.stl, an open surface: it has no inside",)


def test_open_surface_is_reported_by_its_edges() -> None:
    """A box is closed; without a triangle three edges have one, and with a wall inside four have three."""
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    corners, faces = np.array(box.vertices), np.array(box.faces)
    assert surface(corners, faces).opened_by == ""
    assert surface(corners, faces[1:]).opened_by == "3 of its edges belong to one triangle only (a hole)"
    low = [int(np.argmin(np.abs(corners - [0.01 * x, 0.01 * y, 0.01 * z]).sum(1))) for x, y, z in WALL]
    wall = [[low[0], low[1], low[2]], [low[0], low[2], low[3]]]
    both = surface(corners, np.concatenate([faces, wall]))
    assert not both.closed
    assert "of its edges belong to more than two triangles" in both.opened_by


def test_an_open_surface_has_no_inside_to_stay_in(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    vertices, faces = cup()
    trimesh.Trimesh(vertices * 1e3, faces[:-2]).export(tmp_path / "cup.stl")
    load_mesh(tmp_path / "cup.stl")
    assert "to one triangle only (a hole). The arm keeps clear of its triangles" in caplog.text
    caplog.clear()
    inside = {"meshes": [{"file": "cup.stl", "axes": "RAS", "keep": "in"}]}
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({"anatomy": inside}))
    with pytest.raises(
        InputError, match=r"to one triangle only \(a hole\)\. It has no inside to stay in; .* keep: out"
    ):
        load_anatomy(tmp_path / "a.yaml")
    assert not caplog.records  # nothing that the refusal contradicts
    inside["meshes"][0]["keep"] = "out"
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({"anatomy": inside}))
    load_anatomy(tmp_path / "a.yaml")
    assert "to one triangle only (a hole). The arm keeps clear of its triangles" in caplog.text
    assert "an open surface: it has no inside" in load_bodies(tmp_path / "cup.stl")[1]
    for nothing in ((), ((0, 1, 999),)):
        with pytest.raises(InputError, match=r"triangles|faces of the mesh"):
            MeshObstacle(tuple(map(tuple, vertices.tolist())), nothing)


def test_points_of_no_triangle_count_as_well(tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [30, 0, 0]], dtype=float)
    text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    rows = "".join(" ".join(map(str, row)) + "\n" for row in vertices.tolist())
    (tmp_path / "a.ply").write_text(f"{text}{rows}3 0 1 2\n")
    result = load_points(tmp_path / "a.ply")
    assert isinstance(result, MeshObstacle)
    positions = np.array([[30, 0, 2], [3, 3, 2], [20, 0, 0]]) * 1e-3
    assert result.surface.signed_distance(positions) == pytest.approx([2e-3, 2e-3, 1e-2], abs=1e-9)


def test_plan_of_arms_reports_reference_of_clearance() -> None:
    proofs = [SimpleNamespace(clearance_from=text) for text in (("wall", "sheet"), ("sheet",), ())]
    (row,) = (quantity for quantity in ARMS if quantity.name == "clearance from")
    assert row.row_text(SimpleNamespace(proof=SimpleNamespace(proofs=proofs)), {}) == "wall; sheet"  # type: ignore[arg-type]
    assert row.row_text(SimpleNamespace(proof=SimpleNamespace(proofs=proofs[2:])), {}) is None  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [2, 60, 700])
def test_the_largest_gap_is_the_longest_edge_of_the_shortest_tree(count: int) -> None:
    for points in (RNG.normal(size=(count, 3)), np.repeat(RNG.normal(size=(count, 3)), 2, axis=0),
                   np.concatenate([RNG.random((count, 3)), RNG.random((count, 3)) + np.array([9, 0, 0])])):  # fmt: skip
        far = scipy.spatial.distance_matrix(*[np.unique(points, axis=0)] * 2)
        true = scipy.sparse.csgraph.minimum_spanning_tree(far).data.max()
        assert largest_gap(points) == pytest.approx(true, rel=1e-12)
    rings = [[5 * np.cos(a), 5 * np.sin(a), 20 * k] for k in range(4) for a in np.linspace(0, 6, 60)]
    assert largest_gap(np.array(rings)) == pytest.approx(20)
    assert largest_gap(np.zeros((3, 3))) == 0


def test_proof_about_point_cloud_is_reported(run: Run, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    grid = np.array([[x, y, 60] for x in (20, 32, 44) for y in (20, 32, 44)], dtype=float)
    rows = "".join(",".join(map(str, row)) + "\n" for row in grid.tolist())
    (tmp_path / "wall.csv").write_text(f"# SPACE=RAS\nx_mm,y_mm,z_mm\n{rows}")
    (tmp_path / "a.yaml").write_text("anatomy: {points: [{file: wall.csv, radius_mm: 1}]}")
    text = (
        "the 9 points of wall.csv, each a ball of 1 mm; the largest gap between neighbours is 12 mm, and nothing is "
        "proved between points"
    )
    assert load_anatomy(tmp_path / "a.yaml").bodies[0].stands_for == text  # type: ignore[attr-defined]
    assert "neighbouring points are up to 12 mm apart" in caplog.text
    caplog.clear()
    # Balls of half the gap touch, and leave holes of 2.5 mm in the middle of squares.
    assert field_of_points(grid * 1e-3, 6e-3).signed_distance([[26e-3, 26e-3, 60e-3]])[0] > 2e-3
    assert "the arm may pass between balls of radius 6 mm" in caplog.text
    caplog.clear()
    field_of_points(grid * 1e-3, 12e-3)
    assert not caplog.text
    anatomy = str(tmp_path / "a.yaml")
    rows = "0,0,0,0,-33,-92,-96\n1,5,0,0,-30,-89,-93\n"
    columns = [f"{name}_{k}_{unit}" for name, unit in (("rotation", "deg"), ("translation", "mm")) for k in (1, 2, 3)]
    (tmp_path / "t.csv").write_text(f"time_s,{','.join(columns)}\n{rows}")
    requested = "verify", str(tmp_path / "t.csv"), "--robot", CRL, "--anatomy", anatomy
    assert json.loads(run(*requested, "--json").out)["clearance_from"] == [text]
    table = " ".join(run(*requested).out.split())
    assert "clearance from the 9 points of wall.csv" in table
    solved = run("ik", CRL, "--target-mm=0,-3,40", "--anatomy", anatomy, "--json")
    assert json.loads(solved.out)["solutions"][0]["clearance_from"] == [text]


def test_damaged_normals_of_a_mesh_are_left_out_without_a_traceback(tmp_path: Path) -> None:
    """trimesh computes others, and logs the error of the file with its traceback."""
    text = pytest.importorskip("trimesh").creation.box((10, 10, 10)).export(file_type="stl_ascii")
    path = tmp_path / "cube.stl"
    path.write_text(text.replace("normal ", "normal none ", 1))
    script = "import sys; from tubeopt.bodies.corridors import load_mesh; print(len(load_mesh(sys.argv[1]).faces))"
    run = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True)
    assert (run.stdout.split(), run.stderr) == (["12"], "")


def test_bodies_that_overlap_are_one_room_to_stay_in() -> None:
    """Two balls that cross: inside the lens between them the wall is that of the union, by its closed form."""
    pytest.importorskip("manifold3d")
    radius, apart = 0.01, 0.012
    one, other = (trimesh.creation.icosphere(3, radius) for _ in range(2))
    other.apply_translation([apart, 0, 0])
    corners, count = np.concatenate([one.vertices, other.vertices]), len(one.vertices)
    both = surface(corners, np.concatenate([one.faces, other.faces + count]))
    points = RNG.uniform([-radius, -radius, -radius], [apart + radius, radius, radius], (4000, 3))
    to = np.stack([radius - np.linalg.norm(points - [x, 0, 0], axis=1) for x in (0.0, apart)])
    seam = np.hypot(np.hypot(points[:, 1], points[:, 2]) - np.sqrt(radius**2 - apart**2 / 4), points[:, 0] - apart / 2)
    # Of two balls the nearest wall is the farther sphere where its foot is outside the other ball, or the seam.
    axis = points - np.where(to[0] > to[1], 0.0, apart)[:, None] * [1, 0, 0]
    foot = points + axis / np.linalg.norm(axis, axis=1)[:, None] * to.max(0)[:, None]
    free = np.linalg.norm(foot - np.where(to[0] > to[1], apart, 0.0)[:, None] * [1, 0, 0], axis=1) > radius
    true = np.where(free, to.max(0), seam)
    inside = to.max(0) > 5e-4
    report = field_of_mesh(both, keep="in", cell=5e-4).signed_distance(points[inside])
    # A sphere of triangles is inside its ball, by 0.6 % of the radius at most, as is what is read between nodes.
    assert (report <= true[inside] + 1e-9).all()
    middle = np.abs(points[inside, 0] - apart / 2) < 1e-3
    assert np.abs(report - true[inside])[middle].max() < 1.1e-3
    assert (report > 0).all()
