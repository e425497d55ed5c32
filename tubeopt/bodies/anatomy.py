"""The anatomy around a robot: distance fields, a target and landmarks, as the robot's plate has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..display import Displayed
from ..errors import InputError, nearest
from ..typing import Array, Mask
from .distance_field import DistanceField
from .frames import Frame, Registration
from .images import LabelImage
from .obstacles import Obstacle, nearest_distance


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
