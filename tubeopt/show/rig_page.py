"""A heating while it runs, in the terminal; and what is said of it afterwards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from ..errors import SolveError
from ..runs.heating_run import HeatingRun, HeatingRunStudy
from ..shaping.heating.replanning import Leader
from .quantities import Quantity, described, of_field
from .report import Report, two_columns

BLOCKS = " ▁▂▃▄▅▆▇█"
WIDTH = 60

RUN = described(
    HeatingRun,
    of_field(HeatingRun, "reason", label="ended", words="{reason}"),
    Quantity("done", "true if the whole schedule was executed"),
    Quantity("time_s", "duration", label="after", words="{time_s:.1f} s"),
    Quantity("hottest_degC", "highest reading", label="greatest reading", words="{hottest_degC:.1f} degC"),
    "window",
    Quantity("lowest_degC", "lowest reading in the hold; null without one", lambda r: r.held and r.held[0]),
    Quantity("highest_degC", "highest reading in the hold", lambda r: r.held and r.held[1]),
    Quantity("shortfall_K", "miss of the window by the readings of the hold; 0 if it is kept",
             label="in the hold", words=lambda r: _held(r)),
    Quantity("rows", "number of reports from the rig", lambda r: len(r.rows)),
    Quantity("log", "file with all reports", lambda r: None if r.log is None else str(r.log)),
)  # fmt: skip


def _held(run: HeatingRun) -> str:
    """What was read in the hold, in words."""
    if run.held is None:
        return "nothing was measured"
    read = f"{run.held[0]:.1f} to {run.held[1]:.1f} degC"
    if run.window is None or run.shortfall is None:
        return f"{read}; the rig reports no window"
    window = f"{run.window[0]:g} to {run.window[1]:g} degC"
    verdict = f"missed by {run.shortfall:.1f} K" if run.shortfall > 0 else "kept"
    return f"{read}: window of {window} {verdict}"


class HeatingRunReport(Report[HeatingRun]):
    command = "heat run"
    quantities = RUN

    def title(self) -> str:
        return self.answer.name

    def conclude(self) -> None:
        """Raise SolveError where the rig stopped before it was done, or readings of the hold missed the window."""
        if not self.answer.done:
            raise SolveError(f"the rig stopped after {self.answer.time:.1f} s: {self.answer.reason}")
        if self.answer.shortfall:
            raise SolveError(f"in the hold {_held(self.answer)}")


def with_live_page(study: HeatingRunStudy, out: Path | None, *, shown: bool = True) -> HeatingRun:
    """Run a heating and show it as it goes, on stderr; the log goes into `out`."""
    if not shown:
        return study.run_in(out)
    readings: list[float] = []
    line, leader = study.open()
    with Live(console=Console(stderr=True), transient=True, refresh_per_second=8) as live:

        def show(hello: dict[str, Any], row: dict[str, Any]) -> None:
            readings.append(row["temperature_degC"])
            live.update(
                two_columns(
                    f"{hello.get('firmware', 'rig')}: {row['state']}",
                    _told(hello, row, readings) + _foretold(row, leader),
                )
            )

        return study.led(out, line, leader, show)


def _foretold(row: dict[str, Any], leader: Leader | None) -> list[tuple[str, str]]:
    """What a computer that plans the rest anew thinks of the rig."""
    if leader is None:
        return []
    who = "this computer" if row.get("led") else "the board's own law"
    rest = leader.rest
    hold = () if rest is None else rest.reading[max(leader.planner.law.hold[0] - rest.place, 0) :]
    told = [("led by", f"{who}; the rig heats {100 * leader.strength:+.0f} % more than its file says")]
    return told if not len(hold) else [*told, ("foretold", f"{min(hold):.0f} to {max(hold):.0f} degC in the hold")]


def _told(hello: dict[str, Any], row: dict[str, Any], readings: list[float]) -> list[tuple[str, str]]:
    left = max(hello.get("slots", 0) - row["place"], 0) * hello.get("slot_ms", 500) / 1000
    volt, ampere = row["voltage_V"], row["current_A"]
    battery = "not measured" if volt is None else f"{volt:.2f} V, {ampere:.0f} A while on"
    window = hello.get("window_degC")
    within = "" if window is None else f", window {window[0]:g} to {window[1]:g}"
    return [
        ("temperature", f"{row['temperature_degC']:.1f} degC, wanted {row['reference_degC']:.1f}{within}"),
        ("", _curve(readings)),
        ("duty", f"{row['count']} of 255" + (", dry: nothing flows" if row["dry"] else "")),
        ("battery", battery),
        ("time", f"{row['time_s']:.0f} s, {left:.0f} s left"),
        ("stop", "Ctrl-C"),
    ]


def _curve(readings: list[float]) -> str:
    """The readings so far as a line of blocks."""
    shown = readings[:: max(1, -(-len(readings) // WIDTH))]
    top = max(max(shown), 1.0)
    return "".join(BLOCKS[round(max(value, 0.0) / top * (len(BLOCKS) - 1))] for value in shown)
