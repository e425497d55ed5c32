"""Numbers of a robot as C."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..robots.robot import Robot
from ..solvers.compiled.text import numbers

C_FOLDER = Path(__file__).parent / "c"


def tubes_text(robot: Robot) -> str:
    """The C struct Tubes; of tubes made of pieces, it points to PIECES."""
    home, none = robot.assembly(robot.home_translations), np.zeros(robot.n_tubes)
    general = home.lengthwise is not None
    even = [none, none, none] if general else [home.bending_stiffness, home.torsional_stiffness, home.curvature]
    places = [none, none] if general else [home.offset, home.offset_angle]
    lengths = [[tube.straight_length for tube in robot.tubes], [tube.length for tube in robot.tubes]]
    rows = ", ".join(f"{{{numbers(row)}}}" for row in (*even, *lengths, *places))
    return f"{{{rows}, {int(home.eccentric)}{', &PIECES' if general else ''}}}"
