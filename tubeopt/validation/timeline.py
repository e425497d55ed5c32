"""Joint readings at any time: interpolated within each run, behind by a latency, and through the play of the drives."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..robots.calibration import Calibration
from ..typing import Array, Index
from .measurements import Measurements

TURN = 2 * math.pi
"""rad."""


def runs_of(time: Array) -> list[Index]:
    """Indices of every run: rows on end whose times ascend without a gap."""
    step = np.diff(time)
    forward = step[step > 0]
    usual = float(np.median(forward)) if len(forward) else 0.0
    cuts = np.flatnonzero((step <= 0) | (step > 5.0 * usual)) + 1  # runs are parted by much longer steps
    return list(np.split(np.arange(len(time)), cuts))


@dataclass(frozen=True, eq=False)
class Timeline:
    """The joint readings of measurements, as a function of a latency.

    Readings between two rows are interpolated by monotone cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17 (1980)),
    which do not overshoot where a joint stops. Before the first and behind the last row of a run they are held.
    """

    measurements: Measurements
    runs: tuple[Index, ...]
    source: tuple[tuple[Array, Array], ...]
    """Times and joints (M, 2 n) of every run of what was recorded of the joints."""

    @classmethod
    def of(cls, measurements: Measurements) -> Timeline:
        """The runs of measurements, in the order of time; without times there are none."""
        m = measurements
        if m.time is None:
            return cls(m, (), ())
        runs = tuple(runs_of(m.time))
        if m.log is None:
            time, joints, parts = m.time, np.hstack([m.rotations, m.translations]), list(runs)
        else:
            time, joints = m.log.time, np.hstack([m.log.rotations, m.log.translations])
            parts = runs_of(time)
        return cls(m, runs, tuple((time[part], joints[part]) for part in parts))

    def readings(self, latency: float) -> tuple[Array, Array]:
        """(N, n) rotations, rad, and translations, m, by a latency (s) before each row."""
        m = self.measurements
        if m.time is None or (m.log is None and latency == 0):
            return m.rotations, m.translations
        joints = np.empty((len(m), 2 * m.n_tubes))
        if m.log is None:
            for rows, (time, values) in zip(self.runs, self.source, strict=True):
                joints[rows] = _between(time, values, m.time[rows] - latency)
        else:
            wanted = m.time - latency
            first = np.array([time[0] for time, _ in self.source])
            run = np.clip(np.searchsorted(first, wanted, side="right") - 1, 0, len(first) - 1)
            for k, (time, values) in enumerate(self.source):
                joints[run == k] = _between(time, values, wanted[run == k])
        return joints[:, : m.n_tubes], joints[:, m.n_tubes :]

    def driven(self, drives: Calibration, turns: Array) -> tuple[Array, Array]:
        """(N, n) joint values of the model, rad and m, at the readings less full `turns` (n,), through latency and play
        of the drives; those of carriages that do not yield."""
        read, moved = self.readings(drives.latency)
        alpha, shift = drives.to_model(read - TURN * turns, moved)
        return (
            self.with_play(alpha, np.array(drives.rotation_play)),
            self.with_play(shift, np.array(drives.translation_play)),
        )

    def with_play(self, joints: Array, play: Array) -> Array:
        """(N, n) joint values of the tubes behind drives at `joints` with play of half width (n,), rad or m.

        A tube stands still until its drive has taken up the play. At the start of a run the play is taken up in the
        direction of the first motion.
        """
        if not play.any():
            return joints
        followed = joints.copy()
        for rows in self.runs:
            drive = joints[rows]
            moved = np.diff(drive, axis=0)
            begins = np.argmax(moved != 0, axis=0) if len(moved) else np.zeros(len(play), dtype=int)
            first = np.sign(moved[begins, np.arange(len(play))]) if len(moved) else np.zeros(len(play))
            low, high = drive - play, drive + play
            here = drive[0] - play * first
            for k, row in enumerate(rows):
                here = np.minimum(np.maximum(here, low[k]), high[k])
                followed[row] = here
        return followed


def _between(time: Array, values: Array, wanted: Array) -> Array:
    """Values (M, c) at times (M,), at wanted times, held beyond the ends."""
    if len(time) == 1 or not len(wanted):
        return np.repeat(values[:1], len(wanted), axis=0)
    inside = np.clip(wanted, time[0], time[-1])
    return np.asarray(scipy.interpolate.PchipInterpolator(time, values)(inside))


def middles_of(drives: Calibration, measurements: Measurements) -> tuple[Calibration, Array]:
    """Drives whose gains act about the turn in which the recording lies, and (n,) turns from there to its median.

    A drive of gain 1 has no turn yet: its own begins next to the median of the recording.
    """
    middle = np.median(measurements.rotations, axis=0)
    gained = np.array(drives.rotation_gains) != 1.0
    known = np.where(gained, drives.rotation_middles, middle)
    turns = np.where(gained, np.round((middle - known) / TURN), 0.0)
    return replace(drives, rotation_middles=tuple(known.tolist())), turns
