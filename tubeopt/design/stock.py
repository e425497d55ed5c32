"""Choice of tubes from a stock list, by enumeration with bounds and a design for each candidate."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np

from ..arguments import typed
from ..errors import InputError, SolveError, TimeLimitError, instance, whole
from ..files.field_metadata import (
    NOT_NEGATIVE,
    POSITIVE,
    TYPICAL_TUBE_CLEARANCE,
    Typical,
    check_fields,
    typical_length,
    unit,
)
from ..robots.eccentric import BundleRobot
from ..robots.materials import NITINOL, Material
from ..solvers.parallel import executor, run_all
from ..solvers.time_limit import LONG_TIME_LIMIT, limited, time_left
from ..typing import Progress
from .infeasibility import shown_infeasible
from .objectives import key_of
from .optimize import add_worst_cases
from .parameters import of_section
from .program import compile_task
from .requirements import Length, Nesting, Strain, Wall
from .solve import multistart
from .task import DesignedRobot, DesignTask

# Requirements on dimensions alone, which bound a candidate without an equilibrium.
CHEAP = (Length, Nesting, Wall)

# Objectives that speak of dimensions alone.
BOUNDED = ("tip_curvature", "turning_radius", "strain", "length", "change")

OF_POSES = ("tip_curvature", "turning_radius")
"""Objectives that a bundle has in its poses."""


@dataclass(frozen=True)
class StockTube:
    """Tube size from stock."""

    name: Annotated[str, "order number"]
    outer_diameter: Annotated[float, unit("mm"), POSITIVE, Typical(1e-4, 0.1)]
    inner_diameter: Annotated[float, unit("mm"), NOT_NEGATIVE, Typical(2e-5, 0.1)]
    source: Annotated[str, "supplier or publication"] = ""
    material: Material = NITINOL
    """Material of the tube."""

    def __post_init__(self) -> None:
        check_fields(self)
        instance("material", self.material, Material)
        if self.inner_diameter >= self.outer_diameter:
            raise InputError(f"stock tube {self.name!r} has no wall: its inner diameter must be less than its outer")


@dataclass(frozen=True, eq=False)
class Candidate:
    """Choice of tube sizes, inner to outer."""

    sizes: tuple[StockTube, ...]
    bound: float
    """Lower bound on the minimised objective, from the requirements on dimensions alone."""
    objective: float | None
    """Objective of the design in its own sign, SI; None without a design."""
    robot: DesignedRobot | None
    status: str
    """"design", "pruned", "out of time", "not found" with the limit violated most, or "infeasible" with the reason."""


@dataclass(frozen=True, eq=False)
class StockChoice:
    """All candidates: designs, the best first, then candidates without a design, then pruned ones."""

    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate | None:
        """Best design; None without any."""
        first = self.candidates[0] if self.candidates else None
        return first if first is not None and first.robot is not None else None

    def count(self, status: str) -> int:
        """Number of candidates with a status."""
        return sum(candidate.status.startswith(status) for candidate in self.candidates)


@typed
@limited
def choose_from_stock(
    task: DesignTask,
    stock: Sequence[StockTube],
    *,
    clearance: float = 0.05e-3,
    keep: int = 5,
    starts: int = 1,
    workers: int = 1,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> StockChoice:
    """Choose stock sizes for all tubes: a design for every choice that fits and may be among the best.

    Tubes of a bundle fit at the offsets of its robot; those of equal section stay equal.

    Candidates are solved in the order of their bounds, the optima under the requirements on dimensions alone (strain of
    straightened tubes, lengths, walls). A candidate is pruned if its bound is worse than the `keep` best designs. The
    bound is exact if that smaller problem has one optimum, as for curvature and strain.

    Args:
        clearance: smallest difference of diameters between a tube and the tube around it, m.
        keep: number of best designs that pruning must not remove.
        starts: number of starts for each design.
        time_limit: maximum run time, s; choices without a design by then are "out of time".

    Raises:
        InputError: keep, starts or workers below 1, a clearance below 0, nothing in stock nests, a task in which
            diameters are free or with several objectives.
        SolveError: no design was found with any of them.
    """
    for name, value in (("keep", keep), ("starts", starts), ("workers", workers)):
        whole(name, value, 1)
    choices = stock_choices(task, stock, clearance)
    bounds = [_bound(with_sizes(task, sizes)) for sizes in choices]
    out_of_time = False
    order = np.argsort(bounds, kind="stable")
    candidates: list[Candidate] = []
    with executor(workers) as pool:
        for k in range(0, len(order), workers):
            best = sorted(_minimised(task, candidate) for candidate in candidates if candidate.robot is not None)
            limit = best[keep - 1] if len(best) >= keep else np.inf
            batch = order[k : k + workers]
            out_of_time = out_of_time or time_left() == 0
            ended = [i for i in batch if out_of_time or bounds[i] >= limit]
            candidates += [
                Candidate(choices[i], bounds[i], None, None, "out of time" if out_of_time else "pruned") for i in ended
            ]
            tasks = [(with_sizes(task, choices[i]), choices[i], bounds[i]) for i in batch if i not in ended]
            candidates += run_all(partial(_design, starts=starts), tasks, pool)
            if progress is not None:
                progress(len(candidates), len(order))
    designs = sorted((each for each in candidates if each.robot is not None), key=lambda each: _minimised(task, each))
    if not designs:
        why = f"no design was found with any of {len(choices)} choices from stock: {candidates[0].status}"
        raise TimeLimitError(f"{why}; the time limit was {time_limit:g} s") if out_of_time else SolveError(why)
    without_design = sorted(
        (candidate for candidate in candidates if candidate.robot is None),
        key=lambda candidate: candidate.status in ("pruned", "out of time"),
    )
    return StockChoice((*designs, *without_design))


def stock_choices(task: DesignTask, stock: Sequence[StockTube], clearance: float) -> list[tuple[StockTube, ...]]:
    """Choices of sizes for the tubes of a task: nesting ones, inner to outer, or those of a bundle, one per tube."""
    if any(dimension.field in ("outer_diameter", "inner_diameter") for dimension in task.free):
        raise InputError("diameters are free, and the tubes come from stock; use one of both")
    if len(task.objectives) > 1:
        raise InputError("a choice from stock needs one objective; the task has several")
    typical_length("clearance", clearance, TYPICAL_TUBE_CLEARANCE, zero=True)
    if isinstance(task.robot, BundleRobot):
        choices = list(_side_by_side(task, task.robot, stock, clearance))
        if not choices:
            raise InputError("no tubes in stock fit at the offsets of the robot; move its tubes apart")
        return choices
    choices = list(combinations(stock, task.robot.n_tubes, clearance))
    if not choices:
        raise InputError(f"no {task.robot.n_tubes} tubes in stock nest with a clearance of {clearance * 1e3:g} mm")
    return choices


def _side_by_side(
    task: DesignTask, robot: BundleRobot, stock: Sequence[StockTube], clearance: float
) -> Iterator[tuple[StockTube, ...]]:
    """Choices of sizes for the tubes of a bundle at their offsets; tubes of equal section stay equal."""
    sections = [(tube.outer_diameter, tube.inner_diameter) for tube in robot.tubes]
    kinds = list(dict.fromkeys(sections))
    for chosen in itertools.product(stock, repeat=len(kinds)):
        sizes = tuple(chosen[kinds.index(section)] for section in sections)
        gaps = [sizes[outer].inner_diameter - sizes[inner].outer_diameter for inner, outer in robot.nested_pairs]
        if min(gaps, default=np.inf) < clearance - 1e-12:
            continue
        try:
            with_sizes(task, sizes)
        except InputError:  # tubes overlap, or are wider than their sheath
            continue
        yield sizes


def combinations(stock: Sequence[StockTube], n: int, clearance: float) -> Iterator[tuple[StockTube, ...]]:
    """Choices of n sizes, inner to outer, each with `clearance` inside the next."""
    sizes = sorted(stock, key=lambda size: size.outer_diameter)
    for chosen in itertools.combinations(sizes, n):
        if all(b.inner_diameter - a.outer_diameter >= clearance - 1e-12 for a, b in itertools.pairwise(chosen)):
            yield chosen


def with_sizes(task: DesignTask, sizes: Sequence[StockTube]) -> DesignTask:
    """The task with tubes of these sizes."""
    tubes = tuple(
        of_section(
            tube,
            outer_diameter=size.outer_diameter,
            inner_diameter=size.inner_diameter,
            material=size.material,
            curvature=np.sign(tube.curvature) * min(abs(tube.curvature), 1.0 / size.outer_diameter),
        )
        for tube, size in zip(task.robot.tubes, sizes, strict=True)
    )
    return replace(task, robot=replace(task.robot, tubes=tubes))


def _bound(task: DesignTask) -> float:
    """The best objective, as minimised, under the requirements on dimensions alone."""
    key = key_of(task.objectives[0])
    if key not in BOUNDED or (isinstance(task.robot, BundleRobot) and key in OF_POSES):
        return -np.inf
    cheap = tuple(
        replace(r, in_poses=False) if isinstance(r, Strain) else r
        for r in task.requirements
        if isinstance(r, (*CHEAP, Strain))
    )
    ranking = multistart(compile_task(replace(task, requirements=cheap)), starts=1)
    return ranking.designs[0].objective if ranking.designs else np.inf


def _minimised(task: DesignTask, candidate: Candidate) -> float:
    assert candidate.objective is not None
    return task.objectives[0].sign * task.objectives[0].weight * candidate.objective


def _design(item: tuple[DesignTask, tuple[StockTube, ...], float], starts: int) -> Candidate:
    """The design of one candidate."""
    task, sizes, bound = item
    program = compile_task(task)
    ranking = multistart(program, starts=starts)
    if not ranking.designs:
        shown = shown_infeasible(program)
        status = f"infeasible: {shown}" if shown else f"not found: {next(iter(ranking.failures))}"
        return Candidate(sizes, bound, None, None, "out of time" if ranking.out_of_time and not shown else status)
    try:
        design, _ = add_worst_cases(ranking.designs[0])
    except SolveError as error:
        return Candidate(sizes, bound, None, None, f"not found: {error}")
    if design.out_of_time:
        return Candidate(sizes, bound, None, None, "out of time")
    return Candidate(sizes, bound, design.value(task.objectives[0]), design.robot, "design")
