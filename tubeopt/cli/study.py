"""`tubeopt run`: any study file."""

from __future__ import annotations

from typing import Annotated

import typer

from ..runs.study_file import load_study
from .flags import answer, command
from .output import Output


@command("tubeopt run configs/studies/thesis_actuated.yaml --out results")
def run(
    study: Annotated[str, typer.Argument(metavar="STUDY.yaml", help="Study file.", show_default=False)], output: Output
) -> None:
    """Run the study that a file describes. Ends as the command of its kind does."""
    answer(load_study(study), output)
