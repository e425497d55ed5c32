"""The parts of a design study as they are written: free dimensions, requirements, objectives, tolerances."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Literal

from pydantic import Field

from ..bodies.corridors import Corridor
from ..design import (
    Avoid,
    Coverage,
    Deployment,
    DesignTask,
    Free,
    Length,
    Nesting,
    Objective,
    Poses,
    Reach,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    StrokeForce,
    Target,
    Tolerances,
    Wall,
)
from ..design.parameters import TUBE_FIELDS
from ..design.requirements import Requirement
from ..errors import InputError
from ..files.checked import Count, Entry, NotNegative, Number, Positive, Whole
from ..files.fields import EntryOf, Part, asking, described, extended
from ..files.units import unit_of
from ..robots.concentric import ConcentricRobot
from ..robots.file import Range
from ..robots.pieces import Slots
from ..robots.tubes import Tube
from .obstacle_file import Bodies
from .robot_keys import RobotPath

Row = Annotated[list[Number], Field(min_length=1)]
"""A number for every tube."""


@dataclass(frozen=True)
class Ranged:
    """A key that holds the least and greatest value of a free dimension."""

    field: str
    """The dimension."""
    unit: str
    about: str
    """What is said of it."""
    scaled: bool = False
    """Whether the tubes are scaled by one factor."""


OF_PIECES = (
    Ranged("piece_curvature", "per_m", "range of the largest curvature; a varying curvature is scaled"),
    Ranged("piece_shape", "per_m", "range of the Chebyshev coefficients of the curvature about x along the piece"),
    Ranged("piece_plane", "deg", "range of the rotation of the bend plane, from that of the robot"),
    Ranged("piece_twist", "deg_per_mm", "range of the natural twist"),
    Ranged("piece_bending_factor", "", "range of the remaining fraction of the bending stiffness"),
    Ranged("piece_torsion_factor", "", "range of the remaining fraction of the torsional stiffness"),
)

SCALED = ("curvature", "straight_length", "curved_length")
"""Dimensions that one factor may scale."""

RANGES = {
    **{
        one.key: Ranged(one.name, unit_of(one.key), "range of this dimension")
        for one in described(Tube)
        if one.name in TUBE_FIELDS
    },
    **{f"{name}_factor": Ranged(name, "", "range of one factor for all these tubes", scaled=True) for name in SCALED},
    **{f"{one.field}_{one.unit}" if one.unit else one.field: one for one in OF_PIECES},
}
"""Keys of a free dimension."""


@extended({key: (Range | None, Field(None, description=one.about or None)) for key, one in RANGES.items()})
class FreeEntry(Part):
    """One free dimension of some tubes; the value of its key is the allowed range."""

    tubes: Annotated[list[Whole], Field(min_length=1)] = Field(description="numbers of the tubes, 1 for the innermost")
    equal: bool = Field(False, description="one common value for all these tubes or pieces, instead of one each")
    pieces: list[Whole] = Field(
        [],
        description="numbers of the pieces, counted from the straight part to the tip; default all",
    )
    coefficients: Annotated[Whole, Field(ge=1)] = Field(1, description="number of coefficients of a piece_shape")
    torsion_share: NotNegative | None = Field(
        None,
        description="loss of torsional stiffness per loss of bending stiffness, with a piece_bending_factor; 0 to 1",
    )

    slots: EntryOf[Slots] | None = Field(
        None, description="position of the slots, for a strain limit with a piece_bending_factor"
    )

    def build(self) -> Free:
        """The free dimension in SI."""
        given = [key for key in RANGES if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"gives {len(given)} ranges; it must give one of {', '.join(RANGES)}")
        key = given[0]
        one, (low, high) = RANGES[key], self.si(key)
        if one.scaled and self.equal:
            raise ValueError(f"gives equal with {key}; a factor is already the same for all its tubes")
        return Free(
            one.field,
            tuple(i - 1 for i in self.tubes),
            low,
            high,
            "scaled" if one.scaled else "equal" if self.equal else "each",
            tuple(j - 1 for j in self.pieces),
            self.coefficients,
            self.si("torsion_share"),
            None if self.slots is None else self.slots.build(),
        )


class LengthEntry(Part):
    """A bound on a length of one tube."""

    length: Literal["overall", "straight", "curved"] = Field(description="the length: overall, straight or curved")
    tube: Whole = Field(description="number of the tube, 1 for the innermost")
    at_most_mm: Positive | None = Field(None, description="upper bound")
    at_least_mm: Positive | None = Field(None, description="lower bound")

    def build(self) -> Length:
        """The requirement in SI."""
        least, most = self.si("at_least_mm"), self.si("at_most_mm")
        if (least is None) == (most is None):
            raise ValueError("must give one of at_most_mm and at_least_mm")
        field = "length" if self.length == "overall" else f"{self.length}_length"
        return Length(field, self.tube - 1, least or most, most is None)


class PoseEntry(Entry):
    """A task pose with given joint values."""

    rotations_deg: Row
    translations_mm: Row


DEPLOYED = "also for the arm during deployment to each pose, with its tubes retracted straight"


@asking(Corridor)
class CorridorRequirementEntry(Part):
    """A tube around a polyline in which the whole arm must stay."""

    deployed: bool = Field(False, description=DEPLOYED)

    def build(self) -> Avoid:
        """The requirement in SI."""
        return Avoid((super().build(),), deployed=self.deployed)


class AvoidEntry(Part):
    """Bodies that the whole arm must keep away from."""

    obstacles: Bodies
    clearance_mm: NotNegative = Field(Decimal(0), description="smallest allowed distance between arm and bodies")
    deployed: bool = Field(False, description=DEPLOYED)

    def build(self) -> Avoid:
        """The requirement in SI."""
        return Avoid(self.obstacles, self.si("clearance_mm"), self.deployed)


NUMBERS = [(kind, one) for kind in (Nesting, Wall, Stroke, Deployment, StrokeForce) for one in described(kind)]
"""Requirements that are one number each, and what that is."""


@extended({one.key: (one.annotation | None, Field(None, description=one.about)) for _, one in NUMBERS})
class Requirements(Part):
    """Requirements of a design."""

    snap_free: EntryOf[SnapFree] | None = None
    snap_free_in_use: EntryOf[SnapFreeInUse] | None = None
    strain: EntryOf[Strain] | None = None
    lengths: list[LengthEntry] = Field([])
    reach: list[EntryOf[Target]] = Field([])
    coverage: EntryOf[Coverage] | None = None
    poses: list[PoseEntry] = Field([])
    corridor: CorridorRequirementEntry | None = None
    avoid: AvoidEntry | None = None

    def build(self) -> tuple[Requirement, ...]:
        """All requirements in SI; task poses in the order reach, coverage, poses."""
        out = _built(self.snap_free, self.snap_free_in_use, self.strain, *self.lengths)
        given = [(kind, one, getattr(self, one.key)) for kind, one in NUMBERS]
        out += [kind(one.read(number)) for kind, one, number in given if number is not None]
        out += [Reach(tuple(target.build() for target in self.reach))] if self.reach else []
        out += _built(self.coverage)
        if self.poses:
            rotations, translations = (tuple(pose.si(key) for pose in self.poses) for key in PoseEntry.model_fields)
            out.append(Poses(rotations, translations))
        return (*out, *_built(self.corridor, self.avoid))


def _built(*entries: Part | None) -> list[Requirement]:
    return [entry.build() for entry in entries if entry is not None]


class Designed(Entry):
    """A robot that is designed: what may change, and what must hold."""

    name: str = Field("", description="name of the design")
    robot: RobotPath
    free: Annotated[list[FreeEntry], Field(min_length=1)]
    requirements: Requirements
    ordered: bool = Field(
        True, description="require the tube order at translations 0 and at all translations of the task"
    )

    def task_for(self, *aims: Objective) -> DesignTask:
        """The task in SI; raises InputError where its parts do not fit together."""
        if not isinstance(self.robot, ConcentricRobot):
            raise InputError("robot must be a concentric robot")
        free = tuple(entry.build() for entry in self.free)
        return DesignTask(self.robot, free, self.requirements.build(), aims, self.name, self.ordered)


class Tried(Entry):
    """How many designs a search begins with."""

    starts: Count = Field(1, description="number of starting points: the given dimensions and random ones")
    seed: Annotated[Whole, Field(ge=0)] = Field(0, description="random seed of starts, turns and samples")
    turns: Annotated[Whole, Field(ge=0)] = Field(
        6, description="number of random full turns, per row of translations, to test a certified robot for snaps"
    )


@asking(Tolerances)
class TolerancesEntry(Part):
    """Manufacturing errors: standard deviations, or half widths of uniform distributions."""

    samples: Annotated[Whole, Field(ge=2)] = Field(500, description="number of random robots")
