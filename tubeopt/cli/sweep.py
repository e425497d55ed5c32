"""`tubeopt sweep`: any study at many values of its keys, saved point by point."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..runs.sweep_file import load_sweep
from ..runs.sweeping import sweep as run_sweep
from ..show.progress import counting
from ..show.report import can_be_saved, present
from ..show.reports import report, to_dict
from .options import JsonOption


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
            question.function(to_dict),
            question.points,
            directory,
            fingerprint=question.fingerprint,
            workers=workers,
            scheduler=scheduler,
            retry_failed=retry_failed,
            progress=progress,
        )
    present(report(answer), out=directory, as_json=as_json)
