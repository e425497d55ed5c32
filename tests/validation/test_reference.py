"""Tips relative to a reference tool in the same recording, and two tools that are no sensors of one tip."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import InputError, load_robot
from tubeopt.runs.measurement_file import load_measurements
from tubeopt.typing import Array
from tubeopt.validation import Measurements, validate

from .drives import driven, joints, robot, trivial
from .laboratory import MM
from .test_recorded import JOINTS, joint_log, mapped, table

COUNT = 60

NDI = "Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Port 2,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"


def true() -> Measurements:
    return driven(trivial(), count=COUNT, noise=0.0)


def moving(tips: Array) -> tuple[Array, Array, Rotation, Rotation]:
    """Places (N, 3) of a tip and of a reference tool, m, as a tracker sees them that is carried about, and their turns:
    the reference stays where the tips are written from, the tip's sensor turns as it likes."""
    t = np.linspace(0, 1, len(tips))[:, None]
    turn = Rotation.from_rotvec(np.hstack([0.5 * np.sin(5 * t), 0.3 * t, 0.4 * np.cos(3 * t)]))
    shift = np.hstack([0.2 + 0.05 * np.sin(7 * t), 0.1 * t, -0.3 + 0.04 * np.cos(4 * t)])
    own = Rotation.from_rotvec(np.hstack([t, 1 - t, 0.5 * t]))
    return turn.apply(tips) + shift, shift, turn * own, turn


def ndi(tmp_path: Path, tips: Array, lost: tuple[int, ...] = ()) -> None:
    position, base, turn, base_turn = moving(tips)
    lines = [NDI]
    for k in range(len(tips)):
        cells = ["2"]
        for name, p, q in (("tip", position, turn), ("spine", base, base_turn)):
            state = "MISSING" if name == "spine" and k in lost else "OK"
            pose = [f"{x:.9f}" for x in (*q[k].as_quat(scalar_first=True), *p[k] * 1e3)]
            cells += [name, str(4 * k), "0", state, *pose, "0.1"]
        lines.append(",".join(cells))
    (tmp_path / "ndi.csv").write_text("\n".join(lines))


def test_two_tools_of_a_tracker_that_moves(tmp_path: Path) -> None:
    """The error falls from tens of mm to none; both tools as sensors of the tip are remarked upon."""
    m = true()
    assert m.time is not None
    ndi(tmp_path, m.tip_position, lost=(3, 9))
    joint_log(tmp_path, np.arange(0, 330) / 53.0, float(m.time[-1]))
    text = f"tips: ndi.csv\njoints: joints.csv\nframe_rate_Hz: 40\njoint_columns: {JOINTS}\n"
    before = mapped(tmp_path, text)
    assert any("sensors 1 and 2 of the tip are" in each and "name it by reference" in each for each in before.remarks)
    assert any("have distances from" in each for each in before.remarks)
    assert validate(robot(), before).summary.mean > 5 * MM
    for name in ("2", "spine"):
        after = mapped(tmp_path, f"{text}reference: {name}\n")
        assert after.sensors.shape == (COUNT - 2, 1, 3)
        retained = np.delete(np.arange(COUNT), [3, 9])
        np.testing.assert_allclose(after.tip_position, m.tip_position[retained], atol=1e-8)
        assert after.orientation is not None
        own = moving(m.tip_position)[2:]
        np.testing.assert_allclose(after.orientation, (own[1].inv() * own[0]).as_matrix()[retained], atol=1e-7)
        assert after.remarks == ("2 of 60 rows have no pose of the reference tool and were left out",)
        assert validate(robot(), after).summary.p95 < 0.05 * MM


NOTATIONS: dict[str, tuple[str, Callable[[Rotation], Array]]] = {
    "x y z w": ("qx_1 qy_1 qz_1 qw_1", lambda turn: turn.as_quat()),
    "w x y z": ("qw_1 qx_1 qy_1 qz_1", lambda turn: -3 * turn.as_quat(scalar_first=True)),
    "rows": (" ".join(f"r{i}{j}_1" for i in "123" for j in "123"), lambda turn: turn.as_matrix().reshape(-1, 9)),
    "vector": ("rx_1 ry_1 rz_1", lambda turn: np.degrees(turn.as_rotvec())),
}


@pytest.mark.parametrize("notation", NOTATIONS)
def test_a_reference_in_a_table_of_ones_own(tmp_path: Path, notation: str) -> None:
    """Joints beside the poses; the reference is tool 1, in every notation of its orientation."""
    m = true()
    assert m.time is not None
    position, base, _, base_turn = moving(m.tip_position)
    meanings, write = NOTATIONS[notation]
    values = write(base_turn)
    names = [f"o{k}" for k in range(values.shape[1])]
    read = joints(m.time, float(m.time[-1]))
    rows = np.column_stack([m.time, np.degrees(read[:, :2]), read[:, 2:] * 1e3, base, position * 1e3, values])
    rows[5, 5:8] = np.nan
    rows[6, 11:] = np.nan
    rows[7, 8:11] = np.nan
    table(tmp_path / "own.csv", "t a b p q bx by bz x y z " + " ".join(names), rows)
    units = ", deg" if notation == "vector" else ""
    pairs = ", ".join(f"{n}: '{k}{units}'" for n, k in zip(names, meanings.split(), strict=True))
    text = "tips: own.csv\nreference: 1\ncolumns: {t: time, a: rotation_1, b: rotation_2, p: translation_1, "
    text += f"q: translation_2, bx: 'x_1, m', by: 'y_1, m', bz: 'z_1, m', x: x_2, y: y_2, z: z_2, {pairs}}}\n"
    result = mapped(tmp_path, text)
    retained = np.delete(np.arange(COUNT), [5, 6, 7])
    np.testing.assert_allclose(result.tip_position, m.tip_position[retained], atol=1e-12)
    assert result.remarks == (
        "2 of 60 rows have no pose of the reference tool and were left out",
        "1 of 60 rows have no measured position and were left out",
    )


WRONG = [
    ("reference: 3", r"reference is 3; the tools of .*ndi.csv are 1, 2, or the names tip, spine"),
    ("reference: base", r"reference is 'base'; the tools of .* are 1, 2, or the names tip, spine"),
    ("reference: 2\nbehind_mm: [0, 0]", "behind_mm has 2 numbers; there are 1 sensors"),
]


@pytest.mark.parametrize(("text", "words"), WRONG)
def test_a_reference_that_is_none(tmp_path: Path, text: str, words: str) -> None:
    m = true()
    assert m.time is not None
    ndi(tmp_path, m.tip_position)
    joint_log(tmp_path, np.arange(0, 330) / 53.0, float(m.time[-1]))
    with pytest.raises(InputError, match=words):
        mapped(tmp_path, f"tips: ndi.csv\njoints: joints.csv\nframe_rate_Hz: 40\njoint_columns: {JOINTS}\n{text}\n")


def test_a_reference_without_orientation_is_refused(tmp_path: Path) -> None:
    m = true()
    both = np.hstack([np.zeros((COUNT, 2)), m.tip_position, m.tip_position])
    table(tmp_path / "own.csv", "a b x y z u v w", both)
    columns = "{a: rotation_1, b: rotation_2, x: x_1, y: y_1, z: z_1, u: x_2, v: y_2, w: z_2}"
    with pytest.raises(InputError, match="reference is 2, which has no pose; it must have position and orientation"):
        mapped(tmp_path, f"tips: own.csv\nreference: 2\ncolumns: {columns}\n")
    with pytest.raises(InputError, match="reference is 1, which has no pose"):
        mapped(tmp_path, "tips: own.csv\nreference: 1\ncolumns: {a: rotation_1, b: rotation_2, x: x, y: y, z: z}\n")


@pytest.mark.parametrize(("apart", "shaken", "said"), [(1e-3, 0.0, False), (4e-3, 0.0, True), (1e-3, 8e-3, True)])
def test_sensors_that_cannot_be_on_one_tip_are_said(tmp_path: Path, apart: float, shaken: float, said: bool) -> None:
    """The arm is 1.5 mm thick: sensors farther apart, or whose distance changes, are not both at its tip."""
    m = true()
    assert m.time is not None
    beside = m.tip_position + np.array([apart, 0, 0]) + shaken * np.sin(m.time)[:, None] * [0, 1, 0]
    rows = np.column_stack([np.degrees(m.rotations), m.translations * 1e3, m.tip_position * 1e3, beside * 1e3])
    header = "rotation_1_deg rotation_2_deg translation_1_mm translation_2_mm x1_mm y1_mm z1_mm x2_mm y2_mm z2_mm"
    table(tmp_path / "m.csv", header, rows)
    result = load_measurements(tmp_path / "m.csv", robot())
    assert any("sensors 1 and 2 of the tip" in each for each in result.remarks) == said


def test_a_number_that_is_the_name_of_another_tool_is_refused(tmp_path: Path) -> None:
    m = true()
    assert m.time is not None
    ndi(tmp_path, m.tip_position)
    swapped = (tmp_path / "ndi.csv").read_text().replace("tip", "2").replace("spine", "1")
    (tmp_path / "ndi.csv").write_text(swapped)
    joint_log(tmp_path, np.arange(0, 330) / 53.0, float(m.time[-1]))
    text = f"tips: ndi.csv\njoints: joints.csv\nframe_rate_Hz: 40\njoint_columns: {JOINTS}\n"
    with pytest.raises(InputError, match="reference is 1, and tool 2 has that name; it must be '1' in quotes"):
        mapped(tmp_path, f"{text}reference: 1\n")
    named = mapped(tmp_path, f"{text}reference: '1'\n")
    np.testing.assert_allclose(named.tip_position, m.tip_position, atol=1e-8)
    with pytest.raises(InputError, match="reference is true; it must be the number or the name of a tool"):
        mapped(tmp_path, f"{text}reference: true\n")


def test_tools_that_are_never_seen_together_are_remarked_upon(tmp_path: Path) -> None:
    m = true()
    assert m.time is not None
    position, base, *_ = moving(m.tip_position)
    position[1::2] = base[::2] = np.nan
    read = joints(m.time, float(m.time[-1]))
    table(tmp_path / "own.csv", "t a b p q x y z u v w", np.column_stack([m.time, read, position, base]))
    columns = "t: 'time, s', a: 'rotation_1, rad', b: 'rotation_2, rad', p: 'translation_1, m', q: 'translation_2, m'"
    observed = "x: 'x_1, m', y: 'y_1, m', z: 'z_1, m', u: 'x_2, m', v: 'y_2, m', w: 'z_2, m'"
    result = mapped(tmp_path, f"tips: own.csv\ncolumns: {{{columns}, {observed}}}\n")
    assert any("sensors 1 and 2 of the tip never appear in one row" in each for each in result.remarks)


def test_noisy_sensors_within_the_thickness_of_the_arm_are_no_reference() -> None:
    """Three sensors, one in each tube of an eccentric robot, with noise of 0.6 mm."""
    robot_of = load_robot("configs/robots/thesis_etr.yaml")
    result = load_measurements("configs/experiments/synthetic_etr.csv", robot_of)
    assert result.sensors.shape[1] == 3
    assert not any("name it by reference" in each for each in result.remarks)
