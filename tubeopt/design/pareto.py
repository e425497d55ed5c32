"""The trade between margin and everything else: the front along which one cannot gain but by giving up the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..arguments import renamed, typed
from ..errors import InputError, SolveError, finite
from ..robots.concentric import ConcentricRobot
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Progress
from .attempt import Attempt
from .multistart import multistart, solve_from
from .objectives import key_of
from .optimize import add_worst_cases
from .program import compile_task, recompiled
from .relaxation import best_of
from .requirements import SnapFree, SnapFreeInUse
from .task import DesignTask


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """One design of the front: margin demanded, objective in its own sign (SI), and the robot."""

    margin: float
    objective: float
    robot: ConcentricRobot


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """Designs in order of the margin demanded, up to the greatest for which one was found."""

    task: DesignTask
    objective: str
    """The kind of what is traded for it."""
    points: tuple[FrontPoint, ...]
    ended: float | None
    """The first margin demanded for which no design was found near the front, None where one was for all."""
    out_of_time: bool = False
    """Whether the time limit ended the front there."""


def front_tasks(task: DesignTask, margins: Sequence[float]) -> list[tuple[float, DesignTask]]:
    """Margins in order of size, each with the task in which it is demanded."""
    if not len(margins):
        raise InputError("margins is empty; a front needs at least one")
    if len(task.objectives) > 1 or key_of(task.objectives[0]) == "margin":
        raise InputError("a front needs one objective, and that other than the margin itself")
    margined = SnapFree | SnapFreeInUse
    if not any(isinstance(one, margined) for one in task.requirements):
        raise InputError("a front needs a certificate or a margin in use among the requirements")
    out = []
    for margin in sorted(finite("a margin of the front", m) for m in margins):
        asked = [replace(one, margin=margin) if isinstance(one, margined) else one for one in task.requirements]
        out.append((margin, replace(task, requirements=tuple(asked))))
    return out


@renamed(begin="start")
@typed
@limited
def pareto_front(
    task: DesignTask,
    margins: Sequence[float],
    *,
    start: Attempt | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> ParetoFront:
    """The best objective at each of several margins, each solve warm-started from the one before.

    Args:
        margins: demanded of the certificate or in use; they are taken in order of size.
        start: an answer for the least of them, or near it.
        time_limit: s, on the clock, at which the front ends.

    Raises:
        InputError: no margins, one that no certificate or pose can have, a task without certificate or margin in use,
            or with several objectives.
        SolveError: no design was found for the least margin.
    """
    one = task.objectives[0]
    points: list[FrontPoint] = []
    here = start
    tasks = front_tasks(task, margins)
    for k, (margin, eased) in enumerate(tasks):
        if here is None:
            found = best_of(multistart(compile_task(eased), starts=4, seed=seed))
        else:
            found = solve_from(recompiled(eased, here.program), here.x, keep=True)
        try:
            if not found.feasible:
                raise SolveError(f"no design was found with a margin of at least {margin:g}")
            found, _ = add_worst_cases(found)
        except SolveError:
            if not points:
                raise
            return ParetoFront(task, key_of(one), tuple(points), margin, found.late)
        if found.late and points:
            return ParetoFront(task, key_of(one), tuple(points), margin, True)
        points.append(FrontPoint(margin, found.value(one), found.robot))
        here = found
        if progress is not None:
            progress(k + 1, len(tasks))
    return ParetoFront(task, key_of(one), tuple(points), None)
