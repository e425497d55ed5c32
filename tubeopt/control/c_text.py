"""Numbers of a robot as C."""

from __future__ import annotations

from pathlib import Path

from ..robots.lengthwise import lengthwise
from ..robots.robot import Robot
from ..solvers.compiled.binding import piece_sizes, piece_tables, tube_rows
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
    """The C struct Tubes, which points to PIECES."""
    home = robot.assembly(robot.home_translations)
    rows = ", ".join(f"{{{numbers(row)}}}" for row in tube_rows(robot))
    return f"{{{rows}, {int(home.eccentric)}, &PIECES}}"


def pieces_text(robot: Robot) -> str:
    """The C struct PIECES of the tubes of a robot, and its tables."""
    own = piece_tables(lengthwise(robot.tubes))
    tables = {f"PIECES_{name}": array for name, array in own.items()}
    entries = [*map(str, piece_sizes(own)), *tables, "0"]  # no refinement
    return f"{c_tables(tables)}static const Pieces PIECES = {{{', '.join(entries)}}};\n"
