"""The study of a tube design: the task, and what else is asked of its answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from ..design import (
    DesignSolution,
    DesignTask,
    Objective,
    ParetoFront,
    StockChoice,
    StockTube,
    ToleranceAnalysis,
    choose_from_stock,
    optimize_design,
    pareto_front,
    tolerance_analysis,
)
from ..design.exchange import certified_at
from ..design.pareto import front_tasks
from ..design.stock import stock_choices, with_sizes
from ..display import Displayed
from ..files.checked import Count, Entry, NotNegative, Number, in_file
from ..files.field_metadata import Typical
from ..files.fields import EntryOf
from ..stability import ASSUMING
from ..typing import Progress
from .design_parts import Designed, TolerancesEntry, Tried
from .region_part import RegionAnswer, RegionEntry
from .stock_file import load_stock
from .study_file import Timed

StockPath = Annotated[
    tuple[StockTube, ...],
    in_file(load_stock, "a stock list"),
    Field(description="path of the stock list, relative to this file"),
]
"""Sizes of tubes, given as the path of their file."""


def _aims(value: object) -> str:
    if isinstance(value, list):
        return "<several>"
    return "<region>" if isinstance(value, dict) and value.get("kind") == "reach_share" else "<one>"


Aims = Annotated[
    Annotated[EntryOf[Objective], Tag("<one>")]
    | Annotated[RegionEntry, Tag("<region>")]
    | Annotated[list[EntryOf[Objective]], Field(min_length=1), Tag("<several>")],
    Discriminator(_aims),
]
"""One objective, several, or the share of a region that is reached."""


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
    """A design, and what was asked besides, None where it was not."""

    solution: DesignSolution
    """The design."""
    tolerance: ToleranceAnalysis | None
    """Its spread in manufacture."""
    front: ParetoFront | None
    """On which it lies."""
    stock: StockChoice | None
    """The choice from stock."""
    region: RegionAnswer | None = None
    """What it reaches of a region."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Of the design, and of the search for what it reaches of a region."""
        return self.solution.remarks + (() if self.region is None else self.region.remarks)


class DesignStudy(Designed, Tried, Timed):
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
    workers: Count = Field(1, description="number of processes for starts, stock and tolerances")

    @model_validator(mode="after")
    def _makes_a_task(self) -> Self:
        task = self.task()
        if self.pareto_margins is not None:
            front_tasks(task, [float(m) for m in self.pareto_margins])
        if self.stock is not None:
            stock_choices(task, self.stock.file, self.stock.si("clearance_mm"))
        if isinstance(self.objective, RegionEntry):
            if self.stock is not None or self.pareto_margins is not None:
                raise ValueError(
                    "objective reach_share uses a derivative-free search; it does not support stock or a Pareto front"
                )
            self.objective.reach(task.robot.n_tubes, self.seed)
        return self

    def task(self) -> DesignTask:
        """The task in SI; raises InputError where its parts do not fit together."""
        objectives = self.objective if isinstance(self.objective, list) else [self.objective]
        return self.task_for(
            *(Objective("change") if isinstance(one, RegionEntry) else one.build() for one in objectives)
        )

    def run(self, progress: Progress | None = None) -> DesignAnswer:
        """The design.

        Raises:
            SolveError: no design meets all requirements, or the one found does not keep them.
        """
        task, choice = self.task(), None
        if self.stock is not None:
            given = self.stock.in_si("clearance_mm", "keep")
            choice = choose_from_stock(task, self.stock.file, workers=self.workers, progress=progress, **given)
            assert choice.best is not None
            task = with_sizes(task, choice.best.sizes)
        region = None
        if isinstance(self.objective, RegionEntry):
            region = self.objective.run(task, self.starts, self.seed, self.turns, progress)
            solution = region.search.solution
        else:
            solution = optimize_design(task, progress=progress, **self.in_si("starts", "seed", "workers", "turns"))
        tolerance = None
        if self.tolerances is not None:
            tolerance = tolerance_analysis(
                solution.robot,
                self.tolerances.build(),
                translations=certified_at(solution.attempt.program, solution.robot) or None,
                poses=[(e.rotations, e.translations) for e in solution.equilibria],
                samples=self.tolerances.samples,
                workers=self.workers,
                progress=progress,
            )
        front = None
        if self.pareto_margins is not None:
            front = pareto_front(task, [float(m) for m in self.pareto_margins], start=solution.attempt)
        return DesignAnswer(solution, tolerance, front, choice, region)
