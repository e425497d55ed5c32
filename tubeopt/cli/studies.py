"""`tubeopt run`, `figure`, `sweep` and `heat run`: study files, figures for papers, sweeps, heating runs."""

from __future__ import annotations

import shlex
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError, choice
from ..runs.heating_run import LOG_FILE, HeatingRunStudy
from ..runs.study_file import load_study
from ..runs.sweep_file import load_sweep
from ..runs.sweeping import SWEEP_LIMIT, Sweep
from ..runs.sweeping import sweep as run_sweep
from ..show.command_report import JOURNALS, Figures
from ..show.heat_report import with_live_page
from ..show.page import FONTS
from ..show.progress import working
from ..show.reports import report, to_dict
from .flags import answer, ask, command, completion, files, has_pictures, study_command
from .interruption import reporting_saved
from .output import OF_PICTURES, Output, can_be_saved, check_formats, present


@command("tubeopt run thesis_actuated --out results")
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


@command("tubeopt figure thesis_snap --journal ieee --out results", without=("plot", "formats", "no_title"))
def figure(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY.yaml",
            help="Study file of any kind with plots, or the name of a built-in study.",
            show_default=False,
            autocompletion=files("study"),
        ),
    ],
    output: Output,
    journal: Annotated[
        str,
        typer.Option(
            "--journal",
            metavar=f"[{'|'.join(JOURNALS)}]",
            help="Publisher: sets column width, file format and font. --width-mm overrides the width.",
            autocompletion=completion(tuple(JOURNALS)),
        ),
    ] = "ieee",
) -> None:
    """Make the plots of a study for a paper, with captions, data and the command in separate files.

    Saves what `tubeopt run` saves, in DIR of --out, which is required. Each plot has the format of the journal, 600 dpi
    and no heading. The file captions.txt has the headings, command.txt the command and the versions. NAME_data.csv has
    the values in the plot NAME. Exit codes are those of the command of the study.
    """
    style = JOURNALS[choice("--journal", journal, tuple(JOURNALS))]
    if output.out is None:
        raise InputError("--out is missing: the directory for plots, captions and data")
    question = load_study(study)
    if not has_pictures(question.kind):
        raise InputError(f"{study}: kind is {question.kind}; it has no plots")
    # command.txt has the width as a number: the figure is the same if the journal's style changes.
    width = output.width_mm or str(style.width_mm)
    typed = ["tubeopt", "figure", study, "--journal", journal, "--width-mm", width, "--out", str(output.out)]
    paper = replace(output, width_mm=width, formats=style.format, no_title=True)
    token = FONTS.set(style.fonts)
    try:
        present(report(Figures(report(ask(question, paper)), shlex.join(typed))), paper)
    finally:
        FONTS.reset(token)


@command("tubeopt sweep sweep_tips --workers 1 --out results", without=OF_PICTURES)
def sweep(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY.yaml",
            help="Study of kind sweep; `tubeopt init study --kind sweep` writes one.",
            show_default=False,
            autocompletion=files("study"),
        ),
    ],
    output: Output,
    workers: Annotated[
        int,
        typer.Option(metavar="N", help="Number of worker processes; 0 for one per core, 1 to compute in this process."),
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
        float, typer.Option("--time-limit-s", metavar="S", help="Time limit for all remaining points.")
    ] = SWEEP_LIMIT,
    table_format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="F,..",
            help="Further formats of the table, separated by commas: parquet, mat; default CSV and NumPy files only.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Run a study over a grid or random samples of its parameters.

    With --out, the same command resumes an interrupted run. Without --out, the table is printed as CSV, and nothing is
    saved.
    """
    if table_format is not None:  # a sweep has no plots, so that it has none of their formats
        output = replace(output, formats=table_format)
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
        with reporting_saved(f"finished points are in {output.out}; the same command resumes the run"):
            present(report(_into(output.out)), output)
        return
    # The journal needs a directory; the table is read before it is removed.
    with tempfile.TemporaryDirectory() as directory:
        present(report(_into(Path(directory)).unkept()), output)


@study_command(
    HeatingRunStudy,
    arguments={},
    example="tubeopt heat run --simulate thesis_calcium_silicate --out results",
    without=OF_PICTURES,
)
def run_heating(study: HeatingRunStudy, output: Output) -> None:
    """Heat a tube on a rig or a simulated rig: start it, show it live, and log it for `tubeopt heat calibrate`.

    Ctrl-C stops the rig (exit code 130). Exit code 3: the rig stopped early, or the sensor reading left the window
    during the hold time.
    """
    can_be_saved(output.out)
    log = None if output.out is None else output.out / LOG_FILE

    def _saved() -> str:
        saved = f"{log} has the log up to now" if log is not None and log.exists() else "nothing was saved"
        return f"the rig stops; {saved}"

    with reporting_saved(_saved):
        run = with_live_page(study, output.out, shown=not output.quiet)
    present(report(run), output, written=() if run.log is None else (run.log,))
