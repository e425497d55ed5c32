"""Pieces of tubes as YAML: what their keys are, and the way there and back."""

from __future__ import annotations

import logging
from decimal import Decimal
from os import PathLike
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag

from ..errors import InputError
from ..files.checked import Entry, Number, Positive, in_file, unusual
from ..files.csv_file import read_csv
from ..files.field_metadata import Typical
from ..files.fields import EntryOf, to_data
from ..files.units import DEG, MM, PER_M, UNITS, in_unit, to_si
from ..typing import Array
from .pieces import BEND, LENGTH, Piece, Slots, check_table
from .series import Quantity, Series, extremes, turned
from .tubes import Tube

DEG_PER_MM, N_MM2 = UNITS["deg_per_mm"], UNITS["N_mm2"]

LOGGER = logging.getLogger(__name__)

RADIUS = PITCH = Typical(5e-4, 10.0)
"""Of a piece or a helix, and what a helix advances per turn, m."""

LEAST_STIFFNESS, MOST_STIFFNESS = 1e-4, 10.0
"""Of that of the cross-section: what is given outside has a wrong unit."""

COLUMNS = ("arc_length_mm", "curvature_x_per_m", "curvature_y_per_m")
TWIST = "twist_deg_per_mm"
"""Columns of a table of precurvature; the twist may be left out."""


class SeriesEntry(Entry):
    """A quantity along the piece, as Chebyshev coefficients on panels; `save_robot` writes this form."""

    breaks_mm: list[Number] = Field(min_length=2, description="arc lengths of the panel boundaries, starting at 0")
    coefficients: list[list[Number]] = Field(min_length=1, description="Chebyshev coefficients of every panel")

    def series(self, unit: Decimal) -> Series:
        """The quantity in SI."""
        breaks = tuple(to_si(s, MM) for s in self.breaks_mm)
        return Series(breaks, tuple(tuple(to_si(c, unit) for c in panel) for panel in self.coefficients))


def _kind(value: Any) -> str:
    if isinstance(value, list):
        return "<list>"
    return "<mapping>" if isinstance(value, (dict, SeriesEntry)) else "<number>"


OneNumber = Annotated[Number, Tag("<number>")]
Varying = Annotated[SeriesEntry, Tag("<mapping>")]

Along = Annotated[OneNumber | Varying, Discriminator(_kind)]
"""A number, or a quantity that varies along the piece."""

Stiffness = Annotated[Annotated[Positive, Tag("<number>")] | Varying, Discriminator(_kind)]

Both = Annotated[list[Along], Field(min_length=2, max_length=2), Tag("<list>")]

Curvature = Annotated[OneNumber | Both | Varying, Discriminator(_kind)]
"""Curvature about x, or about x and y."""


class HelixEntry(Entry):
    """A helix in space."""

    radius_mm: Annotated[Positive, RADIUS]
    pitch_mm: Annotated[Positive, PITCH] = Field(description="advance along the helix axis per turn")
    handed: Literal["left", "right"] = "right"


Factor = Annotated[Positive, Field(le=1)]


class PatternEntry(Entry):
    """Slots in the wall: remaining fractions of the tube's stiffnesses."""

    bending_factor: Factor
    torsion_factor: Factor
    source: str = Field(
        min_length=1, description="source of the factors, such as a measurement or a model of slotted tubes"
    )


def _load_table(path: str | PathLike[str]) -> tuple[Array, Array]:
    """Arc lengths (k,), m, and u* (k, 3), 1/m, of a table in a CSV file."""
    table = read_csv(path, (*COLUMNS, TWIST))
    table.expect(COLUMNS, [TWIST])
    s = table.numbers(COLUMNS[:1], MM)[:, 0]
    u = np.zeros((len(s), 3))
    u[:, :2] = table.numbers(COLUMNS[1:], PER_M)
    if TWIST in table.columns:
        u[:, 2] = table.numbers([TWIST], DEG_PER_MM)[:, 0]
    table.check()
    end = in_unit(float(s[-1]), MM) if len(s) else 0
    for words in unusual("the last arc_length_mm", "mm", Decimal(repr(end)), LENGTH):
        LOGGER.warning(f"{path}: {words}")
    try:
        check_table(s, u, "arc_length_mm", 1e-3)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return s, u


Table = Annotated[
    Any,
    in_file(_load_table, "a CSV file"),
    Field(
        description=f"path of a CSV file, relative to this file, with columns {', '.join(COLUMNS)} and twist_deg_per_mm"
    ),
]


class PieceEntry(Entry):
    """A piece of a tube: length, precurvature in one of several forms, and optional stiffnesses."""

    length_mm: Annotated[Positive | None, LENGTH] = Field(
        None, description="length of the piece; optional with a table"
    )
    radius_mm: Annotated[Positive | None, RADIUS] = None
    curvature_per_m: Annotated[Curvature | None, BEND] = Field(None, description="precurvature about x, or [x, y]")
    twist_deg_per_mm: Along | None = Field(
        None, description="natural twist: rotation of the bending direction per length"
    )
    helix: HelixEntry | None = None
    table: Table | None = Field(None, description="CSV file of the precurvature along the piece")
    plane_deg: Number | None = Field(None, description="rotation of the bending direction about the tube axis")
    bending_stiffness_N_mm2: Stiffness | None = None
    torsional_stiffness_N_mm2: Stiffness | None = None
    pattern: PatternEntry | None = None
    slots: EntryOf[Slots] | None = Field(
        None, description="position of the slots, for the strain of the remaining material"
    )

    def build(self, tube: Tube) -> Piece:
        """The piece in SI, of a tube with these diameters and stiffnesses."""
        length = self._length()
        x, y, z = self._precurvature()
        if self.helix is not None:
            _check_pitch(self.helix, length, tube.outer_diameter)
        if self.plane_deg is not None:
            x, y = turned(x, y, to_si(self.plane_deg, DEG))
        own = float(tube.bending_stiffness), float(tube.torsional_stiffness)
        bending, torsional = self._stiffness(own)
        for name, part, whole in (("bending", bending, own[0]), ("torsional", torsional, own[1])):
            for value in () if part is None else extremes([part], length):
                check_stiffness(f"{name}_stiffness_N_mm2", value, whole)
        slots = None if self.slots is None else self.slots.build()
        return Piece(length, (x, y, z), bending_stiffness=bending, torsional_stiffness=torsional, slots=slots)

    def _length(self) -> float:
        if self.table is None:
            if self.length_mm is None:
                raise InputError("length_mm is missing")
            return to_si(self.length_mm, MM)
        measured = float(self.table[0][-1])
        if self.length_mm is not None and abs(to_si(self.length_mm, MM) - measured) > 1e-9:
            raise InputError(
                f"length_mm is {self.length_mm}; the table ends at {measured * 1e3:g} mm, and they must agree"
            )
        return measured

    def _precurvature(self) -> tuple[Quantity, Quantity, Quantity]:
        ways = ("radius_mm", "curvature_per_m", "helix", "table")
        given = [name for name in ways if getattr(self, name) is not None]
        if len(given) > 1:
            raise InputError(f"{given[0]} and {given[1]} are both given; a piece has one of {', '.join(ways)}")
        if self.twist_deg_per_mm is not None and given and given[0] in ("helix", "table"):
            raise InputError(f"twist_deg_per_mm and {given[0]} are both given; a {given[0]} already defines the twist")
        if self.helix is not None:
            radius, pitch = to_si(self.helix.radius_mm, MM), to_si(self.helix.pitch_mm, MM)
            x, y, z = Piece.helix(1.0, radius, pitch, left=self.helix.handed == "left").precurvature
            return x, y, z
        if self.table is not None:
            x, y, z = Piece.table(*self.table).precurvature
            return x, y, z
        twist = _quantity(self.twist_deg_per_mm, DEG_PER_MM) if self.twist_deg_per_mm is not None else 0.0
        if self.radius_mm is not None:
            return float(1 / (self.radius_mm * MM)), 0.0, twist
        bend = self.curvature_per_m
        if bend is None:
            return 0.0, 0.0, twist
        parts = bend if isinstance(bend, list) else [bend, Decimal(0)]
        return _quantity(parts[0], PER_M), _quantity(parts[1], PER_M), twist

    def _stiffness(self, own: tuple[float, float]) -> tuple[Quantity | None, Quantity | None]:
        named = (self.bending_stiffness_N_mm2, self.torsional_stiffness_N_mm2)
        if self.pattern is None:
            bending, torsional = (None if part is None else _quantity(part, N_MM2) for part in named)
            return bending, torsional
        if named != (None, None):
            raise InputError("pattern and a stiffness are both given; a piece has one or the other")
        return own[0] * float(self.pattern.bending_factor), own[1] * float(self.pattern.torsion_factor)


def _check_pitch(helix: HelixEntry, length: float, diameter: float) -> None:
    """Raise InputError where turns of a helix would run through each other."""
    pitch = to_si(helix.pitch_mm, MM)
    if pitch <= diameter and length > np.hypot(2 * np.pi * to_si(helix.radius_mm, MM), pitch):
        raise InputError(
            f"helix.pitch_mm is {helix.pitch_mm}; it must exceed the tube's diameter, {diameter * 1e3:g} mm"
        )


def _quantity(entry: Decimal | SeriesEntry, unit: Decimal) -> Quantity:
    return entry.series(unit) if isinstance(entry, SeriesEntry) else to_si(entry, unit)


def check_stiffness(name: str, value: float, of_section: float) -> None:
    """Raise InputError where a stiffness (N m^2) can be none of a tube whose cross-section has another."""
    if not LEAST_STIFFNESS * of_section <= value <= MOST_STIFFNESS * of_section:
        raise InputError(
            f"{name} is {value * 1e6:.10g}; the cross-section and material give {of_section * 1e6:.4g}, and it must be "
            f"{LEAST_STIFFNESS:g} to {MOST_STIFFNESS:g} times that"
        )


def piece_to_dict(piece: Piece) -> dict[str, Any]:
    """A piece with the keys and units of a robot file."""
    x, y, z = piece.precurvature
    data: dict[str, Any] = {
        "length_mm": in_unit(piece.length, MM),
        "curvature_per_m": [_written(x, PER_M), _written(y, PER_M)],
    }
    if z != 0.0:
        data["twist_deg_per_mm"] = _written(z, DEG_PER_MM)
    for name in ("bending_stiffness", "torsional_stiffness"):
        own = getattr(piece, name)
        if own is not None:
            data[f"{name}_N_mm2"] = _written(own, N_MM2)
    if piece.slots is not None:
        data["slots"] = to_data(piece.slots)
    return data


def _written(quantity: Quantity, unit: Decimal) -> Any:
    if not isinstance(quantity, Series):
        return in_unit(quantity, unit)
    return {
        "breaks_mm": [in_unit(s, MM) for s in quantity.breaks],
        "coefficients": [[in_unit(c, unit) for c in panel] for panel in quantity.coefficients],
    }
