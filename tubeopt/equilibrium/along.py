"""Position and curvature at a fraction of the arm's length, with their derivatives."""

from __future__ import annotations

import numpy as np

from ..block.transcription.arm import between
from ..block.transcription.collocated import ENDS, THROUGH_ENDS
from ..typing import Array
from .linearised import Linearised


def place_at(of: Linearised, fraction: float) -> Array:
    """(3,) position at a fraction of the arm's length in front of the plate, m."""
    table = of.arm.position
    if len(of.cuts) < 2:
        return np.asarray(table[-1])
    k, weights, _ = _weights(of, fraction)
    return np.asarray(weights @ table[4 * k : 4 * k + 5])


def position_at(of: Linearised, fraction: float) -> tuple[Array, Array]:
    """(3,) position at a fraction of the arm's length in front of the plate, m, and its change (3, Q)."""
    table = of.arm.position
    change = of.position.copy()
    if len(of.cuts) < 2:
        return table[-1], change[-1]
    longer = _longer(of)
    # The last shape point moves with the tip; the others are at fixed arc lengths.
    change[-1] -= np.outer(of.arm.frame[-1][:, 2], longer)
    k, weights, rates = _weights(of, fraction)
    own = slice(4 * k, 4 * k + 5)
    return weights @ table[own], np.tensordot(weights, change[own], 1) + fraction * np.outer(rates @ table[own], longer)


def curvature_at(of: Linearised, fraction: float) -> tuple[Array, Array]:
    """(2,) curvature in the Bishop frame at a fraction of the arm's length, 1/m, and its change (2, Q)."""
    if len(of.cuts) < 2:
        return np.zeros(2), np.zeros((2, of.size))
    k, x = _place(of, fraction)
    found = of.section(k, x, fraction * _longer(of))
    return found.curvature, found.by_curvature


def _longer(of: Linearised) -> Array:
    """(Q,) change of the arm's length."""
    return np.asarray(of.arm.frame[-1][:, 2] @ of.pushed)


def _place(of: Linearised, fraction: float) -> tuple[int, float]:
    """The piece in which a fraction of the length lies, and how far inside, 0 to 1."""
    (k,), _, (x,) = between(of.cuts, np.array([fraction * of.cuts[-1]]))
    return int(k), float(x)


def _weights(of: Linearised, fraction: float) -> tuple[int, Array, Array]:
    """The piece in which a fraction of the length lies, and weights (5,) of its shape points in value and change per m,
    by the polynomial through them."""
    k, x = _place(of, fraction)
    powers = np.arange(len(ENDS))
    rates = powers * np.power(x, np.maximum(powers - 1, 0))
    return k, np.power(x, powers) @ THROUGH_ENDS, rates @ THROUGH_ENDS / (of.cuts[k + 1] - of.cuts[k])
