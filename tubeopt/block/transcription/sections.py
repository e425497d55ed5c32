"""Cross-sections that bear a bending moment, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...typing import Array
from .buffered import bent_function, section_function


@dataclass(frozen=True, eq=False)
class Sections:
    """Cross-sections at X places: torque (X, n) and bending energy (X,) per length, curvature (X, 2), and their
    derivatives (X, n, c), (X, 2, c), (X, c) by theta and b, c = n + 2; stretch (X, n) and, of tubes off the centreline,
    its derivatives (X, n, n) by theta."""

    torque: Array
    curvature: Array
    energy: Array
    by_torque: Array
    by_curvature: Array
    by_energy: Array
    stretch: Array
    by_stretch: Array | None = None


Given = tuple[Array, Array, Array, Array]
"""theta, kb, m (X, n) and b (X, 2) at X places."""


def values_of(given: Given, offsets: tuple[Array, ...]) -> tuple[Array, Array, Array, Array]:
    """Torque (X, n), curvature (X, 2), bending energy (X,) and stretch (X, n) of `sections_of`."""
    count, n = given[0].shape
    if offsets:
        torque, stretch, curvature, energy = section_function("section", count, n, True)(*given[:3], *offsets)
        return torque.copy(), curvature.copy(), energy[:, 0].copy(), stretch.copy()
    torque, curvature, energy = bent_function("section", count, n)(*given)
    return torque.copy(), curvature.copy(), energy[:, 0].copy(), np.ones((count, n))


def sections_of(given: Given, offsets: tuple[Array, ...]) -> Sections:
    """Cross-sections that bear bending moments; `offsets` are those of the tubes and their angles (n,), or nothing."""
    count, n = given[0].shape
    if offsets:
        values, (torque, stretch, curvature, energy) = _off_the_centreline(given, offsets)
        # They bear no bending moment b.
        none, by = np.zeros((count, n, 2)), [part[..., :n] for part in (torque, curvature, energy, stretch)]
        return Sections(
            torque=values[0],
            curvature=values[2],
            energy=values[3][:, 0],
            by_torque=np.concatenate([by[0], none], axis=2),
            by_curvature=np.concatenate([by[1], none[:, :2]], axis=2),
            by_energy=np.concatenate([by[2], none[:, :1]], axis=2)[:, 0],
            stretch=values[1],
            by_stretch=by[3],
        )
    out = bent_function("linear", count, n)(*given)
    torque, curvature, energy = (part.copy() for part in out[:3])
    return Sections(torque, curvature, energy[:, 0], *_by_rows(out[3:], n + 2), np.ones((count, n)))


def by_data_of(given: Given, offsets: tuple[Array, ...]) -> tuple[Array, ...]:
    """Derivatives (X, n, 2 n), (X, 2, 2 n), (X, 2 n) of torque, curvature and energy there by kb and m; of tubes off
    the centreline also those (X, n, 2 n) of the stretch."""
    count, n = given[0].shape
    if offsets:
        torque, stretch, curvature, energy = (by[..., n:] for by in _off_the_centreline(given, offsets)[1])
        return torque, curvature, energy[:, 0], stretch
    return _by_rows(bent_function("linear_data", count, n)(*given), 2 * n)


def _off_the_centreline(given: Given, offsets: tuple[Array, ...]) -> tuple[list[Array], list[Array]]:
    """Torque, stretch, curvature and energy (X, r), and their derivatives (X, r, 3 n) by theta, kb and m."""
    count, n = given[0].shape
    out = [part.copy() for part in section_function("linear", count, n, True)(*given[:3], *offsets)]
    # CasADi stores (r, 3 n) by columns.
    by = [
        part.reshape(count, 3 * n, value.shape[1]).swapaxes(1, 2) for value, part in zip(out[:4], out[4:], strict=True)
    ]
    return out[:4], by


def _by_rows(parts: list[Array], columns: int) -> tuple[Array, Array, Array]:
    """Derivatives (X, n, c), (X, 2, c), (X, c), of which CasADi stores (rows, c) by columns."""
    by = [part.reshape(-1, columns, part.shape[1]).swapaxes(1, 2).copy() for part in parts]
    return by[0], by[1], by[2][:, 0]
