"""A heating on a rig, led by its board or simulated: start it, follow what it reports, log every row as it comes."""

from __future__ import annotations

import contextlib
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
from ..shaping.firmware.sketch_files import OVERSHOOT
from ..shaping.heating.controller import HeatingLaw
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.replanning import Leader, planner_for
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
"""Gets what a rig said of itself, and a report of it."""

REPORTED = {"state", "time_s", "temperature_degC", "reference_degC", "count", "place", "voltage_V", "current_A"} | {
    "reason",
    "dry",
}
"""Keys of every report on the state; one without all of them is passed over, as noise on the line is."""

SILENCE = 5
"""Seconds without a word from the rig after which it counts as lost."""


@dataclass(frozen=True)
class HeatingRun(Displayed):
    """A heating that was run."""

    rows: tuple[dict[str, Any], ...]
    """What the rig reported, slot by slot."""
    reason: Annotated[str, "reason for the end"]
    log: Path | None = None
    """Where it was written."""
    name: str = "rig"
    """Of the rig."""
    window: Annotated[tuple[float, float] | None, unit("degC"), "temperature window of the hold"] = None
    """None where the rig has none."""

    @property
    def done(self) -> bool:
        """Whether the whole schedule was run through."""
        return self.reason == "done"

    @property
    def hottest(self) -> float:
        """Greatest reading, degC."""
        return float(max((row["temperature_degC"] for row in self.rows), default=np.nan))

    @property
    def held(self) -> tuple[float, float] | None:
        """Least and greatest reading from the hold's first slot on, degC; None where nothing was heated so far."""
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
        """How long it took, s."""
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

    def open(self) -> tuple[Line, Leader | None]:
        """The line to the board, or to the simulated rig, and what plans the rest anew where that is asked for; raises
        InputError where the port cannot be opened."""
        rig, planned = self.simulate or self.rig, self.simulate is not None or self.replan_s is not None
        # The board has its own law: this computer needs one only to simulate or to replan.
        law = feedback_of(rig) if rig is not None and planned else None
        leader = None if law is None or self.replan_s is None else Leader(planner_for(*law), self.si("replan_s"))
        if self.port is not None:
            return SerialLine(self.port), leader
        assert law is not None
        plan, known, sensor = law
        simulated = SimulatedRig(thermal_model(plan.tube, plan.rig, FINE), sensor)
        # The board switches off at the same temperature.
        limit = plan.spec.limit + OVERSHOOT
        return SimulatedLine(simulated, known, limit, self.si("speed"), plan.spec.window_degC), leader

    def run_in(self, out: Path | None, progress: Progress | None = None) -> HeatingRun:
        """Run it, and log into `out` where that is given."""
        tell = progress or (lambda done, total: None)
        return self.led(out, *self.open(), lambda hello, row: tell(row["place"], int(hello.get("slots", 0))))

    def led(self, out: Path | None, line: Line, leader: Leader | None, show: Show) -> HeatingRun:
        """Run it over what `open` gave, as `run_heating`, and log into `out` where that is given."""
        log = None if out is None else out / LOG_FILE
        return run_heating(line, dry=self.dry, log=log, show=show, leader=leader)


class FeedbackDesign(NamedTuple):
    """A schedule with the law that corrects it from a sensor."""

    plan: HeatingPlan
    law: HeatingLaw
    sensor: Sensor


def feedback_of(rig: Rig) -> FeedbackDesign:
    """A rig's schedule as `tubeopt heat firmware` makes it by default, and the law of a thermocouple; the file must
    name the tube."""
    assert rig.tube is not None
    plan, sensor = plan_heating(rig.tube, rig, HeatingSpec(objective="margin")), Thermocouple()
    return FeedbackDesign(plan, design_feedback(plan, sensor, samples=20).law, sensor)


def run_heating(
    line: Line,
    *,
    dry: bool = False,
    log: Path | None = None,
    show: Show | None = None,
    leader: Leader | None = None,
) -> HeatingRun:
    """Start a rig and follow it to its end; where this is interrupted, the rig is stopped first.

    Args:
        line: to it. dry: everything but the current. log: CSV, written row by row. show: gets what the rig said of
            itself and every report. leader: plans the rest anew, and tells the rig.

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
        # The board answers before it heats: a wrong port or sketch is found cold.
        hello = _next(line, "hello")
        line.send("start", **({"dry": True} if dry else {}))
        while True:
            found = _next(line, "status", "error")
            if found["event"] == "error":
                raise InputError(f"the rig does not start: {found.get('text', '')}")
            # Reports from before the start command are still on the line.
            if found["state"] == "idle":
                continue
            if log is not None:
                # Logged before anything else: a crash below loses no measurement.
                _append(log, found, rows[-1]["count"] if rows else 0)
            rows.append(found)
            if leader is not None and (lead := leader.advise(found)) is not None:
                line.send("lead", **lead)
            if show is not None:
                show(hello, found)
            if found["state"] == "stopped":
                window = hello.get("window_degC")
                return HeatingRun(tuple(rows), str(found["reason"]), log, window=window and (window[0], window[1]))
    except BaseException:
        # Whatever happens here, nothing stays hot there; a line that is gone can carry no word.
        with contextlib.suppress(SolveError):
            line.send("stop")
        raise
    finally:
        line.close()


def _next(line: Line, *events: str) -> dict[str, Any]:
    """The next report of one of these kinds."""
    silent = 0
    while silent < SILENCE:
        found = line.receive()
        # Only silence is a fault: any report shows that the board runs.
        silent = silent + 1 if found is None else 0
        if found and found.get("event") in events and (found["event"] != "status" or found.keys() >= REPORTED):
            return found
    raise SolveError(f"the rig has not answered for {SILENCE} s; its watchdog stops it if the board hangs")


def _append(log: Path, row: dict[str, Any], before: int) -> None:
    """Write one row, and let it reach the disk.   before: count of the slot that has ended."""
    volt, ampere = row["voltage_V"], row["current_A"]
    # What is reported as a slot begins was measured in the one before, and pulses of one count may be too short for it.
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
