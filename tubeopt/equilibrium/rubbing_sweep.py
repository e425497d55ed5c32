"""Many increments of a robot whose tubes rub, in the compiled kernel as far as it goes."""

from __future__ import annotations

import numpy as np

from ..block.transcription.contact import evaluate_contact
from ..robots.robot import Robot
from ..solvers.compiled.rubbing import Rubbed, rub_compiled
from ..solvers.rubbing import HONEST, Increment
from ..typing import Array
from .friction import Held, contact_of


def sweep(
    robot: Robot, held: Held, joints: Array, behind: Array, *, margins: bool = True
) -> tuple[Rubbed, Held] | None:
    """States at rows of joint values (T, 2n), the first of which is that of `held`, and the last that was reached, from
    where `rubbing_following` goes on: the next step is too long, or a snap. Its heat is not known.

    Args:
        behind: (S,) stations behind the tip that are told, m.   margins: whether they are told.

    None where there is no kernel for this robot and this friction.
    """
    friction = held.contact.friction
    state = held.found.state.x, held.found.torque, held.found.signs
    out = rub_compiled(robot, friction, joints, state, behind, margins=margins)
    if out is None:
        return None
    count = len(out.margin)
    if not count:
        return out, held
    rotations, translations = np.split(joints[count], 2)
    contact = contact_of(robot, tuple(translations.tolist()), friction)
    there = evaluate_contact(contact, rotations, out.unknowns[: contact.problem.size])
    rows = len(contact.capacity)
    found = Increment(there, out.torque[:rows], out.signs[:rows], np.nan, True, 0.0, HONEST)
    return out, Held(contact, rotations, translations, found, np.nan)
