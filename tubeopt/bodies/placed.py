"""Bodies as another frame sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import triple
from ..typing import Array
from .corridors import Corridor, MeshObstacle
from .distance_field import DistanceField
from .frames import Frame
from .obstacles import Capsule, HalfSpace, Obstacle, Sphere, as_points


@dataclass(frozen=True, eq=False)
class Turned:
    """A body that is written along the axes of one frame, seen from another, which is given in the first."""

    body: Obstacle
    frame: Frame

    @property
    def SOLID(self) -> bool:  # as other bodies have it
        """Whether distances are those of the body, no bounds of them."""
        return bool(getattr(self.body, "SOLID", False))

    @property
    def stands_for(self) -> str:
        """What the distance is from, in words, where the body is no solid."""
        return str(getattr(self.body, "stands_for", ""))

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance, m."""
        own = (
            row[0] * x + row[1] * y + row[2] * z + o for row, o in zip(self.frame.axes, self.frame.origin, strict=True)
        )
        return self.body.distance(*own)

    def signed_distance(self, points: ArrayLike) -> Array:
        """(...) distance of points (..., 3), m."""
        return self.body.signed_distance(self.frame.placed(as_points(points)))

    def gradient(self, points: ArrayLike) -> Array:
        """(..., 3) unit vectors along which the distance grows."""
        return np.asarray(self.body.gradient(self.frame.placed(as_points(points))) @ self.frame.axes)


def _point(frame: Frame, place: ArrayLike) -> tuple[float, float, float]:
    return triple("place", frame.seen(place))


def seen_from(frame: Frame, bodies: Sequence[Obstacle]) -> tuple[Obstacle, ...]:
    """Bodies as a frame sees them that is given in their own."""
    return tuple(_seen(frame, body) for body in bodies)


def _seen(frame: Frame, body: Obstacle) -> Obstacle:
    if isinstance(body, Sphere):
        return replace(body, centre=_point(frame, body.centre))
    if isinstance(body, Capsule):
        return replace(body, start=_point(frame, body.start), end=_point(frame, body.end))
    if isinstance(body, HalfSpace):
        return HalfSpace(_point(frame, body.point), triple("normal", np.array(body.normal) @ frame.axes))
    if isinstance(body, Corridor):
        return replace(body, centreline=tuple(_point(frame, place) for place in body.centreline))
    if isinstance(body, MeshObstacle):
        return replace(body, vertices=tuple(map(tuple, frame.seen(body.vertices).tolist())))
    if isinstance(body, DistanceField):
        return body.in_frame(frame)
    return Turned(body, frame)
