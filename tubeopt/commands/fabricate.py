"""`tubeopt fabricate`: molds and heating schedules for every tube of a robot, in one go."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..errors import SolveError
from ..fabrication.heating_robust import Uncertainty
from ..fabrication.heating_spec import HeatingSpec
from ..fabrication.mold_spec import MoldSpec
from ..fabrication.rig import Rig
from ..fabrication.robot_mold import chosen_tubes, plan_robot_mold
from ..fabrication.thermal import gap_transfer, vent_profile
from ..study.files import write_text
from ..study.mold_file import load_mold_spec
from ..study.rig_file import load_rig
from ..study.robot_file import load_robot, save_robot
from ..tubes import Tube
from .heat import DEFAULT_CHARGES, ChargesOption, chosen_charges, heat_report, missed
from .heat_report import HeatReport
from .mold_report import MoldReport
from .options import JsonOption, RobotArgument
from .progress import working
from .report import can_be_saved, present, to_text

MM = 1e3
VENT_CELLS = 5
"""Cells in half of the bend by which the lid's vents follow the rig's profile."""


def mold_spec_for(rig: Rig, tube: Tube, spec: MoldSpec) -> MoldSpec:
    """The mold's specification in line with the rig on which it is heated: material, gap, clamps, lead, vents."""
    clamps = replace(spec.clamps, gap=rig.clamps.clearance, grip=rig.clamps.grip)
    cold = rig.clamps.clearance + rig.mold.lead
    heat = replace(spec.heat, ambient=rig.ambient, contact_conductance=gap_transfer(rig))
    vents = replace(spec.vents, profile=lid_profile(rig, tube))
    return replace(spec, material=rig.mold.material, clamps=clamps, cold_length=cold, heat=heat, vents=vents)


def lid_profile(rig: Rig, tube: Tube) -> tuple[float, ...]:
    """Open part of the groove's area in cells along the bend, from the rig's open part of the tube's surface.

    A vent bares the upper half of the tube below it, so that the groove is open over twice the part of the surface.
    """
    if not any(rig.mold.vents):
        return (0.0,)
    ends = np.linspace(0.0, 1.0, 2 * VENT_CELLS + 1)
    middle = 0.5 * (ends[1:] + ends[:-1])
    half = 0.5 * tube.curved_length
    inward = (rig.mold.lead + half * (1 - np.abs(2 * middle - 1))) / (rig.mold.lead + half)
    return tuple((2 * vent_profile(rig, inward)).tolist())


def fabricate(
    robot: RobotArgument,
    rig: Annotated[str, typer.Option("--rig", metavar="RIG.yaml", help="Rig file.", show_default=False)],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Save the results into this directory.", show_default=False)
    ],
    mold: Annotated[
        str | None, typer.Option("--mold", metavar="MOLD.yaml", help="What is asked of the mold.", show_default=False)
    ] = None,
    hold_s: Annotated[float, typer.Option(help="Length of the hold.")] = HeatingSpec.hold_time,
    objective: Annotated[str, typer.Option(help="time, energy or margin.")] = "time",
    charges_percent: ChargesOption = DEFAULT_CHARGES,
    samples: Annotated[int, typer.Option(help="Uncertain rigs in the ensemble; 0 for no band.")] = 32,
    as_json: JsonOption = False,
) -> None:
    """Molds and schedules for every tube of a robot: drawings, G-code, duties by the battery's voltage, pictures.

    Ends with 3 where the window cannot be held for one of them; everything is shown and saved all the same.
    """
    made_of = load_robot(robot)
    heated_on = load_rig(rig)
    spec = HeatingSpec(hold_time=hold_s, objective=objective)
    charges = chosen_charges(charges_percent)
    asked = MoldSpec() if mold is None else load_mold_spec(mold)
    chosen, left_out = chosen_tubes(made_of)
    can_be_saved(out)
    parts = []
    with working("planning molds and schedules") as progress:
        for k, number in enumerate(chosen):
            progress(k, len(chosen))
            tube = made_of.tubes[number - 1]
            # Each tube has a mold of its own: its arc and its length of cold end decide the plate.
            planned = plan_robot_mold(made_of, mold_spec_for(heated_on, tube, asked), [number])
            heat = heat_report(heated_on, tube, spec, charges, (Uncertainty(), samples, False))
            parts.append(TubeParts(number, MoldReport(planned), heat))
        progress(len(chosen), len(chosen))
    report = FabricationReport(made_of, tuple(parts), tuple(left_out))
    present(report, out=out, as_json=as_json)
    faults = [f"tube {part.number}: {missed(part.heat.plan)}" for part in parts if not part.heat.plan.feasible]
    if faults:
        raise SolveError("; ".join(faults))


@dataclass(frozen=True)
class TubeParts:
    """Mold and schedules of one tube; number from 1."""

    number: int
    mold: MoldReport
    heat: HeatReport


@dataclass(frozen=True)
class FabricationReport:
    """Everything that it takes to make a robot's tubes."""

    robot: Any
    parts: tuple[TubeParts, ...]
    left_out: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """The answer as JSON: mold and heating of every tube."""
        tubes = [{"tube": p.number, "mold": p.mold.record(), "heating": p.heat.record()} for p in self.parts]
        return {"robot": self.robot.name, "tubes": tubes, "left_out": list(self.left_out)}

    def table(self) -> Group:
        """The answer for a person: a row for every tube."""
        title = f"{self.robot.name or 'robot'}: molds and schedules"
        table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
        for name in ("tube", "window", "curved part", "duty", "heating", "mold"):
            table.add_column(name)
        notes = []
        for part in self.parts:
            plan = part.heat.plan
            hold = plan.duty[plan.in_hold][:-1]
            table.add_row(
                str(part.number),
                "held" if plan.feasible else f"missed by {plan.shortfall:.1f} K",
                f"{plan.lowest:.0f} to {plan.highest:.0f} degC",
                f"{hold.max()} to {hold.min()}",
                f"{plan.hold_start:g} + {plan.spec.hold_time:g} s",
                f"radius {part.mold.mold.grooves[0].radius * MM:.2f} mm",
            )
            notes += [f"tube {part.number}: {words}" for words in plan.problems]
            notes += [f"tube {part.number}: what would help: {cure.change}" for cure in plan.cures]
        lines = [Text(words, style="yellow") for words in (*notes, *self.left_out)]
        return Group(table, *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write robot.yaml, fabrication.json, and for every tube N tube_N/mold/ and tube_N/heating/."""
        paths = [directory / "robot.yaml", directory / "fabrication.json"]
        save_robot(self.robot, paths[0])
        write_text(paths[1], to_text(self.record()))
        for part in self.parts:
            place = directory / f"tube_{part.number}"
            paths += part.mold.save(place / "mold") + part.heat.save(place / "heating")
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write the pictures of every mold and schedule."""
        paths = []
        for part in self.parts:
            place = directory / f"tube_{part.number}"
            paths += part.mold.draw(place / "mold") + part.heat.draw(place / "heating")
        return paths
