"""`tubeopt run`: any study file."""

from __future__ import annotations

from typing import Annotated

import typer

from ..runs.study_file import load_study
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, PlotOption


def run(
    study: Annotated[str, typer.Argument(metavar="STUDY.yaml", help="Study file.", show_default=False)],
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the study that a file describes. Ends as the command of its kind does."""
    question = load_study(study)
    can_be_saved(out)
    with working("running the study") as progress:
        answer = question.run(progress)
    present(report(answer), out=out, as_json=as_json, plot=plot)
