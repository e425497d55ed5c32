"""Many increments of a robot whose tubes rub, in the compiled kernel as far as it goes."""

from __future__ import annotations

import numpy as np

from ..block.transcription.contact import evaluate_contact
from ..robots.robot import Robot
from ..solvers.compiled.rubbing import Rubbed, rub_compiled
from ..solvers.rubbing import Increment
from ..typing import Array
from .friction import Held, contact_of


def sweep(robot: Robot, held: Held, joints: Array, behind: Array, *, margins: bool = True) -> Rubbed | None:
    """States at rows of joint values (T, 2n), the first of which is that of `held`. Where they end sooner, the next
    step is too long, or a snap, and `rubbing_following` goes on from the last.

    Args:
        behind: (S,) stations behind the tip that are told, m.   margins: whether they are told.

    None where there is no kernel for this robot and this friction.
    """
    state = held.found.state.x, held.found.torque, held.found.signs
    return rub_compiled(robot, held.contact.friction, joints, state, behind, margins=margins)


def swept(robot: Robot, held: Held, joints: Array, many: Rubbed, k: int) -> Held:
    """The state after the k-th of many increments from `held`, along the rows (T, 2n) given for them; `held` itself
    after the 0-th."""
    if not k:
        return held
    rotations, translations = np.split(joints[k], 2)
    contact = contact_of(robot, tuple(translations.tolist()), held.contact.friction)
    there = evaluate_contact(contact, rotations, many.unknowns[k - 1, : contact.problem.size])
    rows, heat, violation = len(contact.capacity), float(many.heat[k - 1]), float(many.violation[k - 1])
    torque, signs = many.torque[k - 1, :rows], many.signs[k - 1, :rows]
    found = Increment(there, torque, signs, heat, True, 0.0, violation)
    return Held(contact, rotations, translations, found, held.heat + heat)
