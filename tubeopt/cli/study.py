"""`tubeopt run`: any study file."""

from __future__ import annotations

from typing import Annotated

import typer

from ..errors import NotProvedError, SolveError
from ..planning import Trajectory
from ..runs.heating_study import Heating
from ..runs.inverse_study import Postures, TargetTable
from ..runs.stability_studies import Certification
from ..runs.study_file import load_study
from ..show.certify_report import EXIT_CODES
from ..show.heat_report import missed
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .inverse import refuse_misses
from .options import JsonOption, OutOption, PlotOption
from .plan import unproved


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
    if isinstance(answer, Heating) and not answer.plan.feasible:
        raise SolveError(missed(answer.plan))
    if isinstance(answer, Trajectory) and not answer.proved:
        raise NotProvedError(unproved(answer))
    if isinstance(answer, Postures | TargetTable):
        refuse_misses(answer)
    if isinstance(answer, Certification):
        raise typer.Exit(EXIT_CODES[answer.verdict.finding])
