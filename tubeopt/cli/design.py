"""`tubeopt design`: the best robot that keeps a list of requirements."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from ..errors import InputError
from ..runs.design_study import DesignStudy
from ..runs.study_file import load_study
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, PlotOption

WORDS = {"feasibility": "towards feasibility, largest violation", "optimum": "towards the optimum, minimised"}
"""Stages of a solve, and what their measure is."""


def design(
    study: Annotated[str, typer.Argument(metavar="STUDY.yaml", help="Study of kind design.", show_default=False)],
    starts: Annotated[
        int | None, typer.Option(help="Starts, in place of those in the file.", show_default=False)
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes for starts, stock and tolerances.")] = 1,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Design the tubes of a robot: what may change, what must hold and what is wanted stand in a file."""
    question = load_study(study)
    if not isinstance(question, DesignStudy):
        raise InputError(f"{study}: kind is {question.kind!r}; it must be 'design'")
    if starts is not None and starts < 1:
        raise InputError(f"--starts is {starts}; it must be at least 1")
    if workers < 1:
        raise InputError(f"--workers is {workers}; it must be at least 1")
    can_be_saved(out)
    with iterating() as (progress, watch):
        answer = question.run(progress, report=watch, starts=starts, workers=workers)
    present(report(answer), out=out, as_json=as_json, plot=plot)


@contextmanager
def iterating() -> Iterator[tuple[Callable[[int, int], object], Callable[[str, float], object]]]:
    """Yield what a design is to call for its progress and after each iteration; shows a line where somebody looks."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield (lambda done, total: None), (lambda stage, value: None)
        return
    stage, part, iteration = "", "", 0
    with Live(Text("designing"), console=console, transient=True, refresh_per_second=8) as live:

        def watch(now: str, value: float) -> None:
            nonlocal stage, iteration
            iteration = iteration + 1 if now == stage else 1
            stage = now
            live.update(Text(f"designing{part}: {WORDS[stage]} {value:.6g} (iteration {iteration})"))

        def progress(done: int, total: int) -> None:
            nonlocal part
            part = f", {done} of {total} done" if total > 1 else ""
            live.update(Text(f"designing{part}"))

        yield progress, watch
