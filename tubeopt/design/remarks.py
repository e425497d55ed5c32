"""What is worth knowing of a design before it is made: bounds that hold it, and tubes that it does not need."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..constants import GRAVITY
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import Tube, mass_per_length
from ..typing import Array


@dataclass(frozen=True)
class Dimension:
    """One free dimension."""

    name: str
    unit: str
    before: float
    """In that unit, as `after`."""
    after: float
    bound: str
    """The bound that it lies on, "lower" or "upper"; "" where on none."""


def remarks(robot: ConcentricRobot, dimensions: Sequence[Dimension]) -> tuple[str, ...]:
    """Sentences on a designed robot, each with its number."""
    return (*_bounds(dimensions), *_useless(robot))


def _bounds(dimensions: Sequence[Dimension]) -> Iterator[str]:
    for one in dimensions:
        if one.bound:
            yield f"{one.name} lies on its {one.bound} bound, {one.after:.4g} {one.unit}, which the design hangs on"


def _useless(robot: ConcentricRobot) -> Iterator[str]:
    """Tubes whose bend moves the end of their curved part, at home, by less than the weight of the stiffest tube moves
    its own: as cantilevers, the curvature kb kappa / sum kb of the tubes that are there, and w L^4 / (8 kb)."""
    stiff = np.array([float(tube.bending_stiffness) for tube in robot.tubes])
    stiffest = int(stiff.argmax())
    outer = robot.tubes[stiffest]
    mass = mass_per_length(outer)
    if mass is None or robot.n_tubes == 1:
        return
    sag = mass * GRAVITY * outer.curved_length**4 / (8 * stiff[stiffest])
    ends = np.array([tube.length for tube in robot.tubes]) + robot.home_translations
    for i, tube in enumerate(robot.tubes):
        moved = _moved(tube, float(ends[i]), ends, stiff)
        if moved < sag:
            yield (
                f"tube {i + 1} bends the arm by {moved * 1e3:.2g} mm. Tube {stiffest + 1}, the stiffest, sags by "
                f"{sag * 1e3:.2g} mm under its own weight, which is more: tube {i + 1} may be straight"
            )


def _moved(tube: Tube, end: float, ends: Array, stiff: Array) -> float:
    """How far, m, the end (m from the plate) of a tube is moved by its bend, tubes of `stiff` lying up to `ends`."""
    begin = end - tube.curved_length
    cuts = np.unique(np.clip([begin, *ends, end], begin, end))
    there = ends > 0.5 * (cuts[1:] + cuts[:-1])[:, None]
    bend = float(tube.bending_stiffness) * abs(tube.curvature) / (there * stiff).sum(1)
    lever = end - cuts
    return float((bend * (lever[:-1] ** 2 - lever[1:] ** 2) / 2).sum())
