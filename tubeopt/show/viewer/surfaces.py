"""What the viewer draws besides the arm: the arrow of a force, shapes between two of a snap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from ...equilibrium.result import Equilibrium
from ...typing import Array
from ..arm_surfaces import Centreline
from ..surfaces import Surface, axes_about, revolved


def arrow_surface(start: Array, end: Array) -> Surface:
    """An arrow from one place to another."""
    length = float(np.linalg.norm(end - start))
    shaft, head, tall = 0.015 * length, 0.05 * length, 0.8 * length
    profile = [(0.0, length), (head, tall), (head, tall), (shaft, tall), (shaft, 0.0), (shaft, 0.0), (0.0, 0.0)]
    body = revolved(np.array(profile))
    return Surface(start + body.vertices @ axes_about((end - start) / length), body.faces)


def between(before: Equilibrium, after: Equilibrium, count: int) -> list[Equilibrium]:
    """Shapes between two of one robot at the same joint values, for a moving picture of a snap.

    Their curvature goes evenly from one to the other, and the arm keeps its length. They are no equilibria: how a snap
    runs in time is not in the model.
    """
    s = after.arc_length
    first = np.column_stack([np.interp(s, before.arc_length, u) for u in before.curvature.T])
    weights = ((1 - np.cos(np.pi * np.arange(count + 1) / count)) / 2)[:, None, None]
    u = (1 - weights) * first + weights * after.curvature
    h = np.diff(s)
    turn = np.concatenate([(u[:, :-1] + u[:, 1:]) / 2 * h[:, None], np.zeros((count + 1, len(h), 1))], axis=2)
    frame = np.empty((count + 1, len(s), 3, 3))
    frame[:, 0] = after.frame[0]
    position = np.zeros((count + 1, len(s), 3))
    position[:, 0] = after.position[0]
    for k in range(len(h)):
        frame[:, k + 1] = frame[:, k] @ scipy.spatial.transform.Rotation.from_rotvec(turn[:, k]).as_matrix()
        position[:, k + 1] = position[:, k] + h[k] * (frame[:, k, :, 2] + frame[:, k + 1, :, 2]) / 2
    # The few points integrate to within a per cent: what is missing at both ends is shared out between them.
    ends = Centreline(before).position(s), after.position
    position += (1 - weights) * (ends[0] - position[0]) + weights * (ends[1] - position[-1])
    return [replace(after, position=p, frame=f) for p, f in zip(position[1:-1], frame[1:-1], strict=True)]
