"""The exact snap: the first fold on a straight path in joint space, as a nonlinear program."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..block.transcription.program import Structure, add_torsion, structure_of, torsion_guess, torsion_numbers
from ..block.transcription.reduced import to_unknowns
from ..equilibrium.continuation import JointPath, Point, follow_to
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import Solution, polish
from ..errors import InputError, vector
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.ipopt import EQUILIBRIUM, inside_points
from ..solvers.parallel.blas import small
from ..solvers.problem import Problem
from ..solvers.problem_solution import ProblemStatus
from ..typing import Array
from .following import Event, leave_branch, to_snap
from .loaded_following import loaded_legs
from .snap import Snap

Configuration = tuple[ArrayLike, ArrayLike | None]


@small
def find_snap(
    robot: Robot,
    start: Configuration,
    end: Configuration,
    *,
    equilibrium: Equilibrium | None = None,
    load: Load | None = None,
) -> Snap | None:
    """The first snap on the straight path from `start` to `end`, or None where the branch reaches the end.

    The branch is followed to where it ends; the fold is the largest fraction t of the path for which the equilibrium
    equations have a solution on it (maximised by IPOPT), polished on the augmented fold system.

    Args:
        start, end: (rotations, translations), each (n,), rad and m; translations may be None for home.
        equilibrium: stable equilibrium at `start` on the branch to follow; by default that of `forward_kinematics`.
        load: forces that keep their direction and stay on the robot. The fold is then that of a bordered system.

    Raises:
        InputError: joint values of the wrong number, or not finite; an equilibrium that is unstable or not at `start`.
        SolveError: no stable equilibrium at `start`, or none where the robot lands.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> home = [0, 0, 0]
        >>> snap = tubeopt.find_snap(robot, (home, home), (np.radians([360, 0, 0]), home))
        >>> round(float(np.degrees(snap.rotations[0])), 3)
        214.222
    """
    path = JointPath(robot, _joint(robot, "start", start), _joint(robot, "end", end))
    if load is not None:
        legs = loaded_legs(robot, np.array([path.start, path.end]), load, equilibrium, first_only=True)
        return next((snap for _, snaps in legs for snap in snaps), None)
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, *path.at(0.0))
    if not first.stable:
        raise InputError(f"equilibrium has margin {first.margin:.3g}; it must be stable (margin above 0)")
    own = np.concatenate([first.rotations, first.translations])
    if np.abs(own - path.start).max() > 1e-9:
        raise InputError("equilibrium is at other joint values than start; they must be the same")
    here = Point(0.0, polish(first))
    for goal in path.events():
        while here.t < goal:
            points, reached = follow_to(path, here, goal)
            here = points[-1] if points else here
            if reached:
                break
            event = leave_branch(path, largest_fraction(path, here, goal), goal)
            if isinstance(event, Event):
                return to_snap(path, event, 0)
            here = event
    return None


def _joint(robot: Robot, name: str, value: Configuration) -> Array:
    try:
        rotations, translations = value
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be a pair (rotations, translations)") from None
    home = robot.home_translations if translations is None else translations
    alpha = vector(f"rotations of {name}", rotations, robot.n_tubes)
    shift = vector(f"translations of {name}", home, robot.n_tubes)
    robot.assembly(shift)
    return np.concatenate([alpha, shift])


NEXT_TO_FOLD = replace(EQUILIBRIUM, expand=False, hessian="limited-memory")
"""From a point so close to the fold a few steps lead there: second derivatives, and a program written out in scalars,
would take far longer to build than they save."""

MOVING = ("rotations", "transmission", "lengths")
"""What is linear in the fraction of the path, as long as breakpoints keep their order."""


@lru_cache(maxsize=32)
def _program(structure: Structure, thread: int) -> Problem:
    """max t subject to the equilibrium equations at joint values and lengths that are linear in t; each thread has its
    own numbers."""
    problem = Problem("snap")
    t = problem.variable("fraction of the path")
    sizes = {"rotations": structure.grid.n_tubes, **{name: shape[0] for name, shape in structure.shapes.items()}}
    rotations, *own = (
        problem.parameter(f"{name} at 0", np.zeros(sizes[name]))
        + t * problem.parameter(f"{name} per path", np.zeros(sizes[name]))
        for name in MOVING
    )
    add_torsion(problem, structure, rotations, dict(zip(MOVING[1:], own, strict=True)))
    problem.maximize(t)
    return problem


def largest_fraction(path: JointPath, here: Point, goal: float) -> Point:
    """The branch of `here` where t is largest, by IPOPT; `here` where it does not converge on this branch.

    Lengths are linear in t between events, so one structure of sections serves up to `goal`.
    """
    problem = here.solution.problem
    if problem.here is not None:
        # No program of tubes made of pieces: the point is next to the fold as it is.
        return here
    assembly, mesh = problem.assembly, problem.mesh
    ahead = path.robot.assembly(path.at(min(goal, here.t + 0.5 * (goal - here.t)))[1])
    if ahead.n_sections != assembly.n_sections or not goal > here.t:
        return here
    span = 0.5 * (goal - here.t)
    counts = np.bincount(mesh.section, minlength=assembly.n_sections)
    program = _program(structure_of(problem), threading.get_ident())
    rates = {
        "rotations": np.split(path.end - path.start, 2)[0],
        "transmission": (ahead.transmission - assembly.transmission) / span,
        "lengths": ((ahead.length - assembly.length) / counts / span)[mesh.section],
    }
    for name, value in {"rotations": here.solution.rotations, **torsion_numbers(problem)}.items():
        if name in rates:
            program.set_value(f"{name} at 0", value - here.t * rates[name])
            program.set_value(f"{name} per path", rates[name])
        else:
            program.set_value(name, value)
    for name, value in torsion_guess(problem, here.solution.arm).items():
        program.set_guess(name, value)
    program.set_guess("fraction of the path", here.t)
    program.set_bounds("fraction of the path", here.t, goal)
    found = program.attempt(NEXT_TO_FOLD)
    t = float(found.values["fraction of the path"][0])
    if found.status is not ProblemStatus.SOLVED or t - here.t > 1e-2:
        return here
    return _at_fold(path, here, t, inside_points(problem, found.values["rotation inside"]))


def _at_fold(path: JointPath, here: Point, t: float, theta: Array) -> Point:
    """The point of the program's solution, on the mesh of `here`, which may be a little off where lengths change."""
    problem = here.solution.problem
    rotations = path.at(t)[0]
    return Point(t, Solution.at(problem, rotations, to_unknowns(problem, rotations, theta)))
