"""Studies of tube designs: one robot, or two that work in one region."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from ..bodies.frames import Frame
from ..bodies.obstacles import nearest_distance
from ..design import (
    DesignSolution,
    DesignTask,
    Objective,
    ParetoFront,
    SearchedPair,
    SnapFree,
    StockChoice,
    StockTube,
    ToleranceAnalysis,
    choose_from_stock,
    optimize_design,
    pareto_front,
    search_pair,
    tolerance_analysis,
)
from ..design.exchange import certified_at
from ..design.optimize import front_tasks
from ..design.requirements import of_kind
from ..design.stock import stock_choices, with_sizes
from ..display import Displayed
from ..errors import InputError
from ..files.checked import Count, Entry, NotNegative, Number, Positive, Whole, in_file
from ..files.field_metadata import Typical, key
from ..files.fields import EntryOf, values
from ..files.units import TO_MM
from ..planning import PairFraction, PairReach
from ..stability import ASSUMING
from ..typing import Array, Progress
from ..validation.certainty import PROBABILITIES
from .design_parts import (
    DOUBTFUL_FRACTION,
    MAX_POINTS,
    POSSIBLE_CAUSES,
    DesignedRobot,
    Multistart,
    RegionAnswer,
    RegionEntry,
    SearchPart,
    TolerancesEntry,
    load_stock,
    with_plan_time,
)
from .plan_study import PlacedPart, shared
from .real_robot import (
    DesignBounds,
    Judged,
    Reserve,
    check_confidence,
    design_bounds,
    judged_design,
    kept_by_real_robot,
    with_reserve,
)
from .study_file import Timed
from .surroundings_file import AnatomyKey, BasePart, Position

StockPath = Annotated[
    tuple[StockTube, ...],
    in_file(load_stock, "a stock list"),
    Field(description="path of the stock list, relative to this file"),
]
"""Stock of tube sizes, given as the path of its file."""


def _objective_form(value: object) -> str:
    if isinstance(value, list):
        return "<several>"
    return "<region>" if isinstance(value, dict) and value.get("kind") == "reach_share" else "<one>"


Aims = Annotated[
    Annotated[EntryOf[Objective], Tag("<one>")]
    | Annotated[RegionEntry, Tag("<region>")]
    | Annotated[list[EntryOf[Objective]], Field(min_length=1), Tag("<several>")],
    Discriminator(_objective_form),
]
"""Objectives, or the reached fraction of a region."""


class StockStudy(Entry):
    """Tube sizes from stock."""

    file: StockPath
    clearance_mm: Annotated[NotNegative, Typical(1e-5, 0.1)] = Field(
        description="smallest difference between the inner diameter of a tube and the outer "
        "diameter of the tube inside it"
    )
    keep: Count = Field(5, description="number of best choices to find with certainty")


@dataclass(frozen=True, eq=False)
class DesignAnswer(Displayed):
    """Design with the requested analyses; None for those that were not requested."""

    solution: DesignSolution
    """Best design."""
    tolerance: Annotated[ToleranceAnalysis | None, "effect of manufacturing tolerances; null unless requested"]
    front: Annotated[ParetoFront | None, key("pareto"), "trade-off between margin and objective; null unless requested"]
    stock: StockChoice | None
    """Choice of tube sizes from stock."""
    region: Annotated[RegionAnswer | None, "reached fraction of a region; null unless it is the objective"] = None
    real: DesignBounds | None = None
    """Bounds on the real robot; None without a posterior."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the design, and on the search over its reached region."""
        return self.solution.remarks + (() if self.region is None else self.region.remarks)


class DesignStudy(DesignedRobot, Multistart, Timed):
    """The best robot that satisfies a list of requirements."""

    doing = "designing"
    assuming = f"Statements about snaps are valid {ASSUMING}, except the force max_tip_force_mN."

    kind: Literal["design"]
    objective: Aims
    tolerances: TolerancesEntry | None = None
    pareto_margins: Annotated[list[Number], Field(min_length=1)] | None = Field(
        None, description="required margins of the points of the Pareto front"
    )
    stock: StockStudy | None = None
    confidence: Positive | None = Field(
        None,
        gt=0.5,
        lt=1,
        description="a real robot of the design must keep certificate, margin, clearance and tolerances of targets at "
        "this probability, estimated from the posterior of the robot file; default not required",
        examples=["P"],
    )
    workers: Count = Field(1, description="number of processes for starts, stock and tolerances")

    @model_validator(mode="after")
    def _makes_a_task(self) -> Self:
        task = self.task()
        check_confidence(self.confidence, task.robot)
        if self.confidence is not None and (isinstance(self.objective, RegionEntry) or self.pareto_margins is not None):
            raise ValueError("gives confidence, which supports neither objective reach_share nor pareto_margins")
        if self.confidence is not None and any(each.max_force for each in of_kind(task.requirements, SnapFree)):
            raise ValueError("gives confidence and max_tip_force_mN; the real robot is known without force only")
        if self.pareto_margins is not None:
            # Tasks are built now, so that a wrong margin is reported before the design is searched.
            front_tasks(task, [float(m) for m in self.pareto_margins])
        if self.stock is not None:
            stock_choices(task, self.stock.file, self.stock.si("clearance_mm"))
        if isinstance(self.objective, RegionEntry):
            if self.stock is not None or self.pareto_margins is not None:
                raise ValueError(
                    "objective reach_share uses a derivative-free search; it does not support stock or a Pareto front"
                )
            self.objective.reach(task.robot.n_tubes, self.multistart["seed"])
        return self

    def task(self) -> DesignTask:
        """Design task in SI; raises InputError if its parts do not fit together."""
        objectives = self.objective if isinstance(self.objective, list) else [self.objective]
        return self.task_for(
            *(Objective("change") if isinstance(each, RegionEntry) else each.build() for each in objectives)
        )

    def run(self, progress: Progress | None = None) -> DesignAnswer:
        """Optimise the design.

        Raises:
            SolveError: no design satisfies all requirements, or the verification of the best one failed.
        """
        task, choice, confidence = self.task(), None, self.si("confidence")
        if self.stock is not None:
            options = self.stock.in_si("clearance_mm", "keep")
            choice = choose_from_stock(task, self.stock.file, workers=self.workers, progress=progress, **options)
            assert choice.best is not None
            # Sizes from stock are fixed; lengths and curvatures are optimised with them.
            task = with_sizes(task, choice.best.sizes)
        region = None
        if isinstance(self.objective, RegionEntry):
            region = self.objective.run(task, self.multistart, progress)
            solution = region.search.solution
        else:

            def design_with(reserve: Reserve) -> Judged[DesignSolution]:
                raised = with_reserve(task, reserve)
                found = optimize_design(raised, progress=progress, workers=self.workers, **self.multistart)
                return Judged(found, ()) if confidence is None else judged_design(found, task, confidence)

            solution = kept_by_real_robot("design", design_with)
        tolerance = None
        if self.tolerances is not None:
            tolerance = tolerance_analysis(
                solution.robot,
                self.tolerances.build(),
                translations=certified_at(solution.attempt.program, solution.robot) or None,
                poses=[(e.rotations, e.translations) for e in solution.equilibria],
                workers=self.workers,
                progress=progress,
                **values(tolerance_analysis, self.tolerances, "samples"),
            )
        front = None
        if self.pareto_margins is not None:
            front = pareto_front(task, [float(m) for m in self.pareto_margins], start=solution.attempt)
        real = design_bounds(solution, PROBABILITIES if confidence is None else (confidence,))
        return DesignAnswer(solution, tolerance, front, choice, region, real)


# --- two robots -------------------------------------------------------------------------------------------------------

PLANNED_PAIRS = 4
"""Number of reached pairs of points with planned and proved motions of both arms."""


@dataclass(frozen=True, eq=False)
class PairAnswer(Displayed):
    """Two robots designed together, with the fraction of pairs of points that both tips reach."""

    search: SearchedPair
    """Search that found the designs."""
    before: PairFraction
    """Reached fraction of the given robots, for points that the search did not use and larger roadmaps."""
    after: PairFraction
    """Reached fraction of the designs, for the same points."""
    proved: Annotated[int, "number of proved plans"]
    planned: Annotated[int, "number of plans of both arms to such pairs"]
    names: tuple[str, str]
    """Names of the arms."""
    plates: tuple[Frame, Frame]
    """Base poses of the designs."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the designs, each with the name of its arm, and on the search."""
        remarks = [
            f"{name}: {remark}"
            for name, solution in zip(self.names, self.search.solutions, strict=True)
            for remark in solution.remarks
        ]
        if min(arm.fraction for arm in self.after.reached) <= DOUBTFUL_FRACTION:
            remarks.append(f"an arm reached next to nothing by itself; {POSSIBLE_CAUSES}: raise points")
        return tuple(remarks)


class PairPart(DesignedRobot, PlacedPart):
    """Robot of a pair: base, start, free dimensions and requirements."""

    name: str = Field("", description="name in messages and plots; default the name of the robot")
    base: BasePart = Field(description="base plate in the common frame")

    def task(self) -> DesignTask:
        """Design task of the robot; raises InputError if its parts do not fit together."""
        return self.task_for(Objective("change"))


class BallPart(Entry):
    """Ball-shaped region."""

    centre_mm: Position = Field(description="centre in the common frame")
    radius_mm: Positive = Field(description="radius of the ball")

    def places(self, count: int, seed: int) -> Array:
        """Sample uniformly distributed points (count, 3) in the ball, m."""
        random = np.random.default_rng(seed)
        # Normal components have no preferred direction: scaled to length 1 they are uniform on the sphere.
        direction = random.normal(size=(count, 3))
        # The fraction of the volume within r is (r / R)^3; its inverse makes the density uniform.
        r = self.si("radius_mm") * random.random((count, 1)) ** (1 / 3)
        return np.asarray(self.si("centre_mm") + r * direction / np.linalg.norm(direction, axis=1, keepdims=True))


class PairStudy(Timed, SearchPart, Multistart):
    """Two robots, designed together to reach as many pairs of points of a region as possible without contact."""

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
    places: Annotated[Whole, Field(ge=2, le=MAX_POINTS)] = Field(
        8, description="number of points of the region for the search"
    )
    judged: Annotated[Whole, Field(ge=2, le=MAX_POINTS)] = Field(
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
        searched, evaluation = self.reach_problems()
        targets = np.concatenate([searched.targets, evaluation.targets])
        # Some points may lie in an obstacle: they cannot be reached by any design.
        if searched.obstacles and not (nearest_distance(searched.obstacles, targets) > 0).any():
            raise ValueError("has a region inside an obstacle: none of its sampled points is free")
        # Base plates that may shift are moved apart by the search.
        distance = float(np.linalg.norm(searched.bases[0].origin - searched.bases[1].origin))
        # At the plates the arms are at least as thick as their outermost tubes.
        radii = sum(max(tube.outer_diameter for tube in arm.robot.tubes) / 2 for arm in self.arms)
        if not self.shift_mm and distance < radii + searched.options.clearance:
            raise ValueError(
                f"has fixed base plates {distance * TO_MM:.3g} mm apart; tubes and clearance "
                f"need {(radii + searched.options.clearance) * TO_MM:.3g} mm"
            )
        return self

    def reach_problems(self) -> tuple[PairReach, PairReach]:
        """Problem of the search, and a larger one with other points that evaluates its result."""
        around, seed = shared(self.anatomy), self.multistart["seed"]
        if self.region is None:
            points = self.sample_target(around.target, seed)
        else:
            points = self.region.places(self.places + self.judged, seed)
        first, second = (arm.placed(around).base for arm in self.arms)
        starts = self.arms[0].start, self.arms[1].start
        bodies = around.bodies + self.obstacles
        searched = PairReach(starts, (first, second), points[: self.places], bodies, **self.options(seed))
        return searched, self.evaluation_of(searched, points)

    def run(self, progress: Progress | None = None) -> PairAnswer:
        """Search for the best pair of designs.

        Raises:
            SolveError: no designs satisfy all requirements, or the verification of the best ones failed.
        """
        searched, evaluation = self.reach_problems()
        first, second = (arm.task() for arm in self.arms)
        search = search_pair(
            (first, second),
            searched,
            progress=progress,
            time_limit=self.si("seconds"),
            **self.multistart,
        )
        before = evaluation.evaluate(first.robot, second.robot, np.zeros(len(evaluation.ranges)))
        after = evaluation.evaluate(*search.value, search.variables)
        plans = with_plan_time(evaluation).plans_proved(*search.value, search.variables, after, PLANNED_PAIRS)
        proved, planned = plans
        name_1, name_2 = (arm.placed(shared(self.anatomy)).called for arm in self.arms)
        return PairAnswer(search, before, after, proved, planned, (name_1, name_2), searched.plates(search.variables))
