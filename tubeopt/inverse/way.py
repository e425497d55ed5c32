"""Ways of joint values without a snap: what is known of how the robot gets to an answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..robots.assembly import Array
from .answer import JointWay
from .joints import JointSpace
from .posture import Posture, same_place


def straight_way(origin: str, begin: Posture | None, end: Posture) -> JointWay | None:
    """The straight way of joint values between two postures; None where the robot snaps on it, or there is no begin."""
    if begin is None or not same_place(begin.to(end.q), end):
        return None
    return joint_way(origin, end.space, [begin.q, end.q])


def joint_way(origin: str, space: JointSpace, points: Sequence[Array]) -> JointWay:
    """A way through independent joint values (m,)."""
    table = np.array([space.joint(q) for q in points])
    n = space.robot.n_tubes
    return JointWay(origin, table[:, :n], table[:, n:])
