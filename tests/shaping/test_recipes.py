"""Heat sets the shape of nitinol, at temperatures that it bears; of what cannot be, nothing is planned."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.command_line import ROOT, Run, refused
from tubeopt import HeatingSpec, InputError, Tube, load_robot, plan_heating, plan_mold
from tubeopt.robots.materials import THERMAL_DATA, Material
from tubeopt.shaping import rank_mold_materials
from tubeopt.shaping.heating.calibration import HeatingLog
from tubeopt.shaping.heating.rig import Battery, Circuit, Clamps, MoldBed, Rig
from tubeopt.shaping.materials import STEEL, recipe_for
from tubeopt.shaping.mold.heat import HeatSpec
from tubeopt.shaping.mold.spec import GrooveSpec, MoldSpec, PlateSpec
from tubeopt.shaping.mold.springback import calibrate_springback
from tubeopt.shaping.tube_fabrication import plan_tube

from .heating_reference import TUBE, thesis_rig

STAINLESS = Material("stainless steel 304", 193e9, 77e9, thermal=THERMAL_DATA["stainless_steel"])
RIG = str(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")


def of(material: Material) -> Tube:
    """The thesis' tube of another material."""
    return replace(TUBE, material=material)


@pytest.mark.parametrize(
    "material",
    [
        STAINLESS,
        replace(STAINLESS, name="tube"),
        replace(STAINLESS, thermal=None),
        replace(STAINLESS, name="tube", thermal=None),
        Material("titanium", 110e9, 42e9),
        Material("aluminium 6061", 69e9, 26e9),
    ],
)
def test_another_metal_is_refused_with_what_it_needs_instead(material: Material) -> None:
    needed = f"'{material.name}' is not nitinol .* bend the tube beyond its yield point.* relieve its stress"
    with pytest.raises(InputError, match=needed):
        plan_heating(of(material), thesis_rig(), HeatingSpec(hold_time=5))
    with pytest.raises(InputError, match=needed):
        plan_tube(of(material), thesis_rig())
    with pytest.raises(InputError, match=needed):
        rank_mold_materials(of(material))


def test_each_metal_has_its_stress_relief() -> None:
    for name, relief in (("titanium", "480 to 650 degC"), ("Elgiloy", "480 to 540 degC"), ("steel 304", "350 to 400")):
        with pytest.raises(InputError, match=f"relieve its stress: .*{relief}"):
            recipe_for(Material(name, 110e9, 42e9))


@pytest.mark.parametrize(("finish", "fits"), [(-30.0, False), (-15.0, True), (30.0, True), (60.0, False)])
def test_nitinol_is_superelastic_in_the_body_by_its_af(
    caplog: pytest.LogCaptureFixture, finish: float, fits: bool
) -> None:
    thermal = replace(THERMAL_DATA["nitinol"], austenite_finish=finish + 273.15)
    tube = of(replace(TUBE.material, thermal=thermal))
    with caplog.at_level(logging.WARNING):
        plan_mold(tube)
    assert ("superelastic in the body" not in caplog.text) == fits


def test_a_mold_of_another_metal_says_that_there_is_no_recipe() -> None:
    assert any("is not nitinol" in words for words in plan_mold(of(STAINLESS)).remarks)
    assert not any("is not nitinol" in words for words in plan_mold(TUBE).remarks)


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "robots").glob("*.yaml")), ids=lambda path: path.stem)
def test_tubes_of_shipped_robots_have_a_recipe_but_those_of_steel_and_nylon(path: Any) -> None:
    for tube in load_robot(path).tubes:
        if any(other in tube.material.name for other in ("steel", "nylon")):
            with pytest.raises(InputError):
                recipe_for(tube.material)
        else:
            assert recipe_for(tube.material).metal == "nitinol"


def test_temperatures_that_nitinol_does_not_bear_are_refused(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(InputError, match="window_degC is 830 to 850 degC; it must be at most 700 degC for nitinol"):
        plan_heating(TUBE, thesis_rig(), HeatingSpec(window_degC=(830.0, 850.0)))
    hot = HeatSpec(set_temperature=850.0 + 273.15)
    for plan in (lambda: rank_mold_materials(TUBE, hot), lambda: plan_mold(TUBE, MoldSpec(heat=hot))):
        with pytest.raises(InputError, match="set_temperature is 850 degC; it must be at most 700 degC for nitinol"):
            plan()
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        plan_mold(TUBE, MoldSpec(heat=HeatSpec(set_temperature=300.0 + 273.15)))
    assert "set_temperature is 300 degC; nitinol is shape-set at 400 to 600 degC" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        plan_mold(TUBE)
    assert "nitinol is shape-set at" not in caplog.text


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rig(ambient=25.0), "ambient of the rig is 25; it must be at least 233.15"),
        (lambda: Rig(ambient=300.0 + 273.15), "ambient of the rig is 573.15; it must be at most 333.15"),
        (lambda: Circuit(current_limit=1e4), "current_limit of the circuit is 10000 A; it must be at most 2000 A"),
        (lambda: Circuit(peak_limit=1e4), "peak_limit of the circuit is 10000 A; it must be at most 5000 A"),
        (lambda: Circuit(cable_resistance=20.0), "cable_resistance of the circuit is 20 ohm; it must be at most 10"),
        (lambda: Battery(open_circuit=((0.1, 200.0), (1.0, 230.0))), "up to 230 V; it must .* up to 120 V"),
        (lambda: Battery(open_circuit=((10.0, 11.0), (100.0, 12.7))), "from a charge of 10 to 100 .* from 0 to 1"),
        (lambda: Clamps(grip=10.0), "grip of the clamps is 10 m; it must be at most 0.2"),
        (lambda: Clamps(clearance=5.0), "clearance of the clamps is 5 m; it must be at most 0.2"),
        (lambda: MoldBed(width=100.0), "width of the mold is 100 m; it must be at most 2"),
        (lambda: MoldBed(gap=75.0), "gap of the mold is 75 m; it must be at most 0.005"),
        (lambda: replace(STEEL, density=7.85), "density of mold material 'steel' is 7.85; it must be at least 10"),
        (lambda: replace(THERMAL_DATA["nitinol"], density=6.45), "density is 6.45; it must be at least 100"),
        (lambda: PlateSpec(thickness=12.7), "thickness .*is 12.7 m; it must be at most 2"),
        (lambda: GrooveSpec(wall=3.0), "wall .*is 3 m; it must be at most 2"),
        (lambda: HeatSpec(ambient=20.0), "ambient is 20; it must be at least 233.15"),
        (lambda: calibrate_springback([0.06e-3] * 3, [0.0654e-3] * 3), "mold_radius of trial 1 is 0.06 mm; .* 1 to"),
        (lambda: calibrate_springback([0.06] * 3, [65.4] * 3), "obtained_radius of trial 1 is 65400 mm; .* 1 to 10000"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_where_it_enters(make: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    ("channel", "values", "message"),
    [
        ("current", [0.0, 1e4, 0.0], "current of the log is 0 to 10000 A; it must be -50 to 5000 A"),
        ("voltage", [12.0, 1200.0, 12.0], "voltage of the log is 12 to 1200 V; it must be -1 to 150 V"),
        ("temperature", [25.0, 300.0, 500.0], "temperature of the log is -248.15 to 226.85 degC; it must be -60 to"),
    ],
)  # fmt: skip
def test_readings_that_no_instrument_shows_are_refused(channel: str, values: list[float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        HeatingLog(np.arange(3.0), np.full(3, 20.0), **{channel: np.array(values)})


def test_files_in_other_units_are_refused(run: Run, tmp_path: Any) -> None:
    trials = tmp_path / "trials.csv"
    trials.write_text("mold_radius_mm,obtained_radius_mm\n0.06,0.0654\n0.08,0.0871\n0.1,0.1092\n")
    assert "column mold_radius_mm is 0.06; it must be 1 to 10000" in refused(run("mold", "calibrate", str(trials)))[0]
    rig = tmp_path / "rig.yaml"
    rig.write_text("kind: rig\nbattery: {}\nambient_degC: 300\ncircuit: {current_limit_A: 10000}\n")
    refusals = " ".join(refused(run("heat", str(rig))))
    assert "ambient_degC is 300; it must be" in refusals
    assert "circuit.current_limit_A is 10000; it must be" in refusals
    hot = run("heat", "plan", RIG, "--window-degC", "830,850")
    assert hot.code == 2
    assert "--window-degC is 830 to 850 degC; it must be at most 700 degC for nitinol" in hot.err
    materials = run("mold", "materials", "--set-degC", "850")
    assert materials.code == 2
    assert "is 850 degC; it must be at most 700 degC for nitinol" in materials.err
