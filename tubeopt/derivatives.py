"""How tip pose and margin change with the joint values, by the implicit function theorem.

At a fixed arc length s, a change of the joint values changes theta by

    (1 + Gamma V'') dtheta = d alpha + w(0) d|beta| - sum_k G(s, s_k) [M]_k ds_k,

where [M]_k is what the moment gains on the stretch that a moving breakpoint s_k uncovers. The pose follows from
d phi = int R du ds,  dp = int R du x (p(L) - p) ds  with the same jumps at the breakpoints, and the margin, a Rayleigh
quotient, from the change of the second variation at its eigenvector (see `offset_derivatives` for tubes off the
centreline, which have none).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .equilibrium import Equilibrium
from .errors import InputError
from .offset_derivatives import margin_slope
from .robots.assembly import ROUND_OFF, Array, Assembly, merge, where
from .solution import Solution, discretisation_of, polish
from .transcription import arm as arms
from .transcription.buffered import section_function
from .transcription.piece import ENDS


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives with respect to (rotations, translations): columns 0..n-1 per rad, n..2n-1 per m.

    Tubes that one carriage moves (the three of an eccentric segment) share the derivative with respect to its
    translation in equal parts, so that the chain rule holds for every motion that is possible.

    position: (3, 2n) of tip_position.  rotation: (3, 2n) turn vector of the tip frame, in the plate frame, rad.
    tip_rotations: (n, 2n) of theta at each tube's own end.  margin: (2n,); NaN where the margin is a double eigenvalue.
    """

    position: Array
    rotation: Array
    tip_rotations: Array
    margin: Array


@dataclass(frozen=True, eq=False)
class _Jump:
    """A breakpoint at arc length s that moves along with carriage `carriage`; theta, w (n,) there; kb_i, m_i (n,) of
    the cross-section that the motion uncovers (`gained`) and of what was there (`lost`); `place` of eccentric tubes."""

    carriage: int
    s: float
    theta: Array
    twist: Array
    gained: tuple[Array, Array]
    lost: tuple[Array, Array]
    place: tuple[Array, ...]

    def change(self, kind: str, output: int = 0) -> Array:
        """Gain of an output of a cross-section function; an empty cross-section counts as zero."""
        function = section_function(kind, 1, len(self.theta), bool(self.place))
        values = []
        for section in (self.gained, self.lost):
            out = function(self.theta, *section, *self.place)[output]
            values.append(out[0].copy() if section[0].any() else np.zeros(out.shape[1]))
        return values[0] - values[1]

    def variation_change(self, y: Array) -> float:
        """Gain of y' V'' y of concentric tubes."""
        function = section_function("variation", 1, len(self.theta), False)
        values = [
            float(function(self.theta, *section, y)[0][0, 0]) if section[0].any() else 0.0
            for section in (self.gained, self.lost)
        ]
        return values[0] - values[1]


@dataclass(frozen=True, eq=False)
class _Linearised:
    """A solution, the tubes of each of G carriages, the breakpoints that move to `side`, [M / kt] (J, n) at each."""

    solution: Solution
    carriages: tuple[tuple[int, ...], ...]
    jumps: tuple[_Jump, ...]
    side: int
    moment_jumps: Array

    def direct(self, s: Array) -> Array:
        """(len(s), n, n + G) change of theta at fixed moments: base rotation, transmission, and breakpoints."""
        assembly, n = self.solution.problem.assembly, self.solution.problem.assembly.n_tubes
        out = np.zeros((len(s), n, n + len(self.carriages)))
        out[:, np.arange(n), np.arange(n)] = 1.0
        if len(self.solution.problem.mesh.length):
            for c, tubes in enumerate(self.carriages):
                # Advancing a tube shortens its transmission: d|beta| = -1.
                out[:, list(tubes), n + c] -= self.solution.arm.twist[0, list(tubes)]
        for jump, moment in zip(self.jumps, self.moment_jumps, strict=True):
            column = n + jump.carriage
            out[:, :, column] -= moment * (assembly.transmission + np.minimum(s, jump.s)[:, None])
            if jump.place:
                beyond = (s > jump.s)[:, None]
                out[:, :, column] += beyond * (self.side * jump.change("moment", 1) * jump.twist)
        return out

    def theta(self, s: Array, response: Array) -> Array:
        """(len(s), n, n + G) change of theta at fixed arc lengths, given the response (len(s), n (n + G)) there."""
        direct = self.direct(s)
        return direct + response.reshape(direct.shape)

    def per_tube(self, columns: Array) -> Array:
        """(..., 2n) from columns (..., n + G): every tube of a carriage gets an equal part."""
        n = self.solution.problem.assembly.n_tubes
        out = np.zeros((*columns.shape[:-1], 2 * n))
        out[..., :n] = columns[..., :n]
        for c, tubes in enumerate(self.carriages):
            out[..., n + np.array(tubes)] = columns[..., n + c, None] / len(tubes)
        return out


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
    solution = polish(equilibrium, discretisation_of(equilibrium))
    return jacobian_at(solution, equilibrium.robot.moving_together, side=side)


def jacobian_at(solution: Solution, carriages: tuple[tuple[int, ...], ...], *, side: int = 1) -> Jacobian:
    """`jacobian` of a solved problem whose `carriages` move tubes together."""
    problem = solution.problem
    linear = _linearise(solution, carriages, side)
    response = _response(linear)
    position, rotation = _pose(linear, response)
    ends = np.clip(problem.assembly.end, 0.0, problem.assembly.total_length)
    tips = linear.theta(ends, arms.interpolate(problem, response, ends))
    own = np.diagonal(tips, axis1=0, axis2=1).T
    margin = _margin(linear, response)
    return Jacobian(*(linear.per_tube(part) for part in (position, rotation, own, margin)))


def _linearise(solution: Solution, carriages: tuple[tuple[int, ...], ...], side: int) -> _Linearised:
    jumps = _jumps(solution, carriages, side)
    kt = solution.problem.assembly.torsional_stiffness
    moments = [side * jump.change("moment") / kt for jump in jumps]
    return _Linearised(solution, carriages, jumps, side, np.reshape(moments, (len(jumps), len(kt))))


def _place(assembly: Assembly) -> tuple[Array, ...]:
    return (assembly.offset, assembly.offset_angle) if assembly.eccentric else ()


def _response(linear: _Linearised) -> arms.Profile:
    """Response of theta to every rotation and carriage: solves the linearised integral equation."""
    problem, state = linear.solution.problem, linear.solution.result.state
    assembly, n, count = problem.assembly, problem.assembly.n_tubes, len(problem.weight)
    columns = n + len(linear.carriages)
    transmission = np.repeat(assembly.transmission, columns)
    if not count:
        return arms.integrate(problem.mesh, np.zeros(n * columns), transmission, np.zeros((0, n * columns)))
    s = problem.arc_length
    right = linear.direct(s)
    balance = section_function("balance", count, n, assembly.eccentric)
    out = [o.copy() for o in balance(state.theta, problem.stiffness, problem.moment, *_place(assembly))]
    stiffness = out[1].reshape(count, n, n).swapaxes(1, 2) / assembly.torsional_stiffness[:, None]
    twist_jump = np.zeros_like(right)
    if problem.stretch is not None:
        for jump, moment in zip(linear.jumps, linear.moment_jumps, strict=True):
            twist_jump[:, :, n + jump.carriage] -= (s < jump.s)[:, None] * moment
        right = right + _apply(problem.stretch[0], (out[3] - 1)[:, :, None] * twist_jump)
    theta = np.zeros_like(right)
    whitened = np.linalg.solve(problem.factor, right[problem.point, problem.tube])
    theta[problem.point, problem.tube] = problem.factor @ np.linalg.solve(state.hessian, whitened)
    moment = stiffness @ theta
    extra = None
    if problem.stretch is not None:
        beyond = problem.stretch[1]
        twist = -(beyond @ state.moment) / assembly.torsional_stiffness
        stretched = out[4].reshape(count, n, n).swapaxes(1, 2) @ theta
        change = stretched * twist[:, :, None]
        change += (out[3] - 1)[:, :, None] * (twist_jump - _apply(beyond, moment))
        extra = change.reshape(count, -1)
    return arms.integrate(problem.mesh, np.zeros(n * columns), transmission, moment.reshape(count, -1), extra)


def _apply(matrix: Array, columns: Array) -> Array:
    """matrix (N, N) times columns (N, n, k)."""
    return np.asarray((matrix @ columns.reshape(len(columns), -1)).reshape(columns.shape))


def _jumps(solution: Solution, carriages: tuple[tuple[int, ...], ...], side: int) -> tuple[_Jump, ...]:
    """Every breakpoint in front of the plate, and the cross-section that it uncovers when its tube moves to `side`."""
    problem, assembly = solution.problem, solution.problem.assembly
    kb, curvature, nudge = assembly.bending_stiffness, assembly.curvature, side * ROUND_OFF
    out = []
    for c, tubes in enumerate(carriages):
        mine = list(tubes)
        ends, transitions = assembly.end[mine], assembly.transition[mine]
        # Tubes that move together share most breakpoints: each is counted once.
        for s in merge(np.concatenate([ends, transitions[ends - transitions > ROUND_OFF]])).tolist():
            if s < -ROUND_OFF or (s <= ROUND_OFF and side < 0):
                continue
            moved = np.where(np.isin(np.arange(assembly.n_tubes), tubes), 2 * nudge, 0.0)
            before = where(assembly.transition, assembly.end, curvature, s + nudge)
            after = where(assembly.transition + moved, assembly.end + moved, curvature, s + nudge)
            lost, gained = ((kb * present, kb * curvature * curved) for present, curved in (before, after))
            theta = arms.interpolate(problem, solution.arm, np.array([s]))[0]
            twist = arms.twist_at(problem, solution.arm, s)
            out.append(_Jump(c, max(s, 0.0), theta, twist, gained, lost, _place(assembly)))
    return tuple(out)


def bend_changes(linear: _Linearised, response: arms.Profile) -> tuple[NDArray[np.intp], Array]:
    """Change of the curvature (P x 5, 2, n + G) at fixed arc lengths, at the points of each piece, its two ends
    included; and the index (P, 5) of these points along the arm, since pieces share the point between them."""
    solution, problem = linear.solution, linear.solution.problem
    assembly, n, pieces, count = problem.assembly, problem.assembly.n_tubes, len(problem.mesh.length), len(ENDS)
    x = tuple(ENDS.tolist())
    index = np.arange(pieces)[:, None] * (count - 1) + np.arange(count)
    theta = arms.rotations_at(problem, solution.arm, x).reshape(-1, n)
    kb, m = (np.repeat(table, count, axis=0) for table in (problem.piece_stiffness, problem.piece_moment))
    function = section_function("curvature_slope", pieces * count, n, assembly.eccentric)
    slope = function(theta, kb, m, *_place(assembly))[0].reshape(-1, n, 2)
    change = arms.rotations_at(problem, response, x).reshape(len(theta), -1)
    # A breakpoint between two pieces lies behind the first point of one and ahead of the last of the other.
    inside = arms.arc_lengths(problem.mesh)[index] + 10 * ROUND_OFF * np.sign(0.5 - ENDS)
    return index, slope.swapaxes(1, 2) @ linear.theta(inside.ravel(), change)


@lru_cache(maxsize=4)
def _newton_cotes(count: int) -> Array:
    """Weights on [0, 1] of the closed rule at `count` equidistant points."""
    x = np.linspace(0.0, 1.0, count)
    return np.asarray(np.linalg.solve(np.vander(x, increasing=True).T, 1.0 / np.arange(1, count + 1)))


def _pose(linear: _Linearised, response: arms.Profile) -> tuple[Array, Array]:
    """(3, n + G) change of tip position and of tip rotation (turn vector)."""
    solution, problem = linear.solution, linear.solution.problem
    mesh, assembly, n = problem.mesh, problem.assembly, problem.assembly.n_tubes
    position, turn = (np.zeros((3, n + len(linear.carriages))) for _ in range(2))
    shape = arms.evaluate_arm(problem, solution.rotations, solution.result.state, solution.arm)
    s = shape.arc_length
    lever = shape.position[-1] - shape.position
    if len(mesh.length):
        index, bend = bend_changes(linear, response)
        count = len(ENDS)
        weights = (mesh.length[:, None] * _newton_cotes(count)).ravel()
        spatial = shape.frame[index].reshape(-1, 3, 3)[:, :, :2] @ bend * weights[:, None, None]
        turn += spatial.sum(0)
        position += np.cross(spatial, lever[index].reshape(-1, 3)[:, :, None], axis=1).sum(0)
    for jump in linear.jumps:
        k = int(np.argmin(np.abs(s - jump.s)))
        gain = linear.side * shape.frame[k][:, :2] @ jump.change("curvature")
        turn[:, n + jump.carriage] += gain
        position[:, n + jump.carriage] += np.cross(gain, lever[k])
    longest = np.abs(assembly.end - assembly.total_length) <= ROUND_OFF
    for c, tubes in enumerate(linear.carriages):
        # The tip goes along with a carriage that pushes it out, or that alone holds it there.
        mine = longest[list(tubes)]
        if mine.any() and (linear.side > 0 or mine.sum() == longest.sum()):
            position[:, n + c] += shape.frame[-1][:, 2]
    return position, turn


def _margin(linear: _Linearised, response: arms.Profile) -> Array:
    """(n + G,) change of the margin: of the Rayleigh quotient at its eigenvector y, for which int kt y'^2 = 1."""
    solution, problem = linear.solution, linear.solution.problem
    assembly, state, n = problem.assembly, solution.result.state, problem.assembly.n_tubes
    out = np.zeros(n + len(linear.carriages))
    if not problem.size or solution.margin >= 1 - 1e-9:
        # No elastic coupling (or none that softens): the margin stays at its greatest value, 1.
        return out
    if assembly.eccentric:
        s = problem.arc_length
        theta = linear.theta(s, arms.interpolate(problem, response, s))
        return margin_slope(solution, theta, linear.jumps, linear.carriages, linear.side)
    values, vectors = np.linalg.eigh(state.hessian)
    if len(values) > 1 and values[1] - values[0] < 1e-9:
        return np.full(len(out), np.nan)
    count = len(problem.weight)
    y = np.zeros((count, n))
    y[problem.point, problem.tube] = problem.factor @ vectors[:, 0]
    s = problem.arc_length
    theta = linear.theta(s, arms.interpolate(problem, response, s))
    gradient = section_function("variation", count, n, False)(state.theta, problem.stiffness, problem.moment, y)[1]
    out += np.einsum("a,ai,aic->c", problem.weight, gradient, theta)
    # y anywhere follows from y (1 - mu) = -G V'' y, whose moments are known at the points.
    stiffness = section_function("balance", count, n, False)(state.theta, problem.stiffness, problem.moment)[1]
    pull = np.einsum("aji,aj->ai", stiffness.reshape(count, n, n), y) / (1 - solution.margin)
    mode = arms.integrate(problem.mesh, np.zeros(n), assembly.transmission, pull / assembly.torsional_stiffness)
    # At fixed y(0) the energy kt y(0)^2 / |beta| of the transmissions falls as they lengthen, and they shorten.
    gain = (1 - solution.margin) * assembly.torsional_stiffness * mode.twist[0] ** 2
    for c, tubes in enumerate(linear.carriages):
        out[n + c] += gain[list(tubes)].sum()
    for jump in linear.jumps:
        here = arms.interpolate(problem, mode, np.array([jump.s]))[0]
        out[n + jump.carriage] += linear.side * jump.variation_change(here)
    return out
