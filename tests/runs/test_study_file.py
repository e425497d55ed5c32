"""Studies as YAML: read, checked together with their robot, and run."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from tubeopt.equilibrium.kinematics import METHODS
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.errors import InputError
from tubeopt.runs.study_file import STUDY_KINDS, load_study

CONFIGS = Path(__file__).parents[2] / "configs"
STUDY = f"kind: forward_kinematics\nrobot: {CONFIGS}/robots/thesis_ctr.yaml\n"


def test_the_example_finds_the_thesis_robot_and_its_shape() -> None:
    equilibrium = load_study(CONFIGS / "studies" / "thesis_actuated.yaml").run()
    assert isinstance(equilibrium, Equilibrium)
    assert equilibrium.rotations.tolist() == [0, 1, 2]
    np.testing.assert_allclose(equilibrium.tip_position * 1e3, [72.83688204, -41.40882527, 169.68901052], atol=1e-5)
    assert equilibrium.margin == pytest.approx(1, abs=1e-4)
    assert equilibrium.verification is not None


def test_without_joint_values_the_robot_is_at_home(tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    equilibrium = load_study(path).run()
    np.testing.assert_allclose(equilibrium.tip_position * 1e3, [0, -90.75837047, 164.83462233], atol=1e-5)


def test_the_methods_are_those_of_forward_kinematics() -> None:
    assert get_args(STUDY_KINDS["forward_kinematics"].model_fields["method"].annotation) == METHODS


def problems(path: Path, text: str) -> list[str]:
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_study(path)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ("rotations_deg: [1, 2]", "rotations_deg has 2 numbers; it must be 3 (one per tube)"),
        ("translations_mm: [1]", "translations_mm has 1 number; it must be 3 (one per tube)"),
        ("rotations_deg: [1, 2, x]", "rotations_deg[2] is 'x'; it must be a number"),
        ("rotations_deg: 3", "rotations_deg is 3; it must be a list"),
        ("translations_mm: [0, 0, .nan]", "translations_mm[2] is NaN; it must be a finite number"),
        ("method: newtn", "method is 'newtn'; it must be newton, ipopt or energy; did you mean 'newton'?"),
        ("tolerance_rad: 0", "tolerance_rad is 0; it must be greater than 0"),
        ("verify: 1", "verify is 1; it must be true or false"),
        ("rotation_deg: [1, 2, 3]", "rotation_deg is not a known key; did you mean 'rotations_deg'?"),
    ],
)
def test_each_problem_has_its_sentence(tmp_path: Path, more: str, problem: str) -> None:
    assert problems(tmp_path / "x.yaml", f"{STUDY}{more}\n") == [problem]


def test_all_problems_at_once_those_of_the_robot_included(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("kind: concentric\nnam: x\ntubes: [3]\n")
    text = "kind: forward_kinematics\nrobot: robot.yaml\nmethod: x\nrotations_deg: [a]\n"
    assert problems(tmp_path / "x.yaml", text) == [
        f"robot: {tmp_path}/robot.yaml: tubes[0] is 3; it must be a mapping of keys to values",
        f"robot: {tmp_path}/robot.yaml: nam is not a known key; did you mean 'name'?",
        "rotations_deg[0] is 'a'; it must be a number",
        "method is 'x'; it must be newton, ipopt or energy",
    ]


def test_the_robot_is_named_by_a_path(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    assert problems(path, "kind: forward_kinematics\n") == ["robot is missing"]
    assert problems(path, "kind: forward_kinematics\nrobot: 3\n") == ["robot is 3; it must be the path of a robot file"]
    assert problems(path, "kind: forward_kinematics\nrobot: none.yaml\n") == [
        f"robot: {tmp_path}/none.yaml: there is no such file"
    ]


def test_an_unknown_kind(tmp_path: Path) -> None:
    kinds = list(STUDY_KINDS)
    assert problems(tmp_path / "x.yaml", "kind: forward_kinematic\n") == [
        f"kind is 'forward_kinematic'; it must be {', '.join(kinds[:-1])} or {kinds[-1]}; "
        "did you mean 'forward_kinematics'?"
    ]
