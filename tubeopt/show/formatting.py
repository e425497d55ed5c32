"""Numbers of a result as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..equilibrium.result import Equilibrium
from ..files.units import TO_MILLI, TO_MM
from ..robots.order import EndInside, ends_inside, out_of_order, tip_tube
from ..robots.robot import Robot
from ..typing import Array

CLOSE_TO_A_SNAP = 0.05
"""Margin below which the table warns."""


AT_A_SNAP = 5e-4
"""Margin below which all printed digits are 0."""


def in_a_word(margin: float) -> str:
    """Meaning of a stability margin in a word."""
    if np.isnan(margin):
        return "unknown"
    if abs(margin) < AT_A_SNAP:
        return "at a snap"
    if margin < 0:
        return "unstable"
    return "close to a snap" if margin < CLOSE_TO_A_SNAP else "stable"


def margin_text(margin: float) -> str:
    """Stability margin with its meaning."""
    return in_a_word(margin) if np.isnan(margin) else f"{round(margin, 3) + 0.0:.3f}, {in_a_word(margin)}"


def released(energy: float, template: str) -> str:
    """Text with the released energy, J, in its placeholder in mJ; "" if the load has no energy."""
    return "" if np.isnan(energy) else template.format(energy * TO_MILLI)


def ends_text(inside: Sequence[EndInside]) -> str:
    """Tubes that end inside outer tubes, as text; "" without any."""
    return "; ".join(
        f"tube {end.tube + 1} ends {end.depth * TO_MM:.4g} mm inside tube {end.around + 1}" for end in inside
    )


def tip_number(equilibrium: Equilibrium) -> int | None:
    """Number of the tube at the tip, from 1; None if all are withdrawn behind the plate."""
    tip = tip_tube(equilibrium.tube_end)
    return None if tip is None else tip + 1


def tip_text(robot: Robot, end: Array) -> str:
    """Tube at the tip, as text, if tubes end at arc lengths (n,), m; "" if all ends are in order."""
    tip, inside = tip_tube(end), ends_inside(robot, end)
    if tip is None:
        return "at the plate, since all tubes are withdrawn"
    return f"the end of tube {tip + 1}; {ends_text(inside)}" if inside else ""


def order_remarks(robot: Robot, translations: Array) -> list[str]:
    """Violations of the order of carriages by translations (n,), m, as text."""
    return [
        f"{demand.broken}, by {missing * TO_MM:.4g} mm: inverse kinematics and plans refuse such translations"
        for demand, missing in out_of_order(robot, translations)
    ]


def row(values: ArrayLike, form: str) -> str:
    """Text of numbers, separated by commas, without negative zeros."""
    # Round-off below 1e-12 would show as -0.000.
    texts = (format(round(value, 12) + 0.0, form) for value in np.asarray(values, dtype=float))
    return ", ".join(text.removeprefix("-") if text.strip("-0.") == "" else text for text in texts)


def degrees(angles: Array, form: str = ".9g") -> str:
    """Text of angles (rad), in deg with unit."""
    return f"{row(np.degrees(angles), form)} deg"


def millimetres(lengths: Array, form: str = ".9g") -> str:
    """Text of lengths (m), in mm with unit."""
    return f"{row(np.asarray(lengths) * TO_MM, form)} mm"


def at_least(lengths: ArrayLike, digits: int = 3) -> Array:
    """Proved lengths, m, in mm, rounded down to the printed digits, so that a bound stays one."""
    lowered: Array = np.floor(np.asarray(lengths) * TO_MM * 10**digits) / 10**digits
    return lowered


def flag(values: Array) -> str:
    """Text of numbers as the value of a command-line flag, to six decimals."""
    return row(np.round(values, 6), ".12g").replace(" ", "")


def counted(count: int, singular: str, plural: str = "", *, none: str = "") -> str:
    """Count with its noun: "1 snap", "2 snaps"; `none` for 0."""
    if count == 0 and none:
        return none
    return f"1 {singular}" if count == 1 else f"{count} {plural or singular + 's'}"
