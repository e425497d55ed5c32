"""`tubeopt run` and `sweep`: any study of a file, at once or at many values of its keys, saved point by point."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from ..runs.study_file import load_study
from ..runs.sweep_file import load_sweep
from ..runs.sweeping import SWEEP_LIMIT, Sweep
from ..runs.sweeping import sweep as run_sweep
from ..show.progress import working
from ..show.reports import report, to_dict
from .completion import files
from .flags import answer, command
from .interruption import keeping
from .output import Output, can_be_saved, check_formats, present


@command("tubeopt run configs/studies/thesis_actuated.yaml --out results")
def run(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY.yaml",
            help="Study file of any kind, or the name of a built-in study.",
            show_default=False,
            autocompletion=files("study"),
        ),
    ],
    output: Output,
) -> None:
    """Run a study file of any kind. Exit codes are those of the command of that kind."""
    answer(load_study(study), output)


@command("tubeopt sweep configs/studies/sweep_tips.yaml --workers 1 --out results", without=("plot", "width_mm"))
def sweep(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY.yaml", help="Study of kind sweep.", show_default=False, autocompletion=files("study")
        ),
    ],
    output: Output,
    workers: Annotated[
        int,
        typer.Option(metavar="N", help="Number of worker processes; 0 for one per core, 1 for none besides this one."),
    ] = 0,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address of a Dask cluster that replaces the worker processes, such as tcp://host:8786.",
            show_default=False,
        ),
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Compute points again that failed in an earlier run.")
    ] = False,
    time_limit_s: Annotated[
        float, typer.Option("--time-limit-s", metavar="S", help="Time limit for all remaining points, s.")
    ] = SWEEP_LIMIT,
) -> None:
    """Run a study over a grid or random samples of its parameters.

    With --out, the same command resumes an interrupted run. Without --out, the table is printed as CSV, and nothing is
    saved.
    """
    question = load_sweep(study)
    can_be_saved(output.out)
    check_formats(output, "sweep")

    def _into(directory: Path) -> Sweep:
        with working("sweeping", shown=not output.quiet) as progress:
            return run_sweep(
                question.function(to_dict),
                question.points,
                directory,
                fingerprint=question.fingerprint,
                workers=workers,
                scheduler=scheduler,
                retry_failed=retry_failed,
                progress=progress,
                time_limit=time_limit_s,
            )

    if output.out is not None:
        with keeping(f"finished points are in {output.out}; the same command resumes the run"):
            present(report(_into(output.out)), output)
        return
    with tempfile.TemporaryDirectory() as directory:
        present(report(_into(Path(directory)).unkept()), output)
