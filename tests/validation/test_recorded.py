"""Data as labs record them: columns mapped by YAML, joints apart, orientations, exports of trackers, doubtful units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import InputError
from tubeopt.files.csv_file import to_csv
from tubeopt.runs.measurement_file import load_measurements, save_measurements
from tubeopt.runs.recorded_table import columns_of, read_recorded
from tubeopt.validation import Measurements, validate

from .drives import driven, joints, robot, trivial
from .laboratory import MM


def mapped(tmp_path: Path, text: str) -> Measurements:
    path = tmp_path / "map.yaml"
    path.write_text("kind: measurements\n" + text, encoding="utf-8")
    return load_measurements(path, robot())


def table(path: Path, columns: str, rows: np.ndarray) -> None:
    path.write_text(to_csv(columns.split(), [["" if np.isnan(x) else repr(x) for x in row] for row in rows.tolist()]))


JOINTS = "{tin: 'time, ms', a: '-rotation_1, rad', b: 'rotation_2, deg', p: 'translation_1, mm', q: 'translation_2, m'}"


def joint_log(tmp_path: Path, time: np.ndarray, last: float) -> None:
    read = joints(time, last)
    units = np.array([-1.0, 180 / np.pi, 1e3, 1.0])
    table(tmp_path / "joints.csv", "tin a b p q", np.column_stack([time * 1e3, read * units]))


def test_joints_and_tips_at_rates_of_their_own(tmp_path: Path) -> None:
    m = driven(trivial(), count=120, noise=0.0)
    assert m.time is not None
    joint_log(tmp_path, np.arange(-20, 660) / 53.0, float(m.time[-1]))
    tips = np.column_stack([m.time * 1e6, m.tip_position, m.tip_position])
    tips[3, 1:4], tips[4, 1:] = np.nan, np.nan
    table(tmp_path / "tips.csv", "stamp x y z u v w", tips)
    text = "tips: tips.csv\njoints: joints.csv\nbehind_mm: [0, 0]\ncolumns: {stamp: 'time, us', "
    text += f"x: 'x_1, m', y: 'y_1, m', z: 'z_1, m', u: 'x_2, m', v: 'y_2, m', w: 'z_2, m'}}\njoint_columns: {JOINTS}\n"
    result = mapped(tmp_path, text)
    assert result.log is not None
    assert len(result) == 119
    assert "1 of 120 rows have no measured position and were left out" in result.remarks
    assert "1 of 119 rows have no position of sensor 1" in result.remarks
    retained = np.delete(np.arange(120), 4)[:55]
    np.testing.assert_allclose(result.rotations[:55], m.rotations[retained], atol=2e-5)
    assert validate(robot(), result).summary.p95 < 0.01 * MM


def test_rows_beyond_the_log_of_the_joints_are_left_out(tmp_path: Path) -> None:
    m = driven(trivial(), count=100, noise=0.0)
    assert m.time is not None
    table(tmp_path / "tips.csv", "t x y z", np.column_stack([m.time, m.tip_position * 1e3]))
    text = f"tips: tips.csv\njoints: joints.csv\ncolumns: {{t: time, x: x, y: y, z: z}}\njoint_columns: {JOINTS}\n"
    joint_log(tmp_path, np.arange(25, 76) / 10.0, float(m.time[-1]))
    result = mapped(tmp_path, text)
    assert len(result) == 51
    assert result.remarks[0] == "49 of 100 rows lie before or after all joint readings and were left out"
    joint_log(tmp_path, np.arange(1000, 1010) / 10.0, float(m.time[-1]))
    with pytest.raises(InputError, match="have no time in common"):
        mapped(tmp_path, text)


def test_a_pose_in_every_notation_is_the_same(tmp_path: Path) -> None:
    m = driven(trivial(), count=12, noise=0.0)
    frames = Rotation.random(12, random_state=3)
    matrix = frames.as_matrix()
    base = np.column_stack([np.degrees(m.rotations), m.tip_position * 1e3])
    notations = {
        "w x y z": (frames.as_quat(scalar_first=True), "qw qx qy qz", ""),
        "x y z w": (frames.as_quat(), "qx qy qz qw", ""),
        "r1 r2 r3": (np.degrees(frames.as_rotvec()), "rx ry rz", ", deg"),
        "m1 m2 m3 m4 m5 m6 m7 m8 m9": (
            matrix.reshape(12, 9),
            " ".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)),
            "",
        ),
        "z1 z2 z3 x1 x2 x3": (
            np.hstack([matrix[:, :, 2] * 5, matrix[:, :, 0] + 0.3 * matrix[:, :, 2]]),
            "zaxis_x zaxis_y zaxis_z xaxis_x xaxis_y xaxis_z",
            "",
        ),
    }
    for columns, (values, meanings, unit) in notations.items():
        names = [f"o{name}" for name in columns.split()]
        rows = np.column_stack([base, values])
        rows[2, 5:] = np.nan
        table(tmp_path / "tips.csv", "a b px py pz " + " ".join(names), rows)
        pairs = ", ".join(f"{n}: '{k}{unit}'" for n, k in zip(names, meanings.split(), strict=True))
        text = "tips: tips.csv\naxis: -y\ncolumns: {a: rotation_1, b: rotation_2, px: x, py: y, pz: z, " + pairs + "}\n"
        result = mapped(tmp_path, text)
        assert result.orientation is not None
        assert np.isnan(result.orientation[2]).all()
        np.testing.assert_allclose(np.delete(result.orientation, 2, 0), np.delete(matrix, 2, 0), atol=1e-12)
        assert result.sensor_axis is not None
        np.testing.assert_array_equal(result.sensor_axis, [0, -1, 0])


def test_joints_beside_the_tools_of_an_export_are_asked_for_apart(tmp_path: Path) -> None:
    (tmp_path / "ndi.csv").write_text("Tools,Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,j1,j2\nA,1,OK,1,0,0,0,1,2,3,10,20\n")
    with pytest.raises(InputError, match=r"map.yaml: joints is missing; the tracker export ndi.csv has no joint"):
        mapped(tmp_path, "tips: ndi.csv\nframe_rate_Hz: 40\ncolumns: {j1: 'rotation_1, deg', j2: 'rotation_2, deg'}\n")


def test_an_export_of_ndi(tmp_path: Path) -> None:
    m = driven(trivial(), count=30, noise=0.0)
    assert m.time is not None
    lines = [
        "Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Port 2,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"
    ]
    for k, tip in enumerate(m.tip_position * 1e3):
        pose = f"1,0,0,0,{tip[0]:.6f},{tip[1]:.6f},{tip[2]:.6f},0.1"
        lines.append(f"2,A,{4 * k},0,{'OK' if k != 7 else 'MISSING'},{pose},B,{4 * k},0,OK,{pose}")
    (tmp_path / "ndi.csv").write_text("\n".join(lines))
    joint_log(tmp_path, np.arange(0, 160) / 53.0, float(m.time[-1]))
    text = f"tips: ndi.csv\njoints: joints.csv\nframe_rate_Hz: 40\njoint_columns: {JOINTS}\n"
    result = mapped(tmp_path, text)
    assert result.sensors.shape == (30, 2, 3)
    np.testing.assert_allclose(result.time, m.time)
    assert np.argwhere(np.isnan(result.sensors[:, :, 0])).tolist() == [[7, 0]]
    np.testing.assert_allclose(result.tip_position, m.tip_position, atol=1e-8)
    assert result.orientation is not None


@pytest.mark.parametrize("names", ["Rz,Ry,Rx", "Rx,Ry,Rz"])
def test_an_export_of_ndi_with_euler_angles(tmp_path: Path, names: str) -> None:
    """NDI turns about the axes of the tool: R = Rz Ry Rx, in degrees."""
    angles = np.random.default_rng(3).uniform([-180, -89, -180], [180, 89, 180], (4, 3))  # of z, y, x
    lines = [f"Tools,Port 1,Frame,State,{names},Tx,Ty,Tz,Error"]
    for k, turn in enumerate(angles.tolist()):
        written = turn if names.startswith("Rz") else turn[::-1]
        lines.append(f"1,A,{k},{'MISSING' if k == 2 else 'OK'},{','.join(map(repr, written))},1,2,3,0.1")
    (tmp_path / "ndi.csv").write_text("\n".join(lines))
    read = read_recorded(tmp_path / "ndi.csv", 40.0)
    assert read.table.columns == ("time", "qw_1", "qx_1", "qy_1", "qz_1", "x_1", "y_1", "z_1")
    assert read.table.rows[2][1:] == ("",) * 7
    for k in (0, 1, 3):
        z, y, x = np.radians(angles[k])
        about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
        about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
        about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
        w, *v = map(float, read.table.rows[k][1:5])
        np.testing.assert_allclose(
            Rotation.from_quat([*v, w]).as_matrix(), np.array(about_z) @ about_y @ about_x, atol=1e-12
        )
        assert read.table.rows[k][5:] == ("1", "2", "3")


NDI_ROW = "Tools,Port 1,Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz\n1,A,4,OK,1,0,0,0,1.5,-2.25,130\n"
"""A tool at (1.5, -2.25, 130) mm."""

NDI_UNITS = NDI_ROW.replace("Tx,Ty,Tz", "Tx (mm),Ty (mm),Tz (mm)")


@pytest.mark.parametrize(
    "text",
    [
        NDI_UNITS,
        NDI_UNITS.replace(",", ";"),
        NDI_UNITS.replace(",", ";").replace(".", ","),
        NDI_UNITS.replace(",", "\t").replace(".", ","),
        NDI_ROW.replace("Tx,Ty,Tz", "Tx [m],Ty [m],Tz [m]").replace("1.5,-2.25,130", "0.0015,-0.00225,0.13"),
        "\ufeff" + NDI_UNITS,
    ],
    ids=["units", "semicolons", "decimal commas", "tabs", "metres", "mark"],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_an_ndi_export_in_other_notations(text: str, encoding: str, tmp_path: Path) -> None:
    (tmp_path / "ndi.csv").write_text(text, encoding=encoding)
    read = read_recorded(tmp_path / "ndi.csv", 40.0)
    columns = columns_of(read.table, read.meaning, "ndi.csv", [0.0])
    np.testing.assert_allclose(columns.positions()[0, 0], [1.5e-3, -2.25e-3, 0.13], rtol=1e-15)
    np.testing.assert_allclose(columns.time(), [0.1], rtol=1e-15)


def test_euler_angles_of_ndi_in_rad(tmp_path: Path) -> None:
    text = "Tools,Port 1,Frame,State,Rz (rad),Ry (rad),Rx (rad),Tx,Ty,Tz\n1,A,0,OK,0.5,0,0,1,2,3\n"
    (tmp_path / "ndi.csv").write_text(text)
    row = read_recorded(tmp_path / "ndi.csv", 40.0).table.rows[0]
    np.testing.assert_allclose([float(cell) for cell in row[1:5]], [np.cos(0.25), 0, 0, np.sin(0.25)], atol=1e-15)


@pytest.mark.parametrize("titles", ["Tx (inch),Ty (inch),Tz (inch)", "Tx (mm),Ty (mm),Tz (m)", "Tx (mm),Ty,Tz"])
def test_units_of_an_ndi_export_that_are_not_lengths_or_differ(titles: str, tmp_path: Path) -> None:
    (tmp_path / "ndi.csv").write_text(NDI_ROW.replace("Tx,Ty,Tz", titles))
    with pytest.raises(InputError, match=r"ndi.csv: the NDI export has columns Tx .*; all must have one unit of mm, m"):
        read_recorded(tmp_path / "ndi.csv", 40.0)


def test_an_export_of_optitrack(tmp_path: Path) -> None:
    m = driven(trivial(), count=30, noise=0.0)
    assert m.time is not None
    bodies = ["tip"] * 8 + ["base:Marker1"] * 3
    lines = [
        "Format Version,1.23,Take Name,x,Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global",
        "",
        ",," + ",".join(["Rigid Body"] * 8 + ["Rigid Body Marker"] * 3),
        ",Name," + ",".join(bodies),
        ",ID," + ",".join(["1"] * 11),
        ",," + ",".join(["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"] + ["Position"] * 3),
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z",
    ]
    for k, (t, tip) in enumerate(zip(m.time, m.tip_position, strict=True)):
        pose = ",,,,,,," if k == 4 else f"0,0,0,1,{tip[0]!r},{tip[1]!r},{tip[2]!r},0.001"
        lines.append(f"{k},{t!r},{pose},0,0,0".replace("np.float64(", "").replace(")", ""))
    (tmp_path / "take.csv").write_text("\n".join(lines))
    joint_log(tmp_path, np.arange(0, 160) / 53.0, float(m.time[-1]))
    result = mapped(tmp_path, f"tips: take.csv\njoints: joints.csv\njoint_columns: {JOINTS}\n")
    assert len(result) == 29
    np.testing.assert_allclose(result.tip_position, np.delete(m.tip_position, 4, 0))
    assert result.orientation is not None
    np.testing.assert_allclose(result.orientation[0], np.eye(3))


def one_tool(tmp_path: Path, row: dict[int, str], between: str = ",") -> Measurements:
    """30 rows of one NDI tool, of which the sixth has other cells."""
    m = driven(trivial(), count=30, noise=0.0)
    assert m.time is not None
    lines = ["Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz"]
    for k, tip in enumerate(m.tip_position * 1e3):
        cells = ["1", "A", str(4 * k), "0", "OK", "1", "0", "0", "0", *(f"{x:.6f}" for x in tip)]
        lines.append(",".join(row.get(j, cell) if k == 5 else cell for j, cell in enumerate(cells)))
    (tmp_path / "ndi.csv").write_text("\n".join(lines).replace(",", between))
    joint_log(tmp_path, np.arange(0, 160) / 53.0, float(m.time[-1]))
    return mapped(tmp_path, f"tips: ndi.csv\njoints: joints.csv\nframe_rate_Hz: 40\njoint_columns: {JOINTS}\n")


@pytest.mark.parametrize("missing", ["-3.697314E+28", "MISSING", "NaN", "0"])
def test_what_an_ndi_tool_does_not_see_is_no_position(tmp_path: Path, missing: str) -> None:
    assert one_tool(tmp_path, dict.fromkeys(range(5, 12), missing)).remarks[0].startswith("1 of 30 rows have no")


def test_an_ndi_export_that_a_spreadsheet_has_touched(tmp_path: Path) -> None:
    np.testing.assert_array_equal(one_tool(tmp_path, {2: "20.0"}, "\t").sensors, one_tool(tmp_path, {}).sensors)
    assert "has the time of the row before" in one_tool(tmp_path, {2: "16"}).remarks[0]
    assert "goes back from 0.400 to 0.300 s" in one_tool(tmp_path, {2: "12"}).remarks[0]
    with pytest.raises(InputError, match=r"line 7, column Frame is 'x'; it must be a whole number"):
        one_tool(tmp_path, {2: "x"})


# --- what cannot be right ---------------------------------------------------------------------------------------------


def test_wrapped_angles_are_unwrapped_and_said(tmp_path: Path) -> None:
    m = driven(trivial(), count=60)
    turning = m.rotations + np.linspace(0, 12, 60)[:, None] * [1.0, 0.0]
    wrapped = np.column_stack([np.mod(turning[:, 0] + np.pi, 2 * np.pi) - np.pi, turning[:, 1]])
    table(
        tmp_path / "m.csv",
        "time_s rotation_1_deg rotation_2_deg x_mm y_mm z_mm",
        np.column_stack([m.time, np.degrees(wrapped), m.tip_position * 1e3]),
    )
    result = load_measurements(tmp_path / "m.csv", robot())
    apart = result.rotations[:, 0] - turning[:, 0]
    np.testing.assert_allclose(apart, apart[0], atol=1e-9)
    assert result.remarks[0].startswith("rotation_1 jumps by a full turn 2 times")


@pytest.mark.parametrize(
    ("joint_unit", "tip_unit", "word"),
    [
        (1.0, 1e3, "are they in rad, in a column that says deg"),
        (180 / np.pi, 1.0, "Are positions in m in columns for mm"),
        (180 / np.pi, 1e6, "Are positions in mm in columns for m"),
    ],
)
def test_units_that_cannot_be_right_are_said(tmp_path: Path, joint_unit: float, tip_unit: float, word: str) -> None:
    m = driven(trivial(), count=30)
    rows = np.column_stack([m.rotations * joint_unit, m.tip_position * tip_unit])
    table(tmp_path / "m.csv", "rotation_1_deg rotation_2_deg x_mm y_mm z_mm", rows)
    assert any(word in remark for remark in load_measurements(tmp_path / "m.csv", robot()).remarks)


@pytest.mark.parametrize(
    ("time_unit", "shuffled", "said"), [(1e3, False, True), (1.0, False, False), (1e3, True, False)]
)
def test_times_in_ms_along_a_path_are_said(tmp_path: Path, time_unit: float, shuffled: bool, said: bool) -> None:
    m = driven(trivial(), count=120)
    assert m.time is not None
    order = np.random.default_rng(0).permutation(120) if shuffled else np.arange(120)
    rows = np.column_stack([m.time * time_unit, np.degrees(m.rotations[order]), m.tip_position[order] * 1e3])
    table(tmp_path / "m.csv", "time_s rotation_1_deg rotation_2_deg x_mm y_mm z_mm", rows)
    remarks = load_measurements(tmp_path / "m.csv", robot()).remarks
    assert any("are times in ms" in remark for remark in remarks) == said


def test_a_way_is_saved_with_its_times_and_directions(tmp_path: Path) -> None:
    m = driven(count=20)
    frames = Rotation.random(20, random_state=1).as_matrix()
    frames[3] = np.nan
    saved = Measurements(m.rotations, m.translations, m.sensors, time=m.time, orientation=frames)
    save_measurements(saved, tmp_path / "m.csv")
    again = load_measurements(tmp_path / "m.csv", robot())
    np.testing.assert_array_equal(again.time, m.time)
    assert again.orientation is not None
    np.testing.assert_allclose(again.orientation, frames, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("tips: t.csv\ncolumns: {a: rotation_9}", "columns.a is 'rotation_9'; the robot has 2 tubes"),
        ("tips: t.csv\ncolumns: {a: 'rotation_1, mm'}", "the unit of rotation_1 is 'mm'; it must be deg, rad, turn"),
        ("tips: t.csv\ncolumns: {a: turning}", "columns.a is 'turning'; it must be one of time, rotation_I"),
        ("tips: t.csv\ncolumns: {c: rotation_1}", "has no column c"),
        ("tips: t.csv\ncolumns: {a: rotation_1}", "no column contains rotation_2"),
        ("tips: none.csv", "none.csv: there is no such file"),
    ],
)
def test_maps_that_make_no_sense(tmp_path: Path, text: str, problem: str) -> None:
    table(tmp_path / "t.csv", "a b", np.zeros((2, 2)))
    with pytest.raises(InputError) as caught:
        mapped(tmp_path, text + "\n")
    assert problem in str(caught.value)


def test_formulas_have_factors_constants_sums_and_home(tmp_path: Path) -> None:
    """A differential drive, an absolute carriage, and a column with a minus in its name."""
    m = driven(trivial(), count=20, noise=0.0)
    (a, b), (p, q) = np.degrees(m.rotations).T, m.translations.T * 1e3
    held = -np.array([tube.straight_length for tube in robot().tubes]) * 1e3
    rows = np.column_stack([2 * (a - b - 12.5), b, p + held[0], (7 - q) / 1.25, m.tip_position * 1e3])
    table(tmp_path / "tips.csv", "motor-1 m2 s s2 x y z", rows)
    text = "tips: tips.csv\ncolumns: {m2: 'rotation_2, deg', x: x_1, y: y_1, z: z_1}\nformulas:\n"
    good = "  rotation_1: 0.5 * motor-1 + m2 + 12.5, deg\n  translation_1: s - home, mm\n"
    good += "  translation_2: -1.25*s2 + 7, mm\n"
    result = mapped(tmp_path, text + good)
    np.testing.assert_allclose(result.rotations, m.rotations, atol=1e-12)
    np.testing.assert_allclose(result.translations, m.translations, atol=1e-12)
    for wrong, problem in (
        ("rotation_1: 0.5 * motor, deg", "'0.5 \\* motor' cannot be read.*a sum of columns"),
        ("rotation_1: motor-1 - home, deg", "'- home' cannot be read"),
        ("rotation_1: 12.5, deg", "must name a column"),
        ("rotation_1: motor-1", "must end with a comma and deg, rad, turn"),
        ("rotation_2: motor-1, deg", "rotation_2 is column m2 already"),
        ("rotation_3: motor-1, deg", "rotation or translation of 2 tubes"),
    ):
        with pytest.raises(InputError, match=problem):
            mapped(tmp_path, f"{text}  {wrong}\n")
