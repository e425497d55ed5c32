"""What is said and saved about the mandrel of a space curve."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..robots.tubes import Tube
from ..shaping.mold.checks import pressing_strain
from ..shaping.mold.mandrel import Block, Cylinder, Mandrel, predict_wound_tube
from ..shaping.mold.mandrel_files import write_mandrel
from .quantities import Quantity
from .report import Report


def _turned(get: Callable[[Cylinder], Any]) -> Callable[[Mandrel], Any]:
    """What is said of a turned mandrel only."""
    return lambda m: get(m.body) if isinstance(m.body, Cylinder) else None


OFF_IT: tuple[Quantity[Tube], ...] = (
    Quantity("curvature_per_m", "its largest curvature"),
    Quantity("curved_length_mm", "its curved part"),
)

MANDREL: tuple[Quantity[Mandrel], ...] = (
    Quantity("tube", "number of the tube, 1 for the innermost", lambda m: m.number),
    Quantity("made", "turned or printed", lambda m: "turned" if isinstance(m.body, Cylinder) else "printed",
             words="{made}"),
    Quantity("diameter_mm", "cylinder, diameter", _turned(lambda b: 2 * b.radius), form=".4f", optional=True),
    Quantity("length_mm", "cylinder, length", _turned(lambda b: b.length), form=".4g", optional=True),
    Quantity("helix_radius_mm", "helix, radius", _turned(lambda b: b.helix_radius), form=".4f", optional=True),
    Quantity("pitch_mm", "helix, pitch", _turned(lambda b: b.pitch), form=".4f", optional=True),
    Quantity("handed", "helix, handed", _turned(lambda b: b.handed), optional=True),
    Quantity("size_mm", "block", lambda m: m.body.size if isinstance(m.body, Block) else None, form=".4g",
             optional=True),
    Quantity("width_mm", "groove, width", form=".4g"),
    Quantity("bend_length_mm", "bend, length", lambda m: m.held.curved_length, form=".5g"),
    Quantity("curvature_per_m", "largest curvature of the groove", lambda m: m.held.curvature, form=".5g"),
    Quantity("strain_percent", "strain when wound in", lambda m: pressing_strain(m.tube, m.held.curvature), form=".3g"),
    Quantity("cold_length_mm", "cold end from the clamp", lambda m: m.cold.length, form=".4g"),
    Quantity("free_length_mm", "tube between the clamps", form=".4g"),
    Quantity("stock_length_mm", "cut the tube to", form=".4g"),
    Quantity("predicted", "what comes off it", predict_wound_tube, of=OFF_IT),
    Quantity("remarks", "what to beware of"),
)  # fmt: skip


class MandrelReport(Report[Mandrel]):
    command = "mold mandrel"
    quantities = MANDREL
    file = "mandrel.json"
    drawn = (("mandrel", "mandrel.plot_mandrel"),)

    def title(self) -> str:
        return f"mandrel of tube {self.answer.number}"

    def save(self, directory: Path) -> list[Path]:
        """Write mandrel.json and mandrel.stl, of a turned one mandrel.csv and mandrel.nc, and the sheet setup.pdf."""
        from .plots.mandrel import plot_mandrel_sheet

        paths = [self.save_record(directory), *write_mandrel(self.answer, directory)]
        plot_mandrel_sheet(self.answer, directory / "setup.pdf")
        return [*paths, directory / "setup.pdf"]
