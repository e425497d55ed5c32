"""What is said and saved about everything that it takes to make a robot's tubes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rich.console import Group
from rich.text import Text

from ..errors import SolveError
from ..files.units import TO_MM
from ..robots.file import save_robot
from ..runs.heating_study import Fabrication, TubeParts
from ..runs.rig_file import save_rig
from .heat_report import HEATING, SUCCESS, HeatingReport, held_duties, missed, success_words, unlikely
from .mold_report import MOLD, MoldReport
from .quantities import Quantity, described, of_field
from .report import Drawing, Report, grid, remarks

TUBE = described(
    TubeParts,
    "number",
    of_field(TubeParts, "mold", of=MOLD),
    of_field(TubeParts, "heating", of=HEATING),
    Quantity(
        "between_clamps_mm",
        "length of tube between the clamps, by the mold and by the heating",
        lambda part: {
            "mold": part.made.groove.free_length * TO_MM,
            "heating": part.made.heating.free_length * TO_MM,
        },
    ),
    Quantity("agreed", "true if mold and heating agree", lambda part: part.made.agreed),
    Quantity("disagreement", "difference between them, as text", lambda part: part.made.disagreement),
    Quantity("rounds", "number of rounds to agreement", lambda part: part.made.rounds),
    Quantity("remarks", "remarks for making it", lambda part: part.made.remarks),
)

FABRICATION = described(
    Fabrication,
    *SUCCESS,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    of_field(Fabrication, "parts", of=TUBE),
    "left_out",
)


def _faults(a: Fabrication) -> list[str]:
    """What is not kept, in words."""
    found = []
    for part in a.parts:
        plan = part.heating.plan
        kept = unlikely(part.heating.success) if plan.feasible else missed(plan)
        found += [f"tube {part.number}: {kept}"] if kept else []
        found += [] if part.made.agreed else [f"tube {part.number}: {part.made.disagreement}"]
    return found


class FabricationReport(Report[Fabrication]):
    command = "fabricate"
    quantities = FABRICATION
    file = "fabrication.json"

    def table(self) -> Group:
        """A row for every tube, and the remarks."""
        cells, notes = [], []
        for part in self.answer.parts:
            plan, made = part.heating.plan, part.made
            most, least = held_duties(plan)
            cells.append(
                (
                    str(part.number),
                    plan.verdict,
                    f"{plan.lowest:.0f} to {plan.highest:.0f} degC",
                    f"{most} to {least}",
                    f"{plan.hold_start:g} + {plan.spec.hold_time:g} s",
                    f"radius {made.groove.radius * TO_MM:.2f} mm",
                    f"{plan.rig.mold.lead * TO_MM:.1f} mm",
                    f"{made.groove.free_length * TO_MM:.1f} mm",
                )
            )
            said = (*made.remarks, *plan.problems, *([] if made.agreed else [made.disagreement]))
            notes += [f"tube {part.number}: {words}" for words in said]
            notes += [f"tube {part.number}: what would help: {cure.change}" for cure in plan.cures]
        columns = ("tube", "window", "curved part", "duty", "heating", "mold", "leads", "between clamps")
        title = f"{self.title()}: molds and schedules"
        sure = [f"tube {part.number}: {success_words(part.heating.success)}" for part in self.answer.parts]
        return Group(
            *(Text(words, style="bold") for words in sure),
            grid(columns, cells, title=title),
            *remarks((*notes, *self.answer.left_out)),
        )

    def save(self, directory: Path) -> list[Path]:
        """Write robot.yaml, fabrication.json, and for tube N mold/, heating/, rig.yaml and sheet.pdf in tube_N/."""
        from .plots.sheet import plot_fabrication_sheet

        save_robot(self.answer.robot, directory / "robot.yaml")
        paths = [directory / "robot.yaml", self.save_record(directory)]
        for part in self.answer.parts:
            place = directory / f"tube_{part.number}"
            paths += MoldReport(part.mold).save(place / "mold") + HeatingReport(part.heating).save(place / "heating")
            paths.append(place / "rig.yaml")
            rig = replace(part.heating.plan.rig, tube=part.heating.plan.tube)
            save_rig(rig, paths[-1], f"The rig with the mold of tube {part.number} as drawn.")
            title = f"{self.answer.robot.name or 'robot'}, tube {part.number}"
            words = success_words(part.heating.success)
            plot_fabrication_sheet(part.made, place / "sheet.pdf", title=title, success=words)
            paths.append(place / "sheet.pdf")
        return paths

    def pictures(self) -> dict[str, Drawing]:
        """Those of every mold and schedule, in the folders of the tubes."""
        return {
            f"tube_{part.number}/{folder}/{name}": draw
            for part in self.answer.parts
            for folder, of in (("mold", MoldReport(part.mold)), ("heating", HeatingReport(part.heating)))
            for name, draw in of.pictures().items()
        }

    def conclude(self) -> None:
        """Raise SolveError where a window is not held, or by few rigs, or mold and heating do not agree."""
        faults = _faults(self.answer)
        if faults:
            raise SolveError("; ".join(faults))
