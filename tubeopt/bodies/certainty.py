"""How well a registration is known: its standard errors in rad and m.

The turn minimises  sum_v w_v |R m_v + t - p_v|^2, whose second derivative by the turn, the translation following, is
H = tr(S) I - S  with  S = sum_v w_v (R m_v - mean)(p_v - mean)'  (symmetric at the minimum), curvature by residuals
included. Data on a line, or residuals as large as the spread across it, leave H singular or indefinite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy

from ..files.field_metadata import unit
from ..typing import Array

MOST = math.radians(5.0)
"""Standard error of the turn beyond which a registration is refused."""

NARROW = 0.1
"""Spread across over spread along, below which points are taken as near to a line."""

MIRRORED = 0.7
"""A mirror image whose residual is below this part of the registration's is worth a remark."""

EXACT = 1e-6
"""Residual over the spread of the points, below which it is round-off, and tells nothing about a mirror image."""

OPEN = 1e-9
"""Least eigenvalue of H over its trace, below which the turn is open."""


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
