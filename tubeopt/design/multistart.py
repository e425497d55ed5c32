"""Solves from many starts: ranked, duplicates merged, failures counted by what stood in their way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..solvers.parallel.executors import executor, run_all
from ..typing import Array, Progress
from .program import Program
from .solve import solve
from .solve_one import Attempt, Report
from .starts import start_values


@dataclass(frozen=True, eq=False)
class Ranking:
    """What became of all starts.

    designs: feasible ones, the best first, each once.  found: from how many starts each was reached.
    failures: how many starts ended infeasible, by the limit violated most.  failed: where, the least violated first.
    """

    designs: tuple[Attempt, ...]
    found: tuple[int, ...]
    failures: dict[str, int]
    failed: tuple[Attempt, ...]

    @property
    def starts(self) -> int:
        """Number of starts."""
        return sum(self.found) + sum(self.failures.values())


def solve_from(program: Program, start: Array, report: Report | None = None, method: str = "reduced") -> Attempt:
    """`solve` on a copy of the program that remembers no poses of other starts."""
    return solve(replace(program, guesses={}), start, report, method)


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
    return Ranking(tuple(designs), tuple(found), dict(failures.most_common()), tuple(failed))


def _same(a: Attempt, b: Attempt) -> bool:
    count = a.program.layout.designs
    gap = np.abs(a.x[:count] - b.x[:count]) / a.program.scale[:count]
    return bool(gap.max() < a.program.task.solver.same_design)


def multistart(
    program: Program,
    *,
    starts: int = 1,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
    report: Report | None = None,
    method: str = "reduced",
) -> Ranking:
    """Solve from the task's own dimensions and from `starts` - 1 others, on so many processes; with one only, `report`
    is told of every iteration. `seed` is of the other dimensions and of the first joint values."""
    begin, workers = start_values(program, seed, starts), min(workers, starts)
    one = partial(solve_from, program, report=report if workers == 1 else None, method=method)
    with executor(workers) as pool:
        return rank(run_all(one, begin, pool, progress))
