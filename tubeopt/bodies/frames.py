"""Rigid frames of a robot in a patient: by an entry and a direction, or by landmarks measured twice; their errors.

A patient's axes are RAS, to the right, to the front and up, as NIfTI has them; LPS, as DICOM has them, points to the
left and to the back. Lengths are in m.

Some files state their axes: SPACE=LPS in headers and comments, as 3D Slicer writes them. STL has it in its header, PLY,
OBJ, OFF and CSV in comments, VTK in its second line, Slicer's .fcsv as `# CoordinateSystem = LPS` (0 for RAS and 1
for LPS in old ones), and .mrk.json under `coordinateSystem`.

The errors of a registration: the turn minimises  sum_v w_v |R m_v + t - p_v|^2, whose second derivative by the turn,
the translation following, is  H = tr(S) I - S  with  S = sum_v w_v (R m_v - mean)(p_v - mean)'  (symmetric at the
minimum), curvature by residuals included. Data on a line, or residuals as large as the spread across it, leave H
singular or indefinite.
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

# Ways of writing positions in a patient.
AXES = ("RAS", "LPS")

# Landmarks that fix a frame.
FEWEST = 3

# Fraction of their size by which landmarks must lie off a line: below, the rotation about the line is known to no
# better than 1000 times their relative error.
FLAT = 1e-3


# Standard deviation (m) of a coordinate of landmarks, as careful hands and trackers reach it; used where a file
# states none.
DOUBT = 0.5e-3

# Uncertainty of a place (m) that no clearance need cover: a micrometre is below what is milled or measured.
NEGLIGIBLE = 1e-6


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


# Standard error of the rotation above which a registration is refused: at 100 mm, 5 deg are 9 mm.
MOST = math.radians(5.0)

# Spread across over spread along, below which points are near a line, and the rotation about it is ten times less
# certain.
NARROW = 0.1

# A mirror image whose residual is below this fraction of the registration's is worth a remark: where points are
# nearly plane both residuals are about equal.
MIRRORED = 0.7

# Residual over the spread of the points, below which it is round-off, and tells nothing about a mirror image.
EXACT = 1e-6

# Smallest eigenvalue of H over its trace, below which the rotation is open: H is then singular to round-off.
OPEN = 1e-9


@dataclass(frozen=True)
class RegistrationError:
    """Standard errors of a registration."""

    turn: Annotated[float, unit("deg"), "standard error of the rotation about the worst axis"]
    """Infinite where the data leave it open."""
    reach: Annotated[float, unit("mm"), "standard error of a point at the arm's length from the plate"]
    """Worst of all directions; from landmarks, at the distance of the farthest one."""
    narrow: float
    """Spread of the points across the line that is nearest to them, over the spread along it."""
    mirrored: float | None = None
    """Root mean square distance to the best mirror image, m, where that is clearly smaller; else None."""
    doubtful: float = 1.0
    """Factor by which the standard errors may be larger (95 %), where few residuals tell them."""

    @property
    def too_large(self) -> bool:
        """Whether points near to a line leave the turn so open that a registration is refused."""
        return self.turn * self.doubtful > MOST and self.narrow <= NARROW


def turn_curvature(here: Array, there: Array, weight: Array, turns: Array) -> Array | None:
    """(k, k) second derivative H by turns about axes (k, 3), from places (V, 3) about their mean; None where a turn is
    open."""
    s = np.einsum("v,vi,vj->ij", weight, here, there)
    hessian = turns @ (np.trace(s) * np.eye(3) - (s + s.T) / 2) @ turns.T
    least, scale = np.linalg.eigvalsh(hessian)[0], max(float(np.trace(hessian)), 1e-300)
    return None if least <= OPEN * scale else hessian


def narrowness(points: Array) -> float:
    """Spread of points (V, 3) across the line that is nearest to them, over the spread along it."""
    along = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return float(along[1] / max(along[0], 1e-300)) if len(along) > 1 else 0.0


def standard_errors(covariance: Array, turns: Array, centre: Array, length: float) -> tuple[float, float]:
    """Standard errors of the turn about its worst axis, and of the worst point at a distance from the plate."""
    n = len(turns)
    about = turns.T @ covariance[:n, :n] @ turns
    reach = 0.0
    for point in length * np.vstack([np.eye(3), -np.eye(3)]):
        x, y, z = point - centre
        cross = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])  # of a small turn
        change = np.hstack([cross @ turns.T, np.eye(3)])
        reach = max(reach, float(np.linalg.eigvalsh(change @ covariance @ change.T)[-1]))
    return math.sqrt(max(np.linalg.eigvalsh(about)[-1], 0.0)), math.sqrt(reach)


def mirrored(here: Array, there: Array, left: float) -> float | None:
    """Root mean square distance to the best mirror image, where it is clearly below what is left, else None."""
    u, v = here - here.mean(0), there - there.mean(0)
    size = np.linalg.svd(u.T @ v)[1]
    sign = np.sign(np.linalg.det(u.T @ v))
    best = (u**2).sum() + (v**2).sum() - 2 * (size[0] + size[1] - sign * size[2])
    apart, spread = math.sqrt(max(float(best), 0.0) / len(u)), math.sqrt(float((u**2).sum()) / len(u))
    return apart if apart < MIRRORED * left and left > EXACT * spread else None


def landmark_error(here: Array, there: Array, noise: float | None = None) -> RegistrationError:
    """The standard errors of a registration from landmarks `here` (N, 3), m, in the plate's frame, by which `there`
    (N, 3), in the same frame after the registration, are explained.

    `noise` is the standard deviation of each coordinate, m; by default what the registration leaves over 3 N - 6. So
    the errors of landmarks are taken as independent and of one size, in all directions alike. An error that all of them
    share moves the plate and leaves no trace.
    """
    count, centre, doubtful = len(here), there.mean(0), 1.0
    narrow, rms = narrowness(here), math.sqrt(((here - there) ** 2).sum() / count)
    if noise is None:
        spare = max(3 * count - 6, 1)
        noise = rms * math.sqrt(count / spare)
        doubtful = math.sqrt(spare / scipy.stats.chi2.ppf(0.05, spare))
    hessian = turn_curvature(here - here.mean(0), there - centre, np.ones(count), np.eye(3))
    if hessian is None:
        return RegistrationError(math.inf, math.inf, narrow, mirrored(here, there, rms))
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = np.linalg.inv(hessian), np.eye(3) / count
    length = float(np.linalg.norm(here, axis=1).max())
    turn, reach = standard_errors(noise**2 * covariance, np.eye(3), centre, length)
    return RegistrationError(turn, reach, narrow, mirrored(here, there, rms), doubtful)


# A statement, and its word; of other spellings of SPACE only the words that are known, since "space" is common.
STATED = re.compile(
    rb"""\bSPACE=([A-Za-z0-9-]+)|(?i:\bCoordinateSystem)["']?\s*[=:]\s*["']?([A-Za-z0-9-]+)|"""
    rb"""(?i:\bspace\s*[=:]\s*(ras|lps|right-anterior-superior|left-posterior-superior)\b)"""
)

# What files call the axes that are known.
WORDS = {
    "ras": "RAS", "right-anterior-superior": "RAS", "0": "RAS",
    "lps": "LPS", "left-posterior-superior": "LPS", "1": "LPS",
}  # fmt: skip

# Bytes at the beginning of a file in which it is stated.
HEAD = 4096

# Bytes of the header of a binary STL file.
STL_HEADER = 80

# How lines that are comments begin, by the kind of file.
COMMENTS = {".ply": b"comment obj_info", ".obj": b"#", ".off": b"#", ".csv": b"#", ".fcsv": b"#", ".txt": b"#"}


def stated_axes(path: str | PathLike[str]) -> str | None:
    """RAS or LPS: the axes that a file states itself; None where it states none.

    Raises:
        InputError: no such file, axes that are not known, or two of them.
    """
    found = {"".join(word.decode() for word in one).lower() for one in STATED.findall(_statements(path))}
    unknown = sorted(found - WORDS.keys())
    if unknown:
        raise InputError(f"{path}: it states the axes {unknown[0]!r}; they must be {' or '.join(AXES)}")
    known = sorted({WORDS[word] for word in found})
    if len(known) > 1:
        raise InputError(f"{path}: it states two kinds of axes, {' and '.join(known)}; it must state one")
    return known[0] if known else None


def _statements(path: str | PathLike[str]) -> bytes:
    """The parts of a file in which axes may be stated."""
    suffix, content = Path(path).suffix.lower(), read_bytes(path)
    if suffix == ".json":
        return content
    if suffix == ".stl" and not content[:STL_HEADER].lstrip().lower().startswith(b"solid"):
        return content[:STL_HEADER]
    head = content[:HEAD]
    if suffix == ".stl":  # text, or a binary one whose header begins as text does
        return head.split(b"\n", 1)[0][:HEAD]
    if suffix == ".vtk":
        return b"\n".join(head.split(b"\n")[:2])
    begins = tuple(COMMENTS.get(suffix, b"").split())
    if not begins:
        return b""
    return b"\n".join(line for line in head.splitlines() if line.lstrip().startswith(begins))


def agreed(path: str | PathLike[str], axes: str | None) -> str | None:
    """RAS or LPS: the axes that a file states, or else those that are given with it; None where neither says anything.

    Raises:
        InputError: as `stated_axes`; axes that are given and contradict those that the file states.
    """
    stated = stated_axes(path)
    if stated is not None and axes is not None and stated != axes:
        raise InputError(f"{path}: axes is {axes}, but the file states {stated}; leave axes out, or correct the file")
    return stated or axes


def needed(path: str | PathLike[str], axes: str | None) -> str:
    """The same where one must be known: raises InputError where neither says anything."""
    known = agreed(path, axes)
    if known is None:
        raise InputError(
            f"{path}: the file does not state its axes, and none are given; give axes: RAS (x to the right, y to the "
            "front) or axes: LPS (x to the left, y to the back)"
        )
    return known


# Sine of the angle between two vectors from which on they span a plane: its normal is then known to 1e-10.
COLLINEAR = 1e-6


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
        if not np.linalg.norm(normal) > COLLINEAR * np.linalg.norm(second - one) * np.linalg.norm(third - one):
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
