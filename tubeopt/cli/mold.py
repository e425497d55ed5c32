"""`tubeopt mold`: molds for the tubes of a robot, spring-back from trials, materials side by side."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..errors import InputError, positive
from ..files.units import TO_MM
from ..robots.file import load_robot
from ..robots.materials import ZERO_CELSIUS
from ..robots.tubes import Tube
from ..runs.mold_file import load_mold_spec, load_springback, load_trials
from ..runs.mold_study import Ranking
from ..shaping.mold.heat import HeatSpec
from ..shaping.mold.materials import mold_material
from ..shaping.mold.ranking import rank_mold_materials
from ..shaping.mold.robot import plan_robot_mold
from ..shaping.mold.spec import MoldSpec
from ..shaping.mold.springback import calibrate_springback
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, PlotOption, RobotArgument


class _PlanByDefault(TyperGroup):
    """`tubeopt mold ROBOT.yaml` is short for `tubeopt mold plan ROBOT.yaml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `plan` in front of arguments that name no command."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["plan", *args]
        rest: list[str] = super().parse_args(ctx, args)
        return rest


app = typer.Typer(cls=_PlanByDefault, help="Molds for setting the shape of tubes.", no_args_is_help=True)

TubesOption = Annotated[
    str | None,
    typer.Option("--tubes", metavar="N,..", help="Which tubes, from 1; by default every different curved one."),
]


@app.command(epilog="Example: tubeopt mold plan configs/robots/thesis_etr.yaml --out results")
def plan(
    robot: RobotArgument,
    mold: Annotated[
        str | None, typer.Option("--mold", metavar="MOLD.yaml", help="What is asked of the mold.", show_default=False)
    ] = None,
    tubes: TubesOption = None,
    material: Annotated[
        str | None, typer.Option(help="steel, mdf, glass_mica or calcium_silicate; by default that of the mold file.")
    ] = None,
    springback: Annotated[
        str | None, typer.Option(metavar="FILE.yaml", help="Spring-back from `tubeopt mold calibrate`.")
    ] = None,
    cold_length_mm: Annotated[
        float | None, typer.Option(help="From a clamp to where the tube is hot; by default estimated.")
    ] = None,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The mold for the tubes of a robot: DXF, SVG, STL, G-code and a set-up sheet."""
    made_of = load_robot(robot)
    spec = MoldSpec() if mold is None else load_mold_spec(mold)
    if material is not None:
        spec = replace(spec, material=mold_material(material))
    if springback is not None:
        spec = replace(spec, springback=load_springback(springback))
    if cold_length_mm is not None:
        spec = replace(spec, cold_length=positive("--cold-length-mm", cold_length_mm, zero=True) / TO_MM)
    numbers = _tube_numbers(tubes)
    can_be_saved(out)
    present(report(plan_robot_mold(made_of, spec, numbers)), out=out, as_json=as_json, plot=plot)


def _tube_numbers(text: str | None) -> list[int] | None:
    """`1,3` as numbers; raises InputError for anything else."""
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdigit() for part in parts):
        raise InputError(f"--tubes is {text!r}; it must be numbers from 1, with commas between")
    return [int(part) for part in parts]


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
