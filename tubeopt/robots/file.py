"""Robots as YAML: what the keys are, and the way there and back.

Keys carry their unit; the library behind is in SI. What the parts of a robot demand of each other is checked by the
dataclasses themselves, whose messages are passed on with the file and the path of the part.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from decimal import Decimal
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from ..arguments import typed
from ..errors import InputError, undoubted
from ..files.checked import NotNegative, Number, Positive, check_kind
from ..files.field_metadata import Typical
from ..files.fields import EntryOf, Part, asking, named_or, to_data, values
from ..files.files import write_text
from ..files.shipped import found
from ..files.units import MM, in_unit, to_si
from ..files.yaml_file import load_yaml, to_yaml
from .calibration import TABLES, Calibration
from .concentric import ConcentricRobot
from .eccentric import EccentricRobot, SegmentedEccentricRobot
from .friction import Friction
from .limits import JointLimits
from .materials import MATERIALS, NITINOL, Material
from .piece_file import PieceEntry, check_stiffness, piece_to_dict
from .robot import Robot
from .tubes import OfCrossSection, Tube, material_doubts

LOGGER = logging.getLogger(__name__)

STIFFNESSES = ("bending_stiffness", "torsional_stiffness")


def _one_of(key: str, other: str, *, both: bool) -> str:
    return f"gives {f'both {key} and' if both else f'neither {key} nor'} {other}; it must give one of them"


@asking(Material)
class MaterialEntry(Part):
    """An isotropic, linear-elastic material: Young's modulus, and either the shear modulus or Poisson's ratio."""

    shear_modulus_GPa: Positive | None = Field(None, description="shear modulus; alternatively Poisson's ratio")
    poisson_ratio: NotNegative | None = None

    def build(self) -> Material:
        """The material in SI."""
        given = values(Material, self)
        if ("shear_modulus" in given) == (self.poisson_ratio is not None):
            raise ValueError(_one_of("shear_modulus_GPa", "poisson_ratio", both=self.poisson_ratio is not None))
        if self.poisson_ratio is not None:
            isotropic = Material.from_poisson_ratio(given["name"], given["youngs_modulus"], float(self.poisson_ratio))
            given["shear_modulus"] = isotropic.shear_modulus
        material = Material(**given)
        # Nitinol by its constants is the nitinol that has a name.
        return NITINOL if material == replace(NITINOL, thermal=None) else material


if TYPE_CHECKING:
    MaterialChoice = str | MaterialEntry
else:
    MaterialChoice = named_or(MaterialEntry, MATERIALS)


def material_of(choice: MaterialChoice) -> Material:
    """The material that was chosen."""
    return MATERIALS[choice] if isinstance(choice, str) else choice.build()


@asking(Tube)
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

    @field_validator("curved_length_mm")
    @classmethod
    def _told(cls, value: Decimal | None, info: ValidationInfo) -> Decimal | None:
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
        """The tube in SI."""
        given = values(Tube, self) | {"material": material_of(self.material)}
        if self.pieces is None:
            given["curvature"] = self._curvature()
        stiffness = {name: given.pop(name) for name in STIFFNESSES if name in given}
        plain = Tube(**{"curved_length": 0.0 if self.curved_length_mm == 0 else 1e-3, "curvature": 0.0} | given)
        for name, value in stiffness.items():
            check_stiffness(f"{name}_N_mm2", value, getattr(plain, name))
        tube = replace(plain, **stiffness)
        return tube if self.pieces is None else self._of_pieces(tube, self.pieces)

    def _curvature(self) -> float:
        if (self.curvature_per_m is None) == (self.radius_mm is None):
            raise ValueError(_one_of("curvature_per_m", "radius_mm", both=self.radius_mm is not None))
        return float(1 / (self.radius_mm * MM) if self.radius_mm is not None else self.curvature_per_m or 0)

    def _of_pieces(self, tube: Tube, entries: list[PieceEntry]) -> Tube:
        """A tube like `tube`, made of pieces."""
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
        alike = ("straight_length", "material", *STIFFNESSES, "mass_per_length")
        own = {name: getattr(tube, name) for name in alike}
        return Tube.of_pieces(tube.outer_diameter, tube.inner_diameter, pieces, **own)


Range = Annotated[list[Number], Field(min_length=2, max_length=2)]
"""Least and greatest value."""


@asking(Calibration)
class CalibrationEntry(Part):
    """Conversion of joint readings to joint values: gain times reading plus offset, one number per tube."""

    def build(self) -> Calibration:
        """The calibration in SI; tables that are left out are those of drives that read true."""
        given = values(Calibration, self)
        none = Calibration.none(max((len(given[name]) for name in TABLES if name in given), default=0))
        return Calibration(**{name: getattr(none, name) for name in TABLES} | given)


class RobotEntry(Part):
    """What all kinds of robot have in common."""

    kind: str
    name: str = ""
    limits: EntryOf[JointLimits] | None = Field(
        None, description="joint limits of the actuators; by default the range given by the tube lengths"
    )
    calibration: CalibrationEntry | None = Field(None, description="conversion of joint readings to joint values")

    def common(self) -> dict[str, Any]:
        """Name, limits and calibration in SI."""
        return {
            "name": self.name,
            "joint_limits": self.limits.build() if self.limits else None,
            "calibration": self.calibration.build() if self.calibration else None,
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
        """The robot in SI."""
        friction = self.friction.build() if self.friction else None
        tubes = tuple(tube.build() for tube in self.tubes)
        return ConcentricRobot(tubes, **self.common(), friction=friction, clearance=self.si("clearance_mm"))


@asking(EccentricRobot)
class EccentricEntry(RobotEntry):
    """A one-segment eccentric tube robot: three equal tubes side by side in a sheath."""

    kind: Literal["eccentric"]
    tube: TubeEntry

    def build(self) -> EccentricRobot:
        """The robot in SI."""
        return EccentricRobot(self.tube.build(), **values(EccentricRobot, self), **self.common())


@asking(SegmentedEccentricRobot)
class SegmentedEccentricEntry(RobotEntry):
    """An eccentric tube robot of telescoping segments, inner to outer."""

    kind: Literal["segmented_eccentric"]
    segments: list[TubeEntry] = Field(min_length=1)

    def build(self) -> SegmentedEccentricRobot:
        """The robot in SI."""
        segments = tuple(tube.build() for tube in self.segments)
        return SegmentedEccentricRobot(segments, **values(SegmentedEccentricRobot, self), **self.common())


AnyRobot = ConcentricRobot | EccentricRobot | SegmentedEccentricRobot
"""Every robot that a file can describe."""

ROBOT_KINDS: dict[str, type[ConcentricEntry] | type[EccentricEntry] | type[SegmentedEccentricEntry]] = {
    "concentric": ConcentricEntry,
    "eccentric": EccentricEntry,
    "segmented_eccentric": SegmentedEccentricEntry,
}
"""What the key `kind` of a robot file may say."""


@typed
def load_robot(path: str | PathLike[str]) -> AnyRobot:
    """The robot in a YAML file, or the one of this name that comes with tubeopt (`tubeopt robot list` shows them).

    A file of exactly this path goes first.

    Raises:
        InputError: no such file or name, not YAML, or keys or values that make no robot: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("two_tube")
        >>> robot.n_tubes
        2
    """
    path = found(path, "robots")
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
    """The text of such a file."""
    return to_yaml(robot_to_dict(robot), "A robot for tubeopt.")


def robot_from_dict(data: object, where: str | PathLike[str] = "") -> AnyRobot:
    """The robot that `data`, with the keys of a robot file, describes.

    Args:
        where: what the messages begin with.

    Raises:
        InputError: one line for every problem.
    """
    with undoubted():
        robot: AnyRobot = check_kind(ROBOT_KINDS, data, where).build()
    # In SI units; what the reader says is of single keys, whatever the material is.
    for words in dict.fromkeys(words for tube in robot.tubes for words in material_doubts(tube)):
        LOGGER.warning(f"{where}: {words}" if str(where) else words)
    return robot


def robot_to_dict(robot: Robot) -> dict[str, Any]:
    """`robot` with the keys and units of a robot file.

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
    else:
        raise InputError(f"robot is a {type(robot).__name__}; it must be one of {', '.join(ROBOT_KINDS)}")
    if robot.joint_limits is not None:
        data["limits"] = to_data(robot.joint_limits)
    if robot.calibration is not None:
        data["calibration"] = calibration_to_dict(robot.calibration)
    if isinstance(robot, ConcentricRobot) and robot.friction is not None:
        none, own = to_data(Friction()), to_data(robot.friction)
        data["friction"] = {key: value for key, value in own.items() if value not in (none[key], [none[key]])}
    if isinstance(robot, ConcentricRobot) and robot.clearance is not None:
        data["clearance_mm"] = [in_unit(x, MM) for x in robot.clearance]
    return data


def tube_to_dict(tube: Tube) -> dict[str, Any]:
    """`tube` with the keys and units of a robot file."""
    derived = [name for name in STIFFNESSES if isinstance(getattr(tube, name), OfCrossSection)]
    if tube.pieces:
        data = to_data(tube, [*derived, "curved_length", "curvature"])
        data["pieces"] = [piece_to_dict(piece) for piece in tube.pieces]
    else:
        data = to_data(tube, derived)
    data["material"] = NITINOL.name if tube.material == NITINOL else to_data(tube.material)
    return data


def calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    """A calibration with the keys and units of a robot file; what reads true is left out."""
    none, data = to_data(Calibration.none(calibration.n_tubes)), to_data(calibration)
    # One table stays, to tell how many tubes there are.
    return {key: value for key, value in data.items() if value != none.get(key) or key == "rotation_offsets_deg"}
