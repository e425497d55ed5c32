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
    "compare": "--compare",
    "folds": "--folds",
    "loss": "--loss",
    "priors": "--priors",
    "noise_mm": "--noise-mm",
    "axis_noise_deg": "--axis-noise-deg",
}
"""What the keys of the study are called on the command line."""


def validate(
    robot: RobotArgument,
    measured: Annotated[
        str, typer.Argument(metavar="MEASURED", help="Measured tips: CSV, or YAML that maps one.", show_default=False)
    ],
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
        typer.Option("--fit", metavar="NAME,..", help="Estimate these: latency, rotation_all, curvature_2, ..."),
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="Add effects (all, or those of --fit) in the order in which they pay.")
    ] = False,
    folds: Annotated[
        str | None, typer.Option(help="Folds of the cross-validation; 0 for none. By default 5, or 10 with --compare.")
    ] = None,
    loss: Annotated[str, typer.Option(help="How a large error counts: linear, huber or soft_l1.")] = "linear",
    priors: Annotated[
        bool, typer.Option("--priors", help="Draw the parameters to their values in the drawing.")
    ] = False,
    noise_mm: Annotated[
        str | None, typer.Option(metavar="MM", help="Noise of a measured coordinate; by default estimated.")
    ] = None,
    axis_noise_deg: Annotated[
        str | None, typer.Option(metavar="DEG", help="Noise of a measured direction; by default estimated.")
    ] = None,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measured tips against the model: errors, residuals, a calibrated robot, and the effects that explain it."""
    flags: dict[str, Any] = {
        "kind": "validation",
        "robot": robot,
        "measurements": measured,
        "registration": registration,
        "base_position_mm": numbers(base_position_mm),
        "base_axis": numbers(base_axis),
        "fit": [] if parameters is None else [name.strip() for name in parameters.split(",")],
        "compare": compare,
        "folds": None if folds is None else parse_number(folds),
        "loss": loss,
        "priors": priors,
        "noise_mm": None if noise_mm is None else parse_number(noise_mm),
        "axis_noise_deg": None if axis_noise_deg is None else parse_number(axis_noise_deg),
    }
    study = check(ValidationStudy, flags, "", names=FLAGS)
    can_be_saved(out)
    with working("solving shapes") as progress:
        answer = study.run(progress)
    present(report(answer), out=out, as_json=as_json, plot=plot)
