"""`tubeopt fabricate`: molds and heating schedules for every tube of a robot, in one go."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..errors import SolveError
from ..files.files import write_text
from ..robots.file import load_robot, save_robot
from ..runs.mold_file import load_mold_spec
from ..runs.rig_file import load_rig, save_rig
from ..shaping.heating.robust import Uncertainty
from ..shaping.mold.robot import RobotMold, chosen_tubes
from ..shaping.mold.spec import MoldSpec
from ..shaping.tube_fabrication import TubeFabrication, heating_for, plan_tube
from ..show.heat_report import HeatReport
from ..show.mold_report import MoldReport
from ..show.progress import working
from ..show.report import can_be_saved, present, to_text
from .heat import DEFAULT_CHARGES, ChargesOption, chosen_charges, missed, report_of
from .options import JsonOption, RobotArgument

MM = 1e3


def fabricate(
    robot: RobotArgument,
    rig: Annotated[str, typer.Option("--rig", metavar="RIG.yaml", help="Rig file.", show_default=False)],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Save the results into this directory.", show_default=False)
    ],
    mold: Annotated[
        str | None, typer.Option("--mold", metavar="MOLD.yaml", help="What is asked of the mold.", show_default=False)
    ] = None,
    hold_s: Annotated[
        float | None, typer.Option(help="Length of the hold; by default the mold file's, 60.", show_default=False)
    ] = None,
    objective: Annotated[str, typer.Option(help="time, energy or margin.")] = "time",
    charges_percent: ChargesOption = DEFAULT_CHARGES,
    samples: Annotated[int, typer.Option(help="Uncertain rigs in the ensemble; 0 for no band.")] = 32,
    as_json: JsonOption = False,
) -> None:
    """Molds and schedules for every tube of a robot: drawings, G-code, duties by the battery's voltage, pictures.

    The mold is drawn for the rig, and the heating planned on the rig with the mold as drawn. Ends with 3 where the
    window cannot be held within limit, ramp and currents for one of them, or where mold and heating do not agree;
    everything is shown and saved all the same.
    """
    made_of = load_robot(robot)
    heated_on = load_rig(rig)
    asked = MoldSpec() if mold is None else load_mold_spec(mold)
    spec = replace(heating_for(asked.heat), objective=objective)
    spec = spec if hold_s is None else replace(spec, hold_time=hold_s)
    charges = chosen_charges(charges_percent)
    chosen, left_out = chosen_tubes(made_of)
    can_be_saved(out)
    parts = []
    with working("planning molds and schedules") as progress:
        for k, number in enumerate(chosen):
            progress(k, len(chosen))
            # Each tube has a mold of its own: its arc and its length of cold end decide the plate.
            made = plan_tube(made_of.tubes[number - 1], heated_on, asked, spec, number=number)
            heat = report_of(made.heating, charges, (Uncertainty(), samples, False))
            drawn = MoldReport(RobotMold(made.mold, made_of.name, (number,), ()))
            parts.append(TubeParts(number, made, drawn, heat))
        progress(len(chosen), len(chosen))
    report = FabricationReport(made_of, tuple(parts), tuple(left_out))
    present(report, out=out, as_json=as_json)
    faults = [f"tube {part.number}: {words}" for part in parts for words in part.faults]
    if faults:
        raise SolveError("; ".join(faults))


@dataclass(frozen=True)
class TubeParts:
    """Mold and schedules of one tube; number from 1."""

    number: int
    made: TubeFabrication
    mold: MoldReport
    heat: HeatReport

    @property
    def faults(self) -> tuple[str, ...]:
        """What is not kept, in words."""
        plan = self.heat.plan
        found = [] if plan.feasible else [missed(plan)]
        return (*found, *([] if self.made.agreed else [self.made.disagreement]))

    def record(self) -> dict[str, Any]:
        """Mold and heating as JSON, and how they agree."""
        made = self.made
        return {
            "tube": self.number,
            "mold": self.mold.record(),
            "heating": self.heat.record(),
            "between_clamps_mm": {"mold": made.groove.free_length * MM, "heating": made.heating.free_length * MM},
            "agreed": made.agreed,
            "disagreement": made.disagreement,
            "rounds": made.rounds,
            "remarks": list(made.remarks),
        }


@dataclass(frozen=True)
class FabricationReport:
    """Everything that it takes to make a robot's tubes."""

    robot: Any
    parts: tuple[TubeParts, ...]
    left_out: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """The answer as JSON: mold and heating of every tube."""
        tubes = [part.record() for part in self.parts]
        return {"robot": self.robot.name, "tubes": tubes, "left_out": list(self.left_out)}

    def table(self) -> Group:
        """The answer for a person: a row for every tube."""
        title = f"{self.robot.name or 'robot'}: molds and schedules"
        table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
        for name in ("tube", "window", "curved part", "duty", "heating", "mold", "leads", "between clamps"):
            table.add_column(name)
        notes = []
        for part in self.parts:
            plan = part.heat.plan
            hold = plan.duty[plan.in_hold][:-1]
            table.add_row(
                str(part.number),
                plan.verdict,
                f"{plan.lowest:.0f} to {plan.highest:.0f} degC",
                f"{hold.max()} to {hold.min()}",
                f"{plan.hold_start:g} + {plan.spec.hold_time:g} s",
                f"radius {part.made.groove.radius * MM:.2f} mm",
                f"{plan.rig.mold.lead * MM:.1f} mm",
                f"{part.made.groove.free_length * MM:.1f} mm",
            )
            said = (*part.made.remarks, *plan.problems, *([] if part.made.agreed else [part.made.disagreement]))
            notes += [f"tube {part.number}: {words}" for words in said]
            notes += [f"tube {part.number}: what would help: {cure.change}" for cure in plan.cures]
        lines = [Text(words, style="yellow") for words in (*notes, *self.left_out)]
        return Group(table, *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write robot.yaml, fabrication.json, and for every tube N mold/, heating/ and rig.yaml in tube_N/."""
        paths = [directory / "robot.yaml", directory / "fabrication.json"]
        save_robot(self.robot, paths[0])
        write_text(paths[1], to_text(self.record()))
        for part in self.parts:
            place = directory / f"tube_{part.number}"
            paths += part.mold.save(place / "mold") + part.heat.save(place / "heating")
            paths.append(place / "rig.yaml")
            rig = replace(part.heat.plan.rig, tube=part.heat.plan.tube)
            save_rig(rig, paths[-1], f"The rig with the mold of tube {part.number} as drawn.")
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write the pictures of every mold and schedule."""
        paths = []
        for part in self.parts:
            place = directory / f"tube_{part.number}"
            paths += part.mold.draw(place / "mold") + part.heat.draw(place / "heating")
        return paths
