"""Spring-back: how much of a mold's curvature a tube keeps, from trials, and the mold that a curvature needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
import scipy

from ...display import Displayed
from ...errors import InputError, choice, positive, vector
from ...files.field_metadata import OneOf, check_fields, unit
from ...typing import Array

MODELS = ("auto", "constant", "linear")
ROUND_OFF = 1e-9
"""Change of the fraction over the trials below which a slope is round-off, whatever the statistics say."""


RADII = 1e-3, 10.0
"""Least and greatest radius to which a tube is bent, m: a tighter or wider one was given in another unit."""


@dataclass(frozen=True)
class Springback:
    """Fraction of the mold's curvature that a tube loses: obtained = mold (1 - fraction - slope mold).

    The fraction holds all that happens between the mold and the bench: relaxation that was not complete, and the
    contraction when the tube cools, since that is how trials see it.

    Raises:
        InputError: a number is out of its range.
    """

    fraction: Annotated[
        float, unit("percent"), "lost fraction at small curvature; negative if tubes become more curved than the mold"
    ] = 0.0
    slope: Annotated[float, unit("mm"), "increase of the lost fraction with the mold curvature"] = 0.0
    shrinkage: Annotated[float, unit("percent"), "fraction of the bend length lost on cooling"] = 0.0
    curvature_range: tuple[float, float] | None = None
    """Mold curvatures of the trials that the numbers are from, 1/m, or None without trials."""

    def __post_init__(self) -> None:
        check_fields(self, "the spring-back")
        if not -1 < self.fraction < 1:
            raise InputError(f"fraction of the spring-back is {self.fraction:g}; it must lie between -1 and 1")
        if self.curvature_range is not None:
            least, most = vector("curvature_range of the spring-back", self.curvature_range, 2, "least and greatest")
            object.__setattr__(self, "curvature_range", (float(least), float(most)))
        if not 0 <= self.shrinkage < 0.1:
            raise InputError(f"shrinkage of the spring-back is {self.shrinkage:g}; it must lie in [0, 0.1)")

    @property
    def calibrated(self) -> bool:
        """Whether the numbers are from trials, or at least not all 0."""
        return self.curvature_range is not None or self.fraction != 0 or self.slope != 0

    def obtained(self, mold_curvature: float) -> float:
        """Curvature (1/m) of a tube set in a mold of `mold_curvature` (1/m); the sign is kept."""
        size = abs(mold_curvature)
        return math.copysign(size * (1 - self.fraction - self.slope * size), mold_curvature)

    def mold(self, curvature: float) -> float:
        """Curvature (1/m) of the mold that yields `curvature` (1/m); the sign is kept.

        Raises:
            InputError: no mold yields it: the more one bends, the more springs back.
        """
        size, kept = abs(curvature), 1 - self.fraction
        inside = kept**2 - 4 * self.slope * size
        if inside < 0:
            most = kept**2 / (4 * self.slope)
            raise InputError(
                f"curvature is {curvature:g} per m; with this spring-back no mold yields more than {most:.4g} per m "
                f"(radius {1e3 / most:.4g} mm)"
            )
        return math.copysign(2 * size / (kept + math.sqrt(inside)), curvature)


@dataclass(frozen=True, eq=False)
class Calibration(Displayed):
    """Spring-back fitted to trials."""

    springback: Springback
    """The fitted model, with the range of the trials."""
    model: str
    """Constant or linear."""
    mold_curvature: Array
    """(N,) of the molds of the trials, 1/m."""
    obtained_curvature: Array
    """(N,) of the tubes that came out of them, 1/m."""
    fraction_interval: tuple[float, float] | None
    """95 % interval; None where there are too few trials to know."""
    slope_interval: tuple[float, float] | None
    """95 % interval, m; None where there are too few trials to know, or no slope."""
    noise: float
    """Standard deviation of the lost fraction about the model; NaN where there are too few trials."""
    remarks: tuple[str, ...]
    """What to keep in mind."""

    @property
    def lost(self) -> Array:
        """(N,) part of the curvature that each trial lost."""
        return np.asarray(1 - self.obtained_curvature / self.mold_curvature)

    @property
    def fitted(self) -> Array:
        """(N,) part of the curvature that the model loses in each trial."""
        return self.springback.fraction + self.springback.slope * self.mold_curvature


def calibrate_springback(
    mold_radius: Sequence[float] | Array,
    obtained_radius: Sequence[float] | Array,
    *,
    model: Annotated[str, OneOf(MODELS)] = "auto",
) -> Calibration:
    """Fit the spring-back to pairs of mold radius and obtained radius (m) by least squares of the lost fraction.

    Args:
        model: model of the lost curvature fraction: constant, linear (increases with curvature) or auto (selected from
            the trials). "auto" is linear where the 95 % interval of the slope leaves out 0. Intervals are those of the
            chosen model as if it had been given. In 600 simulated sets of 6 trials they cover the fraction in 91 to
            97 %, and a slope that is small and happens to be kept in 52 to 94 %; with a model that is given they cover
            both in 93 to 96 %.

    Raises:
        InputError: no trials, lists of different lengths, a radius that is not positive, or too few different mold
            radii for a linear model.
    """
    choice("model", model, MODELS)
    molds, tubes = _radii("mold_radius", mold_radius), _radii("obtained_radius", obtained_radius)
    if len(molds) != len(tubes):
        raise InputError(f"mold_radius has {len(molds)} numbers and obtained_radius {len(tubes)}; they must be pairs")
    kappa, lost = 1 / molds, 1 - molds / tubes
    distinct = len(np.unique(np.round(molds, 9)))
    if model == "linear" and distinct < 2:
        raise InputError("model is linear; that needs trials in molds of at least 2 different radii")
    values, intervals, noise = _least_squares(kappa, lost, 2 if model == "linear" else 1)
    if model == "auto" and distinct >= 2 and len(molds) >= 4:
        line, ends, about = _least_squares(kappa, lost, 2)
        if ends and ends[1][0] * ends[1][1] > 0 and abs(line[1]) * np.ptp(kappa) > ROUND_OFF:
            values, intervals, noise = line, ends, about
    slope = float(values[1]) if len(values) == 2 else 0.0
    back = Springback(float(values[0]), slope, curvature_range=(float(kappa.min()), float(kappa.max())))
    return Calibration(
        springback=back,
        model="linear" if len(values) == 2 else "constant",
        mold_curvature=kappa,
        obtained_curvature=1 / tubes,
        fraction_interval=intervals[0] if intervals else None,
        slope_interval=intervals[1] if len(intervals) == 2 else None,
        noise=noise,
        remarks=_remarks(back, lost, len(molds), distinct),
    )


def _least_squares(kappa: Array, lost: Array, order: int) -> tuple[Array, list[tuple[float, float]], float]:
    """Coefficients, their 95 % intervals, none of too few trials, and the standard deviation about them."""
    matrix = np.vander(kappa, order, increasing=True)
    values = np.asarray(np.linalg.lstsq(matrix, lost, rcond=None)[0], dtype=float)
    free = len(lost) - order
    if free < 1:
        return values, [], math.nan
    noise = float(np.sqrt(np.sum((lost - matrix @ values) ** 2) / free))
    spread = noise * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    reach = scipy.special.stdtrit(free, (1 + 0.95) / 2) * spread
    return values, [(float(v - r), float(v + r)) for v, r in zip(values, reach, strict=True)], noise


def _radii(name: str, values: Sequence[float] | Array) -> Array:
    if not len(values):
        raise InputError(f"{name} is empty; there must be at least one trial")
    radii = np.array([positive(f"{name} of trial {k}", value) for k, value in enumerate(values, start=1)])
    for k, radius in enumerate(radii.tolist(), start=1):
        if not RADII[0] <= radius <= RADII[1]:
            raise InputError(
                f"{name} of trial {k} is {1e3 * radius:g} mm; it must be {1e3 * RADII[0]:g} to {1e3 * RADII[1]:g} mm, "
                "as radii of curved tubes are"
            )
    return radii


def _remarks(back: Springback, lost: Array, trials: int, distinct: int) -> tuple[str, ...]:
    remarks = []
    if trials < 3:
        remarks.append(f"{trials} trial{'s' if trials > 1 else ''}: too few to know how far the next tube may differ")
    if distinct == 1 and trials > 1:
        remarks.append("all trials are of one mold radius: the fraction is known for that radius only")
    if (lost < -0.02).any():
        remarks.append("a tube came out more than 2 % tighter than its mold: are the columns swapped?")
    if back.curvature_range and back.slope:
        ends = [back.obtained(kappa) for kappa in np.linspace(0, back.curvature_range[1], 50)]
        if any(after <= before for before, after in pairwise(ends)):
            remarks.append("within the trials a tighter mold yields a straighter tube: take a constant model")
    return tuple(remarks)
