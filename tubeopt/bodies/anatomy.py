"""Anatomy around a robot: distance fields, target and landmarks; bodies in another frame."""

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
from .obstacles import Capsule, HalfSpace, Obstacle, Point3, Sphere, as_points, nearest_distance


@dataclass(frozen=True, eq=False)
class TransformedBody:
    """Body in another frame, which is given in the frame of the body."""

    body: Obstacle
    frame: Frame

    @property
    def SOLID(self) -> bool:  # a constant of other bodies
        """True if distances are exact outside of the body, and no bounds."""
        return bool(getattr(self.body, "SOLID", False))

    @property
    def stands_for(self) -> str:
        """Text that says from what distances to points or an open surface are measured; "" for a solid."""
        return str(getattr(self.body, "stands_for", ""))

    def distance(self, x: Any, y: Any, z: Any) -> Any:
        """Smooth signed distance, m."""
        local = (
            row[0] * x + row[1] * y + row[2] * z + o for row, o in zip(self.frame.axes, self.frame.origin, strict=True)
        )
        return self.body.distance(*local)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Signed distances (...) of points (..., 3), m."""
        return self.body.signed_distance(self.frame.placed(as_points(points)))

    def gradient(self, points: ArrayLike) -> Array:
        """Gradients (..., 3) of the distance at points (..., 3)."""
        return np.asarray(self.body.gradient(self.frame.placed(as_points(points))) @ self.frame.axes)


def _point(frame: Frame, point: ArrayLike) -> Point3:
    return triple("point", frame.seen(point))


def bodies_in_frame(frame: Frame, bodies: Sequence[Obstacle]) -> tuple[Obstacle, ...]:
    """Transform bodies into a frame that is given in their own."""
    return tuple(_seen(frame, body) for body in bodies)


def _seen(frame: Frame, body: Obstacle) -> Obstacle:
    if isinstance(body, Sphere):
        return replace(body, centre=_point(frame, body.centre))
    if isinstance(body, Capsule):
        return replace(body, start=_point(frame, body.start), end=_point(frame, body.end))
    if isinstance(body, HalfSpace):
        return HalfSpace(_point(frame, body.point), triple("normal", np.array(body.normal) @ frame.axes))
    if isinstance(body, Corridor):
        return replace(body, centreline=tuple(_point(frame, point) for point in body.centreline))
    if isinstance(body, MeshObstacle):
        return replace(body, vertices=tuple(map(tuple, frame.seen(body.vertices).tolist())))
    if isinstance(body, DistanceField):
        return body.in_frame(frame)
    return TransformedBody(body, frame)


@dataclass(frozen=True, eq=False)
class Anatomy(Displayed):
    """Surroundings of the robot in the frame of its plate, m."""

    bodies: tuple[Obstacle, ...] = ()
    """Bodies that the arm avoids; a lumen is represented by its outside."""
    target: Array | None = None
    """Points (N, 3) of a region for the tip, those with the largest clearance first; None without one."""
    landmarks: Mapping[str, Array] = field(default_factory=dict)
    """Landmarks (3,), m, by name."""
    base: Frame = field(default_factory=Frame)
    """Pose of the plate in the patient, RAS."""
    registration_error: float = 0.0
    """RMS error of the landmarks of the registration, m; 0 without one."""
    registration: Registration | None = None
    """Registration of the plate, with its standard errors; None without."""

    @property
    def fields(self) -> tuple[DistanceField, ...]:
        """Bodies that are distance fields."""
        return tuple(body for body in self.bodies if isinstance(body, DistanceField))

    def position(self, name: str) -> Array:
        """Position of a landmark (3,), m, or points of the target (N, 3), m, for a goal of the tip.

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
            listed = f"they are {', '.join(known)}" if known else "it has no landmarks"
            raise InputError(f"{name!r} is not a landmark of the anatomy; {listed}{nearest(name, known)}")
        return self.landmarks[name]


def anatomy_in_frame(
    fields: Sequence[DistanceField],
    base: Frame,
    *,
    target: Array | None = None,
    landmarks: Mapping[str, Array] | None = None,
    registration: Registration | None = None,
) -> Anatomy:
    """Build the anatomy in the frame of a base plate, from fields and positions in the axes of the patient.

    Raises:
        InputError: a target without a free voxel.
    """
    bodies = tuple(body.in_frame(base) for body in fields)
    points = None
    if target is not None:
        points = base.seen(target)
        clearance = nearest_distance(bodies, points)
        if not (clearance > 0).any():
            raise InputError(
                "no voxel of the target is proved free: the largest proved distance from "
                f"obstacles is {clearance.max() * 1e3:.3g} mm; the target lies inside an obstacle "
                "or in a passage of one voxel"
            )
        points = points[np.argsort(-clearance, kind="stable")][: int((clearance > 0).sum())]
    known = {name: base.seen(point) for name, point in (landmarks or {}).items()}
    if points is not None and "target" in known:
        raise InputError(
            "'target' is both a landmark and the target region; rename the landmark (in a "
            ".txt file the file name is its name), or remove the region"
        )
    error = 0.0 if registration is None else registration.rms
    return Anatomy(bodies, points, known, base, error, registration)


def centres(image: LabelImage, chosen: Mask) -> Array:
    """Centres (N, 3) of chosen voxels in the axes of the patient, m."""
    return image.frame.placed(np.argwhere(chosen) * image.spacing)
