"""From the solution of a program back to a plain, verified equilibrium."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..equilibrium import Equilibrium
from ..errors import SolveError
from ..kinematics import forward_kinematics
from ..robots.breakpoints import DIMENSIONS, dimensions_of
from ..robots.concentric import ConcentricRobot
from ..robots.robot import Robot
from ..solution import DEFAULT_DISCRETISATION, Solution, reduced_problem, to_equilibrium
from ..solvers.newton import newton
from ..transcription.reduced import margin, to_unknowns
from ..verification import verify_equilibrium

if TYPE_CHECKING:
    from .equilibrium_block import EquilibriumBlock

AGREEMENT = 1e-6
"""Largest difference of the tip between block and equilibrium, over the length of the arm."""


def confirmed(block: EquilibriumBlock, value: Callable[[Any], Any]) -> Equilibrium:
    """The verified equilibrium of a block at the numbers that `value` gives to its expressions."""
    numbers = {name: np.array(value(part)).ravel() for name, part in block.dimensions.items()}
    robot = _robot(block.robot, numbers)
    rotations, translations = (np.array(value(part)).ravel() for part in (block.rotations, block.translations))
    translations = np.minimum(translations, numbers["straight_length"])
    problem = reduced_problem(robot, tuple(translations.tolist()), DEFAULT_DISCRETISATION)
    theta = block.rotation_at(problem.arc_length, value)
    result = newton(problem, rotations, to_unknowns(problem, rotations, theta))
    if not result.converged:
        raise SolveError("Newton's method does not stay at the equilibrium of the program: it is a fold (margin 0)")
    solution = Solution(problem, rotations, result, margin(problem, result.state))
    near = to_equilibrium(robot, solution, tuple(translations.tolist()), ("newton", "a program", 0.0))
    found = verify_equilibrium(forward_kinematics(robot, rotations, translations, guess=near))
    tip = np.array(value(block.tip_position)).ravel()
    apart = float(np.linalg.norm(tip - found.tip_position))
    if apart > AGREEMENT * float(found.arc_length[-1]):
        raise SolveError(
            f"the tip of the program is {1e3 * apart:.2g} mm from that of the equilibrium at its joint values: the "
            "pieces of the block are too long (raise its refinement), or the program was not solved",
            found,
        )
    return found


def _robot(robot: Robot, numbers: dict[str, Any]) -> Robot:
    """The robot with other dimensions of its tubes."""
    given = dimensions_of(robot.tubes)
    if all(np.array_equal(numbers[name], given[name]) for name in DIMENSIONS):
        return robot
    tubes = []
    for i, tube in enumerate(robot.tubes):
        own = {name: float(numbers[name][i]) for name in DIMENSIONS}
        stiff = own.pop("bending_stiffness"), own.pop("torsional_stiffness")
        moduli = {}
        if stiff != (tube.bending_stiffness, tube.torsional_stiffness):
            moduli = {"youngs_modulus": stiff[0] / tube.second_moment, "shear_modulus": stiff[1] / tube.polar_moment}
        tubes.append(replace(tube, **own, material=replace(tube.material, **moduli) if moduli else tube.material))
    return _rebuilt(robot, tuple(tubes))


def _rebuilt(robot: Robot, tubes: tuple[Any, ...]) -> Robot:
    if isinstance(robot, ConcentricRobot):
        return replace(robot, tubes=tubes)
    raise SolveError("the tubes of an eccentric robot are equal: its dimensions cannot be unknowns one by one")
