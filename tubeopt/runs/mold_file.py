"""Molds as YAML: what is asked of a mold, its material and spring-back; and trials of spring-back in CSV."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from os import PathLike
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from ..errors import nearest
from ..files.checked import Entry, NotNegative, Number, Positive, check
from ..files.csv_file import read_csv, refuse
from ..files.units import MM, PERCENT, in_unit, to_si
from ..files.yaml_file import load_yaml, save_yaml
from ..robots.file import Part
from ..robots.materials import ZERO_CELSIUS
from ..shaping.mold.heat import HeatSpec
from ..shaping.mold.materials import MOLD_MATERIALS, PRICE_CLASSES, MoldMaterial
from ..shaping.mold.spec import ClampSpec, EndMill, GrooveSpec, MillingSpec, MoldSpec, PlateSpec, VentSpec
from ..shaping.mold.springback import Calibration, Springback
from ..typing import Array

TRIAL_COLUMNS = ("mold_radius_mm", "obtained_radius_mm")
NOTE = "note"


class MoldMaterialEntry(Part):
    """A mold material by its constants."""

    name: str
    conductivity_W_per_m_K: Positive
    density_kg_per_m3: Positive
    heat_capacity_J_per_kg_K: Positive
    limit_degC: Number
    failure: str = "fails"
    resistivity_ohm_m: Positive
    emissivity: Positive = Decimal("0.9")
    price_class: str = Field(default="moderate", description=", ".join(PRICE_CLASSES))
    source: str

    def build(self) -> MoldMaterial:
        """The material in SI."""
        return MoldMaterial(
            name=self.name,
            conductivity=float(self.conductivity_W_per_m_K),
            density=float(self.density_kg_per_m3),
            heat_capacity=float(self.heat_capacity_J_per_kg_K),
            limit_temperature=float(self.limit_degC) + ZERO_CELSIUS,
            failure=self.failure,
            resistivity=float(self.resistivity_ohm_m),
            emissivity=float(self.emissivity),
            price_class=self.price_class,
            source=self.source,
        )


MoldMaterialChoice = Annotated[
    Annotated[Literal["steel", "mdf", "glass_mica", "calcium_silicate"], Tag("<name>")]
    | Annotated[MoldMaterialEntry, Tag("<mapping>")],
    Discriminator(lambda value: "<name>" if isinstance(value, str) else "<mapping>"),
]
"""A mold material by name or by its constants."""


class SpringbackEntry(Part):
    """What a tube loses of the mold's curvature, from `tubeopt mold calibrate`."""

    fraction_percent: Number = Decimal(0)
    slope_mm: Number = Field(default=Decimal(0), description="growth of the lost part with the mold's curvature")
    shrinkage_percent: NotNegative = Field(default=Decimal(0), description="part of the bend's length lost on cooling")
    radius_range_mm: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="least and greatest mold radius of the trials"
    )

    def build(self) -> Springback:
        """The spring-back in SI."""
        radii = None if self.radius_range_mm is None else [to_si(radius, MM) for radius in self.radius_range_mm]
        return Springback(
            fraction=to_si(self.fraction_percent, PERCENT),
            slope=to_si(self.slope_mm, MM),
            shrinkage=to_si(self.shrinkage_percent, PERCENT),
            curvature_range=None if radii is None else (1 / max(radii), 1 / min(radii)),
        )


def _in_m(entry: Entry, leave: str = "") -> dict[str, Any]:
    """The lengths of an entry in m, under their names without the unit."""
    kept = {name: value for name, value in entry if name not in leave.split()}
    return {name.removesuffix("_mm"): to_si(value, MM) for name, value in kept.items()}


def _mm(length: float) -> Decimal:
    return Decimal(str(in_unit(length, MM)))


class GrooveEntry(Part):
    """How the groove fits the tube."""

    clearance_mm: NotNegative = _mm(GrooveSpec.clearance)
    most_clearance_mm: Positive = _mm(GrooveSpec.most_clearance)
    depth_step_mm: Positive = _mm(GrooveSpec.depth_step)
    wall_mm: Positive = _mm(GrooveSpec.wall)
    floor_mm: Positive = _mm(GrooveSpec.floor)

    def build(self) -> GrooveSpec:
        """The fit in SI."""
        return GrooveSpec(**_in_m(self))


class PlateEntry(Part):
    """The two plates and how they are fastened."""

    size_mm: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="width and height; by default the least that holds the grooves"
    )
    thickness_mm: Positive = _mm(PlateSpec.thickness)
    lid_thickness_mm: Positive = _mm(PlateSpec.lid_thickness)
    margin_mm: Positive = _mm(PlateSpec.margin)
    bolt_diameter_mm: Positive = _mm(PlateSpec.bolt_diameter)
    dowel_diameter_mm: Positive = _mm(PlateSpec.dowel_diameter)
    bolt_pitch_mm: Positive = _mm(PlateSpec.bolt_pitch)

    def build(self) -> PlateSpec:
        """The plates in SI."""
        size = None if self.size_mm is None else (to_si(self.size_mm[0], MM), to_si(self.size_mm[1], MM))
        return PlateSpec(size=size, **_in_m(self, leave="size_mm"))


class EndMillEntry(Part):
    """An end mill at hand."""

    diameter_mm: Positive
    flute_length_mm: Positive | None = Field(default=None, description="by default three diameters")

    def build(self) -> EndMill:
        """The end mill in SI."""
        flute = None if self.flute_length_mm is None else to_si(self.flute_length_mm, MM)
        return EndMill(to_si(self.diameter_mm, MM), flute)


class MillingEntry(Part):
    """End mills and feeds."""

    end_mills: list[EndMillEntry] | None = Field(default=None, min_length=1, description="those at hand")
    step_down_mm: Positive = _mm(MillingSpec.step_down)
    feed_mm_per_min: Positive = Decimal(300)
    plunge_feed_mm_per_min: Positive = Decimal(120)
    spindle_rpm: Positive = Decimal(12000)
    safe_height_mm: Positive = _mm(MillingSpec.safe_height)

    def build(self) -> MillingSpec:
        """End mills and feeds in SI."""
        mills = {} if self.end_mills is None else {"end_mills": tuple(mill.build() for mill in self.end_mills)}
        return MillingSpec(
            step_down=to_si(self.step_down_mm, MM),
            feed=to_si(self.feed_mm_per_min, MM) / 60,
            plunge_feed=to_si(self.plunge_feed_mm_per_min, MM) / 60,
            spindle=float(self.spindle_rpm) / 60,
            safe_height=to_si(self.safe_height_mm, MM),
            **mills,
        )


class ClampEntry(Part):
    """The clamps outside the plate."""

    gap_mm: NotNegative = _mm(ClampSpec.gap)
    grip_mm: Positive = _mm(ClampSpec.grip)
    width_mm: Positive = _mm(ClampSpec.width)
    least_lead_mm: Positive = _mm(ClampSpec.least_lead)
    sliding_end: Literal["proximal", "distal"] = "distal"
    travel_factor: Positive = Decimal(str(ClampSpec.travel_factor))
    travel_extra_mm: NotNegative = _mm(ClampSpec.travel_extra)

    def build(self) -> ClampSpec:
        """The clamps in SI."""
        lengths = _in_m(self, leave="sliding_end travel_factor")
        return ClampSpec(sliding_end=self.sliding_end, travel_factor=float(self.travel_factor), **lengths)


class VentEntry(Part):
    """Vents of the top plate over the bend."""

    diameter_mm: Positive = _mm(VentSpec.diameter)
    open_percent: list[NotNegative] = Field(
        default=[Decimal(20)],
        min_length=1,
        description="of the groove's area, in equal cells along the bend; [0] closed",
    )

    def build(self) -> VentSpec:
        """The vents in SI."""
        return VentSpec(to_si(self.diameter_mm, MM), tuple(to_si(part, PERCENT) for part in self.open_percent))


class HeatEntry(Part):
    """The heating that the mold is laid out for."""

    set_degC: Number = Decimal(525)
    tolerance_K: Positive = Decimal(str(HeatSpec.tolerance))
    hold_s: Positive = Decimal(str(HeatSpec.hold_time))
    ambient_degC: Number = Decimal(20)
    clamp_degC: Number | None = Field(
        default=None, description="of the clamps at the end of the hold; by default ambient"
    )
    contact_conductance_W_per_m2_K: Positive = Decimal(str(HeatSpec.contact_conductance))

    def build(self) -> HeatSpec:
        """The heating in SI."""
        return HeatSpec(
            set_temperature=float(self.set_degC) + ZERO_CELSIUS,
            tolerance=float(self.tolerance_K),
            hold_time=float(self.hold_s),
            ambient=float(self.ambient_degC) + ZERO_CELSIUS,
            clamp_temperature=None if self.clamp_degC is None else float(self.clamp_degC) + ZERO_CELSIUS,
            contact_conductance=float(self.contact_conductance_W_per_m2_K),
        )


class MoldEntry(Part):
    """What a mold is asked for; every key may be left out."""

    kind: Literal["mold"]
    material: MoldMaterialChoice = "calcium_silicate"
    springback: SpringbackEntry = Field(default_factory=SpringbackEntry)
    cold_length_mm: NotNegative | None = Field(
        default=None, description="of tube from a clamp to where it is hot; by default estimated as a fin"
    )
    growth_mm: NotNegative | None = Field(
        default=None, description="of the hot tube between the clamps; by default integrated over the fin"
    )
    most_strain_percent: Positive | None = Field(
        default=None, description="of a straight tube pressed in; by default what its material springs back from"
    )
    groove: GrooveEntry = Field(default_factory=GrooveEntry)
    plate: PlateEntry = Field(default_factory=PlateEntry)
    milling: MillingEntry = Field(default_factory=MillingEntry)
    clamps: ClampEntry = Field(default_factory=ClampEntry)
    vents: VentEntry = Field(default_factory=VentEntry)
    heat: HeatEntry = Field(default_factory=HeatEntry)

    def build(self) -> MoldSpec:
        """The specification in SI."""
        named = isinstance(self.material, str)
        return MoldSpec(
            material=MOLD_MATERIALS[str(self.material)] if named else self.material.build(),  # type: ignore[union-attr]
            springback=self.springback.build(),
            cold_length=None if self.cold_length_mm is None else to_si(self.cold_length_mm, MM),
            growth=None if self.growth_mm is None else to_si(self.growth_mm, MM),
            most_strain=None if self.most_strain_percent is None else to_si(self.most_strain_percent, PERCENT),
            groove=self.groove.build(),
            plate=self.plate.build(),
            milling=self.milling.build(),
            clamps=self.clamps.build(),
            vents=self.vents.build(),
            heat=self.heat.build(),
        )


MOLD_KINDS = {"mold": MoldEntry}
"""What the key `kind` of a mold file may say."""


def load_mold_spec(path: str | PathLike[str]) -> MoldSpec:
    """The specification in a YAML file.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no mold: one line for every problem.
    """
    return mold_spec_from_dict(load_yaml(path), path)


def mold_spec_from_dict(data: object, where: str | PathLike[str] = "") -> MoldSpec:
    """The specification that `data`, with the keys of a mold file, describes; raises InputError as `load_mold_spec`."""
    return check(MoldEntry, data, where).build()


def load_springback(path: str | PathLike[str]) -> Springback:
    """The spring-back in a YAML file that `save_springback` wrote.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no spring-back.
    """
    return check(SpringbackEntry, load_yaml(path), path).build()


def springback_to_dict(back: Springback) -> dict[str, Any]:
    """A spring-back with the keys and units of a mold file."""
    data: dict[str, Any] = {
        "fraction_percent": in_unit(back.fraction, PERCENT),
        "slope_mm": in_unit(back.slope, MM),
        "shrinkage_percent": in_unit(back.shrinkage, PERCENT),
    }
    if back.curvature_range is not None:
        low, high = back.curvature_range
        data["radius_range_mm"] = [in_unit(1 / high, MM), in_unit(1 / low, MM)]
    return data


def save_springback(calibration: Calibration, path: str | PathLike[str]) -> None:
    """Write the fitted spring-back as YAML, to stand under the key `springback` of a mold file or for --springback.

    Raises:
        InputError: the file cannot be written.
    """
    trials = len(calibration.mold_curvature)
    save_yaml(path, springback_to_dict(calibration.springback), f"Spring-back of tubes, from {trials} trials.")


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials of spring-back: (N,) radii of molds and of the tubes that came out, m."""

    mold_radius: Array
    obtained_radius: Array


def load_trials(path: str | PathLike[str]) -> Trials:
    """The trials in a CSV file with the columns `mold_radius_mm`, `obtained_radius_mm` and, for any text, `note`.

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no positive number: one line for
            every problem.
    """
    table = read_csv(path)
    known = (*TRIAL_COLUMNS, NOTE)
    problems = [
        f"column {name} is not known; columns are {', '.join(known)}{nearest(name, known)}"
        for name in table.columns
        if name not in known
    ]
    problems += [f"column {name} is missing" for name in TRIAL_COLUMNS if name not in table.columns]
    refuse(path, problems)
    radii = table.numbers(TRIAL_COLUMNS, MM)
    for row in range(len(table.rows)):
        for k, column in enumerate(TRIAL_COLUMNS):
            if radii[row, k] <= 0 and not any(f"row {row + 1} " in p and column in p for p in table.problems):
                table.complain(row, column, f"is {table.cell(row, column)}; it must be greater than 0")
    table.check()
    return Trials(radii[:, 0], radii[:, 1])
