"""The trade between margin and everything else: the front along which one cannot gain but by giving up the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..errors import InputError, SolveError, finite
from ..robots.concentric import ConcentricRobot
from ..typing import Progress
from .objectives import key_of
from .optimize import settle
from .program import compile_task, recompiled
from .relaxation import best_of
from .requirements import SnapFree, SnapFreeInUse
from .solve import multistart, solve
from .solve_one import Attempt
from .task import DesignTask


@dataclass(frozen=True, eq=False)
class FrontPoint:
    """One design of the front: margin demanded, objective in its own sign (SI), and the robot."""

    margin: float
    objective: float
    robot: ConcentricRobot


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """Designs in order of the margin demanded, up to the greatest that is feasible."""

    task: DesignTask
    objective: str
    """The kind of what is traded for it."""
    points: tuple[FrontPoint, ...]
    ended: float | None
    """The first margin demanded that no design near the front keeps, None where all do."""


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


def pareto_front(
    task: DesignTask,
    margins: Sequence[float],
    *,
    begin: Attempt | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> ParetoFront:
    """The best objective at each of several margins, each solve warm-started from the one before.

    Args:
        margins: demanded of the certificate or in use; they are taken in order of size.
        begin: an answer for the least of them, or near it.

    Raises:
        InputError: no margins, one that no certificate or pose can have, a task without certificate or margin in use,
            or with several objectives.
        SolveError: not even the least margin is feasible.
    """
    one = task.objectives[0]
    points: list[FrontPoint] = []
    here = begin
    tasks = front_tasks(task, margins)
    for k, (margin, eased) in enumerate(tasks):
        if here is None:
            found = best_of(multistart(compile_task(eased), starts=4, seed=seed))
        else:
            found = solve(recompiled(eased, here.program), here.x)
        try:
            if not found.feasible:
                raise SolveError("infeasible")
            found, _ = settle(found)
        except SolveError:
            if not points:
                raise
            return ParetoFront(task, key_of(one), tuple(points), margin)
        points.append(FrontPoint(margin, found.value(one), found.robot))
        here = found
        if progress is not None:
            progress(k + 1, len(tasks))
    return ParetoFront(task, key_of(one), tuple(points), None)
