"""What is said and saved about where to measure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import RenderableType

from ..files.files import write_text
from ..files.units import SIGNS
from ..robots.file import waypoints_csv
from ..validation import Placement
from .quantities import Quantity, described, in_units, with_unit
from .report import Report, grid
from .validation_report import SUFFIXES


def _expected(p: Placement) -> list[dict[str, Any]]:
    rows = zip(p.parameters, p.units, p.standard_errors.tolist(), p.random.tolist(), strict=True)
    return [
        {"name": name} | with_unit(SUFFIXES[unit], {"standard_error": own, "at_random": random})
        for name, unit, own, random in rows
    ]


PLACEMENT = described(
    Placement,
    Quantity("robot", "name of the robot", lambda p: p.robot.name),
    Quantity(
        "count",
        "number of configurations to measure",
        lambda p: int(p.measured.sum()),
        form="d",
        label="configurations to measure",
    ),
    Quantity(
        "waypoints",
        "number of waypoints, with home and detours around snaps",
        lambda p: len(p.measured),
        form="d",
        label="waypoints with home and what leads round snaps",
    ),
    Quantity("least_margin", "smallest margin", lambda p: p.margin.min(), form=".3f", label="least margin"),
    "noise",
    Quantity("expected", "expected standard errors, and those of random configurations", _expected),
    "rotations translations measured",
)


class PlacementReport(Report[Placement]):
    command = "measure"
    quantities = PLACEMENT
    file = "report.json"

    def below(self) -> list[RenderableType]:
        """The expected errors."""
        p = self.answer
        cells = []
        for name, unit, own, random in zip(p.parameters, p.units, p.standard_errors, p.random, strict=True):
            suffix = SUFFIXES[unit]
            sign = SIGNS.get(suffix, suffix)
            shown = (f"{in_units(float(x), suffix):.3g} {sign}".strip() for x in (own, random))
            cells.append((name, *shown, f"{random / own:.1f}"))
        heads = ("parameter", "standard error >", "at random >", "times less >")
        return [grid(heads, cells, key=True)]

    def save(self, directory: Path) -> list[Path]:
        """Write report.json, path.csv, which `tubeopt follow` reads, and configurations.csv, those to measure."""
        a = self.answer
        tables = {"path.csv": a.measured >= 0, "configurations.csv": a.measured}
        for name, rows in tables.items():
            write_text(directory / name, waypoints_csv(a.rotations[rows], a.translations[rows]))
        return [self.save_record(directory), *(directory / name for name in tables)]
