"""Frames of the base plate in a patient, from an entry and a direction or by registration of landmarks, with errors.

The axes of a patient are RAS (right, anterior, superior), as in NIfTI. LPS, as in DICOM, points to the left and to the
back. Lengths are in m.

Some files state their axes: SPACE=LPS in headers and comments, as 3D Slicer writes them. STL has it in its header, PLY,
OBJ, OFF and CSV in comments, VTK in its second line, Slicer's .fcsv as `# CoordinateSystem = LPS` (0 for RAS and 1
for LPS in old ones), and .mrk.json under `coordinateSystem`.

Errors of a registration: the rotation minimises  sum_v w_v |R m_v + t - p_v|^2. Its second derivative by a rotation
vector, with the optimal translation, is  H = tr(S) I - S  with  S = sum_v w_v (R m_v - mean)(p_v - mean)'  (symmetric
at the minimum). It includes the curvature by residuals. H is singular or indefinite for points on a line, or if the
residuals are as large as the spread across it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, choice, finite, vector
from ..files.field_metadata import unit
from ..files.files import read_bytes
from ..typing import Array

# Axes of positions in a patient.
AXES = ("RAS", "LPS")

# Smallest number of landmarks that determine a frame.
MIN_LANDMARKS = 3

# Smallest spread of landmarks across a line over that along it: below, the error of the rotation about the line is more
# than 1000 times their relative error.
FLAT = 1e-3


# Standard deviation (m) of a coordinate of a landmark for a careful operator with a tracker, if a file states none.
TYPICAL_NOISE = 0.5e-3

# Negligible uncertainty of a position (m): it is below the tolerance of milling and measuring.
NEGLIGIBLE = 1e-6


@dataclass(frozen=True, eq=False)
class Frame:
    """Right-handed frame."""

    axes: Array = field(default_factory=lambda: np.eye(3))
    """Axes as columns (3, 3)."""
    origin: Array = field(default_factory=lambda: np.zeros(3))
    """Origin (3,) of the frame, m."""

    def placed(self, points: ArrayLike) -> Array:
        """Transform points (..., 3) from this frame to its parent frame."""
        return np.asarray(points, dtype=float) @ self.axes.T + self.origin

    def seen(self, points: ArrayLike) -> Array:
        """Transform points (..., 3) from the parent frame to this frame."""
        return np.asarray((np.asarray(points, dtype=float) - self.origin) @ self.axes)

    @property
    def inverse(self) -> Frame:
        """Parent frame, given in this frame."""
        return Frame(self.axes.T, self.seen(np.zeros(3)))

    def of(self, inner: Frame) -> Frame:
        """Transform a frame from the common parent frame to this frame."""
        return Frame(self.axes.T @ inner.axes, self.seen(inner.origin))


def ras(points: ArrayLike, axes: str) -> Array:
    """Convert points (..., 3) from RAS or LPS to RAS."""
    choice("axes", axes, AXES)
    return np.asarray(points, dtype=float) * ([1.0, 1.0, 1.0] if axes == "RAS" else [-1.0, -1.0, 1.0])


def base_frame(position: ArrayLike, direction: ArrayLike, roll: float = 0.0) -> Frame:
    """Frame of the base plate at a position (3,), m, with z along a direction, rotated about it by `roll`, rad.

    Without roll, x is as close as possible to the patient's x, or to y if the direction is along x.

    Raises:
        InputError: numbers that are not finite, a direction of no length.
    """
    z = vector("direction of the base", direction, 3, "x, y, z")
    length = float(np.linalg.norm(z))
    if length == 0:
        raise InputError("direction of the base is 0, 0, 0; it must point somewhere")
    z = z / length
    reference = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    x = reference - (reference @ z) * z
    x = x / np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(finite("roll of the base", roll)), np.sin(roll)
    return Frame(
        np.column_stack([c * x + s * y, c * y - s * x, z]), vector("position of the base", position, 3, "x, y, z")
    )


def roll_of(frame: Frame) -> float:
    """Roll, rad, that makes `base_frame` return a frame for its origin and its z."""
    plain = base_frame(frame.origin, frame.axes[:, 2]).axes
    return float(np.arctan2(plain[:, 1] @ frame.axes[:, 0], plain[:, 0] @ frame.axes[:, 0]))


@dataclass(frozen=True, eq=False)
class Registration:
    """Registration of the base plate by landmarks."""

    frame: Frame
    """Frame of the base plate in the patient."""
    errors: dict[str, float]
    """Residual of each landmark, m."""
    known: RegistrationError
    """Standard errors, with the noise estimated from the residuals."""
    doubt: RegistrationError
    """Standard errors, with the noise TYPICAL_NOISE of every coordinate."""

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, m: the fiducial registration error."""
        return float(np.sqrt(np.mean(np.square(list(self.errors.values())))))

    @property
    def exact(self) -> bool:
        """True if the residuals are negligible and the landmarks are not near to a line."""
        return self.known.reach < NEGLIGIBLE and self.known.narrow > NARROW

    @property
    def statement(self) -> str:
        """Sentence on the accuracy of the registration."""
        known, turn = self.known, math.degrees(self.known.turn)
        text = (
            f"registration by {len(self.errors)} landmarks has an error of {self.rms * 1e3:.2g} mm (root of the mean "
            f"square). Standard errors of the plate: {turn:.2g} deg about every axis, and {known.reach * 1e3:.2g} mm "
            "at the distance of the farthest landmark. No proof includes this error; let the clearance cover it"
        )
        if known.mirrored is not None:
            text += (
                f"; a mirror image of them fits better ({known.mirrored * 1e3:.2g} mm off): has an axis the wrong sign?"
            )
        if known.narrow <= NARROW:
            text += (
                f"; the landmarks lie near to a line, so that errors of {TYPICAL_NOISE * 1e3:g} mm turn the plate by "
                f"{math.degrees(self.doubt.turn):.2g} deg: measure one that is farther off the line"
            )
        elif known.turn > MAX_ROTATION_ERROR:
            text += "; the landmarks are too near to one another, or too far from those of the patient"
        return text


def register(patient: Mapping[str, ArrayLike], plate: Mapping[str, ArrayLike]) -> Registration:
    """Register the base plate: rigid motion from landmarks in its frame to their positions in the patient, m.

    Least squares (Arun, Huang and Blostein 1987; Umeyama 1991).

    Raises:
        InputError: landmarks that the patient does not have, fewer than three, or all on a line. Also if they are so
            near to a line that the standard error of the rotation about it may exceed 5 deg (95 %).
    """
    names = list(plate)
    missing = [name for name in names if name not in patient]
    if missing:
        known = ", ".join(patient) or "none"
        raise InputError(f"landmark {missing[0]!r} is measured from the plate only; the patient has {known}")
    if len(names) < MIN_LANDMARKS:
        raise InputError(f"registration has {len(names)} landmarks; it must have at least {MIN_LANDMARKS}")
    p = np.array([vector(f"landmark {name!r}", patient[name], 3, "x, y, z") for name in names])
    m = np.array([vector(f"landmark {name!r}", plate[name], 3, "x, y, z") for name in names])
    for what, points in (("in the patient", p), ("from the plate", m)):
        spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
        if spread[1] <= FLAT * max(spread[0], 1e-300):
            raise InputError(f"landmarks {what} lie on a line; at least one must be off it")
    # The rotation R maximises tr(R M) with the covariance M = U S V'; the sign excludes a reflection.
    u, _, v = np.linalg.svd((m - m.mean(0)).T @ (p - p.mean(0)))
    R = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    frame = Frame(R, p.mean(0) - R @ m.mean(0))
    p_plate = frame.seen(p)
    residuals = np.linalg.norm(p_plate - m, axis=1)
    errors = dict(zip(names, residuals.tolist(), strict=True))
    registration = Registration(frame, errors, landmark_error(m, p_plate), landmark_error(m, p_plate, TYPICAL_NOISE))
    if registration.known.too_large:
        angle = math.degrees(registration.known.turn * registration.known.doubtful)
        known = "not at all" if math.isinf(angle) else f"to {angle:.0f} deg only"
        raise InputError(
            "the landmarks lie near a line and determine the rotation of the base plate "
            f"about it {known} (95 % limit of the standard error). It must be at most "
            f"{math.degrees(MAX_ROTATION_ERROR):g} deg; the RMS error is {registration.rms * 1e3:.2g} mm; measure "
            "a landmark farther from the line"
        )
    return registration


# Standard error of the rotation above which a registration is refused: at 100 mm, 5 deg are 9 mm.
MAX_ROTATION_ERROR = math.radians(5.0)

# Spread across a line over spread along it, below which points are near to the line: the rotation about it is then ten
# times less certain.
NARROW = 0.1

# Residual of the best mirror image over that of the registration, below which it is worth a remark: for nearly plane
# points both are about equal.
MIRRORED = 0.7

# Residual over the spread of the points, below which it is round-off, and irrelevant for a mirror image.
EXACT = 1e-6

# Smallest eigenvalue of H over its trace, below which the rotation is undetermined: H is then singular to round-off.
OPEN = 1e-9


@dataclass(frozen=True)
class RegistrationError:
    """Standard errors of a registration."""

    turn: Annotated[float, unit("deg"), "standard error of the rotation about the worst axis"]
    """Infinite if the data do not determine it."""
    reach: Annotated[float, unit("mm"), "standard error of a point at the arm's length from the plate"]
    """Largest over all directions; for landmarks, at the distance of the farthest one."""
    narrow: float
    """Spread of the points across their nearest line over the spread along it."""
    mirrored: float | None = None
    """RMS distance to the best mirror image, m, if that is clearly smaller; otherwise None."""
    doubtful: float = 1.0
    """Largest factor (95 %) on the standard errors: few residuals determine them."""

    @property
    def too_large(self) -> bool:
        """True if the points are near to a line and the rotation about it is too uncertain."""
        return self.turn * self.doubtful > MAX_ROTATION_ERROR and self.narrow <= NARROW


def turn_curvature(measured: Array, known: Array, weight: Array, turns: Array) -> Array | None:
    """Second derivative H (k, k) by rotations about axes (k, 3); None if a rotation is undetermined.

    Args:
        measured: measured points (V, 3), relative to their mean.
        known: their positions (V, 3), relative to their mean.
        weight: weights (V,).
        turns: axes (k, 3).
    """
    S = np.einsum("v,vi,vj->ij", weight, measured, known)
    H = turns @ (np.trace(S) * np.eye(3) - (S + S.T) / 2) @ turns.T
    smallest, scale = np.linalg.eigvalsh(H)[0], max(float(np.trace(H)), 1e-300)
    return None if smallest <= OPEN * scale else H


def narrowness(points: Array) -> float:
    """Spread of points (V, 3) across their nearest line over the spread along it."""
    along = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return float(along[1] / max(along[0], 1e-300)) if len(along) > 1 else 0.0


def standard_errors(covariance: Array, turns: Array, centre: Array, length: float) -> tuple[float, float]:
    """Largest standard errors of the rotation, rad, and of a point at the distance `length` from the plate, m."""
    n = len(turns)
    about = turns.T @ covariance[:n, :n] @ turns
    reach = 0.0
    for point in length * np.vstack([np.eye(3), -np.eye(3)]):
        x, y, z = point - centre
        cross = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])  # displacement by a small rotation
        change = np.hstack([cross @ turns.T, np.eye(3)])
        reach = max(reach, float(np.linalg.eigvalsh(change @ covariance @ change.T)[-1]))
    return math.sqrt(max(np.linalg.eigvalsh(about)[-1], 0.0)), math.sqrt(reach)


def mirrored(measured: Array, known: Array, rms: float) -> float | None:
    """RMS distance to the best mirror image, m, if it is clearly below the residual `rms`; otherwise None."""
    u, v = measured - measured.mean(0), known - known.mean(0)
    size = np.linalg.svd(u.T @ v)[1]
    sign = np.sign(np.linalg.det(u.T @ v))
    best = (u**2).sum() + (v**2).sum() - 2 * (size[0] + size[1] - sign * size[2])
    distance, spread = math.sqrt(max(float(best), 0.0) / len(u)), math.sqrt(float((u**2).sum()) / len(u))
    return distance if distance < MIRRORED * rms and rms > EXACT * spread else None


def landmark_error(measured: Array, known: Array, noise: float | None = None) -> RegistrationError:
    """Standard errors of a registration by landmarks.

    The errors of landmarks are assumed to be independent and equal in all directions. A common error of all landmarks
    moves the plate and cannot be detected.

    Args:
        measured: landmarks (N, 3) measured in the frame of the plate, m.
        known: positions (N, 3) in the patient, in the frame of the plate after the registration, m.
        noise: standard deviation of each coordinate, m; by default estimated with 3 N - 6 degrees of freedom.
    """
    count, centre, doubtful = len(measured), known.mean(0), 1.0
    narrow, rms = narrowness(measured), math.sqrt(((measured - known) ** 2).sum() / count)
    if noise is None:
        freedom = max(3 * count - 6, 1)
        noise = rms * math.sqrt(count / freedom)
        doubtful = math.sqrt(freedom / scipy.stats.chi2.ppf(0.05, freedom))
    hessian = turn_curvature(measured - measured.mean(0), known - centre, np.ones(count), np.eye(3))
    if hessian is None:
        return RegistrationError(math.inf, math.inf, narrow, mirrored(measured, known, rms))
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = np.linalg.inv(hessian), np.eye(3) / count
    length = float(np.linalg.norm(measured, axis=1).max())
    turn, reach = standard_errors(noise**2 * covariance, np.eye(3), centre, length)
    return RegistrationError(turn, reach, narrow, mirrored(measured, known, rms), doubtful)


# Statements of axes. SPACE in other spellings needs a known word, since "space" is a common word.
STATED = re.compile(
    rb"""\bSPACE=([A-Za-z0-9-]+)|(?i:\bCoordinateSystem)["']?\s*[=:]\s*["']?([A-Za-z0-9-]+)|"""
    rb"""(?i:\bspace\s*[=:]\s*(ras|lps|right-anterior-superior|left-posterior-superior)\b)"""
)

# Words in files -> axes.
WORDS = {
    "ras": "RAS", "right-anterior-superior": "RAS", "0": "RAS",
    "lps": "LPS", "left-posterior-superior": "LPS", "1": "LPS",
}  # fmt: skip

# Length of the start of a file that may contain the statement, bytes.
HEAD = 4096

# Length of the header of a binary STL file, bytes.
STL_HEADER = 80

# Starts of comment lines, by file format.
COMMENTS = {".ply": b"comment obj_info", ".obj": b"#", ".off": b"#", ".csv": b"#", ".fcsv": b"#", ".txt": b"#"}


def stated_axes(path: str | PathLike[str]) -> str | None:
    """Axes that a file states, RAS or LPS; None if it states none.

    Raises:
        InputError: no such file, unknown axes, or both.
    """
    names = {"".join(part.decode() for part in parts).lower() for parts in STATED.findall(_statements(path))}
    unknown = sorted(names - WORDS.keys())
    if unknown:
        raise InputError(f"{path}: it states the axes {unknown[0]!r}; they must be {' or '.join(AXES)}")
    known = sorted({WORDS[word] for word in names})
    if len(known) > 1:
        raise InputError(f"{path}: it states two kinds of axes, {' and '.join(known)}; it must state one")
    return known[0] if known else None


def _statements(path: str | PathLike[str]) -> bytes:
    """Parts of a file that may state its axes."""
    suffix, content = Path(path).suffix.lower(), read_bytes(path)
    if suffix == ".json":
        return content
    if suffix == ".stl" and not content[:STL_HEADER].lstrip().lower().startswith(b"solid"):
        return content[:STL_HEADER]
    head = content[:HEAD]
    if suffix == ".stl":  # text, or a binary file whose header begins as that of a text file
        return head.split(b"\n", 1)[0][:HEAD]
    if suffix == ".vtk":
        return b"\n".join(head.split(b"\n")[:2])
    starts = tuple(COMMENTS.get(suffix, b"").split())
    if not starts:
        return b""
    return b"\n".join(line for line in head.splitlines() if line.lstrip().startswith(starts))


def file_axes(path: str | PathLike[str], axes: str | None) -> str | None:
    """Axes of a file, RAS or LPS: those that it states, otherwise those in `axes`.

    Raises:
        InputError: as `stated_axes`; axes that contradict those in the file.
    """
    stated = stated_axes(path)
    if stated is not None and axes is not None and stated != axes:
        raise InputError(f"{path}: axes is {axes}, but the file states {stated}; leave axes out, or correct the file")
    return stated or axes


def required_axes(path: str | PathLike[str], axes: str | None) -> str:
    """Axes of a file as `file_axes`; raises InputError if they are unknown."""
    known = file_axes(path, axes)
    if known is None:
        raise InputError(
            f"{path}: the file does not state its axes, and none are given; give axes: RAS (x to the right, y to the "
            "front) or axes: LPS (x to the left, y to the back)"
        )
    return known


# Smallest sine of the angle between two vectors that span a plane: its normal is then known to 1e-10.
COLLINEAR = 1e-6


@dataclass(frozen=True, eq=False)
class Plane(Displayed):
    """Plane in space.

    Raises:
        InputError: no three finite numbers, a normal of length 0.
    """

    point: Array
    """Any point of the plane (3,), m."""
    normal: Array
    """Normal (3,); scaled to length 1."""

    def __post_init__(self) -> None:
        normal = vector("normal of the plane", self.normal, 3, "x, y, z")
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise InputError("normal of the plane is 0, 0, 0; it must have a direction")
        object.__setattr__(self, "point", vector("point of the plane", self.point, 3, "x, y, z in m"))
        object.__setattr__(self, "normal", normal / length)

    @classmethod
    def through(cls, a: ArrayLike, b: ArrayLike, c: ArrayLike) -> Plane:
        """Plane through three points (3,), m; raises InputError if they lie on one line."""
        first, second, third = (vector("point of the plane", point, 3, "x, y, z in m") for point in (a, b, c))
        normal = np.cross(second - first, third - first)
        if not np.linalg.norm(normal) > COLLINEAR * np.linalg.norm(second - first) * np.linalg.norm(third - first):
            raise InputError("the three points of the plane lie on one line; give other points, or a normal")
        return cls(first, normal)

    def height(self, points: ArrayLike) -> Array:
        """Signed distances (...) of points (..., 3) from the plane along its normal, m."""
        return np.asarray((np.asarray(points, dtype=float) - self.point) @ self.normal)

    @property
    def frame(self) -> Frame:
        """Frame in the plane with z along the normal.

        Its y is as close as possible to the z of the base frame, or to its y if z is the normal.
        """
        up = np.array([0.0, 0.0, 1.0]) if abs(self.normal[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, self.normal)
        right /= np.linalg.norm(right)
        return Frame(np.column_stack([right, np.cross(self.normal, right), self.normal]), self.point)

    def seen_from(self, frame: Frame) -> Plane:
        """Transform the plane into a frame."""
        return Plane(frame.seen(self.point), self.normal @ frame.axes)
