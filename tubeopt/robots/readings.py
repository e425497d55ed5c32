"""Joint values of the model from what the drives of a robot read, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..typing import Array
from .robot import Robot


def to_model(robot: Robot, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
    """The model's joint values at readings of a robot: the readings where it has no calibration."""
    own = robot.calibration
    if own is None:
        return np.array(rotations, dtype=float), np.array(translations, dtype=float)
    return own.to_model(rotations, translations)


def to_readings(robot: Robot, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
    """The readings of a robot at joint values of the model: the same where it has no calibration."""
    own = robot.calibration
    if own is None:
        return np.array(rotations, dtype=float), np.array(translations, dtype=float)
    return own.to_readings(rotations, translations)
