"""What a mold is asked for: material, spring-back, fit of the groove, plate, cutters, clamps, vents, heating (SI)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from ...errors import InputError, choice, instance, numbers, positive
from .heat import HeatSpec
from .materials import CALCIUM_SILICATE, MoldMaterial, mold_material
from .springback import Springback

ENDS = ("proximal", "distal")


def _check_positive(spec: object, *, zero: tuple[str, ...] = ()) -> None:
    """Every field a finite number > 0, those named in `zero` >= 0."""
    for entry in fields(spec):  # type: ignore[arg-type]
        if entry.type == "float":
            value = positive(entry.name, getattr(spec, entry.name), zero=entry.name in zero)
            object.__setattr__(spec, entry.name, value)


@dataclass(frozen=True)
class GrooveSpec:
    """How the groove fits the tube (m).

    Args:
        clearance: least width and depth beyond the tube's outer diameter.
        most_clearance: width beyond the outer diameter up to which a single end mill makes the groove in one cut; a
            groove for which no end mill is that near is cut along both walls with a smaller one.
        depth_step: depths are rounded up to a multiple of it.
        wall: least material between grooves, holes and edges.
        floor: least material below the groove.
    """

    clearance: float = 0.05e-3
    most_clearance: float = 0.25e-3
    depth_step: float = 0.05e-3
    wall: float = 3e-3
    floor: float = 4e-3

    def __post_init__(self) -> None:
        _check_positive(self, zero=("clearance",))
        if self.most_clearance < self.clearance:
            raise InputError(
                f"most_clearance is {self.most_clearance * 1e3:g} mm; it must be at least clearance "
                f"({self.clearance * 1e3:g} mm)"
            )


@dataclass(frozen=True)
class PlateSpec:
    """The two plates and how they are fastened (m).

    Args:
        size: width and height; None takes the least that holds the grooves, in steps of 5 mm.
        thickness: of the lower plate; the default is the half inch of the thesis' steel mold.
        lid_thickness: of the top plate.
        margin: from the bends and the least leads to the edge of a plate whose size is free; bolts stand in it.
        bolt_diameter, dowel_diameter: of their holes, through both plates.
        bolt_pitch: greatest distance of bolts along the edge that is aimed at.
    """

    size: tuple[float, float] | None = None
    thickness: float = 12.7e-3
    lid_thickness: float = 6.35e-3
    margin: float = 16e-3
    bolt_diameter: float = 5.5e-3
    dowel_diameter: float = 3e-3
    bolt_pitch: float = 80e-3

    def __post_init__(self) -> None:
        _check_positive(self)
        if self.size is not None:
            sides = numbers("size of the plate", self.size)
            if len(sides) != 2:
                raise InputError(f"size has {len(sides)} numbers; it must be the width and the height of the plate")
            size = (positive("width of the plate", sides[0]), positive("height of the plate", sides[1]))
            object.__setattr__(self, "size", size)


@dataclass(frozen=True)
class EndMill:
    """An end mill: diameter and length of its flutes (m); None is three diameters."""

    diameter: float
    flute_length: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "diameter", positive("diameter of an end mill", self.diameter))
        if self.flute_length is not None:
            object.__setattr__(self, "flute_length", positive("flute_length of an end mill", self.flute_length))

    @property
    def reach(self) -> float:
        """Depth to which it cuts, m."""
        return 3 * self.diameter if self.flute_length is None else self.flute_length


@dataclass(frozen=True)
class MillingSpec:
    """The end mills at hand and how the groove is cut with them.

    Args:
        end_mills: those at hand.
        step_down: greatest depth of one pass, m.
        feed, plunge_feed: m/s, along the groove and into the material.
        spindle: revolutions per s.
        safe_height: m above the plate, for moves between cuts.
    """

    end_mills: tuple[EndMill, ...] = tuple(
        EndMill(d * 1e-3) for d in (0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0)
    )
    step_down: float = 0.5e-3
    feed: float = 5e-3
    plunge_feed: float = 2e-3
    spindle: float = 200.0
    safe_height: float = 5e-3

    def __post_init__(self) -> None:
        _check_positive(self)
        if not isinstance(self.end_mills, (tuple, list)):
            raise InputError(f"end_mills is {self.end_mills!r}; it must be a list of EndMill")
        if not self.end_mills:
            raise InputError("end_mills is empty; there must be at least one")
        for mill in self.end_mills:
            instance("an entry of end_mills", mill, EndMill)
        object.__setattr__(self, "end_mills", tuple(sorted(self.end_mills, key=lambda mill: mill.diameter)))


@dataclass(frozen=True)
class ClampSpec:
    """The clamps that hold the tube and feed the current, outside the plate (m).

    Args:
        gap: from the plate's edge to the clamp, along the tube; more where the tube leaves the plate at a slant.
        grip: length of tube in a clamp.
        width: of a clamp, across the tube.
        least_lead: least straight groove on either side of the bend.
        sliding_end: proximal or distal: where the clamp gives way when the tube grows.
        travel_factor, travel_extra: the sliding clamp travels growth * travel_factor + travel_extra.
    """

    gap: float = 5e-3
    grip: float = 12e-3
    width: float = 15e-3
    least_lead: float = 5e-3
    sliding_end: str = "distal"
    travel_factor: float = 1.5
    travel_extra: float = 0.5e-3

    def __post_init__(self) -> None:
        _check_positive(self, zero=("gap", "travel_extra"))
        choice("sliding_end", self.sliding_end, ENDS)
        if self.travel_factor < 1:
            raise InputError(f"travel_factor is {self.travel_factor:g}; it must be at least 1, or the tube buckles")


@dataclass(frozen=True)
class VentSpec:
    """Holes through the top plate over the bend, which let heat out.

    Args:
        diameter: of a vent, m.
        profile: part of the groove's area that is open, in equal cells along the bend from its proximal to its distal
            end; (0,) is a closed lid. A thermal model may shape it so that the tube's temperature is even.
    """

    diameter: float = 1.5e-3
    profile: tuple[float, ...] = (0.2,)

    def __post_init__(self) -> None:
        _check_positive(self)
        profile = numbers("profile of the vents", self.profile)
        if not profile:
            raise InputError("profile of the vents is empty; it must have at least one number, 0 for a closed lid")
        for value in profile:
            if not 0 <= value <= 1:
                raise InputError(f"profile of the vents has {value:g}; every number must lie in [0, 1]")
        object.__setattr__(self, "profile", profile)


@dataclass(frozen=True)
class MoldSpec:
    """What `plan_mold` is asked for.

    Args:
        material: of both plates, or its name.
        springback: from `calibrate_springback`, or a plain fraction; by default none, which the mold remarks upon.
        cold_length: m of tube from a clamp to where it is hot enough; None estimates it as a fin (`cold_end`). A
            thermal model of the whole rig may know better.
        growth: m by which the tube between the clamps gets longer when hot; None integrates over the fin. As above.
        most_strain: of a straight tube pressed into the groove; None is what the tube's material springs back from.
        groove, plate, milling, clamps, vents, heat: the rest.

    Raises:
        InputError: a number is out of its range, or no such material.
    """

    material: MoldMaterial = CALCIUM_SILICATE
    springback: Springback = field(default_factory=Springback)
    cold_length: float | None = None
    growth: float | None = None
    most_strain: float | None = None
    groove: GrooveSpec = field(default_factory=GrooveSpec)
    plate: PlateSpec = field(default_factory=PlateSpec)
    milling: MillingSpec = field(default_factory=MillingSpec)
    clamps: ClampSpec = field(default_factory=ClampSpec)
    vents: VentSpec = field(default_factory=VentSpec)
    heat: HeatSpec = field(default_factory=HeatSpec)

    def __post_init__(self) -> None:
        if isinstance(self.material, str):
            object.__setattr__(self, "material", mold_material(self.material))
        if isinstance(self.springback, (int, float)):
            object.__setattr__(self, "springback", Springback(self.springback))
        for name, part in PARTS.items():
            instance(f"{name} of the mold", getattr(self, name), part)
        for name in ("cold_length", "growth"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, positive(name, getattr(self, name), zero=True))
        if self.most_strain is not None:
            object.__setattr__(self, "most_strain", positive("most_strain", self.most_strain))


PARTS = {
    "material": MoldMaterial,
    "springback": Springback,
    "groove": GrooveSpec,
    "plate": PlateSpec,
    "milling": MillingSpec,
    "clamps": ClampSpec,
    "vents": VentSpec,
    "heat": HeatSpec,
}
"""What the parts of a specification must be."""
