"""Parts of a design study: free dimensions, requirements, tolerances, tubes from stock, and a region to reach."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from os import PathLike
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import Field, model_validator

from ..bodies.corridors import Corridor
from ..bodies.frames import Frame
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
    SearchedDesign,
    SnapFree,
    SnapFreeInUse,
    StockTube,
    Strain,
    Stroke,
    StrokeForce,
    Target,
    Tolerances,
    Wall,
    optimize_design,
    search_design,
    tolerance_analysis,
)
from ..design.parameters import TUBE_FIELDS
from ..design.requirements import Requirement
from ..display import Displayed
from ..errors import InputError
from ..files.checked import Count, Entry, NotNegative, Number, Positive, Whole, check_kind
from ..files.field_metadata import Typical
from ..files.fields import EntryOf, Part, asking, described, extended, values
from ..files.units import unit_of
from ..files.yaml_file import load_yaml
from ..planning import PairReach, PlanOptions, ReachShare, RegionReach
from ..robots.concentric import ConcentricRobot
from ..robots.file import MaterialChoice, Range, material_of
from ..robots.pieces import Slots
from ..robots.tubes import Tube
from ..typing import Array, Progress
from .robot_keys import RobotPath
from .surroundings_file import AnatomyKey, Bodies

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
        # Design variables are dimensions of nested tubes; eccentric robots have other constraints.
        if not isinstance(self.robot, ConcentricRobot):
            raise InputError("robot must be a concentric robot")
        free = tuple(entry.build() for entry in self.free)
        return DesignTask(self.robot, free, self.requirements.build(), aims, self.name, self.ordered)


TRIES = ("starts", "seed", "turns")


@asking(optimize_design, *TRIES)
class Tried(Entry):
    """How many designs a search begins with."""

    @property
    def tries(self) -> dict[str, Any]:
        """Arguments of `optimize_design`, and of the searches over it: starts, seed, turns."""
        return values(optimize_design, self, *TRIES)


@asking(Tolerances)
@asking(tolerance_analysis, "samples")
class TolerancesEntry(Part):
    """Manufacturing errors: standard deviations, or half widths of uniform distributions."""


# --- tubes from stock -------------------------------------------------------------------------------------------------


@asking(StockTube)
class StockEntry(Part):
    """One size."""

    material: MaterialChoice = "nitinol"

    def build(self) -> StockTube:
        """The size in SI."""
        return StockTube(**values(StockTube, self), material=material_of(self.material))


class StockList(Entry):
    """Sizes of tubes that can be bought, each with its source."""

    kind: Literal["tubes"]
    tubes: list[StockEntry] = Field(min_length=1)


STOCK_KINDS: dict[str, type[StockList]] = {"tubes": StockList}
"""What the key `kind` of a stock list may say."""


def load_stock(path: str | PathLike[str]) -> tuple[StockTube, ...]:
    """The sizes in a stock list; raises InputError for what makes none: one line for every problem."""
    found = check_kind(STOCK_KINDS, load_yaml(path, "tubes"), path)
    sizes = tuple(entry.build() for entry in found.tubes)
    if len({size.name for size in sizes}) < len(sizes):
        raise InputError(f"{path}: a tube name is given twice; every size must have its own name")
    return sizes


# --- a region of a patient as the objective ---------------------------------------------------------------------------

# Seconds for all places of one robot, so that a large roadmap cannot take the time of the whole search.
OF_ONE = 120.0

# Reached places to which plans are made and proved: a sample of them.
PLANNED = 6

# Seconds for each of these plans.
OF_A_PLAN = 20.0

# Added to the seed of roadmaps that evaluate a design, so that they differ from those of the search.
OTHER = 100


Searched = TypeVar("Searched", RegionReach, PairReach)

# Share of a region below which the roadmap may be the cause, and not the robot.
HARDLY = 0.05

# Possible causes of such a share.
FEW = "it lies out of reach, or the roadmap is too small to decide"

# Largest number of places.
MOST = 1000


@dataclass(frozen=True, eq=False)
class RegionAnswer(Displayed):
    """What a design reaches of a region."""

    search: SearchedDesign
    """How it was found."""
    before: ReachShare
    """What the robot that was given reaches of places that were not searched with, over larger roadmaps."""
    after: ReachShare
    """The same of the design."""
    proved: Annotated[int, "number of proved plans"]
    planned: Annotated[int, "number of plans made to these places"]
    base: Frame
    """Where the plate stands for the design, in the frame of the plate as it was given."""

    @property
    def words(self) -> str:
        """What is reached, in words: at least, since a larger roadmap may lead to more places."""
        before, after = (f"at least {100 * one.share:.0f} %" for one in (self.before, self.after))
        judged = f"of {len(self.after.targets)} places not searched with"
        return f"{self.search.wanted}: {before} before, {after} after, {judged}"

    @property
    def remarks(self) -> tuple[str, ...]:
        """That the roadmap may be too small, where it leads to next to nothing."""
        if self.after.share > HARDLY:
            return ()
        return (f"next to nothing of the region was reached; {FEW}: raise objective.points",)


class SearchPart(Entry):
    """What a search for designs that reach a region says, for one robot or for two."""

    obstacles: Bodies = Field((), description="further obstacles: a YAML file or a list of bodies")
    clearance_mm: Annotated[NotNegative, Typical(1e-5, 0.1)] = Field(
        Decimal("0.2"), description="smallest allowed distance of an arm from obstacles, and between two arms"
    )
    min_margin: NotNegative = Field(Decimal("0.05"), lt=1, description="smallest allowed stability margin, below 1")
    tolerance_mm: Annotated[Positive, Typical(1e-6, 0.05)] = Field(
        Decimal("0.5"), description="largest distance between the tip and a reached point"
    )
    places: Annotated[Count, Field(le=MOST)] = Field(12, description="number of points of the region for the search")
    judged: Annotated[Count, Field(le=MOST)] = Field(
        48, description="number of other points of the region to evaluate the result"
    )
    points: Count = Field(200, description="number of roadmap nodes per robot")
    shift_mm: NotNegative = Field(Decimal(0), description="largest shift of a base plate along each of its axes")
    tilt_deg: NotNegative = Field(Decimal(0), le=45, description="largest tilt of a base plate about its x and y axes")
    seconds: Positive = Field(Decimal(180), description="time limit of the search")

    def chosen(self, target: Array | None, seed: int) -> Array:
        """(places + judged, 3) places of a target, picked at random; raises ValueError where it has too few, or is
        none."""
        if target is None:
            raise ValueError("has an anatomy without a target; the objective needs a target")
        wanted = self.places + self.judged
        if len(target) < wanted:
            raise ValueError(
                f"has a target of {len(target)} voxels; it must have at least {wanted} (places plus judged)"
            )
        # Without replacement: places of the search and of the evaluation are disjoint.
        return np.asarray(np.random.default_rng(seed).permutation(target)[:wanted])

    def options(self, seed: int) -> dict[str, Any]:
        """Fields of `RegionReach` and `PairReach`, SI."""
        options = PlanOptions(clearance=self.si("clearance_mm"), time_limit=OF_ONE, seed=seed)
        return {"options": options, "count": self.points} | self.in_si(
            "tolerance_mm", "min_margin", "shift_mm", "tilt_deg"
        )

    def judge(self, searched: Searched, chosen: Array) -> Searched:
        """What tells the share of the other places: over roadmaps twice as large, with other random numbers."""
        options = replace(searched.options, seed=searched.options.seed + OTHER)
        # The search fits its designs to its own roadmap and places. Others show what remains elsewhere.
        return replace(searched, targets=chosen[self.places :], options=options, count=2 * self.points)


def hurried(judge: Searched) -> Searched:
    """The same with the time that a plan has, not that of a whole region."""
    return replace(judge, options=replace(judge.options, time_limit=OF_A_PLAN))


class RegionEntry(SearchPart):
    """Fraction of the anatomy's target that the tip reaches from a start, with margin and clearance."""

    kind: Literal["reach_share"]
    anatomy: AnatomyKey = Field(
        description="anatomy of a patient with a target (images, meshes, point clouds): a YAML file or its keys"
    )
    start_deg: Annotated[list[Number], Field(min_length=1)] | None = Field(
        None, description="rotations at the start; default 0"
    )
    start_mm: Annotated[list[Number], Field(min_length=1)] = Field(description="translations at the start")

    @model_validator(mode="after")
    def _a_region(self) -> Self:
        self.chosen(self.anatomy.target, 0)
        return self

    def reach(self, n: int, seed: int) -> tuple[RegionReach, RegionReach]:
        """What is searched for with n tubes, and that by which what comes of it is judged."""
        for name, row in (("start_deg", self.start_deg), ("start_mm", self.start_mm)):
            if row is not None and len(row) != n:
                raise ValueError(f"objective.{name} has {len(row)} numbers; it must be {n} (one per tube)")
        chosen = self.chosen(self.anatomy.target, seed)
        start = np.array(self.si("start_deg") or np.zeros(n)), np.array(self.si("start_mm"))
        bodies = self.anatomy.bodies + self.obstacles
        wanted = RegionReach(start, chosen[: self.places], bodies, **self.options(seed))
        return wanted, self.judge(wanted, chosen)

    def run(self, task: DesignTask, tries: Mapping[str, Any], progress: Progress | None) -> RegionAnswer:
        """The design, and what it reaches, with the arguments `Tried.tries`; raises as `search_design`."""
        wanted, other = self.reach(task.robot.n_tubes, tries["seed"])
        found = search_design(task, wanted, time_limit=self.si("seconds"), progress=progress, **tries)
        robot = task.robot
        assert isinstance(robot, ConcentricRobot)
        # 0 is the base plate as given.
        before = other.evaluate(robot, np.zeros(len(other.ranges)))
        after = other.evaluate(found.value, found.own)
        proved, planned = hurried(other).plans_proved(found.value, found.own, after, PLANNED)
        return RegionAnswer(found, before, after, proved, planned, wanted.base(found.own))
