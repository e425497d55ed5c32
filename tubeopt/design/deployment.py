"""An arm on its way out: every tube is where it will be, or drawn back straight to a share of the arm's length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..robots.concentric import ConcentricRobot
from ..robots.order import last_tube
from ..robots.tubes import Tube
from ..typing import Array, Mask

SHARES = (0.25, 0.5, 0.75)
"""Of the arm's length, at which a deployment is looked at."""

ALONG = (0.5, 0.75, 1.0)
"""Of an arm that is drawn back, where its distance from the whole one counts."""


def retracted(tubes: Sequence[Tube], translations: Array, share: float) -> tuple[Array, Mask, int]:
    """Translations (n,), m, of an arm drawn back to a share of its length; which tubes (n,) are drawn back for that;
    and the tube that ends last."""
    ends = translations + np.array([tube.length - tube.straight_length for tube in tubes])
    last = int(last_tube(ends))
    beyond = ends - share * ends[last]
    return translations - np.maximum(beyond, 0.0), beyond > 0, last


def draw(robot: ConcentricRobot, whole: Equilibrium, share: float) -> Equilibrium:
    """The arm of a pose drawn back to a share of its length, by forward kinematics."""
    return forward_kinematics(robot, whole.rotations, retracted(robot.tubes, whole.translations, share)[0])
