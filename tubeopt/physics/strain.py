"""Bending strain at the surface of a tube, in arithmetic alone: of numbers, arrays or expressions."""

from __future__ import annotations

from typing import Any

SMOOTH = 1e-6
"""Curvature (1/m) within which the root of a bend is rounded off at 0."""


def bend_from_own(direction: tuple[Any, Any], curvature: Any, natural: Any, stretch: Any = 1.0) -> Any:
    """How far a tube is bent from its own curvature, |u / g - u*|, 1/m.

    Args:
        direction: cos and sin of its rotation theta.
        curvature: u of the arm, x and y, 1/m.
        natural: its precurvature, 1/m, 0 on a straight part.
        stretch: g, its length per length of the arm.
    """
    x, y = (curvature[k] / stretch - natural * direction[k] for k in range(2))
    return (x**2 + y**2 + SMOOTH**2) ** 0.5 - SMOOTH


def surface_strain(radius: Any, bend: Any, natural: Any) -> Any:
    """Largest strain at the surface of a tube of outer `radius`, m, that is bent by `bend` from its own curvature."""
    return radius * bend / (1 - radius * abs(natural))
