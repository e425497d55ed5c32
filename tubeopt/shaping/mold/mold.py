"""Molds for shape-setting: grooves on a plate, a lid with vents, and the tube after spring-back (SI).

Frame: the origin is the lower left corner of the lower plate, x to the right, y up, z = 0 its upper face; the lid lies
on it. Grooves run from the proximal end of the tube, on the left, to the distal end.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...arguments import typed
from ...display import Displayed
from ...errors import InputError, instance, whole
from ...files.field_metadata import form, key, unit
from ...robots.robot import Robot
from ...robots.tubes import Tube
from ...typing import Array, Delegate, StatusEnum
from ..materials import mold_remarks
from .checks import (
    Check,
    choose_mill,
    fit_tolerance,
    groove_depth,
    held_in_plane,
    machining_remarks,
    material_remarks,
    pressing_strain,
    refuse_failed,
    springback_remarks,
    stiffness_remarks,
    tube_checks,
    wall_check,
)
from .groove import Centreline, Point, bend_of, clipped_area, polygon
from .heat import ColdEnd, cold_end, thermal_growth
from .layout import Blank, Hinge, Hole, Slot, nest, place_fasteners, place_hinge, place_slot, place_vents
from .spec import ENDS, ClampSpec, EndMill, MoldSpec
from .springback import Springback, bend_direction, tube_from_mold

PARTS = ("base", "lid")
"""Names of the two plates of a mold."""

TRAVEL_STEP = 0.5e-3
"""Step for rounding up the travel of the sliding clamp, m."""

CLAMP_CLEARANCE = 1e-3
"""Smallest distance of a clamp's corner from the plate along the tube, m."""


@dataclass(frozen=True)
class Clamp:
    """A clamp outside the plate."""

    end: Annotated[str, "proximal or distal"]
    face: Annotated[Point, unit("mm"), "centre of the face towards the plate"]
    direction: Annotated[Point, "direction of the tube into the clamp"]
    """Unit vector along the tube."""
    travel: float
    """Travel of the sliding clamp outwards, m; 0 for the fixed one."""

    @property
    def slides(self) -> bool:
        """True for the clamp that slides when the tube expands."""
        return self.travel > 0


def clamp_corners(clamp: Clamp, spec: ClampSpec, travel: float = 0.0) -> Array:
    """(6, 2) corners (m) of a clamp: its face, one shoulder, its far side moved outwards by `travel` (m), the other."""
    along = np.asarray(clamp.direction)
    across = np.array([-along[1], along[0]])
    depth = shoulder(spec)
    right = [(0.0, spec.face_width), (depth, spec.width), (spec.grip + travel, spec.width)]
    sides = [(x, -0.5 * width) for x, width in right] + [(x, 0.5 * width) for x, width in right[::-1]]
    return np.array([np.asarray(clamp.face) + x * along + y * across for x, y in sides])


def shoulder(spec: ClampSpec) -> float:
    """Distance (m) behind a clamp's face from which on it has its full width."""
    return min(0.5 * (spec.width - spec.face_width), spec.grip)


@dataclass(frozen=True)
class Groove:
    """Groove of one tube on a plate, with the properties of its blank."""

    blank: Blank
    """Groove without its position on the plate."""
    centreline: Centreline
    """Centreline from plate edge to plate edge."""
    depth: Annotated[float, unit("mm"), form(".4g", label="groove, depth"), "depth of the groove"]
    growth: Annotated[float, unit("mm"), form(".4g", label="growth when hot"), "thermal expansion of the tube"]
    """Growth of the tube between the clamps; from the specification if given."""
    clamps: Annotated[tuple[Clamp, Clamp], "the two clamps"]
    """Proximal and distal clamp."""
    grip: float
    """Length of tube in each clamp, m."""
    vents: tuple[Hole, ...] = ()
    """Vents of the lid over the bend."""
    slot: Slot | None = None
    """Slot of the lid for a thermocouple."""

    number, mill, cold = Delegate[int]("blank"), Delegate[EndMill]("blank"), Delegate[ColdEnd]("blank")
    tube, held = Delegate[Tube]("blank"), Delegate[Tube]("blank")
    width, bend_angle = Delegate[float]("blank"), Delegate[float]("blank")

    @property
    def curvature(self) -> float:
        """Largest curvature of the bend, 1/m, with its sign."""
        return self.held.curvature

    @property
    def radius(self) -> float:
        """Smallest radius of the bend's centreline, m; inf if it is straight."""
        return 1 / abs(self.curvature) if self.curvature else math.inf

    @property
    def bend_length(self) -> float:
        """Length of the bend along its centreline, m."""
        return self.centreline.bend_length

    @property
    def strain(self) -> float:
        """Largest surface strain of a straight tube pressed into the groove."""
        return pressing_strain(self.tube, self.curvature)

    @property
    def gaps(self) -> tuple[float, float]:
        """Lengths (m) of tube between the plate's edge and the proximal and the distal clamp."""
        first, last = self.clamps
        return math.dist(first.face, self.centreline.lead_in.start), math.dist(last.face, self.centreline.lead_out.end)

    @property
    def free_length(self) -> float:
        """Length of tube between the clamps when cold, m."""
        return self.centreline.length + sum(self.gaps)

    @property
    def before_bend(self) -> float:
        """Length of tube to cut before the bend, m: clamp, gap and lead, or the straight part if that is longer."""
        to_clamp_end = self.grip + math.dist(self.clamps[0].face, self.centreline.lead_in.end)
        return max(to_clamp_end, self.tube.straight_length)

    @property
    def after_bend(self) -> float:
        """Length of tube to cut behind the bend, m: lead, gap and clamp."""
        return math.dist(self.clamps[1].face, self.centreline.lead_out.start) + self.grip

    @property
    def stock_length(self) -> float:
        """Length of straight tube to cut, m."""
        return self.before_bend + self.bend_length + self.after_bend

    @property
    def extra_length(self) -> float:
        """Length of tube to trim off after setting, m, which cold ends and clamps need."""
        return self.stock_length - self.tube.length

    @property
    def trim(self) -> tuple[float, float]:
        """Lengths (m) to cut off the proximal and the distal end after setting."""
        return self.before_bend - self.tube.straight_length, self.after_bend

    @property
    def cutter_offsets(self) -> tuple[float, ...]:
        """Offsets (m) of the cutter paths to the left of the centreline; only 0 if the cutter fills the groove."""
        span = self.width - self.mill.diameter
        if span <= 1e-9:
            return (0.0,)
        # Neighbouring paths are at most a cutter's radius apart.
        count = math.ceil(span / (self.mill.diameter / 2) - 1e-9) + 1
        return tuple(float(x) for x in np.linspace(-span / 2, span / 2, count))

    @property
    def radius_play(self) -> float:
        """Largest relative difference of the tube's radius from the groove's, as it may touch either wall."""
        return (self.width - self.tube.outer_diameter) / 2 * abs(self.curvature)

    def curvature_play(self, tolerance: float) -> float:
        """Largest change (1/m) of the mean curvature by the tube's play; tolerance: of the groove's width, m.

        The middle of the bend moves by half the play, and its ends by as much the other way.
        """
        return 8 * (self.width + tolerance - self.tube.outer_diameter) / self.bend_length**2


class MoldStatus(StatusEnum):
    """Status of a planned mold; every value reads as a sentence. A mold that fails a check raises InputError."""

    CHECKED = "the mold passes all checks"
    REMARKED = "the mold passes all checks, with remarks"


@dataclass(frozen=True)
class MoldStatistics:
    """Numbers of grooves, holes of the lower plate, checks and remarks."""

    grooves: int
    holes: int
    checks: int
    remarks: int


@dataclass(frozen=True)
class Mold(Displayed):
    """Two plates with the grooves of one or several tubes."""

    spec: MoldSpec
    """Specification that the mold satisfies."""
    size: Point
    """Width and height of both plates, m."""
    grooves: tuple[Groove, ...]
    """Grooves, one per tube."""
    holes: tuple[Hole, ...]
    """Holes for bolts and dowels through both plates; none with a hinge."""
    checks: tuple[Check, ...]
    """Checks, with numbers and limits."""
    remarks: tuple[str, ...]
    """Remarks for making and using the mold."""
    hinge: Hinge | None = None
    """Hinges and latches of the lid, in place of bolts and dowels."""

    @property
    def value(self) -> tuple[Groove, ...]:
        """Grooves, one per tube."""
        return self.grooves

    @property
    def status(self) -> MoldStatus:
        """Status of the checks and remarks, as a sentence."""
        return MoldStatus.REMARKED if self.remarks else MoldStatus.CHECKED

    @property
    def statistics(self) -> MoldStatistics:
        """Numbers of grooves, holes, checks and remarks."""
        return MoldStatistics(len(self.grooves), len(self.base_holes), len(self.checks), len(self.remarks))

    @property
    def vents(self) -> tuple[Hole, ...]:
        """Vents of the lid, over all bends."""
        return tuple(vent for groove in self.grooves for vent in groove.vents)

    @property
    def slots(self) -> tuple[Slot, ...]:
        """Slots of the lid for thermocouples."""
        return tuple(groove.slot for groove in self.grooves if groove.slot is not None)

    @property
    def base_holes(self) -> tuple[Hole, ...]:
        """All holes of the lower plate."""
        return (*self.holes, *(self.hinge.base_holes if self.hinge else ()))

    @property
    def lid_holes(self) -> tuple[Hole, ...]:
        """All holes of the lid, with those of its strip."""
        return (
            *self.holes,
            *(self.hinge.lid_holes if self.hinge else ()),
            *self.vents,
            *(hole for slot in self.slots for hole in slot.exits),
        )

    @property
    def base_volume(self) -> float:
        """Volume of the lower plate, m^3: plate minus grooves and holes."""
        plate = self.size[0] * self.size[1] * self.spec.plate.thickness
        holes = sum(math.pi / 4 * hole.diameter**2 for hole in self.base_holes) * self.spec.plate.thickness
        grooves = 0.0
        for groove in self.grooves:
            # Lengthened beyond the plate, so that a corner of the plate cuts it off.
            corners = polygon(groove.centreline.lengthened(groove.width + 1e-3), groove.width, 1e-9)
            grooves += clipped_area(corners, self.size) * groove.depth
        return plate - holes - grooves

    @property
    def lid_volume(self) -> float:
        """Volume of the top plate, m^3: plate minus holes, vents and slots, vents counted in both.

        With a hinge, lid and strip are counted without the cut between them.
        """
        open_area = sum(math.pi / 4 * hole.diameter**2 for hole in self.lid_holes)
        open_area += self.size[0] * self.spec.gap if self.hinge else 0.0
        slots = sum(slot.centreline.length * slot.mill.diameter * slot.depth for slot in self.slots)
        return (self.size[0] * self.size[1] - open_area) * self.spec.plate.lid_thickness - slots


@typed
def plan_mold(
    tubes: Tube | Sequence[Tube], mold: MoldSpec | None = None, *, numbers: Sequence[int] | None = None
) -> Mold:
    """Mold for one tube, or for several on one plate.

    The bend of a groove has the length of the tube's curved part, and a curvature that springs back to the tube's. It
    is one arc for a tube of one curvature, and a chain of tangent arcs for planar pieces. Tangent leads run to the
    plate's edge, long enough that the clamps do not cool the bend. The tube's straight part needs no setting: if it is
    longer than lead and clamp, its end is free behind the proximal clamp.

    Args:
        tubes: a tube, or several.
        numbers: number of each tube in texts and drawings; None numbers them from 1.
        mold: material, fit, plate, cutters and so on; None takes the defaults of `MoldSpec`.

    Raises:
        InputError: no tube, a tube without a curved part, or a space curve (`plan_mandrel` winds it). A tube strained
            too far when pressed into its groove, or a curvature that no mold can give. End mills wider than the groove
            or its bend, a plate too thin or too small, grooves that cross, or no room for bolts.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> mold = tubeopt.plan_mold(robot.tubes[0])
        >>> len(mold.grooves)
        1
    """
    spec = MoldSpec() if mold is None else mold
    instance("mold", spec, MoldSpec)
    if not isinstance(tubes, (Tube, Sequence)):
        raise InputError(f"tubes is {tubes!r}; it must be a Tube or several")
    all_tubes = (tubes,) if isinstance(tubes, Tube) else tuple(tubes)
    if not all_tubes:
        raise InputError("tubes is empty; there must be at least one")
    if numbers is None:
        numbers = range(1, len(all_tubes) + 1)
    if len(numbers) != len(all_tubes):
        raise InputError(f"numbers has {len(numbers)} entries; it must have {len(all_tubes)}, one per tube")
    blanks = [_blank(number, tube, spec) for number, tube in zip(numbers, all_tubes, strict=True)]
    checks = [check for blank in blanks for check in tube_checks(blank, spec)]
    refuse_failed(checks)
    layout = nest(blanks, spec)
    if len(blanks) > 1:
        checks.append(wall_check(layout.min_wall, spec))
    widths = [blank.width for blank in blanks]
    of_layout = layout.size, layout.centrelines, widths, spec
    hinge = place_hinge(*of_layout) if spec.hinged else None
    holes = () if hinge else place_fasteners(*of_layout)
    grooves = tuple(
        _groove(blank, curve, layout.size, spec) for blank, curve in zip(blanks, layout.centrelines, strict=True)
    )
    remarks = *_remarks(grooves, spec), *machining_remarks(layout.size, widths, spec)
    return Mold(spec, layout.size, grooves, holes, tuple(checks), remarks, hinge)


def _blank(number: int, tube: Tube, spec: MoldSpec) -> Blank:
    """Groove of a tube without its position on the plate."""
    if not isinstance(tube, Tube):
        raise InputError(f"tube {number} is a {type(tube).__name__}; it must be a Tube")
    held = held_in_plane(number, tube, spec, "a plate is for")
    cold = cold_end(tube, spec.material, spec.heat).of_length(spec.cold_length)
    mill, width = choose_mill(number, tube, spec)
    lead = max(spec.clamps.least_lead, cold.length - spec.clamps.gap)
    return Blank(number, tube, held, cold, mill, width, bend_of(held), lead)


def _groove(blank: Blank, curve: Centreline, size: Point, spec: MoldSpec) -> Groove:
    """Groove on the plate, with clamps, thermal growth and vents."""
    mouths = curve.lead_in.start, curve.lead_out.end
    outward = -curve.lead_in.tangent(np.zeros(1))[0], curve.lead_out.tangent(np.zeros(1))[0]
    gaps, clamps = [], spec.clamps
    for mouth, direction in zip(mouths, outward, strict=True):
        # The gap is larger where the corner of a slanted clamp would meet the plate.
        to_edge = [min(abs(x), abs(extent - x)) for x, extent in zip(mouth, size, strict=True)]
        cosine = abs(float(direction[to_edge.index(min(to_edge))]))
        slant = math.sqrt(max(1 - cosine**2, 0.0)) / cosine
        reach = max(clamps.face_width / 2 * slant, clamps.width / 2 * slant - shoulder(clamps))
        gaps.append(max(clamps.gap, reach + CLAMP_CLEARANCE))
    vents = place_vents(curve, blank.width, spec.vents)
    growth = spec.growth
    if growth is None:
        growth = thermal_growth(blank.tube, spec.heat, blank.cold.decay_length, curve.length + sum(gaps))
    travel = growth * clamps.travel_factor + clamps.travel_extra
    travel = math.ceil(travel / TRAVEL_STEP - 1e-9) * TRAVEL_STEP
    placed = []
    for end, mouth, direction, gap in zip(ENDS, mouths, outward, gaps, strict=True):
        face = np.asarray(mouth) + gap * direction
        placed.append(
            Clamp(
                end=end,
                face=(float(face[0]), float(face[1])),
                direction=(float(direction[0]), float(direction[1])),
                travel=travel if end == clamps.sliding_end else 0.0,
            )
        )
    return Groove(
        blank=blank,
        centreline=curve,
        depth=groove_depth(blank.tube, spec),
        growth=growth,
        clamps=(placed[0], placed[1]),
        grip=clamps.grip,
        vents=vents,
        slot=place_slot(curve, vents, spec),
    )


def _clamp_remarks(grooves: Sequence[Groove], spec: ClampSpec) -> list[str]:
    """Remarks on clamps that overlap anywhere in their travel."""
    jaws = [(g.number, clamp_corners(clamp, spec, clamp.travel)) for g in grooves for clamp in g.clamps]
    pairs = {(first, second) for (first, a), (second, b) in itertools.combinations(jaws, 2) if _overlap(a, b)}
    return [
        f"the two clamps of tube {first} overlap: use narrower clamps, or longer leads"
        if first == second
        else f"clamps of tubes {first} and {second} overlap: set one tube after the other"
        for first, second in sorted(pairs)
    ]


def _overlap(first: Array, second: Array) -> bool:
    """True if two convex outlines (N, 2) overlap: no side of either separates them (separating axis theorem)."""
    for corners in (first, second):
        sides = np.roll(corners, -1, axis=0) - corners
        # Two corners coincide where a clamp has no shoulder; a side without length would separate everything.
        for side in sides[sides.any(axis=1)]:
            axis = np.array([-side[1], side[0]])
            a, b = first @ axis, second @ axis
            if a.max() <= b.min() or b.max() <= a.min():
                return False
    return True


MOST_PLAY = 0.05
"""Relative change of the mean curvature by play, above which a remark names it."""


def _remarks(grooves: Sequence[Groove], spec: MoldSpec) -> list[str]:
    """Remarks on spring-back, shrinkage, clamps and materials."""
    remarks, back = springback_remarks(spec), spec.springback
    if back.curvature_range is not None:
        low, high = back.curvature_range
        for groove in grooves:
            if not low * 0.999 <= abs(groove.curvature) <= high * 1.001:
                remarks.append(
                    f"tube {groove.number}: a mold radius of {groove.radius * 1e3:.4g} mm lies outside the trials "
                    f"({1e3 / high:.4g} to {1e3 / low:.4g} mm) that the spring-back is from"
                )
    if back.shrinkage == 0:
        shrinkage = max(groove.growth / groove.free_length * groove.bend_length for groove in grooves)
        remarks.append(
            f"a curved part comes out up to {shrinkage * 1e3:.2g} mm short when it cools; `shrinkage` of the "
            "spring-back makes up for it"
        )
    remarks += _clamp_remarks(grooves, spec.clamps)
    for groove in grooves:
        change = groove.curvature_play(fit_tolerance(spec)) / max(abs(groove.curvature), 1e-12)
        if groove.curvature and change > MOST_PLAY:
            remarks.append(
                f"tube {groove.number}: play in the groove changes the mean curvature by up to {100 * change:.1f} %; "
                "a narrower groove (clearance_mm) changes it by less"
            )
        if groove.tube.material.thermal is None:
            remarks.append(
                f"tube {groove.number}: thermal constants of {groove.tube.material.name} are not known; those of "
                "nitinol are taken"
            )
        of_tube = *stiffness_remarks(groove.tube), *mold_remarks(groove.tube.material, spec.heat.set_temperature)
        remarks += [f"tube {groove.number}: {remark}" for remark in of_tube]
    return [*remarks, *material_remarks(spec)]


# --- the tubes of a robot ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RobotMold(Displayed):
    """A mold for tubes of a robot."""

    mold: Mold
    """Planned mold; its grooves have the numbers of the robot's tubes."""
    name: Annotated[str, key("robot"), "name of the robot"]
    left_out: tuple[str, ...]
    """Reasons why other tubes have no groove."""
    made: tuple[int, ...] = ()
    """Number of equal tubes to make in each groove; without numbers one each."""

    @property
    def making(self) -> str:
        """Grooves in which several tubes are made, as text for a title; "" if there are none."""
        several = [(g.number, n) for g, n in zip(self.mold.grooves, self.made, strict=False) if n > 1]
        if len(self.mold.grooves) == 1:
            return "".join(f", make {n}" for _, n in several)
        return "".join(f", make {n} of tube {number}" for number, n in several)


def plan_robot_mold(robot: Robot, spec: MoldSpec | None = None, tubes: Sequence[int] | None = None) -> RobotMold:
    """Mold for the tubes of a robot.

    Args:
        tubes: their numbers, from 1; by default every curved tube that is not equal to an earlier one.

    Raises:
        InputError: no such tube, none that needs a mold, or a mold that cannot be made.
    """
    numbers, left_out = chosen_tubes(robot, tubes)
    mold = plan_mold([robot.tubes[number - 1] for number in numbers], spec, numbers=numbers)
    made = [equal_tubes(robot, number) if tubes is None else 1 for number in numbers]
    return RobotMold(mold, robot.name, tuple(left_out), tuple(made))


def equal_tubes(robot: Robot, number: int) -> int:
    """Number of tubes of a robot that are equal to the tube of a number, from 1; itself included."""
    return sum(tube == robot.tubes[number - 1] for tube in robot.tubes)


def chosen_tubes(robot: Robot, tubes: Sequence[int] | None = None) -> tuple[list[int], list[str]]:
    """Numbers, from 1, of the tubes that need a groove, and the reasons why others have none.

    Args:
        tubes: numbers that the user selects; None selects all that need one.

    Raises:
        InputError: no such tube, or none that needs a groove.
    """
    all_tubes = robot.tubes
    if tubes is not None:
        for number in tubes:
            if not 1 <= number <= len(all_tubes):
                raise InputError(f"tubes has {number}; it must be numbers of tubes, from 1 to {len(all_tubes)}")
        return list(tubes), []
    numbers: list[int] = []
    left_out, space_curves = [], 0
    for k, tube in enumerate(all_tubes, start=1):
        first = next((j for j in numbers if all_tubes[j - 1] == tube), None)
        if tube.curved_length == 0 or tube.curvature == 0:
            left_out.append(f"tube {k} is straight and needs no mold")
        elif bend_direction(tube) is None:
            space_curves += 1
            left_out.append(f"tube {k} is a space curve and takes a mandrel: tubeopt mold mandrel")
        elif first is not None:
            left_out.append(f"tube {k} is equal to tube {first} and is set in its groove")
        else:
            numbers.append(k)
    if not numbers and space_curves:
        raise InputError("no tube of this robot is planar; use `tubeopt mold mandrel` for space curves")
    if not numbers:
        raise InputError("no tube of this robot is curved; none needs a mold")
    return numbers, left_out


def predict_tube(mold: Mold, index: int | None = None, *, springback: Springback | None = None) -> Tube:
    """Tube that a groove produces after spring-back: the inverse of `plan_mold`.

    Args:
        mold: the mold.
        index: index of the groove, from 0; required if there are several.
        springback: spring-back model; by default that of the mold.

    Raises:
        InputError: no such groove, several grooves and no index, or a tube tighter than it is thick.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> mold = tubeopt.plan_mold(robot.tubes[0])
        >>> round(tubeopt.predict_tube(mold).curvature, 6)
        10.0
    """
    instance("mold", mold, Mold)
    count = len(mold.grooves)
    if index is None and count > 1:
        raise InputError(f"the mold has {count} grooves; give index, 0 to {count - 1}")
    if not 0 <= (k := whole("index", 0 if index is None else index)) < count:
        raise InputError(f"index is {index}; it must lie in 0 to {count - 1}")
    return tube_from_mold(mold.grooves[k].held, springback or mold.spec.springback)


def predict_tubes(mold: Mold, *, springback: Springback | None = None) -> tuple[Tube, ...]:
    """Tubes that all grooves produce after spring-back, as `predict_tube`."""
    return tuple(predict_tube(mold, k, springback=springback) for k in range(len(mold.grooves)))
