"""Ways of rotations inside joint limits, where turning all tubes together turns the robot and changes nothing else."""

from __future__ import annotations

import numpy as np

from ..robots.robot import Robot
from ..typing import Array, Index, Mask


def relaxed_rotations(robot: Robot, coupled: Index) -> list[Array]:
    """(n,) rotations, nearest to home, at which all tubes curve to one side, so that none is twisted.

    A tube that curves to the other side than the outermost coupled one is turned by half a turn, to one side or the
    other: these are two poses, mirror images. Those inside the joint limits come first.
    """
    curvature = np.array([tube.curvature for tube in robot.tubes])
    other_side = np.zeros(robot.n_tubes)
    other_side[coupled] = np.pi * (curvature[coupled] * curvature[coupled[-1]] < 0)
    poses = [other_side, -other_side] if other_side.any() else [other_side]
    return sorted(poses, key=lambda pose: not inside(robot, coupled, pose))


def room(robot: Robot, coupled: Index, rotations: Array) -> Array:
    """(...) rad by which coupled tubes at rotations (..., n) can be turned together inside the joint limits; below 0
    where no turn of the whole brings them inside."""
    low, high = np.array(robot.limits.rotations)[coupled].T
    angles = rotations[..., coupled]
    return np.asarray((high - angles).min(-1) - (low - angles).max(-1))


def inside(robot: Robot, coupled: Index, rotations: Array) -> Mask:
    """(...) whether rotations (..., n), turned together, are inside the joint limits to round-off."""
    return np.asarray(room(robot, coupled, rotations) >= -1e-9)


def clipped(robot: Robot, coupled: Index, start: Array, end: Array) -> Array:
    """The last rotations (n,) inside the joint limits on the straight way from `start`, which is inside, to `end`."""
    low, high = np.array(robot.limits.rotations)[coupled].T
    here, rate = start[coupled], (end - start)[coupled]
    closing = rate[:, None] - rate
    left = high[:, None] - low - (here[:, None] - here)
    most = np.min(left[closing > 0] / closing[closing > 0], initial=1.0)
    return np.asarray(end if most >= 1 else start + max(most, 0.0) * (end - start))


def placed(robot: Robot, coupled: Index, way: Array) -> Array:
    """Waypoints (W, n) with all tubes turned together where that brings each inside the joint limits.

    Where limits differ from tube to tube this is the least turn. A tube that is not coupled goes to its rotation
    nearest to home. Limits are a box, so straight ways between waypoints inside are inside.
    """
    low, high = np.array(robot.limits.rotations).T
    out = np.clip(np.zeros_like(way), low, high)
    angles = way[:, coupled]
    least, most = (low[coupled] - angles).max(1), (high[coupled] - angles).min(1)
    turn = np.where(least <= most, np.clip(0.0, least, most), 0.0)
    out[:, coupled] = angles + turn[:, None]
    return np.asarray(out)
