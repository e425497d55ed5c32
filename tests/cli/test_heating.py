"""`tubeopt heat` and `tubeopt fabricate`: what they print, what they save, and how they fail."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.command_line import ROOT, Run, answer, refused
from tests.shaping.heating_reference import header_duties, thesis_plan
from tubeopt import load_rig
from tubeopt.cli.commands import CHARGES
from tubeopt.runs.heating_study import ClosedLoopStudy
from tubeopt.shaping.firmware.boards import BOARDS
from tubeopt.shaping.firmware.sketch_files import board_header
from tubeopt.shaping.heating import robust
from tubeopt.shaping.tube_fabrication import lid_profile

RIG = str(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")
ROBOT = str(ROOT / "configs" / "robots" / "thesis_etr.yaml")
LOG = str(ROOT / "configs" / "experiments" / "heating_log.csv")
SHORT = ("--hold-s", "5", "--samples", "8")


def test_tables_are_for_the_charges_that_the_library_takes_by_default() -> None:
    assert ",".join(f"{100 * charge:g}" for charge in robust.CHARGES) == CHARGES


def test_a_plan_is_printed_and_saved(run: Run, tmp_path: Path) -> None:
    # Of eight uncertain rigs fewer than half keep the window: the plan is shown and saved, and the command ends with 3.
    data = answer(run("heat", RIG, *SHORT, "--charges-percent", "100,60", "--json", "--out", str(tmp_path)), 3)
    assert data["feasible"]
    assert next(iter(data)) == "success_probability"
    assert data["success_probability"] == data["band"]["probability"] < 0.5
    low, high = data["success_interval"]
    assert 0 <= low <= data["success_probability"] < high < 1
    assert data["led_by"] == ""
    assert 500 <= data["lowest_degC"] <= data["highest_degC"] <= 550
    assert data["energy_error"] < 1e-3
    assert [table["battery_V"] for table in data["tables"]] == pytest.approx([12.73, 12.24])
    assert all(table["feasible"] for table in data["tables"])
    assert data["band"]["samples"] == 8
    names = {Path(name).name for name in data["files"]}
    assert names == {path.name for path in tmp_path.iterdir()}
    assert {"schedule.csv", "schedule.h", "schedule_12.24V.h", "plan.json", "heating.png"} < names
    for name in ("schedule", "schedule_12.73V", "schedule_12.24V"):
        lines = [x for x in (tmp_path / f"{name}.csv").read_text().splitlines() if not x.startswith("#")]
        duties = [int(row["duty"]) for row in csv.DictReader(lines)]
        assert duties == header_duties((tmp_path / f"{name}.h").read_text())
    # The file that one loads says that the heating fails more often than not.
    for path in tmp_path.glob("schedule*.[hc]*"):
        assert "DO NOT RUN" in path.read_text(encoding="utf-8").splitlines()[0]
    stored = json.loads((tmp_path / "plan.json").read_text())
    assert stored["duty"] == data["duty"]
    assert stored["rig_data"]["kind"] == "rig"


def test_a_plan_as_a_table(run: Run) -> None:
    outcome = run("heat", "plan", RIG, "--robot", ROBOT, *SHORT, "--charges-percent", "none", "--robust")
    assert outcome.code == 3
    assert re.match(r"success: \d+ % of 8 uncertain rigs keep window and limit", outcome.out)
    assert re.search(r"error: success: \d+ % of 8 uncertain rigs .* at least 50 % must: close the loop", outcome.err)
    for words in ("held: 500 to 550 degC for 5 s", "cold end", "stay in the", "energy balance"):
        assert words in outcome.out


def test_a_sensor_that_closes_the_loop_makes_success_likely(run: Run) -> None:
    flags = ("--hold-s", "5", "--samples", "20", "--sensor", "thermocouple", "--charges-percent", "none", "--json")
    data = answer(run("heat", "plan", RIG, *flags))
    assert data["led_by"] == "thermocouple"
    assert data["success_probability"] > 0.8 > 0.5 > data["band"]["probability"]
    assert "--sensor: sensor is 'nose'; it must be one of" in refused(run("heat", RIG, "--sensor", "nose"))[0]


def test_the_schedule_alone_is_rated_alike_with_and_without_a_sensor(run: Run) -> None:
    flags = ("heat", "plan", RIG, "--hold-s", "5", "--samples", "20", "--charges-percent", "none")
    alone, led = run(*flags), run(*flags, "--sensor", "thermocouple")
    (share,) = re.findall(r"success: (\d+) % of 20 uncertain rigs", alone.out)
    (alike,) = re.findall(r"by the schedule alone (\d+) % of the same rigs do", " ".join(led.out.split()))
    assert share == alike
    assert (alone.code, led.code) == (3, 0)


@pytest.mark.parametrize("samples", ["0", "19"])
def test_a_sensor_needs_uncertain_rigs(run: Run, samples: str) -> None:
    flags = ("--samples", samples, "--sensor", "thermocouple")
    wanted = f"--samples is {samples}; with a sensor it must be at least 20"
    assert refused(run("heat", "plan", RIG, *flags)) == [wanted]
    assert refused(run("fabricate", ROBOT, "--rig", RIG, *flags)) == [wanted]
    (line,) = refused(run("fabricate", ROBOT, "--rig", RIG, "--sensor", "nose"))
    assert "it must be one of thermocouple, resistance, camera, none" in line


@pytest.mark.parametrize(
    ("flags", "wanted"),
    [
        (("--charges-percent", "90,200"), "--charges-percent[1] is 200; it must be at most 100"),
        (("--hold-s", "0.5"), "--hold-s is 0.5 s; it must be at least 1 s"),
        (("--longest-s", "5000"), "--longest-s is 5000 s; it must be at most 1800 s"),
        (("--slot-s", "10"), "--slot-s is 10 s; it must be 0.02 to 5 s, and not above the --hold-s"),
        (("--lead-range-mm", "5,2"), "--lead-range-mm is 5 mm to 2 mm; the first must be below the second"),
    ],
)
def test_refused_value_is_reported_by_flag_and_unit(run: Run, flags: tuple[str, ...], wanted: str) -> None:
    assert refused(run("heat", "plan", RIG, *flags)) == [wanted]


def test_robot_file_in_place_of_rig_is_reported(run: Run) -> None:
    (line,) = refused(run("heat", "plan", ROBOT))
    assert line.endswith("kind is 'eccentric'; it must be rig; this is a robot file, and a rig file is required")


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        # The bare tube is in the window, the middle is not.
        (
            ("--material", "steel", "--window-degC", "60,120", "--hold-s", "5", "--longest-s", "30", "--slot-s", "2"),
            "the middle of the curved part is below the window",
        ),
        (("--hold-s", "5"), "mm from each clamp are below the window"),
    ],
)
def test_a_cold_end_is_never_negative(run: Run, flags: tuple[str, ...], words: str) -> None:
    outcome = run("heat", "plan", RIG, "--samples", "0", "--charges-percent", "none", *flags)
    (said,) = re.findall("cold end (.*?) extra tube", " ".join(outcome.out.split()))
    assert said.endswith(words)
    assert "-" not in said


@pytest.mark.parametrize("loss", ["0", "2"])
def test_a_rig_that_is_known_keeps_the_window_without_a_sensor(run: Run, loss: str) -> None:
    # 3 % of the loss is known after a calibration.
    flags = ("--objective", "margin", "--hold-s", "5", "--samples", "16", "--loss-percent", loss)
    outcome = run("heat", "plan", RIG, *flags, "--charges-percent", "none")
    assert "success: " in outcome.out
    assert "uncertain rigs keep window and limit" in " ".join(outcome.out.split())


def test_missed_window_is_reported_with_remedy(run: Run, tmp_path: Path) -> None:
    flags = ("--material", "steel", "--hold-s", "5", "--longest-s", "40", "--loss-percent", "0")
    outcome = run("heat", RIG, *flags, "--charges-percent", "none", "--out", str(tmp_path))
    assert outcome.code == 3
    assert re.search(
        r"no schedule was found that keeps 500 to 550 degC for 5 s: the window is missed by \d+\.\d", outcome.err
    )
    plan = json.loads((tmp_path / "plan.json").read_text())
    assert not plan["feasible"]
    assert plan["shortfall_K"] > 300
    assert plan["cold_end_mm"] is None
    text = " ".join(outcome.out.split())
    for words in (
        "MISSED",
        "a mold of calcium silicate in place of steel: sufficient",
        "problem: while the MOSFET",
    ):
        assert words in text


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--window-degC", "500"), "--window-degC has 1 number; it must have 2"),
        (("--window-degC", "500,x"), "--window-degC[1] is 'x'; it must be a number"),
        (("--limit-degC", "520"), "--window-degC is 500 to 550 degC; it must end below the limit of 520 degC"),
        (("--objective", "speed"), "--objective is 'speed'; it must be time, energy or margin"),
        (
            ("--material", "wood"),
            "--material: mold material is 'wood'; it must be one of steel, mdf, glass_mica, calcium_silicate",
        ),
        (("--battery-V", "14"), "--battery-V: voltage of the battery is 14 V; it must be 11.51 to 12.73 V"),
        (("--robot", ROBOT, "--tube", "7"), "--tube is 7; it must be 1 to 3"),
        (("--free", "leads"), "--free[0] is 'leads'; it must be clearance, lead or vents; did you mean 'lead'?"),
        (
            ("--slot-s", "0.0333"),
            "--slot-s is 0.0333 s; for an Arduino it must be a whole number of milliseconds",
        ),
        (("--loss-percent", "120"), "--loss-percent is 120; it must be less than 100"),
    ],
)
def test_wrong_flags(run: Run, flags: tuple[str, ...], message: str) -> None:
    assert message in refused(run("heat", RIG, *flags))[0]


def test_bad_rig_files_are_refused(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("kind: rig\n")
    assert refused(run("heat", str(file))) == [f"{file}: battery is missing"]
    file.write_text("kind: rig\nbattery: {internal_resistance_mohm: -8}\n")
    assert "battery.internal_resistance_mohm is -8; it must be greater than 0" in refused(run("heat", str(file)))[0]
    file.write_text("kind: rig\nbattery: {}\n")
    assert "the rig file has no tube" in refused(run("heat", str(file)))[0]
    assert refused(run("heat", "none.yaml")) == ["none.yaml: there is no such file"]


def test_a_log_calibrates_the_rig(run: Run, tmp_path: Path) -> None:
    flags = ("--fit", "loss,resistivity", "--out", str(tmp_path))
    data = answer(run("heat", "calibrate", LOG, "--rig", RIG, *flags, "--json"))
    values = {estimate["name"]: estimate for estimate in data["estimates"]}
    assert values["loss"]["factor"] == pytest.approx(1.12, rel=0.02)
    assert values["resistivity"]["factor"] == pytest.approx(1.05, rel=0.02)
    rig = load_rig(tmp_path / "rig.yaml")
    assert rig.loss_factor == pytest.approx(values["loss"]["factor"])
    assert {path.name for path in tmp_path.iterdir()} == {"calibration.json", "rig.yaml", "calibration.png"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run",), "--port and --simulate are missing; one of them must be given"),
        (("run", "--port", "p", "--simulate", RIG), "--port and --simulate are given; it must be one of them"),
        (("plan", RIG, "--tube", "4"), "--tube is 4; without a robot it must be 1, the rig file's own"),
    ],
)
def test_missing_or_superfluous_key_is_reported_by_flag(run: Run, words: tuple[str, ...], message: str) -> None:
    assert refused(run("heat", *words)) == [message]


def test_a_robot_is_fabricated(run: Run, tmp_path: Path) -> None:
    flags = (
        "--rig",
        RIG,
        "--out",
        str(tmp_path),
        "--hold-s",
        "5",
        "--samples",
        "20",
        "--board",
        "pico",
        "--objective",
        "time",
        "--charges-percent",
        "none",
        "--json",
    )
    data = answer(run("fabricate", ROBOT, *flags))
    # Without a flag, a thermocouple leads the heating.
    assert (data["success_probability"], data["led_by"]) == (1.0, "thermocouple")
    assert [tube["tube"] for tube in data["tubes"]] == [1]
    assert len(data["left_out"]) == 2
    (made,) = data["tubes"]
    (groove,), plan = made["mold"]["grooves"], made["heating"]
    assert plan["feasible"]
    assert made["agreed"]
    assert groove["free_length_mm"] == pytest.approx(plan["free_length_mm"], abs=0.01)
    between = 2 * (plan["lead_mm"] + plan["clearance_mm"]) + plan["curved_length_mm"]
    assert groove["free_length_mm"] == pytest.approx(between, abs=0.01)
    assert [groove["lead_in_mm"], groove["lead_out_mm"]] == pytest.approx([plan["lead_mm"]] * 2, abs=0.01)
    assert (groove["width_mm"] - 1.92) / 2 == pytest.approx(1e-3 * plan["side_clearance_um"])
    assert plan["gap_um"] > plan["side_clearance_um"]
    for name in ("growth_mm", "extra_length_mm"):
        assert groove[name] == pytest.approx(plan[name], abs=0.01)
    assert groove["cold_length_mm"] == pytest.approx(plan["cold_end_mm"], abs=0.01)
    for sheet in ("sheet.pdf", "clamps.pdf"):
        assert (tmp_path / "tube_1" / sheet).read_bytes().startswith(b"%PDF")
    rig = load_rig(tmp_path / "tube_1" / "rig.yaml")
    assert 1e3 * rig.mold.lead == pytest.approx(plan["lead_mm"])
    mold = {path.name for path in (tmp_path / "tube_1" / "mold").iterdir()}
    heating = {path.name for path in (tmp_path / "tube_1" / "heating").iterdir()}
    firmware = tmp_path / "tube_1" / "firmware"
    assert {"law.json", "wiring.png", "tube_heater"} <= {path.name for path in firmware.iterdir()}
    # Sketch, schedule and sheet are for the pulses of the board.
    frequency = rig.circuit.pwm_frequency
    assert frequency in BOARDS["pico"].frequencies
    assert f"#define PWM_HZ {frequency:.2f}f" in (firmware / "tube_heater" / "board.h").read_text(encoding="utf-8")
    assert {"base.dxf", "base.stl", "base_1.nc"} <= mold
    assert {"schedule.csv", "schedule.h", "heating.png", "plan.json"} <= heating
    assert (tmp_path / "robot.yaml").exists()


def test_tubes_of_a_robot_are_heated_by_one_circuit(run: Run, tmp_path: Path) -> None:
    """Pulses and scale of the current sensor are the same in the sketches of all tubes; schedules are not."""
    robot = str(ROOT / "configs" / "robots" / "two_tube.yaml")
    flags = ("--rig", RIG, "--out", str(tmp_path), "--samples", "20", "--charges-percent", "none")
    run("fabricate", robot, *flags, "--objective", "time", "--hold-s", "5")
    boards, schedules = (
        {path.read_text(encoding="utf-8") for path in tmp_path.glob(f"tube_*/firmware/tube_heater/{name}.h")}
        for name in ("board", "schedule")
    )
    lines = [{line for line in text.splitlines() if re.search("PWM_HZ|AMPERE_PER_STEP", line)} for text in boards]
    assert [len(each) for each in lines] == [2] * len(boards)
    assert len(set.union(*lines)) == 2
    assert len(schedules) == 2
    # A sketch made later from a tube's rig file is for the same circuit, though the tube alone needs another sensor.
    shared = {line.split()[1]: float(line.split()[2].strip("(f)")) for line in set.union(*lines)}
    for file in tmp_path.glob("tube_*/rig.yaml"):
        rig = load_rig(file)
        assert rig.tube is not None
        study = ClosedLoopStudy.model_validate({"kind": "led_heating", "rig": str(file), "board": "uno"})
        board = board_header(study.wiring(), replace(thesis_plan(), tube=rig.tube, rig=study.pulsed_rig()))
        defined = dict(re.findall(r"#define (PWM_HZ|AMPERE_PER_STEP) \(?([\d.e-]+)f", board))
        assert {name: float(value) for name, value in defined.items()} == pytest.approx(shared, rel=1e-4)


@pytest.mark.parametrize("words", [("heat", "plan"), ("heat", "calibrate"), ("fabricate",)])
def test_help_has_an_example(run: Run, words: tuple[str, ...]) -> None:
    assert f"Example: tubeopt {words[0]}" in run(*words, "--help").out


def test_the_example_of_the_help_works(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    text = " ".join(run("heat", "plan", "--help").out.split())
    assert run(*text.split("Example: tubeopt ")[1].split()).code == 0


def test_the_lid_of_a_fabricated_mold_has_the_vents_that_the_schedule_counts_on() -> None:
    rig = load_rig(RIG)
    tube = rig.tube
    assert tube is not None
    assert lid_profile(rig, tube) == (0.0,)
    vented = replace(rig, mold=replace(rig.mold, vents=(0.0, 0.2)))
    profile = lid_profile(vented, tube)
    assert profile == pytest.approx(profile[::-1])
    assert 2 * 0.2 * 20 / 67 < profile[0] < profile[4] < 2 * 0.2
    # Along the bend the surface left open is that of the rig: its mean lies halfway between the bend's end and middle.
    assert sum(profile) / len(profile) == pytest.approx(0.2 * (1 + 20 / 67), rel=1e-6)
