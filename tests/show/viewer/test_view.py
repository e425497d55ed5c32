"""Files that are loaded in the page: bodies of every kind, and files that name each other."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.bodies.obstacles import Obstacle
from tubeopt.show.viewer.view import LoadedFiles, load_bodies

CUBE, LOW, HIGH = 2.0, np.array([10.0, 20.0, 30.0]), np.array([14.0, 26.0, 38.0])
"""Edge of a voxel, and corners of a box, mm."""


@pytest.fixture
def given() -> Iterator[LoadedFiles]:
    inputs = LoadedFiles()
    yield inputs
    inputs.close()


def nifti(path: Path, label: int = 7) -> bytes:
    """An image in which the voxels of the box have a label."""
    nibabel = pytest.importorskip("nibabel")
    labels = np.zeros((12, 16, 22), dtype=np.uint8)
    (a, b, c), (d, e, f) = (LOW / CUBE).astype(int), (HIGH / CUBE).astype(int)
    labels[a:d, b:e, c:f] = label
    position = np.diag([CUBE, CUBE, CUBE, 1.0])
    position[:3, 3] = CUBE / 2  # of the middle of the first voxel
    image = nibabel.Nifti1Image(labels, None)
    image.set_sform(position, 1)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, path)
    return path.read_bytes()


def ends(bodies: tuple[Obstacle, ...]) -> tuple[float, float]:
    """Along z through the middle of the box (mm): where a body begins and where it ends."""
    (body,) = bodies
    z = np.linspace(20.0, 44.0, 241)
    x, y = (LOW + HIGH)[:2] / 2
    inside = z[body.signed_distance(np.column_stack([np.full(241, x), np.full(241, y), z]) * 1e-3) < 0]
    return float(inside.min()), float(inside.max())


def test_an_image_and_a_mesh_lie_where_their_files_have_them(given: LoadedFiles, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    bodies, text = load_bodies(given.keep("C:\\scans\\a.nii.gz", nifti(tmp_path / "a.nii.gz")))
    assert ends(bodies) == pytest.approx((30, 38), abs=CUBE)
    assert text == "all that has a label (7), where the file has it"
    box = trimesh.creation.box(bounds=[LOW, HIGH])
    bodies, text = load_bodies(given.keep("box.stl", box.export(file_type="stl")))
    assert ends(bodies) == pytest.approx((30, 38), abs=0.2)
    assert text == "a mesh where its file has it"


def test_a_file_of_an_anatomy_finds_the_image_that_was_loaded_before(given: LoadedFiles, tmp_path: Path) -> None:
    text = b"anatomy:\n  image: a.nii\n  forbidden: [7]\n  base: {position_mm: [0, 0, 10], direction: [0, 0, 1]}\n"
    path = given.keep("anatomy.yaml", text)
    with pytest.raises(InputError) as missing:
        load_bodies(path)
    assert str(path.parent) not in given.message(missing.value)
    assert "a.nii: there is no such file" in given.message(missing.value)
    given.keep("a.nii", nifti(tmp_path / "a.nii"))
    bodies, message = load_bodies(path)
    (body,) = bodies
    x, y, z = (LOW + HIGH) / 2 - [0, 0, 10]
    assert body.signed_distance(np.array([[x, y, z]]) * 1e-3)[0] < 0
    assert message == "obstacles, 1"


def test_what_is_no_file_of_bodies_is_refused_by_its_own_name(given: LoadedFiles, tmp_path: Path) -> None:
    for name, content, message in (
        ("empty.nii", nifti(tmp_path / "e.nii", 0), "empty.nii has"),
        ("notes.txt", b"hello", "notes.txt: "),
        ("broken.stl", b"hello", "broken.stl: "),
    ):
        with pytest.raises(InputError) as wrong:
            load_bodies(given.keep(name, content))
        assert given.message(wrong.value).startswith(message)
    for name in ("", "..", "a/.."):
        with pytest.raises(InputError, match="is no name of a file"):
            given.keep(name, b"")
