"""The samples of a workspace: a table with a row per sample, in memory or on disk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..display import Displayed
from ..equilibrium.batch import BatchStatistics, BatchStatus
from ..errors import InputError
from ..robots.robot import Robot
from ..typing import Array, Mask

CHUNK = 1 << 14
"""Rows that are looked at together, so that a table on disk never is in memory as a whole."""


@dataclass(frozen=True, eq=False)
class Workspace(Displayed):
    """Tips of a robot at N joint values; rows of what has no stable equilibrium that was found are NaN.

    The arrays are views of `table`, which lies on disk where the workspace was computed with `out`.
    """

    _brief = ("robot", "method", "seed", "table")

    robot: Robot
    """The robot."""
    method: str
    """Sampling method of the joint values."""
    seed: int
    """Seed of the joint values."""
    table: Array
    """(N, 2 n + 7) rotations, translations, tip position, tip direction, margin; rad and m."""
    failures: tuple[tuple[int, str], ...] = ()
    """(row, reason) of configurations without an equilibrium."""

    def __len__(self) -> int:
        return len(self.table)

    @property
    def value(self) -> Array:
        """(N, 3) the tips, m."""
        return self.tip_position

    @property
    def status(self) -> BatchStatus:
        """Whether an equilibrium was found for every sample."""
        return BatchStatus.GAPS if self.failures else BatchStatus.SOLVED

    @property
    def statistics(self) -> BatchStatistics:
        """Numbers of samples and failures."""
        return BatchStatistics(len(self), len(self.failures))

    @property
    def rotations(self) -> Array:
        """(N, n) rotations, rad."""
        return self.table[:, : self.robot.n_tubes]

    @property
    def translations(self) -> Array:
        """(N, n) translations, m."""
        return self.table[:, self.robot.n_tubes : 2 * self.robot.n_tubes]

    @property
    def tip_position(self) -> Array:
        """(N, 3) in the plate frame, m."""
        return self.table[:, -7:-4]

    @property
    def tip_direction(self) -> Array:
        """(N, 3) unit vectors: where the tips point."""
        return self.table[:, -4:-1]

    @property
    def margin(self) -> Array:
        """(N,) stability margins."""
        return self.table[:, -1]

    @property
    def converged(self) -> Mask:
        """(N,) whether a stable equilibrium was found."""
        return np.isfinite(self.margin)

    def chunks(self) -> Iterator[tuple[int, Array]]:
        """Parts of the table, each with the index of its first row; a table on disk is read in parts."""
        for first in range(0, len(self), CHUNK):
            rows, columns = self.table[first : first + CHUNK].shape
            if isinstance(self.table, np.memmap) and self.table.filename is not None:
                start = self.table.offset + 8 * columns * first
                part = np.fromfile(self.table.filename, "<f8", rows * columns, offset=start).reshape(rows, columns)
            else:
                part = self.table[first : first + CHUNK]
            yield first, part

    def some(self, most: int) -> Array:
        """At most `most` rows in random order, the same each time; every k-th row of a sequence would be biased."""
        random = np.random.default_rng(len(self))
        chosen = np.sort(random.choice(len(self), min(most, len(self)), replace=False))
        rows = [part[chosen[(chosen >= first) & (chosen < first + len(part))] - first] for first, part in self.chunks()]
        return np.asarray(random.permutation(np.concatenate(rows)))


def width(n_tubes: int) -> int:
    """Columns of the table of a robot."""
    return 2 * n_tubes + 7


def held(table: Array, min_margin: float) -> Mask:
    """(B,) rows of a table that are stable by at least a margin."""
    with np.errstate(invalid="ignore"):
        return np.asarray(table[:, -1] >= min_margin)


def require_samples(workspace: Workspace) -> None:
    """Raise InputError where not a single sample has a stable equilibrium."""
    if not any(np.isfinite(part[:, -1]).any() for _, part in workspace.chunks()):
        raise InputError(f"none of the {len(workspace)} samples of the workspace has a stable equilibrium")
