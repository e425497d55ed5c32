"""`tubeopt validate`: measured tips beside the model's, and the parameters that bring them closest."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ..files.checked import check
from ..files.units import parse_number
from ..runs.validation_study import ValidationStudy
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, PlotOption, RobotArgument, numbers

FLAGS = {
    "robot": "",
    "measurements": "",
    "registration": "--registration",
    "base_position_mm": "--base-position-mm",
    "base_axis": "--base-axis",
    "fit": "--fit",
    "folds": "--folds",
}
"""What the keys of the study are called on the command line."""


def validate(
    robot: RobotArgument,
    measured: Annotated[str, typer.Argument(metavar="MEASURED.csv", help="Measured tips.", show_default=False)],
    registration: Annotated[
        str, typer.Option(help="How the device's frame is brought to the plate's: rigid, base-axis or none.")
    ] = "rigid",
    base_position_mm: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="For base-axis: the plate's centre as the device sees it.")
    ] = None,
    base_axis: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="For base-axis: direction of the plate's z in its frame.")
    ] = None,
    parameters: Annotated[
        str | None,
        typer.Option("--fit", metavar="NAME,..", help="Estimate these: curvature, curvature_2, nu, rotation_1, ..."),
    ] = None,
    folds: Annotated[str, typer.Option(help="Folds of the cross-validation of a fit; 0 for none.")] = "5",
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measured tips against the model: errors, residuals, and a calibrated robot."""
    flags: dict[str, Any] = {
        "kind": "validation",
        "robot": robot,
        "measurements": measured,
        "registration": registration,
        "base_position_mm": numbers(base_position_mm),
        "base_axis": numbers(base_axis),
        "fit": [] if parameters is None else [name.strip() for name in parameters.split(",")],
        "folds": parse_number(folds),
    }
    study = check(ValidationStudy, flags, "", names=FLAGS)
    can_be_saved(out)
    with working("solving shapes") as progress:
        answer = study.run(progress)
    present(report(answer), out=out, as_json=as_json, plot=plot)
