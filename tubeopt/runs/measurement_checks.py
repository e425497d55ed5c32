"""Whether recorded numbers can be what their columns say: wrapped angles unwrapped, and units that cannot be right."""

from __future__ import annotations

import math

import numpy as np

from ..robots.robot import Robot
from ..typing import Array
from ..validation.measurements import Measurements
from ..validation.timeline import runs_of

A_TURN = 1.5 * math.pi
"""rad: between rows on end, a larger step of a rotation is a turn that was counted away."""

SMALL, LARGE = 0.02, 8.0
"""Parts of the arm's length between which the spread of tips that move must lie."""

MOVES = 0.3
"""rad: a robot whose tubes turn by more against each other moves its tip."""

SLOW = 1.0
"""s: recorders of a moving arm are faster."""

PATH, ROWS = 0.1, 20
"""Rows that are at least so many are a path where the joints usually move by less than this part of their range."""


def unwrapped(time: Array, rotations: Array, words: list[str]) -> Array:
    """Rotations (N, n) without the jumps by full turns between rows of a run; says where there were any."""
    out = rotations.copy()
    for rows in runs_of(time):
        out[rows] = np.unwrap(rotations[rows], discont=A_TURN, axis=0)
    steps = np.abs(np.diff(rotations - out, axis=0)) > 1.0
    for tube in np.flatnonzero(steps.any(0)).tolist():
        count = int(steps[:, tube].sum())
        often = "once" if count == 1 else f"{count} times"
        words.append(
            f"rotation_{tube + 1} jumps by a full turn {often}: taken as an angle that was wrapped, and unwrapped"
        )
    return out


def doubts_of(found: Measurements, robot: Robot) -> list[str]:
    """Remarks on units that the numbers speak against."""
    words = []
    turned = np.abs(found.rotations).max()
    if 0 < turned <= 2 * math.pi / 57:
        words.append(
            f"no rotation is beyond {math.degrees(turned):.2g} deg: are they in rad, in a column that says deg?"
        )
    if turned > 20 * math.pi:
        words.append(f"rotations reach {turned / (2 * math.pi):.0f} turns: are they in deg, in a column that says rad?")
    length = max(tube.length for tube in robot.tubes)
    tips = found.tip_position[np.isfinite(found.tip_position[:, 0])]
    spread = float(np.linalg.norm(np.ptp(tips, axis=0))) if len(tips) else 0.0
    moving = np.ptp(found.rotations, axis=0).max() > MOVES or np.ptp(found.translations, axis=0).max() > 0.1 * length
    if len(tips) > 1 and moving and spread < SMALL * length:
        words.append(
            f"the tips lie within {1e3 * spread:.2g} mm of each other, and the tubes are up to {1e3 * length:.0f} mm "
            "long: are positions in m, in columns that say mm, or was the sensor not on the tip?"
        )
    if spread > LARGE * length:
        words.append(
            f"the tips lie up to {1e3 * spread:.0f} mm apart, and the tubes are up to {1e3 * length:.0f} mm long: are "
            "positions in mm, in columns that say m?"
        )
    reach = np.abs(found.translations).max()
    if 0 < reach < 1e-3 * length and np.ptp(found.translations) > 0:
        words.append(f"no translation is beyond {1e3 * reach:.2g} mm: are they in m, in columns that say mm?")
    return words + _doubts_of_clock(found) + _doubts_of_time(found)


def _doubts_of_clock(found: Measurements) -> list[str]:
    """Remarks on times that stand still, or that go back where joint readings are found by them."""
    if found.time is None:
        return []
    steps, words = np.diff(found.time), []
    still, back = int((steps == 0).sum()), np.flatnonzero(steps < 0)
    if still:
        rows = "row has" if still == 1 else "rows have"
        words.append(f"{still} {rows} the time of the row before: was it recorded twice, or is the clock too coarse?")
    if found.log is not None and len(back):
        words.append(
            f"the time of the positions goes back from {found.time[back[0]]:.3f} to {found.time[back[0] + 1]:.3f} s: "
            "did the clock start anew? Joint readings are looked for at these times"
        )
    return words


def _doubts_of_time(found: Measurements) -> list[str]:
    if found.time is None or len(found) < ROWS:
        return []
    step = float(np.median(np.abs(np.diff(found.time))))
    joints = np.hstack([found.rotations, found.translations])
    extent = np.ptp(joints, axis=0)
    moved = np.abs(np.diff(joints, axis=0))[:, extent > 0] / extent[extent > 0]
    if step <= SLOW or not moved.size or np.median(moved.max(1)) > PATH:
        return []
    return [f"rows follow each other after {step:.3g} s on a path of the joints: are times in ms, taken for s?"]
