"""What is wrong with a table of joint values over time, whatever the arm does: ranges, order, rates, accelerations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..inverse.joints import JointSpace, joint_space
from ..robots.limits import MOST_TURN, JointLimits, default_limits
from ..robots.robot import Robot
from ..typing import Array
from .motion import RateLimits

TIP_SLACK = 1e-3
"""The same of the speed of the tip, which is measured between equilibria."""

SLACK = 1e-6
"""Relative excess of a rate that is round-off."""


def joint_range(robot: Robot, limits: JointLimits | None) -> JointSpace:
    """The joint values of given limits, else of the robot's own; without either, lengths limit translations, and
    rotations are not limited."""
    if limits is None and robot.joint_limits is None:
        free = ((-MOST_TURN, MOST_TURN),) * robot.n_tubes
        limits = JointLimits(free, default_limits(robot.tubes).translations)
    return joint_space(robot, limits)


def rates_of(t: Array, values: Array) -> tuple[Array, Array]:
    """(n,) largest rates between samples, and largest accelerations between these, of columns."""
    if len(t) < 2:
        return np.zeros(values.shape[1]), np.zeros(values.shape[1])
    h = np.diff(t)[:, None]
    rate = np.diff(values, axis=0) / h
    change = np.diff(rate, axis=0) / ((h[1:] + h[:-1]) / 2) if len(h) > 1 else np.zeros((1, values.shape[1]))
    return np.abs(rate).max(0), np.abs(change).max(0)


def out_of_range(space: JointSpace, alpha: Array, shift: Array) -> list[str]:
    """Joint values beyond their range, and tubes out of order."""
    faults = []
    q = np.array([space.join(a, d) for a, d in zip(alpha, shift, strict=True)])
    tied = np.abs(np.array([space.joint(row) for row in q])[:, alpha.shape[1] :] - shift).max()
    if tied > 1e-9:
        faults.append(f"tubes that move together are moved apart by {tied * 1e3:.3g} mm")
    over = np.maximum(space.lower - q, q - space.upper) / space.scale
    k, joint = np.unravel_index(int(np.argmax(over)), over.shape)
    if over[k, joint] > SLACK:
        n = alpha.shape[1]
        name = f"rotation of tube {joint + 1}" if joint < n else f"translation of carriage {joint - n + 1}"
        value = f"{np.degrees(q[k, joint]):.5g} deg" if joint < n else f"{q[k, joint] * 1e3:.5g} mm"
        faults.append(f"{name} leaves its range at sample {k + 1}, {value}")
    if len(space.least):
        late = (space.least - q @ space.rows.T).max(0) / space.length
        row = int(np.argmax(late))
        if late[row] > SLACK:
            faults.append(f"the tubes leave their order: beyond {space.row_names[row]}")
    return faults


def too_fast(space: JointSpace, rates: Sequence[tuple[Array, Array]], tip_rate: float, limits: RateLimits) -> list[str]:
    """Joints that are faster, or accelerate more, than their limits, and the tip where it is faster than its own."""
    faults = []
    if limits.tip is not None and tip_rate > limits.tip * (1 + TIP_SLACK):
        faults.append(f"the tip reaches {tip_rate * 1e3:.4g} mm/s; it must be at most {limits.tip * 1e3:.4g} mm/s")
    n = space.robot.n_tubes
    units = ((180 / np.pi, "deg/s"), (1e3, "mm/s")), ((180 / np.pi, "deg/s^2"), (1e3, "mm/s^2"))
    for order, limit in enumerate(limits.of(space)):
        most = np.concatenate([limit[:n], (space.spread @ np.append(np.zeros(n), limit[n:]))[n:]])
        for kind, what in enumerate(("rotation", "translation")):
            own, allowed = rates[kind][order], most[kind * n : kind * n + n]
            i = int(np.argmax(own / allowed))
            factor, unit = units[order][kind]
            if own[i] > allowed[i] * (1 + 1e-3 * order + SLACK):
                faults.append(
                    f"{what} of tube {i + 1} reaches {own[i] * factor:.4g} {unit}; "
                    f"it must be at most {allowed[i] * factor:.4g} {unit}"
                )
    return faults
