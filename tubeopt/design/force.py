"""Designs that no force on the tip can snap: the certificate under bounded force as a requirement.

It is at most the certificate without force, and falls with it. So the floor of that one is raised until the design that
is best above it keeps the other, which is computed anew for every such design (see `stability.loaded_certificate`). The
answer is the best among designs of that certificate without force; another with a smaller one may bear the force too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..errors import SolveError
from ..robots.concentric import ConcentricRobot
from ..stability import snap_free_certificate
from .exchange import certified_at
from .program import Program
from .requirements import SnapFree, of_kind
from .settings import DesignSolver
from .task import DesignTask
from .verify import Check


def forced(task: DesignTask) -> SnapFree | None:
    """The requirement that names a force; None without one."""
    return next((one for one in of_kind(task.requirements, SnapFree) if one.max_force), None)


def without_force(task: DesignTask, one: SnapFree, floor: float) -> DesignTask:
    """The task with a floor of the certificate without force in place of the requirement."""
    plain = replace(one, margin=floor, max_force=0.0)
    return replace(task, requirements=tuple(plain if each is one else each for each in task.requirements))


def under_force(program: Program, robot: ConcentricRobot, one: SnapFree) -> tuple[float, Check]:
    """The certificate of a design under the force that a requirement names, at all translations for which it was asked,
    and the check that says so."""
    rows = certified_at(program, robot)
    value = min(snap_free_certificate(robot, np.array(row), max_force=one.max_force) for row in rows)
    words = f"certificate under forces on the tip of up to {one.max_force * 1e3:g} mN"
    return value, Check(words, f"{value:.5f}", value >= one.margin)


def raised(one: SnapFree, bears: Callable[[float], float], solver: DesignSolver) -> float:
    """The least floor, within `force_accuracy`, whose design bears the force; `bears` tells the certificate under it."""
    low, high = one.margin, None
    floor = one.margin
    for _ in range(solver.force_rounds):
        short = one.margin - bears(floor)
        if short <= 0:
            high = floor
            if high - low <= solver.force_accuracy:
                return high
            # What is in hand, but not all of it: the two certificates do not fall alike.
            floor = max((low + high) / 2, high + 0.9 * short)
            continue
        low = floor
        floor = min(floor + 1.1 * short + solver.force_accuracy / 2, (low + (1.0 if high is None else high)) / 2)
    if high is None:
        raise SolveError(f"no design was found that bears {one.max_force * 1e3:g} mN: the floor reached {low:.4f}")
    return high
