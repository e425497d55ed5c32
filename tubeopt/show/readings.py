"""What the drives of a calibrated robot read at an answer's joint values."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ..equilibrium.readings import to_readings
from ..equilibrium.result import Equilibrium
from ..typing import Array
from .quantities import Quantity
from .words import degrees, millimetres

A = TypeVar("A")


def readings(of: Callable[[A], Equilibrium]) -> tuple[Quantity[A], ...]:
    """Readings of rotations and translations; left out where the robot has no calibration."""

    def read(answer: A, which: int) -> Array | None:
        e = of(answer)
        known = e.robot.calibration is not None
        return to_readings(e.robot, e.rotations, e.translations)[which] if known else None

    def told(answer: A) -> str | None:
        turned, shifted = read(answer, 0), read(answer, 1)
        return None if turned is None or shifted is None else f"{degrees(turned, '.6g')}, {millimetres(shifted, '.6g')}"

    return (
        Quantity(
            "readings_deg",
            "rotations that the drives of a calibrated robot read there",
            lambda answer: read(answer, 0),
            label="the drives read",
            words=told,
            optional=True,
        ),
        Quantity(
            "readings_mm",
            "translations that the drives of a calibrated robot read there",
            lambda answer: read(answer, 1),
            optional=True,
        ),
    )


def joints_in_words(e: Equilibrium) -> str:
    """Joint values of an answer, and what the drives of a calibrated robot read there."""
    words = f"rotations {degrees(e.rotations, '.4g')}, translations {millimetres(e.translations, '.4g')}"
    if e.robot.calibration is None:
        return words
    turned, shifted = to_readings(e.robot, e.rotations, e.translations)
    return f"{words}; the drives read {degrees(turned, '.4g')}, {millimetres(shifted, '.4g')}"
