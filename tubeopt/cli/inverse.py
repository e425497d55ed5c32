"""`tubeopt ik`: the joint values that bring the tip to a target."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ..errors import SolveError
from ..files.checked import check
from ..files.units import parse_number
from ..runs.inverse_study import InverseStudy, Postures, TargetTable
from ..show.inverse_report import miss, why
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, RobotArgument, numbers

PATHS = {"robot": "", "targets": "", "start": "", "obstacles": ""}
"""Keys that are files, whose messages name the file."""


def ik(
    robot: RobotArgument,
    target_mm: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Where the tip shall be.")] = None,
    direction: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Along which the tip shall point, of any length.")
    ] = None,
    targets: Annotated[
        str | None,
        typer.Option(metavar="TARGETS.csv", help="Many targets: columns x_mm, y_mm, z_mm[, direction_x, ...]."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="JOINTS.yaml", help="Where the robot is: rotations_deg, translations_mm."),
    ] = None,
    min_margin: Annotated[str, typer.Option(metavar="MU", help="Least stability margin.")] = "0.05",
    objective: Annotated[
        str | None, typer.Option(metavar="WHAT", help="What is best: nearest (to --from), margin or curvature.")
    ] = None,
    direction_weight: Annotated[
        str | None, typer.Option(metavar="W", help="Make the direction a cost of this weight.")
    ] = None,
    obstacles: Annotated[
        str | None, typer.Option(metavar="OBSTACLES.yaml", help="Bodies that the whole arm keeps away from.")
    ] = None,
    clearance_mm: Annotated[str, typer.Option(metavar="MM", help="Least distance of the arm from obstacles.")] = "0",
    method: Annotated[str, typer.Option(help="How to solve: auto, gauss_newton or nlp.")] = "auto",
    every: Annotated[bool, typer.Option("--all", help="All distinct postures for the target, the best first.")] = False,
    closest: Annotated[
        bool, typer.Option("--closest", help="Where the target is out of reach, the closest pose.")
    ] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Solve each of TARGETS.csv from the last one, on its branch.")
    ] = False,
    reachable: Annotated[
        bool,
        typer.Option(
            "--reachable/--no-reachable",
            help="Find a way without a snap, from --from or home, or say none.",
        ),
    ] = True,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Inverse kinematics: stable joint values that bring the tip to a target, and point it there.

    Ends with 3 where the target, or every one of a table, is missed, with --closest as well; misses within a table are
    named in it. With --follow, targets are put between those of the table where the robot would leap.
    """
    flags: dict[str, Any] = {
        "kind": "inverse_kinematics",
        "robot": robot,
        "target_mm": numbers(target_mm),
        "direction": numbers(direction),
        "targets": targets,
        "start": start,
        "min_margin": parse_number(min_margin),
        "objective": objective,
        "direction_weight": None if direction_weight is None else parse_number(direction_weight),
        "obstacles": obstacles,
        "clearance_mm": parse_number(clearance_mm),
        "method": method,
        "all": every,
        "closest": closest,
        "follow": follow,
        "reachable": reachable,
    }
    names = {key: f"--{key.replace('_', '-')}" for key in flags} | PATHS
    given = {key: value for key, value in flags.items() if value is not None}
    study = check(InverseStudy, given, "", names=names)
    can_be_saved(out)
    with working("solving targets") as progress:
        answer = study.run(progress)
    present(report(answer), out=out, as_json=as_json)
    refuse_misses(answer)


def refuse_misses(answer: Postures | TargetTable) -> None:
    """Raise SolveError where the target, or every one of a table, is missed."""
    if isinstance(answer, Postures):
        best = answer.solutions[0]
        if not best.reached:
            raise SolveError(f"{best.status}: {miss(best)}", best)
        return
    given = [row for row in answer.rows if row.given]
    if not any(row.solution is not None and row.solution.reached for row in given):
        raise SolveError(f"none of {len(given)} targets was reached; the first: {why(given[0])}")
