"""What a mold is asked for: material, spring-back, fit of the groove, plate, cutters, clamps, vents, heating (SI)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from ...display import Displayed
from ...errors import InputError, instance, numbers, positive, vector
from ...files.marks import NOT_NEGATIVE, POSITIVE, Named, OneOf, Range, Usual, check_fields, key, unit
from ..materials import CALCIUM_SILICATE, MOLD_MATERIALS, MoldMaterial, mold_material
from .heat import HeatSpec
from .settings import DEFAULT_MOLD, MoldSolver
from .springback import Springback

ENDS = ("proximal", "distal")
DIALECTS = ("grbl", "linuxcnc", "mach")
WORK_OFFSETS = ("G54", "G55", "G56", "G57", "G58", "G59")


LENGTH, ROOM = Range(above=0.0, most=2.0), Range(least=0.0, most=2.0)
"""Lengths of molds and tools, m: none is longer, but many are in mm."""

SMALL, STEP = Usual(1e-5, 0.4), Usual(1e-6, 0.02)
"""Of parts of molds and tools, and of depths of single cuts, m."""

CUT = Range(least=1e-5, most=2.0)
"""Depths of single cuts, m: a program with smaller ones has thousands of passes, and machines do not set them."""

FEED, SPEED = Range(least=2e-5, most=1.0), Range(above=0.0, most=2000.0)
"""Of milling machines: m/s, at least 1.2 mm/min, and revolutions per second."""


@dataclass(frozen=True)
class GrooveSpec:
    """How the groove fits the tube (m)."""

    clearance: Annotated[float, unit("mm"), ROOM, STEP, "least width and depth beyond the tube's outer diameter"] = (
        0.05e-3
    )
    most_clearance: Annotated[
        float,
        unit("mm"),
        LENGTH,
        STEP,
        "width beyond the outer diameter up to which a single end mill makes the groove in one cut; a groove for which "
        "no end mill is that near is cut along both walls with a smaller one",
    ] = 0.25e-3
    depth_step: Annotated[float, unit("mm"), LENGTH, STEP, "depths are rounded up to a multiple of it"] = 0.05e-3
    wall: Annotated[float, unit("mm"), LENGTH, SMALL, "least material between grooves, holes and edges"] = 3e-3
    floor: Annotated[float, unit("mm"), LENGTH, SMALL, "least material below the groove"] = 4e-3

    def __post_init__(self) -> None:
        check_fields(self)
        if self.most_clearance < self.clearance:
            raise InputError(
                f"most_clearance is {self.most_clearance * 1e3:g} mm; it must be at least clearance "
                f"({self.clearance * 1e3:g} mm)"
            )


@dataclass(frozen=True)
class PlateSpec:
    """The two plates and how they are fastened (m)."""

    size: Annotated[
        tuple[float, float] | None,
        unit("mm"),
        LENGTH,
        "width and height; by default the least that holds the grooves, in steps of 5 mm",
    ] = None
    thickness: Annotated[
        float, unit("mm"), LENGTH, SMALL, "of the lower plate; by default the half inch of the thesis' steel mold"
    ] = 12.7e-3
    lid_thickness: Annotated[float, unit("mm"), LENGTH, SMALL, "of the top plate"] = 6.35e-3
    margin: Annotated[
        float,
        unit("mm"),
        LENGTH,
        "from the bends and the least leads to the edge of a plate whose size is free; bolts stand in it",
    ] = 16e-3
    bolt_diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "of the holes for bolts, through both plates"] = 5.5e-3
    dowel_diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "of the holes for dowels, through both plates"] = 3e-3
    bolt_pitch: Annotated[float, unit("mm"), LENGTH, "greatest distance of bolts along the edge that is aimed at"] = (
        80e-3
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.size is not None:
            width, height = vector("size of the plate", self.size, 2, "width and height")
            size = positive("width of the plate", width), positive("height of the plate", height)
            object.__setattr__(self, "size", size)


@dataclass(frozen=True)
class EndMill:
    """An end mill at hand (m)."""

    diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "of what it cuts"]
    flute_length: Annotated[float | None, unit("mm"), LENGTH, "by default three diameters"] = None

    def __post_init__(self) -> None:
        check_fields(self, "an end mill")

    @property
    def reach(self) -> float:
        """Depth to which it cuts, m."""
        return 3 * self.diameter if self.flute_length is None else self.flute_length


@dataclass(frozen=True)
class MillingSpec:
    """The end mills at hand and how the groove is cut with them."""

    end_mills: Annotated[tuple[EndMill, ...], "those at hand; by default common ones from 0.4 to 3 mm"] = tuple(
        EndMill(d * 1e-3) for d in (0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0)
    )
    step_down: Annotated[float, unit("mm"), CUT, STEP, "greatest depth of one pass"] = 0.5e-3
    feed: Annotated[float, unit("mm_per_min"), FEED, Usual(1e-4, 0.2), "along the groove"] = 5e-3
    plunge_feed: Annotated[float, unit("mm_per_min"), FEED, Usual(1e-4, 0.2), "into the material"] = 2e-3
    spindle: Annotated[float, unit("rpm"), SPEED, Usual(0.5, 1000.0), "revolutions"] = 200.0
    safe_height: Annotated[float, unit("mm"), LENGTH, SMALL, "above the plate, for moves between cuts"] = 5e-3

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
    """The machine that cuts the plates out of their stock, and its programs."""

    dialect: Annotated[str, OneOf(DIALECTS), "of the programs; for grbl drill cycles are spelled out"] = "grbl"
    work_offset: Annotated[str, OneOf(WORK_OFFSETS), "in which the plate's zero was set"] = "G54"
    touch_plate: Annotated[
        float | None,
        unit("mm"),
        LENGTH,
        "height of a touch plate that is wired to the machine's probe: every plate is then one program, which sets Z "
        "again after each change of the tool; without one it is a program per tool, and Z is set before each",
    ] = None
    change_height: Annotated[float, unit("mm"), LENGTH, SMALL, "above the plate, where tools are changed"] = 40e-3
    spin_up: Annotated[float, unit("s"), NOT_NEGATIVE, "wait after the spindle was switched on"] = 3.0
    drill_feed: Annotated[float, unit("mm_per_min"), FEED, Usual(1e-4, 0.2), "of drills"] = 2e-3
    drill_spindle: Annotated[float, unit("rpm"), SPEED, Usual(0.5, 1000.0), "of drills"] = 50.0
    peck: Annotated[float, unit("mm"), CUT, STEP, "depth after which a drill clears its chips"] = 2e-3
    cut_out: Annotated[bool, "whether plates are cut out of larger stock; else they come in their size"] = True
    outline_diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "of the end mill that cuts plates out"] = 4e-3
    outline_reach: Annotated[float, unit("mm"), LENGTH, SMALL, "depth to which that end mill cuts"] = 25e-3
    outline_step: Annotated[float, unit("mm"), CUT, STEP, "greatest depth of one of its passes"] = 1e-3
    outline_feed: Annotated[float, unit("mm_per_min"), FEED, Usual(1e-4, 0.2), "along the outline"] = 10e-3
    tab_width: Annotated[float, unit("mm"), LENGTH, SMALL, "of the tabs that hold the plate in its stock"] = 6e-3
    tab_height: Annotated[float, unit("mm"), LENGTH, SMALL, "of the tabs"] = 2e-3
    tab_pitch: Annotated[float, unit("mm"), LENGTH, "distance of the tabs that is aimed at"] = 80e-3
    stock: Annotated[
        tuple[float, float] | None, unit("mm"), LENGTH, "width and height of the stock; by default large enough"
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "the workshop")


@dataclass(frozen=True)
class PegSpec:
    """An adjustable mold: a board drilled once, and pegs whose pins stand off their axes.

    Raises:
        InputError: a number is out of its range, or the pegs' disks do not fit beside one another.
    """

    pitch: Annotated[float, unit("mm"), LENGTH, SMALL, "of the holes, which lie on a square lattice on its corner"] = (
        8e-3
    )
    shank: Annotated[float, unit("mm"), LENGTH, SMALL, "diameter of the holes, and of the pegs in them"] = 3e-3
    eccentricity: Annotated[float, unit("mm"), LENGTH, SMALL, "of a peg's pin from its axis"] = 3e-3
    pin: Annotated[float, unit("mm"), LENGTH, SMALL, "diameter of the pin, which touches the tube"] = 2e-3
    angle_step: Annotated[
        float, unit("deg"), Range(above=0.0, most=math.pi / 2), "in which pegs can be set, by a scale or by notches"
    ] = math.pi / 180
    height: Annotated[float, unit("mm"), LENGTH, SMALL, "of the tube above the board"] = 6e-3
    conductivity: Annotated[
        float, unit("W_per_m_K"), POSITIVE, "of the pins; by default that of machinable glass-mica"
    ] = 1.46
    most_deviation: Annotated[float, unit("mm"), LENGTH, "of the tube from its curve, between the pegs too"] = 0.05e-3
    board: Annotated[
        tuple[float, float] | None, unit("mm"), LENGTH, "width and height; by default as large as the tube needs"
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "the pegs")
        if 2 * self.eccentricity + self.pin > self.pitch + 1e-9:
            raise InputError(
                f"pitch of the pegs is {self.pitch * 1e3:g} mm; it must be at least twice the eccentricity and the "
                f"pin's diameter, {(2 * self.eccentricity + self.pin) * 1e3:g} mm, or neighbours run into one another"
            )

    def reach(self, outer_diameter: float) -> float:
        """From the axis of a tube of this diameter (m) to that of a pin which touches it, m."""
        return 0.5 * (outer_diameter + self.pin)


@dataclass(frozen=True)
class ClampSpec:
    """The clamps that hold the tube and feed the current, outside the plate (m).

    The sliding clamp travels growth * travel_factor + travel_extra.
    """

    gap: Annotated[
        float,
        unit("mm"),
        ROOM,
        "from the plate's edge to the clamp, along the tube; more where the tube leaves the plate at a slant",
    ] = 5e-3
    grip: Annotated[float, unit("mm"), LENGTH, "length of tube in a clamp"] = 12e-3
    width: Annotated[float, unit("mm"), LENGTH, "of a clamp, across the tube"] = 15e-3
    least_lead: Annotated[float, unit("mm"), LENGTH, "least straight groove on either side of the bend"] = 5e-3
    sliding_end: Annotated[str, OneOf(ENDS), "where the clamp gives way when the tube grows"] = "distal"
    travel_factor: Annotated[float, POSITIVE, "travel of the sliding clamp per growth of the tube"] = 1.5
    travel_extra: Annotated[float, unit("mm"), ROOM, "travel beyond that"] = 0.5e-3

    def __post_init__(self) -> None:
        check_fields(self)
        if self.travel_factor < 1:
            raise InputError(f"travel_factor is {self.travel_factor:g}; it must be at least 1, or the tube buckles")


@dataclass(frozen=True)
class VentSpec:
    """Holes through the top plate over the bend, which let heat out."""

    diameter: Annotated[float, unit("mm"), LENGTH, SMALL, "of a vent"] = 1.5e-3
    profile: Annotated[
        tuple[float, ...],
        key("open_percent"),
        NOT_NEGATIVE,
        "open part of the groove's area, in equal cells along the bend from its proximal to its distal end; [0] is a "
        "closed lid. A thermal model may shape it so that the tube's temperature is even",
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
class MoldSpec(Displayed):
    """What is asked of a mold; every key may be left out.

    Raises:
        InputError: a number is out of its range, or no such material.
    """

    material: Annotated[MoldMaterial, Named(MOLD_MATERIALS), "of both plates, or its name"] = CALCIUM_SILICATE
    springback: Annotated[Springback, "from `tubeopt mold calibrate`; without one the mold remarks upon it"] = field(
        default_factory=Springback
    )
    cold_length: Annotated[
        float | None, unit("mm"), ROOM, "of tube from a clamp to where it is hot; by default estimated as a fin"
    ] = None
    growth: Annotated[
        float | None,
        unit("mm"),
        ROOM,
        "of the hot tube between the clamps; by default integrated over the fin",
    ] = None
    most_strain: Annotated[
        float | None,
        unit("percent"),
        POSITIVE,
        "of a straight tube pressed in; by default what its material springs back from",
    ] = None
    groove: Annotated[GrooveSpec, "how it fits the tube"] = field(default_factory=GrooveSpec)
    plate: Annotated[PlateSpec, "the two plates and how they are fastened"] = field(default_factory=PlateSpec)
    milling: Annotated[MillingSpec, "end mills and feeds"] = field(default_factory=MillingSpec)
    workshop: Annotated[WorkshopSpec, "the machine that cuts the plates, and its programs"] = field(
        default_factory=WorkshopSpec
    )
    clamps: Annotated[ClampSpec, "the clamps outside the plate"] = field(default_factory=ClampSpec)
    vents: Annotated[VentSpec, "of the top plate over the bend"] = field(default_factory=VentSpec)
    pegs: Annotated[PegSpec, "of an adjustable mold, in place of grooves"] = field(default_factory=PegSpec)
    heat: Annotated[HeatSpec, "the heating that the mold is laid out for"] = field(default_factory=HeatSpec)
    solver: MoldSolver = DEFAULT_MOLD
    """How finely it is searched for and drawn."""

    def __post_init__(self) -> None:
        if isinstance(self.material, str):
            object.__setattr__(self, "material", mold_material(self.material))
        if isinstance(self.springback, (int, float)):
            object.__setattr__(self, "springback", Springback(self.springback))
        check_fields(self, "the mold")
        instance("solver", self.solver, MoldSolver)
