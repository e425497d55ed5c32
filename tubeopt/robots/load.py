"""What pushes on a robot: forces and a moment at its tip, along its arm, and its weight (SI)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Annotated, Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, choice, finite, items, positive, triple, vector
from ..files.marks import NOT_NEGATIVE, OneOf, key, unit
from ..typing import Array
from .tubes import Tube, mass_per_length

Vector = tuple[float, float, float]

FRAMES = ("world", "tip")


@dataclass(frozen=True)
class Stretch:
    """A constant load per length on a stretch of the arm, in world axes."""

    start: Annotated[float, key("from_mm"), NOT_NEGATIVE, "arc length from the plate"]
    end: Annotated[float, key("to_mm"), "arc length from the plate"]
    force: Annotated[Vector, unit("mN_per_m")]


@dataclass(frozen=True)
class PointForce:
    """A force on the arm, in world axes."""

    at: Annotated[float, unit("mm"), NOT_NEGATIVE, "arc length from the plate"]
    force: Annotated[Vector, unit("mN")]


@dataclass(frozen=True)
class Load(Displayed):
    """External forces and moments on a robot; world axes are those of the plate.

    Raises:
        InputError: a vector that is not three finite numbers, an unknown frame, a stretch or point behind the plate.
    """

    force: Annotated[Vector, key("tip_force_mN"), "force on the tip in axes of the plate"] = (0.0, 0.0, 0.0)
    """N."""
    moment: Annotated[Vector, key("tip_moment_mN_m"), "moment on the tip in axes of the plate"] = (0.0, 0.0, 0.0)
    """N m; its part along the tip turns the tube that ends last."""
    _: KW_ONLY
    frame: Annotated[
        str, OneOf(FRAMES), "of tip force and moment: world keeps their direction, tip turns them with the tip"
    ] = "world"
    """Dead loads are those of the "world"; following ones turn with the Bishop frame of the tip, the `tip_rotation` of
    an equilibrium."""
    distributed: Vector | Callable[[float], ArrayLike] | tuple[Stretch, ...] | None = None
    """N/m in world axes: (3,) all along the arm; a function of arc length (m from the plate) -> (3,); or stretches
    (start, end, (3,)) with a constant load on each."""
    points: Annotated[tuple[PointForce, ...], "forces along the arm, in world axes"] = ()
    """(arc length, (3,)) each, m and N."""
    gravity: Annotated[Vector | None, unit("m_per_s2"), "gravity, which acts on the mass of the tubes"] = None
    """m/s^2; the tubes are those in front of the plate."""

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "force", triple("force", self.force))
        set_field(self, "moment", triple("moment", self.moment))
        choice("frame", self.frame, FRAMES)
        if self.gravity is not None:
            set_field(self, "gravity", triple("gravity", self.gravity))
        if self.distributed is not None and not callable(self.distributed):
            set_field(self, "distributed", _distributed(self.distributed))
        points = items("points", self.points, object, "(arc length, (x, y, z))")
        set_field(self, "points", tuple(_point(k, entry) for k, entry in enumerate(points)))

    @property
    def has_energy(self) -> bool:
        """Whether the load keeps its direction and makes no moment: then equilibria are minima of an energy."""
        return not any(self.moment) and (self.frame == "world" or not any(self.force))

    def require_energy(self, untold: str) -> None:
        """Raise InputError, which ends with what is therefore `untold`, where the load has no energy."""
        if not self.has_energy:
            raise InputError(f"load has a moment or turns with the tip; it has no energy, so {untold}")

    @property
    def tip_force_only(self) -> bool:
        """Whether there is nothing but a dead force at the tip."""
        return self.has_energy and self.distributed is None and not self.points and self.gravity is None

    def scaled(self, factor: float) -> Load:
        """The load times a factor."""

        def times(value: Vector) -> Vector:
            return triple("force", np.multiply(factor, value))

        along = self.distributed
        if isinstance(along, Scaled):
            along = Scaled(along.function, factor * along.factor)
        elif callable(along):
            along = Scaled(along, factor)
        elif along is not None and _stretches(along):
            along = tuple(replace(part, force=times(part.force)) for part in along)
        elif along is not None:
            along = triple("distributed", factor * np.array(along, dtype=float))
        return replace(
            self,
            force=times(self.force),
            moment=times(self.moment),
            distributed=along,
            points=tuple(replace(part, force=times(part.force)) for part in self.points),
            gravity=None if self.gravity is None else times(self.gravity),
        )

    def cuts(self) -> Array:
        """Arc lengths where the force on a cross-section jumps or breaks, m."""
        places = [part.at for part in self.points]
        if self.distributed is not None and _stretches(self.distributed):
            places += [end for part in self.distributed for end in (part.start, part.end)]
        return np.array(places, dtype=float)

    def per_length(self, arc_length: Array) -> Array:
        """(..., 3) `distributed` at arc lengths (...), N/m."""
        out = np.zeros((*arc_length.shape, 3))
        along = self.distributed
        if along is None:
            return out
        if callable(along):
            for index in np.ndindex(arc_length.shape):
                s = float(arc_length[index])
                out[index] = vector(f"distributed at {s:g} m", along(s), 3, "x, y, z")
        elif _stretches(along):
            for part in along:
                out[(arc_length > part.start) & (arc_length < part.end)] += part.force
        else:
            out[:] = along
        return out


@dataclass(frozen=True)
class Scaled:
    """A function of arc length times a factor."""

    function: Callable[[float], ArrayLike]
    factor: float

    def __call__(self, arc_length: float) -> Array:
        return np.asarray(self.factor * np.asarray(self.function(arc_length), dtype=float))


@dataclass(frozen=True)
class Sum:
    """Of the distributed parts of two loads."""

    one: Load
    other: Load

    def __call__(self, arc_length: float) -> Array:
        at = np.array(arc_length)
        return self.one.per_length(at) + self.other.per_length(at)


def between(start: Load, end: Load, t: float) -> Load:
    """(1 - t) times one load and t times another; raises InputError where their frames differ."""
    if start.frame != end.frame and not (start.has_energy and not any(start.force)):
        raise InputError(
            f"the load of the guess is given in the frame {start.frame!r}, the wanted one in {end.frame!r}; "
            "they must be the same"
        )
    one, other = start.scaled(1 - t), end.scaled(t)

    def added(a: Vector | None, b: Vector | None) -> Vector:
        return triple("sum", np.add(a or (0, 0, 0), b or (0, 0, 0)))

    along: Any = None
    if one.distributed is not None or other.distributed is not None:
        along = Sum(one, other)
    gravity = None if one.gravity is None and other.gravity is None else added(one.gravity, other.gravity)
    return Load(
        added(one.force, other.force),
        added(one.moment, other.moment),
        frame=end.frame,
        distributed=along,
        points=(*one.points, *other.points),
        gravity=gravity,
    )


def masses(tubes: Sequence[Tube], load: Load) -> Array:
    """(n,) mass per length of tubes, kg/m; zeros where the load has no gravity."""
    if load.gravity is None or not any(load.gravity):
        return np.zeros(len(tubes))
    known = [mass_per_length(tube) for tube in tubes]
    for i, mass in enumerate(known, start=1):
        if mass is None:
            raise InputError(
                f"gravity acts, but the material of tube {i} has no density and the tube no mass_per_length; give one"
            )
    return np.array(known, dtype=float)


def _stretches(value: Any) -> TypeGuard[tuple[Stretch, ...]]:
    return isinstance(value, tuple) and bool(value) and isinstance(value[0], Stretch)


def _distributed(value: Any) -> Vector | tuple[Stretch, ...]:
    if isinstance(value, Sequence) and value and not isinstance(value[0], int | float):
        return tuple(_stretch(k, entry) for k, entry in enumerate(value))
    return triple("distributed", value)


def _stretch(k: int, entry: Any) -> Stretch:
    if isinstance(entry, Stretch):
        entry = (entry.start, entry.end, entry.force)
    name = f"distributed[{k}]"
    try:
        start, end, force = entry
    except (TypeError, ValueError):
        raise InputError(f"{name} is {entry!r}; it must be (start, end, (x, y, z))") from None
    begin, stop = positive(f"start of {name}", start, zero=True), finite(f"end of {name}", end)
    if stop <= begin:
        raise InputError(f"end of {name} is {stop:g} m; it must be greater than its start, {begin:g} m")
    return Stretch(begin, stop, triple(f"force of {name}", force))


def _point(k: int, entry: Any) -> PointForce:
    if isinstance(entry, PointForce):
        entry = (entry.at, entry.force)
    try:
        at, force = entry
    except (TypeError, ValueError):
        raise InputError(f"points[{k}] is {entry!r}; it must be (arc length, (x, y, z))") from None
    return PointForce(positive(f"arc length of points[{k}]", at, zero=True), triple(f"force of points[{k}]", force))
