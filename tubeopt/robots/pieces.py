"""Pieces of tubes: any precurvature and any stiffness along a stretch, as numbers or polynomials in arc length (SI).

A function given by the user is expanded once, in Chebyshev polynomials on panels that are halved until the coefficients
fall to 1e-13 of the largest value (Trefethen, Approximation Theory and Approximation Practice, SIAM 2013). What remains
is plain data: it is compared, hashed, pickled and saved, and evaluated alike by NumPy and by the compiled kernel.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache, reduce
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import scipy
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, call_user_function, finite, instance, positive
from ..files.field_metadata import POSITIVE, REQUIRED, Typical
from ..physics.strain import slotted_strain_ratio
from ..typing import Array

# Chebyshev points on a panel, and most coefficients of it: smooth functions reach 1e-13 with fewer, and a panel that
# needs more is halved, which costs less than a higher degree.
POINTS = 25

# Relative to the largest value: some hundred times the round-off of a sum of 25 terms, which is
# indistinguishable from 0.
TOLERANCE = 1e-13

# How often a panel may be halved: functions with finer detail than a thousandth of their stretch are refused.
HALVINGS = 10

# Chebyshev points of the first kind, rising. Interpolation there is well conditioned: discrete T_k are orthogonal.
_NODES = np.cos(np.pi * (np.arange(POINTS)[::-1] + 0.5) / POINTS)
_FIT = np.linalg.inv(chebyshev.chebvander(_NODES, POINTS - 1))


@dataclass(frozen=True)
class Series:
    """A polynomial on each of several panels."""

    breaks: tuple[float, ...]
    """(k + 1) arc lengths of the ends of the panels, from 0, m."""
    coefficients: tuple[tuple[float, ...], ...]
    """Per panel, of the Chebyshev polynomials in x = -1 .. 1 along it."""

    def __post_init__(self) -> None:
        breaks = tuple(float(s) for s in self.breaks)
        table = tuple(tuple(float(c) for c in panel) for panel in self.coefficients)
        values = np.array([*breaks, *(c for panel in table for c in panel)])
        shaped = len(breaks) == len(table) + 1 and len(table) > 0 and all(table)
        if not shaped or not np.isfinite(values).all() or breaks[0] != 0 or (np.diff(breaks) <= 0).any():
            raise InputError("a series must have one list of finite coefficients for every panel between rising breaks")
        object.__setattr__(self, "breaks", breaks)
        object.__setattr__(self, "coefficients", table)

    @cached_property
    def _hash(self) -> int:
        return hash((self.breaks, self.coefficients))

    @cached_property
    def _arrays(self) -> tuple[Array, Array]:
        width = max(map(len, self.coefficients))
        return np.array(self.breaks), np.array([[*panel, *[0.0] * (width - len(panel))] for panel in self.coefficients])

    def __hash__(self) -> int:
        return self._hash

    @property
    def length(self) -> float:
        """Arc length of the whole, m."""
        return self.breaks[-1]

    def __call__(self, arc_length: ArrayLike) -> Array:
        """Values at arc lengths (any shape), m; outside, the value at the nearest end."""
        shape = np.shape(arc_length)
        s = np.clip(np.asarray(arc_length, dtype=float).ravel(), 0.0, self.length)
        breaks, table = self._arrays
        panel = np.clip(np.searchsorted(breaks, s, side="right") - 1, 0, len(table) - 1)
        low, high = breaks[panel], breaks[panel + 1]
        x = (2 * s - low - high) / (high - low)
        return np.asarray((table[panel] * chebyshev.chebvander(x, table.shape[1] - 1)).sum(-1).reshape(shape))

    def value(self, s: float) -> float:
        """Value at one arc length, m, by Clenshaw's recurrence, in a tenth of the time of a call."""
        s = min(max(s, 0.0), self.length)
        panel = min(bisect_right(self.breaks, s), len(self.coefficients)) - 1
        low, high = self.breaks[panel], self.breaks[panel + 1]
        # Twice the coordinate on the panel, since b_k = c_k + 2 x b_(k+1) - b_(k+2).
        x = 2 * (2 * s - low - high) / (high - low)
        c_0, *higher = self.coefficients[panel]
        b = b_next = 0.0
        for c in reversed(higher):
            b, b_next = c + x * b - b_next, b
        return c_0 + x / 2 * b - b_next

    def stretched(self, factor: float) -> Series:
        """Series stretched to `factor` times its length."""
        return Series(tuple(s * factor for s in self.breaks), self.coefficients)

    def times(self, factor: float) -> Series:
        """Series multiplied by a number."""
        return Series(self.breaks, tuple(tuple(factor * c for c in panel) for panel in self.coefficients))


Quantity = float | Series
"""Quantity along a stretch: a constant, or a series of arc length."""

Precurvature = tuple[Quantity, Quantity, Quantity]
"""Components u*_x, u*_y, 1/m, and u*_z, rad/m."""


def vary(quantities: Iterable[Any]) -> bool:
    """Return whether any quantity is a series."""
    return any(isinstance(quantity, Series) for quantity in quantities)


def values(quantity: Quantity, s: Array) -> Array:
    """Values (N,) of a quantity at arc lengths (N,), m."""
    return quantity(s) if isinstance(quantity, Series) else np.full(len(s), quantity)


def at(quantity: Quantity, s: float) -> float:
    """Value of a quantity at one arc length, m."""
    return quantity.value(s) if isinstance(quantity, Series) else quantity


def stretched(quantity: Any, factor: float) -> Any:
    """A quantity, or none, along a stretch that is `factor` times as long."""
    return quantity.stretched(factor) if isinstance(quantity, Series) else quantity


def times(quantity: Quantity, factor: float) -> Quantity:
    """Quantity, a number or a series, multiplied by a number."""
    return quantity.times(factor) if isinstance(quantity, Series) else quantity * factor


def turned(x: Quantity, y: Quantity, angle: float) -> tuple[Quantity, Quantity]:
    """A bend direction turned about z."""
    cos, sin = math.cos(angle), math.sin(angle)
    if not isinstance(x, Series) and not isinstance(y, Series):
        return cos * x - sin * y, sin * x + cos * y
    return plus(times(x, cos), times(y, -sin)), plus(times(x, sin), times(y, cos))


def plus(a: Quantity, b: Quantity) -> Quantity:
    """Sum of two quantities, each a number or a series on the same panels."""
    if not isinstance(a, Series):
        a, b = b, a
    if not isinstance(a, Series):
        return a + b  # type: ignore[operator]
    other = b.coefficients if isinstance(b, Series) else ((b,),) * len(a.coefficients)
    table = []
    for one, more in zip(a.coefficients, other, strict=True):
        row = np.zeros(max(len(one), len(more)))
        row[: len(one)] += one
        row[: len(more)] += more
        table.append(tuple(row.tolist()))
    return Series(a.breaks, tuple(table))


def breaks_of(quantities: Sequence[Quantity], length: float) -> Array:
    """Arc lengths of all panel ends of the quantities along a stretch, with both of its ends, m."""
    inner = {s for q in quantities if isinstance(q, Series) for s in q.breaks if 0 < s < length}
    return np.array([0.0, *sorted(inner), length])


def on_panels(quantity: Quantity, breaks: Array) -> list[Array]:
    """Coefficients of a quantity on panels between `breaks`, which are its own panels or parts of them."""
    if not isinstance(quantity, Series):
        return [np.array([quantity])] * (len(breaks) - 1)
    out = []
    for low, high in pairwise(breaks):
        # The middle of a panel lies inside one of the series; ends may differ by round-off.
        panel = min(int(np.searchsorted(quantity.breaks, (low + high) / 2)) - 1, len(quantity.coefficients) - 1)
        coefficients = np.array(quantity.coefficients[panel])
        first, last = quantity.breaks[panel : panel + 2]
        if first == low and last == high:
            out.append(coefficients)
            continue
        ends = (2 * np.array([low, high]) - first - last) / (last - first)
        out.append(part_of(coefficients, ends))
    return out


def part_of(coefficients: Array, ends: Array) -> Array:
    """Coefficients (D, ...) of the same polynomials on the part of [-1, 1] between two `ends` (2,)."""
    middle, half = ends.mean(), (ends[1] - ends[0]) / 2
    return np.asarray(
        chebyshev.chebinterpolate(lambda x: chebyshev.chebval(middle + half * x, coefficients).T, len(coefficients) - 1)
    )


def zeros(coefficients: Array, imaginary: float, negligible: float | None = None) -> Array:
    """Real roots of a Chebyshev series inside -1 .. 1.

    Args:
        imaginary: largest imaginary part of a root that counts as real.
        negligible: size of coefficients that are round-off, by default 1e-14 of the largest.
    """
    size = 1e-14 * float(np.abs(coefficients).max()) if negligible is None else negligible
    trimmed = chebyshev.chebtrim(coefficients, size)
    roots = chebyshev.chebroots(trimmed) if len(trimmed) > 1 else np.zeros(0)
    return np.asarray(roots.real[(np.abs(roots.imag) < imaginary) & (np.abs(roots.real) < 1 - 1e-9)])


def extremes(quantities: Sequence[Quantity], length: float) -> tuple[float, float]:
    """Smallest and largest norm of quantities along a stretch; smallest and largest value of a single quantity."""
    extrema: list[float] = []
    breaks = breaks_of(quantities, length)
    for panels in zip(*(on_panels(q, breaks) for q in quantities), strict=True):
        total = panels[0] if len(panels) == 1 else reduce(chebyshev.chebadd, (chebyshev.chebmul(p, p) for p in panels))
        inside = zeros(chebyshev.chebder(total), 1e-4, 1e-14 * float(np.abs(total).max()))
        extrema += np.atleast_1d(chebyshev.chebval(np.array([-1.0, 1.0, *inside]), total)).tolist()
    if len(quantities) == 1:
        return min(extrema), max(extrema)
    return max(min(extrema), 0.0) ** 0.5, max(max(extrema), 0.0) ** 0.5


def spline(arc_length: Array, values: Array) -> Series:
    """Interpolating spline of degree 5 through values (k,) at rising arc lengths (k,) from 0.

    It is four times continuously differentiable, without knots at the two points next to either end. Through six points
    or fewer it is a polynomial.
    """
    degree = min(5, len(arc_length) - 1)
    polynomials = scipy.interpolate.PPoly.from_spline(
        scipy.interpolate.make_interp_spline(arc_length, values, k=degree)
    )
    # Knots outside, and repeated knots, bound pieces of no length.
    inside = np.flatnonzero((np.diff(polynomials.x) > 0) & (polynomials.x[:-1] >= arc_length[0]))
    coefficients, breaks = polynomials.c[:, inside], polynomials.x[[*inside, inside[-1] + 1]]

    def on_panels(x: Array) -> Any:
        return np.polyval(coefficients, (x[:, None] + 1) / 2 * np.diff(breaks))

    # The same polynomials in the Chebyshev basis.
    table = chebyshev.chebinterpolate(on_panels, len(coefficients) - 1).T
    return Series(tuple(breaks.tolist()), tuple(map(tuple, table.tolist())))


def expand(function: Callable[[float], ArrayLike], length: float, name: str, size: int) -> tuple[Quantity, ...]:
    """Expand the `size` components of a function of arc length 0 .. `length` (m) as constants or series.

    Raises:
        InputError: the function does not return `size` finite numbers, or is not smooth; the message has the place.
    """

    def sample(low: float, high: float, x: Array) -> Array:
        return np.array([_values(function, (low + high) / 2 + t * (high - low) / 2, name, size) for t in x])

    # Points between the nodes, at which the expansion is compared with the function.
    ends = np.array([-1.0, -0.6, 0.1, 1.0])
    scale = np.maximum(np.abs(sample(0.0, length, np.concatenate([ends, _NODES]))).max(0), 1e-300)
    # Round-off of the function scales with its largest component. Smaller ones are not resolved beyond a thousandth of
    # that.
    scale = np.maximum(scale, 1e-3 * scale.max())
    panels: list[tuple[float, float, Array]] = []
    stack = [(0.0, length, 0)]
    while stack:
        low, high, depth = stack.pop()
        values = sample(low, high, _NODES)
        coefficients = _FIT @ values
        # A constant component stays exact.
        constant = np.ptp(values, axis=0) == 0
        coefficients[:, constant] = np.eye(POINTS)[:, :1] * values[0, constant]
        # Between the nodes the function must agree with its expansion, or a spike would not be noticed.
        between = np.abs(sample(low, high, ends) - chebyshev.chebval(ends, coefficients).T)
        # Three in a row, since every other coefficient of an even or odd function is 0.
        if (np.abs(coefficients[-3:]) <= TOLERANCE * scale).all() and (between <= 1e-11 * scale).all():
            panels.append((low, high, coefficients))
            continue
        if depth == HALVINGS:
            raise InputError(
                f"{name} is not smooth near {(low + high) / 2 * 1e3:.4g} mm of its piece; a jump or a corner must lie "
                "where two pieces meet"
            )
        middle = (low + high) / 2
        # The left half is on top of the stack, so that panels are in order.
        stack += [(middle, high, depth + 1), (low, middle, depth + 1)]
    _must_join(panels, scale, name)
    return tuple(_trimmed(panels, k, scale[k]) for k in range(size))


def _values(function: Callable[[float], ArrayLike], s: float, name: str, size: int) -> Array:
    values: Array = call_user_function(
        f"{name} of a piece", lambda s: np.asarray(function(s), dtype=float).reshape(-1), float(s)
    )
    if values.shape != (size,) or not np.isfinite(values).all():
        allowed = "a finite number" if size == 1 else f"{size} finite numbers"
        raise InputError(f"{name} at {s * 1e3:.4g} mm of its piece is {values.tolist()}; it must be {allowed}")
    return values


def _must_join(panels: list[tuple[float, float, Array]], scale: Array, name: str) -> None:
    """Raise InputError for jumps and corners between panels."""
    for (low, middle, left), (_, high, right) in pairwise(panels):
        jump = np.abs(chebyshev.chebval(1.0, left) - chebyshev.chebval(-1.0, right))
        slopes = [
            chebyshev.chebval(x, chebyshev.chebder(c)) * 2 / (b - a)
            for x, c, a, b in ((1.0, left, low, middle), (-1.0, right, middle, high))
        ]
        # A derivative amplifies errors up to 24^2 times (Markov's inequality), hence its wider bound below.
        corner = np.abs(slopes[0] - slopes[1]) * (high - low)
        if (jump > 1e-10 * scale).any() or (corner > 1e-7 * scale).any():
            raise InputError(
                f"{name} is not smooth at {middle * 1e3:.4g} mm of its piece; a jump or a corner must lie where two "
                "pieces meet"
            )


def _trimmed(panels: list[tuple[float, float, Array]], column: int, scale: float) -> Quantity:
    """Component of a table without coefficients of round-off size; a number if only a constant is left."""
    table = [chebyshev.chebtrim(c[:, column], TOLERANCE * scale / 10) for *_, c in panels]
    first = float(table[0][0])
    if all(len(c) == 1 and abs(c[0] - first) <= TOLERANCE * scale for c in table):
        return first
    breaks = (0.0, *(high for _, high, _ in panels))
    return Series(breaks, tuple(tuple(c.tolist()) for c in table))


Along = float | Series | Callable[[float], float]
"""Stiffness of a piece: a number, a series, or a function of the arc length of the piece."""

# Of a piece, m; its curvature, 1/m, and its natural twist, rad/m: a turn in 6 mm.
LENGTH, BEND, TWIST = Typical(3e-4, 10.0), Typical(0.1, 2000.0), Typical(0.0, 1000.0)


@dataclass(frozen=True)
class Slots(Displayed):
    """Geometry of the slots in a piece, for the strain of the remaining material.

    Slotted stretches, all alike, alternate with full rings, and both bend as beams under one moment:
    `physics.strain.slotted_strain_ratio`.

    Raises:
        InputError: a fraction that is not in (0, 1].
    """

    share: Annotated[float, REQUIRED, POSITIVE, "slotted fraction of the length of the piece, at most 1"] = 1.0
    one_sided: Annotated[bool, "slots on one side of the bend only, which shifts the neutral axis"] = False

    def __post_init__(self) -> None:
        instance("one_sided of the slots", self.one_sided, bool)
        if positive("share of the slots", self.share) > 1:
            raise InputError(f"share of the slots is {self.share:g}; it must be at most 1")

    def strain_ratio(self, bending_factor: Any) -> Any:
        """Strain relative to the whole tube, for slots that leave this fraction of the bending stiffness."""
        return slotted_strain_ratio(bending_factor, self.share, symmetric=not self.one_sided)


@dataclass(frozen=True)
class Piece(Displayed):
    """A stretch of a tube with a precurvature and stiffnesses of its own.

    Raises:
        InputError: a value is not finite or out of its range, or a function is not smooth.
    """

    length: float
    """Length, m, > 0."""
    precurvature: Any
    """Precurvature u* (1/m) in the tube's own frame, which rotates with the tube. A number (about x), three numbers (x,
    y, z; z is the natural twist), or a function of the piece's own arc length (m) that returns either. A function must
    be smooth: it is converted to polynomials at once. Jumps belong between two pieces.
    """
    bending_stiffness: Any = None
    """Bending stiffness, N m^2: a number, a function of arc length, or None for that of the tube."""
    torsional_stiffness: Any = None
    """Torsional stiffness, N m^2: a number, a function of arc length, or None for that of the tube."""
    slots: Slots | None = None
    """Slots, for the strain only; the stiffnesses already include them."""

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        slots: Any = self.slots
        if isinstance(slots, Mapping) and set(slots) <= {field.name for field in fields(Slots)}:  # as JSON has them
            set_field(self, "slots", Slots(**slots))
        instance("slots", self.slots, Slots, optional=True)
        set_field(self, "length", positive("length of a piece", self.length))
        set_field(self, "precurvature", _precurvature(self.precurvature, self.length))
        for field in ("bending_stiffness", "torsional_stiffness"):
            stiffness = getattr(self, field)
            if stiffness is not None:
                set_field(self, field, _stiffness(field, stiffness, self.length))

    @classmethod
    def helix(cls, length: float, radius: float, pitch: float, *, left: bool = False, **stiffness: Any) -> Piece:
        """Helix of a radius and a pitch (m), wound like a right-handed screw unless `left`.

        Its curvature is R / (R^2 + h^2) and its torsion h / (R^2 + h^2), with h = p / 2 pi.
        """
        h = positive("pitch", pitch, zero=True) / (2 * math.pi)
        square = positive("radius", radius) ** 2 + h**2
        return cls(length, (radius / square, 0.0, (-h if left else h) / square), **stiffness)

    @classmethod
    def table(cls, arc_length: ArrayLike, precurvature: ArrayLike, **stiffness: Any) -> Piece:
        """Precurvature (k, 3) at rising arc lengths (k,) from 0 (m), joined by an interpolating spline of degree 5.

        Raises:
            InputError: the table is not in order, not finite, or has fewer than two rows.
        """
        s, u = np.asarray(arc_length, dtype=float), np.asarray(precurvature, dtype=float)
        check_table(s, u, "arc_length", 1.0)
        parts = tuple(float(c[0]) if (c == c[0]).all() else spline(s, c) for c in u.T)
        return cls(float(s[-1]), parts, **stiffness)

    @property
    def largest_curvature(self) -> float:
        """Largest |u*_xy| along the piece, 1/m."""
        return _largest(self.precurvature, self.length)

    @property
    def plain(self) -> bool:
        """True for an arc about x, or a straight piece, with the tube's own stiffnesses and no slots."""
        x, y, z = self.precurvature
        as_tube = self.bending_stiffness is None and self.torsional_stiffness is None and self.slots is None
        return as_tube and not isinstance(x, Series) and (y, z) == (0.0, 0.0)

    def bending_factor(self, tube_stiffness: float) -> float:
        """Smallest bending stiffness along the piece over that of the whole tube, N m^2, at most 1."""
        stiffness = (
            tube_stiffness if self.bending_stiffness is None else extremes([self.bending_stiffness], self.length)[0]
        )
        return min(1.0, float(stiffness) / tube_stiffness)

    def strain_ratio(self, tube_stiffness: float) -> float:
        """Largest strain relative to a piece without slots, in a tube of bending stiffness `whole` (N m^2)."""
        return 1.0 if self.slots is None else float(self.slots.strain_ratio(self.bending_factor(tube_stiffness)))

    def stretched(self, factor: float) -> Piece:
        """Piece `factor` times as long, with series stretched along it."""
        return replace(
            self,
            length=self.length * factor,
            precurvature=tuple(stretched(part, factor) for part in self.precurvature),
            bending_stiffness=stretched(self.bending_stiffness, factor),
            torsional_stiffness=stretched(self.torsional_stiffness, factor),
        )

    def stiffened(self, factor: float, torsional_factor: float | None = None) -> Piece:
        """Piece with its own stiffnesses multiplied by `factor`, or in torsion by `torsional_factor`."""
        factors = factor, factor if torsional_factor is None else torsional_factor
        stiffnesses = self.bending_stiffness, self.torsional_stiffness
        bending, torsional = (None if a is None else times(a, b) for a, b in zip(stiffnesses, factors, strict=True))
        return replace(self, bending_stiffness=bending, torsional_stiffness=torsional)

    def bent(self, change: float) -> Piece:
        """Piece with `change` (1/m) added to its precurvature, about its mean bending axis.

        A piece without a mean direction, as a straight one or a helix of full turns, is bent about x.
        """
        x, y, z = self.precurvature
        s = np.linspace(0.0, self.length, POINTS)
        mean = complex(*(float(np.mean(values(q, s))) for q in (x, y)))
        # A smaller mean is round-off of a helix of whole turns, and has no direction.
        axis = mean / abs(mean) if abs(mean) > 1e-9 * self.largest_curvature else 1.0 + 0.0j
        return replace(self, precurvature=(plus(x, change * axis.real), plus(y, change * axis.imag), z))

    def scaled(self, factor: float) -> Piece:
        """Piece with `factor` times the curvature and the same natural twist."""
        x, y, z = self.precurvature
        return replace(self, precurvature=(times(x, factor), times(y, factor), z))


def bent_along(pieces: Sequence[Piece], x: tuple[float, ...], y: tuple[float, ...]) -> tuple[Piece, ...]:
    """Pieces with a precurvature added that varies along all of them.

    Args:
        x, y: Chebyshev coefficients of what is added about x and y, along the whole, 1/m.
    """
    ends = np.cumsum([0.0, *(piece.length for piece in pieces)])
    added = [Series((0.0, float(ends[-1])), (part,)) for part in (x, y)]
    out = []
    for piece, low in zip(pieces, ends, strict=False):
        breaks = breaks_of(piece.precurvature[:2], piece.length)
        bends = []
        for quantity, more in zip(piece.precurvature, added, strict=False):
            panels = zip(on_panels(quantity, breaks), on_panels(more, low + breaks), strict=True)
            table = tuple(tuple(chebyshev.chebadd(*both).tolist()) for both in panels)
            bends.append(Series(tuple(breaks.tolist()), table))
        out.append(replace(piece, precurvature=(*bends, piece.precurvature[2])))
    return tuple(out)


def check_table(s: Array, u: Array, name: str, unit: float) -> None:
    """Raise InputError unless arc lengths (k,), shown in `unit` (m), rise from 0 and u is (k, 3), all finite."""
    if s.ndim != 1 or len(s) < 2 or u.shape != (len(s), 3):
        raise InputError(f"a table has {len(np.atleast_1d(s))} arc lengths; it must have two or more, with u* of each")
    if not (np.isfinite(s).all() and np.isfinite(u).all()):
        raise InputError("a table has a number that is not finite; every number must be")
    if s[0] != 0:
        raise InputError(f"{name} of a table begins at {s[0] / unit:g}; it must begin at 0")
    fall = np.flatnonzero(np.diff(s) <= 0)
    if len(fall):
        k = int(fall[0])
        raise InputError(
            f"{name} of a table is {s[k + 1] / unit:g} in row {k + 2}, after {s[k] / unit:g}; it must rise from row to "
            "row"
        )


def _precurvature(entry: Any, length: float) -> Precurvature:
    """Precurvature from a number (about x), three components, or a function of arc length."""
    if callable(entry) and not isinstance(entry, Series):
        x, y, z = expand(lambda s: _vector(entry(s)), length, "precurvature", 3)
        return x, y, z
    if isinstance(entry, str):
        raise InputError(f"precurvature is {entry!r}; it must be a number, three numbers, or a function")
    several = isinstance(entry, list | tuple) or (isinstance(entry, np.ndarray) and entry.ndim > 0)
    parts = tuple(entry) if several else (entry, 0.0, 0.0)
    if len(parts) != 3:
        raise InputError(f"precurvature has {len(parts)} components; it must have three, about x, y and z")
    x, y, z = (_quantity("precurvature", part, length) for part in parts)
    return x, y, z


def _vector(value: ArrayLike) -> Array:
    try:
        out = np.asarray(value, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        raise InputError(f"precurvature is {value!r}; it must be one number or three, or a function of them") from None
    return np.array([out[0], 0.0, 0.0]) if len(out) == 1 else out


def _quantity(name: str, entry: Any, length: float) -> Quantity:
    if isinstance(entry, Mapping):  # a series in JSON
        if set(entry) != {field.name for field in fields(Series)}:
            raise InputError(f"{name} is {entry!r}; it must be a number or a function of the arc length")
        entry = Series(**entry)
    if not isinstance(entry, Series):
        return finite(name, entry)
    if abs(entry.length - length) > 1e-12 * length:
        raise InputError(f"{name} is given for {entry.length:g} m; it must cover the whole piece, {length:g} m")
    return entry


def _stiffness(name: str, entry: Any, length: float) -> Quantity:
    function = callable(entry) and not isinstance(entry, Series)
    quantity = expand(entry, length, name, 1)[0] if function else _quantity(name, entry, length)
    smallest = extremes([quantity], length)[0]
    if smallest <= 0:
        raise InputError(f"{name} of a piece is {smallest:g} N m^2; it must be greater than 0")
    return quantity


@lru_cache(maxsize=1024)
def _largest(precurvature: Precurvature, length: float) -> float:
    x, y, _ = precurvature
    if not isinstance(x, Series) and not isinstance(y, Series):
        return math.hypot(x, y)
    return extremes([x, y], length)[1]
