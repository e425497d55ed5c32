"""How finely a mold is searched for and drawn: what a user may want to change, as documented fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...errors import Settings


@dataclass(frozen=True)
class MoldSolver(Settings):
    """How plates, mandrels and boards of pegs are searched for, and how finely they are drawn; a field of `MoldSpec`.

    Args:
        arc_tolerance: greatest distance, m, of the arcs of a groove from its curve, where it is looked at.
        arc_places: on a pair of arcs, where that is.
        arc_turn: angle, rad, through which such a pair turns at most.
        sagitta: by which chords leave the curves of grooves at most, m.
        chord_turn: angle, rad, by which a groove in space turns at most from one of its points to the next.
        hole_sides: corners of a hole in a solid; of 192 its area is 0.02 % small.
        nest_step: by multiples of which grooves are moved until they are apart, m.
        nest_steps: of these at most.
        plate_step: of which the sides of a plate of free size are multiples, m.
        fastener_step: distance of places along the edge at which bolts and dowels are tried, m.
        block_sides: from which a block for a space curve may be open, that are tried.
        block_slope: greatest slope (sine) of a groove in a block towards its open side.
        peg_shifts: places of the curve on the lattice of holes that are tried, in x and in y.
        peg_places: of these at which pegs are set, those first that offer holes most evenly.
        peg_room: between a peg and the tube, m, that is as bad as a whole spacing along it.
        peg_overrun: pitches by which a bend goes on where the tube is cut off at its end: a tube between pegs cannot
            stop bending at once.
        peg_reach: part of a pin's circle within which it is set: near its ends an angle decides little.
        peg_sampled: distance of the places on the curve at which it is looked at, m.
        peg_element: greatest length of an element of the tube between its pegs, m.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    arc_tolerance: float = 0.5e-6
    arc_places: int = 17
    arc_turn: float = 0.5
    sagitta: float = 1e-6
    chord_turn: float = math.radians(5.0)
    hole_sides: int = 192
    nest_step: float = 0.5e-3
    nest_steps: int = 1024
    plate_step: float = 5e-3
    fastener_step: float = 0.5e-3
    block_sides: int = 200
    block_slope: float = 0.8
    peg_shifts: int = 6
    peg_places: int = 10
    peg_room: float = 50e-6
    peg_overrun: float = 2.0
    peg_reach: float = 0.97
    peg_sampled: float = 0.1e-3
    peg_element: float = 1.5e-3


DEFAULT_MOLD = MoldSolver()
