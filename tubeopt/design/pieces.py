"""Pieces of tubes as unknowns of a design: what they make of the tubes, and how the cross-sections change with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from ..block.transcription.chain import bend_of
from ..equilibrium.directions import Change, Directions
from ..errors import InputError
from ..robots.pieces import Piece, Slots
from ..robots.series import Quantity, Series, times, turned, values
from ..robots.tubes import STIFFNESSES, OfCrossSection, Tube
from ..typing import Array

PIECE_FIELDS = {
    "piece_curvature": ("curvature", "1/m", 1.0),
    "piece_shape": ("coefficient of the curvature", "1/m", 1.0),
    "piece_plane": ("turn of the bend plane", "deg", 180 / np.pi),
    "piece_twist": ("natural twist", "1/m", 1.0),
    "piece_bending_factor": ("bending factor", "", 1.0),
    "piece_torsion_factor": ("torsion factor", "", 1.0),
}
"""Dimensions of pieces that may be free: in words, and how they are shown."""

LEAST_BEND = 1e-9
"""Curvature (1/m) of a piece that may be curved, in place of 0: it has a direction."""

Place = tuple[int, int]
"""A tube, and one of its pieces."""


@dataclass(frozen=True)
class Unknown:
    """What one unknown of a design is: a dimension of tubes, or of some of their pieces."""

    field: str
    tubes: tuple[int, ...]
    scaled: bool = False
    """Whether it is a factor on what the tubes have."""
    pieces: tuple[Place, ...] = ()
    """() of whole tubes."""
    order: int = 0
    """Of a shape: the number of the coefficient."""
    torsion_share: float | None = None
    """By how much less torsional stiffness is left, per bending stiffness that slots take, where the one follows the
    other."""


Given = Mapping[Place, Mapping[tuple[str, int], tuple[float, float | None]]]
"""Of every piece, the values of its unknowns by field and order, with the share of the torsion."""


def of_section(tube: Tube, **changes: Any) -> Tube:
    """The tube with other diameters or another material. A stiffness that is given, of the tube or of a piece, grows as
    that of the cross-section does, and a given mass as its area."""
    new = replace(tube, **changes)
    second = new.second_moment / tube.second_moment
    moduli = [(one.material.youngs_modulus, one.material.shear_modulus) for one in (new, tube)]
    factors = [second * after / before for after, before in zip(*moduli, strict=True)]
    grown = {
        name: getattr(tube, name) * factor
        for name, factor in zip(STIFFNESSES, factors, strict=True)
        if not isinstance(getattr(tube, name), OfCrossSection)
    }
    mass = tube.mass_per_length
    if mass is not None:
        grown["mass_per_length"] = mass * new.cross_section / tube.cross_section
    return replace(new, **grown, pieces=tuple(piece.stiffened(*factors) for piece in tube.pieces))


def as_pieces(tube: Tube) -> Tube:
    """The tube as one of pieces, though it be of one curvature."""
    if tube.general or tube.curved_length == 0:
        return tube
    return replace(tube, curvature=abs(tube.curvature), pieces=(Piece(tube.curved_length, tube.curvature),))


def with_slots(tubes: Sequence[Tube], places: Sequence[Place], slots: Slots) -> tuple[Tube, ...]:
    """The tubes with slots in some of their pieces."""
    return tuple(
        replace(
            tube,
            pieces=tuple(
                replace(piece, slots=slots) if (i, j) in places else piece for j, piece in enumerate(tube.pieces)
            ),
        )
        for i, tube in enumerate(tubes)
    )


def start_of(tubes: Sequence[Tube], unknown: Unknown) -> float:
    """What an unknown is before anything is changed, on average over its pieces or tubes."""
    if unknown.pieces:
        return float(np.mean([_start(tubes[i], j, unknown.field, unknown.order) for i, j in unknown.pieces]))
    return 1.0 if unknown.scaled else float(np.mean([getattr(tubes[i], unknown.field) for i in unknown.tubes]))


def _start(tube: Tube, number: int, field: str, order: int) -> float:
    piece = tube.pieces[number]
    x, y, z = piece.precurvature
    match field:
        case "piece_curvature":
            return bend_of((x, y), piece.length)[0]
        case "piece_shape":
            if y != 0:
                raise InputError(f"piece {number + 1} has curvature about y; a shape may have curvature about x only")
            return _coefficient(x, piece.length, order)
        case "piece_twist":
            if isinstance(z, Series):
                raise InputError(f"the natural twist of piece {number + 1} varies along it; it must be one number")
            return float(z)
        case "piece_plane":
            return 0.0
        case _:
            return 1.0


def _coefficient(x: Quantity, length: float, order: int) -> float:
    """Coefficient of the Chebyshev polynomial of an order on the whole piece."""
    if not isinstance(x, Series):
        return x if order == 0 else 0.0
    nodes = np.cos(np.pi * (np.arange(65) + 0.5) / 65)
    return float(chebyshev.chebfit(nodes, x(length * (nodes + 1) / 2), 24)[order])


def given_of(unknowns: Sequence[Unknown], values: Sequence[float]) -> Given:
    """The values of unknowns, piece by piece."""
    out: dict[Place, dict[tuple[str, int], tuple[float, float | None]]] = {}
    for one, value in zip(unknowns, values, strict=True):
        for place in one.pieces:
            out.setdefault(place, {})[one.field, one.order] = float(value), one.torsion_share
    return out


def changed_tubes(tubes: Sequence[Tube], given: Given) -> tuple[Tube, ...]:
    """The tubes with their pieces changed."""
    out = []
    for i, tube in enumerate(tubes):
        pieces = [_changed(tube, piece, given.get((i, j), {})) for j, piece in enumerate(tube.pieces)]
        largest = max((piece.largest_curvature for piece in pieces), default=tube.curvature)
        out.append(replace(tube, curvature=largest, pieces=tuple(pieces)))
    return tuple(out)


def _changed(tube: Tube, piece: Piece, values: Mapping[tuple[str, int], tuple[float, float | None]]) -> Piece:
    x, y, z = piece.precurvature
    shape = [value for (field, _), (value, _) in sorted(values.items()) if field == "piece_shape"]
    if shape:
        shape[0] = shape[0] if any(abs(c) > LEAST_BEND for c in shape) else LEAST_BEND
        x, y = Series((0.0, piece.length), (tuple(shape),)), 0.0
    own = {field: value for (field, _), (value, _) in values.items() if field != "piece_shape"}
    bend = own.get("piece_curvature")
    if bend is not None:
        bend = bend if abs(bend) > LEAST_BEND else LEAST_BEND
        x, y = (times(q, bend) for q in bend_of((x, y), piece.length)[1])
    if "piece_plane" in own:
        x, y = turned(x, y, own["piece_plane"])
    stiffness: dict[str, Any] = {}
    for name, factor in zip(("bending", "torsional"), factors(values), strict=True):
        if factor != 1.0:
            drawn = getattr(piece, f"{name}_stiffness")
            whole = float(getattr(tube, f"{name}_stiffness")) if drawn is None else drawn
            stiffness[f"{name}_stiffness"] = times(whole, factor)
    return replace(piece, precurvature=(x, y, own.get("piece_twist", z)), **stiffness)


def factors(values: Mapping[tuple[str, int], tuple[float, float | None]]) -> tuple[float, float]:
    """By what bending and torsional stiffness of a piece are multiplied."""
    bending, share = values.get(("piece_bending_factor", 0), (1.0, None))
    tied = 1.0 if share is None else 1 - share * (1 - bending)
    return bending, tied * values.get(("piece_torsion_factor", 0), (1.0, None))[0]


def largest_bend_slope(piece: Piece, unknown: Unknown, value: float) -> float:
    """Change of the largest curvature of a piece with one of its unknowns, by the value of that."""
    if unknown.field == "piece_curvature":
        return -1.0 if value < 0 else 1.0
    if unknown.field != "piece_shape":
        return 0.0
    x, y, _ = piece.precurvature
    s = np.linspace(0.0, piece.length, 2001)
    rows = [values(q, s) for q in (x, y)]
    worst = int(np.argmax(np.hypot(*rows)))
    sign = float(np.sign(rows[0][worst])) or 1.0
    return sign * float(np.cos(unknown.order * np.arccos(np.clip(2 * s[worst] / piece.length - 1, -1, 1))))


def change_of(here: Directions, unknown: Unknown, given: Given) -> Change:
    """What an unknown changes along a solved arm."""
    (rate, stiffness, moment, phase), n = np.zeros((4, *here.here.phase.shape)), here.n
    out = Change(np.zeros(n), rate, stiffness, moment, phase, np.zeros(n))
    for i, j in unknown.pieces:
        tube = here.tubes[i]
        low = tube.straight_length + sum(piece.length for piece in tube.pieces[:j])
        length = tube.pieces[j].length
        local = here.place[..., i] - low
        kb, kt, x, y, _, _ = here.values[..., i]
        there = (here.here.stiffness[..., i] > 0).astype(float)
        inside = (local > 0) & (local < length)
        dx, dy, dkb, dkt, wound = _rates(unknown, given[i, j], (local, length), (kb, kt, x, y))
        size = np.hypot(x, y)
        solid = np.where(size > 0, size, 1.0)
        bent = there * inside
        out.stiffness[..., i] += bent * dkb
        out.moment[..., i] += bent * (dkb * size + kb * (x * dx + y * dy) / solid)
        out.phase[..., i] += wound + inside * (x * dy - y * dx) / solid**2
        out.rate[..., i] += -(inside * dkt) / kt**2
        out.transmission[i] += _softer(here, (i, low, length), dkt, kt)
        if unknown.field == "piece_twist":
            out.wound[i] += length
    return out


def _rates(
    unknown: Unknown,
    values: Mapping[tuple[str, int], tuple[float, float | None]],
    along: tuple[Array, float],
    now: tuple[Array, Array, Array, Array],
) -> tuple[Any, Any, Any, Any, Any]:
    """Change of u*_x, u*_y, EI, GJ and of the natural turn; of GJ in proportion to it."""
    (local, length), (kb, kt, x, y) = along, now
    plane = values.get(("piece_plane", 0), (0.0, None))[0]
    bending, torsion = factors(values)
    match unknown.field:
        case "piece_curvature":
            bend = values["piece_curvature", 0][0]
            bend = bend if abs(bend) > LEAST_BEND else LEAST_BEND
            return x / bend, y / bend, 0.0, 0.0, 0.0
        case "piece_shape":
            order = np.cos(unknown.order * np.arccos(np.clip(2 * local / length - 1, -1, 1)))
            return order * np.cos(plane), order * np.sin(plane), 0.0, 0.0, 0.0
        case "piece_plane":
            return -y, x, 0.0, 0.0, 0.0
        case "piece_twist":
            return 0.0, 0.0, 0.0, 0.0, np.clip(local, 0.0, length)
        case "piece_bending_factor":
            share = 0.0 if unknown.torsion_share is None else unknown.torsion_share
            return 0.0, 0.0, kb / bending, kt * share / (1 - share * (1 - bending)), 0.0
        case _:
            untwisted = {**values, ("piece_torsion_factor", 0): (1.0, None)}
            return 0.0, 0.0, 0.0, kt / torsion * factors(untwisted)[1], 0.0


def _softer(here: Directions, piece: tuple[int, float, float], dkt: Any, kt: Array) -> float:
    """Change of int ds / GJ from the held end to the plate, with GJ of a piece in proportion to it."""
    tube, low, length = piece
    if np.ndim(dkt) == 0:
        return 0.0
    held = here.assembly.transmission
    ends = []
    for end in (low, low + length):
        place = held.copy()
        place[tube] = min(end, held[tube])
        ends.append(float(here.table.compliant(place)[tube]))
    return -(ends[1] - ends[0]) * float((dkt / kt).flat[0])
