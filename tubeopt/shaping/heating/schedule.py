"""Whole counts in place of real duties: sum-up rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from .rig import COUNTS

Counts = NDArray[np.int64]


def sum_up_rounding(duty: ArrayLike) -> Counts:
    """Counts (T,) whose running sum never differs from that of 255 times the duty by more than a half.

    Every slot gets the count that brings the sums together again, so that between two counts the schedule dithers in
    the right proportion, and the tube, which integrates, hardly sees it: the combinatorial integral approximation with
    equal slots (Sager, Math. Program. 118 (2009)).

    Args:
        duty: (T,) in [0, 1], mean over each slot.

    Raises:
        InputError: a duty outside of [0, 1].
    """
    levels = np.asarray(duty, dtype=float)
    if levels.ndim != 1 or not np.isfinite(levels).all() or (levels < 0).any() or (levels > 1).any():
        raise InputError("duty must be a list of numbers from 0 to 1")
    # Rounding the running sums themselves leaves no more than a half; their differences are the counts. Where the
    # duty is 0 a count may still be owed: it is dropped, rather than heat after the end.
    sums = np.floor(COUNTS * np.cumsum(levels) + 0.5)
    counts = np.diff(sums, prepend=0.0)
    return np.asarray(np.clip(counts, 0, COUNTS) * (levels > 0), dtype=np.int64)
