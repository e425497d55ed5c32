"""The firmware on this computer, in step with the thermal model of a rig; and what can go wrong with one."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tubeopt.constants import ZERO_CELSIUS
from tubeopt.shaping.firmware.line import SimulatedRig
from tubeopt.shaping.heating.thermal import curved_temperatures
from tubeopt.typing import Array

COMPILER = shutil.which("g++") or shutil.which("clang++")
TICK, AMBIENT = 0.1, 25.0
HOLD, WATCHDOG = 0.28, 0.5
"""Time after which ticks that end let the cut-out open, and without food for the watchdog, s."""
DELAY = 0.03
"""Time until the cut-out opens where the drain stays low, s: that of the thesis' rig at 122 Hz."""


CORE = Path(__file__).parent / "arduino_core"


def built(folder: Path, core: str = "", options: tuple[str, ...] = ()) -> Path:
    """The heater of a sketch with host.cpp for a board; or with that of an Arduino core, as much as it takes."""
    out = folder / "host"
    board = [
        f"-DARDUINO_ARCH_{core}", "-DARDUINO=1", f"-I{CORE}", "-I.", "hardware_arduino.cpp", str(CORE / "core.cpp"),
    ]  # fmt: skip
    command = [
        str(COMPILER),
        "-std=c++11",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O1",
        *options,
        "heater.cpp",
        *(board if core else ["host.cpp"]),
        "-o",
        str(out),
    ]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return out


@dataclass
class Fault:
    """What goes wrong from a time on, s: what the heater is told in place of the truth."""

    name: str = ""
    since: float = 1e9
    command: str = ""


@dataclass
class Run:
    """rows: time, count, reading, coldest and hottest of the curved part, hottest point. lines: of the heater."""

    rows: list[tuple[float, ...]] = field(default_factory=list)
    lines: list[dict[str, Any]] = field(default_factory=list)

    reset: bool = False
    """The watchdog has reset it."""

    @property
    def columns(self) -> Array:
        """(6, T)."""
        return np.array(self.rows).T

    @property
    def reason(self) -> str:
        """Why it ended."""
        return str(self.lines[-1].get("reason", ""))


def run(
    heater: Path,
    rig: SimulatedRig,
    fault: Fault | None = None,
    longest: float = 200.0,
    start: str = '{"do":"start"}',
) -> Run:
    """Start the heater and go on until it has stopped, or its watchdog has."""
    fault = fault or Fault()
    found = Run()
    with subprocess.Popen([heater], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None

        def answer() -> tuple[int, ...]:
            while not (line := process.stdout.readline()).startswith("="):  # type: ignore[union-attr]
                with contextlib.suppress(ValueError):  # a reset breaks a line off
                    found.lines.append(json.loads(line))
            return tuple(int(word) for word in line[1:].split())

        (count, *_), command, frozen = answer(), start, None
        # The monostable lets go of the cut-out, and the watchdog resets the board, once they are not retriggered.
        closed, ticked, fed, stopped_clock = False, -1e9, 0.0, 0.0
        for k in range(round(longest / TICK)):
            # What the wires show: the heater corrects it.
            share = rig.sensor.correction / (rig.hot - AMBIENT)
            reading = (rig.reading + share * AMBIENT) / (1 + share)
            wrong = fault.name if rig.time >= fault.since else ""
            shorted = wrong == "switch"
            welded = wrong == "cut-out"
            volt, on = rig.electrics((count > 0 or shorted) and (closed or welded))
            off, button = on if shorted else 0.0, 0
            if shorted and not closed:
                volt = 0.0
            if wrong == "open":
                reading = float("nan")
            elif wrong == "short":
                reading = -200.0
            elif wrong == "stuck":
                frozen = reading if frozen is None else frozen
                reading = frozen
            elif wrong == "hot":
                reading = 600.0
            elif wrong == "over-current":
                on = 260.0
            elif wrong == "no current":
                on = 0.0
            elif wrong == "battery":
                volt = 6.0
            elif wrong == "button":
                button = 1
            elif wrong == "abort":
                command = '{"do":"stop"}'
            elif wrong == "lead":
                command, fault = fault.command, Fault()
            if wrong != "clock":
                stopped_clock = rig.time
            told = f"{round(1000 * stopped_clock)} {reading} {volt} {on} {off} {button} {command}"
            process.stdin.write(told + "\n")
            process.stdin.flush()
            command = ""
            count, holds, alive = answer()
            if not holds:
                ticked = -1e9
            elif not shorted and wrong != "clock":
                ticked = rig.time
            closed, fed = rig.time - ticked < HOLD, rig.time if alive else fed
            if rig.time - fed > WATCHDOG:
                found.reset = True
                count = 0
            tube = rig.state.cells[:, :, 0]
            curved = curved_temperatures(rig.model, tube) - ZERO_CELSIUS
            found.rows.append((rig.time, count, reading, curved.min(), curved.max(), tube.max() - ZERO_CELSIUS))
            if found.reset or (k and found.lines and found.lines[-1].get("state") == "stopped"):
                break
            # The switch conducts in pulses, or always; without the cut-out nothing flows.
            flows = 255 if shorted else count
            if not closed and not welded:
                flows = 0
            elif shorted:
                rig.pass_time(255, DELAY)
                rig.pass_time(0, TICK - DELAY)
                ticked = -1e9
                continue
            rig.pass_time(flows, TICK)
        process.stdin.close()
    return found
