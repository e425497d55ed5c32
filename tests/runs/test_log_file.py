"""Logs without a description: columns by their names, logs in pairs, clocks, quaternions, and answers to questions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import InputError
from tubeopt.runs.log_file import ReadLog, columns_by_name, paired, read_log
from tubeopt.runs.measurement_file import load_measurements
from tubeopt.typing import Array

from ..validation.drives import RATE, joints, poses, robot, trivial
from ..validation.laboratory import MM, TURN, in_device

ANSWERS = [(f"{kind}_{i}", "forward") for kind in ("rotation", "translation") for i in (1, 2)]


def table(path: Path, names: str, rows: Array) -> Path:
    """A CSV file of these columns."""
    lines = [names.replace(" ", ","), *(",".join(f"{x:.8g}" for x in row) for row in rows.tolist())]
    path.write_text("\n".join(lines) + "\n")
    return path


def way(count: int = 120) -> tuple[Array, Array, Array, Rotation]:
    """Times, joint values, tips in the device's frame, and frames of the tip there."""
    time = np.arange(count) / RATE
    values = joints(time, time[-1])
    result = poses(robot(), trivial(), values)
    tips = in_device(result.position[:, 0]) + np.random.default_rng(0).normal(0, 0.3 * MM, (count, 3))
    return time, values, tips, Rotation.from_matrix(TURN @ result.frame)


def read(*paths: Path) -> ReadLog:
    (pair,) = paired(paths, robot())
    (found,) = read_log(pair, robot(), [], ANSWERS)
    return found


def test_columns_are_known_by_usual_names(tmp_path: Path) -> None:
    path = table(
        tmp_path / "log.csv", "stamp motor1 rot_2_deg slide_1 tip_x tip_y tip_z note_1 q0 q1 q2 q3", np.ones((2, 12))
    )
    found = columns_by_name(path, robot())
    assert found.known == {
        "time": ("stamp", ""),
        "rotation_1": ("motor1", ""),
        "rotation_2": ("rot_2_deg", "deg"),
        "translation_1": ("slide_1", ""),
        "x_1": ("tip_x", ""),
        "y_1": ("tip_y", ""),
        "z_1": ("tip_z", ""),
    }
    assert found.quaternion == ("q0", "q1", "q2", "q3")
    with pytest.raises(InputError, match="columns x and tip_x both are x 1"):
        columns_by_name(table(tmp_path / "twice.csv", "x tip_x", np.ones((1, 2))), robot())


def test_logs_of_joints_and_tips_are_paired(tmp_path: Path) -> None:
    tips = table(tmp_path / "tips.csv", "time_s x y z", np.ones((2, 4)))
    drives = table(tmp_path / "drives.csv", "time_s motor_1 motor_2", np.ones((2, 3)))
    both = table(tmp_path / "both.csv", "motor_1 motor_2 x y z", np.ones((2, 5)))
    for order in ([tips, drives], [drives, tips]):
        ((first, second),) = (pair for pair in paired(order, robot()) if not isinstance(pair, Path))
        assert (first.path, second.path) == (tips, drives)
    assert len(paired([both, tips, drives, both], robot())) == 3
    with pytest.raises(InputError, match=r"tips.csv has positions and no rotations; give the log of rotations"):
        paired([both, tips], robot())
    with pytest.raises(InputError, match=r"both have rotations and no positions; give them in pairs"):
        paired([drives, drives], robot())
    other = table(tmp_path / "other.csv", "a b", np.ones((1, 2)))
    with pytest.raises(InputError, match=r"no column is named rotation_1 or x; its columns are a, b"):
        paired([other], robot())
    alone = table(tmp_path / "alone.csv", "motor_1 x y z", np.ones((1, 4)))
    with pytest.raises(InputError, match=r"no column is named rotation_2; the robot has 2 tubes"):
        paired([alone], robot())


@pytest.mark.parametrize(("order", "inverted"), [("wxyz", False), ("xyzw", True)])
def test_a_quaternion_is_read_in_its_order(tmp_path: Path, order: str, inverted: bool) -> None:
    time, values, tips, frames = way()
    written = (frames.inv() if inverted else frames).as_quat(scalar_first=order == "wxyz")
    rows = np.column_stack([1e6 * time, np.degrees(values[:, :2]), values[:, 2:] / MM, tips / MM, written])
    found = read(table(tmp_path / "log.csv", "t rot1 rot2 trans1 trans2 x y z q1 q2 q3 q4", rows))
    m = found.measurements
    assert m.orientation is not None
    np.testing.assert_allclose(m.orientation, frames.as_matrix(), atol=1e-6)
    assert m.time is not None
    np.testing.assert_allclose(m.time, time, atol=1e-6)  # microseconds
    np.testing.assert_allclose(m.rotations, values[:, :2], atol=1e-6)
    np.testing.assert_allclose(m.translations, values[:, 2:], atol=1e-8)
    # The file that describes this reading gives it again.
    (tmp_path / "map.yaml").write_text(found.text(tmp_path))
    again = load_measurements(tmp_path / "map.yaml", robot())
    np.testing.assert_array_equal(again.rotations, m.rotations)
    np.testing.assert_array_equal(again.orientation, m.orientation)


def test_a_wrong_unit_in_a_name_is_found(tmp_path: Path) -> None:
    time, values, tips, _ = way()
    rows = np.column_stack([time, np.degrees(values[:, :2]), values[:, 2:], tips / MM])
    names = "time_s rotation_1_deg rotation_2_deg translation_1_mm translation_2_mm x_m y_m z_m"
    found = read(table(tmp_path / "log.csv", names, rows))
    chosen = {d.about: d.chosen for d in found.every_decision}
    assert (chosen["translations"], chosen["positions"]) == ("m", "mm")
    np.testing.assert_allclose(found.measurements.translations, values[:, 2:], atol=1e-8)
    np.testing.assert_allclose(found.measurements.tip_position, tips, atol=1e-8)


def test_a_question_names_both_readings(tmp_path: Path) -> None:
    time, values, _, _ = way()
    values[:, 3] = 0.012
    result = poses(robot(), trivial(), values)
    rows = np.column_stack([time, values[:, :2], values[:, 2:] / MM, in_device(result.position[:, 0])])
    path = table(tmp_path / "log.csv", "t motor_1 motor_2 slide_1 slide_2 x y z", rows)
    (pair,) = paired([path], robot())
    question = re.escape(
        "log.csv: is translation_2 forward or reversed? It does not move. Answer by --answer translation_2=forward or "
        "--answer translation_2=reversed"
    )
    with pytest.raises(InputError, match=question):
        read_log(pair, robot(), [], ANSWERS[:3])
    (found,) = read_log(pair, robot(), [], ANSWERS)
    assert found.measurements.translations[0, 1] == pytest.approx(0.012, abs=2 * MM)
