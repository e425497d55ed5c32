"""Axes of the patient that files state themselves, in every kind of file, against those that are given."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tubeopt import InputError
from tubeopt.bodies.corridors import load_mesh, load_points
from tubeopt.bodies.frames import stated_axes
from tubeopt.bodies.images import read_image
from tubeopt.runs.surroundings_file import load_anatomy, load_landmarks, load_obstacles, load_pose

trimesh, nibabel, nrrd = (pytest.importorskip(name) for name in ("trimesh", "nibabel", "nrrd"))

PLACE = np.array([10.0, 20.0, 30.0])
"""In the numbers of a file, mm."""

IN_RAS = {"RAS": PLACE, "LPS": PLACE * [-1, -1, 1]}


def ball() -> Any:
    mesh = trimesh.creation.icosphere(1, 4.0)
    mesh.apply_translation(PLACE)
    return mesh


def write_mesh(path: Path, words: str) -> None:
    """As 3D Slicer writes it: the axes in the header of a binary STL, in the name of a text one, in comments."""
    kind = "stl_ascii" if path.name == "text.stl" else None
    content = b"" if path.suffix == ".vtk" else ball().export(file_type=kind or path.suffix[1:])
    if path.suffix == ".stl" and kind is None:
        content = words.encode().ljust(80, b"\0") + content[80:]
    elif kind is not None:
        content = content.replace("solid", f"solid {words}", 1).encode()
    elif path.suffix == ".ply":
        content = content.replace(b"ply\n", f"ply\ncomment {words}\n".encode(), 1)
        content = content.replace(b"\nformat", b"\nformat") if words else content
    elif path.suffix == ".vtk":
        content = vtk(words, ball(), binary=path.name != "text.vtk", new=path.name == "new.vtk")
    elif path.suffix == ".obj":
        content = f"# {words}\n{content}".encode()
    else:
        content = content.replace("OFF\n", f"OFF\n# {words}\n", 1).encode()
    path.write_bytes(content)


def written(folder: Path, part: dict[str, Any]) -> Path:
    (folder / "a.yaml").write_text(yaml.safe_dump({"anatomy": part}))
    return folder / "a.yaml"


NAMES = ["a.stl", "text.stl", "a.ply", "a.obj", "a.off", "a.vtk", "text.vtk", "new.vtk"]


def vtk(words: str, mesh: Any, *, binary: bool, new: bool) -> bytes:
    """Legacy VTK of version 4.2, as Slicer writes it, or of 5.1, with colours behind."""
    n, f = len(mesh.vertices), len(mesh.faces)
    head = f"# vtk DataFile Version {'5.1' if new else '4.2'}\n{words}\n{'BINARY' if binary else 'ASCII'}\n"

    def numbers(array: Any, form: str) -> bytes:
        flat = np.asarray(array).ravel()
        return flat.astype(form).tobytes() if binary else "\n".join(map(repr, flat.tolist())).encode()

    content = f"{head}DATASET POLYDATA\nPOINTS {n} float\n".encode() + numbers(mesh.vertices, ">f4") + b"\n"
    content += b"METADATA\nINFORMATION 0\n\n"
    if new:
        content += f"POLYGONS {f + 1} {3 * f}\nOFFSETS vtktypeint64\n".encode() + numbers(np.arange(f + 1) * 3, ">i8")
        content += b"\nCONNECTIVITY vtktypeint64\n" + numbers(mesh.faces, ">i8") + b"\n"
    else:
        rows = np.column_stack([np.full(f, 3), mesh.faces])
        content += f"POLYGONS {f} {4 * f}\n".encode() + numbers(rows, ">i4") + b"\n"
    return content + f"\nPOINT_DATA {n}\nSCALARS colour float 1\nLOOKUP_TABLE default\n".encode()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("key", ["meshes", "points"])
def test_meshes_lie_where_they_say(tmp_path: Path, name: str, key: str) -> None:
    part = {"file": name, "cell_mm": 2} | ({"radius_mm": 1} if key == "points" else {})
    for axes in ("RAS", "LPS"):
        write_mesh(tmp_path / name, f"3D Slicer output. SPACE={axes}")
        assert stated_axes(tmp_path / name) == axes
        for inputs in ({}, {"axes": axes}):
            (body,) = load_anatomy(written(tmp_path, {key: [part | inputs]})).bodies
            away = np.linalg.norm(body.gradient(IN_RAS[axes] * 1e-3 + [0.02, 0, 0]) - [1, 0, 0])
            assert away < 0.1
        other = "LPS" if axes == "RAS" else "RAS"
        with pytest.raises(InputError, match=f"{name}: axes is {other}, but the file states {axes}"):
            load_anatomy(written(tmp_path, {key: [part | {"axes": other}]}))
    write_mesh(tmp_path / name, "made by hand, color space: sRGB")
    with pytest.raises(InputError, match=f"{name}: the file does not state its axes, and none are given; give axes"):
        load_anatomy(written(tmp_path, {key: [part]}))
    write_mesh(tmp_path / name, "SPACE=IJK")
    with pytest.raises(InputError, match=f"{name}: it states the axes 'ijk'; they must be RAS or LPS"):
        load_anatomy(written(tmp_path, {key: [part]}))
    write_mesh(tmp_path / name, "SPACE=LPS SPACE=RAS")
    with pytest.raises(InputError, match=f"{name}: it states two kinds of axes, LPS and RAS"):
        load_anatomy(written(tmp_path, {key: [part]}))


@pytest.mark.parametrize("name", ["a.vtk", "text.vtk", "new.vtk"])
def test_vtk_has_the_surface_that_was_written(tmp_path: Path, name: str) -> None:
    write_mesh(tmp_path / name, "3D Slicer output. SPACE=RAS")
    result, desired = load_mesh(tmp_path / name), ball()
    assert result.closed
    assert np.array(result.vertices) == pytest.approx(np.asarray(desired.vertices) * 1e-3, abs=1e-8)
    assert np.array_equal(result.faces, desired.faces)
    content = (tmp_path / name).read_bytes()
    for broken in (content[: len(content) // 3], b"# vtk DataFile Version 4.2\n\nASCII\nDATASET UNSTRUCTURED_GRID\n"):
        (tmp_path / name).write_bytes(broken)
        with pytest.raises(
            InputError,
            match=r"no legacy VTK file|has no|no points of it|GRID, which is not read",
        ):
            load_mesh(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.glb", b"glTF", "format is '.glb'; it"),
        ("a.obj", b"v 0 0 0\nv 60 0 0\nv 0 60 0\nl 1 2\n", "it has lines between points, which are not read"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 2\nelement edge 1\n", "it has lines between points"),
        (
            "a.vtk",
            b"# vtk DataFile Version 4.2\n\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n0 0 0 60 0 0\nLINES 1 3\n2 0 1\n",
            "it has LINES, which are not read; save its surface as polygons",
        ),
        (
            "b.vtk",
            b"# vtk DataFile Version 4.2\n\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 60 0 0 0 60 0\n"
            b"TRIANGLE_STRIPS 1 4\n3 0 1 2\n",
            "it has TRIANGLE_STRIPS, which are not read; save its surface as polygons",
        ),
    ],
)
def test_what_would_be_read_in_part_or_in_another_unit_is_refused(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    (tmp_path / name).write_bytes(content)
    for read in (load_mesh, load_points):
        with pytest.raises(InputError, match=words):
            read(tmp_path / name)


def test_an_obstacle_is_read_in_the_axes_that_its_file_states(tmp_path: Path) -> None:
    for axes in ("RAS", "LPS"):
        write_mesh(tmp_path / "a.stl", f"3D Slicer output. SPACE={axes}")
        (tmp_path / "o.yaml").write_text("obstacles: [{kind: mesh, file: a.stl}]")
        (body,) = load_obstacles(tmp_path / "o.yaml")
        assert body.signed_distance(IN_RAS[axes] * 1e-3) < -3e-3
    write_mesh(tmp_path / "a.stl", "")
    assert load_mesh(tmp_path / "a.stl").signed_distance(PLACE * 1e-3) < -3e-3


def fcsv(system: str) -> str:
    head = f"# Markups fiducial file version = 4.11\n{system}"
    head += "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    return f"{head}vtkMRMLMarkupsFiducialNode_0,10,20,30,0,0,0,1,1,1,0,entry,,\n"


def markups(system: dict[str, str]) -> str:
    points = [{"id": "1", "label": "entry", "position": [10.0, 20.0, 30.0], "positionStatus": "defined"},
              {"id": "2", "label": "later", "position": [0.0, 0.0, 0.0], "positionStatus": "undefined"}]  # fmt: skip
    return json.dumps({"@schema": "x", "markups": [{"type": "Fiducial", **system, "controlPoints": points}]})


LANDMARKS: dict[str, Callable[[str | None], str]] = {
    "a.csv": lambda axes: f"{f'# SPACE={axes}' if axes else '# by hand'}\nname,x_mm,y_mm,z_mm\nentry,10,20,30\n",
    "entry.txt": lambda axes: f"{f'# CoordinateSystem = {axes}' if axes else ''}\n10 20 30\n",
    "a.fcsv": lambda axes: fcsv(f"# CoordinateSystem = {axes}\n" if axes else ""),
    "old.fcsv": lambda axes: fcsv(f"# CoordinateSystem = {int(axes == 'LPS')}\n" if axes else ""),
    "a.mrk.json": lambda axes: markups({"coordinateSystem": axes} if axes else {}),
}


@pytest.mark.parametrize("name", LANDMARKS)
def test_landmarks_lie_where_they_say(tmp_path: Path, name: str) -> None:
    write, path = LANDMARKS[name], tmp_path / name
    for axes in ("RAS", "LPS"):
        path.write_text(write(axes))
        for inputs in (None, axes):
            (result,) = load_landmarks(path, inputs).values()
            assert result == pytest.approx(IN_RAS[axes] * 1e-3)
        with pytest.raises(InputError, match="but the file states"):
            load_landmarks(path, "LPS" if axes == "RAS" else "RAS")
        path.write_text(write(None))
        assert load_landmarks(path, axes)["entry"] == pytest.approx(IN_RAS[axes] * 1e-3)
    with pytest.raises(InputError, match="the file does not state its axes, and none are given"):
        load_landmarks(path)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.fcsv", "# CoordinateSystem = LPS\nx,1,2\n", "line 2 has no x, y and z that are numbers"),
        ("a.fcsv", "# CoordinateSystem = LPS\n", "it has no points"),
        ("a.mrk.json", '{"markups": [{"coordinateSystem": "LPS", "controlPoints": [3]}]}', "markups file of 3D Slicer"),
        ("a.mrk.json", "not json", "markups file of 3D Slicer"),
    ],
)
def test_markups_that_are_none_are_refused(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words) as error:
        load_landmarks(tmp_path / name, "LPS")
    assert len(str(error.value).splitlines()) == 1


def test_a_pose_needs_axes(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[:3, 3] = PLACE
    np.savetxt(tmp_path / "pose.txt", pose)
    for axes in ("RAS", "LPS"):
        assert load_pose(tmp_path / "pose.txt", axes).origin == pytest.approx(IN_RAS[axes] * 1e-3)
    with pytest.raises(InputError, match="the file does not state its axes"):
        load_pose(tmp_path / "pose.txt")
    text = (tmp_path / "pose.txt").read_text()
    (tmp_path / "pose.txt").write_text(f"# SPACE=LPS\n{text}")
    frame = load_pose(tmp_path / "pose.txt")
    assert frame.origin == pytest.approx(IN_RAS["LPS"] * 1e-3)
    assert frame.axes == pytest.approx(np.diag([-1.0, -1.0, 1.0]))


LABELS = np.zeros((6, 7, 8), dtype=np.uint8)
LABELS[2:4, 3:5, 4:6] = 1


def test_images_without_orientation_need_axes(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(LABELS, None)
    image.header.set_zooms((1.0, 2.0, 3.0))
    image.header["sform_code"] = image.header["qform_code"] = 0
    nibabel.save(image, tmp_path / "a.nii")
    nrrd.write(str(tmp_path / "a.nrrd"), LABELS, {"spacings": [1.0, 2.0, 3.0]})
    for name in ("a.nii", "a.nrrd"):
        with pytest.raises(InputError, match=f"{name}: its header does not say how the image lies in the patient"):
            read_image(tmp_path / name)
        for axes, sign in (("RAS", 1), ("LPS", -1)):
            result = read_image(tmp_path / name, axes)
            assert result.frame.placed(np.array([1, 1, 1]) * result.spacing) * 1e3 == pytest.approx([sign, 2 * sign, 3])
            for part in ({"image": name, "image_axes": axes, "lumen": [1]},
                         {"structures": [{"file": name, "axes": axes, "keep": "in"}]}):  # fmt: skip
                (body,) = load_anatomy(written(tmp_path, part)).bodies
                assert body.signed_distance(np.array([2.5 * sign, 7.0 * sign, 13.5]) * 1e-3) > 0
        with pytest.raises(InputError, match=r"anatomy.image: .* give the axes"):
            load_anatomy(written(tmp_path, {"image": name, "lumen": [1]}))


def test_images_that_say_how_they_lie_are_not_overruled(tmp_path: Path) -> None:
    nibabel.save(nibabel.Nifti1Image(LABELS, np.diag([1.0, 2.0, 3.0, 1.0])), tmp_path / "a.nii")
    about = {"space directions": np.diag([1.0, 2.0, 3.0]), "space origin": np.zeros(3)}
    for space, states in (("left-posterior-superior", "LPS"), ("left-anterior-superior", "LAS")):
        nrrd.write(str(tmp_path / f"{states}.nrrd"), LABELS, about | {"space": space})
        read_image(tmp_path / f"{states}.nrrd")
        with pytest.raises(InputError, match=f"axes is RAS, but the header states {states}"):
            read_image(tmp_path / f"{states}.nrrd", "RAS")
    assert read_image(tmp_path / "a.nii", "RAS").spacing == pytest.approx([1e-3, 2e-3, 3e-3])
    with pytest.raises(InputError, match="axes is LPS, but the header states RAS"):
        read_image(tmp_path / "a.nii", "LPS")


@pytest.mark.parametrize("line", ["# space: LPS", "# Space = lps", "# SPACE=LPS"])
def test_axes_may_have_alternative_spellings(tmp_path: Path, line: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"{line}\nx_mm,y_mm,z_mm\n1,2,3\n")
    assert stated_axes(path) == "LPS"
    path.write_text("# space: laboratory\nx_mm,y_mm,z_mm\n1,2,3\n")
    assert stated_axes(path) is None
