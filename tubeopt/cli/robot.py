"""`tubeopt robot`: what a robot is made of, and whether it can be built."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..files.files import write_text
from ..robots.file import load_robot
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..show.report import present, to_text
from .options import JsonOption, OutOption, RobotArgument

TIGHT_MM = 0.01
"""Radial clearance below which tubes bind: what drawn tubing and its ovality already use up."""

LOOSE_MM = 0.1
"""Radial clearance above which the inner tube lies visibly off the centreline that the model gives both."""

app = typer.Typer(help="What a robot is made of.", no_args_is_help=True)


@app.command(epilog="Example: tubeopt robot show configs/robots/thesis_ctr.yaml")
def show(robot: RobotArgument, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Stiffness, strain and fit of every tube, with warnings."""
    present(RobotReport(load_robot(robot)), out=out, as_json=as_json)


def clearances(robot: Robot) -> dict[int, tuple[int, float]]:
    """Tube -> the tube around it, if any, and the radial clearance (mm) between them; tubes counted from 0."""
    return {
        i: (o, _mm(robot.tubes[o].inner_diameter - robot.tubes[i].outer_diameter) / 2) for i, o in robot.nested_pairs
    }


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


@dataclass(frozen=True)
class RobotReport:
    """What is said and saved about a robot."""

    robot: Robot

    def record(self) -> dict[str, Any]:
        """The answer as JSON: a mapping per tube, and the warnings."""
        gaps = clearances(self.robot)
        tubes = [
            _tube(tube) | {"radial_clearance_mm": gaps[i][1] if i in gaps else None}
            for i, tube in enumerate(self.robot.tubes)
        ]
        return {"robot": self.robot.name, "tubes": tubes, "warnings": warnings(self.robot)}

    def table(self) -> Group:
        """A row per property, a column per tube; then the warnings."""
        record = self.record()
        table = Table(title=self.robot.name or "robot", title_justify="left", box=None, padding=(0, 2, 0, 0))
        table.add_column("tube", style="bold", no_wrap=True)
        for i, _ in enumerate(self.robot.tubes, start=1):
            table.add_column(str(i), justify="right")
        for key in record["tubes"][0]:
            name, unit = _WORDS[key]
            table.add_row(f"{name} ({unit})" if unit else name, *(_cell(tube[key]) for tube in record["tubes"]))
        lines = [Text(f"warning: {line}", style="yellow") for line in record["warnings"]]
        return Group(table, *(lines or [Text("no warnings", style="green")]))

    def save(self, directory: Path) -> list[Path]:
        """Write robot.json."""
        path = directory / "robot.json"
        write_text(path, to_text(self.record()))
        return [path]

    def draw(self, directory: Path) -> list[Path]:
        """A robot without joint values has no picture."""
        return []


_WORDS = {
    "outer_diameter_mm": ("outer diameter", "mm"),
    "inner_diameter_mm": ("inner diameter", "mm"),
    "straight_length_mm": ("straight length", "mm"),
    "curved_length_mm": ("curved length", "mm"),
    "length_mm": ("overall length", "mm"),
    "curvature_per_m": ("precurvature", "1/m"),
    "material": ("material", ""),
    "bending_stiffness_N_mm2": ("bending stiffness EI", "N mm²"),
    "torsional_stiffness_N_mm2": ("torsional stiffness GJ", "N mm²"),
    "poisson_ratio": ("Poisson's ratio", ""),
    "straightened_strain_percent": ("strain held straight", "%"),
    "radial_clearance_mm": ("radial clearance in the next", "mm"),
}


def _mm(length: float) -> float:
    return round(length * 1e3, 9)  # without the last digits, which only tell how mm become m


def _tube(tube: Tube) -> dict[str, Any]:
    return {
        "outer_diameter_mm": _mm(tube.outer_diameter),
        "inner_diameter_mm": _mm(tube.inner_diameter),
        "straight_length_mm": _mm(tube.straight_length),
        "curved_length_mm": _mm(tube.curved_length),
        "length_mm": _mm(tube.length),
        "curvature_per_m": tube.curvature,
        "material": tube.material.name,
        "bending_stiffness_N_mm2": tube.bending_stiffness * 1e6,
        "torsional_stiffness_N_mm2": tube.torsional_stiffness * 1e6,
        "poisson_ratio": tube.material.poisson_ratio,
        "straightened_strain_percent": tube.straightened_strain * 100,
    }


def _cell(value: float | str | None) -> str:
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.4g}"
