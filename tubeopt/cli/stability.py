"""`tubeopt equilibria`, `snap`, `follow`, `certify` and `stability-map`: what is stable, and where the robot snaps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ..files.checked import check
from ..files.units import parse_number
from ..runs.base import Study
from ..runs.stability_studies import CertifyStudy, EquilibriaStudy, FollowStudy, SnapStudy, StabilityMapStudy
from ..show.certify_report import EXIT_CODES
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, RobotArgument, RotationsOption, TranslationsOption, numbers


def _ask(model: type[Study], flags: dict[str, Any], doing: str, out: Path | None) -> Any:
    """The answer to a study made of flags; keys that are arguments are not named in messages, they are files."""
    names = {key: "" if key in ("robot", "path") else f"--{key.replace('_', '-')}" for key in flags}
    study = check(model, {key: value for key, value in flags.items() if value is not None}, "", names=names)
    can_be_saved(out)
    with working(doing) as progress:
        return study.run(progress)


def equilibria(
    robot: RobotArgument,
    rotations_deg: RotationsOption = None,
    translations_mm: TranslationsOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Every equilibrium at given joint values, stable and unstable, the lowest energy first."""
    flags = {
        "kind": "equilibria",
        "robot": robot,
        "rotations_deg": numbers(rotations_deg),
        "translations_mm": numbers(translations_mm),
    }
    answer = _ask(EquilibriaStudy, flags, "searching equilibria", out)
    present(report(answer), out=out, as_json=as_json)


def snap(
    robot: RobotArgument,
    from_deg: Annotated[str | None, typer.Option(metavar="A,B,..", help="Rotations to start from; default 0.")] = None,
    to_deg: Annotated[
        str | None, typer.Option(metavar="A,B,..", help="Rotations to turn to; by default those of the start.")
    ] = None,
    from_mm: Annotated[
        str | None, typer.Option(metavar="A,B,..", help="Translations to start from; by default home.")
    ] = None,
    to_mm: Annotated[
        str | None, typer.Option(metavar="A,B,..", help="Translations to move to; by default those of the start.")
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The first snap on the straight way from one set of joint values to another, computed exactly."""
    flags = {
        "kind": "snap",
        "robot": robot,
        "from_deg": numbers(from_deg),
        "to_deg": numbers(to_deg),
        "from_mm": numbers(from_mm),
        "to_mm": numbers(to_mm),
    }
    present(report(_ask(SnapStudy, flags, "looking for the snap", out)), out=out, as_json=as_json)


def follow(
    robot: RobotArgument,
    path: Annotated[
        str,
        typer.Argument(
            metavar="PATH.csv",
            help="Waypoints, with the columns rotation_1_deg, rotation_2_deg, ... in deg and, where tubes slide, "
            "translation_1_mm, ... in mm; a row per waypoint.",
            show_default=False,
        ),
    ],
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Slow motion through waypoints, with its history: where the robot snaps and where it lands."""
    flags = {"kind": "follow", "robot": robot, "path": path}
    present(report(_ask(FollowStudy, flags, "following the path", out)), out=out, as_json=as_json)


def certify(
    robot: RobotArgument,
    translations_mm: TranslationsOption = None,
    box: Annotated[bool, typer.Option("--box", help="For all translations that the robot's limits allow.")] = False,
    lower_mm: Annotated[
        str | None, typer.Option(metavar="A,B,..", help="Least translations of a box, in place of the limits.")
    ] = None,
    upper_mm: Annotated[
        str | None, typer.Option(metavar="A,B,..", help="Largest translations of a box, in place of the limits.")
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Whether the robot can snap at any rotation: what is proved, and what search finds.

    Ends with 0 if it cannot snap, 3 if it can, 4 if neither is known; with a box, at the translations of its least
    certificate that was found.
    """
    flags = {
        "kind": "certify",
        "robot": robot,
        "translations_mm": numbers(translations_mm),
        "box": box,
        "lower_mm": numbers(lower_mm),
        "upper_mm": numbers(upper_mm),
    }
    answer = _ask(CertifyStudy, flags, "looking for snaps", out)
    present(report(replace(answer, robot_file=robot)), out=out, as_json=as_json)
    raise typer.Exit(EXIT_CODES[answer.verdict.finding])


def stability_map(
    robot: RobotArgument,
    translations_mm: TranslationsOption = None,
    tubes: Annotated[str, typer.Option(metavar="I,J", help="The two tubes that turn; 1 is the innermost.")] = "1,2",
    samples: Annotated[str, typer.Option(metavar="N", help="Points per axis, from -180 to 180 deg.")] = "60",
    directions: Annotated[
        str, typer.Option(metavar="N", help="Directions in which the snap boundary is computed.")
    ] = "180",
    workers: Annotated[str, typer.Option(metavar="N", help="Processes that share the work.")] = "2",
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The margin over the rotations of two tubes turned together from home, and where the robot snaps."""
    flags = {
        "kind": "stability_map",
        "robot": robot,
        "translations_mm": numbers(translations_mm),
        "tubes": numbers(tubes),
        "samples": parse_number(samples),
        "directions": parse_number(directions),
        "workers": parse_number(workers),
    }
    answer = _ask(StabilityMapStudy, flags, "mapping the margin", out)
    present(report(answer), out=out, as_json=as_json)
