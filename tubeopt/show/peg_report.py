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
    Quantity("hole", "row from below by letter, place in the row from the left", label="hole", words="{hole}"),
    Quantity("angle_deg", "at which its pin is set, from x", label="angle", form="g"),
    Quantity("left", "whether it stands to the left of the tube", label="side",
             words=lambda peg: "left" if peg.left else "right"),
    Quantity("pin_mm", "where its pin stands"),
    Quantity("arc_length_mm", "of the tube beside it, from the proximal clamp", label="along mm",
             words="{arc_length_mm:.1f}"),
    Quantity("room_um", "between it and a tube that lay on its curve"),
    Quantity("force_N", "with which it pushes while the tube is cold", label="push N", words="{force_N:.2f}"),
)  # fmt: skip

COOLED: tuple[Quantity[tuple[Peg, float]], ...] = (
    *within(PEG, lambda at: at[0]),
    line("colder K", lambda at: f"{at[1]:.0f}"),
)
"""Of a peg, and of how much colder the tube is there."""

PEGS: tuple[Quantity[PegBoard], ...] = (
    Quantity("tube", "number of the tube, 1 for the innermost", lambda b: b.number),
    Quantity("board_mm", "board", lambda b: b.size, form=".4g"),
    Quantity("holes", "holes, drilled once", lambda b: len(b.holes)),
    Quantity("free_length_mm", "tube between the clamps", form=".4g"),
    Quantity("cold_length_mm", "cold end from the clamp", lambda b: b.cold.length, form=".4g"),
    Quantity("deviation_mm", "tube off its curve, at most", form=".3f"),
    Quantity("heading_deviation_deg", "its heading off, at most", form=".2f"),
    Quantity("dip_K", "colder at a peg, at most", lambda b: b.heat.dip.max(initial=0.0), form=".0f"),
    Quantity("drawn_W", "heat into all pegs", lambda b: b.heat.drawn.sum(), words="{drawn_W:.2f} W"),
    Quantity("lost_W", "heat of the tube into air", lambda b: b.heat.loss * b.free_length, words="{lost_W:.1f} W"),
    Quantity("pegs", "along the tube", of=PEG),
    Quantity("remarks", "what to beware of"),
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
