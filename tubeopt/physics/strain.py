"""Bending strain at the surface of a tube, in arithmetic alone: of numbers, arrays or expressions."""

from __future__ import annotations

from typing import Any

SMOOTH = 1e-6
"""Curvature (1/m) below which the norm of a change of curvature is smoothed, so that it has derivatives at 0."""


def bend_from_own(direction: tuple[Any, Any], curvature: Any, natural: Any, stretch: Any = 1.0) -> Any:
    """Change of curvature of a tube from its precurvature, |u / g - u*|, 1/m.

    Args:
        direction: cos and sin of the tube's rotation theta.
        curvature: curvature u of the arm, x and y, 1/m.
        natural: precurvature, 1/m, 0 on a straight part.
        stretch: g, length of the tube per length of the arm.
    """
    x, y = (curvature[k] / stretch - natural * direction[k] for k in range(2))
    return (x**2 + y**2 + SMOOTH**2) ** 0.5 - SMOOTH


def surface_strain(radius: Any, bend: Any, natural: Any) -> Any:
    """Largest strain at the surface of a tube of outer `radius`, m, at a change of curvature `bend`, 1/m."""
    # The fibre at the inside of the bend is the shortest, 1 - r |kappa| of the axis, so its strain is the largest.
    return radius * bend / (1 - radius * abs(natural))


def slotted_strain_ratio(bending_factor: Any, fraction: Any, *, symmetric: bool = True) -> Any:
    """Ratio of the largest strains of a slotted piece and of a tube without slots, at the same change of curvature.

    First order in radius times curvature. Times r Delta kappa it is a bound for pieces in which equal slotted stretches
    and whole rings alternate and bend as beams under one moment. With the bending factor b of the piece and slots along
    the fraction f of its length, the slotted stretches bend (1 - b (1 - f)) / f times as much as the piece. The
    distance from the neutral axis is at most the radius, or twice the radius if slots on one side shift it. The bound
    excludes stress concentrations at the ends of slots, and rings between staggered rows of slots that bend out of
    their planes.

    Args:
        bending_factor: b, in (0, 1].  fraction: f, in (0, 1].
        symmetric: True if the slots are symmetric about the plane across the bend.
    """
    # Under one moment rings bend b times the mean: 1 = (1 - f) b + f times that of the slotted part.
    return (1 if symmetric else 2) * (1 - bending_factor * (1 - fraction)) / fraction


def fibre_strain(place: tuple[Any, Any], curvature: tuple[Any, Any], natural: tuple[Any, Any]) -> Any:
    """Strain along a fibre of a bent tube.

    Args:
        place: x and y of the fibre in the axes of the tube, m.
        curvature: curvature u of the tube, x and y in its axes, 1/m.
        natural: precurvature u*, x and y, 1/m.
    """
    # A fibre at q is as long as the axis times 1 + (u x q)_z.
    x, y = place
    bent = (curvature[0] - natural[0]) * y - (curvature[1] - natural[1]) * x
    return bent / (1 + natural[0] * y - natural[1] * x)
