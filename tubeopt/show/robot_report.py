"""What is said and saved about what a robot is made of, and whether it can be built."""

from __future__ import annotations

from typing import NamedTuple

from rich.console import Group
from rich.text import Text

from ..files.units import TO_MM
from ..robots.file import AnyRobot
from ..robots.robot import Robot
from ..robots.tubes import OfCrossSection, Tube
from .quantities import Quantity, within
from .report import Report, grid, remarks, report

TIGHT_MM = 0.01
"""Radial clearance below which tubes bind: what drawn tubing and its ovality already use up."""

LOOSE_MM = 0.1
"""Radial clearance above which the inner tube lies visibly off the centreline that the model gives both."""

TUBE: tuple[Quantity[Tube], ...] = (
    Quantity("outer_diameter_mm", "outer diameter", digits=9),
    Quantity("inner_diameter_mm", "inner diameter", digits=9),
    Quantity("straight_length_mm", "straight length", digits=9),
    Quantity("curved_length_mm", "curved length", digits=9),
    Quantity("length_mm", "overall length", digits=9),
    Quantity("curvature_per_m", "precurvature"),
    Quantity("material", "material", lambda tube: tube.material.name),
    Quantity("bending_stiffness_N_mm2", "bending stiffness EI"),
    Quantity("torsional_stiffness_N_mm2", "torsional stiffness GJ"),
    Quantity("poisson_ratio", "Poisson's ratio", lambda tube: _poisson_ratio(tube)),
    Quantity("straightened_strain_percent", "strain held straight"),
)


def _poisson_ratio(tube: Tube) -> float | None:
    """That of the material; None where a stiffness was given, of which it says nothing."""
    derived = all(isinstance(k, OfCrossSection) for k in (tube.bending_stiffness, tube.torsional_stiffness))
    return tube.material.poisson_ratio if derived else None


class Nested(NamedTuple):
    """A tube, and its radial clearance (m) in the next one around it, None without one."""

    tube: Tube
    clearance: float | None


NESTED: tuple[Quantity[Nested], ...] = (
    *within(TUBE, lambda nested: nested.tube),
    Quantity("radial_clearance_mm", "radial clearance in the next", lambda nested: nested.clearance, digits=9),
)

ROBOT: tuple[Quantity[Robot], ...] = (
    Quantity("robot", "name of the robot", lambda robot: robot.name),
    Quantity("tubes", "the tubes, inner to outer", lambda robot: _nested(robot), of=NESTED),
    Quantity("warnings", "what may go wrong when it is built and used", lambda robot: warnings(robot)),
)


def clearances(robot: Robot) -> dict[int, tuple[int, float]]:
    """Tube -> the tube around it, if any, and the radial clearance (mm) between them; tubes counted from 0."""
    return {
        i: (o, round((robot.tubes[o].inner_diameter - robot.tubes[i].outer_diameter) * TO_MM, 9) / 2)
        for i, o in robot.nested_pairs
    }


def _nested(robot: Robot) -> list[Nested]:
    gaps = clearances(robot)
    return [Nested(tube, gaps[i][1] / TO_MM if i in gaps else None) for i, tube in enumerate(robot.tubes)]


def warnings(robot: Robot) -> list[str]:
    """What may go wrong when this robot is built and used: tubes strained too far, tubes too tight or too loose."""
    found = []
    for i, tube in enumerate(robot.tubes, start=1):
        strain, name = tube.straightened_strain, tube.material.name
        reached = f"tube {i} is strained {strain * 100:.2f} % when held straight, beyond the"
        if strain > tube.material.superelastic_strain:
            found.append(f"{reached} {tube.material.superelastic_strain * 100:.3g} % from which {name} springs back")
        elif strain > tube.material.working_strain:
            found.append(f"{reached} {tube.material.working_strain * 100:.3g} % to which {name} may be cycled")
    for i, (around, clearance) in clearances(robot).items():
        fit = f"tube {i + 1} has {clearance:.3g} mm of radial clearance in tube {around + 1},"
        if clearance < TIGHT_MM:
            found.append(f"{fit} less than the {TIGHT_MM:g} mm that sliding needs: friction will wind the tubes up")
        elif clearance > LOOSE_MM:
            found.append(f"{fit} more than {LOOSE_MM:g} mm: its axis may lie beside the outer tube's")
    return found


class RobotReport(Report[Robot]):
    """What is said and saved about a robot."""

    command = "robot show"
    quantities = ROBOT
    file = "robot.json"

    def title(self) -> str:
        """The robot's name."""
        return self.answer.name or "robot"

    def table(self) -> Group:
        """A row per property, a column per tube; then the warnings."""
        tubes = self.record()["tubes"]
        cells = []
        for quantity in NESTED:
            name = f"{quantity.about} ({quantity.sign})" if quantity.unit else quantity.about
            cells.append([name, *(_cell(tube[quantity.key]) for tube in tubes)])
        numbers = [f"{i} >" for i in range(1, len(tubes) + 1)]
        lines = remarks(warnings(self.answer), what="warning")
        found = grid(("tube", *numbers), cells, title=self.title(), key=True)
        return Group(found, *(lines or [Text("no warnings", style="green")]))


def _cell(value: float | str | None) -> str:
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.4g}"


report.register(AnyRobot, RobotReport)
