"""The study of two robots sized together, for a region in which both tips work at the same time."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..bodies.frames import Frame
from ..bodies.obstacles import nearest_distance
from ..design import DesignTask, Objective, SearchedPair, search_pair
from ..display import Displayed
from ..errors import InputError
from ..files.checked import Count, Entry, NotNegative, Positive, Whole
from ..files.field_metadata import Typical
from ..files.units import TO_MM
from ..planning import PairReach, PairShare
from ..stability import ASSUMING
from ..typing import Array, Progress
from .anatomy_file import AnatomyKey, BasePart
from .arms_study import PlacedPart, shared
from .design_parts import Designed, Tried
from .obstacle_file import Place
from .region_part import FEW, HARDLY, MOST, SearchPart, hurried
from .study_file import Timed

PLANNED = 4
"""Pairs of places of those that are held to which motions of both arms are planned and proved."""


@dataclass(frozen=True, eq=False)
class PairAnswer(Displayed):
    """Two robots sized together, and what they hold of a region."""

    search: SearchedPair
    """How they were found."""
    before: PairShare
    """What the robots that were given hold of places that were not searched with, over larger roadmaps."""
    after: PairShare
    """The same of the designs."""
    proved: int
    """How many of the motions are proved."""
    planned: int
    """How many motions of both arms were planned, to some pairs of these places."""
    names: tuple[str, str]
    """What the arms are called."""
    plates: tuple[Frame, Frame]
    """Where they stand for the designs."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Of the designs, each with the name of its arm, and of the search for what they hold."""
        told = [
            f"{name}: {words}"
            for name, solution in zip(self.names, self.search.solutions, strict=True)
            for words in solution.remarks
        ]
        if min(one.share for one in self.after.reached) <= HARDLY:
            told.append(f"an arm reached next to nothing by itself; {FEW}: raise points")
        return tuple(told)


class PairPart(Designed, PlacedPart):
    """One of the two robots: base, start, free dimensions and requirements."""

    name: str = Field("", description="name in messages and plots; default the name of the robot")
    base: BasePart = Field(description="base plate in the common frame")

    def task(self) -> DesignTask:
        """What may change of it, and what must hold; raises InputError where that makes no task."""
        return self.task_for(Objective("change"))


class BallPart(Entry):
    """A ball."""

    centre_mm: Place = Field(description="centre in the common frame")
    radius_mm: Positive = Field(description="radius of the ball")

    def places(self, count: int, seed: int) -> Array:
        """(count, 3) random places in it, as thick everywhere, m."""
        random = np.random.default_rng(seed)
        way = random.normal(size=(count, 3))
        far = self.si("radius_mm") * random.random((count, 1)) ** (1 / 3)
        return np.asarray(self.si("centre_mm") + far * way / np.linalg.norm(way, axis=1, keepdims=True))


class PairStudy(Timed, SearchPart, Tried):
    """Two robots, designed together to hold as many pairs of places of a region as possible without contact."""

    doing = "designing"
    assuming = f"Statements about snaps are valid {ASSUMING}."

    kind: Literal["design_pair"]
    arms: Annotated[list[PairPart], Field(min_length=2, max_length=2)] = Field(description="the two robots")
    region: BallPart | None = Field(
        None, description="region for both tips in the common frame; default the target of the anatomy"
    )
    anatomy: AnatomyKey | None = Field(
        None, description="anatomy of a patient (images, meshes, point clouds): a YAML file or its keys"
    )
    clearance_mm: Annotated[NotNegative, Typical(1e-5, 0.1)] = Field(
        Decimal("0.5"), description="smallest allowed distance of both arms from obstacles and from each other"
    )
    places: Annotated[Whole, Field(ge=2, le=MOST)] = Field(
        8, description="number of points of the region for the search"
    )
    judged: Annotated[Whole, Field(ge=2, le=MOST)] = Field(
        16, description="number of other points of the region to evaluate the result"
    )
    points: Count = Field(80, description="number of roadmap nodes per robot")

    @model_validator(mode="after")
    def _a_pair(self) -> Self:
        if self.region is None and self.anatomy is None:
            raise ValueError("has neither a region nor an anatomy with a target; give one of them")
        for k, arm in enumerate(self.arms):
            try:
                arm.task()
            except InputError as error:
                raise ValueError(f"arms[{k}]: {error}") from None
        searched, judge = self.wanted()
        places = np.concatenate([searched.targets, judge.targets])
        if searched.obstacles and not (nearest_distance(searched.obstacles, places) > 0).any():
            raise ValueError("has a region inside an obstacle: none of its sampled points is free")
        apart = float(np.linalg.norm(searched.bases[0].origin - searched.bases[1].origin))
        thick = sum(max(tube.outer_diameter for tube in arm.robot.tubes) / 2 for arm in self.arms)
        if not self.shift_mm and apart < thick + searched.options.clearance:
            raise ValueError(
                f"has fixed base plates {apart * TO_MM:.3g} mm apart; tubes and clearance "
                f"need {(thick + searched.options.clearance) * TO_MM:.3g} mm"
            )
        return self

    def wanted(self) -> tuple[PairReach, PairReach]:
        """What is searched for, and that by which what comes of it is judged."""
        around = shared(self.anatomy)
        if self.region is None:
            chosen = self.chosen(around.target, self.seed)
        else:
            chosen = self.region.places(self.places + self.judged, self.seed)
        one, other = (arm.placed(around).base for arm in self.arms)
        starts = self.arms[0].start, self.arms[1].start
        bodies = around.bodies + self.obstacles
        searched = PairReach(starts, (one, other), chosen[: self.places], bodies, *self.numbers(self.seed))
        return searched, self.judge(searched, chosen)

    def run(self, progress: Progress | None = None) -> PairAnswer:
        """The designs, and what they hold.

        Raises:
            SolveError: no designs meet all requirements, or those found do not keep them.
        """
        searched, judge = self.wanted()
        first, second = (arm.task() for arm in self.arms)
        found = search_pair(
            (first, second),
            searched,
            progress=progress,
            time_limit=self.si("seconds"),
            **self.in_si("starts", "seed", "turns"),
        )
        before = judge.evaluate(first.robot, second.robot, np.zeros(len(judge.ranges)))
        after = judge.evaluate(*found.value, found.own)
        proved, planned = hurried(judge).plans_proved(*found.value, found.own, after, PLANNED)
        one, other = (arm.placed(shared(self.anatomy)).called for arm in self.arms)
        return PairAnswer(found, before, after, proved, planned, (one, other), searched.plates(found.own))
