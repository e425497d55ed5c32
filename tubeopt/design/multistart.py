"""Solving a design program from many starts, and what became of each: designs in order, failures by what failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..errors import InputError, undoubted
from ..solvers.parallel import executor, run_all
from ..solvers.sampling import sobol
from ..solvers.time_limit import LateError
from ..typing import Array, Progress
from .evaluation import Attempt, Report
from .program import Program
from .solve import solve, with_joints

# Random dimensions per start; only those whose tubes nest and fit become starts, which random diameters rarely do.
DESIGNS_PER_START = 32

# Steps of their scale. Far above the tolerance to which starts reach one optimum, far below what can be made.
SAME_DESIGN = 1e-3

# Where no design was looked at.
NOTHING = "a first design, which time did not suffice for"


@dataclass(frozen=True, eq=False)
class Ranking:
    """What became of all starts."""

    designs: tuple[Attempt, ...]
    """Feasible ones, the best first, each once."""
    found: tuple[int, ...]
    """From how many starts each was reached."""
    failures: dict[str, int]
    """How many starts ended infeasible, by the limit violated most."""
    failed: tuple[Attempt, ...]
    """Where, the least violated first."""

    late: int = 0
    """How many starts a time limit ended."""

    @property
    def starts(self) -> int:
        """Number of starts."""
        return sum(self.found) + sum(self.failures.values())


def solve_from(program: Program, start: Array, report: Report | None = None, *, keep: bool = False) -> Attempt:
    """`solve` on a copy of the program that remembers no poses of other starts, unless it is to `keep` them; the best
    on its way where a time limit ends it."""
    own = program if keep else replace(program, guesses={})
    try:
        return solve(own, start, report)
    except LateError:
        return cut_short(own)


def cut_short(program: Program) -> Attempt:
    """The best design that a search had passed when its time was over."""
    best = program.lately.best
    if best is None:
        return Attempt(program, program.lower, np.inf, np.inf, NOTHING, None, late=True)
    x = np.clip(best.x, program.lower, program.upper)
    return Attempt(program, x, best.objective, best.violation, best.worst, None, late=True)


def rank(attempts: Sequence[Attempt]) -> Ranking:
    """Feasible designs in order, duplicates merged; the others counted."""
    designs: list[Attempt] = []
    found: list[int] = []
    for one in sorted((a for a in attempts if a.feasible), key=lambda a: a.objective):
        k = next((k for k, other in enumerate(designs) if _same(one, other)), None)
        if k is None:
            designs.append(one)
            found.append(1)
        else:
            found[k] += 1
    failed = sorted((a for a in attempts if not a.feasible), key=lambda a: a.violation)
    failures = Counter(a.worst for a in failed)
    late = sum(a.late for a in attempts)
    return Ranking(tuple(designs), tuple(found), dict(failures.most_common()), tuple(failed), late)


def _same(a: Attempt, b: Attempt) -> bool:
    count = a.program.layout.designs
    gap = np.abs(a.x[:count] - b.x[:count]) / a.program.scale[:count]
    return bool(gap.max() < SAME_DESIGN)


def multistart(
    program: Program,
    *,
    starts: int = 1,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Ranking:
    """Solve from the task's own dimensions and from `starts` - 1 others, on so many processes; with one only, `report`
    is told of every iteration. `seed` is of the other dimensions and of the first joint values."""
    begin, workers = start_values(program, seed, starts), min(workers, starts)
    one = partial(solve_from, program, report=report if workers == 1 else None)
    with executor(workers) as pool:
        return rank(run_all(one, begin, pool, progress))


def start_values(program: Program, seed: int, count: int) -> list[Array]:
    """`count` starts x (X,), SI: the first at the task's own dimensions, the others from a scrambled Sobol sequence."""
    layout = program.layout
    space = layout.space
    if count == 1:
        return [with_joints(program, space.start, np.random.default_rng([seed, 0]))]
    unit = sobol(layout.designs, DESIGNS_PER_START * count, seed)
    drawn = [space.lower + row * (space.upper - space.lower) for row in unit]
    # Dimensions of tubes that make a robot come first.
    designs = [space.start, *sorted(drawn, key=lambda design: not _makes_robot(program, design))]
    return [with_joints(program, design, np.random.default_rng([seed, k])) for k, design in enumerate(designs[:count])]


@undoubted()
def _makes_robot(program: Program, design: Array) -> bool:
    try:
        replace(program.task.robot, tubes=program.layout.space.tubes(design), joint_limits=None)
    except InputError:
        return False
    return True
