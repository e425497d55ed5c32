"""Cross-sections that bear a bending moment, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...typing import Array
from .buffered import bent_function, section_function


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections at X places: torque per length above curvature, `values` (X, n + 2), and bending energy per length
    (X,), with their derivatives (X, n + 2, n + 2), (X, n + 2) by theta and b; stretch (X, n) and, of tubes off the
    centreline, its derivatives (X, n, n) by theta."""

    values: Array
    energy: Array
    by: Array
    by_energy: Array
    stretch: Array
    by_stretch: Array | None = None

    @property
    def torque(self) -> Array:
        """(X, n) N m per m."""
        return self.values[:, :-2]

    @property
    def curvature(self) -> Array:
        """(X, 2) 1/m."""
        return self.values[:, -2:]

    @property
    def by_torque(self) -> Array:
        """(X, n, n + 2) of the torque."""
        return self.by[:, :-2]

    @property
    def by_curvature(self) -> Array:
        """(X, 2, n + 2) of the curvature."""
        return self.by[:, -2:]


Given = tuple[Array, Array, Array, Array]
"""theta, kb, m (X, n) and b (X, 2) at X places."""


def values_of(given: Given, offsets: tuple[Array, ...]) -> tuple[Array, Array, Array, Array]:
    """Torque (X, n), curvature (X, 2), bending energy (X,) and stretch (X, n) of `sections_of`."""
    count, n = given[0].shape
    if offsets:
        torque, stretch, curvature, energy = section_function("section", count, n, True)(*given[:3], *offsets)
        return torque.copy(), curvature.copy(), energy[:, 0].copy(), stretch.copy()
    values, energy = bent_function("section", count, n)(*given)
    own = values.copy()
    return own[:, :n], own[:, n:], energy[:, 0].copy(), np.ones((count, n))


def sections_of(given: Given, offsets: tuple[Array, ...]) -> Sections:
    """Cross-sections that bear bending moments; `offsets` are those of the tubes and their angles (n,), or nothing."""
    count, n = given[0].shape
    if offsets:
        values, (torque, stretch, curvature, energy) = _off_the_centreline(given, offsets)
        # They bear no bending moment b.
        by, by_energy = np.zeros((count, n + 2, n + 2)), np.zeros((count, n + 2))
        by[:, :n, :n], by[:, n:, :n], by_energy[:, :n] = torque[..., :n], curvature[..., :n], energy[:, 0, :n]
        stacked = np.concatenate([values[0], values[2]], axis=1)
        return Sections(stacked, values[3][:, 0], by, by_energy, values[1], stretch[..., :n])
    stacked, energy, by, by_energy = (part.copy() for part in bent_function("linear", count, n)(*given))
    return Sections(stacked, energy[:, 0], by.reshape(count, n + 2, n + 2), by_energy, np.ones((count, n)))


def by_data_of(given: Given, offsets: tuple[Array, ...]) -> tuple[Array, ...]:
    """Derivatives (X, n, 2 n), (X, 2, 2 n), (X, 2 n) of torque, curvature and energy there by kb and m; of tubes off
    the centreline also those (X, n, 2 n) of the stretch."""
    count, n = given[0].shape
    if offsets:
        torque, stretch, curvature, energy = (by[..., n:] for by in _off_the_centreline(given, offsets)[1])
        return torque, curvature, energy[:, 0], stretch
    by, by_energy = (part.copy() for part in bent_function("linear_data", count, n)(*given))
    by = by.reshape(count, n + 2, 2 * n)
    return by[:, :n], by[:, n:], by_energy


def _off_the_centreline(given: Given, offsets: tuple[Array, ...]) -> tuple[list[Array], list[Array]]:
    """Torque, stretch, curvature and energy (X, r), and their derivatives (X, r, 3 n) by theta, kb and m."""
    count, n = given[0].shape
    out = [part.copy() for part in section_function("linear", count, n, True)(*given[:3], *offsets)]
    # CasADi stores (r, 3 n) by columns.
    by = [
        part.reshape(count, 3 * n, value.shape[1]).swapaxes(1, 2) for value, part in zip(out[:4], out[4:], strict=True)
    ]
    return out[:4], by
