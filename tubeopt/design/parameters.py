"""Free dimensions of a design: of tubes and of their pieces, their bounds, and which change together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev

from ..block.transcription.chain import bend_of
from ..display import Displayed
from ..equilibrium.directions import OF_SHEATH, Change, Directions
from ..errors import InputError, choice, finite, items, whole
from ..robots.eccentric import BundleRobot
from ..robots.pieces import Piece, Quantity, Series, Slots, times, turned, values
from ..robots.robot import Robot
from ..robots.tubes import STIFFNESSES, OfCrossSection, Tube, second_moment
from ..typing import Array

# Dimensions of pieces that may be free: in words, and how they are shown.
PIECE_FIELDS = {
    "piece_curvature": ("curvature", "1/m", 1.0),
    "piece_shape": ("coefficient of the curvature", "1/m", 1.0),
    "piece_plane": ("turn of the bend plane", "deg", 180 / np.pi),
    "piece_twist": ("natural twist", "1/m", 1.0),
    "piece_bending_factor": ("bending factor", "", 1.0),
    "piece_torsion_factor": ("torsion factor", "", 1.0),
}

# Curvature (1/m) of a piece that may be curved, in place of 0: without a direction its derivative would be undefined.
# It moves no tip by more than round-off.
MIN_BEND = 1e-9

PieceIndex = tuple[int, int]
"""A tube, and one of its pieces."""


@dataclass(frozen=True)
class Unknown:
    """Unknown of a design: a dimension of tubes, or of some of their pieces."""

    field: str
    tubes: tuple[int, ...]
    scaled: bool = False
    """True if it is a factor on the dimension of the tubes."""
    pieces: tuple[PieceIndex, ...] = ()
    """Tube and piece numbers; () for a dimension of whole tubes."""
    order: int = 0
    """Degree of the coefficient of a shape."""
    torsion_share: float | None = None
    """Relative loss of torsional stiffness per relative loss of bending stiffness by slots; None without loss."""

    @property
    def entries(self) -> tuple[int, ...]:
        """Entries of the dimension that it determines: tubes, or the one number of the sheath."""
        return self.tubes or (0,)


UnknownValues = Mapping[tuple[str, int], tuple[float, float | None]]
"""Value and torsion share of each unknown of a piece, by field and order."""

PieceValues = Mapping[PieceIndex, UnknownValues]
"""Values of the unknowns of every piece."""


def of_section(tube: Tube, **changes: Any) -> Tube:
    """Tube with other diameters or another material.

    A given stiffness of the tube or of a piece scales with that of the cross-section, a given mass with its area.
    """
    new = replace(tube, **changes)
    second = new.second_moment / tube.second_moment
    # K = E I and K_t = G J, and J = 2 I of a tube: both grow as the second moment and as their modulus.
    moduli = [(each.material.youngs_modulus, each.material.shear_modulus) for each in (new, tube)]
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
    """Tube made of pieces; a tube of one curvature becomes one piece."""
    if tube.general or tube.curved_length == 0:
        return tube
    return replace(tube, curvature=abs(tube.curvature), pieces=(Piece(tube.curved_length, tube.curvature),))


def with_slots(tubes: Sequence[Tube], slotted: Sequence[PieceIndex], slots: Slots) -> tuple[Tube, ...]:
    """The tubes with slots in some of their pieces."""
    return tuple(
        replace(
            tube,
            pieces=tuple(
                replace(piece, slots=slots) if (i, j) in slotted else piece for j, piece in enumerate(tube.pieces)
            ),
        )
        for i, tube in enumerate(tubes)
    )


def start_of(robot: Robot, tubes: Sequence[Tube], unknown: Unknown) -> float:
    """Initial value of an unknown, averaged over its pieces or tubes."""
    if unknown.field in SHEATH and isinstance(robot, BundleRobot):
        value = getattr(robot, unknown.field)
        return float(robot.least_sheath_diameter if value is None else value)
    if unknown.field in PLACES and not unknown.scaled:
        return float(np.mean([getattr(robot, unknown.field)[i] for i in unknown.tubes]))
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
    # At Chebyshev nodes the polynomials T_k are orthogonal as sums too: the fit is the truncated series.
    nodes = np.cos(np.pi * (np.arange(65) + 0.5) / 65)
    return float(chebyshev.chebfit(nodes, x(length * (nodes + 1) / 2), 24)[order])


def piece_values(unknowns: Sequence[Unknown], values: Sequence[float]) -> PieceValues:
    """Values of unknowns, piece by piece."""
    out: dict[PieceIndex, dict[tuple[str, int], tuple[float, float | None]]] = {}
    for unknown, value in zip(unknowns, values, strict=True):
        for position in unknown.pieces:
            out.setdefault(position, {})[unknown.field, unknown.order] = float(value), unknown.torsion_share
    return out


def changed_tubes(tubes: Sequence[Tube], values: PieceValues) -> tuple[Tube, ...]:
    """The tubes with their pieces changed."""
    out = []
    for i, tube in enumerate(tubes):
        pieces = [_changed_piece(tube, piece, values.get((i, j), {})) for j, piece in enumerate(tube.pieces)]
        largest = max((piece.largest_curvature for piece in pieces), default=tube.curvature)
        out.append(replace(tube, curvature=largest, pieces=tuple(pieces)))
    return tuple(out)


def _changed_piece(tube: Tube, piece: Piece, values: UnknownValues) -> Piece:
    x, y, z = piece.precurvature
    # Sorted by order: coefficients of rising degree.
    shape = [value for (field, _), (value, _) in sorted(values.items()) if field == "piece_shape"]
    if shape:
        shape[0] = shape[0] if any(abs(c) > MIN_BEND for c in shape) else MIN_BEND
        x, y = Series((0.0, piece.length), (tuple(shape),)), 0.0
    new_values = {field: value for (field, _), (value, _) in values.items() if field != "piece_shape"}
    bend = new_values.get("piece_curvature")
    if bend is not None:
        bend = bend if abs(bend) > MIN_BEND else MIN_BEND
        x, y = (times(q, bend) for q in bend_of((x, y), piece.length)[1])
    if "piece_plane" in new_values:
        x, y = turned(x, y, new_values["piece_plane"])
    stiffness: dict[str, Any] = {}
    for name, factor in zip(("bending", "torsional"), factors(values), strict=True):
        # A factor of 1 leaves a stiffness None, so that the piece keeps that of the tube.
        if factor != 1.0:
            drawn = getattr(piece, f"{name}_stiffness")
            base = float(getattr(tube, f"{name}_stiffness")) if drawn is None else drawn
            stiffness[f"{name}_stiffness"] = times(base, factor)
    return replace(piece, precurvature=(x, y, new_values.get("piece_twist", z)), **stiffness)


def factors(values: UnknownValues) -> tuple[float, float]:
    """Factors on the bending and torsional stiffness of a piece."""
    bending, torsion_fraction = values.get(("piece_bending_factor", 0), (1.0, None))
    # Slots that take 1 - b of the bending stiffness take share (1 - b) of the torsional one.
    tied = 1.0 if torsion_fraction is None else 1 - torsion_fraction * (1 - bending)
    return bending, tied * values.get(("piece_torsion_factor", 0), (1.0, None))[0]


def largest_bend_slope(piece: Piece, unknown: Unknown, value: float) -> float:
    """Derivative of the largest curvature of a piece by one of its unknowns."""
    if unknown.field == "piece_curvature":
        return -1.0 if value < 0 else 1.0
    if unknown.field != "piece_shape":
        return 0.0
    x, y, _ = piece.precurvature
    s = np.linspace(0.0, piece.length, 2001)
    rows = [values(q, s) for q in (x, y)]
    worst = int(np.argmax(np.hypot(*rows)))
    sign = float(np.sign(rows[0][worst])) or 1.0
    # The maximum changes as the curvature at its place does (envelope theorem): by T_k there.
    return sign * float(np.cos(unknown.order * np.arccos(np.clip(2 * s[worst] / piece.length - 1, -1, 1))))


def change_of(directions: Directions, unknown: Unknown, values: PieceValues) -> Change:
    """Derivatives of the cross-sections of a solved arm by an unknown of pieces."""
    (rate, stiffness, moment, phase), n = np.zeros((4, *directions.arm.phase.shape)), directions.n
    out = Change(np.zeros(n), rate, stiffness, moment, phase, np.zeros(n))
    for i, j in unknown.pieces:
        tube = directions.tubes[i]
        low = tube.straight_length + sum(piece.length for piece in tube.pieces[:j])
        length = tube.pieces[j].length
        local = directions.tube_position[..., i] - low
        kb, kt, x, y, _, _ = directions.values[..., i]
        # Behind its end, a tube has neither stiffness nor a change of it.
        present = (directions.arm.stiffness[..., i] > 0).astype(float)
        inside = (local > 0) & (local < length)
        dx, dy, dkb, dkt, turned = _piece_rates(
            unknown, values[i, j], local / length, length, directions.values[..., i]
        )
        size = np.hypot(x, y)
        # A straight section has no direction: divided by 1 its rates are 0, not 0 / 0.
        solid = np.where(size > 0, size, 1.0)
        bent = present * inside
        out.stiffness[..., i] += bent * dkb
        # The moment is kb |u*|, the phase atan2(u*_y, u*_x): product rule, and rates in polar coordinates.
        out.moment[..., i] += bent * (dkb * size + kb * (x * dx + y * dy) / solid)
        out.phase[..., i] += turned + inside * (x * dy - y * dx) / solid**2
        # d (1 / kt) = -dkt / kt^2: the twist rate is the torsional moment times 1 / kt.
        out.rate[..., i] += -(inside * dkt) / kt**2
        out.transmission[i] += _compliance_change(directions, i, (low, low + length), dkt / kt)
        if unknown.field == "piece_twist":
            out.twist_angle[i] += length
    return out


class PieceRates(NamedTuple):
    """Derivatives of a piece's cross-sections by one unknown."""

    x: Any
    """Derivative of the precurvature u*_x."""
    y: Any
    """Derivative of the precurvature u*_y."""
    bending: Any
    """Derivative of the bending stiffness."""
    torsional: Any
    """Derivative of the torsional stiffness."""
    twist: Any
    """Derivative of the natural rotation."""


def _piece_rates(
    unknown: Unknown,
    values: UnknownValues,
    fraction: Array,
    length: float,
    now: Array,
) -> PieceRates:
    """Derivatives at fractions of a piece with cross-sections `now` (6, ..)."""
    kb, kt, x, y, _, _ = now
    plane = values.get(("piece_plane", 0), (0.0, None))[0]
    bending, torsion = factors(values)
    match unknown.field:
        case "piece_curvature":
            bend = values["piece_curvature", 0][0]
            bend = bend if abs(bend) > MIN_BEND else MIN_BEND
            # u* is proportional to the bend.
            return PieceRates(x / bend, y / bend, 0.0, 0.0, 0.0)
        case "piece_shape":
            # T_k(x) = cos(k arccos x) is curvature about the x axis, then turned with the bend plane.
            order = np.cos(unknown.order * np.arccos(np.clip(2 * fraction - 1, -1, 1)))
            return PieceRates(order * np.cos(plane), order * np.sin(plane), 0.0, 0.0, 0.0)
        case "piece_plane":
            # (x, y) turned by phi changes by (-y, x).
            return PieceRates(-y, x, 0.0, 0.0, 0.0)
        case "piece_twist":
            return PieceRates(0.0, 0.0, 0.0, 0.0, length * np.clip(fraction, 0.0, 1.0))
        case "piece_bending_factor":
            torsional = 0.0 if unknown.torsion_share is None else unknown.torsion_share
            # kt is proportional to 1 - share (1 - b), and the slope of that by b is share.
            return PieceRates(0.0, 0.0, kb / bending, kt * torsional / (1 - torsional * (1 - bending)), 0.0)
        case _:
            # torsion = tied * factor, so that kt / torsion * tied = kt / factor.
            untwisted = {**values, ("piece_torsion_factor", 0): (1.0, None)}
            return PieceRates(0.0, 0.0, 0.0, kt / torsion * factors(untwisted)[1], 0.0)


def _compliance_change(directions: Directions, tube: int, ends: tuple[float, float], relative: Any) -> float:
    """Change of int ds / GJ from the clamped end to the plate, for a relative change of GJ between two arc lengths."""
    if not np.any(relative):
        return 0.0
    clamped = directions.assembly.transmission
    compliance = []
    for end in ends:
        position = clamped.copy()
        position[tube] = min(end, clamped[tube])
        compliance.append(float(directions.table.compliant(position)[tube]))
    # d (1 / GJ) = -(1 / GJ) dGJ / GJ, and dGJ / GJ is the same all along a piece.
    return -(compliance[1] - compliance[0]) * float(relative.flat[0])


TUBE_FIELDS = ("curvature", "straight_length", "curved_length", "outer_diameter", "inner_diameter")

# Dimensions of the arrangement of a bundle robot: places of the tubes, (n,) each, and numbers of the sheath.
PLACES = ("offset", "angle")
SHEATH = (*OF_SHEATH, "sheath_diameter")

# Dimensions of a tube, of its pieces, or of an arrangement that may be free.
FIELDS = (*TUBE_FIELDS, *PIECE_FIELDS, *PLACES, *SHEATH)

DIAMETERS = ("outer_diameter", "inner_diameter")

TIES = ("each", "equal", "scaled")

NAMES = {
    **{field: field.replace("_", " ") for field in TUBE_FIELDS},
    **{field: words for field, (words, _, _) in PIECE_FIELDS.items()},
    "offset": "offset",
    "angle": "angle of the offset",
    "sheath_stiffness": "bending stiffness of the sheath",
    "sheath_rigid_length": "rigid length of the sheath",
    "sheath_rigid_from": "start of the rigid tip of the sheath",
    "sheath_diameter": "inner diameter of the sheath",
}

# How a dimension is shown: its unit, and what turns SI into it.
UNITS = {
    "curvature": ("1/m", 1.0),
    **dict.fromkeys(TUBE_FIELDS[1:], ("mm", 1000.0)),
    **{field: (unit, factor) for field, (_, unit, factor) in PIECE_FIELDS.items()},
    "offset": ("mm", 1000.0),
    "angle": ("deg", 180 / np.pi),
    "sheath_stiffness": ("N mm^2", 1e6),
    **dict.fromkeys(("sheath_diameter", "sheath_rigid_length", "sheath_rigid_from"), ("mm", 1000.0)),
}

# Dimensions of whole tubes that may be free where tubes are made of pieces.
WHOLE = ("straight_length", "curved_length", *DIAMETERS)

# Coefficients of the curvature along a piece: higher degrees add oscillations along the piece that no mold shapes.
MAX_COEFFICIENTS = 12

# Dimensions and stiffnesses whose derivatives by the unknowns are computed, n each.
GRADED = (*TUBE_FIELDS, *STIFFNESSES)


@dataclass(frozen=True)
class Free(Displayed):
    """A dimension of some tubes that the design may choose.

    Fields that begin with "piece_" have one value per piece, or one for all with "equal". The lengths of the pieces
    stay, and a tube of one curvature is one piece. Their meaning:

    - Curvature scales the bend of a piece.
    - A shape is a polynomial for the curvature about the x axis: the sum of c_k T_k(x) with Chebyshev's T_k and x = -1
      .. 1 along the piece.
    - The rotation of the bend plane counts from the present direction of the piece.
    - Stiffness factors count from the present stiffnesses of the piece.

    Raises:
        InputError: unknown field or tie, no tube, bounds that are not finite or crossed.
    """

    field: str
    """Name of the dimension, one of `FIELDS`."""
    tubes: tuple[int, ...]
    """Tubes, from 0, inner to outer; () for a dimension of the sheath."""
    lower: float
    """SI; for "scaled", a factor."""
    upper: float
    """SI; for "scaled", a factor."""
    tie: str = "each"
    """"each": one value per tube; "equal": one value for all; "scaled": one factor that multiplies all."""
    pieces: tuple[int, ...] = ()
    """Pieces, from 0, from the straight part to the tip; () means all."""
    coefficients: int = 1
    """Number of coefficients of a shape."""
    torsion_share: float | None = None
    """Measured ratio for slotted tubes: bending factor b gives the torsion factor 1 - torsion_share (1 - b). With None
    the torsional stiffness does not change."""
    slots: Slots | None = None
    """Geometry of the slots that produce a bending factor, for the strain; None takes the slots of the pieces."""

    def __post_init__(self) -> None:
        choice("field of a free dimension", self.field, FIELDS)
        choice("tie of a free dimension", self.tie, TIES)
        what = f"tubes of the free {NAMES[self.field]}"
        numbers = items(what, self.tubes, object, "tubes, counted from 0")
        object.__setattr__(self, "tubes", tuple(whole(f"one of the {what}", i) for i in numbers))
        of_sheath = self.field in SHEATH
        if of_sheath and (self.tubes or self.tie == "scaled"):
            raise InputError(f"{what} are given; a sheath has no tubes, and its range is no factor")
        if not self.tubes and not of_sheath:
            raise InputError(f"{what} is empty; there must be at least one")
        twice = [i for k, i in enumerate(self.tubes) if i in self.tubes[:k]]
        if twice:
            raise InputError(f"{what} has tube {twice[0] + 1} twice; tubes must be different")
        low, high = (finite(f"{name} bound of {NAMES[self.field]}", getattr(self, name)) for name in ("lower", "upper"))
        if low > high:
            raise InputError(f"bounds of {NAMES[self.field]} are {low:g} and {high:g}; the lower must not be greater")
        signed = ("curvature", "angle", "piece_curvature", "piece_shape", "piece_plane", "piece_twist")
        if low < 0 and (self.field not in signed or self.tie == "scaled"):
            raise InputError(f"lower bound of {NAMES[self.field]} is {low:g}; it must be at least 0")
        self._check_pieces()

    def _check_pieces(self) -> None:
        object.__setattr__(
            self,
            "pieces",
            tuple(
                whole("one of the pieces", j, 0) for j in items("pieces", self.pieces, object, "pieces, counted from 0")
            ),
        )
        whole("coefficients", self.coefficients, 1)
        name, of_piece = NAMES[self.field], self.field in PIECE_FIELDS
        if of_piece and self.tie == "scaled":
            raise InputError(f"tie of the {name} is 'scaled'; for pieces it must be 'each' or 'equal'")
        if not of_piece and self.pieces:
            raise InputError(f"pieces are given for the {name}; it is a dimension of whole tubes")
        if self.coefficients > 1 and self.field != "piece_shape":
            raise InputError(f"coefficients is {self.coefficients} for the {name}; only a piece_shape has them")
        if self.coefficients > MAX_COEFFICIENTS:
            raise InputError(f"coefficients is {self.coefficients}; it must be at most {MAX_COEFFICIENTS}")
        if self.field.endswith("_factor") and not 0 < self.lower <= self.upper <= 1:
            raise InputError(f"bounds of the {name} are {self.lower:g} and {self.upper:g}; they must be in (0, 1]")
        if self.slots is not None and self.field != "piece_bending_factor":
            raise InputError(f"slots are given for the {name}; they belong to a piece_bending_factor")
        if self.torsion_share is None:
            return
        if self.field != "piece_bending_factor":
            raise InputError(f"torsion_share is given for the {name}; it belongs to a piece_bending_factor")
        if not 0 <= finite("torsion_share", self.torsion_share) <= 1:
            raise InputError(f"torsion_share is {self.torsion_share:g}; it must be 0 to 1")


@dataclass(frozen=True, eq=False)
class DesignSpace:
    """The D unknowns of a design, one per free value: (D,) in SI, factors where scaled."""

    robot: Robot
    """Robot with the starting dimensions."""
    robot_tubes: tuple[Tube, ...]
    """Tubes of the robot, of pieces if the design has such unknowns."""
    unknowns: tuple[Unknown, ...]
    start: Array
    lower: Array
    upper: Array
    scale: Array
    """Typical changes (D,)."""
    pieced: bool = False
    """True if the design has unknowns of pieces; all `robot_tubes` are then made of pieces."""

    @property
    def names(self) -> tuple[str, ...]:
        """Description of each unknown."""
        return tuple(_piece_text(unknown) if unknown.pieces else _tube_text(unknown) for unknown in self.unknowns)

    @property
    def pieces(self) -> list[int]:
        """Number of pieces of each tube; a tube of one curvature is one piece."""
        return [len(tube.pieces) or 1 for tube in self.robot_tubes]

    @cached_property
    def arranged(self) -> dict[str, tuple[float, ...]]:
        """Starting values of PLACES (n,) and of the SHEATH (1,) of a bundle.

        A sheath that touches the tubes has no diameter of its own.
        """
        robot = self.robot
        if not isinstance(robot, BundleRobot):
            return {}
        out = {"offset": robot.offset, "angle": robot.angle}
        out |= {name: (value,) for name in OF_SHEATH if (value := getattr(robot, name)) is not None}
        if robot.sheath_diameter is not None or any(unknown.field == "sheath_diameter" for unknown in self.unknowns):
            out["sheath_diameter"] = (robot.sheath_diameter or robot.least_sheath_diameter,)
        return out

    def arrangement(self, x: Array) -> dict[str, tuple[float, ...]]:
        """PLACES (n,) and numbers of the SHEATH (1,) of a bundle at x (D,), as `arranged`."""
        out = {name: list(values) for name, values in self.arranged.items()}
        for unknown, value in zip(self.unknowns, x.tolist(), strict=True):
            for i in unknown.entries if unknown.field in out else ():
                out[unknown.field][i] = value * (self.arranged[unknown.field][i] if unknown.scaled else 1.0)
        return {name: tuple(values) for name, values in out.items()}

    def fields(self, x: Array) -> dict[str, Any]:
        """Fields of the robot at x (D,) that depend on unknowns; raises InputError for tubes without a wall."""
        arrangement = self.arrangement(x)
        sheath = {name: arrangement.pop(name)[0] for name in SHEATH if name in arrangement}
        return {"tubes": self.tubes(x), **arrangement, **sheath}

    def tubes(self, x: Array) -> tuple[Tube, ...]:
        """Tubes at x (D,); raises InputError if they have no wall."""
        values: list[dict[str, float]] = [{} for _ in self.robot_tubes]
        for unknown, value in zip(self.unknowns, x, strict=True):
            for i in unknown.tubes if unknown.field in TUBE_FIELDS else ():
                values[i][unknown.field] = float(value) * (
                    getattr(self.robot_tubes[i], unknown.field) if unknown.scaled else 1.0
                )
        changed = tuple(_changed(tube, changes) for tube, changes in zip(self.robot_tubes, values, strict=True))
        return changed_tubes(changed, piece_values(self.unknowns, x.tolist())) if self.pieced else changed

    def expressions(self, x: Any) -> dict[str, Any]:
        """Expressions (n,) of all GRADED dimensions and of the arrangement in x (D,)."""
        out: dict[str, Any] = {}
        start = {name: tuple(getattr(tube, name) for tube in self.robot_tubes) for name in GRADED} | self.arranged
        for name, row in start.items():
            column = ca.MX(list(row))
            for k, unknown in enumerate(self.unknowns):
                for i in unknown.entries if unknown.field == name else ():
                    column[i] = x[k] * (row[i] if unknown.scaled else 1.0)
            out[name] = column
        if any(unknown.field in DIAMETERS for unknown in self.unknowns):
            second = second_moment(out["outer_diameter"], out["inner_diameter"])
            before = ca.DM([tube.second_moment for tube in self.robot_tubes])
            for name in STIFFNESSES:
                out[name] = out[name] * second / before
        return out

    def bend_slopes(self, tubes: Sequence[Tube], x: Array) -> Array:
        """Derivative (n, D) of the largest curvature of tubes made of pieces."""
        out = np.zeros((len(tubes), len(self.unknowns)))
        for i, tube in enumerate(tubes):
            for j, piece in enumerate(tube.pieces):
                # Pieces that share the largest curvature, but for round-off; the steepest slope counts.
                if piece.largest_curvature >= tube.curvature * (1 - 1e-12):
                    slope = self.bend_slope(tube, (i, j), x)
                    out[i] = np.where(np.abs(slope) > np.abs(out[i]), slope, out[i])
        return out

    def bend_slope(self, tube: Tube, position: PieceIndex, x: Array) -> Array:
        """Gradient (D,) of the largest curvature of a piece."""
        piece = tube.pieces[position[1]]
        slopes = [
            largest_bend_slope(piece, unknown, value) if position in unknown.pieces else 0.0
            for unknown, value in zip(self.unknowns, x.tolist(), strict=True)
        ]
        return np.array(slopes)

    @cached_property
    def _graded(self) -> ca.Function:
        x = ca.MX.sym("x", len(self.unknowns))
        slopes = [ca.densify(ca.jacobian(column, x)) for column in self.expressions(x).values()]
        return ca.Function("slopes", [x], slopes)

    def slopes(self, x: Array) -> dict[str, Array]:
        """Derivatives (n, D) of all GRADED dimensions and of the arrangement by x (D,)."""
        names = (*GRADED, *self.arranged)
        return {name: slope.full() for name, slope in zip(names, self._graded(x), strict=True)}


def _changed(tube: Tube, changes: dict[str, float]) -> Tube:
    """Tube with other dimensions; its pieces scale in proportion."""
    # At once: with only one diameter changed, a tube may have no wall.
    at_once = [name for name in changes if name in DIAMETERS or not tube.general]
    changed = of_section(tube, **{name: changes[name] for name in at_once}) if at_once else tube
    for name in changes:
        if name not in at_once:
            changed = changed.resized(name, changes[name])
    return changed


def _entries(free: Sequence[Free]) -> list[tuple[Free, Unknown]]:
    """Unknowns that are dimensions of whole tubes, each with its free dimension."""
    taken: set[tuple[str, int]] = set()
    entries = []
    for dimension in free:
        for i in dimension.tubes:
            if (dimension.field, i) in taken:
                raise InputError(f"{NAMES[dimension.field]} of tube {i + 1} is free twice; it must be named once")
            taken.add((dimension.field, i))
        each = dimension.tie == "each" and dimension.tubes
        groups = [(i,) for i in dimension.tubes] if each else [dimension.tubes]
        entries += [(dimension, Unknown(dimension.field, group, dimension.tie == "scaled")) for group in groups]
    return entries


def design_space(robot: Robot, free: Sequence[Free]) -> DesignSpace:
    """Unknowns of a design that starts from a robot; the start is clipped to the bounds."""
    tubes: Sequence[Tube] = robot.tubes
    for dimension in free:
        of_bundles, is_bundle = dimension.field in (*PLACES, *SHEATH), isinstance(robot, BundleRobot)
        if of_bundles and not is_bundle:
            raise InputError(f"free {NAMES[dimension.field]} is a dimension of eccentric robots; the tubes are nested")
        if dimension.field == "sheath_rigid_from" and getattr(robot, dimension.field) is None:
            raise InputError(f"free {NAMES[dimension.field]} needs a sheath with a rigid tip")
        if is_bundle and dimension.field in PIECE_FIELDS:
            raise InputError(f"free {NAMES[dimension.field]} is a dimension of nested tubes; the robot is eccentric")
        for i in dimension.tubes:
            if not 0 <= i < len(tubes):
                raise InputError(
                    f"free {NAMES[dimension.field]} names tube {i + 1}; the robot has tubes 1 to {len(tubes)}"
                )
    pieced = any(dimension.field in PIECE_FIELDS for dimension in free) or any(tube.general for tube in tubes)
    if pieced:
        tubes, entries = _piece_entries(tuple(as_pieces(tube) for tube in tubes), free)
    else:
        entries = _entries(free)
    if not entries:
        raise InputError("free is empty; a design needs at least one free dimension")
    lower, upper = (np.array([getattr(dimension, side) for dimension, _ in entries]) for side in ("lower", "upper"))
    unknowns = tuple(unknown for _, unknown in entries)
    start = np.clip([start_of(robot, tubes, unknown) for unknown in unknowns], lower, upper)
    span = np.where(upper > lower, upper - lower, 1.0)
    # The size of the start, from a tenth of the range to all of it: near 0 it would make steps of no size.
    scale = np.where(np.abs(start) > 0, np.minimum(span, np.maximum(np.abs(start), 0.1 * span)), span)
    return DesignSpace(robot, tuple(tubes), unknowns, start, lower, upper, scale, pieced)


def _tube_text(unknown: Unknown) -> str:
    if not unknown.tubes:
        return NAMES[unknown.field]
    tubes = ", ".join(str(i + 1) for i in unknown.tubes)
    factor = "factor of " if unknown.scaled else ""
    return f"{factor}{NAMES[unknown.field]} of tube{'s' * (len(unknown.tubes) > 1)} {tubes}"


def _piece_text(unknown: Unknown) -> str:
    names = ", ".join(f"{j + 1} of tube {i + 1}" for i, j in unknown.pieces)
    order = f"{unknown.order + 1}. " if unknown.field == "piece_shape" else ""
    return f"{order}{NAMES[unknown.field]} of piece{'s' * (len(unknown.pieces) > 1)} {names}"


def _piece_entries(
    tubes: tuple[Tube, ...], free: Sequence[Free]
) -> tuple[tuple[Tube, ...], list[tuple[Free, Unknown]]]:
    """Tubes with the free slots, and the unknowns of a design of pieces, each with its free dimension."""
    of_tubes = [dimension for dimension in free if dimension.field in WHOLE]
    entries = _entries(of_tubes)
    for dimension in free:
        if dimension in of_tubes:
            continue
        if dimension.field not in PIECE_FIELDS:
            raise InputError(
                f"free {NAMES[dimension.field]} is a dimension of whole tubes; for tubes made of "
                "pieces only their lengths and diameters can be free; use piece_curvature "
                "for the curvature of pieces"
            )
        positions = [position for i in dimension.tubes for position in _places(dimension, i, tubes)]
        taken = {(other.field, position) for _, other in entries for position in other.pieces}
        if dimension.slots is not None:
            tubes = with_slots(tubes, positions, dimension.slots)
        for i, j in positions:
            if (dimension.field, (i, j)) in taken:
                raise InputError(
                    f"{NAMES[dimension.field]} of piece {j + 1} of tube {i + 1} is free twice; name it once"
                )
            # The constant coefficient of a shape is a curvature: both free would be two unknowns for one number.
            other = {"piece_shape": "piece_curvature", "piece_curvature": "piece_shape"}.get(dimension.field)
            if (other, (i, j)) in taken:
                raise InputError(
                    f"piece {j + 1} of tube {i + 1} has a free curvature and a free shape; it has one of them"
                )
        for group in [(position,) for position in positions] if dimension.tie == "each" else [tuple(positions)]:
            tube_numbers = tuple(sorted({i for i, _ in group}))
            unknowns = (
                Unknown(
                    field=dimension.field,
                    tubes=tube_numbers,
                    scaled=False,
                    pieces=group,
                    order=k,
                    torsion_share=dimension.torsion_share,
                )
                for k in range(dimension.coefficients)
            )
            entries += [(dimension, unknown) for unknown in unknowns]
    return tubes, entries


def _places(dimension: Free, i: int, tubes: Sequence[Tube]) -> list[tuple[int, int]]:
    """Tube and piece numbers that a free dimension covers in tube i."""
    count = len(tubes[i].pieces)
    for j in dimension.pieces:
        if j >= count:
            raise InputError(
                f"free {NAMES[dimension.field]} names piece {j + 1} of tube {i + 1}; it has {count} pieces"
            )
    return [(i, j) for j in (dimension.pieces or range(count))]
