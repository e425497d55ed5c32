"""Floor of a servo that the real robot keeps: how much more snap distance the calibrated robot needs.

A servo keeps the snap distance of the robot that it calculates with. The real one is another robot x = start + F z at
the same readings of the drives. Configurations close to snaps are found on joint paths from untwisted tubes. At each of
them the snap distance of real robots is linear in z to first order. A drawn robot z needs the floor

    max { distance of the calibrated robot : distance of the real robot < stated floor }

over all configurations at once, and the answer is the quantile of this number. It is estimated, not proved. The margin
has no such floor: on some paths it falls from 0.98 to 0 within the turn by which real robots differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, NamedTuple

import numpy as np

from ..arguments import typed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..files.field_metadata import Range
from ..inverse.joints import joint_space
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, check_time, limited
from ..stability import follow, snap_distance
from ..typing import Array
from .certainty import SECANT, RealRobots, check_probabilities, real_robots

PATHS = 128
"""Joint paths to configurations that are spread over the ranges of the joints."""

WAYPOINTS = 32
"""Rows of a path."""

LEVELS = 4
"""Configurations of a path, from the stated floor to FARTHER above it."""

BISECTIONS = 8
"""Bisections of a path for a level."""

DRAWN = 20_000
"""Robots that are drawn; a probability of 99.9 % is left by twenty of them."""

FARTHER = 0.8
"""Distance (rad) by which deviations seldom raise the floor."""


class Near(NamedTuple):
    """A configuration close to a snap."""

    distance: float
    """Snap distance, rad."""
    equilibrium: Equilibrium


@typed
@small
@limited
def servo_floor(
    robot: Robot,
    min_snap_distance: Annotated[float, Range(above=0.0, below=np.pi)],
    *,
    confidence: float = 0.999,
    time_limit: float = LONG_TIME_LIMIT,
) -> float:
    """Smallest snap distance of a calibrated robot, rad, with which the real one keeps a stated one everywhere.

    Args:
        min_snap_distance: stated distance, rad.
        confidence: probability, between 0.5 and 1.
        time_limit: maximum run time, s.

    Raises:
        InputError: the robot has no posterior, is eccentric, or a number is out of its range.
        SolveError: the parameters are not known well enough for a floor.
    """
    check_probabilities((confidence,))
    reals, stated = real_robots(robot), min_snap_distance
    if reals is None:
        raise InputError("the robot has no posterior; `tubeopt validate --fit` writes one into the robot file")
    if not robot.fixed_sections or robot.axes.any():
        raise InputError(
            "the robot is eccentric; a floor for the real robot is one of the snap distance, which it lacks"
        )
    levels = stated + FARTHER * np.linspace(0, 1, LEVELS) ** 2
    numbers = np.random.default_rng(0).normal(size=(DRAWN, reals.size))
    needed = np.full(DRAWN, stated)
    for path in _close_to_snaps(robot, levels):
        ordered = sorted(path, key=lambda near: near.distance)
        if ordered:
            slopes = np.array([_secants(near, reals) for near in ordered])
            needed = np.maximum(needed, _needed(np.array([near.distance for near in ordered]), slopes, numbers, stated))
    floor = float(np.quantile(needed, confidence, method="higher"))
    if floor >= levels[-1]:
        raise SolveError(
            f"with {100 * confidence:g} % the real robot keeps no such floor: its parameters are not known well enough"
        )
    return floor


def _close_to_snaps(robot: Robot, levels: Array) -> Iterator[list[Near]]:
    """Configurations with distances of the levels (L,), on paths from untwisted tubes."""
    space = joint_space(robot)
    for q in space.sample(PATHS):
        check_time()
        rotations, translations = (np.array(each) for each in space.split(q))
        at = np.linspace(0, 1, WAYPOINTS)[:, None]
        table = rotations.mean() + at * (rotations - rotations.mean())
        try:
            start = forward_kinematics(robot, table[0], translations)
            yield list(_at_levels(start, table, translations, levels))
        except SolveError:
            continue


def _at_levels(start: Equilibrium, table: Array, translations: Array, levels: Array) -> Iterator[Near]:
    """Equilibria with the distances of the levels, by bisection between waypoints (T, n)."""
    path = follow(start.robot, table, np.tile(translations, (len(table), 1)), start=start)
    ends = path.snaps[0].index + 1 if path.snaps else len(table)
    values = np.array([snap_distance(e).turn for e in path.equilibria[:ends]] + [0.0] * bool(path.snaps))
    for level in levels.tolist():
        below = np.flatnonzero(values < level)
        if not len(below) or below[0] == 0:
            continue
        k = int(below[0])
        low, high, reached = 0.0, 1.0, path.equilibria[k - 1]
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            try:
                tried = forward_kinematics(
                    start.robot, table[k - 1] + middle * (table[k] - table[k - 1]), translations, start=reached
                )
                enough = tried.stable and snap_distance(tried).turn >= level
            except (InputError, SolveError):
                enough = False
            low, high, reached = (middle, high, tried) if enough else (low, middle, reached)
        yield Near(snap_distance(reached).turn, reached)


def _secants(near: Near, reals: RealRobots) -> Array:
    """(K,) secants of the snap distance by the numbers of the real robot."""
    turn, e = near

    def value(z: Array) -> float:
        try:
            real = forward_kinematics(*reals.at(z, e.rotations, e.translations))
            return snap_distance(real).turn if real.stable else 0.0
        except (InputError, SolveError):
            return 0.0

    ahead, behind = (np.array([value(side * SECANT * row) for row in np.eye(reals.size)]) for side in (1, -1))
    # A robot that cannot snap has an infinite distance: the other side then tells.
    rise, fall = (np.where(np.isfinite(each), each, np.nan) - turn for each in (ahead, behind))
    return np.asarray(np.nan_to_num(np.nanmean([rise, -fall], axis=0)) / SECANT)


def _needed(distances: Array, slopes: Array, numbers: Array, stated: float) -> Array:
    """(D,) floors that drawn robots (D, K) need on a path with rising distances (L,); 0 where they need none.

    Above the last configuration that misses the stated floor, the distance of the real robot is interpolated.
    """
    out, excess = np.zeros(len(numbers)), distances - stated + numbers @ slopes.T
    for k in range(len(distances)):
        following = min(k + 1, len(distances) - 1)
        here, above = excess[:, k], excess[:, following]
        share = np.where(above > here, -here / np.maximum(above - here, 1e-300), 1.0).clip(0, 1)
        out = np.where(here < 0, np.maximum(out, distances[k] + share * (distances[following] - distances[k])), out)
    return out
