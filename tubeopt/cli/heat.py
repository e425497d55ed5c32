"""`tubeopt heat`: heating schedules for a tube on a rig, and the rig's calibration."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..errors import InputError, SolveError
from ..robots.file import load_robot
from ..robots.tubes import Tube
from ..runs.rig_file import load_heating_log, load_heating_trials, load_rig
from ..shaping.heating.calibration import FACTORS, calibrate
from ..shaping.heating.files import slot_milliseconds
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.rig import Rig
from ..shaping.heating.robust import CHARGES, Uncertainty, assess, charge_tables, most_likely
from ..shaping.heating.spec import HeatingSpec
from ..shaping.heating.trials import calibrate_from_trials
from ..shaping.mold.materials import mold_material
from ..show.heat_report import FitReport, HeatReport, TrialReport
from ..show.progress import working
from ..show.report import can_be_saved, present
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
    made = _with(load_rig(rig), material, voltage)
    heated = chosen_tube(made, robot, tube)
    window = _floats("--window-degC", window_degc)
    spec = HeatingSpec(
        window_degC=window,  # type: ignore[arg-type]
        hold_time=hold_s,
        limit_degC=limit_degc,
        ramp=ramp_k_per_s,
        objective=objective,
        longest_heating=longest_s,
        slot=slot_s,
        quench=quench,
        free=tuple(part.strip() for part in free.split(",") if part.strip()),
    )
    charges = chosen_charges(charges_percent)
    slot_milliseconds(spec.slot)
    uncertainty = Uncertainty(loss=loss_percent / 100)
    can_be_saved(out)
    with working("planning the heating") as progress:
        answer = heat_report(
            made, heated, spec, charges, (uncertainty, samples if loss_percent else 0, robust), progress
        )
    present(answer, out=out, as_json=as_json, plot=plot)
    if not answer.plan.feasible:
        raise SolveError(missed(answer.plan))


def missed(plan: HeatingPlan) -> str:
    """What a plan does not keep, in words."""
    low, high = plan.spec.window_degC
    window = f"the window of {low:g} to {high:g} degC cannot be held for {plan.spec.hold_time:g} s"
    cold = [f"it is missed by {plan.shortfall:.1f} K"] if plan.shortfall > 0 else []
    return f"{window}{':' if cold else ' within the limits:'} {'; '.join((*cold, *plan.broken))}"


def heat_report(
    rig: Rig,
    tube: Tube,
    spec: HeatingSpec,
    charges: tuple[float, ...],
    ensemble: tuple[Uncertainty, int, bool],
    progress: Any = None,
) -> HeatReport:
    """The plan with its tables by charge and its band; `ensemble`: uncertainty, samples (0: none), whether to scale."""
    tell = progress or (lambda done, total: None)
    tell(0, 1 + len(charges) + bool(ensemble[1]))
    return report_of(plan_heating(tube, rig, spec), charges, ensemble, progress)


def report_of(
    planned: HeatingPlan,
    charges: tuple[float, ...],
    ensemble: tuple[Uncertainty, int, bool],
    progress: Any = None,
) -> HeatReport:
    """A plan with its tables by charge and its band, as above."""
    uncertainty, samples, robust = ensemble
    steps = 1 + len(charges) + bool(samples)
    tell = progress or (lambda done, total: None)
    tell(1, steps)
    band, scale = None, 1.0
    if samples:
        if robust:
            better = most_likely(planned, uncertainty, samples=samples)
            planned, band, scale = better.plan, better.band, better.scale
        else:
            band = assess(planned, uncertainty, samples=samples)
    tables: list[HeatingPlan] = []
    for k, charge in enumerate(charges):
        tables += charge_tables(planned, [charge])
        tell(2 + k, steps)
    tell(steps, steps)
    return HeatReport(planned, tuple(tables), band, uncertainty, scale)


def _with(rig: Rig, material: str | None, voltage: float | None) -> Rig:
    if material is not None:
        rig = replace(rig, mold=replace(rig.mold, material=mold_material(material)))
    if voltage is not None:
        rig = rig.with_charge(rig.battery.charge_at(voltage))
    return rig


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
        answer: FitReport | TrialReport
        if trials:
            answer = TrialReport(calibrate_from_trials(heated, given, load_heating_trials(log)))
        else:
            names = [name.strip() for name in parameters.split(",")]
            answer = FitReport(calibrate(heated, given, load_heating_log(log, position_mm / 1e3), names))
    present(answer, out=out, as_json=as_json, plot=plot)
