"""Specification of a mold: material, spring-back, fit of the groove, plate, cutters, clamps, vents, heating (SI)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from ...display import Displayed
from ...errors import InputError, instance, numbers, positive, vector
from ...files.field_metadata import NOT_NEGATIVE, POSITIVE, Named, OneOf, Range, Typical, check_fields, key, unit
from ..heating.thermocouple import ANCHOR, WIRE
from ..materials import CALCIUM_SILICATE, MOLD_MATERIALS, MoldMaterial, mold_material
from .heat import HeatSpec
from .springback import Springback

ENDS = ("proximal", "distal")
DIALECTS = ("grbl", "linuxcnc", "mach")
WORK_OFFSETS = ("G54", "G55", "G56", "G57", "G58", "G59")


LENGTH, LENGTH_OR_ZERO = Range(above=0.0, maximum=2.0), Range(minimum=0.0, maximum=2.0)
"""Allowed lengths of molds and tools, m: none is longer, and a larger number is probably in mm."""

SMALL, STEP = Typical(1e-5, 0.4), Typical(1e-6, 0.02)
"""Typical sizes of parts of molds and tools, and typical depths of single cuts, m."""

CUT = Range(minimum=1e-5, maximum=2.0)
"""Allowed depths of single cuts, m; below them, a program has thousands of passes that machines cannot resolve."""

FEED, SPEED = Range(minimum=2e-5, maximum=1.0), Range(above=0.0, maximum=2000.0)
"""Allowed feeds, m/s (at least 1.2 mm/min), and spindle speeds, 1/s."""


@dataclass(frozen=True)
class GrooveSpec:
    """Fit of the groove around the tube."""

    clearance: Annotated[
        float,
        unit("mm"),
        LENGTH_OR_ZERO,
        STEP,
        "programmed extra width and depth of the "
        "groove over the outer diameter; half of it is the tolerance to both sides",
    ] = 0.05e-3
    most_clearance: Annotated[
        float,
        unit("mm"),
        LENGTH,
        STEP,
        "largest extra width of a groove that one end mill cuts in one pass; otherwise a "
        "smaller end mill cuts along both walls",
    ] = 0.25e-3
    depth_step: Annotated[float, unit("mm"), LENGTH, STEP, "step that depths are rounded up to"] = 0.05e-3
    wall: Annotated[
        float, unit("mm"), LENGTH, SMALL, "smallest material thickness between grooves, holes and edges"
    ] = 3e-3
    floor: Annotated[float, unit("mm"), LENGTH, SMALL, "smallest material thickness below the groove"] = 4e-3

    def __post_init__(self) -> None:
        check_fields(self)
        if self.most_clearance < self.clearance:
            raise InputError(
                f"most_clearance is {self.most_clearance * 1e3:g} mm; it must be at least clearance "
                f"({self.clearance * 1e3:g} mm)"
            )


@dataclass(frozen=True)
class PlateSpec:
    """The two plates and their fasteners."""

    size: Annotated[
        tuple[float, float] | None,
        unit("mm"),
        LENGTH,
        "width and height of the plates; default the smallest that fits the grooves, in steps of 5 mm",
    ] = None
    thickness: Annotated[
        float, unit("mm"), LENGTH, SMALL, "thickness of the lower plate; default 12.7 mm, as the published steel mold"
    ] = 12.7e-3
    lid_thickness: Annotated[float, unit("mm"), LENGTH, SMALL, "thickness of the top plate"] = 6.35e-3
    margin: Annotated[
        float,
        unit("mm"),
        LENGTH,
        "distance from grooves to the edge of an automatically sized plate; the bolts are in it",
    ] = 16e-3
    bolt_diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "diameter of the bolt holes through both plates"] = (
        5.5e-3
    )
    dowel_diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "diameter of the dowel holes through both plates"] = (
        3e-3
    )
    bolt_pitch: Annotated[float, unit("mm"), LENGTH, "target distance between bolts along the edge"] = 80e-3

    def __post_init__(self) -> None:
        check_fields(self)
        if self.size is not None:
            width, height = vector("size of the plate", self.size, 2, "width and height")
            size = positive("width of the plate", width), positive("height of the plate", height)
            object.__setattr__(self, "size", size)


@dataclass(frozen=True)
class EndMill:
    """An available end mill."""

    diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "cutting diameter"]
    flute_length: Annotated[float | None, unit("mm"), LENGTH, "flute length; default three diameters"] = None

    def __post_init__(self) -> None:
        check_fields(self, "an end mill")

    @property
    def reach(self) -> float:
        """Cutting depth, m."""
        return 3 * self.diameter if self.flute_length is None else self.flute_length


@dataclass(frozen=True)
class MillingSpec:
    """Available end mills and cutting parameters of the groove."""

    end_mills: Annotated[tuple[EndMill, ...], "available end mills; default common sizes from 0.4 to 3 mm"] = tuple(
        EndMill(d * 1e-3) for d in (0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0)
    )
    step_down: Annotated[float, unit("mm"), CUT, STEP, "largest depth of one pass"] = 0.5e-3
    feed: Annotated[float, unit("mm_per_min"), FEED, Typical(1e-4, 0.2), "largest feed along the groove"] = 5e-3
    plunge_feed: Annotated[
        float, unit("mm_per_min"), FEED, Typical(1e-4, 0.2), "largest feed of end mills into the material"
    ] = 2e-3
    spindle: Annotated[float, unit("rpm"), SPEED, Typical(0.5, 1000.0), "largest spindle speed"] = 200.0
    safe_height: Annotated[float, unit("mm"), LENGTH, SMALL, "height above the plate for moves between cuts"] = 5e-3

    def __post_init__(self) -> None:
        check_fields(self)
        if not isinstance(self.end_mills, (tuple, list)):
            raise InputError(f"end_mills is {self.end_mills!r}; it must be a list of EndMill")
        if not self.end_mills:
            raise InputError("end_mills is empty; there must be at least one")
        for mill in self.end_mills:
            instance("an entry of end_mills", mill, EndMill)
        object.__setattr__(self, "end_mills", tuple(sorted(self.end_mills, key=lambda mill: mill.diameter)))


@dataclass(frozen=True)
class WorkshopSpec:
    """Milling machine for the plates, and its programs."""

    dialect: Annotated[
        str, OneOf(DIALECTS), "dialect of the G-code; for grbl, drill cycles are written as single moves"
    ] = "grbl"
    work_offset: Annotated[str, OneOf(WORK_OFFSETS), "work offset of the plate's zero"] = "G54"
    touch_plate: Annotated[
        float | None,
        unit("mm"),
        LENGTH,
        "height of a touch plate at the machine's probe input. With it, each plate is one "
        "program that sets Z after each tool change. Without it, each tool has its own "
        "program, and you set Z before each",
    ] = None
    change_height: Annotated[float, unit("mm"), LENGTH, SMALL, "height above the plate for tool changes"] = 40e-3
    spin_up: Annotated[float, unit("s"), NOT_NEGATIVE, "waiting time after spindle start"] = 3.0
    drill_feed: Annotated[float, unit("mm_per_min"), FEED, Typical(1e-4, 0.2), "largest feed of drills"] = 2e-3
    drill_spindle: Annotated[float, unit("rpm"), SPEED, Typical(0.5, 1000.0), "largest spindle speed of drills"] = 50.0
    peck: Annotated[float, unit("mm"), CUT, STEP, "depth of one drilling step before the drill clears its chips"] = 2e-3
    cut_out: Annotated[bool, "cut plates out of larger stock; otherwise stock has their size"] = True
    outline_diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "diameter of the end mill for the outline"] = 4e-3
    outline_reach: Annotated[float, unit("mm"), LENGTH, SMALL, "largest cutting depth of that end mill"] = 25e-3
    outline_step: Annotated[float, unit("mm"), CUT, STEP, "largest depth of one pass along the outline"] = 1e-3
    outline_feed: Annotated[float, unit("mm_per_min"), FEED, Typical(1e-4, 0.2), "largest feed along the outline"] = (
        10e-3
    )
    tab_width: Annotated[float, unit("mm"), LENGTH, SMALL, "width of the tabs between plate and stock"] = 6e-3
    tab_height: Annotated[float, unit("mm"), LENGTH, SMALL, "height of the tabs"] = 2e-3
    tab_pitch: Annotated[float, unit("mm"), LENGTH, "target distance between tabs"] = 80e-3
    stock: Annotated[
        tuple[float, float] | None, unit("mm"), LENGTH, "width and height of the stock; default large enough"
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "the workshop")


@dataclass(frozen=True)
class ClampSpec:
    """The clamps that hold the tube and feed the current, outside the plate.

    The sliding clamp travels growth * travel_factor + travel_extra.
    """

    gap: Annotated[
        float,
        unit("mm"),
        LENGTH_OR_ZERO,
        "distance from plate edge to clamp along the tube; larger if the tube leaves the plate at an angle",
    ] = 5e-3
    grip: Annotated[float, unit("mm"), LENGTH, "length of tube in a clamp"] = 12e-3
    width: Annotated[float, unit("mm"), LENGTH, "width of a clamp, across the tube"] = 15e-3
    nose: Annotated[
        float | None,
        unit("mm"),
        LENGTH,
        "width of a clamp's face towards the plate, behind which it widens at 45 deg; default 3.5 mm, or the width "
        "of a narrower clamp",
    ] = None
    least_lead: Annotated[float, unit("mm"), LENGTH, "smallest straight groove on each side of the bend"] = 5e-3
    sliding_end: Annotated[str, OneOf(ENDS), "end with the sliding clamp, for thermal expansion of the tube"] = "distal"
    travel_factor: Annotated[float, POSITIVE, "travel of the sliding clamp per thermal expansion of the tube"] = 1.5
    travel_extra: Annotated[float, unit("mm"), LENGTH_OR_ZERO, "additional travel"] = 0.5e-3

    def __post_init__(self) -> None:
        check_fields(self)
        if self.nose is not None and self.nose > self.width:
            raise InputError(
                f"nose is {self.nose * 1e3:g} mm; it must be at most the width of the clamp, {self.width * 1e3:g} mm"
            )
        if self.travel_factor < 1:
            raise InputError(f"travel_factor is {self.travel_factor:g}; it must be at least 1, or the tube buckles")

    @property
    def face_width(self) -> float:
        """Width (m) of a clamp's face: `nose`, by default 3.5 mm, or the width of a narrower clamp."""
        return min(3.5e-3, self.width) if self.nose is None else self.nose


@dataclass(frozen=True)
class VentSpec:
    """Vents: holes of the top plate over the bend."""

    diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "diameter of a vent"] = 1.5e-3
    profile: Annotated[
        tuple[float, ...],
        key("open_percent"),
        NOT_NEGATIVE,
        "open fraction of the groove area, in equal cells along the bend, proximal to "
        "distal; [0] is a closed lid. `heat plan --free vents` optimises it",
    ] = (0.2,)

    def __post_init__(self) -> None:
        check_fields(self)
        profile = numbers("profile of the vents", self.profile)
        if not profile:
            raise InputError("profile of the vents is empty; it must have at least one number, 0 for a closed lid")
        for value in profile:
            if not 0 <= value <= 1:
                raise InputError(f"profile of the vents has {value:g}; every number must lie in [0, 1]")
        object.__setattr__(self, "profile", profile)


@dataclass(frozen=True)
class SlotSpec:
    """Slot in the lower face of the lid for a thermocouple on the middle of the bend."""

    wire: Annotated[float, unit("mm"), LENGTH_OR_ZERO, SMALL, "diameter of the wires; 0 for a lid without a slot"] = (
        WIRE
    )
    anchor: Annotated[float, unit("mm"), LENGTH, SMALL, "length of the slot to each side of the middle"] = ANCHOR
    exit_diameter: Annotated[
        float, unit("mm"), LENGTH, SMALL, "holes at its ends, for the wires in their sleeves; a vent there serves too"
    ] = 1.2e-3

    def __post_init__(self) -> None:
        check_fields(self, "the slot")


@dataclass(frozen=True)
class HingeSpec:
    """Lid on two hinges along its upper edge, opened by latches along its lower one, in place of bolts and dowels.

    One leaf of a hinge is on the lid, the other on a strip that is cut off the lid and stays on the lower plate.
    """

    screw_diameter: Annotated[
        float, unit("mm"), LENGTH_OR_ZERO, SMALL, "diameter of the holes for the hinges' screws; 0 for a bolted lid"
    ] = 0.0
    screw_distance: Annotated[float, unit("mm"), LENGTH, SMALL, "distance of the two screws of a leaf"] = 15e-3
    reach: Annotated[float, unit("mm"), LENGTH, SMALL, "distance of the screws from the pin"] = 8e-3
    latch_diameter: Annotated[
        float,
        unit("mm"),
        LENGTH,
        SMALL,
        "diameter of the lid's holes around the latches: nut and bolt pass through when the slotted washer is out",
    ] = 12e-3

    def __post_init__(self) -> None:
        check_fields(self, "the hinge")


@dataclass(frozen=True)
class MoldSpec(Displayed):
    """Material, fit, plate and tools of a mold; every key has a default.

    Raises:
        InputError: a number is out of its range, or no such material.
    """

    material: Annotated[MoldMaterial, Named(MOLD_MATERIALS), "material of both plates: keys, or its name"] = (
        CALCIUM_SILICATE
    )
    springback: Annotated[Springback, "spring-back from `tubeopt mold calibrate`; a warning is shown without one"] = (
        field(default_factory=Springback)
    )
    cold_length: Annotated[
        float | None,
        unit("mm"),
        LENGTH_OR_ZERO,
        "length of tube beside a clamp that stays too cold; the curved part begins beyond it; "
        "by default estimated by a fin model",
    ] = None
    growth: Annotated[
        float | None,
        unit("mm"),
        LENGTH_OR_ZERO,
        "thermal expansion of the tube between the clamps; by default integrated over the fin model",
    ] = None
    most_strain: Annotated[
        float | None,
        unit("percent"),
        POSITIVE,
        "bending strain limit of a straight tube in the groove; default the elastic limit of its material",
    ] = None
    groove: Annotated[GrooveSpec, "fit of the groove around the tube"] = field(default_factory=GrooveSpec)
    plate: Annotated[PlateSpec, "the two plates and their fasteners"] = field(default_factory=PlateSpec)
    milling: Annotated[MillingSpec, "end mills and feeds"] = field(default_factory=MillingSpec)
    workshop: Annotated[WorkshopSpec, "the machine that cuts the plates, and its programs"] = field(
        default_factory=WorkshopSpec
    )
    clamps: Annotated[ClampSpec, "the clamps outside the plate"] = field(default_factory=ClampSpec)
    vents: Annotated[VentSpec, "vents of the top plate over the bend"] = field(default_factory=VentSpec)
    slot: Annotated[SlotSpec, "slot of the lid for a thermocouple"] = field(default_factory=SlotSpec)
    hinge: Annotated[HingeSpec, "hinged lid, for a quench within seconds; default a bolted lid"] = field(
        default_factory=HingeSpec
    )
    heat: Annotated[HeatSpec, "heating conditions of the mold design"] = field(default_factory=HeatSpec)

    def __post_init__(self) -> None:
        if isinstance(self.material, str):
            object.__setattr__(self, "material", mold_material(self.material))
        if isinstance(self.springback, (int, float)):
            object.__setattr__(self, "springback", Springback(self.springback))
        check_fields(self, "the mold")
        if self.hinged and self.hinge.latch_diameter < 1.6 * self.plate.bolt_diameter:
            raise InputError(
                f"latch_diameter of the hinge is {self.hinge.latch_diameter * 1e3:g} mm; the nut of a bolt in a hole "
                f"of {self.plate.bolt_diameter * 1e3:g} mm needs at least {1.6e3 * self.plate.bolt_diameter:g} mm"
            )

    @property
    def hinged(self) -> bool:
        """True for a lid on hinges."""
        return self.hinge.screw_diameter > 0

    @property
    def gap(self) -> float:
        """Width of the cut between a hinged lid and its strip, m; the pin is over its middle."""
        return self.workshop.outline_diameter

    @property
    def behind(self) -> float:
        """Distance of the pin from the plate's upper edge, m."""
        # A countersunk head is twice as wide as its screw.
        return self.hinge.reach + self.hinge.screw_diameter + self.groove.wall

    @property
    def upper_margin(self) -> float:
        """Distance from grooves to the upper edge of an automatically sized plate, m."""
        return max(self.plate.margin, 2 * self.behind) if self.hinged else self.plate.margin
