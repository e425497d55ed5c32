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
    # The fibre inside the bend is the shortest, 1 - r |kappa| of the axis: its strain is the largest.
    return radius * bend / (1 - radius * abs(natural))


def slotted_strain_ratio(bending_factor: Any, share: Any, *, symmetric: bool = True) -> Any:
    """How many times as much as the whole tube, at the same bend, what slots leave of it is strained at most, to first
    order in radius times curvature.

    With the strain r Delta kappa a bound for pieces in which stretches with slots, all alike, and whole rings follow
    one another and bend as beams under one moment: with the factor b of the whole piece and slots along the share f of
    it, the slotted stretches are bent (1 - b (1 - f)) / f times as much as the piece, and nothing of a cross-section is
    farther from its neutral axis than the radius, or, if slots on one side shift that, than twice the radius. It knows
    no stress concentration at the ends of slots, and it is none where rings between staggered rows of slots bend out of
    their planes.

    Args:
        bending_factor: b, in (0, 1].  share: f, in (0, 1].
        symmetric: whether the slots are, about the plane across the bend.
    """
    # Under one moment rings bend b times the mean: 1 = (1 - f) b + f times that of the slotted part.
    return (1 if symmetric else 2) * (1 - bending_factor * (1 - share)) / share
