"""Proofs that no joint motion of a set causes a snap, by a box of changes that is mapped into itself."""

from __future__ import annotations

import math

import numpy as np

from ..typing import Array

MOST_CHANGE = 3.0
"""Largest change (rad) of an angle in a box. Below pi, h has one extremum beside 0 in it."""

ROUND_OFF = 1e-9
"""H must exceed this. Its eigenvalues are right to about 1e-12, so that a smaller value would do."""

SPARE = 1e-10
"""Width (rad) of the box beyond the fixed point, so that it is mapped inside itself by more than round-off."""

SWEEPS, ROOM = 2000, 1.3
"""Maximum number of images of a box, and factor on the remaining steps by which the box is enlarged."""

SHRINKS = 8
"""Images of a box between two checks of H in it."""

FULL_TURN = 2 * math.pi


class Form:
    """Equations of an equilibrium as a map of boxes u = (-low, high), (..., 2 R), of R changes."""

    defect: Array
    """(R,) change that the residual of the equations stands for; about 1e-16."""

    def image(self, y: Array, u: Array) -> Array:
        """Box that contains the image of the box [x] under the map, where y is the box of its linear part."""
        raise NotImplementedError

    def least_eigenvalue(self, u: Array) -> Array:
        """(S,) lower bounds of the second variation in each of the boxes (S, 2 R)."""
        raise NotImplementedError

    def proves(self, y: Array) -> bool:
        """True if all joint motions with linear parts in the boxes y (S, 2 R) lead to one stable equilibrium."""
        if not len(self.defect):
            return True
        y = y + np.tile(self.defect, 2)
        box = self.closed(y)
        while box is not None and (box <= MOST_CHANGE).all() and (self.image(y, box) <= box).all():
            if (self.least_eigenvalue(box) > ROUND_OFF).all():
                return True
            smaller = self.image(y, box)  # which holds its own image, too
            for _ in range(SHRINKS):
                smaller = self.image(y, smaller)
            if (box - smaller).max() < SPARE:
                return False
            box = smaller
        return False

    def closed(self, y: Array) -> Array | None:
        """Box around the least fixed point by plain iteration; None if it finds none.

        The steps shrink by a ratio; the box includes the sum of the remaining ones, with a reserve.
        """
        u, size, wider = y, math.inf, y + SPARE  # images of a wider start hold those of y
        for _ in range(SWEEPS):
            image = self.image(wider, u)
            step, before = image - u, size
            size = float(step.max())
            if image.max() > MOST_CHANGE:
                return None
            box = image + step * (ROOM / max(before / size - 1, 1e-3)) if size > 0 else image
            if (box <= MOST_CHANGE).all() and (self.image(y, box) <= box).all():
                return np.asarray(box)
            u = image
        return None


def widened(matrix: Array, u: Array) -> Array:
    """(..., 2 P) box of the image of boxes u (..., 2 Q) under a matrix (P, Q)."""
    low, high = np.split(u, 2, axis=-1)
    middle, half = (high - low) @ matrix.T / 2, (high + low) @ np.abs(matrix).T / 2
    return np.concatenate([half - middle, half + middle], axis=-1)


def range_of_cosine(low: Array, high: Array) -> tuple[Array, Array]:
    """Least and largest cosine of angles between `low` and `high`, rad."""
    ends = np.stack([np.cos(low), np.cos(high)])
    has_min, has_max = (np.floor((high - at) / FULL_TURN) > np.floor((low - at) / FULL_TURN) for at in (np.pi, 0.0))
    return np.where(has_min, -1.0, ends.min(0)), np.where(has_max, 1.0, ends.max(0))


def bends(sine: Array, cosine: Array, u: Array) -> Array:
    """(4, ..., P) values of sine (1 - cos x) + cosine (x - sin x) among which its least and largest one in boxes are.

    At the low end of boxes u (..., 2 P) within -pi and pi, the high end, 0, and the extremum beside 0, if in the box.
    """

    def at(x: Array) -> Array:
        return np.asarray(sine * (1 - np.cos(x)) + cosine * (x - np.sin(x)))

    low, high = -u[..., : len(sine)], u[..., len(sine) :]
    extremum = np.mod(np.pi - 2 * np.arctan2(sine, cosine), FULL_TURN) - np.pi  # other than 0
    inside = (low <= extremum) & (extremum <= high)
    return np.stack([at(low), at(high), np.zeros_like(low), np.where(inside, at(extremum), 0.0)])


def range_of_bend(sine: Array, cosine: Array, u: Array) -> Array:
    """(..., 2 P) boxes of the values of `bends`."""
    values = bends(sine, cosine, u)
    return np.concatenate([-values.min(0), values.max(0)], axis=-1)
