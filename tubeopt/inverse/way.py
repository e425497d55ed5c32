"""Ways of joint values without a snap: what is known of how the robot gets to an answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..typing import Array
from .answer import InverseSolution, JointWay
from .joints import JointSpace
from .posture import Posture, same_place
from .reachable import snap_free_way

SEARCH_SECONDS = 10.0
"""Seconds for which a way to one answer is looked for at most."""


def straight_way(origin: str, begin: Posture | None, end: Posture) -> JointWay | None:
    """The straight way of joint values between two postures; None where steps of ordinary length do not show that the
    robot does not snap on it, or there is no begin."""
    if begin is None or not same_place(begin.to(end.q), end):
        return None
    return joint_way(origin, end.space, [begin.q, end.q])


def joint_way(origin: str, space: JointSpace, points: Sequence[Array]) -> JointWay:
    """A way through independent joint values (m,)."""
    table = np.array([space.joint(q) for q in points])
    n = space.robot.n_tubes
    return JointWay(origin, table[:, :n], table[:, n:])


def with_a_way(
    answer: InverseSolution, begin: Posture | None, space: JointSpace, seconds: float = np.inf
) -> InverseSolution:
    """The answer with a way to it from a posture, its `reachable` False where none is found in so many seconds."""
    if answer.way is not None:
        return answer
    found = None
    if begin is not None and seconds > 0:
        found = snap_free_way(space, begin.equilibrium, answer.equilibrium, seconds=min(SEARCH_SECONDS, seconds))
    if found is None:
        return replace(answer, reachable=False)
    way = JointWay("home" if answer.straight_from_seed is None else "seed", *found)
    straight = None if answer.straight_from_seed is None else len(way.rotations) == 2
    return replace(answer, reachable=True, way=way, straight_from_seed=straight)
