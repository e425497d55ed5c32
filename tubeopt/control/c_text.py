"""Numbers of a robot as C."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..robots.robot import Robot
from ..solvers.compiled.binding import piece_sizes, piece_tables
from ..solvers.compiled.text import c_tables, numbers

C_FOLDER = Path(__file__).parent / "c"

HUSHED = """/* CasADi writes for every function more than is used here; vectors are handed on within this file alone. */
#if defined(__GNUC__) || defined(__clang__)
#pragma GCC diagnostic ignored "-Wunused-function"
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#define CASADI_SYMBOL_EXPORT static
"""
"""Warnings that what is generated, and the kernel's vectors, give rise to without need."""


def tubes_text(robot: Robot) -> str:
    """The C struct Tubes; of tubes made of pieces, it points to PIECES."""
    home, none = robot.assembly(robot.home_translations), np.zeros(robot.n_tubes)
    general = home.lengthwise is not None
    even = [none, none, none] if general else [home.bending_stiffness, home.torsional_stiffness, home.curvature]
    places = [none, none] if general else [home.offset, home.offset_angle]
    lengths = [[tube.straight_length for tube in robot.tubes], [tube.length for tube in robot.tubes]]
    rows = ", ".join(f"{{{numbers(row)}}}" for row in (*even, *lengths, *places))
    return f"{{{rows}, {int(home.eccentric)}{', &PIECES' if general else ''}}}"


def pieces_text(robot: Robot) -> str:
    """The C struct PIECES of tubes made of pieces and its tables; nothing of tubes of one arc each."""
    table = robot.assembly(robot.home_translations).lengthwise
    if table is None:
        return ""
    tables = {f"PIECES_{name}": array for name, array in piece_tables(table).items()}
    entries = [*map(str, piece_sizes(piece_tables(table))), *tables, "0"]  # no refinement
    return f"{c_tables(tables)}static const Pieces PIECES = {{{', '.join(entries)}}};\n"
