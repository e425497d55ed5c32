"""The firmware: the same heating as the law in Python, and a named stop for everything that goes wrong."""

from __future__ import annotations

import functools
import json
import math
import os
import re
import shutil
import subprocess
import threading
import tty
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from tubeopt import Feedback, HeatingPlan, HeatingSpec, InputError, SolveError, Thermocouple, load_rig, plan_heating
from tubeopt.constants import ZERO_CELSIUS
from tubeopt.runs.heating_run import HeatingRun, run_heating
from tubeopt.runs.heating_study import ClosedLoopHeating, ClosedLoopStudy, Heating, TubeParts
from tubeopt.runs.workshop_file import rig_from_dict, rig_to_dict
from tubeopt.shaping.firmware import boards
from tubeopt.shaping.firmware.boards import (
    BOARDS,
    Wiring,
    coil_zener,
    converter_for,
    fuse_of,
    gate_threshold,
    hall_slope,
    parts_list,
    pwm_frequency,
    root_mean_square,
    shared_parts,
)
from tubeopt.shaping.firmware.line import SerialLine, SimulatedLine, SimulatedRig
from tubeopt.shaping.firmware.sketch_files import (
    CHARGES,
    board_header,
    schedule_header,
    schedules,
    tabled,
    write_sketch,
)
from tubeopt.shaping.heating.controller import MOST_COUNT, HeatingLaw, LawState, decide
from tubeopt.shaping.heating.counts import full_current
from tubeopt.shaping.heating.cutout import (
    SHORTED_LIMIT,
    cut_out,
    cutout_delay,
    safe_supplies,
    stop_current,
    upward,
)
from tubeopt.shaping.heating.rig import Battery
from tubeopt.shaping.heating.thermal import FINE, ThermalModel, thermal_model
from tubeopt.shaping.heating.uncertainty import ENSEMBLE, Uncertainty
from tubeopt.show.heat_report import FeedbackReport, HeatingRunReport
from tubeopt.show.plots.heating import plot_wiring
from tubeopt.typing import Array

from .firmware_host import COMPILER, Fault, built, run
from .heating_reference import TUBE, integrate, thesis_rig
from .test_feedback import led, plan

needs_a_compiler = pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")


@functools.lru_cache(maxsize=1)
def _tables(planned: HeatingPlan, feedback: Feedback) -> list[tuple[float, Array]]:
    return schedules(planned, feedback)


@pytest.fixture(scope="module")
def heater(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The heater, for this computer."""
    directory = tmp_path_factory.mktemp("sketch")
    write_sketch(plan(), led(), Wiring(), directory, host=True)
    return built(directory / "tube_heater")


def member(model: ThermalModel, b: int) -> ThermalModel:
    """One of a model's members."""
    return replace(model, properties=model.properties[b : b + 1], volumes=model.volumes[b : b + 1])


def law_for(rig: SimulatedRig) -> HeatingLaw:
    """The law with the schedule that the firmware chooses by the battery's voltage at rest."""
    tables = _tables(plan(), led())
    volt, _ = rig.electrics(False)
    chosen = next((planned for rest, planned in tables if rest <= volt + 0.05), tables[-1][1])
    return tabled(replace(led().law, planned=chosen))


TESTED = 9
"""Ticks of the test of switch and cut-out."""


def count_of_test(k: int) -> int:
    """Counts that heat in the test: with the cut-out closed."""
    return 2 if k >= 6 else 0


@needs_a_compiler
def test_the_firmware_leads_as_the_law_does(heater: Path) -> None:
    made = plan()
    rigs = Uncertainty.of_a_workshop().ensemble(made.tube, made.rig, 2, sensor_bias=2.0, seed=7)
    fleet, bias = rigs.model, rigs.bias
    for b in range(3):
        rigs = [
            SimulatedRig(
                member(fleet, b),
                Thermocouple(),
                bias=float(bias[b]),
                hot=float(led().law.reference.max()),
                seed=b,
            )
            for _ in range(2)
        ]
        found = run(heater, rigs[0])
        assert found.reason == "done"
        law, memory, hottest = law_for(rigs[1]), LawState.start(1), []
        count: Any = np.zeros(1)
        for k in range(found.columns.shape[1]):
            reading = rigs[1].reading
            count = np.full(1, count_of_test(k)) if k < TESTED else count
            if k >= TESTED and (k - TESTED) % 5 == 0:
                count, memory = decide(law, memory, np.array([reading]))
            hottest.append(rigs[1].hottest - ZERO_CELSIUS)
            rigs[1].pass_time(int(count[0]), 0.1)
        assert np.abs(found.columns[5] - hottest).max() < 1.0


@needs_a_compiler
def test_the_firmware_follows_a_lead_as_the_law_does_and_goes_on_alone(heater: Path) -> None:
    hot = float(led().law.reference.max())
    rigs = [SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple(), hot=hot) for _ in range(2)]
    lead = Fault("lead", 40.0, '{"do":"lead","slots":8,"from":1600,"to":900}')
    found = run(heater, rigs[0], lead)
    assert found.reason == "done"
    told = [line for line in found.lines if line.get("event") == "status"]
    # Told after a slot's count was decided: of the eighth there is nothing left.
    assert sum(line["led"] for line in told) == 7
    first = next(k for k, line in enumerate(told) if line["led"])
    law, memory, hottest = law_for(rigs[1]), LawState.start(1), []
    count: Any = np.zeros(1)
    leads = dict(zip(range(first, first + 8), np.linspace(16, 9, 8), strict=True))
    for k in range(found.columns.shape[1]):
        reading = rigs[1].reading
        count = np.full(1, count_of_test(k)) if k < TESTED else count
        if k >= TESTED and (k - TESTED) % 5 == 0:
            count, memory = decide(law, memory, np.array([reading]), leads.get((k - TESTED) // 5, np.nan))
        hottest.append(rigs[1].hottest - ZERO_CELSIUS)
        rigs[1].pass_time(int(count[0]), 0.1)
    assert np.abs(found.columns[5] - hottest).max() < 1.0


FAULTS = {
    "open": "thermometer broken",
    "short": "thermometer broken",
    "hot": "over-temperature",
    "over-current": "over-current",
    "no current": "no current",
    "switch": "switch stuck",
    "battery": "low battery",
    "button": "emergency stop",
    "abort": "stopped by command",
    "stuck": "thermometer stuck",
}


@needs_a_compiler
@pytest.mark.parametrize(
    ("fault", "since"), [*((fault, 12.03) for fault in FAULTS), ("stuck", 3.03), ("stuck", 47.03), ("switch", 40.03)]
)
def test_every_fault_switches_off_within_half_a_second(heater: Path, fault: str, since: float) -> None:
    found = run(heater, SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple()), Fault(fault, since))
    assert found.reason == FAULTS[fault]
    assert found.columns[0, -1] - since <= 0.5
    assert found.columns[1, -1] == 0
    assert found.columns[5].max() < SHORTED_LIMIT


@needs_a_compiler
@pytest.mark.parametrize("since", [2.03, 12.03, 50.03])
def test_a_clock_that_stands_still_ends_in_a_reset(heater: Path, since: float) -> None:
    found = run(
        heater, SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple()), Fault("clock", since)
    )
    assert found.reset
    assert found.columns[0, -1] - since <= 0.7
    assert found.columns[5].max() < plan().spec.limit + 10


@needs_a_compiler
@pytest.mark.parametrize(
    ("fault", "start", "why"),
    [
        ("switch", '{"do":"start","dry":true}', "no voltage: the switch is shorted, or the fuse is blown"),
        ("cut-out", '{"do":"start"}', "cut-out stuck"),
        ("cut-out", '{"do":"test"}', "cut-out stuck"),
        ("", '{"do":"test"}', "done"),
    ],
)
def test_a_switch_or_cut_out_that_is_stuck_is_named_cold(heater: Path, fault: str, start: str, why: str) -> None:
    rig = SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple())
    found = run(heater, rig, Fault(fault, 0.0), longest=3.0, start=start)
    assert why in {line.get("reason", line.get("text")) for line in found.lines}
    assert found.columns[5].max() < 35


@needs_a_compiler
@pytest.mark.parametrize("after", [-0.17, 0.03, 0.43, 0.63, 1.03, 10.03])
def test_a_thermometer_that_lost_touch_in_the_hold_heats_no_tube(heater: Path, after: float) -> None:
    # In the hold a reading that stays is what is wanted; only its flicker is missed. An old reading that is too low
    # must not raise the counts for the 20 s until it is named: that took the tube to 720 degC.
    rig = SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple())
    begins = 0.1 * TESTED + led().law.slot * led().law.hold[0]
    found = run(heater, rig, Fault("stuck", begins + after))
    assert found.reason in ("done", "thermometer stuck")
    assert found.columns[5].max() < plan().spec.limit


@needs_a_compiler
def test_a_reset_by_the_watchdog_leaves_it_off(heater: Path) -> None:
    environment = {**os.environ, "RESET_BY_WATCHDOG": "1"}
    told = subprocess.run([heater], input="", env=environment, capture_output=True, text=True, check=True).stdout
    lines = told.splitlines()
    assert json.loads(lines[1])["reason"] == "watchdog"
    assert lines[-1].startswith("= 0 0")


@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="no avr-gcc")
@pytest.mark.parametrize("converter", ["max31855", "max6675", "analog"])
def test_the_sketch_compiles_for_an_uno(tmp_path: Path, converter: str) -> None:
    write_sketch(plan(), led(), Wiring(converter=converter), tmp_path)
    command = "avr-gcc -mmcu=atmega328p -DF_CPU=16000000UL -Os -std=gnu++11 -Wall -Wextra -Werror -o heater.elf"
    sources = ["heater.cpp", "hardware_avr.cpp", "hardware_arduino.cpp"]
    subprocess.run([*command.split(), *sources], cwd=tmp_path / "tube_heater", check=True)
    size = subprocess.run(
        ["avr-size", "heater.elf"], cwd=tmp_path / "tube_heater", check=True, capture_output=True, text=True
    ).stdout.splitlines()[1]
    text, data, zero = (int(part) for part in size.split()[:3])
    assert text + data < 30_000  # of 32,256 bytes of flash
    assert data + zero < 1_400  # of 2,048 bytes of memory, the rest for the stack


@needs_a_compiler
@pytest.mark.parametrize(("board", "core"), [("esp32", "ESP32"), ("pico", "RP2040")])
def test_the_sketch_heats_on_other_boards(tmp_path: Path, board: str, core: str) -> None:
    wiring = Wiring(board=board)
    circuit = replace(plan().rig.circuit, pwm_frequency=pwm_frequency(wiring, plan().rig))
    asked = replace(plan(), rig=replace(plan().rig, circuit=circuit))
    write_sketch(asked, led(), wiring, tmp_path)
    other = built(tmp_path / "tube_heater", core)
    rig = SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple())
    found = run(other, rig)
    assert found.reason == "done"
    low, high = plan().spec.window_degC
    states = [line["state"] for line in found.lines if line["event"] == "status"]
    assert "holding" in states
    hottest = found.columns[4]
    assert low < hottest.max() < high
    fault = run(other, SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple()), Fault("open", 5.03))
    assert fault.reason == "thermometer broken"
    assert fault.columns[1, -1] == 0
    assert fault.columns[0, -1] < 5.53


def test_boards_have_the_frequencies_that_their_timers_have() -> None:
    # At 30.6 Hz a shorted switch would take the tube above 650 degC; with half the voltage it does not.
    assert pwm_frequency(Wiring(), thesis_rig()) == pytest.approx(122.55, abs=0.01)
    volts = tuple((charge, 0.5 * volt) for charge, volt in thesis_rig().battery.open_circuit)
    weaker = replace(thesis_rig(), battery=replace(thesis_rig().battery, open_circuit=volts))
    assert pwm_frequency(Wiring(), weaker) == pytest.approx(30.64, abs=0.01)
    assert pwm_frequency(Wiring(), replace(thesis_rig(), tube=None)) == pytest.approx(490.2, abs=0.1)
    assert pwm_frequency(Wiring(), thesis_rig(), 100.0) == pytest.approx(122.55, abs=0.01)
    # A circuit that is built keeps its pulses.
    built = replace(thesis_rig().circuit, hall_sensitivity=0.01, pwm_frequency=490.0)
    assert pwm_frequency(Wiring(), replace(thesis_rig(), circuit=built)) == pytest.approx(490.2, abs=0.1)
    with pytest.raises(InputError, match=r"pwm_Hz is 1000000; the sketch sets .* to 30.64 or 122.5 or 490.2 Hz"):
        pwm_frequency(Wiring(), thesis_rig(), 1e6)
    assert {board.name for board in BOARDS.values()} == {"uno", "nano", "esp32", "pico"}
    losing = replace(thesis_rig(), circuit=replace(thesis_rig().circuit, pwm_frequency=31.0, lost_on_time=5e-3))
    with pytest.raises(InputError, match="lost_on_time of the circuit is 5000 us; at 31 Hz it must be below 3264 us"):
        pwm_frequency(Wiring(), losing, 31.0)


@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("cells", [1, 2])
def test_a_battery_is_read_in_full_and_never_harms_its_pin(board: str, cells: int) -> None:
    # Both resistors in series carry the same current: that is all there is to a divider.
    volts = tuple((charge, cells * volt) for charge, volt in thesis_rig().battery.open_circuit)
    rig = replace(plan().rig, battery=replace(plan().rig.battery, open_circuit=volts))
    planned, wiring, reference = replace(plan(), rig=rig), Wiring(board=board), BOARDS[board].reference
    bought = {part.name: part.rating for part in parts_list(planned, wiring)}["divider"]
    upper, lower = (1e3 * float(number) for number in re.findall(r"([0-9.]+) kohm", bought))
    rest, step = rig.battery.voltage, _defined(board_header(wiring, planned), "VOLT_PER_STEP")
    assert 0.4 * reference < rest * lower / (upper + lower) < reference / 1.5
    assert step == pytest.approx(reference / BOARDS[board].steps * (upper + lower) / lower, rel=1e-6)
    readable = (BOARDS[board].steps - 1) * step
    assert readable > 1.2 * rest
    lowest = _defined(schedule_header(planned, led(), [(rest, led().law.planned)]), "LOWEST_VOLT")
    assert 0 < lowest < rest
    charges = [replace(rig.battery, state_of_charge=charge).voltage for charge in CHARGES]
    assert step < 0.1 * np.abs(np.diff(charges)).min()


@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("limit", [40.0, 200.0, 300.0, 600.0, 1100.0])
def test_the_current_at_which_the_board_stops_can_be_read(board: str, limit: float) -> None:
    planned = replace(plan(), rig=replace(plan().rig, circuit=replace(plan().rig.circuit, peak_limit=limit)))
    wiring, known = Wiring(board=board), BOARDS[board]
    parts = {part.name: part.rating for part in parts_list(planned, wiring)}
    bought = parts["current sensor"]
    limit = min(limit, 1.25 * full_current(TUBE, planned.rig))
    rating, slope = (float(number) for number in re.findall(r"([0-9.]+) (?:A|mV/A)", bought))
    assert rating >= 1.2 * limit
    # Such a sensor is made: 4 V from no current to the end of its range.
    assert 1e-3 * slope * rating == pytest.approx(4.0)
    # A sensor of 5 V must not feed more than 3.3 V to a pin.
    assert ("Schottky diode" in parts["current sensor"]) == (known.reference < 5)
    # What the sensor that is bought puts on the pin at the limit, and what the sketch reads there.
    volt = wiring.current_zero + 1e-3 * slope * limit
    assert volt < known.reference - 0.1 * (known.reference - wiring.current_zero)
    header = board_header(wiring, planned)
    step, zero = _defined(header, "AMPERE_PER_STEP"), int(re.findall("AMPERE_ZERO ([0-9]+)", header)[0])
    most = _defined(schedule_header(planned, led(), [(12.7, led().law.planned)]), "MOST_AMPERE")
    assert most == pytest.approx(limit)
    assert (int(volt / known.reference * known.steps) - zero) * step == pytest.approx(limit, abs=1.5 * step)
    assert (known.steps - 1 - zero) * step > 1.15 * most
    assert _defined(header, "LEAKING_AMPERE") >= 2.9 * step


def test_a_current_that_no_sensor_tells_is_refused() -> None:
    with pytest.raises(InputError, match="stops at 1200 A; for the ESP32 this must be at most 1167 A"):
        hall_slope(Wiring(board="esp32"), 1200.0)
    assert hall_slope(Wiring(), 1200.0) == 0.002
    with pytest.raises(InputError, match="at most 233 A"):
        hall_slope(Wiring(board="pico", shunt_V_per_A=0.01), 300.0)
    assert hall_slope(Wiring(board="esp32", measures_electrics=False), 1200.0) == 0.002


@pytest.mark.parametrize("board", BOARDS)
def test_every_shipped_rig_has_a_sensor_for_its_limit(board: str) -> None:
    for file in sorted(Path("configs/rigs").glob("*.yaml")):
        rig = load_rig(file)
        assert rig.tube is not None
        assert hall_slope(Wiring(board=board), stop_current(rig.tube, rig)) >= 0.01


def _defined(header: str, name: str) -> float:
    """A number that a header defines."""
    found = re.search(rf"#define {name} \(([-0-9.e]+)f\)", header)
    assert found is not None
    return float(found[1])


@pytest.mark.parametrize(("board", "factor"), [("uno", 0.45), ("pico", 0.507)])
def test_the_monostable_is_drawn_as_it_is_listed(board: str, factor: float) -> None:
    """Its time by the data sheet of NXP, K R C with K between 0.55 at 2 V and 0.45 at 5 V, is 1.5 periods."""
    wiring, frequency = Wiring(board=board), plan().rig.circuit.pwm_frequency
    parts = {part.name: part.rating for part in parts_list(plan(), wiring)}
    kohm = float(re.findall(r"([0-9.]+) kohm, 470 nF", parts["monostable"])[0])
    assert factor * kohm * 1e3 * 470e-9 == pytest.approx(1.5 / frequency, rel=0.05)
    supply = re.findall(r"74HC132 at ([0-9.]+ V)", parts["gate"])[0]
    assert float(supply.split()[0]) == wiring.known.reference
    # From its drain at rest, through 10 kohm, the diode holds the input a Schottky drop above the supply: a sure high,
    # which the chip survives.
    threshold = gate_threshold(wiring)
    assert wiring.known.reference / 2 < threshold < wiring.known.reference - 0.5
    assert f"Schottky diode (BAT54) from its input to {supply}" in parts["gate"]
    assert kohm >= 10
    figure = plot_wiring(ClosedLoopHeating(plan(), led(), wiring, frequency))
    drawn = [text.get_text() for text in figure.axes[1].texts]
    # The layout of pictures is quick in tests: heights alone tell whether list and notes fit below each other.
    figure.set_dpi(200)
    figure.draw_without_rendering()
    listed, notes = (text.get_window_extent() for text in figure.axes[2].texts)
    assert listed.height + notes.height < 0.93 * figure.bbox.height
    for value in (f"{kohm:g} kohm", "470 nF", supply, "BAT54,\nbar up", f"{wiring.known.pin('tick')}, tick"):
        assert value in drawn
    # The converter hangs on the pins of SPI in the core of the board, as hardware_arduino.cpp leaves them.
    for name in ("select", "clock", "data"):
        assert wiring.known.pin(name) in parts["thermometer"]
    assert [wiring.known.pins[name] for name in ("clock", "data")] == {"uno": ["13", "12"], "pico": ["18", "16"]}[board]
    assert "at 5 V of the supply" in parts["current sensor"]
    # Every chip has its supply, its ground, and no open input: 14 and 16 pins, those with a wire and those in the text.
    words = " ".join(drawn)
    assert {"14", "7", "1", "2", "3", "16", "8", "1 A", "2 B, 3 RD", "13 Q", "14 C", "15 RC"} <= set(drawn)
    assert "4, 5, 9, 10, 12,\n13 to ground" in words
    assert "9, 10, 11 to ground" in words


def test_parts_bear_the_currents() -> None:
    parts = {part.name: part.rating for part in parts_list(plan(), Wiring())}
    peak, safety = plan().peak_current, cut_out(plan())
    # The longest pulse takes a fifth of what melts the fuse, which is less than what the tube withstands.
    low = float(re.findall(r"([0-9.]+) A2s", parts["fuse"])[0])
    assert peak**2 * plan().duty.max() / 255 / plan().rig.circuit.pwm_frequency < 0.21 * low < low < safety.withstood
    assert int(parts["MOSFET"].split(", ")[1].split()[0]) >= peak
    assert int(parts["fuse"].split()[0]) <= 6 * float(parts["cable"].split()[0])
    # The main switch takes what the cut-out takes, and no wire of a pin is thinner than its fuse allows.
    assert parts["main switch"].split(", ")[2].split()[0] == parts["cut-out"].split(", ")[2].split()[0]
    assert int(parts["main switch"].split(", ")[2].split()[0]) >= peak
    # Battery and coil are of 12 V: no regulator could make 12 V of it. Two batteries need one.
    assert "; battery for driver and coil" in parts["supply"]
    assert "e+" not in "".join(parts.values())
    volts = tuple((charge, 2 * volt) for charge, volt in thesis_rig().battery.open_circuit)
    twice = replace(plan(), rig=replace(plan().rig, battery=replace(plan().rig.battery, open_circuit=volts)))
    assert "12 V regulator" in {part.name: part.rating for part in parts_list(twice, Wiring())}["supply"]
    thin = [float(section) for section in re.findall(r"([0-9.]+) mm2", parts["thin wires"])]
    assert int(parts["control fuse"].split()[0]) <= 6 * min(thin)


def simulated(limit: float = 558.0) -> SimulatedLine:
    """A simulated rig with its law."""
    rig = SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple())
    return SimulatedLine(rig, led().law, limit)


def test_a_run_is_logged_row_by_row(tmp_path: Path) -> None:
    found = run_heating(simulated(), log=tmp_path / "run" / "log.csv")
    assert found.done
    low, high = plan().spec.window_degC
    held = [row["temperature_degC"] for row in found.rows if row["state"] == "holding"]
    assert low < min(held)
    assert max(held) < high
    log = (tmp_path / "run" / "log.csv").read_text().splitlines()
    assert log[0] == "time_s,duty,temperature_degC,voltage_V,current_A"
    assert len(log) == len(found.rows) + 1
    # Before the first pulse there is no current to be told.
    assert log[1].endswith(",,")
    assert not log[-2].endswith(",")


@pytest.mark.parametrize(
    ("read", "missed", "words"),
    [
        ((501.0, 549.0), 0.0, "501.0 to 549.0 degC: window of 500 to 550 degC kept"),
        ((488.0, 503.0), 12.0, "488.0 to 503.0 degC: window of 500 to 550 degC missed by 12.0 K"),
        ((510.0, 551.5), 1.5, "510.0 to 551.5 degC: window of 500 to 550 degC missed by 1.5 K"),
        ((), None, "nothing was measured"),
    ],
)
def test_a_run_says_whether_its_readings_kept_the_window(
    read: tuple[float, ...], missed: float | None, words: str
) -> None:
    # Readings before the hold are below the window in every heating.
    told = [("heating", 300.0), *(("holding", value) for value in read)]
    rows = tuple({"state": state, "temperature_degC": value, "dry": False, "time_s": 1.0} for state, value in told)
    shown = HeatingRunReport(HeatingRun(rows, "done", window=(500.0, 550.0)))
    assert shown.record()["shortfall_K"] == missed
    assert dict(shown.rows())["in the hold"] == words
    if missed:
        with pytest.raises(SolveError, match=f"missed by {missed} K"):
            shown.conclude()
    else:
        shown.conclude()


def test_a_test_of_the_cutout_shows_no_readings() -> None:
    shown = HeatingRunReport(HeatingRun((), "done", opened=0.019, allowed=0.055))
    assert dict(shown.rows()) == {"ended": "done", "cut-out": "opened after 19 ms; the tube allows 55 ms"}


def test_a_sketch_for_a_heating_that_is_not_held_says_so() -> None:
    outcome = plan().outcome
    held = ClosedLoopHeating(plan(), led(), Wiring(), plan().rig.circuit.pwm_frequency)
    FeedbackReport(held).conclude()
    broken = replace(plan(), outcome=replace(outcome, broken=("the ramp is 9 K/s",)))
    with pytest.raises(SolveError, match="the ramp is 9 K/s"):
        FeedbackReport(replace(held, plan=broken)).conclude()
    with pytest.raises(SolveError, match=r"0 % of \d+ uncertain rigs"):
        FeedbackReport(replace(held, feedback=replace(led(), kept=0 * led().kept))).conclude()


def test_a_run_that_is_interrupted_stops_the_rig(tmp_path: Path) -> None:
    line = simulated()

    def stop(hello: object, row: dict[str, float]) -> None:
        if row["time_s"] > 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_heating(line, log=tmp_path / "log.csv", show=stop)
    last = line.receive()
    assert last is not None
    assert last["reason"] == "stopped by command"
    assert len((tmp_path / "log.csv").read_text().splitlines()) > 5


def test_a_dry_run_heats_nothing() -> None:
    line = simulated()
    found = run_heating(line, dry=True)
    assert line.hottest < 26
    assert found.reason == "done"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals")
def test_a_board_on_a_port_is_run_as_a_simulated_one() -> None:
    ours, theirs = os.openpty()
    rig = simulated()

    def board() -> None:
        for _ in range(2):
            asked = json.loads(port.readline())
            rig.send(asked.pop("do"), **asked)
            while (told := rig.receive()) is not None:
                port.write((json.dumps(told) + "\n").encode())

    tty.setraw(theirs)
    with os.fdopen(ours, "rb+", buffering=0) as port:
        thread = threading.Thread(target=board, daemon=True)
        thread.start()
        found = run_heating(SerialLine(os.ttyname(theirs)))
        thread.join(5)
    os.close(theirs)
    assert found.done
    with pytest.raises(InputError, match="--port is '/dev/no_such_port'; it must be a serial port"):
        SerialLine("/dev/no_such_port")


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals")
def test_a_line_that_is_lost_is_told() -> None:
    ours, theirs = os.openpty()
    line = SerialLine(os.ttyname(theirs))
    os.close(ours)
    with pytest.raises(SolveError, match="to the rig is lost"):
        run_heating(line)
    os.close(theirs)


def test_a_sketch_reads_what_it_has_a_converter_for() -> None:
    assert converter_for("camera") == "analog"
    with pytest.raises(InputError, match="converter of a camera is 'max6675'; it must be one of analog"):
        converter_for("camera", "max6675")
    with pytest.raises(InputError, match="sensor is 'resistance'; for a sketch it must be one of thermocouple, camera"):
        converter_for("resistance")


def test_a_shorted_switch_heats_as_another_integrator_says() -> None:
    safety, model = cut_out(plan()), thermal_model(TUBE, plan().rig, FINE)
    cold = integrate(model, safety.delay, [1.0])
    assert safety.shorts[0].peak == pytest.approx(cold.tube[-1].max() - ZERO_CELSIUS, abs=0.3)
    # At the budget, by energy: I^2 rho / A heats what does not have the time to lose it.
    last = safety.shorts[-1]
    rate = (last.peak - last.before) / safety.delay
    assert last.before + rate * safety.budget == pytest.approx(SHORTED_LIMIT, abs=3.0)
    assert last.peak == pytest.approx(safety.peak)
    assert last.before == pytest.approx(558.0)


@pytest.mark.parametrize("name", ["calcium_silicate", "mdf", "steel"])
def test_a_shorted_switch_leaves_the_tube_of_every_rig_below_650_degC(name: str) -> None:
    rig = load_rig(f"thesis_{name}")
    assert rig.tube is not None
    # Also with the pulses that the board chooses for it.
    slower = replace(rig.circuit, pwm_frequency=pwm_frequency(Wiring(), rig))
    assert not cut_out(plan_heating(rig.tube, replace(rig, circuit=slower), HeatingSpec(), cures=False)).problems
    safety = cut_out(plan_heating(rig.tube, rig, HeatingSpec()))
    assert len(safety.shorts) == 5
    assert max(short.peak for short in safety.shorts) <= safety.peak < SHORTED_LIMIT
    assert not safety.problems
    slow = replace(rig, circuit=replace(rig.circuit, cutout_opening=0.1))
    assert cutout_delay(slow) > safety.budget


def test_a_supply_that_needs_no_cut_out_takes_longer() -> None:
    resistor, limited = safe_supplies(plan())
    assert resistor.peak < SHORTED_LIMIT < resistor.peak + 1
    assert resistor.longer is not None
    assert resistor.longer > 60
    assert limited.warm_up == resistor.warm_up
    # Ohm's law: the resistor takes the battery's voltage at this current, less that of the tube.
    ohm, current = float(resistor.rating.split()[0]), float(limited.rating.split()[0])
    rig = plan().rig
    cold = rig.battery.voltage / full_current(TUBE, rig)
    assert current == pytest.approx(rig.battery.voltage / (cold + ohm), rel=0.03)


@pytest.mark.parametrize("rest", [6.0, 12.7, 25.5, 38.0])
def test_the_zener_of_the_coil_spares_its_transistor(rest: float) -> None:
    """Supply, Zener diode and diode together stay below the voltage of the transistor."""
    transistor, charged = np.ceil(2.5 * rest / 10) * 10, 1.15 * rest
    supply = charged if charged <= 15 else 12.0
    assert 5 < coil_zener(transistor, charged) < transistor - supply


def test_a_sketch_that_must_not_run_says_so_where_it_is_compiled(tmp_path: Path) -> None:
    tables = [(12.7, led().law.planned)]
    assert "DO NOT RUN" not in schedule_header(plan(), led(), tables)
    told = schedule_header(plan(), led(), tables, "the ramp is 9 K/s")
    assert told.startswith("// DO NOT RUN: the ramp is 9 K/s\n#warning DO NOT RUN")
    broken = replace(plan(), outcome=replace(plan().outcome, broken=("the ramp is 9 K/s",)))
    held = ClosedLoopHeating(broken, led(), Wiring(), plan().rig.circuit.pwm_frequency)
    FeedbackReport(held).save(tmp_path)
    assert "9 K/s" in (tmp_path / "tube_heater/schedule.h").read_text().split("#ifndef")[0]


def test_a_built_circuit_keeps_its_current_sensor_and_pulses() -> None:
    """In rig.yaml of every tube, in the wiring of `heat firmware`, and in the header for the board."""
    rig = replace(thesis_rig(), tube=TUBE)
    built = replace(rig, circuit=replace(rig.circuit, hall_sensitivity=0.005, pwm_frequency=490.0))
    assert pwm_frequency(Wiring(), rig) != 490.0
    assert pwm_frequency(Wiring(), built) == pytest.approx(490.0, rel=0.01)
    study = ClosedLoopStudy(kind="led_heating", rig=built)
    assert (study.wiring().shunt_V_per_A, Wiring().shunt_V_per_A) == (0.005, None)
    assert study.pulsed_rig().circuit.pwm_frequency == pytest.approx(490.0, rel=0.01)
    steps = [_defined(board_header(wiring, plan()), "AMPERE_PER_STEP") for wiring in (study.wiring(), Wiring())]
    assert steps[0] == pytest.approx(steps[1] * hall_slope(Wiring(), stop_current(TUBE, rig)) / 0.005)
    wiring = Wiring(shunt_V_per_A=0.005)
    part = TubeParts(1, Mock(), Mock(), Heating(plan()), ClosedLoopHeating(plan(), led(), wiring, 122.5))
    assert part.rig.circuit.hall_sensitivity == 0.005
    assert replace(part, led=None).rig.circuit.hall_sensitivity is None


def test_fuses_outlive_lasting_corrections() -> None:
    """The rms current is that of the rig whose corrections heat most over 10 s."""
    held = plan()
    slots = len(held.duty)
    counts = np.column_stack([held.duty, np.full(slots, 2.0 * held.duty.max())])
    history = Mock(count=counts, index=np.column_stack([np.arange(slots)] * 2))
    corrected = replace(held, feedback=Mock(history=history))
    window = round(10.0 / held.spec.slot)
    square = 2.0 * held.duty.max() / 255 * held.current**2
    expected = max(np.sqrt(square[k : k + window].mean()) for k in range(slots - window + 1))
    assert root_mean_square(corrected) == pytest.approx(expected)
    assert expected > 1.2 * root_mean_square(held)
    assert fuse_of(corrected) >= 1.25 * expected


def test_a_circuit_of_several_tubes_has_the_largest_ratings_and_the_fuse_of_each() -> None:
    """One draws the larger current, and the other has the larger rms current: no rating is below that of a tube."""
    strong = replace(plan(), outcome=replace(plan().outcome, peak_current=1.3 * plan().peak_current))
    longer = replace(plan(), course=replace(plan().course, duty=np.minimum(4 * plan().duty, 255)))
    both = strong, longer
    of_two = {part.name: part.rating for part in shared_parts(dict(enumerate(both, start=1)), Wiring())}
    alone = [{part.name: part.rating for part in parts_list(each, Wiring())} for each in both]
    for each in both:
        drawn = {part.name: part.rating for part in ClosedLoopHeating(each, led(), Wiring(), 1.0, both).parts}
        assert drawn.pop("fuse") in of_two["fuse"]
        assert drawn == {name: rating for name, rating in of_two.items() if name != "fuse"}
    assert of_two["fuse"].startswith("tube 1: ")
    for name, k in {"cable": 1, "TVS diode": 0, "main switch": 0}.items():
        assert of_two[name] == alone[k][name] != alone[1 - k][name]
    assert shared_parts({2: longer}, Wiring()) == parts_list(longer, Wiring())


@pytest.mark.parametrize("clamp", [14.0, 24.0, 40.0])
def test_a_clamp_takes_what_the_loop_stores_and_the_battery_adds(clamp: float) -> None:
    """Against an integration of L i' = battery - R i - clamp until the current has ended."""
    battery, current, step = 12.7, 73.0, 1e-9
    i, energy = current, 0.0
    while i > 0:
        energy += clamp * i * step
        i += step / boards.LOOP_INDUCTANCE * (battery * (1 - i / current) - clamp)
    assert boards.clamped_energy(current, battery, clamp) == pytest.approx(energy, rel=2e-3)


def test_the_fuse_outlives_pulses_that_the_feedback_lengthens() -> None:
    """Five times the longest pulse that the law allows, rounded up."""
    law = led().law
    longest = max(float(law.planned.max()), min((1 + law.share) * law.planned.max(), law.bare_count, MOST_COUNT))
    corrected = cut_out(replace(plan(), feedback=led()))
    expected = plan().peak_current ** 2 * longest / 255 / plan().rig.circuit.pwm_frequency
    assert expected <= corrected.pulse <= expected * (1 + 2 / longest)
    assert corrected.pulse > 1.2 * cut_out(plan()).pulse
    rating = parts_list(replace(plan(), feedback=led()), Wiring())[2].rating
    assert 5 * expected <= float(re.findall(r"([0-9.]+) A2s", rating)[0]) < 5.6 * expected
    assert [upward(value) for value in (1.14, 1.43, 18.5, 0.2, 261.0)] == ["1.2", "1.5", "19", "0.2", "270"]


def test_a_correction_beyond_full_pulses_does_not_wind_up() -> None:
    """A tube far behind gets full pulses; when it has caught up, the count comes back at once."""
    law = replace(led().law, planned=np.full(40, 200.0), reference=np.full(40, 500.0), hold=(1, 40), share=2.0,
                  proportional=0.0, integral=0.01, lost=0.0, holdback=1e9, bare_count=math.inf)  # fmt: skip
    state = LawState.start(1)
    for _ in range(30):
        count, state = decide(law, state, np.array([450.0]))
    assert count[0] == MOST_COUNT
    assert state.total[0] == pytest.approx(MOST_COUNT / 200 - 1)
    assert _defined(schedule_header(plan(), led(), [(12.7, led().law.planned)]), "BARE_COUNT") <= MOST_COUNT


def test_another_chemistry_needs_its_own_numbers() -> None:
    own = {"open_circuit_V": [[0.1, 12.8], [1.0, 13.4]], "internal_resistance_mohm": 3, "sag_resistance_mohm": 2,
           "sag_time_s": 20}  # fmt: skip
    rig = rig_from_dict({"kind": "rig", "battery": {"chemistry": "lithium_iron_phosphate", **own}})
    assert rig_from_dict(rig_to_dict(rig)) == rig
    for missing in own:
        kept = {key: value for key, value in own.items() if key != missing}
        with pytest.raises(InputError, match=f"lithium_iron_phosphate battery without {missing}"):
            rig_from_dict({"kind": "rig", "battery": {"chemistry": "lithium_iron_phosphate", **kept}})
    with pytest.raises(InputError, match="chemistry of the battery is other"):
        Battery(chemistry="other")
    assert "lithium-iron-phosphate, 60 Ah, 3 mohm and 2 more after 20 s" in next(
        part.rating for part in parts_list(replace(plan(), rig=replace(plan().rig, battery=rig.battery)), Wiring())
    )
