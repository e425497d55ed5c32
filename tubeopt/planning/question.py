"""From what a caller gives to a checked question, before any work is done."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from ..bodies.obstacles import Obstacle
from ..errors import InputError, SolveError, finite
from ..inverse.arguments import check_robot, checked_obstacles, kind_of
from ..inverse.chart import Chart
from ..inverse.clock import Clock, LateError
from ..inverse.question import prepared
from ..inverse.task import Task
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from .motion import RateLimits
from .options import PlanOptions
from .smooth import path_cost


@contextmanager
def in_time(clock: Clock) -> Iterator[None]:
    """Raise SolveError where the clock is over in the middle of something."""
    try:
        yield
    except LateError:
        raise SolveError(f"no plan was found within {clock.limit:g} s, which ran out before a way was found") from None


def asked(
    robot: Robot,
    obstacles: Sequence[Obstacle],
    min_margin: float,
    rate_limits: RateLimits,
    limits: JointLimits | None,
    options: PlanOptions,
) -> tuple[Task, Clock]:
    """What must hold, and the clock of the time limit, which runs from here.

    Raises:
        InputError: arguments of another kind, or with numbers that make no sense.
    """
    kind_of("options", options, PlanOptions)
    clock = Clock(options.time_limit)
    check_robot(robot)
    kind_of("limits", limits, JointLimits, optional=True)
    kind_of("rate_limits", rate_limits, RateLimits)
    bodies = checked_obstacles(obstacles)
    if options.extra_cost is not None:
        path_cost(options.extra_cost, robot.n_tubes)
    floor = finite("min_margin", min_margin)
    if not 0 <= floor < 1:
        raise InputError(f"min_margin is {floor:g}; it must be at least 0 and less than 1")
    space = prepared(robot, limits, options.carriage_gap, options.section_length)
    rate_limits.of(space)
    return Task(Chart(space), bodies, floor, options.clearance, clock=clock), clock
