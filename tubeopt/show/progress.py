"""How far a long computation is, on stderr where somebody looks at it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from ..runs.base import Progress as Report
from ..runs.sweeping import Progress as Counter


@contextmanager
def working(what: str) -> Iterator[Report]:
    """Yield the callback of a computation; it shows a bar from its first call to the end of the block."""
    with _bar(what, TimeElapsedColumn(), TimeRemainingColumn()) as show:
        yield lambda done, total: show(done, total, 0)


@contextmanager
def counting(what: str) -> Iterator[Counter]:
    """Yield the callback of a sweep; it shows a bar with its rate and the time left."""
    with _bar(what, MofNCompleteColumn(), _Rate(), TimeRemainingColumn()) as show:
        yield lambda done, total, failed: show(done, total, failed)


@contextmanager
def _bar(what: str, *columns: ProgressColumn) -> Iterator[Counter]:
    """Not shown before its first call: the bar has a thread of its own, and processes are best started without."""
    console = Console(stderr=True)
    bar = Progress(
        SpinnerColumn(),
        TextColumn(what),
        BarColumn(),
        *columns,
        console=console,
        transient=True,
        speed_estimate_period=30.0,
    )
    tasks: list[TaskID] = []

    def show(done: int, total: int, failed: int) -> None:
        if not console.is_terminal:
            return
        if not tasks:
            tasks.append(bar.add_task(what, total=total or None, completed=done, failed=failed))
            bar.start()
        bar.update(tasks[0], completed=done, total=total or None, failed=failed)

    try:
        yield show
    finally:
        if tasks:
            bar.stop()


class _Rate(TextColumn):
    """Points per second."""

    def __init__(self) -> None:
        super().__init__("")

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        failed = task.fields.get("failed", 0)
        words = [f"{speed:.3g}/s"] if speed else []
        return Text("  ".join([*words, *([f"{failed} failed"] if failed else [])]))
