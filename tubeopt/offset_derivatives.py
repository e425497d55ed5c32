"""How the margin of tubes off the centreline changes with the joint values.

With the eigenvalue kappa = 1 - mu, its y, v of `transcription.offset_margin`, and the left vector zeta, the equation

    zeta' { kappa (y - P [w g' y]) + [Gamma + P (g - 1) W / kt] M' y } = 0

holds for every joint value, so that with a(s) = int_s^L zeta and b(s) = (|beta| a(0) + int_0^s g a) / kt

    d kappa . l'y = kappa int a . (w d(g') y + dg v + dw g' y) - int b . d(M') y + kappa a(0) . v(0) d|beta|,

where a breakpoint that moves gives the jumps of g, g' and M' at it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .robots.assembly import Array
from .solution import Solution
from .transcription.buffered import section_function
from .transcription.offset_margin import Mode, worst_mode
from .transcription.reduced import ReducedProblem

if TYPE_CHECKING:
    from .derivatives import _Jump


def margin_slope(
    solution: Solution, theta: Array, jumps: Sequence[_Jump], carriages: Sequence[tuple[int, ...]], side: int
) -> Array:
    """(n + G,) change of the margin with n rotations and the advance of G carriages.

    Args:
        solution: of tubes off the centreline.
        theta: (N, n, n + G) change of the rotations at the collocation points, at fixed arc lengths, rad.
        jumps: the breakpoints that move to `side`.

    Returns:
        NaN where the margin is a double eigenvalue.
    """
    problem, state = solution.problem, solution.result.state
    n = problem.assembly.n_tubes
    mode = worst_mode(problem, state.theta)
    if mode is None:
        return np.zeros(n + len(carriages))
    if not np.isfinite(mode.pairing):
        return np.full(n + len(carriages), np.nan)
    wave = _Wave(problem, state.theta, mode)
    weights = (mode.y, wave.b, -mode.value * wave.a * wave.twist, -mode.value * wave.a * wave.v)
    count, place = len(theta), (problem.assembly.offset, problem.assembly.offset_angle)
    slope = section_function("mode", count, n, True)(state.theta, problem.stiffness, problem.moment, *place, *weights)[
        1
    ]
    out = np.einsum("a,ai,aic->c", problem.weight, slope, theta)
    out -= mode.value * np.einsum(
        "a,ai,ai,aic->c", problem.weight, wave.a, wave.stretched, wave.twist_change(theta, jumps, side)
    )
    for c, tubes in enumerate(carriages):
        out[n + c] += mode.value * float((wave.a_start * wave.v_start)[list(tubes)].sum())
    for jump in jumps:
        out[n + jump.carriage] += side * wave.gain(jump)
    return np.asarray(out / mode.pairing)


class _Wave:
    """A mode along the arm: y, v, a, b, w and g' y at the points (N, n), and what it is at breakpoints."""

    def __init__(self, problem: ReducedProblem, theta: Array, mode: Mode) -> None:
        assembly, count = problem.assembly, len(problem.weight)
        n, kt, weight = assembly.n_tubes, assembly.torsional_stiffness, problem.weight[:, None]
        balance = section_function("balance", count, n, True)
        place = assembly.offset, assembly.offset_angle
        outputs = balance(theta, problem.stiffness, problem.moment, *place)
        moment, turned, _, g, stretched = (part.copy() for part in outputs)
        assert problem.stretch is not None
        up_to, beyond, _ = problem.stretch
        self.problem, self.mode, self.g = problem, mode, g
        self.turned, self.slope_g = (part.reshape(count, n, n).swapaxes(1, 2) for part in (turned, stretched))
        self.twist = -(beyond @ moment) / kt
        self.stretched = np.einsum("aij,aj->ai", self.slope_g, mode.y)
        self.pull = np.einsum("aij,aj->ai", self.turned, mode.y)
        self.v = -(beyond @ self.pull) / (mode.value * kt)
        self.v_start = -(weight * self.pull).sum(0) / (mode.value * kt)
        self.a, self.a_start = (up_to.T @ mode.zeta) / weight, mode.zeta.sum(0)
        self.b = np.zeros_like(theta)
        for block in problem.blocks:
            inside = np.ix_(block.points, block.tubes)
            whole = block.compliance + (block.up_to * ((g - 1) / kt).T[block.tubes][:, None]) @ block.beyond
            self.b[inside] = np.einsum("iab,ai->bi", whole, mode.zeta[inside]) / weight[block.points]

    def twist_change(self, theta: Array, jumps: Sequence[_Jump], side: int) -> Array:
        """(N, n, n + G) change of the twist w at fixed arc lengths, given that of theta."""
        kt = self.problem.assembly.torsional_stiffness[:, None]
        assert self.problem.stretch is not None
        moment = self.turned @ theta
        out = -(self.problem.stretch[1] @ moment.reshape(len(theta), -1)).reshape(theta.shape) / kt
        for jump in jumps:
            gain = side * jump.change("moment") / kt[:, 0]
            out[:, :, theta.shape[1] + jump.carriage] -= (self.problem.arc_length < jump.s)[:, None] * gain
        return np.asarray(out)

    def gain(self, jump: _Jump) -> float:
        """What the stretch that a breakpoint uncovers adds to the equation, per length."""
        y, v, a, b = self._at(jump.s)
        kappa = self.mode.value
        weights = (y, b, -kappa * a * jump.twist, -kappa * a * v)
        function = section_function("mode", 1, len(y), True)
        values = [
            float(function(jump.theta, *section, *jump.place, *weights)[0][0, 0]) if section[0].any() else 0.0
            for section in (jump.gained, jump.lost)
        ]
        return values[0] - values[1]

    def _at(self, s: float) -> tuple[Array, Array, Array, Array]:
        """y, v, a, b (n,) at a breakpoint: whole elements lie on either side of it."""
        problem, mode = self.problem, self.mode
        kt, transmission = problem.assembly.torsional_stiffness, problem.assembly.transmission
        before = problem.arc_length < s
        weight = problem.weight[:, None]
        v = -(weight * self.pull)[~before].sum(0) / (mode.value * kt)
        a = mode.zeta[~before].sum(0)
        y = transmission * self.v_start + (weight * (self.g * self.v + self.twist * self.stretched))[before].sum(0)
        b = transmission * self.a_start + (weight * self.g * self.a)[before].sum(0)
        mesh = problem.mesh
        for p in np.flatnonzero(~mesh.collocated & (mesh.start + mesh.length / 2 < s)):
            beyond = problem.arc_length > mesh.start[p]
            y = y - mesh.length[p] * (weight * self.pull)[beyond].sum(0) / (mode.value * kt)
            b = b + mesh.length[p] * mode.zeta[beyond].sum(0)
        return y, v, a, b / kt
