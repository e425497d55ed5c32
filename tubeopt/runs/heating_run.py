"""A heating on a rig, led by its board or simulated: start it, follow what it reports, log every row as it comes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, SolveError
from ..shaping.feedback.feedback import lead_by
from ..shaping.feedback.sensors import Thermocouple
from ..shaping.firmware.line import Line, SerialLine, SimulatedLine
from ..shaping.firmware.simulated import SimulatedRig
from ..shaping.firmware.sketch_files import OVERSHOOT
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.robust import ENSEMBLE
from ..shaping.heating.spec import HeatingSpec
from ..shaping.heating.thermal import thermal_model
from .rig_file import LOG_COLUMNS, load_rig

SILENCE = 5
"""Seconds without a word from the rig after which it counts as lost."""


@dataclass(frozen=True)
class HeatingRun:
    """A heating that was run.

    rows: what the rig reported, slot by slot. reason: why it ended. log: where it was written. name: of the rig.
    """

    rows: tuple[dict[str, Any], ...]
    reason: str
    log: Path | None = None
    name: str = "rig"

    @property
    def done(self) -> bool:
        """Whether the whole schedule was run through."""
        return self.reason == "done"

    @property
    def hottest(self) -> float:
        """Greatest reading, degC."""
        return float(max((row["temperature_degC"] for row in self.rows), default=np.nan))

    @property
    def time(self) -> float:
        """How long it took, s."""
        return float(self.rows[-1]["time_s"]) if self.rows else 0.0


def open_line(port: str | None, simulate: str | None, speed: float = 20.0) -> Line:
    """The line to a board, or to a simulated rig, planned and led on the spot by a thermocouple.

    Raises:
        InputError: neither or both are given, no such port or file, or the rig's file names no tube.
    """
    if (port is None) == (simulate is None):
        raise InputError("--port PORT or --simulate RIG.yaml must be given, and not both")
    if port is not None:
        return SerialLine(port)
    rig = load_rig(str(simulate))
    if rig.tube is None:
        raise InputError(f"{simulate}: the rig file names no tube; it must, to be simulated")
    plan = plan_heating(rig.tube, rig, HeatingSpec(objective="margin"))
    sensor = Thermocouple()
    law = lead_by(plan, sensor, samples=20).law
    simulated = SimulatedRig(thermal_model(rig.tube, rig, ENSEMBLE), sensor)
    return SimulatedLine(simulated, law, plan.spec.limit + OVERSHOOT, speed)


def run_heating(
    line: Line,
    *,
    dry: bool = False,
    log: Path | None = None,
    show: Callable[[dict[str, Any], dict[str, Any]], None] | None = None,
) -> HeatingRun:
    """Start a rig and follow it to its end; where this is interrupted, the rig is stopped first.

    Args:
        line: to it. dry: everything but the current. log: CSV, written row by row. show: gets what the rig said of
            itself and every report.

    Raises:
        SolveError: the rig does not answer.
        InputError: the rig refuses to start, and why.
    """
    rows: list[dict[str, Any]] = []
    if log is not None:
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text(",".join(LOG_COLUMNS) + "\n", encoding="utf-8")
    try:
        line.send("hello")
        hello = _next(line, "hello")
        line.send("start", **({"dry": True} if dry else {}))
        while True:
            found = _next(line, "status", "error")
            if found["event"] == "error":
                raise InputError(f"the rig does not start: {found.get('text', '')}")
            if found["state"] == "idle":
                continue
            rows.append(found)
            if log is not None:
                _append(log, found)
            if show is not None:
                show(hello, found)
            if found["state"] == "stopped":
                return HeatingRun(tuple(rows), str(found["reason"]), log)
    except BaseException:
        # Whatever happens here, nothing stays hot there.
        line.send("stop")
        raise
    finally:
        line.close()


def _next(line: Line, *events: str) -> dict[str, Any]:
    """The next report of one of these kinds."""
    silent = 0
    while silent < SILENCE:
        found = line.receive()
        silent = silent + 1 if found is None else 0
        if found and found.get("event") in events:
            return found
    raise SolveError(f"the rig has not answered for {SILENCE} s; its watchdog stops it where its board hangs")


def _append(log: Path, row: dict[str, Any]) -> None:
    """Write one row, and let it reach the disk."""
    volt, ampere = row["voltage_V"], row["current_A"]
    on = row["count"] > 0
    cells = (
        f"{row['time_s']:g}",
        "0" if row["dry"] else str(row["count"]),
        f"{row['temperature_degC']:g}",
        # Both are those while the switch conducts.
        "" if volt is None or not on else f"{volt:g}",
        "" if ampere is None or not on else f"{ampere:g}",
    )
    with log.open("a", encoding="utf-8") as file:
        file.write(",".join(cells) + "\n")
