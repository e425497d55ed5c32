"""Images as they are written by other libraries, and files that are not what they say."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.bodies.frames import base_frame
from tubeopt.bodies.images import read_image

nibabel = pytest.importorskip("nibabel")
nrrd = pytest.importorskip("nrrd")

PLACE = base_frame([0.1, -0.2, 0.3], [0.3, 0.2, 1.0], 0.7)
SPACING = np.array([0.8, 0.5, 1.1])
LABELS = np.zeros((9, 8, 7), dtype=np.uint8)
LABELS[2:5, 3:6, :] = 3


def affine() -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = PLACE.axes * SPACING, PLACE.origin * 1e3
    return out


def write_nifti(path: Path, data: np.ndarray = LABELS, where: np.ndarray | None = None, unit: str = "mm") -> Path:
    if path.suffix == ".mgz":
        nibabel.save(nibabel.freesurfer.MGHImage(data, affine()), path)
        return path
    image = nibabel.Nifti1Image(data, None)
    image.set_sform(affine() if where is None else where, 1)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    return path


LONG = "NRRD0004\ntype: int64\ndimension: 3\nsizes: 1000 1000 300\nencoding: raw\nendian: little\ndata file: a.raw\n\n"


def write_nrrd(path: Path) -> Path:
    """With "sequence" in its name as a sequence of one volume."""
    back = np.diag([-1.0, -1.0, 1.0])
    header = {
        "space": "left-posterior-superior",
        "space directions": (back @ affine()[:3, :3]).T,
        "space origin": back @ affine()[:3, 3],
    }
    if "sequence" in path.name:
        header["space directions"] = np.vstack([np.full(3, np.nan), header["space directions"]])
    nrrd.write(str(path), LABELS[None] if "sequence" in path.name else LABELS, header)
    return path


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.mgz", "a.nrrd", "sequence.nrrd"])
def test_voxels_lie_where_they_were_written(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    image = read_image(write_nrrd(path) if name.endswith("nrrd") else write_nifti(path))
    index = np.array([[0, 0, 0], [8, 0, 0], [0, 7, 0], [0, 0, 6], [3, 4, 5]])
    expected = (index @ affine()[:3, :3].T + affine()[:3, 3]) * 1e-3
    assert np.allclose(image.frame.placed(index * image.spacing), expected, atol=1e-7)
    assert np.array_equal(image.values, LABELS)
    assert image.labels == (3,)
    assert image.chosen([3]).sum() == (LABELS == 3).sum()


def write_layers(path: Path, values: tuple[int, ...]) -> np.ndarray:
    """Segments as 3D Slicer saves those that overlap: two share the first layer, one has the second."""
    layers = np.zeros((2, *LABELS.shape), dtype=np.uint8)
    layers[0, 1:4], layers[0, 5:7], layers[1, 2:6] = values
    back = np.diag([-1.0, -1.0, 1.0])
    header = {
        "kinds": ["list", "domain", "domain", "domain"],
        "space": "left-posterior-superior",
        "space directions": np.vstack([np.full(3, np.nan), (back @ affine()[:3, :3]).T]),
        "space origin": back @ affine()[:3, 3],
    }
    for k, (name, layer) in enumerate((("airway", 0), ("vessel", 0), ("tumour", 1))):
        header |= {f"Segment{k}_LabelValue": str(values[k]), f"Segment{k}_Layer": str(layer), f"Segment{k}_Name": name}
    nrrd.write(str(path), layers, header)
    return layers


@pytest.mark.parametrize("values", [(1, 2, 1), (4, 5, 9)])
def test_segments_that_overlap_are_read_from_their_layers(
    tmp_path: Path, values: tuple[int, ...], caplog: pytest.LogCaptureFixture
) -> None:
    layers = write_layers(tmp_path / "a.seg.nrrd", values)
    image = read_image(tmp_path / "a.seg.nrrd")
    alike = len(set(values)) < 3
    assert image.labels == ((1, 2, 3) if alike else values)  # numbers of the segments where values do not tell them
    assert ("their labels are 1 airway, 2 vessel, 3 tumour" in caplog.text) == alike
    airway, vessel, tumour = image.labels
    assert np.array_equal(image.chosen([airway]), layers[0] == values[0])
    assert np.array_equal(image.chosen([tumour, vessel]), (layers[1] > 0) | (layers[0] == values[1]))
    assert np.array_equal(image.chosen([0]), ~layers.any(0))
    assert (image.chosen([airway]) & image.chosen([tumour])).any()
    index = np.array([[0, 0, 0], [3, 4, 5]])
    expected = (index @ affine()[:3, :3].T + affine()[:3, 3]) * 1e-3
    assert np.allclose(image.frame.placed(index * image.spacing), expected, atol=1e-7)
    with pytest.raises(InputError, match=r"lumen 77 is not in .*a\.seg\.nrrd; its labels are"):
        image.chosen([77], "lumen")
    with pytest.raises(InputError, match="which has segments; give labels"):
        image.between(0, 1)


def test_layers_without_segments_are_refused(tmp_path: Path) -> None:
    header = {"kinds": ["list", "domain", "domain", "domain"], "space": "left-posterior-superior"}
    header |= {"space directions": np.vstack([np.full(3, np.nan), np.eye(3)])}
    nrrd.write(str(tmp_path / "a.nrrd"), np.ones((2, 3, 3, 3), dtype=np.uint8), header)
    with pytest.raises(InputError, match="has 2 layers, but names no segments"):
        read_image(tmp_path / "a.nrrd")
    header |= {"Segment0_LabelValue": "1", "Segment0_Layer": "2"}
    nrrd.write(str(tmp_path / "b.nrrd"), np.ones((2, 3, 3, 3), dtype=np.uint8), header)
    with pytest.raises(InputError, match="Segment0_Layer is 2; it must be from 0 to 1"):
        read_image(tmp_path / "b.nrrd")


def test_units_and_scales_of_headers(tmp_path: Path) -> None:
    metres = affine() * np.array([[1e-3], [1e-3], [1e-3], [1.0]])
    image = read_image(write_nifti(tmp_path / "m.nii", where=metres, unit="meter"))
    assert np.allclose(image.spacing, SPACING * 1e-3, rtol=1e-5)
    scaled = nibabel.Nifti1Image(LABELS.astype(np.int16), affine())
    scaled.header.set_slope_inter(2.0, -1.0)
    nibabel.save(scaled, tmp_path / "s.nii")
    assert read_image(tmp_path / "s.nii").labels == tuple(
        sorted({int(v) for v in np.unique(np.asarray(nibabel.load(tmp_path / "s.nii").dataobj))} - {0})
    )


def truncated(path: Path) -> None:
    whole = write_nifti(path).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])


def huge(path: Path) -> None:
    raw = bytearray(gzip.decompress(write_nifti(path.with_suffix(".nii.gz")).read_bytes()))
    raw[42:48] = np.array([30000, 30000, 30000], dtype=np.int16).tobytes()
    path.write_bytes(raw)


def sheared(path: Path) -> None:
    where = np.diag([1.0, 1.0, 1.0, 1.0])
    where[0, 1] = 0.3
    write_nifti(path, where=where)


BROKEN: list[tuple[str, Callable[[Path], object], str]] = [
    ("a.nii.gz", truncated, "no image can be read from it: "),
    ("a.nii", huge, "has 30000 x 30000 x 30000 voxels, 2.7e[+]04 GB; it must have 1.2 GB at most"),
    ("a.nii", sheared, "image are 16.7 deg"),
    ("a.nii", lambda path: path.write_bytes(b"hello" * 99), "no image can be read from it: "),
    ("a.nii", lambda path: write_nifti(path, np.zeros((4, 4, 4, 2), np.uint8)), "has 4 x 4 x 4 x 2 voxels"),
    ("a.nii", lambda path: write_nifti(path, where=np.diag([1e-3, 1e-3, 1e-3, 1])), "unit in the header"),
    ("a.nii", lambda path: None, "there is no such file"),
    ("a.dcm", lambda path: path.write_bytes(b""), "image; it must be .nii"),
    ("a.nrrd", lambda path: nrrd.write(str(path), LABELS), "the header has"),
    ("a.nrrd", lambda path: nrrd.write(str(path), np.zeros((3, 4, 4, 4), np.uint8)), "has 3 x 4 x 4 x 4 voxels"),
    ("a.nhdr", lambda path: path.write_text(LONG), "has 1000 x 1000 x 300 voxels, 2.4 GB; it must have 1.2 GB at most"),
    ("a.nrrd", lambda path: path.write_text("NRRD0004\ntype: uchar\n\n1"), "no image can be read from it: "),
]


@pytest.mark.parametrize(("name", "write", "words"), BROKEN)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, name: str, write: Callable[[Path], object], words: str) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=words) as error:
        read_image(tmp_path / name)
    assert len(str(error.value).splitlines()) == 1


def test_labels_must_be_labels(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 300, LABELS.shape).astype(np.float32)
    image = read_image(write_nifti(tmp_path / "ct.nii", noise))
    with pytest.raises(InputError, match="is not a label image: it has values such as"):
        image.chosen([1])
    assert image.between(-100, 100).sum() == (np.abs(noise) <= 100).sum()
    broken = np.where(LABELS, np.nan, 0).astype(np.float32)
    with pytest.raises(InputError, match="NaN or infinite"):
        read_image(write_nifti(tmp_path / "nan.nii", broken)).chosen([1])
    with pytest.raises(InputError, match=r"lumen 9 is .*; its labels are 3"):
        read_image(write_nifti(tmp_path / "ok.nii")).chosen([9], "lumen")


def test_two_places_in_one_header_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    image = nibabel.Nifti1Image(LABELS, None)
    image.set_sform(affine(), 1)
    image.set_qform(affine(), 1)
    nibabel.save(image, tmp_path / "one.nii")
    read_image(tmp_path / "one.nii")
    assert not caplog.records
    image.set_qform(np.diag([*SPACING, 1.0]), 1)
    nibabel.save(image, tmp_path / "two.nii")
    assert np.allclose(read_image(tmp_path / "two.nii").frame.origin, PLACE.origin)
    assert "sform and qform of the" in caplog.text
    (tmp_path / "dicom.nii").mkdir()
    with pytest.raises(InputError, match="this is a directory; it must be a file"):
        read_image(tmp_path / "dicom.nii")
