"""`tubeopt fk`: the shape that a robot takes at given joint values."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ..equilibrium.kinematics import METHODS
from ..files.checked import check
from ..files.units import parse_number
from ..runs.study_file import ForwardKinematicsStudy
from ..show.report import present
from ..show.reports import report
from .options import JsonOption, OutOption, PlotOption, RobotArgument, RotationsOption, TranslationsOption, numbers

FLAGS = {
    "robot": "",
    "rotations_deg": "--rotations-deg",
    "translations_mm": "--translations-mm",
    "method": "--method",
    "tolerance_rad": "--tolerance-rad",
}
"""What the keys of the study are called on the command line."""


def fk(
    robot: RobotArgument,
    rotations_deg: RotationsOption = None,
    translations_mm: TranslationsOption = None,
    method: Annotated[str, typer.Option(help=f"How to solve: {', '.join(METHODS)}.")] = METHODS[0],
    tolerance_rad: Annotated[
        str, typer.Option("--tolerance-rad", "--tolerance", metavar="RAD", help="Largest error of the tubes' angles.")
    ] = "1e-8",
    verify: Annotated[bool, typer.Option("--verify", help="Compare with an adaptive re-integration.")] = False,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Forward kinematics: the stable shape at given joint values, with its margin to snapping."""
    flags: dict[str, Any] = {
        "kind": "forward_kinematics",
        "robot": robot,
        "rotations_deg": numbers(rotations_deg),
        "translations_mm": numbers(translations_mm),
        "method": method,
        "tolerance_rad": parse_number(tolerance_rad),
        "verify": verify,
    }
    study = check(ForwardKinematicsStudy, flags, "", names=FLAGS)
    present(report(study.run()), out=out, as_json=as_json, plot=plot)
