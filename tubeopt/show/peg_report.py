"""What is said and saved about the pegs that hold a tube."""

from __future__ import annotations

from pathlib import Path

from rich.console import RenderableType

from ..shaping.mold.lattice import Peg
from ..shaping.mold.peg_files import write_pegs
from ..shaping.mold.pegs import PegBoard
from .quantities import Quantity, columns, line, within
from .report import Report, grid

PEG: tuple[Quantity[Peg], ...] = (
    Quantity("hole", "hole: row from below by letter, number from the left", label="hole", words="{hole}"),
    Quantity("angle_deg", "angle of the pin from x", label="angle", form="g"),
    Quantity("left", "true if it is to the left of the tube", label="side",
             words=lambda peg: "left" if peg.left else "right"),
    Quantity("pin_mm", "position of the pin"),
    Quantity("arc_length_mm", "arc length of the tube at the peg, from the proximal clamp", label="along mm",
             words="{arc_length_mm:.1f}"),
    Quantity("room_um", "gap between the peg and a tube on its exact curve"),
    Quantity("force_N", "force on the cold tube", label="push N", words="{force_N:.2f}"),
)  # fmt: skip

COOLED: tuple[Quantity[tuple[Peg, float]], ...] = (
    *within(PEG, lambda at: at[0]),
    line("colder K", lambda at: f"{at[1]:.0f}"),
)
"""Of a peg, and of how much colder the tube is there."""

PEGS: tuple[Quantity[PegBoard], ...] = (
    Quantity("tube", "number of the tube, 1 for the innermost", lambda b: b.number),
    Quantity("board_mm", "size of the board", lambda b: b.size, form=".4g", label="board"),
    Quantity("holes", "drilled holes", lambda b: len(b.holes)),
    Quantity("free_length_mm", "length of tube between the clamps", form=".4g", label="tube between the clamps"),
    Quantity(
        "cold_length_mm",
        "length of the cold end from the clamp",
        lambda b: b.cold.length,
        form=".4g",
        label="cold end from the clamp",
    ),
    Quantity(
        "deviation_mm", "largest distance of the tube from its curve", form=".3f", label="tube off its curve, at most"
    ),
    Quantity(
        "heading_deviation_deg", "largest deviation of its direction", form=".2f", label="its heading off, at most"
    ),
    Quantity(
        "dip_K",
        "largest temperature drop at a peg",
        lambda b: b.heat.dip.max(initial=0.0),
        form=".0f",
        label="colder at a peg, at most",
    ),
    Quantity(
        "drawn_W",
        "heat flow into all pegs",
        lambda b: b.heat.drawn.sum(),
        words="{drawn_W:.2f} W",
        label="heat into all pegs",
    ),
    Quantity(
        "lost_W",
        "heat flow from the tube into air",
        lambda b: b.heat.loss * b.free_length,
        words="{lost_W:.1f} W",
        label="heat of the tube into air",
    ),
    Quantity("pegs", "pegs along the tube", of=PEG),
    Quantity("remarks", "remarks for making and using it"),
)


class PegReport(Report[PegBoard]):
    command = "mold pegs"
    quantities = PEGS
    file = "pegs.json"
    drawn = (("pegs", "pegs.plot_pegs"),)

    def title(self) -> str:
        return f"{len(self.answer.pegs)} pegs for tube {self.answer.number}"

    def below(self) -> list[RenderableType]:
        """Where every peg goes, then the remarks."""
        cooled = zip(self.answer.pegs, self.answer.heat.dip.tolist(), strict=True)
        return [grid(*columns(cooled, COOLED)), *super().below()]

    def save(self, directory: Path) -> list[Path]:
        """Write pegs.json, pegs.csv, board.dxf, board.svg and the board's programs."""
        return [self.save_record(directory), *write_pegs(self.answer, directory)]
