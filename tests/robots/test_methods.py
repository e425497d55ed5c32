"""Methods of a robot are shorthands for the functions, with joint values as one vector too."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tubeopt

ROBOT = tubeopt.load_robot("thesis_ctr")
Q = np.array([0.0, 1.0, 2.0, -0.01, -0.006, -0.002])


def test_fk_is_forward_kinematics() -> None:
    expected = tubeopt.forward_kinematics(ROBOT, Q[:3], Q[3:])
    for pose in (ROBOT.fk(Q), ROBOT.fk(Q.tolist()), ROBOT.fk(tuple(Q)), ROBOT.fk(Q[:3], Q[3:])):
        assert np.array_equal(pose.tip_position, expected.tip_position)
    home = ROBOT.fk([0, 1, 2])
    assert home.tip_position * 1e3 == pytest.approx([72.83688204, -41.40882527, 169.68901052], abs=1e-6)
    assert ROBOT.fk([0.1, 1, 2], start=home).stable


def test_the_pose_of_the_tip_is_a_rigid_motion() -> None:
    pose, result = ROBOT.tip_pose(Q), ROBOT.fk(Q)
    assert pose.shape == (4, 4)
    assert pose @ [0, 0, 0, 1] == pytest.approx([*result.tip_position, 1])
    assert pose @ [0, 0, 1, 0] == pytest.approx([*result.tip_rotation[:, 2], 0])
    assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(pose) == pytest.approx(1)
    assert np.array_equal(pose, result.tip_pose)


def test_the_geometric_jacobian_is_that_of_differences() -> None:
    matrix, step, turned = ROBOT.jacobian(Q).matrix, 1e-6, ROBOT.fk(Q).tip_rotation
    assert matrix.shape == (6, 6)
    for k, one in enumerate(step * np.eye(6)):
        change = (ROBOT.tip_pose(Q + one) - ROBOT.tip_pose(Q - one)) / (2 * step)
        spin = change[:3, :3] @ turned.T
        assert matrix[:, k] == pytest.approx([*change[:3, 3], spin[2, 1], spin[0, 2], spin[1, 0]], abs=1e-7)


def test_ik_reaches_what_fk_gives() -> None:
    solution = ROBOT.ik(ROBOT.fk(Q).tip_position)
    assert isinstance(solution, tubeopt.InverseSolution)
    tip = ROBOT.fk(solution.rotations, solution.translations).tip_position
    assert tip == pytest.approx(ROBOT.fk(Q).tip_position, abs=1e-7)


def test_pictures(tmp_path: Path) -> None:
    figure = ROBOT.plot(Q, path=tmp_path / "shape.png")
    assert (tmp_path / "shape.png").stat().st_size > 10_000
    assert type(figure) is type(ROBOT.fk(Q).plot())


@pytest.mark.parametrize(
    "call",
    [
        lambda: ROBOT.fk([0, 1]),
        lambda: ROBOT.fk("thesis"),
        lambda: ROBOT.fk([[0], [1, 2]]),
        lambda: ROBOT.fk(Q[:5]),
        lambda: ROBOT.fk([0, 1, 2, 0, 0, float("nan")]),
        lambda: ROBOT.tip_pose(None),
        lambda: ROBOT.ik([0, 1]),
        lambda: ROBOT.plot([0, 1]),
    ],
)
def test_what_makes_no_sense_is_refused(call: Callable[[], Any]) -> None:
    with pytest.raises(tubeopt.InputError):
        call()


def test_pictures_have_one_place() -> None:
    assert {"plot_shape", "plot_trajectory", "plot_workspace", "save_figure"} <= set(dir(tubeopt.plot))
    for name in dir(tubeopt.plot):
        assert callable(getattr(tubeopt.plot, name)), name
    assert tubeopt.plot.plot_shape is tubeopt.plot_shape
    with pytest.raises(AttributeError, match="no attribute 'plot_shap'"):
        _ = tubeopt.plot.plot_shap  # type: ignore[attr-defined]


def test_every_picture_is_among_them() -> None:
    folder = Path(tubeopt.__file__).parent / "show" / "plots"
    texts = "\n".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    drawn = {line.removeprefix("def ").split("(")[0] for line in texts.splitlines() if line.startswith("def plot_")}
    assert drawn <= set(dir(tubeopt.plot))
