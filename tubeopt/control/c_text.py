"""Numbers of a robot as C."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..robots.robot import Robot

C_FOLDER = Path(__file__).parent / "c"


def numbers(values: ArrayLike) -> str:
    """Literals, by rows, that are read back to the last bit."""

    def literal(value: float) -> str:
        return repr(value) if np.isfinite(value) else "-INFINITY" if value < 0 else "INFINITY"

    return ", ".join(literal(float(value)) for value in np.ravel(np.asarray(values, dtype=float)))


def static_table(name: str, values: ArrayLike) -> str:
    """A constant of C."""
    return f"static const double {name}[] = {{{numbers(values)}}};"


def tubes_text(robot: Robot) -> str:
    """The C struct Tubes; of tubes made of pieces, it points to PIECES."""
    home, none = robot.assembly(robot.home_translations), np.zeros(robot.n_tubes)
    general = home.lengthwise is not None
    even = [none, none, none] if general else [home.bending_stiffness, home.torsional_stiffness, home.curvature]
    places = [none, none] if general else [home.offset, home.offset_angle]
    lengths = [[tube.straight_length for tube in robot.tubes], [tube.length for tube in robot.tubes]]
    rows = ", ".join(f"{{{numbers(row)}}}" for row in (*even, *lengths, *places))
    return f"{{{rows}, {int(home.eccentric)}{', &PIECES' if general else ''}}}"
