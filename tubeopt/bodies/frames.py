"""Where a robot stands in a patient: rigid frames, given by an entry and a direction or by landmarks measured twice.

A patient's axes are RAS, to the right, to the front and up, as NIfTI has them; LPS, as DICOM has them, points to the
left and to the back. Lengths are in m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, choice, finite, vector
from ..typing import Array
from .certainty import MOST, NARROW, RegistrationError, landmark_error

AXES = ("RAS", "LPS")
"""Ways of writing positions in a patient."""

FEWEST = 3
"""Landmarks that fix a frame."""

FLAT = 1e-3
"""Share of their size by which landmarks must lie off a line."""


DOUBT = 0.5e-3
"""Standard deviation (m) of a coordinate of landmarks, as careful hands and trackers reach it."""

NEGLIGIBLE = 1e-6
"""Uncertainty of a place (m) that no clearance need cover."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A right-handed frame: origin and axes."""

    axes: Array = field(default_factory=lambda: np.eye(3))
    """(3, 3) its axes are the columns."""
    origin: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) origin, m."""

    def placed(self, points: ArrayLike) -> Array:
        """(..., 3) where points (..., 3) of this frame lie in the one that it is given in."""
        return np.asarray(points, dtype=float) @ self.axes.T + self.origin

    def seen(self, points: ArrayLike) -> Array:
        """(..., 3) points (..., 3) of the frame that it is given in, as this one has them."""
        return np.asarray((np.asarray(points, dtype=float) - self.origin) @ self.axes)

    @property
    def inverse(self) -> Frame:
        """The frame that this one is given in, as this one has it."""
        return Frame(self.axes.T, self.seen(np.zeros(3)))

    def of(self, inner: Frame) -> Frame:
        """A frame that is given in the same one as this, as this one has it."""
        return Frame(self.axes.T @ inner.axes, self.seen(inner.origin))


def ras(points: ArrayLike, axes: str) -> Array:
    """(..., 3) points in RAS, written in RAS or LPS."""
    choice("axes", axes, AXES)
    return np.asarray(points, dtype=float) * ([1.0, 1.0, 1.0] if axes == "RAS" else [-1.0, -1.0, 1.0])


def base_frame(position: ArrayLike, direction: ArrayLike, roll: float = 0.0) -> Frame:
    """The plate's frame in a patient: at a position (3,), m, its z along a direction, turned about that by `roll`, rad.

    Without roll its x is as close as it can be to the patient's x, or to y where the direction is along x.

    Raises:
        InputError: numbers that are not finite, a direction of no length.
    """
    z = vector("direction of the base", direction, 3, "x, y, z")
    length = float(np.linalg.norm(z))
    if length == 0:
        raise InputError("direction of the base is 0, 0, 0; it must point somewhere")
    z = z / length
    beside = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    x = beside - (beside @ z) * z
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(finite("roll of the base", roll)), np.sin(roll)
    return Frame(
        np.column_stack([c * x + s * y, c * y - s * x, z]), vector("position of the base", position, 3, "x, y, z")
    )


def roll_of(frame: Frame) -> float:
    """The roll, rad, with which `base_frame` makes a frame from its origin and its z."""
    plain = base_frame(frame.origin, frame.axes[:, 2]).axes
    return float(np.arctan2(plain[:, 1] @ frame.axes[:, 0], plain[:, 0] @ frame.axes[:, 0]))


@dataclass(frozen=True, eq=False)
class Registration:
    """A frame found from landmarks."""

    frame: Frame
    """The plate's in the patient."""
    errors: dict[str, float]
    """How far each landmark is off with it, m."""
    known: RegistrationError
    """Standard errors of the plate's place, as far as what the landmarks are off tells them."""
    doubt: RegistrationError
    """The same where every coordinate of the landmarks is known to DOUBT."""

    @property
    def rms(self) -> float:
        """Root of the mean square of the errors, m: the fiducial registration error."""
        return float(np.sqrt(np.mean(np.square(list(self.errors.values())))))

    @property
    def exact(self) -> bool:
        """Whether landmarks away from a line fit so well that nothing need be said of what is left."""
        return self.known.reach < NEGLIGIBLE and self.known.narrow > NARROW

    @property
    def statement(self) -> str:
        """How well the plate's place is known, in words."""
        known, turn = self.known, math.degrees(self.known.turn)
        words = (
            f"registration by {len(self.errors)} landmarks has an error of {self.rms * 1e3:.2g} mm (root of the mean "
            f"square). Standard errors of the plate: {turn:.2g} deg about every axis, and {known.reach * 1e3:.2g} mm "
            "at the distance of the farthest landmark. No proof includes this error; let the clearance cover it"
        )
        if known.mirrored is not None:
            words += (
                f"; a mirror image of them fits better ({known.mirrored * 1e3:.2g} mm off): has an axis the wrong sign?"
            )
        if known.narrow <= NARROW:
            words += (
                f"; the landmarks lie near to a line, so that errors of {DOUBT * 1e3:g} mm turn the plate by "
                f"{math.degrees(self.doubt.turn):.2g} deg: measure one that is farther off the line"
            )
        elif known.turn > MOST:
            words += "; the landmarks are too near to one another, or too far from those of the patient"
        return words


def register(patient: Mapping[str, ArrayLike], plate: Mapping[str, ArrayLike]) -> Registration:
    """Rigid motion from landmarks measured at the plate to their positions in the patient, m.

    Least squares (Arun, Huang and Blostein 1987; Umeyama 1991).

    Raises:
        InputError: names in one set only, or fewer than three landmarks. All of them on a line, or so near to one that
            the standard error of the rotation about it may exceed 5 deg (95 %).
    """
    names = list(plate)
    missing = [name for name in names if name not in patient]
    if missing:
        known = ", ".join(patient) or "none"
        raise InputError(f"landmark {missing[0]!r} is measured from the plate only; the patient has {known}")
    if len(names) < FEWEST:
        raise InputError(f"registration has {len(names)} landmarks; it must have at least {FEWEST}")
    there = np.array([vector(f"landmark {name!r}", patient[name], 3, "x, y, z") for name in names])
    here = np.array([vector(f"landmark {name!r}", plate[name], 3, "x, y, z") for name in names])
    for what, points in (("in the patient", there), ("from the plate", here)):
        spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
        if spread[1] <= FLAT * max(spread[0], 1e-300):
            raise InputError(f"landmarks {what} lie on a line; at least one must be off it")
    u, _, v = np.linalg.svd((here - here.mean(0)).T @ (there - there.mean(0)))
    turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    frame = Frame(turn, there.mean(0) - turn @ here.mean(0))
    seen = frame.seen(there)
    off = np.linalg.norm(seen - here, axis=1)
    errors = dict(zip(names, off.tolist(), strict=True))
    found = Registration(frame, errors, landmark_error(here, seen), landmark_error(here, seen, DOUBT))
    if found.known.too_large:
        turn = math.degrees(found.known.turn * found.known.doubtful)
        known = "not at all" if math.isinf(turn) else f"to {turn:.0f} deg only"
        raise InputError(
            "the landmarks lie near a line and determine the rotation of the base plate "
            f"about it {known} (95 % limit of the standard error). It must be at most "
            f"{math.degrees(MOST):g} deg; the RMS error is {found.rms * 1e3:.2g} mm; measure "
            "a landmark farther from the line"
        )
    return found
