"""Spring-back: its model, its fit to trials, and the tube in its mold and after it (SI).

Every curvature springs back by itself, and the length of the curved part shrinks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from ...display import Displayed
from ...errors import InputError, choice, positive, vector
from ...files.field_metadata import OneOf, Range, check_fields, unit
from ...robots.pieces import Piece, Quantity, Series, breaks_of, on_panels, times, values, vary, zeros
from ...robots.tubes import Tube
from ...typing import Array

MODELS = ("auto", "constant", "linear")
SLOPE_ROUND_OFF = 1e-9
"""Change of the fraction over the trials below which a slope is round-off, whatever the statistics say."""


RADII = 1e-3, 10.0
"""Smallest and largest radius of a bent tube, m; numbers beyond them are probably in another unit."""


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
    uncertainty: Annotated[
        float | None,
        unit("percent"),
        Range(minimum=0.0, maximum=1.0),
        "half-width of the 95 % interval of the lost fraction of one new tube, as measured, from the trials",
    ] = None
    curvature_range: tuple[float, float] | None = None
    """Mold curvatures of the trials that the numbers are from, 1/m, or None without trials."""

    def __post_init__(self) -> None:
        check_fields(self, "the spring-back")
        if not -1 < self.fraction < 1:
            raise InputError(f"fraction of the spring-back is {self.fraction:g}; it must lie between -1 and 1")
        if self.curvature_range is not None:
            low, high = vector("curvature_range of the spring-back", self.curvature_range, 2, "least and greatest")
            object.__setattr__(self, "curvature_range", (float(low), float(high)))
        if not 0 <= self.shrinkage < 0.1:
            raise InputError(f"shrinkage of the spring-back is {self.shrinkage:g}; it must lie in [0, 0.1)")

    @property
    def calibrated(self) -> bool:
        """True for numbers from trials, and for any that are not 0."""
        return self.curvature_range is not None or self.fraction != 0 or self.slope != 0

    def obtained(self, mold_curvature: float) -> float:
        """Curvature (1/m) of a tube set in a mold of `mold_curvature` (1/m), with its sign."""
        size = abs(mold_curvature)
        return math.copysign(size * (1 - self.fraction - self.slope * size), mold_curvature)

    def interval(self, mold_curvature: float) -> tuple[float, float] | None:
        """95 % interval of the curvature (1/m, without sign) of a tube set in a mold; None without enough trials."""
        if self.uncertainty is None:
            return None
        size = abs(mold_curvature)
        middle, half = abs(self.obtained(mold_curvature)), self.uncertainty * size
        return max(middle - half, 0.0), middle + half

    def mold(self, curvature: float) -> float:
        """Curvature (1/m) of the mold that yields `curvature` (1/m), with its sign.

        Raises:
            InputError: no mold yields it, since the lost fraction increases with the mold's curvature.
        """
        size, retained = abs(curvature), 1 - self.fraction
        # size = k (retained - slope k) is a quadratic in the mold's curvature k.
        discriminant = retained**2 - 4 * self.slope * size
        if discriminant < 0:
            max_curvature = retained**2 / (4 * self.slope)
            raise InputError(
                f"curvature is {curvature:g} per m; with this spring-back no mold yields more than "
                f"{max_curvature:.4g} per m (radius {1e3 / max_curvature:.4g} mm)"
            )
        # The smaller root, in the form that does not cancel and is right for a slope of 0.
        return math.copysign(2 * size / (retained + math.sqrt(discriminant)), curvature)


@dataclass(frozen=True, eq=False)
class Calibration(Displayed):
    """Spring-back fitted to trials."""

    springback: Springback
    """Fitted model, with the range of the trials."""
    model: Annotated[str, "spring-back model"]
    """Name of the selected model, "constant" or "linear"."""
    mold_curvature: Array
    """(N,) curvatures of the molds of the trials, 1/m."""
    obtained_curvature: Array
    """(N,) curvatures of the tubes set in the molds, 1/m."""
    fraction_interval: Annotated[tuple[float, float] | None, unit("percent"), "95 % interval of the fraction"]
    """None if trials are too few."""
    slope_interval: Annotated[tuple[float, float] | None, unit("mm"), "95 % interval of the slope"]
    """None if trials are too few, or without a slope."""
    noise: Annotated[float, unit("percent"), "scatter between equal tubes"]
    """Standard deviation of the lost fraction about the model, without the errors of measurement; NaN if trials are too
    few."""
    remarks: Annotated[tuple[str, ...], "remarks on the fit"]

    @property
    def lost(self) -> Array:
        """(N,) fraction of the mold's curvature lost in each trial."""
        return np.asarray(1 - self.obtained_curvature / self.mold_curvature)

    @property
    def fitted(self) -> Array:
        """(N,) lost fraction of the model for each trial."""
        return self.springback.fraction + self.springback.slope * self.mold_curvature


def calibrate_springback(
    mold_radius: Sequence[float] | Array,
    obtained_radius: Sequence[float] | Array,
    *,
    obtained_error: Sequence[float] | Array | None = None,
    model: Annotated[str, OneOf(MODELS)] = "auto",
) -> Calibration:
    """Fit the spring-back to pairs of mold radius and obtained radius (m) by least squares of the lost fraction.

    Args:
        obtained_error: standard errors of the obtained radii, m. Trials count by the variances of measurement and
            scatter together. None: all trials count alike, and errors of measurement are part of the scatter.
        model: model of the lost curvature fraction: constant, linear (increases with curvature) or auto (selected from
            the trials). "auto" selects linear if the 95 % interval of the slope excludes 0. The intervals ignore this
            selection. In 600 simulated sets of 6 trials they cover the fraction in 91 to 97 %, and a small slope that
            happens to be selected in 52 to 94 %; without selection they cover fraction and slope in 93 to 96 %.

    Raises:
        InputError: no trials, lists of different lengths, a radius that is not positive, or too few different mold
            radii for a linear model.
    """
    choice("model", model, MODELS)
    molds, tubes = _radii("mold_radius", mold_radius), _radii("obtained_radius", obtained_radius)
    if len(molds) != len(tubes):
        raise InputError(f"mold_radius has {len(molds)} numbers and obtained_radius {len(tubes)}; they must be pairs")
    kappa, lost = 1 / molds, 1 - molds / tubes
    error = None if obtained_error is None else _errors(obtained_error, tubes) * molds / tubes**2
    distinct = len(np.unique(np.round(molds, 9)))
    if model == "linear" and distinct < 2:
        raise InputError("model is linear; that needs trials in molds of at least 2 different radii")
    fit = _least_squares(kappa, lost, error, 2 if model == "linear" else 1)
    if model == "auto" and distinct >= 2 and len(molds) >= 4:
        line = _least_squares(kappa, lost, error, 2)
        ends = line.intervals
        # The interval excludes 0 if both ends have one sign. A range of round-off shows no slope.
        if ends and ends[1][0] * ends[1][1] > 0 and abs(line.values[1]) * np.ptp(kappa) > SLOPE_ROUND_OFF:
            fit = line
    values, intervals, noise, prediction = fit
    slope = float(values[1]) if len(values) == 2 else 0.0
    back = Springback(
        float(values[0]),
        slope,
        uncertainty=None if math.isnan(prediction) else min(prediction, 1.0),
        curvature_range=(float(kappa.min()), float(kappa.max())),
    )
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


class PolynomialFit(NamedTuple):
    """A polynomial fitted to trials."""

    values: Array
    """(order,) coefficients, constant first."""
    intervals: list[tuple[float, float]]
    """95 % intervals; empty with too few trials."""
    noise: float
    """Standard deviation of the tubes about the polynomial; NaN with too few trials."""
    prediction: float
    """Half-width of the 95 % interval of one new tube in the worst of these molds; NaN with too few trials."""


class _Weighted(NamedTuple):
    """Weighted linear fit."""

    values: Array
    """Coefficients."""
    squares: float
    """Sum of the squares of the scaled deviations."""
    covariance: Array


def _least_squares(kappa: Array, lost: Array, error: Array | None, order: int) -> PolynomialFit:
    """Fit the lost fraction by a polynomial of the mold's curvature with `order` coefficients.

    error: standard errors of the lost fractions from measurement alone; None if unknown.
    """
    matrix = np.vander(kappa, order, increasing=True)
    dof = len(lost) - order

    def weighted(noise: float) -> _Weighted:
        """Fit for a scatter of tubes."""
        deviation = np.ones(len(lost)) if error is None else np.hypot(error, noise)
        scaled = matrix / deviation[:, None]
        values = np.asarray(np.linalg.lstsq(scaled, lost / deviation, rcond=None)[0], dtype=float)
        squares = float(np.sum(((lost - matrix @ values) / deviation) ** 2))
        return _Weighted(values, squares, np.asarray(np.linalg.inv(scaled.T @ scaled), dtype=float))

    values, squares, covariance = weighted(0.0)
    if dof < 1:
        return PolynomialFit(values, [], math.nan, math.nan)
    noise = 0.0
    if error is None:
        noise = math.sqrt(squares / dof)
        covariance = noise**2 * covariance
    elif squares > dof:
        # The scatter that explains the deviations beyond the errors of measurement (Paule and Mandel 1982).
        most = 10 * float(np.std(lost))
        noise = float(scipy.optimize.brentq(lambda trial: weighted(trial).squares - dof, 0.0, most))
        values, _, covariance = weighted(noise)
    # Student's t, since the noise is estimated from the same trials.
    student = float(scipy.special.stdtrit(dof, (1 + 0.95) / 2))
    half_width = student * np.sqrt(np.diag(covariance))
    intervals = [(float(v - h), float(v + h)) for v, h in zip(values, half_width, strict=True)]
    of_fit = float(np.einsum("ni,ij,nj->n", matrix, covariance, matrix).max())
    # Few trials may hide the scatter of the tubes in errors of measurement: both count, as the next tube is measured.
    spread = float(np.sum((lost - matrix @ values) ** 2)) / dof
    return PolynomialFit(values, intervals, noise, student * math.sqrt(spread + of_fit))


def _radii(name: str, values: Sequence[float] | Array) -> Array:
    """(N,) checked radii of trials, m."""
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


def _errors(values: Sequence[float] | Array, tubes: Array) -> Array:
    """(N,) checked standard errors of obtained radii, m."""
    if len(values) != len(tubes):
        raise InputError(
            f"obtained_error has {len(values)} numbers and obtained_radius {len(tubes)}; they must be pairs"
        )
    errors = np.array([positive(f"obtained_error of trial {k}", value) for k, value in enumerate(values, start=1)])
    for k, (error, radius) in enumerate(zip(errors.tolist(), tubes.tolist(), strict=True), start=1):
        if error > 0.5 * radius:
            raise InputError(
                f"obtained_error of trial {k} is {1e3 * error:g} mm; it must be at most half the radius, "
                f"{500 * radius:.4g} mm"
            )
    return errors


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


# --- a tube in its mold, and out of it --------------------------------------------------------------------------------


ORDER = 24
"""Degree of the polynomials that interpolate a curvature after uneven spring-back."""

PLANAR = 1e-9
"""Tolerance of a planar bend: curvature out of its plane over the largest curvature."""


_NODES = chebyshev.chebpts1(ORDER + 1)
_INTERPOLATE = np.linalg.inv(chebyshev.chebvander(_NODES, ORDER))


def tube_in_mold(tube: Tube, back: Springback) -> Tube:
    """Tube in the shape of its mold: before spring-back of its curvatures and shrinkage of its curved part.

    The natural twist stays, since trials of planar bends say nothing about it.
    """
    return _changed(tube, back.mold, 1 / (1 - back.shrinkage), even=back.slope == 0)


def tube_from_mold(held: Tube, back: Springback) -> Tube:
    """Tube after spring-back from its shape in the mold: the inverse of `tube_in_mold`."""
    return _changed(held, back.obtained, 1 - back.shrinkage, even=back.slope == 0)


def _changed(tube: Tube, curve: Callable[[float], float], factor: float, *, even: bool) -> Tube:
    """Tube with every curvature mapped by `curve`, and its curved part `factor` times as long.

    even: the map is a constant factor.
    """
    largest = curve(tube.curvature)
    if not tube.general:
        return replace(tube, curvature=largest, curved_length=tube.curved_length * factor)
    chain = tuple(_changed_piece(piece, curve, factor, even=even) for piece in tube.pieces)
    length = math.fsum(piece.length for piece in chain)
    return replace(tube, curved_length=length, curvature=max(piece.largest_curvature for piece in chain), pieces=chain)


def _changed_piece(piece: Piece, curve: Callable[[float], float], factor: float, *, even: bool) -> Piece:
    """Piece with its curvature mapped by `curve`, `factor` times as long; arguments as in `_changed`."""
    x, y, z = piece.precurvature

    def gain(size: float) -> float:
        size = max(size, 1e-9)  # the limit at curvature 0, where the quotient is 0 / 0
        return curve(size) / size

    if even or not vary((x, y)):
        size = 1.0 if even else float(np.hypot(x, y))
        x, y = times(x, gain(size)), times(y, gain(size))
    else:
        breaks = _smooth_stretches(x, y, piece.length)
        components = x, y

        def mapped(component: Quantity, s: Array) -> Array:
            sizes = np.hypot(values(components[0], s), values(components[1], s))
            return np.asarray(values(component, s) * np.array([gain(size) for size in sizes]))

        x, y = (0.0 if q == 0.0 else _interpolated(partial(mapped, q), breaks) for q in components)
    return replace(piece, precurvature=(x, y, z)).stretched(factor)


def _smooth_stretches(x: Quantity, y: Quantity, length: float) -> list[float]:
    """Arc lengths (m) between which |curvature| is smooth: it has a corner where the bend changes side."""
    breaks = breaks_of([x, y], length)
    corners = set(breaks.tolist())
    for quantity in (x, y):
        for (low, high), coefficients in zip(pairwise(breaks), on_panels(quantity, breaks), strict=True):
            roots = zeros(coefficients, 1e-7)
            corners |= {float((low + high) / 2 + root * (high - low) / 2) for root in roots}
    return sorted(corners)


def _interpolated(function: Callable[[Array], Array], breaks: list[float]) -> Series:
    """Piecewise polynomials that equal a function, smooth between breaks, to round-off."""
    low, high = np.array(breaks[:-1]), np.array(breaks[1:])
    scale = float(np.abs(function(np.linspace(0.0, breaks[-1], 200))).max())
    ends, table = [0.0], []
    stack = [(a, b, 0) for a, b in zip(low[::-1], high[::-1], strict=True)]
    while stack:
        a, b, depth = stack.pop()
        c = _INTERPOLATE @ function((a + b) / 2 + _NODES * (b - a) / 2)
        # The last coefficients of a smooth function fall to round-off; a pole near a panel halves it again.
        if depth < 8 and (np.abs(c[-3:]) > 1e-12 * scale).any():
            stack += [((a + b) / 2, b, depth + 1), (a, (a + b) / 2, depth + 1)]
            continue
        ends.append(float(b))
        table.append(tuple(chebyshev.chebtrim(c, 1e-15 * scale).tolist()))
    return Series(tuple(ends), tuple(table))


def bend_direction(tube: Tube) -> tuple[float, float] | None:
    """Unit vector (2,) of the cross-section along all of the precurvature, with x >= 0; None for a space curve."""
    if tube.curvature == 0 or tube.curved_length == 0:
        return 1.0, 0.0
    u = np.vstack([_sampled(piece) for piece in tube.chain])
    sizes = np.hypot(u[:, 0], u[:, 1])
    largest = float(sizes.max())
    ex, ey = u[int(sizes.argmax()), :2] / largest
    if ex < 0 or (ex == 0 and ey < 0):
        ex, ey = -ex, -ey
    out_of_plane = np.abs(u[:, 0] * ey - u[:, 1] * ex).max()
    if out_of_plane > PLANAR * largest or np.abs(u[:, 2]).max() > PLANAR * largest:
        return None
    return (1.0, 0.0) if abs(ey) <= PLANAR else (float(ex), float(ey))


def _sampled(piece: Piece) -> Array:
    """(N, 3) precurvature u* of a piece, dense in every panel, 1/m."""
    breaks = breaks_of(piece.precurvature, piece.length)
    s = np.unique(np.concatenate([np.linspace(a, b, 3 * ORDER) for a, b in pairwise(breaks)]))
    return np.column_stack([values(q, s) for q in piece.precurvature])


class Panel(NamedTuple):
    """Stretch of a planar tube with a curvature polynomial."""

    length: float
    """Arc length, m."""
    coefficients: Array
    """Chebyshev coefficients of the curvature, 1/m; positive about the bend direction."""


def signed_curvature(tube: Tube) -> list[Panel]:
    """Signed curvature of the curved part of a planar tube, in panels.

    Raises:
        InputError: the tube is a space curve.
    """
    direction = bend_direction(tube)
    if direction is None:
        raise InputError("the tube is a space curve; a plate supports planar bends only")
    panels: list[Panel] = []
    for piece in tube.chain:
        x, y, _ = piece.precurvature
        breaks = breaks_of([x, y], piece.length)
        for length, cx, cy in zip(np.diff(breaks), on_panels(x, breaks), on_panels(y, breaks), strict=True):
            curvature = chebyshev.chebadd(direction[0] * cx, direction[1] * cy)
            panels.append(Panel(float(length), np.asarray(curvature, dtype=float)))
    return panels
