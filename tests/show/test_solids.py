"""Arms for other programs: volumes, watertight surfaces, poses read back."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tubeopt
from tests.examples import CONFIGS, THESIS
from tubeopt.errors import InputError
from tubeopt.show.surfaces import CHORD, SampledCentreline, pieces, visible


@pytest.fixture(scope="module")
def pose() -> tubeopt.Equilibrium:
    return tubeopt.forward_kinematics(THESIS, [0.0, 1.0, 2.0])


def numbers(text: str | None) -> np.ndarray:
    assert text is not None
    return np.array([float(x) for x in text.split()])


@pytest.mark.parametrize(("form", "scale"), [("stl", 1e3), ("glb", 1.0)])
def test_surfaces_are_closed_and_of_the_volume_of_the_tubes(
    pose: tubeopt.Equilibrium, form: str, scale: float, tmp_path: Path
) -> None:
    trimesh = pytest.importorskip("trimesh")
    read = trimesh.load(str(tubeopt.save_solid(pose, tmp_path / f"arm.{form}")), force="mesh", process=form == "stl")
    desired = sum(np.pi * tube.radius**2 * (tube.end - tube.start) for tube in visible(pose)) * scale**3
    polygon = 48 / (2 * np.pi) * np.sin(2 * np.pi / 48)  # what a tube of 48 sides has of a round one
    assert read.volume == pytest.approx(polygon * desired, rel=1e-4)
    assert all(part.is_watertight for part in read.split(only_watertight=False))
    assert np.linalg.norm(read.vertices / scale - pose.tip_position, axis=1).min() < THESIS.tubes[0].outer_diameter


@pytest.mark.parametrize("robot", [THESIS, tubeopt.load_robot(CONFIGS / "thesis_etr.yaml")])
def test_straight_pieces_stay_on_the_arm(robot: tubeopt.ConcentricRobot) -> None:
    pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
    line = SampledCentreline(pose)
    fine = line.position(np.linspace(0, line.length, 20000))
    for piece in list(pieces(pose))[::7]:
        assert np.allclose(piece.frame.T @ piece.frame, np.eye(3), atol=1e-12)
        along = (piece.end - piece.start) / np.linalg.norm(piece.end - piece.start)
        assert piece.frame[:, 2] == pytest.approx(along)
        if robot is THESIS:  # whose tubes run along the centreline
            middle = (piece.start + piece.end) / 2
            assert np.linalg.norm(fine - middle, axis=1).min() < 1.1 * CHORD


def test_urdf_has_the_tip_and_cylinders_along_the_arm(pose: tubeopt.Equilibrium, tmp_path: Path) -> None:
    root = ElementTree.parse(tubeopt.save_solid(pose, tmp_path / "arm.urdf")).getroot()
    origin = root.find("joint/origin")
    assert origin is not None
    assert numbers(origin.get("xyz")) == pytest.approx(pose.tip_position, abs=1e-8)
    turned = Rotation.from_euler("xyz", numbers(origin.get("rpy"))).as_matrix()
    assert turned == pytest.approx(pose.tip_rotation, abs=1e-7)
    cylinders = root.findall("link/collision")
    assert len(cylinders) == len(list(pieces(pose)))
    total = sum(float(c.get("length", "nan")) for c in root.findall("link/collision/geometry/cylinder"))
    assert total == pytest.approx(pose.arc_length[-1], rel=1e-4)
    assert len(root.findall("link")) == 2


def test_mjcf_has_capsules_in_a_chain_and_the_tip(pose: tubeopt.Equilibrium, tmp_path: Path) -> None:
    root = ElementTree.parse(tubeopt.save_solid(pose, tmp_path / "arm.xml")).getroot()
    ends = [numbers(geom.get("fromto")) for geom in root.iter("geom")]
    assert sum(np.linalg.norm(end[3:] - end[:3]) for end in ends) == pytest.approx(pose.arc_length[-1], rel=1e-4)
    site = root.find(".//site")
    assert site is not None
    w, *xyz = numbers(site.get("quat"))
    assert Rotation.from_quat([*xyz, w]).as_matrix() == pytest.approx(pose.tip_rotation, abs=1e-7)


def test_other_endings_are_refused(pose: tubeopt.Equilibrium) -> None:
    with pytest.raises(InputError, match=r"'arm.step'; it must end in .stl, .glb, .urdf, .xml"):
        tubeopt.save_solid(pose, "arm.step")
    with pytest.raises(InputError, match="cannot be written"):
        tubeopt.save_solid(pose, "/proc/arm.urdf")
