"""Derivatives of an equilibrium under load by joint values and dimensions, by the implicit function theorem.

The change dx of the unknowns solves H dx = -dg, H the exact second variation and dg the change of the equations by a
joint or dimension at fixed unknowns. What follows from the unknowns is differentiated along it and x together. Both are
central differences of functions that have no error of their own to magnify, since nothing is solved for in them.

Where a translation or a length changes the order of the breakpoints the unknowns change in number. There the derivative
to one side is that of the parabola through three equilibria.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy

from ..block.transcription.loaded import LoadedProblem, evaluate, tip_frame, tip_position
from ..block.transcription.loaded_arm import elastic_energy, loaded_arm, loaded_profile
from ..errors import InputError, SolveError
from ..robots.load import Load
from ..robots.robot import Robot, resized
from ..typing import Array
from .arm_change import check_wrt
from .load_problem import LOADED_DISCRETISATION, loaded_problem
from .loaded import loaded_kinematics, loaded_point
from .member import Loaded
from .result import Equilibrium, small_turn
from .solving import discretisation_of, told_by_arm

STEP = 1e-5
"""Of the differences: rad, and as a share of the arm's length, of one over it, or of a stiffness."""

APART = 1e-7
"""Eigenvalues closer than this have no derivative."""


def loaded_columns(equilibrium: Equilibrium, wrt: Sequence[str], side: int) -> tuple[Array, Array, Array, Array, Array]:
    """Derivatives as `Jacobian` has them: tip position (3, Q), turn (3, Q), tip rotations (n, Q), margin (Q,), energy
    (Q,); the margin is NaN for loads without one."""
    check_wrt(wrt, side)
    point = loaded_point(equilibrium)
    problem, state = point.member.problem, point.state
    if abs(point.margin) < APART:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
    soft = _softest(state.hessian) if problem.load.has_energy else None
    columns = []
    for name in wrt:
        for i in range(len(equilibrium.rotations)):
            both = sides(equilibrium, name, i)
            if len(both) < 2 or any(there.size != problem.size for there, _ in both):
                columns.append(_to_one_side(equilibrium, name, i, side))
                continue
            step = step_of(equilibrium, name, i)
            slopes = [evaluate(there, alpha, state.x).gradient for there, alpha in both]
            change = np.linalg.solve(state.hessian, (slopes[1] - slopes[0]) / (2 * step))
            ahead, back = (
                _outcome(there, alpha, state.x + sign * step * change)
                for (there, alpha), sign in zip(both, (1, -1), strict=True)
            )
            position, frame, tips, stiffness, energy = (
                (one - other) / (2 * step) for one, other in zip(ahead, back, strict=True)
            )
            margin = float("nan") if soft is None else float(soft @ stiffness @ soft)
            columns.append((position, small_turn(frame @ equilibrium.tip_rotation.T), tips, margin, float(energy)))
    return tuple(np.stack(part, axis=-1) for part in zip(*columns, strict=True))  # type: ignore[return-value]


def _unit(e: Equilibrium, name: str, tube: int) -> float:
    """By what a step is measured: it turns the tip by about as much, in rad."""
    length = float(e.arc_length[-1])
    match name:
        case "rotations":
            return 1.0
        case "curvature":
            return 1 / length
        case "translations" | "straight_length" | "curved_length":
            return length
        case _:
            return float(getattr(e.robot.tubes[tube], name))


def _moved(e: Equilibrium, name: str, tube: int, step: float) -> tuple[Robot, Array, tuple[float, ...]]:
    """Robot, rotations and translations with one joint or dimension a step further; raises InputError where there is
    no such robot."""
    joints = {"rotations": e.rotations.copy(), "translations": e.translations.copy()}
    robot: Any = e.robot
    if name in joints:
        joints[name][tube] += step
    else:
        robot = resized(robot, tube, name, getattr(robot.tubes[tube], name) + step)
    return robot, joints["rotations"], tuple(joints["translations"].tolist())


def sides(
    e: Equilibrium, name: str, tube: int, load_at: Callable[[float], Load] | None = None
) -> list[tuple[LoadedProblem, Array]]:
    """Problems and rotations a step further, and a step back, without those of which there is no robot, under the load
    of an equilibrium, or one by the step."""
    out, d = [], LOADED_DISCRETISATION if e.load is None else discretisation_of(e)
    for step in (step_of(e, name, tube), -step_of(e, name, tube)):
        load = e.load if load_at is None else load_at(step)
        assert load is not None
        try:
            robot, alpha, shift = _moved(e, name, tube, step)
            out.append((loaded_problem(robot, shift, load, d), alpha))
        except InputError:
            continue
    return out


def step_of(e: Equilibrium, name: str, tube: int) -> float:
    """The step of a difference by a joint value or dimension, in its unit."""
    return STEP * _unit(e, name, tube)


def _softest(hessian: Array) -> Array | None:
    """The softest direction; None where it is double, or the margin is 1."""
    values, vectors = scipy.linalg.eigh(hessian, subset_by_index=(0, 1))
    return None if values[1] - values[0] < APART or values[0] > 1 - APART else vectors[:, 0]


def _outcome(problem: LoadedProblem, rotations: Array, x: Array) -> tuple[Array, ...]:
    """Tip position (3,), frame (3, 3), tip rotations (n,), second variation, and energy."""
    state = evaluate(problem, rotations, x)
    profile = loaded_profile(problem, rotations, state)
    arm = loaded_arm(problem, profile, state)
    tips = told_by_arm(arm, problem.torsion.assembly)["tip_rotations"]
    energy = np.array(elastic_energy(problem, profile, state))
    return tip_position(problem, state), tip_frame(state.orientation), tips, state.hessian, energy


def _to_one_side(e: Equilibrium, name: str, tube: int, side: int) -> tuple[Array, Array, Array, float, float]:
    """Derivative by what moves breakpoints towards the tip (1) or the plate (-1)."""
    assert e.load is not None
    step = side * (10 * STEP) * _unit(e, name, tube)
    places = [e]
    for k in (1, 2):
        robot, alpha, shift = _moved(e, name, tube, k * step)
        places.append(loaded_kinematics(places[-1], Loaded.of(robot, alpha, shift, e.load), 1e-8, 0.0))

    def slope(values: list[Array]) -> Array:
        return np.asarray((4 * values[1] - 3 * values[0] - values[2]) / (2 * step))

    return (
        slope([p.tip_position for p in places]),
        small_turn(slope([p.tip_rotation for p in places]) @ e.tip_rotation.T),
        slope([p.tip_rotations for p in places]),
        float(slope([np.array(p.margin) for p in places])),
        float(slope([np.array(p.energy) for p in places])),
    )
