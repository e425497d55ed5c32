"""`tubeopt sweep`: any study at many values of its keys, saved point by point."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from ..errors import SolveError
from ..runs.sweep_file import load_sweep
from ..runs.sweeping import Progress, Sweep
from ..runs.sweeping import sweep as run_sweep
from ..show.report import can_be_saved, present, report, two_columns
from .options import JsonOption

SHOWN = 3
"""Failures that are told; the table has all."""


def sweep(
    study: Annotated[str, typer.Argument(metavar="STUDY.yaml", help="Study of kind sweep.", show_default=False)],
    workers: Annotated[
        int, typer.Option(metavar="N", help="Processes on this machine; 0 is one per core, 1 this one.")
    ] = 0,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask cluster in their place, as tcp://host:8786.", show_default=False),
    ] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Compute failed points again.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Where the sweep is kept; by default named after the file, here."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a study over a grid or a sample of its parameters. The same command goes on with a run that was stopped."""
    question = load_sweep(study)
    directory = out or Path(Path(study).stem)
    can_be_saved(directory)
    with counting("sweeping") as progress:
        answer = run_sweep(
            question.function(record_of),
            question.points,
            directory,
            fingerprint=question.fingerprint,
            workers=workers,
            scheduler=scheduler,
            retry_failed=retry_failed,
            progress=progress,
        )
    present(SweepReport(answer), out=None, as_json=as_json)
    if len(answer.failures) == answer.points:
        raise SolveError(f"all {answer.points} points failed; the first: {answer.failures[0][1]}")


def record_of(answer: object) -> Mapping[str, Any]:
    """What `--json` says about the answer of any study; every command registers its own."""
    importlib.import_module("tubeopt.cli.app")  # a worker has not loaded the commands
    return report(answer).record()


@dataclass(frozen=True)
class SweepReport:
    """What is said about a sweep."""

    answer: Sweep

    def record(self) -> dict[str, Any]:
        """The answer as JSON: how many points, which failed and why, and the files."""
        a = self.answer
        return {
            "points": a.points,
            "computed": a.computed,
            "failed": len(a.failures),
            "failures": [{"point": index + 1, "reason": reason} for index, reason in a.failures],
            "table": str(a.table),
            "arrays": str(a.arrays),
            "journal": str(a.journal),
        }

    def table(self) -> Table:
        """How many points there are, the first failures, and where the table is."""
        a = self.answer
        before = a.points - a.computed
        rows = [
            ("points", f"{a.points}" + (f", {before} of them from an earlier run" if before else "")),
            ("failed", f"{len(a.failures)}"),
        ]
        rows += [(f"  point {index + 1}", reason) for index, reason in a.failures[:SHOWN]]
        if len(a.failures) > SHOWN:
            rows.append(("", f"and {len(a.failures) - SHOWN} more, in the table"))
        return two_columns("sweep", [*rows, ("table", str(a.table)), ("arrays", str(a.arrays))])

    def save(self, directory: Path) -> list[Path]:
        """Nothing: the table was saved by the sweep."""
        return []

    def draw(self, directory: Path) -> list[Path]:
        """No picture."""
        return []


class _Rate(TextColumn):
    """Points per second."""

    def __init__(self) -> None:
        super().__init__("")

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        failed = task.fields.get("failed", 0)
        words = [f"{speed:.3g}/s"] if speed else []
        return Text("  ".join([*words, *([f"{failed} failed"] if failed else [])]))


@contextmanager
def counting(what: str) -> Iterator[Progress]:
    """Yield the callback of a sweep; it shows a bar with its rate and the time left, on stderr where somebody looks."""
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn(what), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    bar = Bar(*columns, console=console, transient=True, speed_estimate_period=30.0)
    tasks: list[TaskID] = []

    def show(done: int, total: int, failed: int = 0) -> None:
        if not console.is_terminal:
            return
        if not tasks:
            tasks.append(bar.add_task(what, total=total, completed=done, failed=failed))
            bar.start()
        bar.update(tasks[0], completed=done, total=total, failed=failed)

    try:
        yield show
    finally:
        if tasks:
            bar.stop()
