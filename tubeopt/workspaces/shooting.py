"""Every equilibrium of concentric tubes, stable or not, from the rotations of the tubes' tips: many at once.

The torsion of a tube is 0 at its own end, so that the tip rotations fix the whole arm: an initial-value problem from
the tip to the base, whose solution there says at which joint rotations the arm is in equilibrium (see
`stability.shooting`, which searches the ones of given joints). Joints, pose and stability come out of one integration.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..block.transcription.buffered import Buffered
from ..block.transcription.explicit import Kind, explicit_arm, explicit_kind, explicit_parameters
from ..robots.robot import Robot
from ..typing import Array, Mask

STEPS = 6
"""Steps per section of the arm: tips to about 1e-6 of the length."""

CHUNK = 256
"""Arms integrated at once."""


@dataclass(frozen=True, eq=False)
class Equilibria:
    """B equilibria.   rotations: (B, n) of the joints, rad.   tip_position: (B, 3) m.   stable: (B,).

    tip_direction: (B, 3) unit vectors.
    """

    rotations: Array
    tip_position: Array
    tip_direction: Array
    stable: Mask


def from_tips(robot: Robot, tips: Array, translations: Array) -> Equilibria:
    """Equilibria of tip rotations (B, n), rad, at translations (B, n), m, of a robot with tubes on the centreline.

    Stable is what the sign test says: the determinant of the derivative of theta(s) by the tip rotations stays positive
    down to the plate, and so does that of the joint rotations.
    """
    count = len(tips)
    parts: list[list[Array]] = [[], [], [], []]
    march = _march(explicit_kind(robot, steps=STEPS), threading.get_ident())
    known = explicit_parameters(robot)
    for first in range(0, count, CHUNK):
        size = min(CHUNK, count - first)
        rows = np.minimum(np.arange(first, first + CHUNK), count - 1)
        rotations, fields, points, tangents, _ = march(tips[rows], translations[rows], 0.0, known)
        places, ahead = (part.reshape(CHUNK, -1, 3)[:size, -1].copy() for part in (points, tangents))
        for part, value in zip(parts, (rotations[:size].copy(), places, ahead, fields[:size].min(1)), strict=True):
            part.append(value)
    rotations, places, ahead, least = (np.concatenate(part) for part in parts)
    return Equilibria(rotations, places, ahead, least > 0)


@lru_cache(maxsize=16)
def _march(kind: Kind, thread: int) -> Buffered:
    return Buffered(explicit_arm(kind).map(CHUNK))
