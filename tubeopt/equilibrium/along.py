"""Position and curvature at a fraction of the arm's length, with their derivatives."""

from __future__ import annotations

import numpy as np

from ..block.transcription.collocated import ENDS
from ..block.transcription.linear import rotation_change, rotation_rates_at, rotations_at, slopes_at
from ..typing import Array
from .derivatives import Derivatives
from .linearised import Linearised


def place_at(of: Derivatives | Linearised, fraction: float) -> Array:
    """(3,) position at a fraction of the arm's length in front of the plate, m."""
    table = of.arm.position
    if len(of.cuts) < 2:
        return np.asarray(table[-1])
    k, weights, _ = _weights(of, fraction)
    return np.asarray(weights @ table[4 * k : 4 * k + 5])


def position_at(of: Derivatives | Linearised, fraction: float) -> tuple[Array, Array]:
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


def curvature_at(of: Derivatives | Linearised, fraction: float) -> tuple[Array, Array]:
    """(2,) curvature in the Bishop frame at a fraction of the arm's length, 1/m, and its change (2, Q)."""
    if len(of.cuts) < 2:
        return np.zeros(2), of.per_tube(np.zeros((2, of.size)))
    k, x = _place(of, fraction)
    if isinstance(of, Linearised):
        found = of.section(k, x, fraction * _longer(of))
        return found.curvature, found.by_curvature
    arm, n = of.arm, of.arm.n_tubes
    here = np.array([x])
    at = slopes_at(arm, rotations_at(arm, of.slopes, here))
    bent = at.curvature_slope[k, 0]
    theta = rotation_change(arm, of.slopes, of.response, of.data, here)[k, 0]
    moved = bent[:, :n] @ rotation_rates_at(arm, of.slopes, here)[k, 0]
    change = of.per_tube(bent[:, :n] @ theta + bent[:, n:] @ of.data[k, : 2 * n])
    return at.curvature[k, 0], change + fraction * np.outer(moved, _longer(of))


def _longer(of: Derivatives | Linearised) -> Array:
    """(Q,) change of the arm's length."""
    return np.asarray(of.per_tube(of.arm.frame[-1][:, 2] @ of.pushed))


def _place(of: Derivatives | Linearised, fraction: float) -> tuple[int, float]:
    """The piece in which a fraction of the length lies, and how far inside, 0 to 1."""
    s = fraction * of.cuts[-1]
    k = int(np.clip(np.searchsorted(of.cuts[:-1], s, side="right") - 1, 0, len(of.cuts) - 2))
    return k, float((s - of.cuts[k]) / (of.cuts[k + 1] - of.cuts[k]))


def _weights(of: Derivatives | Linearised, fraction: float) -> tuple[int, Array, Array]:
    """The piece in which a fraction of the length lies, and weights (5,) of its shape points in value and change per m,
    by the polynomial through them."""
    k, x = _place(of, fraction)
    table = np.linalg.inv(np.vander(ENDS, increasing=True))
    powers = np.arange(len(ENDS))
    rates = powers * np.power(x, np.maximum(powers - 1, 0))
    return k, np.power(x, powers) @ table, rates @ table / (of.cuts[k + 1] - of.cuts[k])
