"""How a servo looks ahead: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import Settings


@dataclass(frozen=True)
class HorizonSolver(Settings):
    """How the way ahead is found and kept; of `PredictiveServo`.

    Args:
        margin_room: margin above its floor that knots keep: between them it is less.
        clearance_room: the same of clearance, m.
        lacking: of a field, which is 1 without torsion, and of a clearance over the room for it, what may be missing of
            a way on which the robot goes.
        trust, calm: largest change of a knot by one program, in units of the scales. It is halved where a change undoes
            the last one, as where tubes end together and derivatives differ to either side, and doubled where not.
        patience: steps that the robot waits for a way that is allowed.
        seconds: for which joint values for a new target are looked for at most.
        close: distance of the tip from its target, as a share of the robot's length, from which one step ahead will do.
        elsewhere: distance of targets, as a share of the robot's length, from which a way is begun anew.
        tip_weight: of the tip's distance from the target over the robot's length, beside the joints' way over their
            scales.
        turn_weight: of the way of the tip rotations, beside that of the joints.
        slack_price: of a unit of slack: of the least field, and of a clearance over a tenth of the robot's length.
        damping: of a change of the knots.
        body_reach: distance from bodies, as a share of the robot's length, up to which they may matter to a knot.
        contacts: bodies' points, at most, that a knot keeps clear of.
        splits: places per step between points of the arm at which its distance from bodies is measured.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    margin_room: float = 0.01
    clearance_room: float = 2e-4
    lacking: float = 0.02
    trust: float = 0.3
    calm: float = 0.01
    patience: int = 20
    seconds: float = 1.0
    close: float = 0.01
    elsewhere: float = 0.05
    tip_weight: float = 100.0
    turn_weight: float = 0.05
    slack_price: float = 30.0
    damping: float = 1e-6
    body_reach: float = 0.05
    contacts: int = 3
    splits: int = 4


DEFAULT_HORIZON = HorizonSolver()
