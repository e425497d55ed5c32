"""How the margin of tubes off the centreline changes with the parameters that an equilibrium is differentiated by.

With the eigenvalue kappa = 1 - mu, its y, v of `block.transcription.second_variation`, and the left vector zeta, the
equation

    zeta' { kappa (y - P [w g' y]) + [Gamma + P (g - 1) W / kt] M' y } = 0

holds for every value of the parameters, so that with a(s) = int_s^L zeta and b(s) = (|beta| a(0) + int_0^s g a) / kt

    d kappa . l'y = kappa int a . (w d(g') y + dg v + dw g' y) - int b . (d(M') y - M' y dkt / kt)
                    + kappa a(0) . v(0) d|beta|,

where a breakpoint that moves gives the jumps of g, g' and M' at it.
"""

from __future__ import annotations

import numpy as np

from ..block.transcription.buffered import section_function
from ..block.transcription.reduced import ReducedProblem
from ..block.transcription.second_variation import Mode, worst_mode
from ..typing import Array
from .arm_change import ArmChange


def offset_change(of: ArmChange, problem: ReducedProblem) -> Array:
    """(Q,) change of the margin, by carriages, of the solution of `problem`; NaN where it is a double eigenvalue."""
    n, there = of.arm.n_tubes, problem.mesh.collocated
    theta = of.arm.inner[there].reshape(-1, n)
    mode = worst_mode(problem, theta)
    if mode is None:
        return np.zeros(of.size)
    if not np.isfinite(mode.pairing):
        return np.full(of.size, np.nan)
    wave = _Wave(problem, theta, mode)
    count, place = len(theta), of.arm.place
    columns = of.columns[there].reshape(count, 3 * n, -1)
    slope = section_function("mode", count, n, True)(theta, problem.stiffness, problem.moment, *place, *wave.weights)[1]
    out = np.einsum("a,ac,acq->q", problem.weight, slope.reshape(count, 3 * n), columns)
    twisted = of.twist_change[there].reshape(count, n, -1)
    out -= mode.value * np.einsum("a,ai,aiq->q", problem.weight, wave.a * wave.stretched, twisted)
    out -= mode.value * (wave.a_start * wave.v_start) @ of.transmitted
    first = of.first("torsional_stiffness")
    if first is not None:
        out[first : first + n] -= problem.weight @ (wave.b * wave.pull) / of.arm.torsional_stiffness
    out += of.side * wave.gains(of) @ of.jumps.spread
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
        # CasADi stores dM_i/dtheta_j by columns, (point, j, i).
        turned, slope_g = (part.reshape(count, n, n).swapaxes(1, 2) for part in (turned, stretched))
        self.twist = -(beyond @ moment) / kt
        self.stretched = np.einsum("aij,aj->ai", slope_g, mode.y)
        self.pull = np.einsum("aij,aj->ai", turned, mode.y)
        self.v = -(beyond @ self.pull) / (mode.value * kt)
        self.v_start = -(weight * self.pull).sum(0) / (mode.value * kt)
        self.a, self.a_start = (up_to.T @ mode.zeta) / weight, mode.zeta.sum(0)
        self.b = np.zeros_like(theta)
        for block in problem.blocks:
            inside = np.ix_(block.points, block.tubes)
            whole = block.compliance + (block.up_to * ((g - 1) / kt).T[block.tubes][:, None]) @ block.beyond
            self.b[inside] = np.einsum("iab,ai->bi", whole, mode.zeta[inside]) / weight[block.points]

    @property
    def weights(self) -> tuple[Array, Array, Array, Array]:
        """What the section function `mode` weighs with, (N, n) each."""
        kappa = self.mode.value
        return self.mode.y, self.b, -kappa * self.a * self.twist, -kappa * self.a * self.v

    def gains(self, of: ArmChange) -> Array:
        """(J,) what the stretches that breakpoints uncover add to the equation, per length."""
        jumps, count, kappa = of.jumps, len(of.jumps), self.mode.value
        if not count:
            return np.zeros(0)
        places = [self._at(s) for s in of.cuts[jumps.index]]
        y, v, a, b = (np.array(part * 2) for part in zip(*places, strict=True))
        theta, twist = (jumps.twice(table) for table in of.arm.states)
        weights = (y, b, -kappa * a * twist, -kappa * a * v)
        function = section_function("mode", 2 * count, of.arm.n_tubes, True)
        values = function(theta, jumps.solid, jumps.moment, *of.arm.place, *weights)[0][:, 0]
        return jumps.gain(np.where(jumps.stiffness.any(1), values, 0.0))

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
