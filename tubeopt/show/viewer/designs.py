"""Dimensions of a robot's tubes, one by one, to be turned like knobs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ...errors import InputError, finite
from ...files.units import TO_MM
from ...robots.concentric import ConcentricRobot
from ...robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ...robots.robot import Robot
from ...robots.tubes import Tube

FIELDS = (
    ("curvature", "curvature", "1/m", 1.0, 0.1),
    ("curved length", "curved_length", "mm", TO_MM, 1.0),
    ("straight length", "straight_length", "mm", TO_MM, 1.0),
)
"""What is told of a tube, its field, unit, the factor from SI to it, and the step of a knob."""


@dataclass(frozen=True)
class Knob:
    """One dimension of one tube (or of the equal tubes of a segment), from `low` to `high` by `step`."""

    label: str
    place: int
    """Which entry of `parts`."""
    field: str
    """Of `Tube`."""
    factor: float
    """From SI to the unit of the label, which the others are in."""
    low: float
    high: float
    step: float

    def shown(self, robot: Robot) -> float:
        """Its value, in the unit of the label."""
        return float(getattr(parts(robot)[self.place], self.field)) * self.factor


def parts(robot: Robot) -> tuple[Tube, ...]:
    """The tubes that can be chosen on their own: all, the one that all three are, or one per segment."""
    if isinstance(robot, EccentricRobot):
        return (robot.tube,)
    if isinstance(robot, SegmentedEccentricRobot):
        return robot.segments
    return robot.tubes


def knobs(robot: Robot) -> tuple[Knob, ...]:
    """Curvature and lengths of every tube, each from nothing to twice what it is."""
    name = {EccentricRobot: "all tubes", SegmentedEccentricRobot: "segment"}.get(type(robot), "tube")
    out = []
    for k, tube in enumerate(parts(robot)):
        for label, field, unit, factor, step in FIELDS:
            value = getattr(tube, field) * factor
            most = max(2 * abs(value), 10 * step)
            if tube.general and field == "curved_length":
                continue  # it is the sum of the pieces
            # Pieces that were bent straight would not know which way to bend.
            low = step if tube.general and field == "curvature" else min(0.0, 2 * value)
            which = name if name == "all tubes" else f"{name} {k + 1}"
            out.append(Knob(f"{which}: {label} ({unit})", k, field, factor, low, most, step))
    return tuple(out)


def with_knob(robot: Robot, knob: Knob, value: float) -> Robot:
    """The robot with one dimension changed to `value`, in the knob's unit.

    Raises:
        InputError: a value out of the knob's range, or tubes that no longer fit together.
    """
    number = finite(knob.label, value)
    if not knob.low - 1e-9 <= number <= knob.high + 1e-9:
        raise InputError(f"{knob.label} is {number:g}; it must be from {knob.low:g} to {knob.high:g}")
    changed: dict[str, Any] = {knob.field: number / knob.factor}
    tubes = list(parts(robot))
    tubes[knob.place] = replace(tubes[knob.place], **changed)
    if isinstance(robot, EccentricRobot):
        return replace(robot, tube=tubes[0])
    if isinstance(robot, SegmentedEccentricRobot):
        return replace(robot, segments=tuple(tubes))
    if isinstance(robot, ConcentricRobot):
        return replace(robot, tubes=tuple(tubes))
    raise InputError(f"the tubes of a {type(robot).__name__} cannot be changed here")
