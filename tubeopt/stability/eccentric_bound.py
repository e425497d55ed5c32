"""How long a segment of three equal tubes off the centreline may be, so that no rotation whatsoever makes it snap.

Three equal tubes at 0 and +-120 deg obey, in x = omega (L - s) with omega^2 = m^2 / (K kt) (m = kb kappa, K the sum of
kb at one place), equations that know nothing but delta = d m / K:

    theta_x = g p,   p_x = M,   p(0) = 0;     linearised   y_x = g v + p (g' y),   v_x = M' y,   v(0) = 0,

with g and M those of a cross-section with K = m = 1 and offset delta. Joint rotations, alpha = theta(X) + lam p(X),
depend smoothly and one to one on those of the tips unless some y has y(X) + lam v(X) = 0. Multiplied by y and
integrated, v_x = M' y says that such a y makes

    Q[y] = y(X)' lam^-1 y(X) + int y_x' G^-1 y_x - y_x' B y + y' C y,   B_ij = p_i g'_ij / g_i,   C = sym M',   G = diag
    g,

zero. With R(0) = 0 and, for every theta and every p that is possible at x,

    R_x >= (R - B/2)' G (R - B/2) - C                                                                          (*)

Q is at least y(X)' (lam^-1 - R(X)) y(X), and not 0. The right-hand side of (*) is convex in p, and p, an integral of M,
lies in x times the convex hull of all M, which a polygon of twelve corners encloses. R = tan(phi(x)) P + delta x J,
with J the projection on turns of all tubes alike and P the rest, fulfils (*) if phi_x is at least `steepest`.

The table that comes with the package, of the x at which phi reaches a given angle, for delta up to 0.2525, is made by
`python -m tubeopt.stability.eccentric_bound`. Every number of it is on the safe side: phi_x is the largest of both ends
of each step, at all corners of the polygon, on a grid of rotations whose largest value is raised by GRID_ROOM; what is
read is lowered by TABLE_ROOM; towards delta = 0, where phi = x is exact, all of that goes to 0. The maximum over
rotations is a search, not an enclosure by intervals.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from ..block.transcription.buffered import section_function
from ..errors import InputError
from ..robots.eccentric import PLACES
from ..typing import Array

FILE = Path(__file__).with_name("eccentric_bound.csv")

DELTAS = np.array([0.0, 0.0025, 0.005, *np.arange(0.01, 0.2501, 0.01), 0.2525])
"""delta of the rows of the table."""

ANGLES = np.linspace(0.0, np.pi / 2, 65)
"""phi of its columns, rad."""

CORNERS = (0.8169, 0.8301)
"""Support of all M towards (2, -1, -1) / sqrt 6 and (1, -1, 0) / sqrt 2, rounded up: twelve sides in turns. With three
equal tubes M_i = sum_j sin(theta_i - theta_j) / k with k >= 3: exactly sqrt(2/3) and 0.82973."""

BASIS = np.column_stack([np.array([2.0, -1.0, -1.0]) / np.sqrt(6), np.array([0.0, 1.0, -1.0]) / np.sqrt(2)])
"""(3, 2) what P keeps: turns of the tubes against one another."""

GRID = 24
"""Rotations per turn and tube at which the slope of phi is maximised: every 15 deg."""

GRID_ROOM = (1e-4, 4e-3)
"""Share by which the slope is raised, and the same per delta: at least twice what lies between the rotations of
GRID."""

TABLE_ROOM = 5e-5
"""By how much the table's x is lowered for what linear interpolation in delta and phi may be off."""

STEPS = 1600
"""Steps of x up to pi / 2."""


def corners() -> Array:
    """(12, 3) corners of the polygon, in order, that holds all M."""
    turn = np.arange(12) * np.pi / 6
    sides = np.column_stack([np.cos(turn), np.sin(turn)]) @ BASIS.T
    reach = np.array(CORNERS)[np.arange(12) % 2]
    out = []
    for k in range(12):
        rows, limit = sides[[k, (k + 1) % 12]], reach[[k, (k + 1) % 12]]
        out.append(rows.T @ np.linalg.solve(rows @ rows.T, limit))
    return np.array(out)


class Slope:
    """The slope of phi at rotations (T, 3) of one delta and every p of some corners, prepared for all x and phi."""

    def __init__(self, theta: Array, delta: float, vertices: Array) -> None:
        moments, g, stretched = cross_sections(theta, delta)
        relative = stretched / g[:, :, None]
        basis, common = BASIS, np.full(3, 1 / np.sqrt(3))
        # Per unit of x: B on turns within P (T, V, 3, 2), and delta J - B/2 on turns of all alike (T, V, 3).
        across = vertices[None, :, :, None] * (relative @ basis)[:, None]
        alike = delta * common - vertices * (relative @ common)[:, None] / 2
        self.delta = delta
        self.coupling = _form(basis.T @ moments @ basis)[:, :, None]
        self.alone = _form(np.einsum("ia,ti,ib->tab", basis, g, basis))[:, :, None]
        self.mixed = _form(np.einsum("ia,ti,tvib->tvab", basis, g, across))
        self.square = _form(np.einsum("tvia,ti,tvib->tvab", across, g, across))
        self.first = np.einsum("ia,ti,tvi->atv", basis, g, alike)
        self.second = np.einsum("tvia,ti,tvi->atv", across, g, alike)
        self.shear = (basis.T @ moments @ common / 2).T[:, :, None]
        self.common = np.einsum("tvi,ti,tvi->tv", alike, g, alike)

    def __call__(self, x: float, phi: float) -> Array:
        """(T, V) least slope of phi at x and phi."""
        sine, cosine = np.sin(phi), np.cos(phi)
        form = sine**2 * self.alone - sine * cosine * x * self.mixed + (cosine * x / 2) ** 2 * self.square
        form = form - cosine**2 * self.coupling
        lean = sine * x * self.first - cosine * x**2 / 2 * self.second - cosine * self.shear
        left = self.delta - x**2 * self.common
        if (left <= 0).any():
            raise ArithmeticError(f"turns of all tubes alike are not bounded at x = {x:g}")
        a, b, c = form[0] + lean[0] ** 2 / left, form[1] + lean[0] * lean[1] / left, form[2] + lean[1] ** 2 / left
        return np.asarray((a + c) / 2 + np.hypot((a - c) / 2, b))


def cross_sections(theta: Array, delta: float) -> tuple[Array, Array, Array]:
    """M' (N, 3, 3), g (N, 3) and g' (N, 3, 3) at rotations (N, 3)."""
    balance = section_function("balance", len(theta), 3, True)
    _, turned, _, g, stretched = balance(theta, 1.0, 1.0, delta, np.array(PLACES))
    moments, stretches = (part.reshape(-1, 3, 3).swapaxes(1, 2).copy() for part in (turned, stretched))
    return moments, g.copy(), stretches


def _form(matrix: Array) -> Array:
    """Entries (3, ...) of the symmetric part of matrices (..., 2, 2): xx, xy, yy."""
    return np.stack([matrix[..., 0, 0], (matrix[..., 0, 1] + matrix[..., 1, 0]) / 2, matrix[..., 1, 1]])


def all_rotations() -> Array:
    """(GRID^3, 3) rotations of three tubes on a grid over a turn of each, rad."""
    axis = np.arange(GRID) * 2 * np.pi / GRID
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def length_curve(delta: float, steps: int = STEPS) -> Array:
    """(65,) x at which phi reaches ANGLES, for one delta: an upper bound of phi, so a lower one of x."""
    if delta == 0.0:
        return ANGLES.copy()
    # Turning all by 120 deg and renaming the tubes turns the polygon by four corners: a third of them is enough.
    slope = Slope(all_rotations(), delta, corners()[:4])
    raised = 1 + GRID_ROOM[0] + GRID_ROOM[1] * delta
    h = np.pi / 2 / steps
    x, phi = [0.0], [0.0]
    while phi[-1] < np.pi / 2:
        start, ahead = phi[-1], x[-1] + h
        steep = float(slope(ahead, start).max())
        steep = max(steep, float(slope(ahead, min(np.pi / 2, start + h * raised * steep)).max()))
        x.append(ahead)
        phi.append(start + h * raised * steep)
    return np.asarray(np.interp(ANGLES, phi, x))


@lru_cache(maxsize=1)
def table() -> Array:
    """(deltas, angles) x of the table, lowered; row 0, of tubes on the centreline, is exact: x = phi."""
    rows = np.loadtxt(FILE, delimiter=",")
    return np.maximum(rows - np.where(DELTAS > 0, TABLE_ROOM, 0.0)[:, None], 0.0)


def longest(delta: float, angle: float) -> float:
    """The x up to which phi stays below `angle` (rad, at most pi / 2): a segment that is shorter cannot snap."""
    if not 0 <= delta <= DELTAS[-1]:
        raise InputError(f"delta is {delta:g}; the bound holds from 0 to {DELTAS[-1]:g}")
    i = min(int(np.searchsorted(DELTAS, delta, side="right")) - 1, len(DELTAS) - 2)
    row = (delta - DELTAS[i]) / (DELTAS[i + 1] - DELTAS[i])
    at = angle / ANGLES[1]
    j = min(int(at), len(ANGLES) - 2)
    column = at - j
    near = table()[i : i + 2, j : j + 2]
    left, right = (1 - row) * near[0] + row * near[1]
    return float((1 - column) * left + column * right)


def make_table() -> None:
    """Compute the table and write it: some minutes."""
    rows = [length_curve(delta) for delta in DELTAS]
    head = "x up to which phi stays below 0, pi/128, .. pi/2 (columns), by delta (rows); see eccentric_bound.py"
    np.savetxt(FILE, rows, fmt="%.7f", delimiter=",", header=head)


if __name__ == "__main__":
    make_table()
