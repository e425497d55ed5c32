"""`tubeopt mold`: molds for the tubes of a robot, spring-back from trials, materials side by side."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from ..errors import InputError, positive
from ..files.units import TO_MM
from ..robots.file import load_robot
from ..robots.materials import ZERO_CELSIUS
from ..robots.tubes import Tube
from ..runs.mold_file import load_mold_spec, load_trials
from ..runs.mold_study import MoldStudy, Ranking
from ..shaping.mold.heat import HeatSpec
from ..shaping.mold.mandrel import plan_mandrel
from ..shaping.mold.ranking import rank_mold_materials
from ..shaping.mold.springback import calibrate_springback
from ..show.report import can_be_saved, present
from ..show.reports import report
from .flags import ask, asks
from .options import App, JsonOption, OutOption, PlanByDefault, PlotOption, RobotArgument

app = App(cls=PlanByDefault, help="Molds for setting the shape of tubes.", no_args_is_help=True)


@app.command(epilog="Example: tubeopt mold plan configs/robots/thesis_etr.yaml --out results")
@asks(MoldStudy)
def plan(study: MoldStudy, plot: PlotOption = False, out: OutOption = None, as_json: JsonOption = False) -> None:
    """The mold for the tubes of a robot: DXF, SVG, STL, G-code and a set-up sheet."""
    present(report(ask(study, "planning the mold", out)), out=out, as_json=as_json, plot=plot)


@app.command(epilog="Example: tubeopt mold mandrel configs/robots/example_pieces.yaml --tube 1 --out results")
def mandrel(
    robot: RobotArgument,
    tube: Annotated[int, typer.Option("--tube", metavar="N", help="Which tube of the robot, from 1.")] = 1,
    mold: Annotated[
        str | None, typer.Option("--mold", metavar="MOLD.yaml", help="What is asked of the mold.", show_default=False)
    ] = None,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The mandrel for a helix or another space curve: STL, table of rotation and feed, G-code for a 4th axis."""
    tubes = load_robot(robot).tubes
    if not 1 <= tube <= len(tubes):
        raise InputError(f"--tube is {tube}; it must lie in 1 to {len(tubes)}")
    can_be_saved(out)
    spec = None if mold is None else load_mold_spec(mold)
    present(report(plan_mandrel(tubes[tube - 1], spec, number=tube)), out=out, as_json=as_json, plot=plot)


@app.command(epilog="Example: tubeopt mold calibrate configs/molds/example_trials.csv --out results")
def calibrate(
    trials: Annotated[
        str,
        typer.Argument(metavar="TRIALS.csv", help="Columns mold_radius_mm and obtained_radius_mm.", show_default=False),
    ],
    model: Annotated[
        str, typer.Option(help="constant: one lost fraction; linear: it grows with curvature; auto: as trials tell.")
    ] = "auto",
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Spring-back from trials: how much of the mold's curvature tubes lose."""
    can_be_saved(out)
    read = load_trials(trials)
    answer = calibrate_springback(read.mold_radius, read.obtained_radius, model=model)
    present(report(answer), out=out, as_json=as_json, plot=plot)


@app.command(epilog="Example: tubeopt mold materials configs/robots/thesis_ctr.yaml --tube 1")
def materials(
    robot: Annotated[
        str | None, typer.Argument(metavar="[ROBOT.yaml]", help="Robot whose tube it is.", show_default=False)
    ] = None,
    tube: Annotated[int, typer.Option("--tube", metavar="N", help="Which tube of the robot, from 1.")] = 1,
    outer_diameter_mm: Annotated[float, typer.Option(help="Without a robot: the tube; by default the thesis'.")] = 1.92,
    inner_diameter_mm: Annotated[float, typer.Option(help="Without a robot: its inner diameter.")] = 1.57,
    curved_length_mm: Annotated[float, typer.Option(help="Without a robot: the length to be heated.")] = 94.0,
    set_degc: Annotated[float, typer.Option("--set-degC", help="Temperature of the tube.")] = 525.0,
    hold_s: Annotated[float, typer.Option(help="For how long it is held.")] = 60.0,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Mold materials for a tube, best first: heat drawn, limit temperature, current that leaks, and why."""
    if robot is not None:
        tubes = load_robot(robot).tubes
        if not 1 <= tube <= len(tubes):
            raise InputError(f"--tube is {tube}; it must lie in 1 to {len(tubes)}")
        wanted = tubes[tube - 1]
    else:
        sizes = (outer_diameter_mm, inner_diameter_mm, curved_length_mm)
        outer, inner, length = (value / TO_MM for value in sizes)
        wanted = Tube(outer, inner, straight_length=0.0, curved_length=length, curvature=0.0)
    heat = replace(HeatSpec(), set_temperature=set_degc + ZERO_CELSIUS, hold_time=positive("--hold-s", hold_s))
    can_be_saved(out)
    answer = Ranking(rank_mold_materials(wanted, heat), wanted, heat)
    present(report(answer), out=out, as_json=as_json, plot=plot)
