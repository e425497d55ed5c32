"""Points that fill a box evenly."""

from __future__ import annotations

import numpy as np
import scipy

from ..typing import Array


def sobol(dimension: int, count: int, seed: int = 0) -> Array:
    """(count, dimension) numbers from 0 to 1: the first of a scrambled Sobol sequence, the same for the same seed."""
    # They come in powers of two.
    return np.asarray(scipy.stats.qmc.Sobol(dimension, rng=seed).random_base2((count - 1).bit_length())[:count])
