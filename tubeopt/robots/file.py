"""Robot files (YAML) and waypoint files of joint values (CSV): keys, reading and writing.

Keys carry their unit; the library is in SI. The dataclasses check conditions between the parts of a robot, and their
messages are shown with the file and the path of the part.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from decimal import Decimal
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from ..arguments import typed
from ..errors import InputError, without_unit_warnings
from ..files.checked import Entry, NotNegative, Number, Positive, check_kind, in_file, unusual
from ..files.csv_file import CsvTable, read_csv, to_csv
from ..files.field_metadata import Typical
from ..files.fields import EntryOf, Part, keys_from, named_or, to_data, values
from ..files.files import write_text
from ..files.shipped import find_file
from ..files.units import DEG, MM, PER_M, UNITS, in_unit, parse_number, to_si
from ..files.yaml_file import load_yaml, to_yaml
from ..typing import Array
from .calibration import TABLES, Calibration, Posterior
from .concentric import ConcentricRobot, Friction, friction_of
from .eccentric import LARGEST_OFFSET, BundleRobot, EccentricRobot, SegmentedEccentricRobot, SheathedRobot
from .limits import JointLimits, reading_fault
from .materials import MATERIALS, NITINOL, Material
from .passport import Passport, load_passport
from .pieces import BEND, LENGTH, Piece, Precurvature, Quantity, Series, Slots, check_table, extremes, turned
from .robot import Robot
from .tubes import OfCrossSection, Tube, material_doubts

DEG_PER_MM, N_MM2 = UNITS["deg_per_mm"], UNITS["N_mm2"]

# Typical radius and pitch of a piece or a helix, m.
RADIUS = PITCH = Typical(5e-4, 10.0)

# A stiffness outside these multiples of that of the cross-section has a wrong unit. A drive shaft beside the tube, or a
# braid, may make it torsionally rigid; numbers in N m^2 are off by 1e6.
MIN_STIFFNESS_RATIO, MAX_STIFFNESS_RATIO = 1e-4, {"bending": 10.0, "torsional": 1e4}

COLUMNS = ("arc_length_mm", "curvature_x_per_m", "curvature_y_per_m")
# Columns of a table of precurvature; the twist may be left out.
TWIST = "twist_deg_per_mm"


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
    """Arc lengths (k,), m, and precurvature (k, 3), 1/m, of a table in a CSV file."""
    table = read_csv(path, (*COLUMNS, TWIST))
    table.expect(COLUMNS, [TWIST])
    s = table.numbers(COLUMNS[:1], MM)[:, 0]
    u = np.zeros((len(s), 3))
    u[:, :2] = table.numbers(COLUMNS[1:], PER_M)
    if TWIST in table.columns:
        u[:, 2] = table.numbers([TWIST], DEG_PER_MM)[:, 0]
    table.check()
    end = in_unit(float(s[-1]), MM) if len(s) else 0
    for warning in unusual("the last arc_length_mm", "mm", Decimal(repr(end)), LENGTH):
        LOGGER.warning(f"{path}: {warning}")
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
        """Piece in SI, of a tube with these diameters and stiffnesses."""
        length = self._length()
        x, y, z = self._precurvature()
        if self.helix is not None:
            _check_pitch(self.helix, length, tube.outer_diameter)
        if self.plane_deg is not None:
            x, y = turned(x, y, to_si(self.plane_deg, DEG))
        kb, kt = float(tube.bending_stiffness), float(tube.torsional_stiffness)
        bending, torsional = self._stiffness(kb, kt)
        for name, stiffness, of_section in (("bending", bending, kb), ("torsional", torsional, kt)):
            for value in () if stiffness is None else extremes([stiffness], length):
                check_stiffness(f"{name}_stiffness_N_mm2", value, of_section)
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

    def _precurvature(self) -> Precurvature:
        forms = ("radius_mm", "curvature_per_m", "helix", "table")
        used = [name for name in forms if getattr(self, name) is not None]
        if len(used) > 1:
            raise InputError(f"{used[0]} and {used[1]} are both given; a piece has one of {', '.join(forms)}")
        if self.twist_deg_per_mm is not None and used and used[0] in ("helix", "table"):
            raise InputError(f"twist_deg_per_mm and {used[0]} are both given; a {used[0]} already defines the twist")
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
        curvature = self.curvature_per_m
        if curvature is None:
            return 0.0, 0.0, twist
        parts = curvature if isinstance(curvature, list) else [curvature, Decimal(0)]
        return _quantity(parts[0], PER_M), _quantity(parts[1], PER_M), twist

    def _stiffness(self, kb: float, kt: float) -> tuple[Quantity | None, Quantity | None]:
        """Stiffnesses of a piece in a tube with kb and kt; None for those of the tube."""
        entries = (self.bending_stiffness_N_mm2, self.torsional_stiffness_N_mm2)
        if self.pattern is None:
            bending, torsional = (None if entry is None else _quantity(entry, N_MM2) for entry in entries)
            return bending, torsional
        if entries != (None, None):
            raise InputError("pattern and a stiffness are both given; a piece has one or the other")
        return kb * float(self.pattern.bending_factor), kt * float(self.pattern.torsion_factor)


def _check_pitch(helix: HelixEntry, length: float, diameter: float) -> None:
    """Raise InputError if turns of a helix would intersect."""
    pitch = to_si(helix.pitch_mm, MM)
    # A turn is hypot(2 pi R, p) long; a shorter helix has no second turn.
    if pitch <= diameter and length > np.hypot(2 * np.pi * to_si(helix.radius_mm, MM), pitch):
        raise InputError(
            f"helix.pitch_mm is {helix.pitch_mm}; it must exceed the tube's diameter, {diameter * 1e3:g} mm"
        )


def _quantity(entry: Decimal | SeriesEntry, unit: Decimal) -> Quantity:
    return entry.series(unit) if isinstance(entry, SeriesEntry) else to_si(entry, unit)


def check_stiffness(name: str, value: float, of_section: float) -> None:
    """Raise InputError if a stiffness is implausible for a cross-section of stiffness `of_section`, both N m^2."""
    most = MAX_STIFFNESS_RATIO[name.partition("_")[0]]
    if not MIN_STIFFNESS_RATIO * of_section <= value <= most * of_section:
        raise InputError(
            f"{name} is {value * 1e6:.10g}; the cross-section and material give {of_section * 1e6:.4g}, and it must be "
            f"{MIN_STIFFNESS_RATIO:g} to {most:g} times that"
        )


def piece_to_dict(piece: Piece) -> dict[str, Any]:
    """Convert a piece to the keys and units of a robot file."""
    x, y, z = piece.precurvature
    data: dict[str, Any] = {
        "length_mm": in_unit(piece.length, MM),
        "curvature_per_m": [_written(x, PER_M), _written(y, PER_M)],
    }
    if z != 0.0:
        data["twist_deg_per_mm"] = _written(z, DEG_PER_MM)
    for name in ("bending_stiffness", "torsional_stiffness"):
        stiffness = getattr(piece, name)
        if stiffness is not None:
            data[f"{name}_N_mm2"] = _written(stiffness, N_MM2)
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


LOGGER = logging.getLogger(__name__)

STIFFNESSES = ("bending_stiffness", "torsional_stiffness")


def _one_of(key: str, other: str, *, both: bool) -> str:
    return f"gives {f'both {key} and' if both else f'neither {key} nor'} {other}; it must give one of them"


@keys_from(Material)
class MaterialEntry(Part):
    """An isotropic, linear-elastic material: Young's modulus, and either the shear modulus or Poisson's ratio."""

    shear_modulus_GPa: Positive | None = Field(None, description="shear modulus; alternatively Poisson's ratio")
    poisson_ratio: NotNegative | None = None

    def build(self) -> Material:
        """Material in SI."""
        data = values(Material, self)
        if ("shear_modulus" in data) == (self.poisson_ratio is not None):
            raise ValueError(_one_of("shear_modulus_GPa", "poisson_ratio", both=self.poisson_ratio is not None))
        if self.poisson_ratio is not None:
            isotropic = Material.from_poisson_ratio(data["name"], data["youngs_modulus"], float(self.poisson_ratio))
            data["shear_modulus"] = isotropic.shear_modulus
        material = Material(**data)
        # A material with the constants of NITINOL also gets its thermal data.
        return NITINOL if material == replace(NITINOL, thermal=None) else material


if TYPE_CHECKING:
    MaterialChoice = str | MaterialEntry
else:
    MaterialChoice = named_or(MaterialEntry, MATERIALS)


def material_of(choice: MaterialChoice) -> Material:
    """Material of a name or an entry."""
    return MATERIALS[choice] if isinstance(choice, str) else choice.build()


@keys_from(Tube)
class TubeEntry(Part):
    """A tube: a straight part, then a curved part with a curvature or radius, or pieces."""

    pieces: list[PieceEntry] | None = Field(
        None, min_length=1, description="pieces of the tube after its straight part, in order"
    )
    curved_length_mm: Annotated[NotNegative | None, Typical(1e-3, 10.0)] = Field(
        None, validate_default=True, description="length of the curved part; optional with pieces"
    )
    curvature_per_m: Annotated[Number | None, Typical(0.1, 2000.0)] = Field(
        None, description="precurvature; 0 for a straight tube, negative for the opposite direction"
    )
    radius_mm: Positive | None = Field(None, description="radius of the precurvature, instead of curvature_per_m")
    material: MaterialChoice = "nitinol"
    passport: Annotated[Passport, in_file(load_passport, "a passport", kind=Passport)] | None = Field(
        None,
        description="path of the passport of the tube, relative to this file; its measured radius replaces the drawn",
    )

    @field_validator("curved_length_mm")
    @classmethod
    def _curved_length_present(cls, value: Decimal | None, info: ValidationInfo) -> Decimal | None:
        if value is None and info.data.get("pieces", 0) is None:
            raise PydanticCustomError("missing", "Field required")
        return value

    @field_validator("inner_diameter_mm", check_fields=False)
    @classmethod
    def _hollow(cls, value: Decimal, info: ValidationInfo) -> Decimal:
        outer = info.data.get("outer_diameter_mm")
        if outer is not None and value >= outer:
            raise ValueError(f"is {value}; it must be less than outer_diameter_mm ({outer})")
        return value

    def build(self) -> Tube:
        """Tube in SI."""
        data = values(Tube, self) | {"material": material_of(self.material)}
        if self.pieces is None:
            data["curvature"] = self._curvature()
        stiffness = {name: data.pop(name) for name in STIFFNESSES if name in data}
        # Pieces replace length and curvature below. Any valid tube gives the stiffness of the cross-section.
        plain = Tube(**{"curved_length": 0.0 if self.curved_length_mm == 0 else 1e-3, "curvature": 0.0} | data)
        for name, value in stiffness.items():
            check_stiffness(f"{name}_N_mm2", value, getattr(plain, name))
        tube = replace(plain, **stiffness)
        return tube if self.pieces is None else self._of_pieces(tube, self.pieces)

    def _curvature(self) -> float:
        if (self.curvature_per_m is None) == (self.radius_mm is None):
            raise ValueError(_one_of("curvature_per_m", "radius_mm", both=self.radius_mm is not None))
        drawn = float(1 / (self.radius_mm * MM) if self.radius_mm is not None else self.curvature_per_m or 0)
        measured = None if self.passport is None else self.passport.measured
        return drawn if measured is None else math.copysign(1 / measured.radius, drawn)

    def _of_pieces(self, tube: Tube, entries: list[PieceEntry]) -> Tube:
        """Tube of pieces with the cross-section, material and stiffnesses of `tube`."""
        for name in ("curvature_per_m", "radius_mm"):
            if getattr(self, name) is not None:
                raise InputError(f"{name} and pieces are both given; give the curvature of each piece instead")
        pieces = []
        for k, entry in enumerate(entries):
            try:
                pieces.append(entry.build(tube))
            except InputError as error:
                raise InputError("\n".join(f"pieces[{k}]: {line}" for line in str(error).splitlines())) from None
        total = sum(piece.length for piece in pieces)
        if self.curved_length_mm is not None and abs(to_si(self.curved_length_mm, MM) - total) > 1e-9:
            raise InputError(
                f"curved_length_mm is {self.curved_length_mm}; the lengths of the pieces add up to {total * 1e3:g}"
            )
        names = ("straight_length", "material", *STIFFNESSES, "mass_per_length")
        common = {name: getattr(tube, name) for name in names}
        return Tube.of_pieces(tube.outer_diameter, tube.inner_diameter, pieces, **common)


Range = Annotated[list[Number], Field(min_length=2, max_length=2)]
"""Smallest and largest value."""


@keys_from(Calibration)
class CalibrationEntry(Part):
    """Conversion of joint readings to joint values: gain times reading plus offset, one number per tube."""

    def build(self) -> Calibration:
        """Calibration in SI; omitted tables are taken from `Calibration.none`."""
        data = values(Calibration, self)
        none = Calibration.none(max((len(data[name]) for name in TABLES if name in data), default=0))
        return Calibration(**{name: getattr(none, name) for name in TABLES} | data)


class RobotEntry(Part):
    """Keys of all kinds of robot."""

    kind: str
    name: str = ""
    limits: EntryOf[JointLimits] | None = Field(
        None, description="joint limits of the actuators; by default the range given by the tube lengths"
    )
    calibration: CalibrationEntry | None = Field(None, description="conversion of joint readings to joint values")
    posterior: EntryOf[Posterior] | None = Field(
        None, description="uncertainty of the parameters, written by `tubeopt validate --fit`"
    )

    def common(self) -> dict[str, Any]:
        """Name, limits, calibration and uncertainty in SI."""
        return {
            "name": self.name,
            "joint_limits": self.limits.build() if self.limits else None,
            "calibration": self.calibration.build() if self.calibration else None,
            "posterior": self.posterior.build() if self.posterior else None,
        }


class ConcentricEntry(RobotEntry):
    """A concentric tube robot, tubes inner to outer."""

    kind: Literal["concentric"]
    tubes: list[TubeEntry] = Field(min_length=1)
    friction: EntryOf[Friction] | None = Field(None, description="friction between neighbouring tubes; default none")
    clearance_mm: list[NotNegative] | None = Field(
        None,
        description="radial gaps between neighbouring tubes: a list of one per pair, or of one for all; default 0",
    )

    def build(self) -> ConcentricRobot:
        """Robot in SI."""
        friction = self.friction.build() if self.friction else None
        tubes = tuple(tube.build() for tube in self.tubes)
        return ConcentricRobot(tubes, **self.common(), friction=friction, clearance=self.si("clearance_mm"))


Model = Literal["thesis", "energy"]
MODEL: Any = Field(
    None,
    description="thesis: a balance of moments, with tubes that end together; energy: that of a bundle; default thesis, "
    f"energy under loads and friction, and for offset times curvature above {LARGEST_OFFSET:g}",
)


@keys_from(EccentricRobot)
class EccentricEntry(RobotEntry):
    """A one-segment eccentric tube robot: three equal tubes side by side in a sheath."""

    kind: Literal["eccentric"]
    tube: TubeEntry
    model: Model | None = MODEL

    def build(self) -> EccentricRobot | BundleRobot:
        """Robot in SI."""
        stated = "thesis" if self.model == "thesis" else None
        robot = EccentricRobot(self.tube.build(), **values(EccentricRobot, self), **self.common(), model=stated)
        return robot.bundle() if self.model == "energy" else robot.modelled()


@keys_from(SegmentedEccentricRobot)
class SegmentedEccentricEntry(RobotEntry):
    """An eccentric tube robot of telescoping segments, inner to outer."""

    kind: Literal["segmented_eccentric"]
    segments: list[TubeEntry] = Field(min_length=1)
    model: Model | None = MODEL

    def build(self) -> SegmentedEccentricRobot | BundleRobot:
        """Robot in SI."""
        segments = tuple(tube.build() for tube in self.segments)
        given, stated = values(SegmentedEccentricRobot, self), "thesis" if self.model == "thesis" else None
        robot = SegmentedEccentricRobot(segments, **given, **self.common(), model=stated)
        return robot.bundle() if self.model == "energy" else robot.modelled()


OF_BUNDLE = (
    "sheath_stiffness",
    "sheath_diameter",
    "sheath_rigid_length",
    "sheath_rigid_from",
    "nested_curves",
    "buffer",
)


class BundleTubeEntry(TubeEntry):
    """A tube of a bundle, with its place in the sheath."""

    offset_mm: NotNegative = Field(description="distance of the tube's axis from the centreline")
    angle_deg: Number = Field(Decimal(0), description="direction of the tube's axis from the centreline")
    carriage: int | None = Field(None, description="number of the carriage; by default the tube has its own")


@keys_from(BundleRobot, *OF_BUNDLE)
class BundleEntry(RobotEntry):
    """Tubes at any offsets in a sheath, each with its own length, rotation and translation."""

    kind: Literal["bundle"]
    tubes: list[BundleTubeEntry] = Field(min_length=1)
    friction: EntryOf[Friction] | None = Field(
        None, description="friction of the tubes in their channels; default none"
    )

    def build(self) -> BundleRobot:
        """Robot in SI."""
        return BundleRobot(
            tuple(tube.build() for tube in self.tubes),
            tuple(to_si(tube.offset_mm, MM) for tube in self.tubes),
            tuple(to_si(tube.angle_deg, DEG) for tube in self.tubes),
            **values(BundleRobot, self, *OF_BUNDLE),
            **self.common(),
            carriages=self._carriages(),
            friction=self.friction.build() if self.friction else None,
        )

    def _carriages(self) -> tuple[tuple[int, ...], ...] | None:
        """Tubes of each carriage; None if each tube has its own."""
        groups = dict[Any, list[int]]()
        for i, tube in enumerate(self.tubes):
            groups.setdefault(("own", i) if tube.carriage is None else tube.carriage, []).append(i)
        return None if len(groups) == len(self.tubes) else tuple(map(tuple, groups.values()))


AnyRobot = ConcentricRobot | EccentricRobot | SegmentedEccentricRobot | BundleRobot
"""Robots of robot files."""

# Models of a robot file by its key `kind`.
ROBOT_KINDS: dict[
    str, type[ConcentricEntry] | type[EccentricEntry] | type[SegmentedEccentricEntry] | type[BundleEntry]
] = {
    "concentric": ConcentricEntry,
    "eccentric": EccentricEntry,
    "segmented_eccentric": SegmentedEccentricEntry,
    "bundle": BundleEntry,
}


@typed
def load_robot(path: str | PathLike[str]) -> AnyRobot:
    """Robot in a YAML file, or the built-in robot of this name (`tubeopt robot list` shows them).

    A file of exactly this path is preferred.

    Raises:
        InputError: no such file or name, not YAML, or keys or values that make no robot: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("two_tube")
        >>> robot.n_tubes
        2
    """
    path = find_file(path, "robots")
    return robot_from_dict(load_yaml(path), path)


@typed
def save_robot(robot: Robot, path: str | PathLike[str]) -> None:
    """Write `robot` as YAML that `load_robot` turns into an equal robot, to the last bit.

    Raises:
        InputError: the file cannot be written.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tubeopt.save_robot(robot, f"{folder}/robot.yaml")
        ...     tubeopt.load_robot(f"{folder}/robot.yaml") == robot
        True
    """
    write_text(path, robot_to_yaml(robot))


def robot_to_yaml(robot: Robot) -> str:
    """Text of the robot file of `robot`."""
    return to_yaml(robot_to_dict(robot), "A robot for tubeopt.")


def robot_from_dict(data: object, where: str | PathLike[str] = "") -> AnyRobot:
    """Robot from `data` with the keys of a robot file.

    Args:
        where: file name at the start of messages.

    Raises:
        InputError: one line for every problem.
    """
    with without_unit_warnings():
        robot: AnyRobot = check_kind(ROBOT_KINDS, data, where).build()
    # The reader has checked single keys only; these warnings depend on the material.
    for warning in dict.fromkeys(doubt for tube in robot.tubes for doubt in material_doubts(tube)):
        LOGGER.warning(f"{where}: {warning}" if str(where) else warning)
    return robot


def robot_to_dict(robot: Robot) -> dict[str, Any]:
    """Convert a robot to the keys and units of a robot file.

    Numbers are int or float, or `Decimal` where a float in the file's unit would lose the last bit.
    """
    data: dict[str, Any]
    if isinstance(robot, ConcentricRobot):
        data = {"kind": "concentric", "name": robot.name, "tubes": [tube_to_dict(tube) for tube in robot.tubes]}
    elif isinstance(robot, EccentricRobot):
        data = {"kind": "eccentric", "name": robot.name, "tube": tube_to_dict(robot.tube)} | to_data(robot)
    elif isinstance(robot, SegmentedEccentricRobot):
        segments = [tube_to_dict(tube) for tube in robot.segments]
        data = {"kind": "segmented_eccentric", "name": robot.name, "segments": segments} | to_data(robot)
    elif isinstance(robot, BundleRobot):
        offsets = zip(robot.tubes, robot.offset, robot.angle, strict=True)
        tubes = [
            tube_to_dict(tube) | {"offset_mm": in_unit(d, MM), "angle_deg": in_unit(phi, DEG)}
            for tube, d, phi in offsets
        ]
        for number, carriage in enumerate(robot.carriages or (), start=1):
            for i in carriage:
                tubes[i]["carriage"] = number
        data = {"kind": "bundle", "name": robot.name, "tubes": tubes} | to_data(
            robot, ["offset", "angle", "carriages", "friction"]
        )
    else:
        raise InputError(f"robot is a {type(robot).__name__}; it must be one of {', '.join(ROBOT_KINDS)}")
    if isinstance(robot, SheathedRobot) and (robot.model is not None or robot.modelled() is not robot):
        data["model"] = "thesis"
    if robot.joint_limits is not None:
        data["limits"] = to_data(robot.joint_limits)
    if robot.calibration is not None:
        data["calibration"] = calibration_to_dict(robot.calibration)
    if (between := friction_of(robot)) is not None:
        none, friction = to_data(Friction()), to_data(between)
        data["friction"] = {key: value for key, value in friction.items() if value not in (none[key], [none[key]])}
    if isinstance(robot, ConcentricRobot) and robot.clearance is not None:
        data["clearance_mm"] = [in_unit(x, MM) for x in robot.clearance]
    if robot.posterior is not None:
        data["posterior"] = to_data(robot.posterior)
    return data


def tube_to_dict(tube: Tube) -> dict[str, Any]:
    """Convert a tube to the keys and units of a robot file."""
    derived = [name for name in STIFFNESSES if isinstance(getattr(tube, name), OfCrossSection)]
    if tube.pieces:
        data = to_data(tube, [*derived, "curved_length", "curvature"])
        data["pieces"] = [piece_to_dict(piece) for piece in tube.pieces]
    else:
        data = to_data(tube, derived)
    data["material"] = NITINOL.name if tube.material == NITINOL else to_data(tube.material)
    return data


def calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    """Convert a calibration to the keys and units of a robot file, without tables of `Calibration.none`."""
    none, data = to_data(Calibration.none(calibration.n_tubes)), to_data(calibration)
    # One table stays, for the number of tubes.
    return {key: value for key, value in data.items() if value != none.get(key) or key == "rotation_offsets_deg"}


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Joint values at T waypoints."""

    rotations: Array
    """Rotations (T, n), rad."""
    translations: Array
    """Translations (T, n), m."""


def joint_columns(n_tubes: int) -> tuple[list[str], list[str]]:
    """Names of the columns of rotations and translations, inner to outer."""
    tubes = range(1, n_tubes + 1)
    return [f"rotation_{i}_deg" for i in tubes], [f"translation_{i}_mm" for i in tubes]


def joint_cells(rotations: Array, translations: Array) -> list[object]:
    """Cells of `joint_columns`, exact to the last bit: rotations (n,) in deg, translations (n,) in mm."""
    return [*(in_unit(float(x), DEG) for x in rotations), *(in_unit(float(x), MM) for x in translations)]


def check_joints(table: CsvTable, robot: Robot) -> None:
    """Report cells in `joint_columns` that are impossible for the tubes; readings of calibrated drives are skipped."""
    if robot.calibration is not None:
        return
    for columns in joint_columns(robot.n_tubes):
        for column, tube in zip(columns, robot.tubes, strict=True):
            for row in range(len(table.rows) if column in table.columns else 0):
                value = parse_number(table.cell(row, column))
                if isinstance(value, Decimal) and (allowed := reading_fault(tube, column, float(value))):
                    table.complain(row, column, f"is {value}; it must be {allowed}")


def waypoints_csv(rotations: Array, translations: Array) -> str:
    """Text of a waypoint file with rotations (T, n), rad, and translations (T, n), m."""
    rotation_columns, translation_columns = joint_columns(rotations.shape[1])
    return to_csv([*rotation_columns, *translation_columns], map(joint_cells, rotations, translations))


def load_waypoints(path: str | PathLike[str], robot: Robot) -> Waypoints:
    """Waypoints in a CSV file with the columns `joint_columns`; without translations the tubes are at home.

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no number: one line for each
            problem.
    """
    rotation_columns, shift_columns = joint_columns(robot.n_tubes)
    table = read_csv(path, (*rotation_columns, *shift_columns))
    shown = f"{rotation_columns[0]} to {rotation_columns[-1]} and {shift_columns[0]} to {shift_columns[-1]}"
    has_translations = table.expect(rotation_columns, together=shift_columns, shown=shown)
    rotations = table.numbers(rotation_columns, DEG)
    home = np.tile(robot.home_readings, (len(table.rows), 1))
    translations = table.numbers(shift_columns, MM) if has_translations else home
    check_joints(table, robot)
    table.check()
    return Waypoints(rotations, translations)
