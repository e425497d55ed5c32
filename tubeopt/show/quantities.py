"""Quantities of an answer: its `--json`, the columns of a sweep, the rows of its table, its docs.

A quantity has a key that ends in its unit, a description, and a function for its value (in SI) from the answer. A field
of an answer with marks (`files.field_metadata`) is a quantity by its marks; `described` lists those of a class.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import string
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from types import EllipsisType
from typing import Annotated, Any, Generic, TypeVar

import numpy as np

from ..equilibrium.readings import to_readings
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..files.field_metadata import Form, Key
from ..files.units import SIGNS, TO_MILLI, TO_MM, per_si, unit_of
from ..robots.load import Load
from ..typing import Array, Delegate
from .formatting import degrees, millimetres, row

A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True)
class Quantity(Generic[A]):
    """Entry of an answer."""

    key: str
    """Name in JSON, with its unit as suffix (see `files.units.UNITS`); "" for a row of the table alone."""
    about: str
    """Description, which is also the name of its row."""
    get: Callable[[A], Any] | None = None
    """Answer -> value in SI (temperatures in degC where the key says so); by default the attribute that the key names
    without its unit. Numbers, arrays, text, None, lists and mappings of them."""
    form: str = ""
    """Format of the number or numbers in the table, which the unit follows; "" for no row."""
    text: str | Callable[[A], str | None] | None = None
    """Row of the table instead of the number: a template, or a function of the answer; None for no row.

    A template names keys of the record, as in "{tip_error_mm:.1e} mm".
    """
    of: Sequence[Quantity[Any]] | None = None
    """Quantities of a part of the answer, or of each of several; `get` returns the part, a list of parts, or None."""
    label: str | None = None
    """Name of the row where that is not `about`."""
    digits: int | None = None
    """Decimals of the number in its unit, against round-off of the conversion from SI."""
    optional: bool = False
    """True if the key is left out, not null, without a value."""

    @functools.cached_property
    def unit(self) -> str:
        """The unit that its key ends in, or ""."""
        return unit_of(self.key)

    @functools.cached_property
    def _attribute(self) -> str:
        return self.key.removesuffix(f"_{self.unit}") if self.unit else self.key

    @property
    def name(self) -> str:
        """Name of the quantity's row in the table."""
        return self.about if self.label is None else self.label

    @property
    def sign(self) -> str:
        """Unit as tables write it."""
        return SIGNS.get(self.unit, self.unit)

    def si_value(self, answer: A) -> Any:
        """Value of the quantity in SI."""
        if self.get is not None:
            return self.get(answer)
        return getattr(answer, self._attribute)

    def value(self, answer: A) -> Any:
        """Value for the record: in the unit of the key, plain numbers and lists."""
        si_value = self.si_value(answer)
        if self.of is not None:
            return _parts(si_value, self.of)
        shown = in_units(si_value, self.unit)
        if self.digits is None or shown is None:
            return shown
        return np.round(shown, self.digits).tolist()

    def row_text(self, answer: A, known: Mapping[str, Any]) -> str | None:
        """Text of the quantity's row in the table; None if it has no row."""
        if callable(self.text):
            return self.text(answer)
        if not (self.text or self.form) or (self.key and known.get(self.key) is None):
            return None
        if self.text is not None:
            return _TEMPLATE.vformat(self.text, (), known)
        return f"{self.number(known)} {self.sign}".strip()

    def number(self, known: Mapping[str, Any]) -> str:
        """Formatted number or numbers of the record, without the unit."""
        return str(_TEMPLATE.format_field(known[self.key], self.form))


def described(kind: type[A], *entries: str | Quantity[A] | EllipsisType) -> tuple[Quantity[A], ...]:
    """Quantities of an answer, in the order of JSON and table.

    Args:
        entries: names of marked fields of `kind` with blanks between them, other quantities, and `...` for all other
            marked fields in their order; by default all marked fields.
    """
    listed: list[Quantity[A] | EllipsisType] = []
    for entry in entries or (...,):
        listed += [of_field(kind, name) for name in entry.split()] if isinstance(entry, str) else [entry]
    keys = {entry.key for entry in listed if isinstance(entry, Quantity)}
    marked = [of_field(kind, name) for name in _marked(kind)] if ... in listed else []
    # A named field has its own position, and is not repeated where `...` stands.
    unnamed = [quantity for quantity in marked if quantity.key not in keys]
    return tuple(each for entry in listed for each in (unnamed if isinstance(entry, EllipsisType) else [entry]))


def of_field(kind: type[A], name: str, **changes: Any) -> Quantity[A]:
    """The quantity of a marked field, or of the marked field of a part that `kind` delegates to.

    Args:
        changes: attributes of `Quantity` that the marks do not have, or that this list has otherwise. By default a
            field that has parts with marks (`X`, `X | None`, `tuple[X, ...]`) is described by all of these.
    """
    metadata = _marked(kind).get(name) or _of_part(kind, name)
    # Reversed, so that of two marks of one type the first is kept.
    first: dict[type, Any] = {type(mark): mark for mark in reversed(metadata[1:])}
    named, shown = first.get(Key, Key("")), first.get(Form, Form(""))
    key = named.name or (f"{name}_{named.unit}" if named.unit else name)
    marked = {"form": shown.spec, "label": shown.label, "of": _of_parts(metadata[0])}
    return Quantity(key, **{"about": first[str], "get": attrgetter(name)} | marked | changes)


def _marked(kind: type) -> Mapping[str, tuple[Any, ...]]:
    """Marked fields of a class in their order -> their type, and their marks."""
    marked = {name: hint for name, hint in _hints(kind).items() if typing.get_origin(hint) is Annotated}
    return {name: (hint.__origin__, *hint.__metadata__) for name, hint in marked.items()}


@functools.lru_cache(maxsize=256)
def _hints(kind: Any) -> Mapping[str, Any]:
    # Resolving annotations is slow, and a table with parts asks for the same class many times.
    return typing.get_type_hints(kind, include_extras=True)


def _of_part(kind: type, name: str) -> tuple[Any, ...]:
    """Type and marks of a field that a class reads from one of its parts."""
    delegate = inspect.getattr_static(kind, name)
    assert isinstance(delegate, Delegate), f"{kind.__name__}.{name} has no marks"
    return _marked(_hints(kind)[delegate.part])[name]


def _of_parts(hint: Any) -> tuple[Quantity[Any], ...] | None:
    """Quantities of the part, or parts, in a field; None for numbers, text and parts without marks."""
    kinds = [
        each for each in (hint, *typing.get_args(hint)) if isinstance(each, type) and dataclasses.is_dataclass(each)
    ]
    return next((described(each) for each in kinds if _marked(each)), None)


def line(label: str, text: str | Callable[[A], str | None]) -> Quantity[A]:
    """Quantity that has a row in the table and no key in the record."""
    return Quantity("", label, text=text)


def within(quantities: Sequence[Quantity[B]], part: Callable[[A], B | None]) -> tuple[Quantity[A], ...]:
    """Quantities of a part as quantities of the whole; None if the whole has no such part."""
    return tuple(_lifted(quantity, part) for quantity in quantities)


def _lifted(q: Quantity[B], part: Callable[[A], B | None]) -> Quantity[A]:
    def of_the_whole(of_the_part: Callable[[B], Any]) -> Callable[[A], Any]:
        def get(answer: A) -> Any:
            selected = part(answer)
            return None if selected is None else of_the_part(selected)

        return get

    # A row of text alone has no value to find.
    get = of_the_whole(q.si_value) if q.key else None
    text = of_the_whole(q.text) if callable(q.text) else q.text
    # Of any answer: `replace` keeps the type of what it copies.
    copied: Quantity[Any] = q
    return replace(copied, get=get, text=text)


def record(answer: A, quantities: Iterable[Quantity[A]]) -> dict[str, Any]:
    """Record of an answer for JSON: plain numbers, text, lists and mappings."""
    values = ((quantity, quantity.value(answer)) for quantity in quantities if quantity.key)
    return {quantity.key: value for quantity, value in values if value is not None or not quantity.optional}


def rows(answer: A, quantities: Sequence[Quantity[A]]) -> list[tuple[str, str]]:
    """Rows of an answer for the table: names and texts."""
    known = record(answer, quantities)
    texts = ((q.name, q.row_text(answer, known)) for q in quantities)
    return [(name, text) for name, text in texts if text is not None]


def columns(parts: Iterable[B], quantities: Sequence[Quantity[B]]) -> tuple[list[str], list[list[str]]]:
    """Column names and rows of a table with one row per part of an answer."""
    shown = [quantity for quantity in quantities if quantity.text or quantity.form]
    known = ((part, record(part, quantities)) for part in parts)
    return [q.name for q in shown], [[q.row_text(part, values) or "" for q in shown] for part, values in known]


_AS_IT_IS = frozenset([bool, str, dict, type(None)])


def in_units(value: Any, unit: str) -> Any:
    """Value converted from SI to a unit, for numbers and arrays; anything else is unchanged."""
    kind = type(value)
    # The most frequent kinds first: a sweep converts millions of numbers.
    if kind is float:
        return value * per_si(unit) if unit else value
    if kind in _AS_IT_IS:
        return value
    if isinstance(value, np.ndarray):
        return (value * per_si(unit)).tolist() if unit else value.tolist()
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, list | tuple):
        return [in_units(each, unit) for each in value]
    if isinstance(value, str | Mapping) or not unit:
        return value
    factor = per_si(unit)
    # Times 1, an integer would become a float in JSON.
    return value if factor == 1 else value * factor


def with_unit(unit: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values converted from SI to a unit, by their names with this unit at the end."""
    return {f"{name}_{unit}" if unit else name: in_units(value, unit) for name, value in values.items()}


def _parts(value: Any, quantities: Sequence[Quantity[Any]]) -> Any:
    """Record of a part, list of records of several parts, or None."""
    if value is None:
        return None
    if isinstance(value, list | tuple):
        return [record(each, quantities) for each in value]
    return record(value, quantities)


class _Template(string.Formatter):
    """Format strings that show a list as its numbers with commas between them, and None as a dash."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, list):
            return row(value, format_spec)
        return "–" if value is None else str(super().format_field(value, format_spec))


_TEMPLATE = _Template()


def load_text(load: Load) -> str:
    """Text of a load in one line."""
    at_tip = []
    if any(load.force):
        at_tip.append(f"{row(np.array(load.force) * TO_MILLI, '.6g')} mN at the tip")
    if any(load.moment):
        at_tip.append(f"{row(np.array(load.moment) * TO_MILLI, '.6g')} mN m at the tip")
    parts = [*at_tip, *(["turning with the tip"] if load.frame == "tip" and at_tip else [])]
    for part in load.points:
        for value, unit in ((part.force, "mN"), (part.moment, "mN m")):
            if any(value):
                parts.append(f"{row(np.array(value) * TO_MILLI, '.6g')} {unit} at {part.at * TO_MM:.6g} mm")
    parts += ["a load along the arm"] if load.distributed is not None else []
    parts += [f"gravity {row(load.gravity, '.6g')} m/s^2"] if load.gravity is not None else []
    return "; ".join(parts) or "none"


def _softness(e: Equilibrium) -> str:
    # m/N are mm/mN.
    # Singular values: displacement per force in the stiffest and the softest direction.
    softness = np.linalg.svd(e.compliance[:3, :3], compute_uv=False)
    return f"by {softness[-1]:.4g} to {softness[0]:.4g} mm/mN"


def _on_the_plate(e: Equilibrium) -> str:
    wrench = e.base_wrench * TO_MILLI
    return f"{row(wrench[:3], '.4f')} mN, {row(wrench[3:], '.4f')} mN m"


LOADED: tuple[Quantity[Equilibrium], ...] = within(
    (
        Quantity[Equilibrium]("load", "what pushes, in words; absent without load",
                              lambda e: e.given_load and load_text(e.given_load), label="load", text="{load}",
                              optional=True),
        Quantity("potential_mJ", "elastic energy less the work of the load", optional=True),
        Quantity("compliance",
                 "6 x 6 compliance: translation (m) and rotation (rad) of the tip per force (N) and moment (N m) there",
                 label="a force at the tip moves it", text=_softness, optional=True),
        Quantity("base_force_mN", "force of the load on the plate", lambda e: e.base_wrench[:3],
                 label="on the plate", text=_on_the_plate, optional=True),
        Quantity("base_moment_mN_m", "moment of the load on the plate", lambda e: e.base_wrench[3:], optional=True),
    ),
    lambda e: None if e.load is None else e,
)  # fmt: skip
"""Quantities of an equilibrium under a load; none without one."""


def known_distance(read: Callable[[], float]) -> float | None:
    """Proved snap distance, rad; None if unknown."""
    try:
        return read()
    except (InputError, SolveError):
        return None


def distance_text(distance: float | None, where: str = "") -> str | None:
    """Text of a snap distance (rad) with its meaning."""
    if distance is None:
        return None
    if distance == np.inf:
        return "no turn of the tubes can snap at these translations (proved)"
    return f"at least {np.degrees(distance):.1f} deg{where}: all tubes can turn by this much, each either way (proved)"


SNAP_DISTANCE: tuple[Quantity[Equilibrium], ...] = (
    Quantity("snap_distance_deg",
             "all tubes can turn by this much, each either way and in any order, without a snap: proved; null if no "
             "turn can snap; absent if unknown, as under a moment",
             lambda e: known_distance(lambda: e.snap_distance), optional=True),
    line("snap distance", lambda e: distance_text(known_distance(lambda: e.snap_distance))),
)  # fmt: skip
"""Snap distance of an equilibrium by turns of its tubes."""


READINGS: tuple[Quantity[tuple[Array, Array]], ...] = (
    Quantity("readings_deg", "readings of the drives for these rotations; calibrated robots only", lambda read: read[0],
             label="the drives read", text=lambda read: _words(read, ".6g"), optional=True),
    Quantity("readings_mm", "readings of the drives for these translations; calibrated robots only",
             lambda read: read[1], optional=True),
)  # fmt: skip


def readings(of: Callable[[A], Equilibrium]) -> tuple[Quantity[A], ...]:
    """Quantities of the drive readings, omitted for robots without a calibration."""
    return within(READINGS, lambda answer: _read(of(answer)))


def _read(e: Equilibrium) -> tuple[Array, Array] | None:
    calibration = e.robot.calibration
    return None if calibration is None or calibration.reads_true else to_readings(e.robot, e.rotations, e.translations)


def _words(joints: tuple[Array, Array], form: str) -> str:
    return f"{degrees(joints[0], form)}, {millimetres(joints[1], form)}"


def joints_text(e: Equilibrium) -> str:
    """Text of joint values, and of the drive readings of a calibrated robot there."""
    text = f"rotations {degrees(e.rotations, '.4g')}, translations {millimetres(e.translations, '.4g')}"
    read = _read(e)
    return text if read is None else f"{text}; the drives read {_words(read, '.4g')}"
