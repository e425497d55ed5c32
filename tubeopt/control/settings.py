"""How a servo looks ahead: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import Settings


@dataclass(frozen=True)
class HorizonSolver(Settings):
    """How the way ahead is found and kept; of `PredictiveServo`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    margin_room: float = 0.01
    """Margin above its floor that knots keep: between them it is less."""
    clearance_room: float = 2e-4
    """The same of clearance, m."""
    lacking: float = 0.02
    """Of a field, which is 1 without torsion, and of a clearance over the room for it, what may be missing of a way on
    which the robot goes."""
    trust: float = 0.3
    """Largest change of a knot by one program, in units of the scales. It is halved where a change undoes the last one,
    as where tubes end together and derivatives differ to either side, and doubled where not."""
    calm: float = 0.01
    """To which it is halved at most."""
    patience: int = 20
    """Steps that the robot waits for a way that is allowed."""
    seconds: float = 1.0
    """For which joint values for a new target are looked for at most."""
    close: float = 0.01
    """Distance of the tip from its target, as a share of the robot's length, from which one step ahead will do."""
    elsewhere: float = 0.05
    """Distance of targets, as a share of the robot's length, from which a way is begun anew."""
    tip_weight: float = 100.0
    """Of the tip's distance from the target over the robot's length, beside the joints' way over their scales."""
    turn_weight: float = 0.05
    """Of the way of the tip rotations, beside that of the joints."""
    slack_price: float = 30.0
    """Of a unit of slack: of the least field, and of a clearance over a tenth of the robot's length."""
    damping: float = 1e-6
    """Of a change of the knots."""
    body_reach: float = 0.05
    """Distance from bodies, as a share of the robot's length, up to which they may matter to a knot."""
    contacts: int = 3
    """Bodies' points, at most, that a knot keeps clear of."""
    splits: int = 4
    """Places per step between points of the arm at which its distance from bodies is measured."""


DEFAULT_HORIZON = HorizonSolver()
