"""`tubeopt heat`: heating schedules for a tube on a rig, and the rig's calibration."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..errors import InputError, SolveError
from ..files.checked import check
from ..files.units import TO_MM
from ..robots.file import load_robot
from ..robots.tubes import Tube
from ..runs.heating_study import HeatingStudy
from ..runs.rig_file import load_heating_log, load_heating_trials, load_rig
from ..shaping.heating.calibration import FACTORS, RigFit, calibrate
from ..shaping.heating.rig import Rig
from ..shaping.heating.robust import CHARGES, Uncertainty
from ..shaping.heating.spec import HeatingSpec
from ..shaping.heating.trials import TrialFit, calibrate_from_trials
from ..show.heat_report import missed
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .options import JsonOption, OutOption, PlotOption, numbers


class _PlanByDefault(TyperGroup):
    """`tubeopt heat RIG.yaml` is short for `tubeopt heat plan RIG.yaml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `plan` in front of arguments that name no command."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["plan", *args]
        rest: list[str] = super().parse_args(ctx, args)
        return rest


app = typer.Typer(cls=_PlanByDefault, help="Heating schedules for setting the shape of tubes.", no_args_is_help=True)

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
def plan(
    rig: RigArgument,
    robot: RobotOption = None,
    tube: TubeOption = 1,
    window_degc: Annotated[
        str, typer.Option("--window-degC", metavar="A,B", help="Of the curved part during the hold.")
    ] = "500,550",
    limit_degc: Annotated[
        float | None, typer.Option("--limit-degC", help="For every point at all times; by default B.")
    ] = None,
    hold_s: Annotated[float, typer.Option(help="Length of the hold.")] = HeatingSpec.hold_time,
    ramp_k_per_s: Annotated[float, typer.Option("--ramp-K-per-s", help="Greatest rate of warming.")] = HeatingSpec.ramp,
    objective: Annotated[
        str, typer.Option(help="time: soonest done; energy: least charge; margin: farthest from the window's ends.")
    ] = "time",
    slot_s: Annotated[float, typer.Option(help="For how long a duty is kept.")] = HeatingSpec.slot,
    longest_s: Annotated[float, typer.Option(help="Longest heating before the hold.")] = HeatingSpec.longest_heating,
    quench: Annotated[str, typer.Option(help="water or air.")] = HeatingSpec.quench,
    free: Annotated[str, typer.Option(metavar="NAME,..", help="Choose these of the rig: clearance, lead, vents.")] = "",
    material: Annotated[str | None, typer.Option(help="Mold material in place of the rig's.")] = None,
    voltage: Annotated[
        float | None, typer.Option("--battery-V", help="Of the battery at rest, as read; by default the rig file's.")
    ] = None,
    charges_percent: ChargesOption = DEFAULT_CHARGES,
    loss_percent: Annotated[
        float, typer.Option(help="Half-width of what is not known of the heat loss; 0 for no band.")
    ] = 100 * Uncertainty.loss,
    robust: Annotated[bool, typer.Option("--robust", help="Scale the duties to the most likely success.")] = False,
    samples: Annotated[int, typer.Option(help="Uncertain rigs in the ensemble.")] = 64,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The heating schedule that holds the curved part of a tube in the window: duties, temperatures, files.

    Ends with 3 where the window cannot be held within limit, ramp and currents; the best schedule and what would help
    are shown and saved all the same.
    """
    flags: dict[str, Any] = {
        "kind": "heating",
        "rig": rig,
        "robot": robot,
        "tube": tube,
        "window_degC": numbers(window_degc),
        "limit_degC": limit_degc,
        "hold_s": hold_s,
        "ramp_K_per_s": ramp_k_per_s,
        "objective": objective,
        "slot_s": slot_s,
        "longest_s": longest_s,
        "quench": quench,
        "free": [part.strip() for part in free.split(",") if part.strip()],
        "material": material,
        "battery_V": voltage,
        "charges_percent": [] if charges_percent == "none" else numbers(charges_percent),
        "loss_percent": loss_percent,
        "robust": robust,
        "samples": samples,
    }
    names = {key: f"--{key.replace('_', '-')}" for key in flags} | {"rig": "", "robot": ""}
    study = check(HeatingStudy, {key: value for key, value in flags.items() if value is not None}, "", names=names)
    can_be_saved(out)
    with working("planning the heating") as progress:
        answer = study.run(progress)
    present(report(answer), out=out, as_json=as_json, plot=plot)
    if not answer.plan.feasible:
        raise SolveError(missed(answer.plan))


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
