"""What is said and saved about the mandrel of a space curve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.text import Text

from ..files.files import write_text
from ..shaping.mold.checks import pressing_strain
from ..shaping.mold.mandrel import Cylinder, Mandrel, predict_wound_tube
from ..shaping.mold.mandrel_files import write_mandrel
from .report import to_text, two_columns

MM = 1e3


@dataclass(frozen=True)
class MandrelReport:
    """The mandrel for one tube of a robot."""

    mandrel: Mandrel

    def record(self) -> dict[str, Any]:
        """The answer as JSON."""
        m, body = self.mandrel, self.mandrel.body
        predicted = predict_wound_tube(m)
        shape: dict[str, Any]
        if isinstance(body, Cylinder):
            shape = {
                "made": "turned",
                "diameter_mm": 2 * body.radius * MM,
                "length_mm": body.length * MM,
                "helix_radius_mm": body.helix_radius * MM,
                "pitch_mm": 2 * math.pi * abs(body.lead) * MM,
                "handed": "left" if body.lead < 0 else "right",
            }
        else:
            shape = {"made": "printed", "size_mm": [x * MM for x in body.size]}
        return {
            "tube": m.number,
            **shape,
            "groove_width_mm": m.width * MM,
            "bend_length_mm": m.held.curved_length * MM,
            "largest_curvature_per_m": m.held.curvature,
            "strain_percent": 100 * pressing_strain(m.tube, m.held.curvature),
            "cold_length_mm": m.cold.length * MM,
            "free_length_mm": m.free_length * MM,
            "stock_length_mm": m.stock_length * MM,
            "predicted": {
                "largest_curvature_per_m": predicted.curvature,
                "curved_length_mm": predicted.curved_length * MM,
            },
            "remarks": list(m.remarks),
        }

    def table(self) -> Group:
        """The numbers for the workshop, then the remarks."""
        rows = []
        for key, value in self.record().items():
            if isinstance(value, (dict, tuple)) or key in ("tube", "remarks"):
                continue
            shown = " x ".join(f"{x:.4g}" for x in value) if isinstance(value, list) else value
            rows.append((_WORDS[key], f"{shown:.5g}" if isinstance(shown, float) else str(shown)))
        lines = [Text(f"remark: {line}", style="yellow") for line in self.mandrel.remarks]
        return Group(two_columns(f"mandrel of tube {self.mandrel.number}", rows), *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write mandrel.json, mandrel.stl, and of a turned one mandrel.csv and mandrel.nc."""
        write_text(directory / "mandrel.json", to_text(self.record()))
        return [directory / "mandrel.json", *write_mandrel(self.mandrel, directory)]

    def draw(self, directory: Path) -> list[Path]:
        """Write mandrel.png."""
        from .plots.mandrel import plot_mandrel

        plot_mandrel(self.mandrel, directory / "mandrel.png")
        return [directory / "mandrel.png"]


_WORDS = {
    "made": "made",
    "diameter_mm": "cylinder, diameter (mm)",
    "length_mm": "cylinder, length (mm)",
    "helix_radius_mm": "helix, radius (mm)",
    "pitch_mm": "helix, pitch (mm)",
    "handed": "helix, handed",
    "size_mm": "block (mm)",
    "groove_width_mm": "groove, width (mm)",
    "bend_length_mm": "bend, length (mm)",
    "largest_curvature_per_m": "largest curvature (1/m)",
    "strain_percent": "strain when wound (%)",
    "cold_length_mm": "cold end from the clamp (mm)",
    "free_length_mm": "from clamp to clamp (mm)",
    "stock_length_mm": "cut the tube to (mm)",
}
