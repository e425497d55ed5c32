"""A piece of a tube: any precurvature and any stiffness along a stretch of it (SI)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, finite, instance, positive
from ..files.field_metadata import POSITIVE, REQUIRED, Typical
from ..physics.strain import slotted_strain_ratio
from ..typing import Array
from .series import POINTS, Quantity, Series, expand, extremes, plus, spline, stretched, times, values

Along = float | Series | Callable[[float], float]
"""What may be given for a stiffness: a number, a series, or a function of the piece's own arc length."""

LENGTH, BEND, TWIST = Typical(3e-4, 10.0), Typical(0.1, 2000.0), Typical(0.0, 1000.0)
"""Of a piece, m; its curvature, 1/m, and its natural twist, rad/m: a turn in 6 mm."""


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
    """N m^2, a number or such a function; None is that of the tube."""
    torsional_stiffness: Any = None
    """Torsional stiffness, N m^2: a number, a function of arc length, or None for that of the tube."""
    slots: Slots | None = None
    """Slots, for the strain only; the stiffnesses already include them."""

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        slots: Any = self.slots
        if isinstance(slots, Mapping) and set(slots) <= {one.name for one in fields(Slots)}:  # as JSON has them
            set_field(self, "slots", Slots(**slots))
        instance("slots", self.slots, Slots, optional=True)
        set_field(self, "length", positive("length of a piece", self.length))
        set_field(self, "precurvature", _precurvature(self.precurvature, self.length))
        for field in ("bending_stiffness", "torsional_stiffness"):
            given = getattr(self, field)
            if given is not None:
                set_field(self, field, _stiffness(field, given, self.length))

    @classmethod
    def helix(cls, length: float, radius: float, pitch: float, *, left: bool = False, **stiffness: Any) -> Piece:
        """A helix of a radius and a pitch (m), wound like a right-handed screw unless `left`.

        Curvature R / (R^2 + (p / 2 pi)^2), torsion p / 2 pi over the same.
        """
        lead = positive("pitch", pitch, zero=True) / (2 * math.pi)
        size = positive("radius", radius) ** 2 + lead**2
        return cls(length, (radius / size, 0.0, (-lead if left else lead) / size), **stiffness)

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
        """Largest |u*_xy| along it, 1/m."""
        return _largest(self.precurvature, self.length)

    @property
    def plain(self) -> bool:
        """True for an arc about x, or a straight piece, with the tube's own stiffnesses and no slots."""
        x, *rest = self.precurvature
        own = self.bending_stiffness is None and self.torsional_stiffness is None and self.slots is None
        return own and not isinstance(x, Series) and tuple(rest) == (0.0, 0.0)

    def bending_factor(self, whole: float) -> float:
        """The least of its bending stiffness along it, of that of the whole tube, N m^2; at most 1."""
        own = whole if self.bending_stiffness is None else extremes([self.bending_stiffness], self.length)[0]
        return min(1.0, float(own) / whole)

    def strain_ratio(self, whole: float) -> float:
        """Largest strain relative to a piece without slots, in a tube of bending stiffness `whole` (N m^2)."""
        return 1.0 if self.slots is None else float(self.slots.strain_ratio(self.bending_factor(whole)))

    def stretched(self, factor: float) -> Piece:
        """The piece `factor` times as long; what varies along it is stretched."""
        return replace(
            self,
            length=self.length * factor,
            precurvature=tuple(stretched(part, factor) for part in self.precurvature),
            bending_stiffness=stretched(self.bending_stiffness, factor),
            torsional_stiffness=stretched(self.torsional_stiffness, factor),
        )

    def stiffened(self, factor: float, torsional_factor: float | None = None) -> Piece:
        """The piece with what stiffnesses of its own it has `factor` times as large, in torsion by a factor of its own
        where one is given."""
        factors = factor, factor if torsional_factor is None else torsional_factor
        own = self.bending_stiffness, self.torsional_stiffness
        bending, torsional = (None if a is None else times(a, b) for a, b in zip(own, factors, strict=True))
        return replace(self, bending_stiffness=bending, torsional_stiffness=torsional)

    def bent(self, change: float) -> Piece:
        """The piece with `change` (1/m) added to its precurvature, about the axis that it is bent about on the whole;
        about x where it is straight or bent to all sides alike."""
        x, y, z = self.precurvature
        s = np.linspace(0.0, self.length, POINTS)
        mean = complex(*(float(np.mean(values(q, s))) for q in (x, y)))
        axis = mean / abs(mean) if abs(mean) > 1e-9 * self.largest_curvature else 1.0 + 0.0j
        return replace(self, precurvature=(plus(x, change * axis.real), plus(y, change * axis.imag), z))

    def scaled(self, factor: float) -> Piece:
        """The piece bent `factor` times as much, with the same natural twist."""
        x, y, z = self.precurvature
        return replace(self, precurvature=(times(x, factor), times(y, factor), z))


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


def _precurvature(given: Any, length: float) -> tuple[Quantity, Quantity, Quantity]:
    """u* as three quantities."""
    if callable(given) and not isinstance(given, Series):
        x, y, z = expand(lambda s: _vector(given(s)), length, "precurvature", 3)
        return x, y, z
    if isinstance(given, str):
        raise InputError(f"precurvature is {given!r}; it must be a number, three numbers, or a function")
    several = isinstance(given, list | tuple) or (isinstance(given, np.ndarray) and given.ndim > 0)
    parts = tuple(given) if several else (given, 0.0, 0.0)
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


def _quantity(name: str, given: Any, length: float) -> Quantity:
    if isinstance(given, Mapping):  # a series, as JSON has it
        if set(given) != {one.name for one in fields(Series)}:
            raise InputError(f"{name} is {given!r}; it must be a number or a function of the arc length")
        given = Series(**given)
    if not isinstance(given, Series):
        return finite(name, given)
    if abs(given.length - length) > 1e-12 * length:
        raise InputError(f"{name} is given for {given.length:g} m; it must cover the whole piece, {length:g} m")
    return given


def _stiffness(name: str, given: Any, length: float) -> Quantity:
    series = callable(given) and not isinstance(given, Series)
    quantity = expand(given, length, name, 1)[0] if series else _quantity(name, given, length)
    least = extremes([quantity], length)[0]
    if least <= 0:
        raise InputError(f"{name} of a piece is {least:g} N m^2; it must be greater than 0")
    return quantity


@lru_cache(maxsize=1024)
def _largest(precurvature: tuple[Quantity, Quantity, Quantity], length: float) -> float:
    x, y, _ = precurvature
    if not isinstance(x, Series) and not isinstance(y, Series):
        return math.hypot(x, y)
    return extremes([x, y], length)[1]
