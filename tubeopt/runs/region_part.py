"""A region of a patient as the aim of a design study: what share of it is reached."""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
from pydantic import Field, model_validator

from ..bodies.frames import Frame
from ..design import DesignTask, SearchedDesign, search_design
from ..display import Displayed
from ..files.checked import Count, Entry, NotNegative, Number, Positive, Whole
from ..files.field_metadata import Typical
from ..planning import PairReach, PlanOptions, ReachShare, RegionReach
from ..robots.concentric import ConcentricRobot
from ..typing import Array, Progress
from .anatomy_file import AnatomyKey
from .obstacle_file import Bodies

OF_ONE = 120.0
"""Seconds on the clock for all places of one robot."""

PLANNED = 6
"""Places of those that are reached to which plans are made and proved."""

OF_A_PLAN = 20.0
"""Seconds on the clock for each of these plans."""

OTHER = 100
"""By how much seed, and by what part roadmaps differ with which other places are judged."""


Searched = TypeVar("Searched", RegionReach, PairReach)

HARDLY = 0.05
"""Share of a region below which the roadmap may be what is missing, and not the robot."""

FEW = "it lies out of reach, or the roadmap is too small to decide"
"""What may be the reason."""

MOST = 1000
"""Places of a region that can be asked for."""


@dataclass(frozen=True, eq=False)
class RegionAnswer(Displayed):
    """What a design reaches of a region."""

    search: SearchedDesign
    """How it was found."""
    before: ReachShare
    """What the robot that was given reaches of places that were not searched with, over larger roadmaps."""
    after: ReachShare
    """The same of the design."""
    proved: int
    """How many of the plans are proved."""
    planned: int
    """How many plans were made, to some of the places that the design reaches."""
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
        return np.asarray(np.random.default_rng(seed).permutation(target)[:wanted])

    def numbers(self, seed: int) -> tuple[float, float, PlanOptions, int, float, float]:
        """What `RegionReach` and `PairReach` take after their bodies, in SI."""
        return (
            self.si("tolerance_mm"),
            self.si("min_margin"),
            PlanOptions(clearance=self.si("clearance_mm"), time_limit=OF_ONE, seed=seed),
            self.points,
            self.si("shift_mm"),
            self.si("tilt_deg"),
        )

    def judge(self, searched: Searched, chosen: Array) -> Searched:
        """What tells the share of the other places: over roadmaps twice as large, with other random numbers."""
        options = replace(searched.options, seed=searched.options.seed + OTHER)
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
        wanted = RegionReach(start, chosen[: self.places], bodies, *self.numbers(seed))
        return wanted, self.judge(wanted, chosen)

    def run(self, task: DesignTask, starts: int, seed: Whole, turns: int, progress: Progress | None) -> RegionAnswer:
        """The design, and what it reaches; raises as `search_design`."""
        wanted, other = self.reach(task.robot.n_tubes, seed)
        found = search_design(
            task, wanted, time_limit=self.si("seconds"), starts=starts, seed=seed, turns=turns, progress=progress
        )
        robot = task.robot
        assert isinstance(robot, ConcentricRobot)
        before = other.evaluate(robot, np.zeros(len(other.ranges)))
        after = other.evaluate(found.value, found.own)
        proved, planned = hurried(other).plans_proved(found.value, found.own, after, PLANNED)
        return RegionAnswer(found, before, after, proved, planned, wanted.base(found.own))
