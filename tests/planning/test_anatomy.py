"""An arm in an anatomy made of formulas: planned and proved in its labels, and looked up voxel by voxel."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import tubeopt
from tests.command_line import ROOT
from tests.conftest import draw_quickly
from tubeopt import InputError, PlanOptions, TipGoal
from tubeopt.bodies.anatomy import Anatomy, anatomy_in_frame, centres
from tubeopt.bodies.corridors import MeshObstacle
from tubeopt.bodies.distance_field import DistanceField
from tubeopt.bodies.frames import Frame, base_frame
from tubeopt.bodies.images import LabelImage, field_of_image
from tubeopt.bodies.phantoms import LUMEN, TARGET, bronchial_tree, kidney, ventricle
from tubeopt.files.checked import check
from tubeopt.planning import Trajectory, plan_trajectory
from tubeopt.planning.knots import table_function
from tubeopt.runs.inverse_study import InverseStudy
from tubeopt.runs.plan_study import PlanStudy
from tubeopt.runs.surroundings_file import load_anatomy, load_obstacles
from tubeopt.show.plots.trajectory import plot_trajectory
from tubeopt.show.viewer.scene import obstacle_parts
from tubeopt.typing import Array, Mask

ROBOT = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
WITHDRAWN = np.zeros(3), np.array([-0.033, -0.092, -0.096])
WITHIN = np.array([0.5, 2.0, -0.5]), np.array([0.01, -0.05, -0.085])


@lru_cache(maxsize=2)
def lung(voxel: float = 1e-3, frame: Frame | None = None) -> LabelImage:
    return bronchial_tree().image(voxel, frame)


def barred_voxels_near(plan: Trajectory, image: LabelImage, free: Mask, near: float) -> int:
    """Points `near` (m) the surface of the arm, at some times, that lie in voxels where it may not be."""
    touched = 0
    for arm in plan.arms[:: max(1, len(plan.arms) // 10)]:
        s = np.linspace(0, arm.arc_length[-1], 200)
        line = np.column_stack([np.interp(s, arm.arc_length, arm.position[:, k]) for k in range(3)])
        frame = arm.frame[np.clip(np.searchsorted(arm.arc_length, s), 0, len(arm.arc_length) - 1)]
        radii = [tube.outer_diameter / 2 for tube in ROBOT.tubes]
        shown = s[:, None] <= arm.tube_end
        radius = np.where(shown, radii, 0.0).max(1)
        angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)[:, None, None]
        rim = line + (radius + near)[:, None] * (np.cos(angle) * frame[:, :, 0] + np.sin(angle) * frame[:, :, 1])
        index = np.rint(image.frame.seen(rim.reshape(-1, 3)) / image.spacing).astype(int)
        touched += int((~free[tuple(index.T)]).sum())
    return touched


def test_an_insertion_is_smoothed_as_asked_and_comes_near_no_voxel_that_is_barred(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw_quickly(monkeypatch)
    image = lung()
    free = image.chosen([LUMEN, TARGET])
    field = field_of_image(image, lumen=free)
    end = tubeopt.forward_kinematics(ROBOT, *WITHIN)
    goal = end.tip_position
    assert field.signed_distance(goal) > 1e-3
    # However busy the machine is, there is time to smooth.
    options = PlanOptions(
        clearance=2e-3, objective="effort", time_limit=600.0, smoothing_seconds=300.0, smoothing_intervals=8
    )
    plan = plan_trajectory(ROBOT, WITHDRAWN, end, obstacles=[field], options=options)
    assert plan.proved
    assert plan.statistics.smoothed == "effort"
    assert plan.proof.least_clearance >= 2e-3
    assert np.linalg.norm(plan.tip_position[-1] - goal) < 1e-5
    assert barred_voxels_near(plan, image, free, 1.99e-3) == 0
    picture = tmp_path / "lung.png"
    plot_trajectory(plan, picture)
    assert picture.stat().st_size > 10_000
    part = obstacle_parts([field], 0.1)[0]
    assert part.opacity == 0.3
    assert len(part.surface.faces) > 1000


def test_a_table_of_distances_is_a_function_of_a_program() -> None:
    """Splines reproduce what is linear, in any frame; beyond the lattice they go on as at its border."""
    x = np.stack(np.meshgrid(*(np.arange(n) * 2e-3 for n in (9, 12, 15)), indexing="ij"), axis=-1)
    frame = base_frame([0.01, 0.02, 0.03], [1.0, 0.3, 0.5])
    table = DistanceField(x @ [0.6, 0.0, 0.8], np.full(3, 2e-3), frame)
    inner = np.random.default_rng(0).uniform([6e-3] * 3, [1e-2, 1.6e-2, 2.2e-2], (50, 3))
    report = np.array(table_function(table).map(50)(inner.T))[0]
    assert report == pytest.approx(inner @ [0.6, 0.0, 0.8], abs=1e-4)  # what is left of blurring at the border
    sharp = MeshObstacle(*_cube())
    assert float(table_function(sharp)(sharp.lattice.frame.seen([0.028, 0.0, 0.0]))) == pytest.approx(0.008, abs=1e-3)


def _cube() -> tuple[Any, Any]:
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    return tuple(map(tuple, box.vertices.tolist())), tuple(map(tuple, box.faces.tolist()))


def test_a_landmark_that_is_called_as_the_region_is_refused() -> None:
    image = lung(2e-3)
    marks = {"target": np.zeros(3)}
    field = field_of_image(image, lumen=image.chosen([LUMEN, TARGET]))
    with pytest.raises(InputError, match="a landmark and the target region"):
        anatomy_in_frame([field], Frame(), target=centres(image, image.chosen([TARGET])), landmarks=marks)


def test_a_region_is_a_goal() -> None:
    image = lung()
    field = field_of_image(image, lumen=image.chosen([LUMEN, TARGET]))
    first = tubeopt.forward_kinematics(ROBOT, *WITHIN).tip_position
    wall = np.array([0.0, 0.03, 0.02])  # where no tip can be
    region = TipGoal(np.stack([wall, first, first + 1e-3]))
    options = PlanOptions(clearance=2e-4, objective="none")
    plan = plan_trajectory(ROBOT, WITHDRAWN, region, obstacles=[field], options=options)
    assert plan.proved
    assert np.linalg.norm(region.position - plan.tip_position[-1], axis=1).min() < 1e-5


@pytest.mark.parametrize("make", [bronchial_tree, ventricle, kidney])
def test_phantoms_are_where_their_formulas_are(make: object) -> None:
    assert callable(make)
    phantom = make()
    image = phantom.image(2e-3)
    assert image.labels == (LUMEN, TARGET)
    for position in phantom.landmarks.values():
        assert phantom.depth(np.array(position) * 1e-3) > 2e-3
    assert phantom.depth(np.zeros(3)) > 3e-3
    inside = centres(image, image.chosen([LUMEN, TARGET]))
    assert (phantom.depth(inside) > 0).all()


@lru_cache(maxsize=1)
def case() -> tuple[LabelImage, Frame, DistanceField]:
    """The lung on that table, in the axes of the patient; the plate of the robot, and how far all is from its wall."""
    base = base_frame([0.02, -0.11, 0.2], [0.1, 0.2, -1.0], 0.4)
    image = lung(1.5e-3, Frame(base.axes.T, -base.axes.T @ base.origin))
    patient = Frame(base.axes @ image.frame.axes, base.placed(image.frame.origin))
    placed = LabelImage(image.values, image.spacing, patient)
    return placed, base, field_of_image(placed, lumen=placed.chosen([1, 2]))


def write_case(directory: Path) -> tuple[Anatomy, Frame]:
    """A lung on a table that lies anyhow, in files, and the anatomy as the library makes it of the same numbers."""
    nibabel = pytest.importorskip("nibabel")
    placed, base, field = case()
    image, patient = placed, placed.frame
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = patient.axes * image.spacing * 1e3, patient.origin * 1e3
    nibabel.save(nibabel.Nifti1Image(image.values, affine), directory / "lung.nii.gz")
    marks = {name: base.placed(np.array(position) * 1e-3) for name, position in bronchial_tree().landmarks.items()}
    rows = [f"{name},{-x * 1e3:.6f},{-y * 1e3:.6f},{z * 1e3:.6f}" for name, (x, y, z) in marks.items()]
    (directory / "marks.csv").write_text("\n".join(["name,x_mm,y_mm,z_mm", *rows]))
    plate = {name: [float(x) for x in position] for name, position in bronchial_tree().landmarks.items()}
    (directory / "anatomy.yaml").write_text(
        yaml.safe_dump(
            {
                "anatomy": {
                    "image": "lung.nii.gz",
                    "lumen": [1],
                    "target": [2],
                    "landmarks": {"file": "marks.csv", "axes": "LPS"},
                    "registration": {"landmarks_mm": plate},
                }
            }
        )
    )
    return anatomy_in_frame([field], base, target=centres(placed, placed.chosen([2])), landmarks=marks), base


def test_files_make_the_anatomy_that_the_library_makes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    expected, base = write_case(tmp_path)
    result = load_anatomy(tmp_path / "anatomy.yaml")
    assert result.registration_error < 1e-8
    assert np.allclose(result.base.axes, base.axes, atol=1e-6)
    points = np.random.default_rng(0).uniform([-0.02, -0.01, 0], [0.02, 0.01, 0.06], (500, 3))
    far = result.bodies[0].signed_distance(points) - expected.bodies[0].signed_distance(points)
    assert np.abs(far).max() < 1e-6
    assert result.target is not None
    assert expected.target is not None
    assert len(result.target) == len(expected.target)
    assert np.allclose(result.position("carina"), [0, 0, 0.042], atol=1e-6)
    robot = str(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    plan = {"kind": "plan", "robot": robot, "anatomy": "anatomy.yaml", "tip_at": "carina"}
    study = check(PlanStudy, plan, tmp_path / "plan.yaml")
    assert np.allclose(goal_of(study), [0, 0, 0.042], atol=1e-6)
    inverse = {"kind": "inverse_kinematics", "robot": robot, "anatomy": "anatomy.yaml", "target_mm": [0, -3, 40]}
    answer = check(InverseStudy, inverse, tmp_path / "ik.yaml").run()
    assert answer.solutions[0].clearance > 0  # type: ignore[union-attr]
    (tmp_path / "bodies.yaml").write_text("obstacles: [{kind: anatomy, file: anatomy.yaml}]")
    assert len(load_obstacles(tmp_path / "bodies.yaml")) == 1
    with pytest.raises(InputError, match=r"'carna' is .*; did you mean 'carina'?"):
        check(PlanStudy, plan | {"tip_at": "carna"}, tmp_path / "plan.yaml")
    text = (tmp_path / "anatomy.yaml").read_text()
    (tmp_path / "anatomy.yaml").write_text(text.replace("LPS", "RAS"))
    assert "no landmark lies in" not in caplog.text
    load_anatomy(tmp_path / "anatomy.yaml")
    assert "no landmark lies in" in caplog.text


def goal_of(study: PlanStudy) -> Array:
    goal = study.goal(study.around)
    assert isinstance(goal, TipGoal)
    return goal.position


def test_a_case_of_one_image_per_structure_is_that_of_all_its_labels(tmp_path: Path) -> None:
    """Files as those of Med-RAD: images of one structure, a start as a matrix, a target as three numbers."""
    expected, base = write_case(tmp_path)
    nibabel = pytest.importorskip("nibabel")
    whole = nibabel.load(tmp_path / "lung.nii.gz")
    values = np.asarray(whole.dataobj)
    tissue = (values == 0).astype(np.int16)
    for name, voxels in {"airway": 5.0 * (values > 0), "nodule": values == 2, "tissue": tissue}.items():
        nibabel.save(nibabel.Nifti1Image(voxels.astype(np.float32), whole.affine), tmp_path / f"{name}.nii.gz")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = base.axes, base.origin * 1e3
    np.savetxt(tmp_path / "start1.txt", pose)
    carina = base.placed(expected.landmarks["carina"]) * 1e3
    np.savetxt(tmp_path / "target1.txt", carina)
    case = {
        "structures": [{"file": "airway.nii.gz", "keep": "in"}, {"file": "nodule.nii.gz", "keep": "target"}],
        "landmarks": {"file": "target1.txt", "axes": "RAS"},
        "base": {"pose": "start1.txt", "axes": "RAS"},
    }
    (tmp_path / "case.yaml").write_text(yaml.safe_dump({"anatomy": case}))
    result = load_anatomy(tmp_path / "case.yaml")
    points = np.random.default_rng(0).uniform([-0.02, -0.01, 0], [0.02, 0.01, 0.06], (500, 3))
    inside = expected.bodies[0].signed_distance(points)
    assert np.abs(result.bodies[0].signed_distance(points) - inside).max() < 1e-6
    assert result.target is not None
    assert expected.target is not None
    assert len(result.target) == len(expected.target)
    assert np.allclose(result.position("target1"), expected.landmarks["carina"], atol=1e-6)
    case["structures"] = [{"file": "tissue.nii.gz"}]
    (tmp_path / "case.yaml").write_text(yaml.safe_dump({"anatomy": case}))
    (barred,) = load_anatomy(tmp_path / "case.yaml").bodies
    close = np.abs(inside) < 3e-3
    assert close.sum() > 40
    assert np.abs(barred.signed_distance(points) - inside)[close].max() < 2e-3  # but for the border of the image
    np.savetxt(tmp_path / "start1.txt", 2 * pose)
    with pytest.raises(InputError, match=r"start1.txt: the"):
        load_anatomy(tmp_path / "case.yaml")
    (tmp_path / "start1.txt").write_text("1 2 x")
    with pytest.raises(InputError, match=r"start1.txt: it must contain only a matrix of four rows of four numbers"):
        load_anatomy(tmp_path / "case.yaml")


WRONG = [
    ({"structures": [{"file": "no.nii"}]}, "no.nii: there is no such file"),
    ({"points": [{"file": "c.csv", "radius_mm": 1, "axes": "RAS"}], "base": {"pose": "c.csv"}},
     "c.csv: it must contain only a matrix of four rows"),
    ({"points": [{"file": "c.csv", "radius_mm": 1}]}, "c.csv: the file does not state its axes, and none are given"),
    ({}, "anatomy has no image, structures, meshes or points; it must have one of them"),
    ({"points": [{"file": "c.csv", "radius_mm": 0}]}, r"anatomy.points\[0\].radius_mm is 0; it must be greater than 0"),
    ({"points": [{"file": "no.csv", "radius_mm": 1}]}, "no.csv"),
    ({"meshes": [{"file": "no.stl"}]}, "no.stl: there is no such file"),
    ({"lumen": [1]}, "anatomy chooses labels or a region without an image"),
    ({"points": [{"file": "c.csv", "radius_mm": 1}], "base": {"position_mm": [0, 0, 0]}},
     "anatomy.base must give one of direction and towards"),
    ({"points": [{"file": "c.csv", "radius_mm": 1, "axes": "RAS"}], "base": {"at": "x", "direction": [0, 0, 1]}},
     "'x' is not a landmark of the anatomy; it has no landmarks"),
    ({"points": [{"file": "c.csv", "radius_mm": 1, "axes": "RAS"}],
      "base": {"position_mm": [0, 0, 0], "direction": [0, 0, 0]}}, "it must point somewhere"),
]  # fmt: skip


@pytest.mark.parametrize(("written", "words"), WRONG)
def test_wrong_files_are_told_in_a_sentence(tmp_path: Path, written: dict[str, object], words: str) -> None:
    (tmp_path / "c.csv").write_text("x_mm,y_mm,z_mm\n30,0,30\n35,0,40\n")
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({"anatomy": written}))
    with pytest.raises(InputError, match=words) as error:
        load_anatomy(tmp_path / "a.yaml")
    assert len(str(error.value).splitlines()) == 1
