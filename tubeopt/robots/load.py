"""External loads on a robot: forces and moments at its tip and along its arm, and its weight (SI)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from functools import cached_property
from numbers import Real
from typing import Annotated, Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, call_user_function, choice, finite, items, positive, triple, vector
from ..files.field_metadata import NOT_NEGATIVE, OneOf, key, unit
from ..typing import Array
from .tubes import Tube, mass_per_length

Vector = tuple[float, float, float]

FRAMES = ("world", "tip")

# Parts of a load per length.
FORCE, MOMENT = slice(0, 3), slice(3, 6)

ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Stretch:
    """A constant load per length on a stretch of the arm, in world axes."""

    start: Annotated[float, key("from_mm"), NOT_NEGATIVE, "arc length from the base plate"]
    end: Annotated[float, key("to_mm"), "arc length from the base plate"]
    force: Annotated[Vector, unit("mN_per_m"), "force per length"] = ZERO
    moment: Annotated[
        Vector, unit("mN_m_per_m"), "moment per length; its axial component acts on the outermost tube"
    ] = ZERO


@dataclass(frozen=True)
class PointLoad:
    """Force and moment at one point of the arm, in world axes."""

    at: Annotated[float, unit("mm"), NOT_NEGATIVE, "arc length from the base plate"]
    force: Annotated[Vector, unit("mN"), "force at the point"] = ZERO
    moment: Annotated[
        Vector,
        unit("mN_m"),
        "moment; its axial component acts on the outermost tube, at the end of the arm on the innermost",
    ] = ZERO


@dataclass(frozen=True)
class Load(Displayed):
    """External forces and moments on a robot; world axes are the axes of the plate.

    Raises:
        InputError: a vector that is not three finite numbers, an unknown frame, a stretch or point behind the plate.
    """

    force: Annotated[Vector, key("tip_force_mN"), "force on the tip in the base frame"] = ZERO
    """Force (3,) on the tip, N."""
    moment: Annotated[Vector, key("tip_moment_mN_m"), "moment on the tip in the base frame"] = ZERO
    """Moment (3,) on the tip, N m; its axial part twists the tube that ends last, of several the innermost."""
    _: KW_ONLY
    frame: Annotated[
        str, OneOf(FRAMES), "frame of tip force and moment: world (constant direction) or tip (they turn with the tip)"
    ] = "world"
    """Frame of tip force and moment: "world" for dead loads, "tip" for loads that turn with the tip.

    The frame of the tip is its Bishop frame, `tip_rotation` of an equilibrium.
    """
    distributed: Vector | Callable[[float], ArrayLike] | tuple[Stretch, ...] | None = None
    """Load per length in world axes: a force (3,), N/m, along the whole arm, a function, or stretches. A function of
    arc length (m from the plate) returns (3,), or (6,) with a moment, N. A stretch is (start, end, force (3,)) or
    (start, end, force (3,), moment (3,)) and constant. The axial part of a moment twists the outermost tube there.
    """
    points: Annotated[tuple[PointLoad, ...], "forces and moments at points of the arm, in the base frame"] = ()
    """Loads at points: (arc length, force (3,)) or (arc length, force (3,), moment (3,)) each, m, N and N m. The
    axial part of a moment twists the outermost tube there; at the end of the arm, the tube of a tip moment.
    """
    gravity: Annotated[
        Vector | None, unit("m_per_s2"), "gravity vector in the base frame; acts on the mass of the tubes"
    ] = None
    """Gravity (3,), m/s^2, on the tubes in front of the plate, or None."""

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "force", triple("force", self.force))
        set_field(self, "moment", triple("moment", self.moment))
        choice("frame", self.frame, FRAMES)
        if self.gravity is not None:
            set_field(self, "gravity", triple("gravity", self.gravity))
        if self.distributed is not None and not callable(self.distributed):
            set_field(self, "distributed", _distributed(self.distributed))
        points = items("points", self.points, object, POINT)
        set_field(self, "points", tuple(_point(k, entry) for k, entry in enumerate(points)))

    @cached_property
    def has_energy(self) -> bool:
        """True for forces of constant direction without moments: stable equilibria are then minima of an energy."""
        has_moment = any(any(part.moment) for part in self.acting) or _has_moment(self.distributed)
        return not has_moment and (self.frame == "world" or not any(self.force))

    @property
    def acting(self) -> tuple[PointLoad, ...]:
        """Forces and moments at points; the last one is that at the tip, in its frame, at infinite arc length."""
        return *self.points, PointLoad(np.inf, self.force, self.moment)

    def require_energy(self, untold: str) -> None:
        """Raise InputError for a load without an energy; its message ends with the quantity `untold`."""
        if not self.has_energy:
            raise InputError(f"load has a moment or turns with the tip; it has no energy, so {untold}")

    @property
    def tip_force_only(self) -> bool:
        """True if the only load is a dead force at the tip."""
        return self.has_energy and self.distributed is None and not self.points and self.gravity is None

    def scaled(self, factor: float) -> Load:
        """The load times a factor."""

        def times(value: Vector) -> Vector:
            return triple("force", np.multiply(factor, value))

        along = self.distributed
        if isinstance(along, Scaled):
            # Continuation scales a load again and again: factors multiply, or calls would nest.
            along = Scaled(along.function, factor * along.factor)
        elif callable(along):
            along = Scaled(along, factor)
        elif along is not None and _stretches(along):
            along = tuple(replace(part, force=times(part.force), moment=times(part.moment)) for part in along)
        elif along is not None:
            along = triple("distributed", factor * np.array(along, dtype=float))
        return replace(
            self,
            force=times(self.force),
            moment=times(self.moment),
            distributed=along,
            points=tuple(replace(p, force=times(p.force), moment=times(p.moment)) for p in self.points),
            gravity=None if self.gravity is None else times(self.gravity),
        )

    def cuts(self) -> Array:
        """Arc lengths where the force on a cross-section jumps or breaks, m."""
        positions = [part.at for part in self.points]
        if self.distributed is not None and _stretches(self.distributed):
            positions += [end for part in self.distributed for end in (part.start, part.end)]
        return np.array(positions, dtype=float)

    def bounds(self, length: float, mass: float) -> tuple[float, float]:
        """Upper bounds on the force on any cross-section of an arm, N, and on the applied moments, N m.

        Args:
            length: length of the arm, m.
            mass: mass of its tubes, kg.
        """
        along = turning = 0.0
        if self.distributed is not None:
            per_length = self.per_length(np.linspace(0, length, 33)[1:-1])
            along, turning = (
                float(np.linalg.norm(per_length[:, k], axis=-1).max(initial=0.0)) for k in (FORCE, MOMENT)
            )
        weight = math.hypot(*self.gravity) * mass if self.gravity else 0.0
        force = sum(math.hypot(*part.force) for part in self.acting) + weight + along * length
        return float(force), sum(math.hypot(*part.moment) for part in self.acting) + turning * length

    def per_length(self, arc_length: Array) -> Array:
        """Distributed load (..., 6) at arc lengths (...): force, N/m, and moment, N."""
        out = np.zeros((*arc_length.shape, 6))
        along = self.distributed
        if along is None:
            return out
        if callable(along):
            # The function returns as many numbers everywhere as at the plate.
            size = 6 if _has_moment(along) else 3
            for index in np.ndindex(arc_length.shape):
                s = float(arc_length[index])
                value = call_user_function("distributed", along, s)
                out[index][:size] = vector(f"distributed at {s:g} m", value, size, "as many as at 0 m")
        elif _stretches(along):
            for part in along:
                out[(arc_length > part.start) & (arc_length < part.end)] += (*part.force, *part.moment)
        else:
            out[..., FORCE] = along
        return out


@dataclass(frozen=True)
class Scaled:
    """Function of arc length times a factor."""

    function: Callable[[float], ArrayLike]
    factor: float

    def __call__(self, arc_length: float) -> Array:
        return np.asarray(self.factor * np.asarray(self.function(arc_length), dtype=float))


@dataclass(frozen=True)
class Sum:
    """Sum of the distributed loads of two loads, as a function of arc length."""

    first: Load
    second: Load

    def __call__(self, arc_length: float) -> Array:
        at = np.array(arc_length)
        total = self.first.per_length(at) + self.second.per_length(at)
        return total if _has_moment(self.first.distributed) or _has_moment(self.second.distributed) else total[FORCE]


def between(start: Load, end: Load, t: float) -> Load:
    """Interpolate linearly between loads, from `start` at t = 0 to `end` at t = 1.

    Raises:
        InputError: their frames differ.
    """
    if start.frame != end.frame and not (start.has_energy and not any(start.force)):
        raise InputError(
            f"the load of the start has the frame {start.frame!r}, the target load {end.frame!r}; they must be the same"
        )
    first, second = start.scaled(1 - t), end.scaled(t)

    def total(a: Vector | None, b: Vector | None) -> Vector:
        return triple("sum", np.add(a or (0, 0, 0), b or (0, 0, 0)))

    distributed: Any = None
    if first.distributed is not None or second.distributed is not None:
        distributed = Sum(first, second)
    return Load(
        total(first.force, second.force),
        total(first.moment, second.moment),
        frame=end.frame,
        distributed=distributed,
        points=(*first.points, *second.points),
        gravity=None if first.gravity is None and second.gravity is None else total(first.gravity, second.gravity),
    )


def masses(tubes: Sequence[Tube], load: Load) -> Array:
    """Masses (n,) per length of tubes, kg/m; zeros if the load has no gravity."""
    if load.gravity is None or not any(load.gravity):
        return np.zeros(len(tubes))
    return known_masses(tubes, "gravity is given")


def known_masses(tubes: Sequence[Tube], why: str) -> Array:
    """Masses (n,) per length of tubes, kg/m; raises InputError, which begins with `why`, if one is unknown."""
    known = [mass_per_length(tube) for tube in tubes]
    for i, mass in enumerate(known, start=1):
        if mass is None:
            raise InputError(
                f"{why}, but tube {i} has neither a material density nor a mass_per_length; give one of them"
            )
    return np.array(known, dtype=float)


def _has_moment(along: Any) -> bool:
    """Return whether a distributed load has moments; a function with moments returns six numbers."""
    if callable(along):
        return bool(np.size(call_user_function("distributed", along, 0.0)) == 6)
    return _stretches(along) and any(any(part.moment) for part in along)


def _stretches(value: Any) -> TypeGuard[tuple[Stretch, ...]]:
    return isinstance(value, tuple) and bool(value) and isinstance(value[0], Stretch)


def _distributed(value: Any) -> Vector | tuple[Stretch, ...]:
    if isinstance(value, Sequence) and value and not isinstance(value[0], Real):
        return tuple(_stretch(k, entry) for k, entry in enumerate(value))
    return triple("distributed", value)


STRETCH = "(start, end, force (x, y, z)), or with a moment (start, end, force, moment)"
POINT = "(arc length, force (x, y, z)), or with a moment (arc length, force, moment)"


def _stretch(k: int, entry: Any) -> Stretch:
    name = f"distributed[{k}]"
    start, end, *loads = _parts(name, entry, 2, STRETCH)
    start, end = positive(f"start of {name}", start, zero=True), finite(f"end of {name}", end)
    if end <= start:
        raise InputError(f"end of {name} is {end:g} m; it must be greater than its start, {start:g} m")
    return Stretch(start, end, *_wrench(name, loads))


def _point(k: int, entry: Any) -> PointLoad:
    name = f"points[{k}]"
    at, *loads = _parts(name, entry, 1, POINT)
    return PointLoad(positive(f"arc length of {name}", at, zero=True), *_wrench(name, loads))


def _parts(name: str, entry: Any, minimum: int, allowed: str) -> tuple[Any, ...]:
    """Arc lengths, force and optional moment of an entry."""
    if isinstance(entry, Stretch | PointLoad):
        return tuple(getattr(entry, field.name) for field in fields(entry))
    try:
        parts = tuple(entry)
    except TypeError:
        parts = ()
    if not minimum + 1 <= len(parts) <= minimum + 2:
        raise InputError(f"{name} is {entry!r}; it must be {allowed}")
    return parts


def _wrench(name: str, loads: Sequence[Any]) -> list[Vector]:
    """Force and optional moment of an entry `name`."""
    return [triple(f"{what} of {name}", value) for what, value in zip(("force", "moment"), loads, strict=False)]
