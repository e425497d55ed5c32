"""The anatomy around a robot: distance fields, a target and landmarks, and bodies as another frame sees them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, nearest, triple
from ..typing import Array, Mask
from .corridors import Corridor, MeshObstacle
from .distance_field import DistanceField
from .frames import Frame, Registration
from .images import LabelImage
from .obstacles import Capsule, HalfSpace, Obstacle, Sphere, as_points, nearest_distance


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


@dataclass(frozen=True, eq=False)
class Anatomy(Displayed):
    """Surroundings of the robot in the frame of its plate, m."""

    bodies: tuple[Obstacle, ...] = ()
    """Bodies that the arm avoids; a lumen is represented by its outside."""
    target: Array | None = None
    """(N, 3) places of a region for the tip, those with most room first; None without one."""
    landmarks: Mapping[str, Array] = field(default_factory=dict)
    """Landmarks (3,), m, by name."""
    base: Frame = field(default_factory=Frame)
    """Pose of the plate in the patient, RAS."""
    registration_error: float = 0.0
    """Root of the mean square error of the landmarks that it was found from, m; 0 without."""
    registration: Registration | None = None
    """Registration of the plate, with its standard errors; None without."""

    @property
    def fields(self) -> tuple[DistanceField, ...]:
        """Bodies that are distance fields."""
        return tuple(body for body in self.bodies if isinstance(body, DistanceField))

    def place(self, name: str) -> Array:
        """(3,) or, of the target, (N, 3): what a goal of the tip may name.

        Raises:
            InputError: no landmark of this name, or no target.
        """
        if name == "target" and self.target is not None:
            return self.target
        return self.landmark(name)

    def landmark(self, name: str) -> Array:
        """(3,) position of a landmark, m; raises InputError for an unknown name."""
        if name not in self.landmarks:
            known = [*self.landmarks, *(["target"] if self.target is not None else [])]
            there = f"they are {', '.join(known)}" if known else "it has no landmarks"
            raise InputError(f"{name!r} is not a landmark of the anatomy; {there}{nearest(name, known)}")
        return self.landmarks[name]


def anatomy_seen(
    fields: Sequence[DistanceField],
    base: Frame,
    *,
    target: Array | None = None,
    landmarks: Mapping[str, Array] | None = None,
    registration: Registration | None = None,
) -> Anatomy:
    """Anatomy in the frame of a plate at `base`, from fields and positions in the axes of the patient.

    Raises:
        InputError: a target without a free voxel.
    """
    bodies = tuple(each.in_frame(base) for each in fields)
    places = None
    if target is not None:
        places = base.seen(target)
        room = nearest_distance(bodies, places)
        if not (room > 0).any():
            raise InputError(
                "no voxel of the target is proved free: the largest proved distance from "
                f"obstacles is {room.max() * 1e3:.3g} mm; the target lies inside an obstacle "
                "or in a passage of one voxel"
            )
        places = places[np.argsort(-room, kind="stable")][: int((room > 0).sum())]
    known = {name: base.seen(place) for name, place in (landmarks or {}).items()}
    if places is not None and "target" in known:
        raise InputError(
            "'target' is both a landmark and the target region; rename the landmark (in a "
            ".txt file the file name is its name), or remove the region"
        )
    error = 0.0 if registration is None else registration.rms
    return Anatomy(bodies, places, known, base, error, registration)


def centres(image: LabelImage, chosen: Mask) -> Array:
    """(N, 3) centres of voxels in the axes of the patient, m."""
    return image.frame.placed(np.argwhere(chosen) * image.spacing)
