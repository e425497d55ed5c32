"""The tip led by the hand: towards a target, as far as margin, joints, order and obstacles let it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ...bodies.obstacles import Obstacle
from ...errors import InputError
from ...files.units import TO_MM
from ...inverse.gauss_newton import held_by, reach
from ...inverse.goal import Goal, pose_question
from ...inverse.posture import Posture, start_posture
from ...inverse.settings import InverseOptions
from ...typing import Array
from .session import Session, moved_to

LONGEST_PULL = 0.05
"""The tip is led along a straight line in parts of this share of the longest tube."""

CLOSE_ENOUGH = 1e-6
"""Distance (m) at which a target counts as reached."""

QUICK = InverseOptions(steps=20)
"""A step towards the target follows the hand, and there will be another one."""


def pull(
    session: Session, target: ArrayLike, *, min_margin: float = 0.05, obstacles: Sequence[Obstacle] = ()
) -> tuple[Session, str]:
    """The session after moving the tip towards `target` (3,), m, on its branch, by Gauss-Newton steps within all
    limits.

    Every step is a stable equilibrium on the same branch with a margin of at least `min_margin` (or that of the start):
    the robot does not snap. The motion ends when the tip comes no nearer.

    Returns:
        The session, and the reason why the tip stopped, "" on target.

    Raises:
        InputError: a target that is not three finite numbers, a margin that is not from 0 to 1; a load.
    """
    if session.equilibrium.load is not None:
        raise InputError("the tip can be moved without load only; remove the load first")
    places = session.equilibrium, None
    goal = pose_question(
        session.robot, (target, None), places, min_margin=min_margin, obstacles=obstacles, options=QUICK
    )
    here = start_posture(goal.space, session.equilibrium)
    for part in _parts(goal, here.tip):
        found = reach(replace(goal, position=part), here)
        here = found.posture
        session = moved_to(session, here.equilibrium)
        if not found.reached and float(np.linalg.norm(part - here.tip)) > CLOSE_ENOUGH:
            # From here straight at the target, which may lie around the corner.
            here = reach(goal, here).posture
            session = moved_to(session, here.equilibrium)
            break
    error = float(np.linalg.norm(goal.position - here.tip))
    if error <= CLOSE_ENOUGH:
        return session, ""
    return session, f"the tip stops {error * TO_MM:.2f} mm short of the target: {', '.join(_held(goal, here))}"


def _parts(goal: Goal, tip: Array) -> list[Array]:
    way = goal.position - tip
    count = max(1, int(np.ceil(float(np.linalg.norm(way)) / (LONGEST_PULL * goal.space.length))))
    return [tip + way * k / count for k in range(1, count + 1)]


def _held(goal: Goal, here: Posture) -> list[str]:
    """What holds the tip; joints beside their ends do not, so the margin and obstacles come first."""
    words = held_by(goal, here)
    return sorted(words, key=lambda word: not word.startswith(("margin", "arm"))) or ["no joint leads nearer to it"]
