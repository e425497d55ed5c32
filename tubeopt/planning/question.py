"""From what a caller gives to a checked question, before any work is done."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ..bodies.obstacles import Obstacle, checked_obstacles
from ..errors import InputError, SolveError, finite, instance
from ..inverse.chart import Chart
from ..inverse.clock import Clock, LateError
from ..inverse.joints import JointSpace, joint_space
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..stability.deflection import under_any_force
from ..typing import Array
from .effort import PlanTask
from .loaded_chart import LoadedChart
from .loaded_sections import uncovered
from .motion import DEFAULT_RATES, RateLimits
from .options import DEFAULT_PLAN, PlanOptions
from .path_program import path_cost


@dataclass(frozen=True, eq=False)
class Question:
    """What must hold, how fast the actuators are, and how a plan is made."""

    task: PlanTask
    rates: RateLimits
    options: PlanOptions

    @property
    def clock(self) -> Clock:
        """Of the time limit, which runs from when it was asked."""
        return self.task.clock

    @contextmanager
    def in_time(self) -> Iterator[None]:
        """Raise SolveError where the clock is over in the middle of something."""
        try:
            yield
        except LateError:
            limit = f"{self.clock.limit:g} s"
            raise SolveError(f"no plan was found within {limit}, which ran out before a way was found") from None


def asked(
    robot: Robot,
    obstacles: Sequence[Obstacle],
    min_margin: float = 0.05,
    rate_limits: RateLimits = DEFAULT_RATES,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
    load: Load | None = None,
) -> Question:
    """The question, its clock running from here.

    Raises:
        InputError: arguments of another kind, or with numbers that make no sense.
    """
    instance("options", options, PlanOptions)
    clock = Clock(options.time_limit)
    check_robot(robot)
    instance("limits", limits, JointLimits, optional=True)
    instance("rate_limits", rate_limits, RateLimits)
    bodies = checked_obstacles(obstacles)
    if options.extra_cost is not None:
        path_cost(options.extra_cost, robot.n_tubes)
    floor = finite("min_margin", min_margin)
    if not 0 <= floor < 1:
        raise InputError(f"min_margin is {floor:g}; it must be at least 0 and less than 1")
    space = joint_space(robot, limits, options.carriage_gap, options.section_length)
    rate_limits.of(space)
    chart = Chart(space) if load is None else _loaded(space, load, options)
    task = PlanTask(
        chart, bodies, floor, options.clearance, max_force=options.max_force, effort=options.effort, clock=clock
    )
    return Question(task, rate_limits, options)


def _loaded(space: JointSpace, load: Load, options: PlanOptions) -> LoadedChart:
    """The chart of a robot that bears a load; raises InputError where no plan could be proved."""
    instance("load", load, Load)
    what = uncovered(load)
    if what:
        raise InputError(f"load has {what}, under which no motion can be proved")
    for name in ("max_force", "roadmap", "extra_cost"):
        if getattr(options, name):
            raise InputError(f"{name} is given beside a load; a plan under a load has none")
    return LoadedChart(space, load)


def bearing(question: Question, *translations: Array) -> Question:
    """The question with room for what a force on the tip moves the arm by at translations (n,) each, and between them.

    Raises:
        SolveError: at one of them it is not shown that every such force leaves the margin.
    """
    task = question.task
    if not task.max_force:
        return question
    robot, alone = task.chart.space.robot, []
    for each in translations:
        bound = under_any_force(robot, each, task.max_force)
        if bound.margin <= 0 or bound.margin < task.min_margin:
            where = ", ".join(f"{x * 1e3:.4g}" for x in each)
            raise SolveError(
                f"no plan can be proved: with translations of {where} mm the margin is only shown to be at least "
                f"{bound.margin:.3g} under any force of up to {task.max_force * 1e3:g} mN on the tip; "
                f"it must be {max(task.min_margin, 0.0):g}"
            )
        alone.append(bound.deflection)
    between = under_any_force(robot, np.array(translations), task.max_force).deflection
    reserve = task.effort.force_room * (between if np.isfinite(between) else max(alone))
    task = replace(task, clearance=task.clearance - task.reserve + reserve, reserve=reserve)
    return replace(question, task=task)
