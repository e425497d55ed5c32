"""Derivatives of an equilibrium under load by its joint values, by the implicit function theorem.

The change dx of the unknowns solves H dx = -dg, H the exact second variation and dg the change of the equations by a
joint at fixed unknowns. What follows from the unknowns is differentiated along (joint, x) together. Both are central
differences of functions that have no error of their own to magnify, since nothing is solved for in them.

Where a translation changes the order of the breakpoints the unknowns change in number. There the derivative to one side
is that of the parabola through three equilibria.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.loaded import LoadedProblem, evaluate, tip_frame, tip_position
from ..block.transcription.loaded_arm import loaded_arm
from ..errors import InputError, SolveError
from ..typing import Array
from .load_problem import loaded_problem
from .loaded import loaded_kinematics, loaded_point
from .result import Equilibrium
from .solving import discretisation_of

TURN, SHIFT = 1e-5, 1e-5
"""Steps of the differences: rad, and as a share of the arm's length."""

ONE_SIDED = 1e-4
"""Step to one side, as a share of the arm's length."""

APART = 1e-7
"""Eigenvalues closer than this have no derivative."""


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Tip position (3,), frame (3, 3), tip rotations (n,), second variation or margin, and energy."""

    position: Array
    frame: Array
    tips: Array
    stiffness: Array
    energy: float


def loaded_columns(equilibrium: Equilibrium, wrt: Sequence[str], side: int) -> tuple[Array, Array, Array, Array, Array]:
    """Derivatives as `Jacobian` has them: tip position (3, Q), turn (3, Q), tip rotations (n, Q), margin (Q,), energy
    (Q,); the margin is NaN for loads without one.

    Raises:
        InputError: a name other than "rotations" or "translations"; a side that is not 1 or -1.
        SolveError: a fold, where derivatives are infinite.
    """
    for name in wrt:
        if name not in ("rotations", "translations"):
            raise InputError(f"wrt has {name!r}; under load it must be of 'rotations' and 'translations'")
    if side not in (1, -1):
        raise InputError(f"side is {side!r}; it must be 1 or -1")
    point = loaded_point(equilibrium)
    problem, state = point.member.problem, point.state
    if abs(point.margin) < APART:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
    soft = _softest(state.hessian) if problem.load.has_energy else None
    columns = []
    for name in wrt:
        for i in range(len(equilibrium.rotations)):
            sides = _sides(equilibrium, name, i)
            if any(there.size != problem.size for there, _ in sides):
                columns.append(_to_one_side(equilibrium, i, side))
                continue
            step = TURN if name == "rotations" else SHIFT * problem.torsion.assembly.total_length
            slopes = [evaluate(there, alpha, state.x).gradient for there, alpha in sides]
            change = np.linalg.solve(state.hessian, (slopes[1] - slopes[0]) / (2 * step))
            ahead, back = (
                _outcome(there, alpha, state.x + sign * step * change)
                for (there, alpha), sign in zip(sides, (1, -1), strict=True)
            )
            columns.append(_difference(ahead, back, 2 * step, equilibrium.tip_rotation, soft))
    return tuple(np.stack(part, axis=-1) for part in zip(*columns, strict=True))  # type: ignore[return-value]


def _sides(e: Equilibrium, name: str, tube: int) -> list[tuple[LoadedProblem, Array]]:
    """Problems and rotations with a joint a step further, and a step back."""
    assert e.load is not None
    d, out = discretisation_of(e), []
    for sign in (1, -1):
        alpha, shift = e.rotations.copy(), e.translations.copy()
        if name == "rotations":
            alpha[tube] += sign * TURN
        else:
            shift[tube] += sign * SHIFT * e.arc_length[-1]
        out.append((loaded_problem(e.robot, tuple(shift.tolist()), e.load, d), alpha))
    return out


def _softest(hessian: Array) -> Array | None:
    """The softest direction; None where it is double, or the margin is 1."""
    values, vectors = scipy.linalg.eigh(hessian, subset_by_index=(0, 1))
    return None if values[1] - values[0] < APART or values[0] > 1 - APART else vectors[:, 0]


def _outcome(problem: LoadedProblem, rotations: Array, x: Array) -> _Outcome:
    state = evaluate(problem, rotations, x)
    arm = loaded_arm(problem, rotations, state)
    ends = np.searchsorted(arm.arc_length, np.maximum(problem.torsion.assembly.end, 0.0) - 1e-12)
    tips = arm.rotation[np.arange(len(rotations)), ends]
    return _Outcome(tip_position(problem, state), tip_frame(state.orientation), tips, state.hessian, state.energy)


def _difference(
    ahead: _Outcome, back: _Outcome, step: float, frame: Array, soft: Array | None
) -> tuple[Array, Array, Array, float, float]:
    turn = (ahead.frame - back.frame) @ frame.T / step
    margin = float("nan") if soft is None else float(soft @ (ahead.stiffness - back.stiffness) @ soft) / step
    return (
        (ahead.position - back.position) / step,
        _axis(turn),
        (ahead.tips - back.tips) / step,
        margin,
        (ahead.energy - back.energy) / step,
    )


def _axis(turn: Array) -> Array:
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2


def _to_one_side(e: Equilibrium, tube: int, side: int) -> tuple[Array, Array, Array, float, float]:
    """Derivative by a translation towards the tip (1) or the plate (-1)."""
    assert e.load is not None
    step = side * ONE_SIDED * float(e.arc_length[-1])
    places = [e]
    for k in (1, 2):
        shift = e.translations.copy()
        shift[tube] += k * step
        joints = e.rotations, tuple(shift.tolist())
        places.append(loaded_kinematics(e.robot, places[-1], joints, e.load, 1e-8, 0.0))

    def slope(values: list[Array]) -> Array:
        return np.asarray((4 * values[1] - 3 * values[0] - values[2]) / (2 * step))

    return (
        slope([p.tip_position for p in places]),
        _axis(slope([p.tip_rotation for p in places]) @ e.tip_rotation.T),
        slope([p.tip_rotations for p in places]),
        float(slope([np.array(p.margin) for p in places])),
        float(slope([np.array(p.energy) for p in places])),
    )
