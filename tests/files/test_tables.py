"""Tables as other programs write them are read right, or refused in a sentence that names what the file is."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

import tubeopt
from tubeopt import InputError
from tubeopt.bodies.corridors import load_points
from tubeopt.files.csv_file import read_csv
from tubeopt.robots.file import load_waypoints
from tubeopt.runs.inverse_study import load_targets
from tubeopt.runs.measurement_file import load_measurements
from tubeopt.runs.surroundings_file import load_landmarks
from tubeopt.runs.workshop_file import load_heating_log, load_trials

PLAIN = "x_mm,y_mm,z_mm\n10.5,-20.25,150\n0,1e1,140.125\n"
MM = np.array([[10.5, -20.25, 150.0], [0.0, 10.0, 140.125]])
COMMAS = PLAIN.replace(",", ";").replace(".", ",")
ROBOT = tubeopt.load_robot("two_tube")


def workbook() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    return out.getvalue()


READ = {
    "as tubeopt writes it": PLAIN.encode(),
    "semicolons": PLAIN.replace(",", ";").encode(),
    "semicolons, decimal commas": COMMAS.encode(),
    "tabs": PLAIN.replace(",", "\t").encode(),
    "tabs, decimal commas": COMMAS.replace(";", "\t").encode(),
    "blanks": PLAIN.replace(",", "  ").encode(),
    "a line that names the separator": ("sep=;\n" + COMMAS).encode(),
    "trailing commas": PLAIN.replace("\n", ",\n").encode(),
    "trailing semicolons in the rows alone": COMMAS.replace("\n", ";;\n").replace("z_mm;;", "z_mm").encode(),
    "a mark of UTF-8": PLAIN.encode("utf-8-sig"),
    "UTF-16 with a mark": PLAIN.encode("utf-16"),
    "UTF-16, the high byte first": b"\xfe\xff" + PLAIN.encode("utf-16-be"),
    "UTF-16 without a mark": PLAIN.encode("utf-16-le"),
    "Latin-1": ("# gemessen am Gerät 3\n" + PLAIN).encode("latin-1"),
    "CR": PLAIN.replace("\n", "\r").encode(),
    "CRLF": PLAIN.replace("\n", "\r\n").encode(),
    "no last line end": PLAIN.rstrip().encode(),
    "quotes": b'"x_mm","y_mm","z_mm"\n"10.5","-20.25","150"\n"0","1e1","140.125"\n',
    "other names": PLAIN.replace("x_mm,y_mm,z_mm", "Tip X [mm],Tip Y [mm],Tip Z [mm]").encode(),
    "metres": b"pos_x_m,pos_y_m,pos_z_m\n0.0105,-0.02025,0.15\n0,0.01,0.140125\n",
    "centimetres": b"x (cm);y (cm);z (cm)\n1,05;-2,025;15\n0;1;14,0125\n",
}
"""21 variants of the same table."""


@pytest.mark.parametrize("variant", READ)
def test_variants_are_read_right(variant: str, tmp_path: Path) -> None:
    path = tmp_path / "targets.csv"
    path.write_bytes(READ[variant])
    np.testing.assert_array_equal(load_targets(path).position, np.vectorize(_si)(MM))


def _si(value: float) -> float:
    """mm in m, rounded once."""
    return float(f"{value:.12g}e-3")


REFUSED = {
    "an Excel workbook": (workbook(), "Excel workbook"),
    "JSON": (b'{"x_mm": [1]}', "JSON file"),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0", "picture"),
    "bytes": (bytes(range(256)), "binary file"),
    "commas for decimals and cells": (PLAIN.replace(".", ",").replace("0,1e1", "0,5,1,5").encode(), "decimal commas"),
    "commas and points": (b"x_mm;y_mm;z_mm\n1,5;2.5;3\n", "decimal comma"),
    "no units": (b"x,y,z\n1,2,3\n", "x has no unit"),
}


@pytest.mark.parametrize("variant", REFUSED)
def test_what_cannot_be_read_is_named(variant: str, tmp_path: Path) -> None:
    content, text = REFUSED[variant]
    path = tmp_path / "targets.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=text):
        load_targets(path)


def test_joint_values_by_other_names_and_units(tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    header = "alpha1 [rad];Alpha 2 (\N{DEGREE SIGN});trans_1_m;translation_2_cm"
    path.write_text(f"{header}\n0,5;90;-0,01;-0,5\n", encoding="utf-8")
    read = load_waypoints(path, ROBOT)
    np.testing.assert_allclose(read.rotations, [[0.5, np.pi / 2]], rtol=1e-15)
    np.testing.assert_allclose(read.translations, [[-0.01, -0.005]], rtol=1e-15)


def test_measurements_are_read_by_the_same_rules(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    header = "rotation_1_deg;rotation_2_deg;tip_x_m;tip_y_m;tip_z_m"
    path.write_text(f"{header}\n10,5;0;0,001;0,002;0,15\n", encoding="utf-16")
    read = load_measurements(path, ROBOT)
    np.testing.assert_allclose(np.ravel(read.sensors), [0.001, 0.002, 0.15], rtol=1e-15)


def test_heating_logs_are_read_by_the_same_rules(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    header = "Time [ms];PWM;Temp [\N{DEGREE SIGN}C];U (mV);Current_mA;temperature_-20_mm_degC"
    path.write_text(
        f"{header}\n0;10;25,5;1250;2000;24\n500;12;30;1300;;25,5\n1000;12;31;1300;;26\n", encoding="latin-1"
    )
    log = load_heating_log(path)
    assert log.voltage is not None
    assert log.current is not None
    assert log.temperature is not None
    np.testing.assert_array_equal(log.time, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(log.duty, [10, 12, 12])
    np.testing.assert_allclose(log.temperature - 273.15, [[25.5, 24.0], [30.0, 25.5], [31.0, 26.0]], atol=1e-12)
    np.testing.assert_array_equal(log.voltage, [1.25, 1.3, 1.3])
    np.testing.assert_array_equal(log.current, [2.0, np.nan, np.nan])
    path.write_text("time_s,duty,temp\n0,10,25\n", encoding="utf-8")
    with pytest.raises(InputError, match="column temp has no unit; call it temperature_degC"):
        load_heating_log(path)


@pytest.mark.parametrize("column", ["temperature_K", "Temp [K]", "temperature (Kelvin)"])
def test_temperatures_in_kelvin(column: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"time_s,duty,{column}\n0,10,298.15\n1,10,300\n2,10,301\n", encoding="utf-8")
    np.testing.assert_allclose(load_heating_log(path).temperature, [298.15, 300.0, 301.0], rtol=1e-15)


def robot_of_pieces(folder: Path) -> Path:
    """A robot of one tube whose only piece is piece.csv."""
    tube = "{outer_diameter_mm: 1, inner_diameter_mm: 0.8, straight_length_mm: 10, pieces: [{table: piece.csv}]}"
    (folder / "robot.yaml").write_text(f"kind: concentric\ntubes: [{tube}]\n")
    return folder / "robot.yaml"


PIECE = "arc_length_mm,curvature_x_per_m,curvature_y_per_m\n0,5,-1.5\n40,7.5,0\n"


@pytest.mark.parametrize(
    "text",
    [
        PIECE,
        "s_m;u_x_per_m;u_y_per_m\n0;5;-1,5\n0,04;7,5;0\n",
        "s [cm]\tkappa_x [1/mm]\tkappa_y [1/mm]\n0\t0.005\t-0.0015\n4\t0.0075\t0\n",
    ],
    ids=["own names", "metres", "1/mm"],
)
def test_tables_of_pieces_are_read_by_the_same_rules(text: str, tmp_path: Path) -> None:
    tubes = []
    for content in (text, PIECE):
        (tmp_path / "piece.csv").write_text(content, encoding="utf-8")
        tubes.append(tubeopt.load_robot(robot_of_pieces(tmp_path)).tubes[0])
    read, right = tubes
    np.testing.assert_allclose(read.pieces[0].length, 0.04, rtol=1e-15)
    np.testing.assert_allclose(read.pieces[0].largest_curvature, 7.5, rtol=1e-12)
    assert read == right


def test_a_table_of_a_piece_in_no_known_unit_is_refused(tmp_path: Path) -> None:
    (tmp_path / "piece.csv").write_text(PIECE.replace("arc_length_mm", "arc_length"), encoding="utf-8")
    with pytest.raises(InputError, match=r"piece\.csv: column arc_length has no unit; call it arc_length_mm"):
        tubeopt.load_robot(robot_of_pieces(tmp_path))


def test_trials_are_read_by_the_same_rules(tmp_path: Path) -> None:
    path = tmp_path / "trials.csv"
    path.write_text("Mold radius [cm];obtained radius (mm);Note\n1,5;16,25;first\n", encoding="utf-8")
    result = load_trials(path)
    np.testing.assert_allclose([result.mold_radius, result.obtained_radius], [[0.015], [0.01625]], rtol=1e-15)


def test_landmarks_and_clouds_are_read_by_the_same_rules(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("# SPACE=LPS\nname;X [cm];pos_y_mm;z_m\ncarina;1,5;-2;0,1\n", encoding="utf-8")
    np.testing.assert_allclose(load_landmarks(path)["carina"], [-0.015, 0.002, 0.1], rtol=1e-15)
    path.write_text("x_m\ty_m\tz_m\n0,01\t0,02\t0,03\n", encoding="utf-8")
    np.testing.assert_allclose(load_points(path), [[0.01, 0.02, 0.03]], rtol=1e-15)


def test_columns_that_mean_nothing_known_stay(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("time_ms,colour\n1500,red\n", encoding="utf-8")
    table = read_csv(path, ("time_s",))
    assert table.columns == ("time_s", "colour")
    assert float(table.rows[0][0]) == 1.5
    assert table.rows[0][1] == "red"
