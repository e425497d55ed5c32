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
    Bore,
    Channel,
    Coverage,
    Deflection,
    Deployment,
    DesignTask,
    Free,
    Girth,
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
from ..design.parameters import PLACES, SHEATH, TUBE_FIELDS
from ..design.requirements import Requirement
from ..display import Displayed
from ..errors import InputError
from ..files.checked import Count, Entry, NotNegative, Number, Positive, Whole, check_kind
from ..files.field_metadata import Typical
from ..files.fields import EntryOf, Part, keys_from, keys_in, values, with_keys
from ..files.units import unit_of
from ..files.yaml_file import load_yaml
from ..planning import PairReach, PlanOptions, ReachFraction, RegionReach
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import BundleRobot, SheathedRobot
from ..robots.file import MaterialChoice, Range, material_of
from ..robots.pieces import Slots
from ..robots.tubes import Tube
from ..typing import Array, Progress
from .robot_keys import DEFAULT_MARGIN, MinMargin, RobotPath
from .surroundings_file import AnatomyKey, Bodies

Row = Annotated[list[Number], Field(min_length=1)]
"""Numbers, one per tube."""


@dataclass(frozen=True)
class Ranged:
    """Key with the range of a free dimension."""

    field: str
    """Name of the dimension in `Free`."""
    unit: str
    about: str
    """Description for help and documentation."""
    scaled: bool = False
    """True if one factor scales all tubes."""


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
        field.key: Ranged(field.name, unit_of(field.key), "range of this dimension")
        for field in keys_in(Tube)
        if field.name in TUBE_FIELDS
    },
    **{f"{name}_factor": Ranged(name, "", "range of one factor for all these tubes", scaled=True) for name in SCALED},
    **{
        field.key: Ranged(field.name, unit_of(field.key), "range, of an eccentric robot")
        for field in keys_in(BundleRobot)
        if field.name in (*PLACES, *SHEATH)
    },
    **{f"{piece.field}_{piece.unit}" if piece.unit else piece.field: piece for piece in OF_PIECES},
}
"""Keys for the range of a free dimension."""


@with_keys({key: (Range | None, Field(None, description=free.about or None)) for key, free in RANGES.items()})
class FreeEntry(Part):
    """Free dimension of some tubes; the value of its key is the allowed range."""

    tubes: list[Whole] = Field([], description="numbers of the tubes, 1 for the innermost; none for a sheath")
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
        """Free dimension in SI."""
        keys = [key for key in RANGES if getattr(self, key) is not None]
        if len(keys) != 1:
            raise ValueError(f"gives {len(keys)} ranges; it must give one of {', '.join(RANGES)}")
        key = keys[0]
        dimension, (low, high) = RANGES[key], self.si(key)
        if not self.tubes and dimension.field not in SHEATH:
            raise ValueError("has no tubes; give the numbers of the tubes, as tubes: [1, 2]")
        if dimension.scaled and self.equal:
            raise ValueError(f"gives equal with {key}; a factor is already the same for all its tubes")
        return Free(
            field=dimension.field,
            tubes=tuple(i - 1 for i in self.tubes),
            lower=low,
            upper=high,
            tie="scaled" if dimension.scaled else "equal" if self.equal else "each",
            pieces=tuple(j - 1 for j in self.pieces),
            coefficients=self.coefficients,
            torsion_share=self.si("torsion_share"),
            slots=None if self.slots is None else self.slots.build(),
        )


class LengthEntry(Part):
    """A bound on a length of one tube."""

    length: Literal["overall", "straight", "curved"] = Field(description="the length: overall, straight or curved")
    tube: Whole = Field(description="number of the tube, 1 for the innermost")
    at_most_mm: Positive | None = Field(None, description="upper bound")
    at_least_mm: Positive | None = Field(None, description="lower bound")

    def build(self) -> Length:
        """Requirement in SI."""
        lower, upper = self.si("at_least_mm"), self.si("at_most_mm")
        if (lower is None) == (upper is None):
            raise ValueError("must give one of at_most_mm and at_least_mm")
        field = "length" if self.length == "overall" else f"{self.length}_length"
        return Length(field, self.tube - 1, lower or upper, upper is None)


class PoseEntry(Entry):
    """A task pose with given joint values."""

    rotations_deg: Row
    translations_mm: Row


DEPLOYED = "also for the arm during deployment to each pose, with its tubes retracted straight"


@keys_from(Corridor)
class CorridorRequirementEntry(Part):
    """Tube around a polyline that the whole arm must stay in."""

    deployed: bool = Field(False, description=DEPLOYED)

    def build(self) -> Avoid:
        """Requirement in SI."""
        return Avoid((super().build(),), deployed=self.deployed)


class AvoidEntry(Part):
    """Bodies that the whole arm must keep away from."""

    obstacles: Bodies
    clearance_mm: NotNegative = Field(Decimal(0), description="smallest allowed distance between arm and bodies")
    deployed: bool = Field(False, description=DEPLOYED)

    def build(self) -> Avoid:
        """Requirement in SI."""
        return Avoid(self.obstacles, self.si("clearance_mm"), self.deployed)


ONE_NUMBER = (Nesting, Wall, Channel, Bore, Girth, Stroke, Deployment, StrokeForce)

NUMBERS = [(kind, field) for kind in ONE_NUMBER for field in keys_in(kind)]
"""Requirements of one number each, with its field."""


@with_keys({field.key: (field.annotation | None, Field(None, description=field.about)) for _, field in NUMBERS})
class Requirements(Part):
    """Requirements of a design."""

    snap_free: EntryOf[SnapFree] | None = None
    snap_free_in_use: EntryOf[SnapFreeInUse] | None = None
    strain: EntryOf[Strain] | None = None
    deflection: EntryOf[Deflection] | None = None
    lengths: list[LengthEntry] = Field([])
    reach: list[EntryOf[Target]] = Field([])
    coverage: EntryOf[Coverage] | None = None
    poses: list[PoseEntry] = Field([])
    corridor: CorridorRequirementEntry | None = None
    avoid: AvoidEntry | None = None

    def build(self) -> tuple[Requirement, ...]:
        """Requirements in SI; task poses in the order reach, coverage, poses."""
        out = _built(self.snap_free, self.snap_free_in_use, self.strain, self.deflection, *self.lengths)
        for kind, field in NUMBERS:
            if (number := getattr(self, field.key)) is not None:
                out.append(kind(field.read(number)))
        out += [Reach(tuple(target.build() for target in self.reach))] if self.reach else []
        out += _built(self.coverage)
        if self.poses:
            rotations, translations = (tuple(pose.si(key) for pose in self.poses) for key in PoseEntry.model_fields)
            out.append(Poses(rotations, translations))
        return (*out, *_built(self.corridor, self.avoid))


def _built(*entries: Part | None) -> list[Requirement]:
    return [entry.build() for entry in entries if entry is not None]


class DesignedRobot(Entry):
    """Robot with its free dimensions and requirements."""

    name: str = Field("", description="name of the design, for headings")
    robot: RobotPath
    free: Annotated[list[FreeEntry], Field(min_length=1)]
    requirements: Requirements
    ordered: bool = Field(
        True, description="require the tube order at translations 0 and at all translations of the task"
    )

    def task_for(self, *objectives: Objective) -> DesignTask:
        """Design task in SI; raises InputError if its parts do not fit together."""
        free = tuple(entry.build() for entry in self.free)
        robot = self.robot.bundle() if isinstance(self.robot, SheathedRobot) else self.robot
        return DesignTask(robot, free, self.requirements.build(), objectives, self.name, self.ordered)


MULTISTART = ("starts", "seed", "turns")


@keys_from(optimize_design, *MULTISTART)
class Multistart(Entry):
    """Number of start designs, and their random seed."""

    @property
    def multistart(self) -> dict[str, Any]:
        """Arguments of `optimize_design`, and of the searches over it: starts, seed, turns."""
        return values(optimize_design, self, *MULTISTART)


@keys_from(Tolerances)
@keys_from(tolerance_analysis, "samples")
class TolerancesEntry(Part):
    """Manufacturing errors: standard deviations, or half widths of uniform distributions."""


# --- tubes from stock -------------------------------------------------------------------------------------------------


@keys_from(StockTube)
class StockEntry(Part):
    """Size of a tube in stock."""

    material: MaterialChoice = "nitinol"

    def build(self) -> StockTube:
        """Size in SI."""
        return StockTube(**values(StockTube, self), material=material_of(self.material))


class StockList(Entry):
    """List of tube sizes in stock, each with its source."""

    kind: Literal["tubes"]
    tubes: list[StockEntry] = Field(min_length=1)


STOCK_KINDS: dict[str, type[StockList]] = {"tubes": StockList}
"""Kinds of stock lists."""


def load_stock(path: str | PathLike[str]) -> tuple[StockTube, ...]:
    """Load the sizes of a stock list; raises InputError with one line per problem."""
    stock = check_kind(STOCK_KINDS, load_yaml(path, "tubes"), path)
    sizes = tuple(entry.build() for entry in stock.tubes)
    if len({size.name for size in sizes}) < len(sizes):
        raise InputError(f"{path}: a tube name is given twice; every size must have its own name")
    return sizes


# --- a region of a patient as the objective ---------------------------------------------------------------------------

# A large roadmap must not use up the time of the whole search.
REACH_TIME = 120.0
"""Time limit for all points of one robot, s."""

PLANNED_POINTS = 6
"""Number of reached points with planned and proved motions."""

PLAN_TIME = 20.0
"""Time limit of each of these plans, s."""

SEED_OFFSET = 100
"""Offset of the seed of the roadmaps that evaluate a design, so that they differ from the search's."""

ReachProblem = TypeVar("ReachProblem", RegionReach, PairReach)

DOUBTFUL_FRACTION = 0.05
"""Reached fraction below which the cause may be the roadmap, and not the robot."""

POSSIBLE_CAUSES = "it lies out of reach, or the roadmap is too small to decide"
"""Causes of such a fraction."""

MAX_POINTS = 1000
"""Largest number of points of a region."""


@dataclass(frozen=True, eq=False)
class RegionAnswer(Displayed):
    """Fraction of a region that a design reaches."""

    search: SearchedDesign
    """Search that found the design."""
    before: ReachFraction
    """Reached fraction of the given robot, for points that the search did not use and larger roadmaps."""
    after: ReachFraction
    """Reached fraction of the design, for the same points."""
    proved: Annotated[int, "number of proved plans"]
    planned: Annotated[int, "number of plans made to these places"]
    base: Frame
    """Base pose of the design, in the frame of the given base plate."""

    @property
    def summary(self) -> str:
        """Sentence on the reached fractions, which are lower bounds: a larger roadmap may reach more points."""
        before, after = (f"at least {100 * reached.fraction:.0f} %" for reached in (self.before, self.after))
        judged = f"of {len(self.after.targets)} places not searched with"
        return f"{self.search.objective}: {before} before, {after} after, {judged}"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remark that the roadmap may be too small, if almost nothing is reached."""
        if self.after.fraction > DOUBTFUL_FRACTION:
            return ()
        return (f"next to nothing of the region was reached; {POSSIBLE_CAUSES}: raise objective.points",)


class SearchPart(Entry):
    """Options of a search for designs that reach a region, for one robot or two."""

    obstacles: Bodies = Field((), description="further obstacles: a YAML file or a list of bodies")
    clearance_mm: Annotated[NotNegative, Typical(1e-5, 0.1)] = Field(
        Decimal("0.2"), description="smallest allowed distance of an arm from obstacles, and between two arms"
    )
    min_margin: MinMargin = DEFAULT_MARGIN
    tolerance_mm: Annotated[Positive, Typical(1e-6, 0.05)] = Field(
        Decimal("0.5"), description="largest distance between the tip and a reached point"
    )
    places: Annotated[Count, Field(le=MAX_POINTS)] = Field(
        12, description="number of points of the region for the search"
    )
    judged: Annotated[Count, Field(le=MAX_POINTS)] = Field(
        48, description="number of other points of the region to evaluate the result"
    )
    points: Count = Field(200, description="number of roadmap nodes per robot")
    shift_mm: NotNegative = Field(Decimal(0), description="largest shift of a base plate along each of its axes")
    tilt_deg: NotNegative = Field(Decimal(0), le=45, description="largest tilt of a base plate about its x and y axes")
    seconds: Positive = Field(Decimal(180), description="time limit of the search")

    def sample_target(self, target: Array | None, seed: int) -> Array:
        """Random voxels of a target, (places + judged, 3), m; raises ValueError if it has too few, or is None."""
        if target is None:
            raise ValueError("has an anatomy without a target; the objective needs a target")
        count = self.places + self.judged
        if len(target) < count:
            raise ValueError(
                f"has a target of {len(target)} voxels; it must have at least {count} (places plus judged)"
            )
        # Without replacement: places of the search and of the evaluation are disjoint.
        return np.asarray(np.random.default_rng(seed).permutation(target)[:count])

    def options(self, seed: int) -> dict[str, Any]:
        """Common fields of `RegionReach` and `PairReach`, SI."""
        options = PlanOptions(clearance=self.si("clearance_mm"), time_limit=REACH_TIME, seed=seed)
        return {"options": options, "count": self.points} | self.in_si(
            "tolerance_mm", "min_margin", "shift_mm", "tilt_deg"
        )

    def evaluation_of(self, searched: ReachProblem, points: Array) -> ReachProblem:
        """Reach problem that evaluates a result: other points, roadmaps of twice the size, other random numbers."""
        options = replace(searched.options, seed=searched.options.seed + SEED_OFFSET)
        # The search fits its designs to its own roadmap and points. Others show what remains elsewhere.
        return replace(searched, targets=points[self.places :], options=options, count=2 * self.points)


def with_plan_time(evaluation: ReachProblem) -> ReachProblem:
    """Reach problem with the time limit of one plan instead of the limit of the whole region."""
    return replace(evaluation, options=replace(evaluation.options, time_limit=PLAN_TIME))


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
    def _has_target(self) -> Self:
        self.sample_target(self.anatomy.target, 0)
        return self

    def reach(self, n: int, seed: int) -> tuple[RegionReach, RegionReach]:
        """Problem of the search for n tubes, and a larger one with other points that evaluates its result."""
        for name, row in (("start_deg", self.start_deg), ("start_mm", self.start_mm)):
            if row is not None and len(row) != n:
                raise ValueError(f"objective.{name} has {len(row)} numbers; it must be {n} (one per tube)")
        points = self.sample_target(self.anatomy.target, seed)
        start = np.array(self.si("start_deg") or np.zeros(n)), np.array(self.si("start_mm"))
        bodies = self.anatomy.bodies + self.obstacles
        searched = RegionReach(start, points[: self.places], bodies, **self.options(seed))
        return searched, self.evaluation_of(searched, points)

    def run(self, task: DesignTask, multistart: Mapping[str, Any], progress: Progress | None) -> RegionAnswer:
        """Search for the best design, with arguments from `Multistart.multistart`; raises as `search_design`."""
        searched, evaluation = self.reach(task.robot.n_tubes, multistart["seed"])
        search = search_design(task, searched, time_limit=self.si("seconds"), progress=progress, **multistart)
        robot = task.robot
        assert isinstance(robot, ConcentricRobot)
        # 0 is the base plate as given.
        before = evaluation.evaluate(robot, np.zeros(len(evaluation.ranges)))
        after = evaluation.evaluate(search.value, search.variables)
        plans = with_plan_time(evaluation).plans_proved(search.value, search.variables, after, PLANNED_POINTS)
        proved, planned = plans
        return RegionAnswer(search, before, after, proved, planned, searched.base(search.variables))
