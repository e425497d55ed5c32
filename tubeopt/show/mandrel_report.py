"""What is said and saved about the mandrel of a space curve."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..robots.tubes import Tube
from ..shaping.mold.checks import pressing_strain
from ..shaping.mold.mandrel import Block, Cylinder, Mandrel, predict_wound_tube, write_mandrel
from .quantities import Quantity, described
from .report import Report


def _turned(get: Callable[[Cylinder], Any]) -> Callable[[Mandrel], Any]:
    """What is said of a turned mandrel only."""
    return lambda m: get(m.body) if isinstance(m.body, Cylinder) else None


OFF_IT: tuple[Quantity[Tube], ...] = (
    Quantity("curvature_per_m", "largest curvature of the tube"),
    Quantity("curved_length_mm", "curved length of the tube"),
)

MANDREL = described(
    Mandrel,
    "number",
    Quantity("made", "method, turned or printed", lambda m: "turned" if isinstance(m.body, Cylinder) else "printed",
             words="{made}", label="turned or printed"),
    Quantity("diameter_mm", "diameter of the cylinder", _turned(lambda b: 2 * b.radius), form=".4f", optional=True,
             label="cylinder, diameter"),
    Quantity("length_mm", "length of the cylinder", _turned(lambda b: b.length), form=".4g", optional=True,
             label="cylinder, length"),
    Quantity("helix_radius_mm", "radius of the helix", _turned(lambda b: b.helix_radius), form=".4f", optional=True,
             label="helix, radius"),
    Quantity("pitch_mm", "pitch of the helix", _turned(lambda b: b.pitch), form=".4f", optional=True,
             label="helix, pitch"),
    Quantity("handed", "hand of the helix", _turned(lambda b: b.handed), optional=True),
    Quantity("size_mm", "size of the block", lambda m: m.body.size if isinstance(m.body, Block) else None, form=".4g",
             optional=True, label="block"),
    "width",
    Quantity("bend_length_mm", "length of the bend", lambda m: m.held.curved_length, form=".5g", label="bend, length"),
    Quantity("curvature_per_m", "largest curvature of the groove", lambda m: m.held.curvature, form=".5g"),
    Quantity("strain_percent", "strain of the wound tube", lambda m: pressing_strain(m.tube, m.held.curvature),
             form=".3g", label="strain when wound in"),
    Quantity("cold_length_mm", "length of the cold end from the clamp", lambda m: m.cold.length, form=".4g",
             label="cold end from the clamp"),
    "free_length",
    Quantity("stock_length_mm", "length of the tube blank", form=".4g", label="cut the tube to"),
    Quantity("predicted", "predicted tube", predict_wound_tube, of=OFF_IT),
    "remarks",
)  # fmt: skip


class MandrelReport(Report[Mandrel]):
    command = "mold mandrel"
    quantities = MANDREL
    file = "mandrel.json"
    drawn = (("mandrel", "mold.plot_mandrel"),)

    def title(self) -> str:
        return f"mandrel of tube {self.answer.number}"

    def save(self, directory: Path) -> list[Path]:
        """Write mandrel.json and mandrel.stl, of a turned one mandrel.csv and mandrel.nc, and the sheet setup.pdf."""
        from .plots.mold import plot_mandrel_sheet

        paths = [self.save_record(directory), *write_mandrel(self.answer, directory)]
        plot_mandrel_sheet(self.answer, directory / "setup.pdf")
        return [*paths, directory / "setup.pdf"]
