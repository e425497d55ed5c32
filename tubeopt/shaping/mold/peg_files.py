"""Files of pegs and their board: a table, the drawing (DXF, SVG), the board's program; all read back."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import scipy

from ...errors import SolveError
from ...files.csv_file import to_csv
from ...files.files import write_text
from ...files.units import TO_MM
from .checks import beyond_edge
from .drawing import TEXT_HEIGHT_MM, Drawing, in_mm, rectangle
from .files import write_drawing
from .gcode import Program, plate_stages, programs_for, write_programs
from .gcode_reader import TOLERANCE, read_gcode
from .holes import Hole
from .pegs import PegBoard

COLUMNS = ("hole", "angle_deg", "side", "pin_x_mm", "pin_y_mm", "arc_length_mm", "force_N", "colder_by_K")


def write_pegs(board: PegBoard, directory: Path) -> list[Path]:
    """Write pegs.csv, board.dxf, board.svg and the programs board_1.nc, ... of the board; return the paths.

    The DXF file is left out with a warning where ezdxf is not installed.

    Raises:
        InputError: a file cannot be written.
        SolveError: read back, a pin stands, or a hole is drilled, more than 10 um from where it is meant to be.
    """
    table, made = pegs_csv(board), board_programs(board)
    off = max(_pins_off(board, table), *(_holes_off(board, each.text) for each in made[:1]))
    if off > TOLERANCE:
        raise SolveError(f"{directory}: a pin or hole deviates from its position by {off * 1e6:.3g} um")
    paths = write_drawing(draw_board(board), board.centreline.pieces, directory / "board")
    write_text(directory / "pegs.csv", table)
    return [*paths, directory / "pegs.csv", *write_programs(made, directory)]


def pegs_csv(board: PegBoard) -> str:
    """A row for every peg along the tube: hole, angle of its pin from x, side of the tube, where the pin stands."""
    rows = [
        (
            peg.hole,
            f"{math.degrees(peg.angle):.6g}",
            "left" if peg.left else "right",
            *(f"{x * TO_MM:.4f}" for x in (*peg.pin, peg.arc_length)),
            f"{peg.force:.2f}",
            f"{dip:.1f}",
        )
        for peg, dip in zip(board.pegs, board.heat.dip, strict=True)
    ]
    spec = board.spec.pegs
    comment = (
        f"tube {board.number}: holes by row (letter, from below) and place in it; lattice of {spec.pitch * TO_MM:g} mm "
        f"on its corner, pins {spec.eccentricity * TO_MM:g} mm off"
    )
    return to_csv(COLUMNS, rows, comment)


def board_programs(board: PegBoard) -> list[Program]:
    """The programs of the board: its holes, and its outline where it is cut out."""
    spec = board.spec
    holes = [Hole("hole", place, spec.pegs.shank) for place in board.holes.values()]
    stages = plate_stages(holes, board.size, spec.plate.thickness, spec)
    clear = beyond_edge([], spec) if spec.workshop.cut_out else 0.0
    return programs_for("board", "board of pegs", clear, spec, stages)


def draw_board(board: PegBoard) -> Drawing:
    """The board with its holes and the tube's centreline; pegs are written beside it."""
    width, height = (side * TO_MM for side in board.size)
    spec = board.spec.pegs
    words = [
        f"board of pegs, {width:g} x {height:g} mm: {len(board.holes)} holes of {spec.shank * TO_MM:g} mm",
        f"tube {board.number}: " + ", ".join(f"{peg.hole} at {math.degrees(peg.angle):g} deg" for peg in board.pegs),
    ]
    step = 1.6 * TEXT_HEIGHT_MM
    return Drawing(
        size=(width, height),
        pieces={
            "OUTLINE": rectangle(width, height),
            "CENTERLINE": tuple(in_mm(piece) for piece in board.centreline.pieces),
        },
        circles=tuple(((x * TO_MM, y * TO_MM), spec.shank * TO_MM) for x, y in board.holes.values()),
        texts=tuple(((0.0, -(k + 2) * step), line) for k, line in enumerate(words)),
    )


def _pins_off(board: PegBoard, table: str) -> float:
    """Greatest distance (m) of the pins that holes and angles of the table make from those planned."""
    read = csv.DictReader(line for line in table.splitlines() if not line.startswith("#"))
    worst = 0.0
    for row, peg in zip(read, board.pegs, strict=True):
        x, y = board.holes[row["hole"]]
        angle, away = math.radians(float(row["angle_deg"])), board.spec.pegs.eccentricity
        pin = x + away * math.cos(angle), y + away * math.sin(angle)
        said = float(row["pin_x_mm"]) / TO_MM, float(row["pin_y_mm"]) / TO_MM
        worst = max(worst, math.dist(pin, peg.pin), math.dist(said, peg.pin))
    return worst


def _holes_off(board: PegBoard, text: str) -> float:
    """Greatest distance (m) between holes wanted and those that a program drills through, either way."""
    deep = -board.spec.plate.thickness
    done = np.array([motion.piece.end for motion in read_gcode(text) if motion.end < deep and motion.feed is not None])
    wanted = np.array(list(board.holes.values()))
    if not len(done):
        return math.inf
    apart = scipy.spatial.distance.cdist(wanted, done)
    return float(max(apart.min(0).max(), apart.min(1).max()))
