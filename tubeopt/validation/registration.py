"""Registration of the frame of the measuring device to the plate frame of the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..errors import InputError, choice, finite_array, vector
from ..files.field_metadata import unit
from ..robots.calibration import SavedRegistration
from ..typing import Array

# Methods, and how many numbers each takes from the measured tips.
FREEDOMS = {"rigid": 6, "base-axis": 1, "none": 0, "saved": 0}

# Methods that leave nothing of the plate's pose to be found otherwise.
FITS_PLATE = tuple(name for name, count in FREEDOMS.items() if count == 6)

# Tips that lie within this distance (m, root mean square) of a line leave the rotation about it open: below the noise
# of any sensor, above round-off.
IN_LINE = 1e-6


@dataclass(frozen=True)
class BasePose:
    """Pose of the robot's base in the frame of the device: centre of the plate (m) and axis of the tubes there.

    Raises:
        InputError: not three finite numbers each, or an axis without length.
    """

    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        position = vector("base position", self.position, 3, "x, y and z")
        axis = vector("base axis", self.axis, 3, "x, y and z")
        if not np.linalg.norm(axis):
            raise InputError("base axis is (0, 0, 0); it must have a length")
        object.__setattr__(self, "position", tuple(position.tolist()))
        object.__setattr__(self, "axis", tuple((axis / np.linalg.norm(axis)).tolist()))


# Standard deviations of positions (m) and directions (rad) before they are estimated: those of electromagnetic
# trackers. They only weigh directions against positions in the first fit.
FIRST_GUESS = 1e-3, math.radians(1.0)

# Alternations of fit and noise at most. They converge linearly, and slowly where directions and positions disagree.
ROUNDS = 200

# Base at the origin of the device, axis along its z: data that were brought into place before.
SENSOR_FRAME = BasePose()


@dataclass(frozen=True, eq=False)
class Registration:
    """A rigid motion without scale: plate coordinates are rotation (3, 3) @ device coordinates + translation (3,) m."""

    method: Annotated[str, "method of the registration, device to plate"]
    rotation: Annotated[Array, "rotation matrix, device to plate"]
    translation: Annotated[Array, unit("mm"), "translation, device to plate"]

    def apply(self, points: Array) -> Array:
        """Points (..., 3) of the device in the plate frame, m."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def moved(self, step: Array) -> Registration:
        """Registration after a small step in its freedoms (F,), as the device sees it.

        The plate turns (rad) about its centre, then shifts (m); for base-axis it turns about its own axis.
        """
        if not len(step):
            return self
        turns = [np.array(self.rates(k)[0]) * x for k, x in enumerate(step[:3])]
        increment = scipy.spatial.transform.Rotation.from_rotvec(np.sum(turns, axis=0)).as_matrix()
        # The plate's centre c as the device sees it: R c + t = 0.
        centre = -self.rotation.T @ self.translation + (step[3:] if len(step) > 3 else 0.0)
        rotation = self.rotation @ increment.T
        return Registration(self.method, rotation, -rotation @ centre)

    def rates(self, k: int) -> tuple[Array, Array]:
        """Axis of the turn and direction of the shift in freedom k, in the device's frame."""
        if FREEDOMS[self.method] == 1:
            return self.rotation[2], np.zeros(3)
        axis = np.eye(3)[k % 3]
        return (axis, np.zeros(3)) if k < 3 else (np.zeros(3), axis)

    @classmethod
    def of_saved(cls, saved: SavedRegistration) -> Registration:
        """Registration that is stored in a calibration."""
        return cls("saved", np.array(saved.rotation), np.array(saved.translation))

    def saved(self, recording: str) -> SavedRegistration:
        """Registration for a calibration, with the mark of its recording."""
        rows = tuple(tuple(row) for row in self.rotation.tolist())
        return SavedRegistration(recording, self.method, rows, tuple(self.translation.tolist()))

    @property
    def yaw(self) -> float:
        """Turn about the plate's axis (rad, in (-pi, pi]), the twist that is left when the tilt is undone."""
        # Swing and twist: the parts z and w of the quaternion alone are the turn about z.
        x = scipy.spatial.transform.Rotation.from_matrix(self.rotation).as_quat()
        return math.remainder(2 * math.atan2(x[2], x[3]), 2 * math.pi)

    @property
    def tilt(self) -> float:
        """Angle between the device's z axis and the plate's, rad."""
        return math.atan2(math.hypot(self.rotation[0, 2], self.rotation[1, 2]), self.rotation[2, 2])


@dataclass(frozen=True, eq=False)
class MeasuredDirections:
    """Directions of the tip's sensor (D, 3), measured in the device's frame and predicted in the plate's.

    Unit vectors, weighted by the noise of positions (m) and of directions (rad); None for an estimated noise.
    """

    measured: Array
    predicted: Array
    noise: tuple[float | None, float | None] = (None, None)


@typed
def register(
    measured: ArrayLike,
    predicted: ArrayLike,
    method: str = "rigid",
    *,
    base: BasePose = SENSOR_FRAME,
    directions: MeasuredDirections | None = None,
) -> Registration:
    """The registration with the least sum of squared distances between measured and predicted tips.

    - "rigid": any rotation and translation, by the singular values of the cross-covariance (Kabsch, Acta Cryst. A 32
      (1976); with the sign of Umeyama, IEEE Trans. PAMI 13 (1991), which excludes mirror images; without his scale).
    - "base-axis": `base` is taken to the plate's origin and z axis by the smallest turn, as measured at the base or at
      the straight robot; only the yaw about that axis is fitted, in closed form.
    - "none": device coordinates are plate coordinates.

    Args:
        measured: (N, 3) in the device's frame, m.   predicted: (N, 3) in the plate frame, m.
        directions: of the tip's sensor. Their squares count too, each over the variance of its kind, as in a fit.

    Raises:
        InputError: unknown method, or tips that leave the turn undetermined: on a line (rigid) or on the axis.
    """
    choice("registration", method, [name for name in FREEDOMS if name != "saved"])
    m, p = finite_array("measured", measured, 2), finite_array("predicted", predicted, 2)
    if m.shape != p.shape or m.shape[1] != 3:
        raise InputError(f"measured has shape {m.shape} and predicted {p.shape}; both must be (N, 3)")
    if method == "none":
        return Registration(method, np.eye(3), np.zeros(3))
    solve = _about_axis if method == "base-axis" else _rigid
    d = directions
    registration = solve(m, p, base, None, 0.0)
    if d is None or not len(d.measured):
        return registration
    ratio = (d.noise[0] or FIRST_GUESS[0]) / (d.noise[1] or FIRST_GUESS[1])
    for _ in range(ROUNDS):
        registration, last = solve(m, p, base, d, ratio), ratio
        ratio = _noise_ratio(registration, m, p, d)
        if abs(ratio - last) <= 1e-12 * last:
            break
    return registration


def registered_residuals(measured: Array, predicted: Array) -> Array:
    """(H, K, 3) measured minus predicted tips after the best rigid motion of each set, m, in the frame of the device.

    The motion is that of `register`, for many sets at once. NaN where a prediction is.

    Args:
        measured: (K, 3).   predicted: (H, K, 3); NaN for a tip that is left out.
    """
    seen = np.isfinite(predicted[..., :1])
    count = np.maximum(seen.sum(1, keepdims=True), 1)
    m, p = (np.where(seen, each, 0.0) for each in (measured, predicted))
    m, p = (np.where(seen, each - each.sum(1, keepdims=True) / count, 0.0) for each in (m, p))
    left, _, right = np.linalg.svd(np.einsum("hki,hkj->hij", m, p))
    # The last axis turns where the best match would be a mirror image (Umeyama).
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(np.where(seen, m - p @ (left @ right).transpose(0, 2, 1), np.nan))


def _noise_ratio(registration: Registration, m: Array, p: Array, d: MeasuredDirections) -> float:
    """Noise of positions over noise of directions, m: known, or from the residuals of a registration."""
    left = registration.apply(m) - p, d.measured @ registration.rotation.T - d.predicted
    # A position has three degrees of freedom, a direction two.
    each = [math.sqrt((r**2).sum() / (k * len(r))) for k, r in zip((3, 2), left, strict=True)]
    position, direction = (known or max(estimated, 1e-12) for known, estimated in zip(d.noise, each, strict=True))
    return position / direction


def _rigid(m: Array, p: Array, _: BasePose, d: MeasuredDirections | None, ratio: float) -> Registration:
    """Rigid registration by positions and by directions in units of `ratio`, m."""
    if len(m) < 3:
        raise InputError(f"registration is 'rigid' and there are {len(m)} measurements; it needs at least 3")
    m_mean, p_mean = m.mean(0), p.mean(0)
    model, target = p - p_mean, m - m_mean
    if d is not None:
        model, target = np.vstack([model, ratio * d.predicted]), np.vstack([target, ratio * d.measured])
    # The second singular value is 0 where all tips lie on a line.
    if np.linalg.svd(model, compute_uv=False)[1] <= IN_LINE * math.sqrt(len(p)):
        raise InputError(
            "registration is 'rigid', but the predicted tips lie on a line and do not "
            "determine the rotation about it; measure more configurations, or use base-axis "
            "or none"
        )
    rotation = scipy.spatial.transform.Rotation.align_vectors(model, target)[0].as_matrix()
    return Registration("rigid", rotation, p_mean - rotation @ m_mean)


def _about_axis(
    measured: Array, predicted: Array, base: BasePose, d: MeasuredDirections | None, ratio: float
) -> Registration:
    """Registration with the base at the origin, its axis along z, and the best yaw."""
    from_base = measured - np.array(base.position)
    model, target = [predicted], [from_base]
    if d is not None:
        model, target = [predicted, ratio * d.predicted], [from_base, ratio * d.measured]
    pairs = np.vstack([[0.0, 0.0, 1.0], *model]), np.vstack([base.axis, *target])
    # scipy meets a pair of infinite weight exactly: that of the axes.
    weights = np.append(np.inf, np.ones(len(pairs[0]) - 1))
    rotation = scipy.spatial.transform.Rotation.align_vectors(*pairs, weights=weights)[0].as_matrix()
    # Of all that is matched: |sum of conj(x + iy) (x' + iy')|, since the rotation about the axis is the best one.
    agreement = ((np.vstack(target) @ rotation.T)[:, :2] * np.vstack(model)[:, :2]).sum()
    if agreement <= IN_LINE**2 * len(measured):
        raise InputError(
            "registration is 'base-axis' and all rotations about the axis fit alike, as of tips on the axis; measure "
            "bent configurations, or use none"
        )
    return Registration("base-axis", rotation, -rotation @ np.array(base.position))
