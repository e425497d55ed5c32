"""An equilibrium solved anew where a program, whose pieces are its own, says that there is one."""

from __future__ import annotations

from collections.abc import Callable

from ..block.transcription.reduced import to_unknowns
from ..block.transcription.second_variation import margin
from ..errors import SolveError
from ..robots.robot import Robot
from ..solvers.newton import newton
from ..typing import Array
from .kinematics import forward_kinematics
from .result import Equilibrium
from .solving import DEFAULT_DISCRETISATION, Solution, reduced_problem, to_equilibrium


def equilibrium_at(
    robot: Robot, rotations: Array, translations: Array, rotation_at: Callable[[Array], Array] | None
) -> Equilibrium:
    """What `Equilibrium.at` tells."""
    if rotation_at is None:
        return forward_kinematics(robot, rotations, translations)
    shift = tuple(translations.tolist())
    problem = reduced_problem(robot, shift, DEFAULT_DISCRETISATION)
    theta = rotation_at(problem.arc_length).T.reshape(-1, robot.n_tubes)
    result = newton(problem, rotations, to_unknowns(problem, rotations, theta))
    if not result.converged:
        raise SolveError("Newton's method does not stay at the equilibrium of the program: it is a fold (margin 0)")
    solution = Solution(problem, rotations, result, margin(problem, result.state))
    near = to_equilibrium(robot, solution, shift, ("newton", "a program", 0.0))
    return forward_kinematics(robot, rotations, translations, guess=near)
