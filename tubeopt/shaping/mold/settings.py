"""How finely a mold is searched for and drawn: what a user may want to change, as documented fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...errors import Settings


@dataclass(frozen=True)
class PegSearch(Settings):
    """Settings of the search for pegs on a board."""

    shifts: int = 6
    """Places of the curve on the lattice of holes that are tried, in x and in y."""
    places: int = 10
    """Number of these arrangements that are solved, those with the most even holes first."""
    room: float = 50e-6
    """Gap between a peg and the tube, m, that counts as much as one spacing along it."""
    overrun: float = 2.0
    """Length, in pitches, that a bend continues beyond the cut at its end, because the curvature of a tube between pegs
    cannot end abruptly.
    """
    reach: float = 0.97
    """Part of a pin's circle within which it is set: near its ends an angle decides little."""
    sampled: float = 0.1e-3
    """Spacing of the checked points on the curve, m."""
    element: float = 1.5e-3
    """Greatest length of an element of the tube between its pegs, m."""


@dataclass(frozen=True)
class MoldSolver(Settings):
    """Settings of the search for plates, mandrels and peg boards, and of their drawings; a field of `MoldSpec`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    arc_tolerance: float = 0.5e-6
    """Largest distance of the arcs of a groove from its curve at the checked points, m."""
    arc_places: int = 17
    """Number of checked points on a pair of arcs."""
    arc_turn: float = 0.5
    """Angle, rad, through which such a pair turns at most."""
    sagitta: float = 1e-6
    """Largest distance of chords from the curves of grooves, m."""
    chord_turn: float = math.radians(5.0)
    """Largest angle between neighbouring segments of a groove in space, rad."""
    hole_sides: int = 192
    """Corners of a hole in a solid; of 192 its area is 0.02 % small."""
    nest_step: float = 0.5e-3
    """Step of the shifts that separate grooves, m."""
    nest_steps: int = 1024
    """Maximum number of these steps."""
    plate_step: float = 5e-3
    """Step of the sides of a plate of free size, m."""
    fastener_step: float = 0.5e-3
    """Distance of places along the edge at which bolts and dowels are tried, m."""
    block_sides: int = 200
    """Number of opening directions tried for a block with a space curve."""
    block_slope: float = 0.8
    """Greatest slope (sine) of a groove in a block towards its open side."""
    pegs: PegSearch = PegSearch()
    """Settings of peg boards."""


DEFAULT_MOLD = MoldSolver()
