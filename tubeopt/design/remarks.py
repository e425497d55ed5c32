"""What is worth knowing of a design before it is made: bounds that hold it, and tubes that it does not need."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from ..robots.concentric import ConcentricRobot
from ..robots.tubes import mass_per_length

GRAVITY = 9.81
"""m/s^2."""


class Held(Protocol):
    """A dimension of a design: its name and unit, its value in that unit, and the bound on which it lies, or ""."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def after(self) -> float: ...
    @property
    def bound(self) -> str: ...


def remarks(robot: ConcentricRobot, dimensions: Sequence[Held]) -> tuple[str, ...]:
    """Sentences on a designed robot, each with its number."""
    return (*_bounds(dimensions), *_useless(robot))


def _bounds(dimensions: Sequence[Held]) -> Iterator[str]:
    for one in dimensions:
        if one.bound:
            yield f"{one.name} lies on its {one.bound} bound, {one.after:.4g} {one.unit}, which the design hangs on"


def _useless(robot: ConcentricRobot) -> Iterator[str]:
    """Tubes whose bend moves the end of their curved part, in the bundle, by less than the weight of the stiffest tube
    moves its own: as cantilevers, kb kappa L^2 / (2 sum kb) and w L^4 / (8 kb)."""
    stiff = np.array([float(tube.bending_stiffness) for tube in robot.tubes])
    stiffest = int(stiff.argmax())
    outer = robot.tubes[stiffest]
    mass = mass_per_length(outer)
    if mass is None or robot.n_tubes == 1:
        return
    sag = mass * GRAVITY * outer.curved_length**4 / (8 * stiff[stiffest])
    for i, tube in enumerate(robot.tubes):
        moved = stiff[i] * abs(tube.curvature) * tube.curved_length**2 / (2 * stiff.sum())
        if moved < sag:
            yield (
                f"tube {i + 1} bends the arm by {moved * 1e3:.2g} mm, less than the {sag * 1e3:.2g} mm by which tube "
                f"{stiffest + 1}, the stiffest, sags under its own weight: it may as well be straight"
            )
