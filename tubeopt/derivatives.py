"""How tip pose and margin change with the joint values, by the implicit function theorem.

At a fixed arc length s, a change of the joint values changes theta by

    (1 + Gamma V'') dtheta = d alpha + w(0) d|beta| - sum_k G(s, s_k) [M]_k ds_k,

where [M]_k is what the moment gains on the stretch that a moving breakpoint s_k uncovers. The pose follows from
d phi = int R du ds,  dp = int R du x (p(L) - p) ds  with the same jumps at the breakpoints, and the margin, a Rayleigh
quotient, from the change of the second variation at its eigenvector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from .equilibrium import Equilibrium
from .errors import InputError
from .kinematics import Solution, polish
from .robots.assembly import ROUND_OFF, Array, Assembly, where
from .transcription import arm as arms
from .transcription.buffered import section_function
from .transcription.piece import ENDS
from .transcription.reduced import second_variation


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives with respect to (rotations, translations): columns 0..n-1 per rad, n..2n-1 per m.

    position: (3, 2n) of tip_position.  rotation: (3, 2n) turn vector of the tip frame, in the plate frame, rad.
    tip_rotations: (n, 2n) of theta at each tube's own end.  margin: (2n,); NaN where the margin is a double eigenvalue.
    """

    position: Array
    rotation: Array
    tip_rotations: Array
    margin: Array


@dataclass(frozen=True, eq=False)
class _Jump:
    """A breakpoint at arc length s that moves along with tube `column`; theta (n,) there; kb_i, m_i (n,) of the
    cross-section that the motion uncovers (`gained`) and of what was there (`lost`)."""

    column: int
    s: float
    theta: Array
    gained: tuple[Array, Array]
    lost: tuple[Array, Array]

    def change(self, kind: str, *more: Array) -> Array:
        """Gain of a cross-section function's last output; an empty cross-section counts as zero."""
        values = []
        for section in (self.gained, self.lost):
            out = section_function(kind, 1, len(self.theta), False)(self.theta, *section, *more)[0]
            values.append(out[0].copy() if section[0].any() else np.zeros(out.shape[1]))
        return values[0] - values[1]


@dataclass(frozen=True, eq=False)
class _Linearised:
    """A solution, the breakpoints that move, [M / kt] at each (J, n), and the response of theta to every joint as a
    profile of n x 2n columns, without the direct terms."""

    solution: Solution
    jumps: tuple[_Jump, ...]
    moment_jumps: Array
    response: arms.Profile

    def theta(self, s: Array, response: Array) -> Array:
        """(len(s), n, 2n) change of theta at fixed arc lengths, given the response (len(s), n 2n) there."""
        direct = _direct(self.solution, self.jumps, self.moment_jumps, s)
        return direct + response.reshape(direct.shape)


def jacobian(equilibrium: Equilibrium, *, side: int = 1) -> Jacobian:
    """Derivatives of tip pose, tube tips and margin of an equilibrium.

    Where breakpoints coincide (at home, for instance, every transition lies at the plate) a translation changes the
    order of the sections, and the derivatives differ to either side.

    Args:
        side: 1 for translations that grow, -1 for translations that shrink.

    Raises:
        InputError: side is neither.
        SolveError: the equilibrium is a fold, where derivatives are infinite.
    """
    if side not in (1, -1):
        raise InputError(f"side is {side}; it must be 1 (forward) or -1 (backward)")
    linear = _linearise(polish(equilibrium), side)
    problem = linear.solution.problem
    position, rotation = _pose(linear, side)
    ends = np.clip(problem.assembly.end, 0.0, problem.assembly.total_length)
    tips = linear.theta(ends, arms.interpolate(problem, linear.response, ends))
    own = np.diagonal(tips, axis1=0, axis2=1).T
    return Jacobian(position, rotation, own, _margin(linear, side))


def _linearise(solution: Solution, side: int) -> _Linearised:
    """Solve the linearised integral equation for every joint."""
    problem, state = solution.problem, solution.result.state
    assembly, n = problem.assembly, problem.assembly.n_tubes
    jumps = _jumps(solution, side)
    moments = [side * jump.change("moment") / assembly.torsional_stiffness for jump in jumps]
    moment_jumps = np.array(moments).reshape(len(jumps), n)
    count = len(problem.weight)
    change = np.zeros((count, n, 2 * n))
    if count:
        direct = _direct(solution, jumps, moment_jumps, problem.arc_length)
        whitened = np.linalg.solve(problem.factor, direct[problem.point, problem.tube])
        theta = np.zeros_like(direct)
        theta[problem.point, problem.tube] = problem.factor @ np.linalg.solve(state.hessian, whitened)
        balance = section_function("balance", count, n, False)
        stiffness = balance(state.theta, problem.stiffness, problem.moment)[1].reshape(count, n, n)
        change = (stiffness @ theta) / assembly.torsional_stiffness[:, None]
    transmission = np.repeat(assembly.transmission, 2 * n)
    response = arms.integrate(problem.mesh, np.zeros(2 * n * n), transmission, change.reshape(count, -1))
    return _Linearised(solution, jumps, moment_jumps, response)


def _jumps(solution: Solution, side: int) -> tuple[_Jump, ...]:
    """Every breakpoint in front of the plate, and the cross-section that it uncovers when its tube moves to `side`."""
    assembly: Assembly = solution.problem.assembly
    kb, curvature, nudge = assembly.bending_stiffness, assembly.curvature, side * ROUND_OFF
    out = []
    for i in range(assembly.n_tubes):
        breakpoints = [float(assembly.end[i])]
        if assembly.end[i] - assembly.transition[i] > ROUND_OFF:
            breakpoints.append(float(assembly.transition[i]))
        for s in breakpoints:
            if s < -ROUND_OFF or (s <= ROUND_OFF and side < 0):
                continue
            moved = np.where(np.arange(assembly.n_tubes) == i, 2 * nudge, 0.0)
            before = where(assembly.transition, assembly.end, curvature, s + nudge)
            after = where(assembly.transition + moved, assembly.end + moved, curvature, s + nudge)
            lost, gained = ((kb * present, kb * curvature * curved) for present, curved in (before, after))
            theta = arms.interpolate(solution.problem, solution.arm, np.array([s]))[0]
            out.append(_Jump(i, max(s, 0.0), theta, gained, lost))
    return tuple(out)


def _direct(solution: Solution, jumps: tuple[_Jump, ...], moment_jumps: Array, s: Array) -> Array:
    """(len(s), n, 2n) change of theta at fixed moments: base rotation, transmission, and breakpoints."""
    assembly, n = solution.problem.assembly, solution.problem.assembly.n_tubes
    out = np.zeros((len(s), n, 2 * n))
    diagonal = np.arange(n)
    out[:, diagonal, diagonal] = 1.0
    if len(solution.problem.mesh.length):
        # Advancing a tube shortens its transmission: d|beta| = -1.
        out[:, diagonal, n + diagonal] -= solution.arm.twist[0]
    for jump, moment in zip(jumps, moment_jumps, strict=True):
        out[:, :, n + jump.column] -= moment * (assembly.transmission + np.minimum(s, jump.s)[:, None])
    return out


@lru_cache(maxsize=4)
def _newton_cotes(count: int) -> Array:
    """Weights on [0, 1] of the closed rule at `count` equidistant points."""
    x = np.linspace(0.0, 1.0, count)
    return np.asarray(np.linalg.solve(np.vander(x, increasing=True).T, 1.0 / np.arange(1, count + 1)))


def _pose(linear: _Linearised, side: int) -> tuple[Array, Array]:
    """(3, 2n) change of tip position and of tip rotation (turn vector)."""
    solution, problem = linear.solution, linear.solution.problem
    mesh, assembly, n = problem.mesh, problem.assembly, problem.assembly.n_tubes
    position, turn = np.zeros((3, 2 * n)), np.zeros((3, 2 * n))
    shape = arms.evaluate_arm(problem, solution.rotations, solution.result.state, solution.arm)
    s = shape.arc_length
    lever = shape.position[-1] - shape.position
    if len(mesh.length):
        x = tuple(ENDS.tolist())
        pieces, count = len(mesh.length), len(x)
        # The points of each piece, its two ends included: pieces share the point between them.
        index = np.arange(pieces)[:, None] * (count - 1) + np.arange(count)
        theta = arms.rotations_at(problem, solution.arm, x).reshape(-1, n)
        kb, m = (np.repeat(table, count, axis=0) for table in (problem.piece_stiffness, problem.piece_moment))
        slope = section_function("curvature_slope", pieces * count, n, False)(theta, kb, m)[0].reshape(-1, n, 2)
        response = arms.rotations_at(problem, linear.response, x).reshape(len(theta), -1)
        bend = slope.swapaxes(1, 2) @ linear.theta(s[index].ravel(), response)
        weights = (mesh.length[:, None] * _newton_cotes(count)).ravel()
        spatial = shape.frame[index].reshape(-1, 3, 3)[:, :, :2] @ bend * weights[:, None, None]
        turn += spatial.sum(0)
        position += np.cross(spatial, lever[index].reshape(-1, 3)[:, :, None], axis=1).sum(0)
    for jump in linear.jumps:
        k = int(np.argmin(np.abs(s - jump.s)))
        gain = side * shape.frame[k][:, :2] @ jump.change("curvature")
        turn[:, n + jump.column] += gain
        position[:, n + jump.column] += np.cross(gain, lever[k])
    longest = np.abs(assembly.end - assembly.total_length) <= ROUND_OFF
    if side > 0 or longest.sum() == 1:
        position[:, n + np.flatnonzero(longest)] += shape.frame[-1][:, 2:]
    return position, turn


def _margin(linear: _Linearised, side: int) -> Array:
    """(2n,) change of the margin: of the Rayleigh quotient at its eigenvector y, for which int kt y'^2 = 1."""
    solution, problem = linear.solution, linear.solution.problem
    assembly, state, n = problem.assembly, solution.result.state, problem.assembly.n_tubes
    out = np.zeros(2 * n)
    if not problem.size or solution.margin >= 1 - 1e-9:
        # No elastic coupling (or none that softens): the margin stays at its greatest value, 1.
        return out
    values, vectors = np.linalg.eigh(second_variation(problem, state))
    if len(values) > 1 and values[1] - values[0] < 1e-9:
        return np.full(2 * n, np.nan)
    count = len(problem.weight)
    y = np.zeros((count, n))
    y[problem.point, problem.tube] = problem.factor @ vectors[:, 0]
    s = problem.arc_length
    theta = linear.theta(s, arms.interpolate(problem, linear.response, s))
    gradient = section_function("variation", count, n, False)(state.theta, problem.stiffness, problem.moment, y)[1]
    out += np.einsum("a,ai,aic->c", problem.weight, gradient, theta)
    # y anywhere follows from y (1 - mu) = -G V'' y, whose moments are known at the points.
    stiffness = section_function("balance", count, n, False)(state.theta, problem.stiffness, problem.moment)[1]
    pull = np.einsum("aji,aj->ai", stiffness.reshape(count, n, n), y) / (1 - solution.margin)
    mode = arms.profile(problem, np.zeros(n), replace(state, moment=pull))
    # At fixed y(0) the energy kt y(0)^2 / |beta| of the transmissions falls as they lengthen, and they shorten.
    out[n:] += (1 - solution.margin) * assembly.torsional_stiffness * mode.twist[0] ** 2
    for jump in linear.jumps:
        here = arms.interpolate(problem, mode, np.array([jump.s]))[0]
        out[n + jump.column] += side * float(jump.change("variation", here)[0])
    return out
