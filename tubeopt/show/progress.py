"""Progress of long computations, on stderr of a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

STAGES = {"feasibility": "towards feasibility, largest violation", "optimum": "towards the optimum, minimised"}
"""Stage of a solve -> its description and measure."""

MANY = 100
"""Smallest number of steps for a display of their rate."""


class Bar:
    """Progress bar of a computation, shown from its first call on in a terminal.

    Not shown before: the bar has a thread of its own, and processes are best started without.
    """

    def __init__(self, what: str, shown: bool) -> None:
        self._what = what
        self._console = Console(stderr=True)
        # In a file or a pipe, a bar would be hundreds of lines.
        self._shown = shown and self._console.is_terminal
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            _Count(),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
            # s: solves take from milliseconds to seconds, and a shorter mean would jump.
            speed_estimate_period=30.0,
        )
        self._task: TaskID | None = None
        self._stage, self._iteration = "", 0

    def __call__(self, done: int, total: int, failed: int = 0) -> None:
        """Show completed and failed steps; a total of 0 is unknown."""
        # rich shows a pulse for an unknown total, and a full bar for 0.
        self._show(completed=done, total=total or None, failed=failed)

    def iteration(self, stage: str, value: float) -> None:
        """Show the measure of a solve after one more iteration; `stage` is one of `STAGES`."""
        self._iteration = self._iteration + 1 if stage == self._stage else 1
        self._stage = stage
        self._show(description=f"{self._what}: {STAGES[stage]} {value:.6g} (iteration {self._iteration})")

    def _show(self, **known: Any) -> None:
        if not self._shown:
            return
        if self._task is None:
            self._task = self._bar.add_task(self._what, total=None)
            self._bar.start()
        self._bar.update(self._task, **known)

    def stop(self) -> None:
        """Remove the bar."""
        if self._task is not None:
            self._bar.stop()


@contextmanager
def working(what: str, *, shown: bool = True) -> Iterator[Bar]:
    """Yield the callback of a computation; its bar is there until the end of the block."""
    bar = Bar(what, shown)
    try:
        yield bar
    finally:
        bar.stop()


class _Count(ProgressColumn):
    """Column with done and total steps, rate, and failures."""

    def render(self, task: Task) -> Text:
        if task.total is None:
            return Text("")
        parts = [f"{task.completed:.0f}/{task.total:.0f}"]
        speed = task.finished_speed or task.speed
        if speed and task.total >= MANY:
            parts.append(f"{speed:.3g}/s")
        failed = task.fields.get("failed", 0)
        return Text("  ".join([*parts, *([f"{failed} failed"] if failed else [])]))
