"""Files of heating: rigs there and back, logs, the header in a C compiler, pictures."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.rig_thermal import Bench
from tubeopt import HeatingSpec, InputError, Material, Tube, load_rig, save_rig
from tubeopt.robots.file import robot_from_dict, robot_to_dict
from tubeopt.robots.materials import NITINOL
from tubeopt.runs.workshop_file import load_heating_log, rig_from_dict
from tubeopt.shaping.heating.calibration import HeatingLog, calibrate
from tubeopt.shaping.heating.outcome import remarks
from tubeopt.shaping.heating.plan import LEFT, arduino_header, left_in_mold, quench_time, slot_milliseconds
from tubeopt.shaping.heating.rig import Battery
from tubeopt.shaping.heating.robust import assess
from tubeopt.shaping.heating.simulation import resimulate
from tubeopt.shaping.heating.thermal import COARSE, thermal_model
from tubeopt.show.plots.heating import plot_heating, plot_rig_fit

from .heating_reference import CONFIGS, TUBE, mold_of, thesis_plan, thesis_rig, with_mold

READER = """
#include <stdio.h>
#include "schedule.h"
int main(void) {
    printf("%u %u\\n", (unsigned)HEATING_SLOT_MS, (unsigned)sizeof HEATING_DUTY);
    for (unsigned k = 0; k < HEATING_SLOTS; k++) printf("%u\\n", (unsigned)HEATING_DUTY[k]);
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_header_compiles_and_reads_back(tmp_path: Path) -> None:
    plan = thesis_plan()
    (tmp_path / "schedule.h").write_text(arduino_header(plan))
    (tmp_path / "reader.c").write_text(READER)
    program = tmp_path / "reader"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(["gcc", *flags, str(tmp_path / "reader.c"), "-o", str(program)], check=True)
    lines = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.splitlines()
    assert lines[0] == f"500 {len(plan.duty)}"
    assert [int(line) for line in lines[1:]] == plan.duty.tolist()


@pytest.mark.parametrize("path", sorted((CONFIGS / "rigs").glob("*.yaml")), ids=lambda path: path.stem)
def test_rigs_there_and_back(path: Path, tmp_path: Path) -> None:
    rig = load_rig(path)
    assert rig.tube == TUBE
    save_rig(rig, tmp_path / "rig.yaml")
    assert load_rig(tmp_path / "rig.yaml") == rig


def test_unusual_rigs_there_and_back(tmp_path: Path) -> None:
    rig = replace(
        with_mold(thesis_rig(), material=mold_of(0.2), vents=(0.1, 1 / 3), gap=1 / 3e4),
        ambient=293.7,
        convection=31.7,
        loss_factor=1.0 / 3,
        tube=Tube(1e-3, 0.8e-3, 0.1, 0.05, 20.0, Material("alloy", 60e9, 22e9, thermal=NITINOL.thermal)),
        battery=Battery(state_of_charge=0.77, internal_resistance=0.0123),
    )
    save_rig(rig, tmp_path / "rig.yaml")
    assert load_rig(tmp_path / "rig.yaml") == rig


def test_a_battery_may_be_given_by_its_voltage() -> None:
    rig = rig_from_dict({"kind": "rig", "battery": {"voltage_V": 12.37}})
    assert rig.battery.state_of_charge == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"kind": "rig"}, "battery is missing"),
        ({"battery": {}}, "kind is missing; it must be rig"),
        (
            {"kind": "rig", "battery": {"internal_resistance_mohm": -8}},
            "battery.internal_resistance_mohm is -8; it must be",
        ),
        (
            {"kind": "rig", "battery": {"capacity": 3}},
            "battery.capacity is not a known key; did you mean 'capacity_Ah'?",
        ),
        (
            {"kind": "rig", "battery": {}, "mold": {"material": "wood"}},
            "mold.material is 'wood'; it must be steel, mdf",
        ),
        ({"kind": "rig", "battery": {}, "mold": {"vents_percent": [80]}}, "they must be fractions from 0 to 0.5"),
        (
            {"kind": "rig", "battery": {"voltage_V": 12, "state_of_charge_percent": 50}},
            "gives both state_of_charge_percent and voltage_V",
        ),
        ({"kind": "rig", "battery": {"voltage_V": 15}}, "voltage of the battery is 15 V; it must be 11.51 to 12.73 V"),
    ],
)
def test_bad_rig_files(data: object, message: str) -> None:
    with pytest.raises(InputError) as caught:
        rig_from_dict(data, "rig.yaml")
    assert message in str(caught.value)
    assert str(caught.value).startswith("rig.yaml: ")


def test_materials_keep_their_thermal_data_in_robot_files() -> None:
    alloy = Material("alloy", 60e9, 22e9, thermal=replace(NITINOL.thermal, resistivity=0.9e-6))  # type: ignore[type-var]
    tube = Tube(1e-3, 0.8e-3, 0.1, 0.05, 20.0, alloy)
    robot = robot_from_dict({"kind": "concentric", "tubes": [{
        "outer_diameter_mm": 1, "inner_diameter_mm": 0.8, "straight_length_mm": 100, "curved_length_mm": 50,
        "curvature_per_m": 20, "material": "nitinol"}]})  # fmt: skip
    changed = replace(robot, tubes=(tube,))
    assert robot_from_dict(robot_to_dict(changed)).tubes[0].material == alloy


def test_logs_are_read(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("time_s,duty,temperature_degC,current_A\n0,3,25,90\n1,4,,89\n2,5,60,\n")
    log = load_heating_log(file, 0.01)
    np.testing.assert_allclose(log.temperature, [298.15, np.nan, 333.15])
    np.testing.assert_allclose(log.current, [90, 89, np.nan])
    assert log.voltage is None
    assert log.position == 0.01
    file.write_text("time_s,duti,temperature_degC\n0,3,25\n")
    with pytest.raises(InputError, match=re.escape("column duti is not known; columns are time_s, duty")):
        load_heating_log(file)
    file.write_text("time_s,duty,voltage_V\n0,3,x\n1,2,3\n")
    with pytest.raises(InputError, match=r"row 1 \(line 2\), column voltage_V is 'x'; it must be a number"):
        load_heating_log(file)
    file.write_text("time_s,duty\n0,3\n1,2\n2,2\n")
    with pytest.raises(InputError, match=r"log.csv: the log has neither temperature"):
        load_heating_log(file)


def test_pictures(tmp_path: Path) -> None:
    plan = thesis_plan()
    plot_heating(plan, tmp_path / "plan.png", band=assess(plan, samples=4), title="a title")
    time = np.arange(0.0, 20.0, 2.0)
    log = HeatingLog(time, np.full(10, 8.0), temperature=300 + 10 * time, voltage=np.full(10, 12.0))
    plot_rig_fit(calibrate(TUBE, thesis_rig(), log, ["loss"]), tmp_path / "fit.png")
    for name in ("plan.png", "fit.png"):
        with Image.open(tmp_path / name) as image:
            assert image.size[0] > 300


@pytest.mark.parametrize(("beyond", "whole"), [(0.9e-9, True), (1.1e-9, False)])
def test_a_slot_is_a_whole_number_of_ms_to_a_picosecond(beyond: float, whole: bool) -> None:
    slot = (500 + beyond) / 1000
    if whole:
        assert slot_milliseconds(slot) == 500
    else:
        with pytest.raises(InputError, match="a whole number of milliseconds"):
            slot_milliseconds(slot)


def test_a_battery_is_never_left_with_less_than_nothing() -> None:
    rig = replace(thesis_rig(), battery=replace(thesis_rig().battery, state_of_charge=0.02))
    model = thermal_model(TUBE, rig, COARSE)
    history = resimulate(model, 5.0, np.full(360, 1.0))
    (words,) = [words for words in remarks(rig, history, 300.0) if "battery" in words]
    assert re.fullmatch(r"the heating takes \d+ % of the battery's capacity; the battery has 2 %", words)


@pytest.mark.parametrize("kelvin", [250.0, 300.0, 373.15])
def test_a_cold_tube_needs_no_quench(kelvin: float) -> None:
    assert quench_time(TUBE, HeatingSpec(), kelvin) == 0.0


def test_a_tube_left_in_its_mold_cools_as_on_a_model_of_its_own() -> None:
    """An opened lid leaves the upper half in air: faster than the closed mold, slower than moving air all around."""
    plan, found = thesis_plan(), left_in_mold(thesis_plan())
    closed = Bench(plan.tube, plan.rig)
    for count in plan.duty[: round(plan.hold_end / plan.spec.slot)]:
        closed.pass_time(float(count), plan.spec.slot)
    opened = Bench(plan.tube, replace(plan.rig, mold=replace(plan.rig.mold, vents=(0.5,))))
    opened.state = closed.state.copy()
    cooling = [closed.pass_time(0.0, 0.25)[-1].max() for _ in range(round(LEFT / 0.25))]
    hottest = [cooling[-1], opened.pass_time(0.0, LEFT)[-1].max()]
    at = np.interp([-500.0, -400.0], -np.array(cooling), 0.25 * np.arange(1, len(cooling) + 1))
    assert [found.latest, found.latest + found.passed] == pytest.approx(at, abs=0.5)
    assert [found.closed, found.opened] == pytest.approx(hottest, abs=8.0)
    assert 100 < found.opened < found.closed - 30


def test_legends_of_a_plan_hide_no_curve() -> None:
    figure = plot_heating(thesis_plan(), band=assess(thesis_plan(), samples=4))
    figure.canvas.draw()
    boxes = [axes.get_window_extent() for axes in figure.axes]
    legends = [legend.get_window_extent() for axes in figure.axes if (legend := axes.get_legend()) is not None]
    assert len(legends) == 4
    for legend in legends:
        assert not any(legend.overlaps(box) for box in boxes)
        assert legend.x1 <= figure.bbox.x1
