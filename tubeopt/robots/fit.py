"""What may go wrong when a robot is built: tubes that are strained too far, too tight or too loose in one another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from ..files.units import TO_MM
from .robot import Robot
from .tubes import Tube, slots_unknown

TIGHT_MM = 0.01
"""Radial clearance below which tubes bind: what drawn tubing and its ovality already use up."""

LOOSE_MM = 0.1
"""Radial clearance above which the inner tube lies visibly off the centreline that the model gives both."""


def clearances(robot: Robot) -> dict[int, tuple[int, float]]:
    """Tube -> the tube around it, if any, and the radial clearance (mm) between them; tubes counted from 0."""
    return {i: (o, round(_room(robot.tubes[i], robot.tubes[o]) * TO_MM, 9)) for i, o in robot.nested_pairs}


def drawn_clearance(tubes: Sequence[Tube]) -> tuple[float, ...]:
    """(n - 1,) radial clearance of every tube in the next one by their diameters, m."""
    return tuple(_room(inner, outer) for inner, outer in pairwise(tubes))


def _room(inner: Tube, outer: Tube) -> float:
    return (outer.inner_diameter - inner.outer_diameter) / 2


def fit_warnings(robot: Robot) -> list[str]:
    """What may go wrong when this robot is built and used: tubes strained too far, tubes too tight or too loose."""
    found = []
    for i, tube in enumerate(robot.tubes, start=1):
        strain, name = tube.straightened_strain, tube.material.name
        reached = f"tube {i} is strained {strain * 100:.2f} % when held straight, beyond the"
        if strain > tube.material.superelastic_strain:
            found.append(
                f"{reached} {tube.material.superelastic_strain * 100:.3g} % limit of superelasticity of {name}"
            )
        elif strain > tube.material.working_strain:
            found.append(f"{reached} {tube.material.working_strain * 100:.3g} % limit of {name} for repeated bending")
        unknown = [str(j) for j, piece in enumerate(tube.pieces, start=1) if slots_unknown(tube, piece)]
        if unknown:
            found.append(
                f"tube {i} is softer in piece{'s' * (len(unknown) > 1)} {', '.join(unknown)} than elsewhere. The "
                "strain at slots is larger than shown here. Give the fraction with slots by slots: {share: ...}"
            )
    for i, (around, clearance) in clearances(robot).items():
        fit = f"tube {i + 1} has {clearance:.3g} mm of radial clearance in tube {around + 1},"
        if clearance < TIGHT_MM:
            found.append(f"{fit} less than the {TIGHT_MM:g} mm that sliding needs: friction will wind the tubes up")
        elif clearance > LOOSE_MM:
            found.append(f"{fit} more than {LOOSE_MM:g} mm: its axis may lie beside the outer tube's")
    return found
