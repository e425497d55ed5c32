"""Run of a heating on a rig or in a simulation: start it, read its reports, log every row immediately."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from ..display import Displayed
from ..errors import InputError, SolveError
from ..files.checked import Positive, in_file, require_one
from ..files.field_metadata import unit
from ..shaping.firmware.line import Line, SerialLine, SimulatedLine, SimulatedRig
from ..shaping.heating.controller import HeatingLaw
from ..shaping.heating.cutout import cut_out, cutout_delay
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.replanning import Replanner, planner_for
from ..shaping.heating.rig import Rig
from ..shaping.heating.robust import design_feedback
from ..shaping.heating.sensors import Sensor, Thermocouple
from ..shaping.heating.spec import HeatingSpec
from ..shaping.heating.thermal import FINE, thermal_model
from ..typing import Progress
from .study_file import Study
from .workshop_file import LOG_COLUMNS, load_rig

LOG_FILE = "log.csv"
"""Name of the log in the directory of a run."""

Show = Callable[[dict[str, Any], dict[str, Any]], object]
"""Callback with the greeting of the rig and its latest report."""

REPORTED = {"state", "time_s", "temperature_degC", "reference_degC", "count", "place", "voltage_V", "current_A"} | {
    "reason",
    "dry",
}
"""Keys of a status report; a message without all of them is ignored as noise on the line."""

MAX_SILENCE = 5
"""Number of reads of one second without a message after which the rig counts as lost."""


@dataclass(frozen=True)
class HeatingRun(Displayed):
    """Log of a finished heating."""

    rows: tuple[dict[str, Any], ...]
    """Reports of the rig, one per slot."""
    reason: Annotated[str, "reason for the end"]
    log: Path | None = None
    """Path of the log file; None without one."""
    name: str = "rig"
    """Name of the rig."""
    window: Annotated[tuple[float, float] | None, unit("degC"), "temperature window of the hold"] = None
    """Temperature window, degC; None if the rig has none."""
    opened: Annotated[float | None, unit("ms"), "time in which the cut-out opened, of a test"] = None
    """Time in which the cut-out opened, ms; None without a test."""
    allowed: Annotated[float | None, unit("ms"), "longest time that the tube allows"] = None

    @property
    def done(self) -> bool:
        """True if the heating schedule was completed."""
        return self.reason == "done"

    @property
    def hottest(self) -> float:
        """Highest reading, degC."""
        return float(max((row["temperature_degC"] for row in self.rows), default=np.nan))

    @property
    def held(self) -> tuple[float, float] | None:
        """Lowest and highest reading during the hold time, degC; None before it."""
        read = [row["temperature_degC"] for row in self.rows if row["state"] == "holding" and not row["dry"]]
        return (float(min(read)), float(max(read))) if read else None

    @property
    def shortfall(self) -> float | None:
        """Largest distance of a reading from the window during the hold time, K; None without readings."""
        if self.held is None or self.window is None:
            return None
        return max(self.window[0] - self.held[0], self.held[1] - self.window[1], 0.0)

    @property
    def time(self) -> float:
        """Duration, s."""
        return float(self.rows[-1]["time_s"]) if self.rows else 0.0


class HeatingRunStudy(Study):
    """A heating run, controlled by a board or simulated."""

    doing = "heating"

    kind: Literal["heating_run"]
    port: str | None = Field(
        None, description="serial port of the board with the sketch, such as /dev/ttyACM0 or COM3", examples=["PORT"]
    )
    simulate: Annotated[Rig, in_file(load_rig, "a rig file", kind=Rig)] | None = Field(
        None, description="rig file of a simulated rig and controller, instead of a board", examples=["RIG.yaml"]
    )
    rig: Annotated[Rig, in_file(load_rig, "a rig file", kind=Rig)] | None = Field(
        None, description="rig file of the connected rig, required to replan", examples=["RIG.yaml"]
    )
    replan_s: Positive | None = Field(
        None,
        description="time between two plans of the remaining heating on this "
        "computer; by default the board's controller works alone",
    )
    dry: bool = Field(False, description="run without current")
    test_cutout: bool = Field(
        False, description="bench test instead of a heating: pulses flow, the cut-out must end them in time"
    )
    speed: Positive = Field(Decimal(20), description="speed of the simulation, as a multiple of real time")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        require_one(self, "port", "simulate")
        if self.port is not None and self.replan_s is not None and self.rig is None:
            raise ValueError("rig is missing; it is required to replan for a board on a port")
        for name, rig in (("simulate", self.simulate), ("rig", self.rig)):
            if rig is not None and rig.tube is None:
                raise ValueError(f"{name}: the rig file has no tube; it must have the tube to heat")
        return self

    def open(self) -> tuple[Line, Replanner | None]:
        """Open the line to the board or the simulated rig, and prepare replanning if requested.

        Raises:
            InputError: the port cannot be opened.
        """
        rig, needs_plan = self.simulate or self.rig, self.simulate is not None or self.replan_s is not None
        # The board has its own controller: this computer needs one only to simulate or to replan.
        design = default_feedback(rig) if rig is not None and needs_plan else None
        leader = (
            None if design is None or self.replan_s is None else Replanner(planner_for(*design), self.si("replan_s"))
        )
        if self.port is not None:
            return SerialLine(self.port), leader
        assert design is not None
        plan, law, sensor = design
        simulated = SimulatedRig(thermal_model(plan.tube, plan.rig, FINE), sensor)
        opening = math.ceil(1e3 * cutout_delay(plan.rig)), math.floor(1e3 * cut_out(plan).budget)
        return SimulatedLine(simulated, law, law.ceiling, self.si("speed"), plan.spec.window_degC, opening), leader

    def run_in(self, out: Path | None, progress: Progress | None = None) -> HeatingRun:
        """Run the heating, with a log in `out`."""
        bar = progress or (lambda done, total: None)
        return self.run_on(out, *self.open(), lambda hello, row: bar(row["place"], int(hello.get("slots", 0))))

    def run_on(self, out: Path | None, line: Line, leader: Replanner | None, show: Show) -> HeatingRun:
        """Run the heating over a line from `open`, with a log in `out`."""
        if self.test_cutout:
            return measure_cutout(line)
        log = None if out is None else out / LOG_FILE
        return run_heating(line, dry=self.dry, log=log, show=show, leader=leader)


class FeedbackDesign(NamedTuple):
    """Heating plan with its feedback controller."""

    plan: HeatingPlan
    law: HeatingLaw
    sensor: Sensor


def default_feedback(rig: Rig) -> FeedbackDesign:
    """Default plan and controller of `tubeopt heat firmware` for the tube of a rig, with a thermocouple."""
    assert rig.tube is not None
    sensor = Thermocouple()
    plan = plan_heating(rig.tube, rig, HeatingSpec(objective="margin"))
    return FeedbackDesign(plan, design_feedback(plan, sensor, samples=20).law, sensor)


def measure_cutout(line: Line) -> HeatingRun:
    """Open the cut-out under pulses and read how long the current lasts; errors as `run_heating`."""
    try:
        line.send("hello")
        hello = _next(line, "hello")
        line.send("test")
        while True:
            row = _next(line, "cutout", "status", "error")
            if row["event"] == "error":
                raise InputError(f"the rig does not start: {row.get('text', '')}")
            if row["event"] == "cutout":
                opened, allowed = 1e-3 * row["opened_ms"], 1e-3 * row["allowed_ms"]
                return HeatingRun((), "done", None, str(hello.get("firmware", "rig")), None, opened, allowed)
            if row["state"] == "stopped" and row["reason"] not in ("", "done"):
                return HeatingRun((row,), str(row["reason"]), None, str(hello.get("firmware", "rig")))
    except BaseException:
        with contextlib.suppress(SolveError):
            line.send("stop")
        raise
    finally:
        line.close()


def run_heating(
    line: Line,
    *,
    dry: bool = False,
    log: Path | None = None,
    show: Show | None = None,
    leader: Replanner | None = None,
) -> HeatingRun:
    """Start a heating and read its reports to the end; an interruption stops the rig.

    Args:
        line: line to the rig.
        dry: run without current.
        log: CSV file, written row by row.
        show: called with the greeting of the rig and every report.
        leader: plans the remaining heating again and sends it to the rig.

    Raises:
        SolveError: the rig does not answer.
        InputError: the rig refuses to start; the message has its reason.
    """
    rows: list[dict[str, Any]] = []
    if log is not None:
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text(",".join(LOG_COLUMNS) + "\n", encoding="utf-8")
    try:
        line.send("hello")
        # The board answers before it heats: a wrong port or sketch is found cold.
        hello = _next(line, "hello")
        line.send("start", **({"dry": True} if dry else {}))
        while True:
            row = _next(line, "status", "error")
            if row["event"] == "error":
                raise InputError(f"the rig does not start: {row.get('text', '')}")
            # Reports from before the start command are still on the line.
            if row["state"] == "idle":
                continue
            if log is not None:
                # Logged before anything else: a crash below loses no measurement.
                _append(log, row, rows[-1]["count"] if rows else 0)
            rows.append(row)
            if leader is not None and (advice := leader.advise(row)) is not None:
                line.send("lead", **advice)
            if show is not None:
                show(hello, row)
            if row["state"] == "stopped":
                window = hello.get("window_degC")
                return HeatingRun(tuple(rows), str(row["reason"]), log, window=window and (window[0], window[1]))
    except BaseException:
        # The rig must never stay hot, whatever failed here; a broken line cannot be written to.
        with contextlib.suppress(SolveError):
            line.send("stop")
        raise
    finally:
        line.close()


def _next(line: Line, *events: str) -> dict[str, Any]:
    """Next report of one of some kinds."""
    silent = 0
    while silent < MAX_SILENCE:
        report = line.receive()
        # Only silence is a fault: any report shows that the board runs.
        silent = silent + 1 if report is None else 0
        if report and report.get("event") in events and (report["event"] != "status" or report.keys() >= REPORTED):
            return report
    raise SolveError(f"the rig has not answered for {MAX_SILENCE} s; its watchdog stops it if the board hangs")


def _append(log: Path, row: dict[str, Any], before: int) -> None:
    """Append a row to the log; `before` is the count of the slot that has ended."""
    volt, ampere = row["voltage_V"], row["current_A"]
    # A report at the start of a slot was measured in the previous one, where pulses of one count may be too short.
    on = min(before, row["count"]) > 1 and not row["dry"]
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
