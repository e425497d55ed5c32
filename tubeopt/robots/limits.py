"""Joint limits of actuators, default limits from the lengths of the tubes, and checks of units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, warn_implausible
from ..files.field_metadata import unit
from ..files.units import TO_MM
from ..typing import Array
from .tubes import Tube

Ranges = tuple[tuple[float, float], ...]
"""Smallest and largest value, one pair per tube."""


# Lengths of itself by which no tube is withdrawn, and of the longest tube beyond which no target lies: a number in mm
# that is taken for m is 1000 times too large, one in cm 100 times.
FAR = 10.0

# Rotation (rad) of tubes against one another, three turns, beyond which degrees were probably meant: 20 deg taken for
# radians are 3.2 turns. The limits of shipped robots allow two turns.
USUAL_TURN = 6 * np.pi

# Largest rotation (rad), 159 turns: beyond, their round-off would show and the path from home have no end.
MOST_TURN = 1e3


@typed
@dataclass(frozen=True)
class JointLimits(Displayed):
    """Smallest and largest value of every joint, one pair per tube.

    Raises:
        InputError: a range is not two finite numbers in order, or the two tables differ in length.
    """

    rotations: Annotated[Ranges, unit("deg"), "smallest and largest rotation of every tube"]
    translations: Annotated[Ranges, unit("mm"), "smallest and largest translation of every tube"]

    def __post_init__(self) -> None:
        for name in ("rotations", "translations"):
            value = tuple(getattr(self, name))
            if any(np.shape(row) != (2,) for row in value):
                raise InputError(f"{name} of the limits is {value!r}; it must be (least, greatest) for every tube")
            rows = np.array(value, dtype=float).reshape(-1, 2)
            table = tuple((low, high) for low, high in rows.tolist())
            sign = "rad" if name == "rotations" else "m"
            for i, (low, high) in enumerate(table):
                if not (np.isfinite([low, high]).all() and low <= high):
                    raise InputError(
                        f"limit of {name[:-1]} {i + 1} is {low:g} {sign} to {high:g} {sign}; it must be least, greatest"
                    )
            object.__setattr__(self, name, table)
        if len(self.rotations) != len(self.translations):
            raise InputError(
                f"limits name {len(self.rotations)} rotations and {len(self.translations)} translations; "
                "they must be as many as there are tubes"
            )


def default_limits(tubes: Sequence[Tube]) -> JointLimits:
    """Limits from the lengths: a full turn to either side; translations from fully withdrawn to fully advanced."""
    return JointLimits(
        rotations=((-2 * np.pi, 2 * np.pi),) * len(tubes),
        translations=tuple((-tube.curved_length, tube.straight_length) for tube in tubes),
    )


def check_turn(rotations: Array) -> None:
    """Raise InputError naming a rotation beyond MOST_TURN; warn of one beyond USUAL_TURN."""
    turns = rotations.ravel().tolist()
    largest = max(map(abs, turns), default=0.0)
    if largest > MOST_TURN:
        worst = max(turns, key=abs)
        raise InputError(
            f"rotations has {worst:g} rad; it must be at most {MOST_TURN:g} rad (159 turns) to either side"
        )
    # Rotations within half of it cannot differ by more: most calls end here.
    if largest > USUAL_TURN / 2:
        _warn_of_degrees(rotations)


def _warn_of_degrees(rotations: Array) -> None:
    """Warn of rotations (..., n) that turn tubes against one another beyond USUAL_TURN."""
    # Turning all tubes together winds nothing up: differences to the outermost count.
    relative = rotations if rotations.shape[-1] == 1 else rotations - rotations[..., -1:]
    turn = float(np.abs(relative).max())
    if turn > USUAL_TURN:
        largest = float(rotations.ravel()[int(np.argmax(np.abs(rotations)))])
        turns = turn / (2 * np.pi)
        warn_implausible(
            f"rotations has {largest:g} rad, and winds tubes up by {turns:.3g} turns; rotations are in rad: was "
            f"{largest:g} deg meant?"
        )


def check_reach(tubes: Sequence[Tube], translations: Sequence[float]) -> None:
    """Raise InputError if translations (n,), m, retract a tube by FAR of its lengths: they were in mm."""
    if min(translations) >= 0:
        return
    for i, (tube, shift) in enumerate(zip(tubes, translations, strict=True)):
        if shift < -FAR * (tube.straight_length + tube.curved_length):
            raise InputError(
                f"translation of tube {i + 1} is {shift:g} m, and the tube is {tube.length:g} m long; it must be at "
                f"least {-FAR:g} times that: translations are in m"
            )


# mm, by which a translation may exceed what the tube allows: numbers of a file are rounded.
ROUNDED = 1e-9


def reading_fault(tube: Tube, key: str, value: float) -> str:
    """Allowed values of a joint reading, as text in its unit; "" if the value is valid."""
    largest = round(math.degrees(MOST_TURN))
    if key.endswith("_deg") and abs(value) > largest:
        return f"at most {largest} ({MOST_TURN / math.tau:.0f} turns) to either side"
    if key.endswith("_mm") and value > tube.straight_length * TO_MM + ROUNDED:
        return f"at most its straight length, {tube.straight_length * TO_MM:g}, where it is clamped"
    if key.endswith("_mm") and value < -FAR * tube.length * TO_MM:
        return f"at least {-FAR * tube.length * TO_MM:g}, {FAR:g} lengths of the tube behind home"
    return ""


# Force times length squared over bending stiffness: beyond, it deflects the tip of a straight arm by more than 0.86
# of the length, as no needle is used.
MOST_BEND = 20.0


def check_force(tubes: Sequence[Tube], name: str, force: float, length: float) -> None:
    """Warn of a force, N, too large for an arm of these tubes and length, m, and probably meant in mN."""
    if not length:
        return
    usual = MOST_BEND * sum(float(tube.bending_stiffness) for tube in tubes) / length**2
    if force > usual:
        warn_implausible(
            f"{name} is {force:g} N; on this arm it is usually at most {usual:.3g} N: was {force:g} mN meant?"
        )


def check_target(tubes: Sequence[Tube], name: str, points: Array) -> None:
    """Raise InputError naming a position (3,), or a row of positions (N, 3), m, that is too far from the plate.

    Farther than FAR times the longest tube, it was probably in mm.
    """
    longest = max(tube.length for tube in tubes)
    if points.ndim == 1 and math.hypot(*points.tolist()) <= FAR * longest:
        return
    away = np.linalg.norm(np.atleast_2d(points), axis=1)
    k = int(away.argmax())
    if away[k] > FAR * longest:
        coordinates = ", ".join(f"{x:.6g}" for x in np.atleast_2d(points)[k])
        where = f"{name} in row {k + 1}" if points.ndim > 1 else name
        raise InputError(
            f"{where} is {coordinates} m, {away[k]:.4g} m from the plate, and the longest tube is {longest:.4g} m "
            f"long; it must be at most {FAR * longest:.4g} m away"
        )
