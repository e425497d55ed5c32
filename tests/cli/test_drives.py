"""Loads of drives on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.command_line import ROOT, Run, answer, refused
from tests.examples import TWO_TUBE
from tubeopt import Friction, drives_along, drives_at, fatigue, workspace
from tubeopt.planning.trajectory import timed_csv
from tubeopt.runs.drives_study import load_strain_life

PAIR = str(ROOT / "configs" / "robots" / "two_tube.yaml")
TIME, TURNS = np.array([0.0, 1.0, 3.0]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, -0.5]])


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    path = tmp_path / "motion.csv"
    path.write_text(timed_csv(TIME, TURNS, np.tile(TWO_TUBE.home_translations, (3, 1)), []))
    return path


def test_drives_along_a_motion_are_saved_and_drawn(run: Run, motion: Path, tmp_path: Path) -> None:
    found = drives_along(TWO_TUBE, TURNS, time=TIME)
    record = answer(run("drives", PAIR, "--along", str(motion), "--json"))
    np.testing.assert_allclose(record["peak_torque_mN_m"], 1e3 * found.peak_torque)
    np.testing.assert_allclose(record["peak_torque_power_mW"], 1e3 * found.peak_torque_power)
    assert record["peak_torque_row"] == (1 + np.abs(found.torque).argmax(0)).tolist()
    outcome = run("drives", PAIR, "--along", str(motion), "--out", str(tmp_path / "out"))
    assert outcome.code == 0
    header, *rows = (tmp_path / "out" / "drives.csv").read_text().splitlines()
    assert header.startswith("time_s,rotation_1_deg,rotation_2_deg,translation_1_mm")
    torques = header.split(",").index("torque_1_mN_m")
    last = [float(cell) for cell in rows[-1].split(",")]
    np.testing.assert_allclose(last[torques : torques + 2], 1e3 * found.torque[-1], rtol=1e-6)
    assert (tmp_path / "out" / "drives.png").stat().st_size > 1000


def test_drives_over_the_workspace(run: Run, tmp_path: Path) -> None:
    rates = "--rotation-rate-deg-per-s=90", "--translation-rate-mm-per-s=10"
    record = answer(run("drives", PAIR, "--samples", "8", *rates, "--out", str(tmp_path), "--json"))
    drawn = workspace(TWO_TUBE, 8)
    found = drives_at(TWO_TUBE, drawn.rotations, drawn.translations, rates=(np.pi / 2, 0.01))
    np.testing.assert_allclose(record["peak_torque_mN_m"], 1e3 * found.peak_torque)
    np.testing.assert_allclose(record["peak_force_power_mW"], 1e3 * found.peak_force_power)
    assert "work_mJ" not in record
    assert (tmp_path / "drives.png").stat().st_size > 1000


def test_friction_of_the_robot_file_acts_unless_shaken(run: Run, motion: Path, tmp_path: Path) -> None:
    robot = tmp_path / "robot.yaml"
    robot.write_text((ROOT / "configs" / "robots" / "two_tube.yaml").read_text() + "friction: {torque_mN_m_per_m: 2}\n")
    flags = "drives", str(robot), "--along", str(motion), "--json"
    rubbed = answer(run(*flags))
    assert rubbed["heat_mJ"] == pytest.approx(1e3 * drives_along(TWO_TUBE, TURNS, friction=Friction(torque=0.002)).heat)
    assert rubbed["heat_mJ"] > 0
    assert answer(run(*flags, "--shaken"))["heat_mJ"] == 0


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--samples", "5"), "samples is given, but along has joint values"),
        (("--rotation-rate-deg-per-s", "5"), "is given, but along has joint values"),
    ],
)
def test_keys_of_the_workspace_are_refused_along_a_motion(
    run: Run, motion: Path, flags: tuple[str, ...], message: str
) -> None:
    (problem,) = refused(run("drives", PAIR, "--along", str(motion), *flags))
    assert message in problem


def test_both_rates_are_needed(run: Run) -> None:
    (problem,) = refused(run("drives", PAIR, "--rotation-rate-deg-per-s", "5"))
    assert "give both rates" in problem


# --- fatigue ----------------------------------------------------------------------------------------------------------

CURVE = "amplitude_percent,cycles,cycles_low,cycles_high\n0.001,1e9,1e8,1e10\n2,1e3,1e2,1e4\n"


def test_strain_cycles_are_saved_and_drawn(run: Run, motion: Path, tmp_path: Path) -> None:
    curve = tmp_path / "curve.csv"
    curve.write_text(CURVE)
    found = fatigue(TWO_TUBE, TURNS, curve=load_strain_life(curve))
    flags = "fatigue", PAIR, str(motion), "--curve", str(curve)
    record = answer(run(*flags, "--json"))
    assert record["returned"] is True
    for tube, each in zip(record["tubes"], found.tubes, strict=True):
        assert tube["amplitude_percent"] == pytest.approx(100 * each.amplitude)
        assert tube["place_mm"] == pytest.approx(1e3 * each.place)
        assert tube["endurance"] == str(each.endurance)
        assert (tube["life"], tube["life_low"]) == pytest.approx((each.life, each.life_range[0]))
        assert tube["life_low"] < tube["life"] < tube["life_high"]
    outcome = run(*flags, "--out", str(tmp_path / "out"))
    assert outcome.code == 0
    header, *rows = (tmp_path / "out" / "strain.csv").read_text().splitlines()
    assert header == "waypoint,strain_1_percent,strain_2_percent"
    assert len(rows) == len(found.tubes[0].history)
    assert (tmp_path / "out" / "fatigue.png").stat().st_size > 1000


def test_a_curve_that_is_none_is_refused(run: Run, motion: Path, tmp_path: Path) -> None:
    curve = tmp_path / "curve.csv"
    curve.write_text("amplitude_percent,cycles\n0.1,1e3\n2,1e9\n")
    (problem,) = refused(run("fatigue", PAIR, str(motion), "--curve", str(curve)))
    assert "lives must not rise with the amplitude" in problem
