"""What is said and saved about what a robot is made of, and whether it can be built."""

from __future__ import annotations

import numpy as np
from rich.console import Group
from rich.text import Text

from ..files.units import TO_MM
from ..robots.file import AnyRobot
from ..robots.order import ends_inside
from ..robots.robot import Robot, clearances, fit_warnings
from ..robots.tubes import OfCrossSection, Tube
from .formatting import ends_in_words
from .quantities import Quantity, within
from .report import Report, grid, remarks


def _poisson_ratio(tube: Tube) -> float | None:
    """That of the material; None where a stiffness was given, of which it says nothing."""
    derived = all(isinstance(k, OfCrossSection) for k in (tube.bending_stiffness, tube.torsional_stiffness))
    return tube.material.poisson_ratio if derived else None


def _poisson_words(tube: Tube) -> str:
    ratio = _poisson_ratio(tube)
    return "–" if ratio is None else f"{ratio:.6g}"


TUBE: tuple[Quantity[Tube], ...] = (
    Quantity("outer_diameter_mm", "outer diameter", digits=9, form=".6g"),
    Quantity("inner_diameter_mm", "inner diameter", digits=9, form=".6g"),
    Quantity("straight_length_mm", "straight length", digits=9, form=".6g"),
    Quantity("curved_length_mm", "curved length", digits=9, form=".6g"),
    Quantity("length_mm", "overall length", digits=9, form=".6g"),
    Quantity("curvature_per_m", "precurvature", form=".6g"),
    Quantity("material", "material", lambda tube: tube.material.name, words="{material}"),
    Quantity("bending_stiffness_N_mm2", "bending stiffness EI", form=".6g"),
    Quantity("torsional_stiffness_N_mm2", "torsional stiffness GJ", form=".6g"),
    Quantity("poisson_ratio", "Poisson's ratio", _poisson_ratio, words=_poisson_words),
    Quantity(
        "straightened_strain_percent", "strain of the straightened tube", form=".6g", label="strain held straight"
    ),
)


NESTED: tuple[Quantity[tuple[Tube, float | None]], ...] = (
    *within(TUBE, lambda nested: nested[0]),
    Quantity("radial_clearance_mm", "radial clearance in the next tube", lambda nested: nested[1], digits=9),
)
"""Of a tube, and of its radial clearance (m) in the next one around it, None without one."""

ROBOT: tuple[Quantity[Robot], ...] = (
    Quantity("robot", "name of the robot", lambda robot: robot.name),
    Quantity("tubes", "the tubes, inner to outer", lambda robot: _nested(robot), of=NESTED),
    Quantity("home_translations_mm", "translations at home", digits=9),
    Quantity("warnings", "possible problems in making and using it", lambda robot: fit_warnings(robot)),
)


def _nested(robot: Robot) -> list[tuple[Tube, float | None]]:
    gaps = clearances(robot)
    return [(tube, gaps[i][1] / TO_MM if i in gaps else None) for i, tube in enumerate(robot.tubes)]


class RobotReport(Report[AnyRobot]):
    command = "robot show"
    quantities = ROBOT
    file = "robot.json"

    def title(self) -> str:
        return self.answer.name or "robot"

    def table(self) -> Group:
        """A row per property, a column per tube; then why the translations at home are not 0, and the warnings."""
        tubes = self.record()["tubes"]
        cells = []
        for quantity in NESTED:
            name = f"{quantity.about} ({quantity.sign})" if quantity.unit else quantity.about
            cells.append([name, *(_cell(tube[quantity.key]) for tube in tubes)])
        carriages = self.answer.home_translations * TO_MM
        cells.append(["translation at home (mm)", *(_cell(float(shift)) for shift in carriages)])
        numbers = [f"{i} >" for i in range(1, len(tubes) + 1)]
        lines = remarks(fit_warnings(self.answer), what="warning")
        found = grid(("tube", *numbers), cells, title=self.title(), key=True)
        home = [Text(words)] if (words := _home_in_words(self.answer)) else []
        return Group(found, *home, *(lines or [Text("no warnings", style="green")]))


def _home_in_words(robot: Robot) -> str:
    """Why the translations at home are not 0; empty where it is."""
    if not robot.home_translations.any():
        return ""
    inside = ends_inside(robot, np.array([tube.curved_length for tube in robot.tubes]))
    if inside and robot.nested_curves:
        return f"the translations at home are not 0: at 0, {ends_in_words(inside)}"
    return "the translations at home are not 0: limits or order of the tubes do not allow 0"


def _cell(value: float | str | None) -> str:
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.4g}"
