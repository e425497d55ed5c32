"""What the drives of a calibrated robot read at an answer's joint values."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ..equilibrium.readings import to_readings
from ..equilibrium.result import Equilibrium
from ..typing import Array
from .formatting import degrees, millimetres
from .quantities import Quantity, within

A = TypeVar("A")


READINGS: tuple[Quantity[tuple[Array, Array]], ...] = (
    Quantity("readings_deg", "readings of the drives for these rotations; calibrated robots only", lambda read: read[0],
             label="the drives read", words=lambda read: _words(read, ".6g"), optional=True),
    Quantity("readings_mm", "readings of the drives for these translations; calibrated robots only",
             lambda read: read[1], optional=True),
)  # fmt: skip


def readings(of: Callable[[A], Equilibrium]) -> tuple[Quantity[A], ...]:
    """Readings of rotations and translations; left out where the robot has no calibration."""
    return within(READINGS, lambda answer: _read(of(answer)))


def _read(e: Equilibrium) -> tuple[Array, Array] | None:
    own = e.robot.calibration
    return None if own is None or own.reads_true else to_readings(e.robot, e.rotations, e.translations)


def _words(joints: tuple[Array, Array], form: str) -> str:
    return f"{degrees(joints[0], form)}, {millimetres(joints[1], form)}"


def joints_in_words(e: Equilibrium) -> str:
    """Joint values of an answer, and what the drives of a calibrated robot read there."""
    words = f"rotations {degrees(e.rotations, '.4g')}, translations {millimetres(e.translations, '.4g')}"
    read = _read(e)
    return words if read is None else f"{words}; the drives read {_words(read, '.4g')}"
