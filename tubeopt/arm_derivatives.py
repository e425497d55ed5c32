"""How the whole arm moves with the joint values, and how much it bends: what obstacles and slender shapes ask for.

The quantities of `derivatives`, at every shape point instead of the tip alone. At a fixed arc length,

    dp(s) = int_0^s R du x (p(s) - p(r)) dr  +  the jumps of u at the breakpoints below s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .derivatives import _Jump, _linearise, _pose, _response, bend_changes
from .robots.assembly import Array
from .solution import Solution
from .transcription import arm as arms
from .transcription.buffered import section_function
from .transcription.piece import ENDS


@dataclass(frozen=True, eq=False)
class ArmJacobian:
    """Derivatives with respect to (rotations, translations), as in `derivatives.Jacobian`.

    position: (m, 3, 2n) of the shape points at fixed arc lengths; the last one is the tip, which moves along.
    bend: (2n,) of int |u|^2 ds, 1/m.
    """

    position: Array
    bend: Array


def total_bend(solution: Solution) -> float:
    """int |u|^2 ds along the arm, 1/m."""
    pieces = len(solution.problem.mesh.length)
    if not pieces:
        return 0.0
    square = _curvatures(solution)
    return float((square**2).sum(2).reshape(pieces, -1) @ _integrals()[-1] @ solution.problem.mesh.length)


def arm_jacobian(solution: Solution, carriages: tuple[tuple[int, ...], ...], *, side: int = 1) -> ArmJacobian:
    """Derivatives along the arm of a solved problem whose `carriages` move tubes together."""
    linear = _linearise(solution, carriages, side)
    response = _response(linear)
    problem = solution.problem
    shape = arms.evaluate_arm(problem, solution.rotations, solution.result.state, solution.arm)
    columns = problem.assembly.n_tubes + len(carriages)
    position = np.zeros((len(shape.arc_length), 3, columns))
    bend = np.zeros(columns)
    pieces = len(problem.mesh.length)
    if pieces:
        index, change = bend_changes(linear, response)
        change = change.reshape(pieces, len(ENDS), 2, columns)
        spatial = shape.frame[index][..., :2] @ change
        turn = _cumulate(problem.mesh.length, spatial)
        moment = _cumulate(problem.mesh.length, _cross(spatial, shape.position[index]))
        position = _cross(turn, shape.position) - moment
        along = 2 * np.einsum("pki,pkic->pkc", _curvatures(solution), change)
        bend = np.einsum("p,k,pkc->c", problem.mesh.length, _integrals()[-1], along)
    for jump in linear.jumps:
        k = int(np.argmin(np.abs(shape.arc_length - jump.s)))
        gain = linear.side * shape.frame[k][:, :2] @ jump.change("curvature")
        column = problem.assembly.n_tubes + jump.carriage
        position[k:, :, column] += np.cross(gain, shape.position[k:] - shape.position[k])
        bend[column] += linear.side * _square_gain(jump)
    position[-1] = _pose(linear, response)[0]
    return ArmJacobian(linear.per_tube(position), linear.per_tube(bend))


def _curvatures(solution: Solution) -> Array:
    """(P, 5, 2) curvature at the points ENDS of each piece: on both sides of a breakpoint."""
    problem = solution.problem
    assembly, count = problem.assembly, len(ENDS)
    theta = arms.rotations_at(problem, solution.arm, tuple(ENDS.tolist())).reshape(-1, assembly.n_tubes)
    kb, m = (np.repeat(table, count, axis=0) for table in (problem.piece_stiffness, problem.piece_moment))
    place = (assembly.offset, assembly.offset_angle) if assembly.eccentric else ()
    function = section_function("curvature", len(theta), assembly.n_tubes, assembly.eccentric)
    return function(theta, kb, m, *place)[0].reshape(-1, count, 2).copy()


def _square_gain(jump: _Jump) -> float:
    """Gain of |u|^2 on the stretch that a moving breakpoint uncovers."""
    function = section_function("curvature", 1, len(jump.theta), bool(jump.place))
    gained, lost = (
        float((function(jump.theta, *section, *jump.place)[0] ** 2).sum()) if section[0].any() else 0.0
        for section in (jump.gained, jump.lost)
    )
    return gained - lost


@lru_cache(maxsize=1)
def _integrals() -> Array:
    """(5, 5) integrals from 0 to each of ENDS of the polynomials that are 1 at one of ENDS and 0 at the others."""
    powers = np.arange(1, len(ENDS) + 1)
    table: Array = (ENDS[:, None] ** powers / powers) @ np.linalg.inv(np.vander(ENDS, increasing=True))
    return table


def _cumulate(length: Array, values: Array) -> Array:
    """Integrals (m, ...) from the plate to every shape point of values (P, 5, ...) along the pieces."""
    inner = np.einsum("jk,pk...->pj...", _integrals(), values) * length.reshape(-1, *[1] * (values.ndim - 1))
    before = np.concatenate([np.zeros_like(inner[:1, -1]), np.cumsum(inner[:, -1], axis=0)[:-1]])
    table = before[:, None] + inner
    return np.concatenate([table[0, :1], table[:, 1:].reshape(-1, *table.shape[2:])])


def _cross(columns: Array, arm: Array) -> Array:
    """(..., 3, c) cross product of every column with vectors (..., 3)."""
    return np.asarray(np.cross(columns, arm[..., None], axis=-2))
