"""`tubeopt plan` and `tubeopt verify`: motions that never snap, and whether a trajectory is one."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from typing import Annotated

import typer

from ..bodies.obstacles import Obstacle
from ..errors import InputError, SolveError
from ..files.units import MM, decimal, parse_number, to_si
from ..planning import RateLimits, Trajectory, verify_trajectory
from ..planning.file import TimedJoints, load_trajectory
from ..robots.file import load_robot
from ..runs.obstacle_file import load_obstacles
from ..runs.plan_study import Checked, PlanStudy
from ..runs.study_file import load_study
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, PlotOption


def plan(
    study: Annotated[str, typer.Argument(metavar="STUDY.yaml", help="Study of kind plan.", show_default=False)],
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan a motion that stays on one stable branch, around obstacles and within rates, and prove it.

    Ends with 0 if it is proved, 3 where none was found, and 4 where one was found, shown and saved, but the time limit
    was reached before its proof was finished.
    """
    question = load_study(study)
    if not isinstance(question, PlanStudy):
        raise InputError(f"{study}: kind is {question.kind!r}; it must be 'plan'")
    can_be_saved(out)
    try:
        with working("planning") as progress:
            answer = question.run(progress)
    except SolveError as error:
        if out is None or not isinstance(error.solution, Trajectory):
            raise
        # What was found until the time was over: in a directory of its own, not to be taken for the plan.
        saved = report(error.solution).save(out / "partial")
        raise SolveError(f"{error}; as far as it came: {saved[1]}", error.solution) from None
    present(report(answer), out=out, as_json=as_json, plot=plot)


def verify(
    trajectory: Annotated[
        str,
        typer.Argument(
            metavar="TRAJECTORY.csv",
            help="Columns time_s, rotation_1_deg, ... and, where tubes slide, translation_1_mm, ...",
            show_default=False,
        ),
    ],
    robot: Annotated[
        str | None, typer.Option(metavar="ROBOT.yaml", help="Robot file; by default the one that the file names.")
    ] = None,
    min_margin: Annotated[str, typer.Option(metavar="MU", help="Least stability margin.")] = "0",
    obstacles: Annotated[
        str | None, typer.Option(metavar="OBSTACLES.yaml", help="Bodies that the whole arm keeps away from.")
    ] = None,
    clearance_mm: Annotated[str, typer.Option(metavar="MM", help="Least distance of the arm from obstacles.")] = "0",
    study: Annotated[
        str | None,
        typer.Option(metavar="STUDY.yaml", help="Margin, obstacles, clearance and rates of this plan study instead."),
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Follow a trajectory, of whatever origin, and say whether it snaps, collides or is too fast. Ends with 3 if so."""
    can_be_saved(out)
    joints = load_trajectory(trajectory, None if robot is None else load_robot(robot))
    margin, gap, rates = _number("--min-margin", min_margin), _number("--clearance-mm", clearance_mm), None
    bodies: Sequence[Obstacle] = () if obstacles is None else load_obstacles(obstacles)
    if study is not None:
        asked = load_study(study)
        if not isinstance(asked, PlanStudy):
            raise InputError(f"{study}: kind is {asked.kind!r}; it must be 'plan'")
        margin, gap, bodies, rates = asked.min_margin, asked.clearance_mm, asked.bodies(), asked.rates.build()
    with working("following the trajectory") as progress:
        progress(0, 0)
        checked = _check(trajectory, joints, (margin, gap), bodies, rates)
    present(report(checked), out=out, as_json=as_json)


def _check(
    file: str,
    joints: TimedJoints,
    least: tuple[Decimal, Decimal],
    bodies: Sequence[Obstacle],
    rates: RateLimits | None,
) -> Checked:
    proof = verify_trajectory(
        joints.robot,
        joints.time,
        joints.rotations,
        joints.translations,
        start=joints.start(),
        obstacles=bodies,
        min_margin=float(least[0]),
        clearance=to_si(least[1], MM),
        rate_limits=rates,
    )
    return Checked(file, joints, proof)


def _number(name: str, text: str) -> Decimal:
    try:
        return decimal(parse_number(text))
    except ValueError as error:
        raise InputError(f"{name} {error}") from None
