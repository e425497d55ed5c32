"""Planes along which bodies are cut open to look into them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, vector
from ..typing import Array
from .frames import Frame

FLAT = 1e-6
"""Sine of the angle between two ways from which on they span a plane."""


@dataclass(frozen=True, eq=False)
class Plane(Displayed):
    """A plane.

    Raises:
        InputError: no three finite numbers, a normal of length 0.
    """

    point: Array
    """(3,) any of it, m."""
    normal: Array
    """(3,) of any length but 0; kept with length 1."""

    def __post_init__(self) -> None:
        normal = vector("normal of the plane", self.normal, 3, "x, y, z")
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise InputError("normal of the plane is 0, 0, 0; it must have a direction")
        object.__setattr__(self, "point", vector("point of the plane", self.point, 3, "x, y, z in m"))
        object.__setattr__(self, "normal", normal / length)

    @classmethod
    def through(cls, a: ArrayLike, b: ArrayLike, c: ArrayLike) -> Plane:
        """The plane that holds three points (3,), m; raises InputError where they lie on one line."""
        one, second, third = (vector("point of the plane", each, 3, "x, y, z in m") for each in (a, b, c))
        normal = np.cross(second - one, third - one)
        if not np.linalg.norm(normal) > FLAT * np.linalg.norm(second - one) * np.linalg.norm(third - one):
            raise InputError("the three points of the plane lie on one line; give other points, or a normal")
        return cls(one, normal)

    def height(self, points: ArrayLike) -> Array:
        """(...) how far points (..., 3) lie beyond the plane along its normal, m."""
        return np.asarray((np.asarray(points, dtype=float) - self.point) @ self.normal)

    @property
    def frame(self) -> Frame:
        """In the plane, its z the normal; its y as near to the z of the plate as can be, for a plane square to that to
        the plate's y."""
        up = np.array([0.0, 0.0, 1.0]) if abs(self.normal[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, self.normal)
        right /= np.linalg.norm(right)
        return Frame(np.column_stack([right, np.cross(self.normal, right), self.normal]), self.point)

    def seen_from(self, frame: Frame) -> Plane:
        """The same plane as a frame has it."""
        return Plane(frame.seen(self.point), self.normal @ frame.axes)
