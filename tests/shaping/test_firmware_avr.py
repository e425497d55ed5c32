"""The sketch as compiled for an Uno, in a simulated ATmega328P: what goes wrong with a rig or with the board itself."""

from __future__ import annotations

import ctypes.util
import shutil
import subprocess
from pathlib import Path

import pytest

from tubeopt import Thermocouple
from tubeopt.shaping.firmware.boards import Wiring
from tubeopt.shaping.firmware.line import SimulatedRig
from tubeopt.shaping.firmware.sketch_files import write_sketch
from tubeopt.shaping.heating.cutout import SHORTED_LIMIT
from tubeopt.shaping.heating.thermal import thermal_model
from tubeopt.shaping.heating.uncertainty import ENSEMBLE

from .firmware_host import Fault, Run, run
from .heating_reference import TUBE, thesis_rig
from .test_feedback import led, plan

pytestmark = pytest.mark.skipif(
    None in (shutil.which("avr-gcc"), shutil.which("gcc"), ctypes.util.find_library("simavr")),
    reason="no avr-gcc, or no libsimavr-dev",
)

HARNESS = Path(__file__).with_name("simavr_host.c")
START, DRY, BENCH = ('{"do":"start"}', '{"do":"start","dry":true}', '{"do":"test"}')

FAULTS = {
    # Of the rig, while it heats.
    "thermometer cut": ("open", 1.53, "", START, "thermometer broken"),
    "thermometer shorted": ("short", 1.53, "", START, "thermometer broken"),
    "thermometer without touch": ("stuck", 4.03, "", START, "thermometer stuck"),
    "tube too hot": ("hot", 1.53, "", START, "over-temperature"),
    "too much current": ("over-current", 1.53, "", START, "over-current"),
    "wire of the tube cut": ("no current", 3.03, "", START, "no current"),
    "switch shorted": ("switch", 1.53, "", START, "switch stuck"),
    "battery empty": ("battery", 1.53, "", START, "low battery"),
    "stop button": ("button", 1.53, "", START, "emergency stop"),
    "command": ("abort", 1.53, "", START, "stopped by command"),
    # Of the rig, before it heats.
    "switch shorted before a dry run": ("switch", 0.0, "", DRY, ""),
    "cut-out welded": ("cut-out", 0.0, "", START, "cut-out stuck"),
    "cut-out welded in its test": ("cut-out", 0.0, "", BENCH, "cut-out stuck"),
    # Of the board.
    "clock stands still": ("clock", 1.53, "", START, "reset"),
    "program hangs": ("lead", 1.53, "!hang", START, "reset"),
    "data of the converter at plus": ("lead", 1.53, "!ones", START, "thermometer broken"),
    "data of the converter at minus": ("lead", 1.53, "!zeros", START, "thermometer broken"),
}
"""Fault, when it begins, command to the simulator, start, and what the board says."""


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Program that runs the sketch in an ATmega328P."""
    folder = tmp_path_factory.mktemp("avr")
    write_sketch(plan(), led(), Wiring(), folder)
    folder /= "tube_heater"
    sketch = "avr-gcc -mmcu=atmega328p -DF_CPU=16000000UL -Os -std=gnu++11 -o heater.elf heater.cpp hardware_avr.cpp"
    subprocess.run(sketch.split(), cwd=folder, check=True)
    harness = f"gcc -O2 -Wall -Wextra -Werror -I. {HARNESS} -o simulator -lsimavr -lm"
    subprocess.run(harness.split(), cwd=folder, check=True)
    program = folder / "board"
    program.write_text(f"#!/bin/sh\nexec {folder}/simulator {folder}/heater.elf\n", encoding="utf-8")
    program.chmod(0o755)
    return program


def heated(board: Path, fault: Fault, longest: float, start: str = START) -> Run:
    """A heating of the thesis' tube by this board."""
    rig = SimulatedRig(thermal_model(TUBE, thesis_rig(), ENSEMBLE), Thermocouple())
    return run(board, rig, fault, longest=longest, start=start)


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_ends_with_the_switch_off(board: Path, name: str) -> None:
    fault, since, command, start, why = FAULTS[name]
    found = heated(board, Fault(fault, since, command), since + 2.0, start)
    if why == "reset":
        # The watchdog takes half a second; then the board says hello anew, with all off. In this simulator it resets
        # twice, so that the board knows no reason, as with Optiboot.
        assert sum(line["event"] == "hello" for line in found.lines) == 2
        assert found.columns[0, found.columns[1] > 0].max() - since <= 0.7
        assert found.lines[-1]["event"] == "hello" or found.reason == "watchdog"
    elif why:
        assert found.reason == why
        # A pulse of one count tells no lack of current.
        assert found.columns[0, -1] - since <= (1.0 if why == "no current" or not since else 0.5)
    else:
        assert found.lines[-1]["text"] == "no voltage: the switch is shorted, or the fuse is blown"
    assert found.columns[1, -1] == 0
    assert found.columns[5].max() < min(SHORTED_LIMIT, 150)


def test_a_heating_begins_as_on_this_computer(board: Path) -> None:
    """Counts and readings of the first seconds follow the reference; nothing is named."""
    found = heated(board, Fault(), 4.0)
    told = [line for line in found.lines if line.get("state") == "heating"]
    assert len(told) == 7
    assert all(abs(line["temperature_degC"] - line["reference_degC"]) < 8 for line in told)
    assert not any(line["reason"] for line in told)
    assert 11 < told[-1]["voltage_V"] < 13
    assert 60 < told[-1]["current_A"] < 100
