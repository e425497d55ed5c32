"""An equilibrium solved anew where a program, whose pieces are its own, says that there is one."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..block.transcription.loaded import unknowns
from ..robots.load import Load
from ..robots.robot import Robot
from ..typing import Array
from .kinematics import forward_kinematics
from .load_continuation import LoadedPoint, Member
from .load_problem import check_load
from .loaded import to_tolerance
from .result import Equilibrium
from .solving import DEFAULT_DISCRETISATION, Solution, reduced_problem, to_equilibrium

Along = Callable[[Array], Array]

FOLD = "Newton's method does not stay at the equilibrium of the program: it is a fold (margin 0)"


def equilibrium_at(
    robot: Robot,
    rotations: Array,
    translations: Array,
    rotation_at: Along | None,
    *,
    load: Load | None = None,
    curvature_at: Along | None = None,
) -> Equilibrium:
    """What `Equilibrium.at` tells."""
    if rotation_at is None:
        return forward_kinematics(robot, rotations, translations, load=load)
    shift = tuple(translations.tolist())
    if load is not None and curvature_at is not None:
        return _under_load(robot, (rotations, shift), load, (rotation_at, curvature_at))
    problem = reduced_problem(robot, shift, DEFAULT_DISCRETISATION)
    theta = rotation_at(problem.arc_length).T.reshape(-1, robot.n_tubes)
    solution = Solution.near(problem, rotations, theta, FOLD)
    near = to_equilibrium(robot, solution, shift, ("newton", "a program", 0.0))
    return forward_kinematics(robot, rotations, translations, guess=near)


def _under_load(
    robot: Robot, joints: tuple[Array, tuple[float, ...]], load: Load, along: tuple[Along, Along]
) -> Equilibrium:
    """From rotations and curvatures along the arm, under a load."""
    check_load(robot, load, joints[1])
    began, member = time.perf_counter(), Member.of(robot, *joints, load)
    theta, curvature = (each(member.problem.torsion.arc_length).T for each in along)
    point = LoadedPoint.near(member, unknowns(member.problem, joints[0], theta, curvature), FOLD)
    return to_tolerance(point, 1e-8, ("a program", began))
