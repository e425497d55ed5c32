"""Robots as YAML: what the keys are, and the way there and back.

Keys carry their unit; the library behind is in SI. What the parts of a robot demand of each other is checked by the
dataclasses themselves, whose messages are passed on with the file and the path of the part.
"""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from os import PathLike
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from ..errors import InputError
from ..files.checked import NotNegative, Number, Positive, check_kind
from ..files.fields import Part
from ..files.units import DEG, GPA, MM, PER_M, PERCENT, in_unit, to_si
from ..files.yaml_file import load_yaml, save_yaml
from .calibration import Calibration
from .calibration_file import CalibrationEntry, calibration_to_dict
from .concentric import ConcentricRobot
from .eccentric import EccentricRobot, SegmentedEccentricRobot
from .limits import JointLimits
from .materials import NITINOL, ZERO_CELSIUS, Material, ThermalData
from .piece_file import N_MM2, PieceEntry, given_stiffness, piece_to_dict
from .robot import Robot
from .tubes import OfCrossSection, Tube


def _percent(strain: float) -> Decimal:
    return Decimal(str(in_unit(strain, PERCENT)))


class ThermalEntry(Part):
    """Constants for heating; slopes are relative changes per K from the reference temperature."""

    density_kg_per_m3: Positive
    heat_capacity_J_per_kg_K: Positive
    conductivity_W_per_m_K: Positive
    resistivity_ohm_m: Positive
    expansion_per_K: Positive
    emissivity: Positive
    heat_capacity_slope_per_K: Number = Decimal(0)
    conductivity_slope_per_K: Number = Decimal(0)
    resistivity_slope_per_K: Number = Decimal(0)
    reference_degC: Number = Decimal(25)

    def build(self) -> ThermalData:
        """The constants in SI."""
        return ThermalData(
            density=float(self.density_kg_per_m3),
            heat_capacity=float(self.heat_capacity_J_per_kg_K),
            conductivity=float(self.conductivity_W_per_m_K),
            resistivity=float(self.resistivity_ohm_m),
            expansion=float(self.expansion_per_K),
            emissivity=float(self.emissivity),
            heat_capacity_slope=float(self.heat_capacity_slope_per_K),
            conductivity_slope=float(self.conductivity_slope_per_K),
            resistivity_slope=float(self.resistivity_slope_per_K),
            reference_temperature=float(self.reference_degC + Decimal(str(ZERO_CELSIUS))),
        )


class MaterialEntry(Part):
    """An isotropic, linear-elastic material: Young's modulus, and either the shear modulus or Poisson's ratio."""

    name: str
    youngs_modulus_GPa: Positive
    shear_modulus_GPa: Positive | None = None
    poisson_ratio: NotNegative | None = None
    working_strain_percent: Positive = _percent(Material.working_strain)
    superelastic_strain_percent: Positive = _percent(Material.superelastic_strain)
    thermal: ThermalEntry | None = Field(None, description="for heating; by default known only of nitinol")

    def build(self) -> Material:
        """The material in SI."""
        modulus = to_si(self.youngs_modulus_GPa, GPA)
        if (self.shear_modulus_GPa is None) == (self.poisson_ratio is None):
            raise ValueError(_one_of("shear_modulus_GPa", "poisson_ratio", both=self.poisson_ratio is not None))
        if self.shear_modulus_GPa is not None:
            material = Material(self.name, modulus, to_si(self.shear_modulus_GPa, GPA))
        else:
            material = Material.from_poisson_ratio(self.name, modulus, float(self.poisson_ratio or 0))
        material = replace(
            material,
            working_strain=to_si(self.working_strain_percent, PERCENT),
            superelastic_strain=to_si(self.superelastic_strain_percent, PERCENT),
            thermal=None if self.thermal is None else self.thermal.build(),
        )
        # Nitinol by its constants is the nitinol that has a name.
        return NITINOL if material == replace(NITINOL, thermal=None) else material


def _one_of(key: str, other: str, *, both: bool) -> str:
    return f"gives {f'both {key} and' if both else f'neither {key} nor'} {other}; it must give one of them"


MaterialChoice = Annotated[
    Annotated[Literal["nitinol"], Tag("<name>")] | Annotated[MaterialEntry, Tag("<mapping>")],
    Discriminator(lambda value: "<name>" if isinstance(value, str) else "<mapping>"),
]
"""A material by name or by its constants."""


G_PER_M = Decimal("1e-3")


class TubeEntry(Part):
    """A tube: a straight part, then a curved part whose curvature or radius is given, or pieces."""

    outer_diameter_mm: Positive
    inner_diameter_mm: NotNegative
    straight_length_mm: NotNegative
    pieces: list[PieceEntry] | None = Field(
        None, min_length=1, description="what the tube is made of behind its straight part"
    )
    curved_length_mm: NotNegative | None = Field(
        None, validate_default=True, description="length of the curved part; with pieces it may be left out"
    )
    curvature_per_m: Number | None = Field(
        None, description="precurvature; 0 for a straight tube, negative to the other side"
    )
    radius_mm: Positive | None = Field(None, description="radius of the precurvature, in place of curvature_per_m")
    material: MaterialChoice = "nitinol"
    bending_stiffness_N_mm2: Positive | None = Field(None, description="as measured; by default E I")
    torsional_stiffness_N_mm2: Positive | None = Field(None, description="as measured; by default G J")
    mass_per_length_g_per_m: Positive | None = None

    @field_validator("curved_length_mm")
    @classmethod
    def _told(cls, value: Decimal | None, info: ValidationInfo) -> Decimal | None:
        if value is None and info.data.get("pieces", 0) is None:
            raise PydanticCustomError("missing", "Field required")
        return value

    def build(self) -> Tube:
        """The tube in SI."""
        tube = Tube(
            outer_diameter=to_si(self.outer_diameter_mm, MM),
            inner_diameter=to_si(self.inner_diameter_mm, MM),
            straight_length=to_si(self.straight_length_mm, MM),
            curved_length=to_si(self.curved_length_mm or Decimal(1), MM) if self.curved_length_mm != 0 else 0.0,
            curvature=0.0 if self.pieces else self._curvature(),
            material=NITINOL if isinstance(self.material, str) else self.material.build(),
            mass_per_length=None
            if self.mass_per_length_g_per_m is None
            else to_si(self.mass_per_length_g_per_m, G_PER_M),
        )
        own: dict[str, Any] = {}
        for name in ("bending_stiffness", "torsional_stiffness"):
            given = getattr(self, f"{name}_N_mm2")
            if given is not None:
                own[name] = given_stiffness(f"{name}_N_mm2", given, getattr(tube, name))
        tube = replace(tube, **own)
        return tube if self.pieces is None else self._of_pieces(tube, self.pieces)

    def _curvature(self) -> float:
        if (self.curvature_per_m is None) == (self.radius_mm is None):
            raise ValueError(_one_of("curvature_per_m", "radius_mm", both=self.radius_mm is not None))
        return float(1 / (self.radius_mm * MM) if self.radius_mm is not None else self.curvature_per_m or 0)

    def _of_pieces(self, tube: Tube, entries: list[PieceEntry]) -> Tube:
        """A tube like `tube`, made of pieces."""
        for name in ("curvature_per_m", "radius_mm"):
            if getattr(self, name) is not None:
                raise InputError(f"{name} and pieces are both given; every piece has a curvature of its own")
        pieces = []
        for k, entry in enumerate(entries):
            try:
                pieces.append(entry.build((float(tube.bending_stiffness), float(tube.torsional_stiffness))))
            except InputError as error:
                raise InputError("\n".join(f"pieces[{k}]: {line}" for line in str(error).splitlines())) from None
        total = sum(piece.length for piece in pieces)
        if self.curved_length_mm is not None and abs(to_si(self.curved_length_mm, MM) - total) > 1e-9:
            raise InputError(
                f"curved_length_mm is {self.curved_length_mm}; the lengths of the pieces add up to {total * 1e3:g}"
            )
        own = {name: getattr(tube, name) for name in ("bending_stiffness", "torsional_stiffness", "mass_per_length")}
        return Tube.of_pieces(
            tube.outer_diameter,
            tube.inner_diameter,
            pieces,
            straight_length=tube.straight_length,
            material=tube.material,
            **own,
        )


Range = Annotated[list[Number], Field(min_length=2, max_length=2)]
"""Least and greatest value."""


class LimitsEntry(Part):
    """Least and greatest value of every joint, one pair per tube."""

    rotations_deg: list[Range]
    translations_mm: list[Range]

    def build(self) -> JointLimits:
        """The limits in SI."""
        return JointLimits(
            rotations=tuple((to_si(low, DEG), to_si(high, DEG)) for low, high in self.rotations_deg),
            translations=tuple((to_si(low, MM), to_si(high, MM)) for low, high in self.translations_mm),
        )


class ConcentricEntry(Part):
    """A concentric tube robot, tubes inner to outer."""

    kind: Literal["concentric"]
    name: str = ""
    tubes: list[TubeEntry] = Field(min_length=1)
    limits: LimitsEntry | None = Field(None, description="what the actuators allow; by default what the lengths allow")
    calibration: CalibrationEntry | None = Field(None, description="how joint readings become joint values")

    def build(self) -> ConcentricRobot:
        """The robot in SI."""
        tubes = tuple(tube.build() for tube in self.tubes)
        return ConcentricRobot(tubes, self.name, _limits(self.limits), _calibration(self.calibration))


class EccentricEntry(Part):
    """A one-segment eccentric tube robot: three equal tubes side by side in a sheath."""

    kind: Literal["eccentric"]
    name: str = ""
    tube: TubeEntry
    offset_mm: NotNegative | None = Field(None, description="from the centreline; by default where the tubes touch")
    transmission_length_mm: NotNegative = Decimal(0)
    limits: LimitsEntry | None = Field(None, description="what the actuators allow; by default what the lengths allow")
    calibration: CalibrationEntry | None = Field(None, description="how joint readings become joint values")

    def build(self) -> EccentricRobot:
        """The robot in SI."""
        return EccentricRobot(
            self.tube.build(),
            offset=None if self.offset_mm is None else to_si(self.offset_mm, MM),
            transmission_length=to_si(self.transmission_length_mm, MM),
            name=self.name,
            joint_limits=_limits(self.limits),
            calibration=_calibration(self.calibration),
        )


class SegmentedEccentricEntry(Part):
    """An eccentric tube robot of telescoping segments, inner to outer."""

    kind: Literal["segmented_eccentric"]
    name: str = ""
    segments: list[TubeEntry] = Field(min_length=1)
    offset_mm: NotNegative | None = Field(None, description="from the centreline; by default where the outermost touch")
    limits: LimitsEntry | None = Field(None, description="what the actuators allow; by default what the lengths allow")
    calibration: CalibrationEntry | None = Field(None, description="how joint readings become joint values")

    def build(self) -> SegmentedEccentricRobot:
        """The robot in SI."""
        return SegmentedEccentricRobot(
            tuple(tube.build() for tube in self.segments),
            offset=None if self.offset_mm is None else to_si(self.offset_mm, MM),
            name=self.name,
            joint_limits=_limits(self.limits),
            calibration=_calibration(self.calibration),
        )


def _limits(entry: LimitsEntry | None) -> JointLimits | None:
    return entry.build() if entry else None


def _calibration(entry: CalibrationEntry | None) -> Calibration | None:
    return entry.build() if entry else None


AnyRobot = ConcentricRobot | EccentricRobot | SegmentedEccentricRobot
"""Every robot that a file can describe."""

ROBOT_KINDS: dict[str, type[ConcentricEntry] | type[EccentricEntry] | type[SegmentedEccentricEntry]] = {
    "concentric": ConcentricEntry,
    "eccentric": EccentricEntry,
    "segmented_eccentric": SegmentedEccentricEntry,
}
"""What the key `kind` of a robot file may say."""


def load_robot(path: str | PathLike[str]) -> AnyRobot:
    """The robot in a YAML file.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no robot: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> robot.n_tubes
        2
    """
    return robot_from_dict(load_yaml(path), path)


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
    save_yaml(path, robot_to_dict(robot), "A robot for tubeopt.")


def robot_from_dict(data: object, where: str | PathLike[str] = "") -> AnyRobot:
    """The robot that `data`, with the keys of a robot file, describes.

    Args:
        where: what the messages begin with.

    Raises:
        InputError: one line for every problem.
    """
    robot: AnyRobot = check_kind(ROBOT_KINDS, data, where).build()
    return robot


def robot_to_dict(robot: Robot) -> dict[str, Any]:
    """`robot` with the keys and units of a robot file.

    Numbers are int or float, or `Decimal` where a float in the file's unit would lose the last bit.
    """
    data: dict[str, Any]
    if isinstance(robot, ConcentricRobot):
        data = {"kind": "concentric", "name": robot.name, "tubes": [tube_to_dict(tube) for tube in robot.tubes]}
    elif isinstance(robot, EccentricRobot):
        data = {
            "kind": "eccentric",
            "name": robot.name,
            "tube": tube_to_dict(robot.tube),
            "offset_mm": in_unit(robot.distance, MM),
            "transmission_length_mm": in_unit(robot.transmission_length, MM),
        }
    elif isinstance(robot, SegmentedEccentricRobot):
        segments = [tube_to_dict(tube) for tube in robot.segments]
        offset = in_unit(robot.distance, MM)
        data = {"kind": "segmented_eccentric", "name": robot.name, "segments": segments, "offset_mm": offset}
    else:
        raise InputError(f"robot is a {type(robot).__name__}; it must be one of {', '.join(ROBOT_KINDS)}")
    if robot.joint_limits is not None:
        data["limits"] = {
            "rotations_deg": [[in_unit(x, DEG) for x in pair] for pair in robot.joint_limits.rotations],
            "translations_mm": [[in_unit(x, MM) for x in pair] for pair in robot.joint_limits.translations],
        }
    if robot.calibration is not None:
        data["calibration"] = calibration_to_dict(robot.calibration)
    return data


def tube_to_dict(tube: Tube) -> dict[str, Any]:
    """`tube` with the keys and units of a robot file."""
    data: dict[str, Any] = {
        "outer_diameter_mm": in_unit(tube.outer_diameter, MM),
        "inner_diameter_mm": in_unit(tube.inner_diameter, MM),
        "straight_length_mm": in_unit(tube.straight_length, MM),
    }
    if tube.pieces:
        data["pieces"] = [piece_to_dict(piece) for piece in tube.pieces]
    else:
        data["curved_length_mm"] = in_unit(tube.curved_length, MM)
        data["curvature_per_m"] = in_unit(tube.curvature, PER_M)
    data["material"] = NITINOL.name if tube.material == NITINOL else _material(tube.material)
    for name in ("bending_stiffness", "torsional_stiffness"):
        own = getattr(tube, name)
        if not isinstance(own, OfCrossSection):
            data[f"{name}_N_mm2"] = in_unit(own, N_MM2)
    if tube.mass_per_length is not None:
        data["mass_per_length_g_per_m"] = in_unit(tube.mass_per_length, G_PER_M)
    return data


def _material(material: Material) -> dict[str, Any]:
    data = {
        "name": material.name,
        "youngs_modulus_GPa": in_unit(material.youngs_modulus, GPA),
        "shear_modulus_GPa": in_unit(material.shear_modulus, GPA),
        "working_strain_percent": in_unit(material.working_strain, PERCENT),
        "superelastic_strain_percent": in_unit(material.superelastic_strain, PERCENT),
    }
    return data if material.thermal is None else data | {"thermal": _thermal(material.thermal)}


def _thermal(data: ThermalData) -> dict[str, Any]:
    return {
        "density_kg_per_m3": data.density,
        "heat_capacity_J_per_kg_K": data.heat_capacity,
        "conductivity_W_per_m_K": data.conductivity,
        "resistivity_ohm_m": data.resistivity,
        "expansion_per_K": data.expansion,
        "emissivity": data.emissivity,
        "heat_capacity_slope_per_K": data.heat_capacity_slope,
        "conductivity_slope_per_K": data.conductivity_slope,
        "resistivity_slope_per_K": data.resistivity_slope,
        "reference_degC": Decimal(repr(data.reference_temperature)) - Decimal(str(ZERO_CELSIUS)),
    }
