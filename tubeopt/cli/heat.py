"""`tubeopt heat`: heating schedules for a tube on a rig, and the rig's calibration."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated

import typer

from ..errors import InputError
from ..files.units import TO_MM
from ..robots.file import load_robot
from ..robots.tubes import Tube
from ..runs.heating_study import HeatingStudy
from ..runs.rig_file import load_heating_log, load_heating_trials, load_rig
from ..shaping.heating.calibration import FACTORS, RigFit, calibrate
from ..shaping.heating.rig import Rig
from ..shaping.heating.robust import CHARGES
from ..shaping.heating.trials import TrialFit, calibrate_from_trials
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .flags import ask, asks
from .options import App, JsonOption, OutOption, PlanByDefault, PlotOption, numbers

app = App(cls=PlanByDefault, help="Heating schedules for setting the shape of tubes.", no_args_is_help=True)

RigArgument = Annotated[str, typer.Argument(metavar="RIG.yaml", help="Rig file.", show_default=False)]
RobotOption = Annotated[
    str | None,
    typer.Option("--robot", metavar="ROBOT.yaml", help="Robot whose tube is heated; by default the rig's own tube."),
]
DEFAULT_CHARGES = ",".join(f"{100 * charge:g}" for charge in CHARGES)
ChargesOption = Annotated[
    str, typer.Option(metavar="A,B,..", help="Also tables for these states of charge; 'none' for no tables.")
]
TubeOption = Annotated[int, typer.Option("--tube", metavar="N", help="Which tube of the robot, from 1.")]


def chosen_tube(rig: Rig, robot: str | None, number: int) -> Tube:
    """The tube that is heated; raises InputError where neither rig nor robot has it."""
    if robot is None:
        if rig.tube is None:
            raise InputError("the rig file names no tube; --robot ROBOT.yaml must name the robot whose tube is heated")
        return rig.tube
    tubes = load_robot(robot).tubes
    if not 1 <= number <= len(tubes):
        raise InputError(f"--tube is {number}; it must lie in 1 to {len(tubes)}")
    return tubes[number - 1]


def chosen_charges(text: str) -> tuple[float, ...]:
    """The states of charge of an option in percent; none for "none"."""
    return () if text == "none" else tuple(value / 100 for value in _floats("--charges-percent", text))


def _floats(name: str, text: str) -> tuple[float, ...]:
    values = numbers(text) or []
    if not all(isinstance(value, Decimal) for value in values):
        raise InputError(f"{name} is {text!r}; it must be numbers with commas between")
    return tuple(float(value) for value in values)


@app.command(epilog="Example: tubeopt heat configs/rigs/thesis_calcium_silicate.yaml --out results")
@asks(
    HeatingStudy,
    arguments={"rig": ("RIG.yaml", "Rig file.")},
    defaults={"charges_percent": DEFAULT_CHARGES, "samples": "64"},
)
def plan(study: HeatingStudy, plot: PlotOption = False, out: OutOption = None, as_json: JsonOption = False) -> None:
    """The heating schedule that holds the curved part of a tube in the window: duties, temperatures, files.

    Ends with 3 where the window cannot be held within limit, ramp and currents; the best schedule and what would help
    are shown and saved all the same.
    """
    present(report(ask(study, "planning the heating", out)), out=out, as_json=as_json, plot=plot)


@app.command("calibrate", epilog="Example: tubeopt heat calibrate configs/experiments/heating_log.csv "
             "--rig configs/rigs/thesis_calcium_silicate.yaml --out results")  # fmt: skip
def calibrate_command(
    log: Annotated[
        str,
        typer.Argument(
            metavar="LOG.csv",
            help="time_s, duty, and any of temperature_degC, voltage_V, current_A; or trials: duty, time_s, ramp_s, "
            "and result or spring_back_percent.",
            show_default=False,
        ),
    ],
    rig: Annotated[str, typer.Option("--rig", metavar="RIG.yaml", help="Rig file.", show_default=False)],
    robot: RobotOption = None,
    tube: TubeOption = 1,
    parameters: Annotated[
        str, typer.Option("--fit", metavar="NAME,..", help=f"Of {', '.join(FACTORS)}.")
    ] = "loss,gap,contact_resistance,resistivity",
    position_mm: Annotated[float, typer.Option(help="Of the thermometer from the middle of the curved part.")] = 0.0,
    trials: Annotated[bool, typer.Option("--trials", help="The file holds outcomes of trials, not a log.")] = False,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Loss and contacts of a rig from a logged heating, or from trials without a thermometer."""
    given = load_rig(rig)
    heated = chosen_tube(given, robot, tube)
    can_be_saved(out)
    with working("calibrating the rig") as progress:
        progress(0, 0)
        answer: RigFit | TrialFit
        if trials:
            answer = calibrate_from_trials(heated, given, load_heating_trials(log))
        else:
            names = [name.strip() for name in parameters.split(",")]
            answer = calibrate(heated, given, load_heating_log(log, position_mm / TO_MM), names)
    present(report(answer), out=out, as_json=as_json, plot=plot)
