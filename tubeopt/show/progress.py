"""How far a long computation is, on stderr where somebody looks at it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ..runs.base import Progress as Report


@contextmanager
def working(what: str) -> Iterator[Report]:
    """Yield the callback of a computation; it shows a bar from its first call to the end of the block.

    Not before: the bar has a thread of its own, and processes are best started without.
    """
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn(what), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=console, transient=True)
    tasks: list[TaskID] = []

    def show(done: int, total: int) -> None:
        if not console.is_terminal:
            return
        if not tasks:
            tasks.append(bar.add_task(what, total=total or None))
            bar.start()
        bar.update(tasks[0], completed=done, total=total or None)

    try:
        yield show
    finally:
        if tasks:
            bar.stop()
