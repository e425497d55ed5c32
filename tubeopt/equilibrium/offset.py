"""How the margin of tubes off the centreline changes with the parameters that an equilibrium is differentiated by.

With the eigenvalue kappa = 1 - mu, its y of `block.transcription.second_variation`, the torques t of the tubes and
those of the mode, tau, tau' = M' y, and the left vector zeta, the equation

    zeta' { kappa (y - P [t / kt g' y]) - [|beta| / kt tau(0) + P g tau / kt] } = 0

holds for every value of the parameters, so that with a(s) = int_s^L zeta and b(s) = (|beta| a(0) + int_0^s g a) / kt

    d kappa . l'y = int a . (kappa d(t / kt g') y + d(g / kt) tau) - int b . d(M') y + a(0) . tau(0) d(|beta| / kt),

where a breakpoint that moves gives the jumps of g, g' and M' at it.
"""

from __future__ import annotations

import numpy as np

from ..block.transcription.buffered import section_function
from ..block.transcription.reduced import ReducedProblem
from ..block.transcription.second_variation import Mode, worst_mode
from ..typing import Array
from .arm_change import ArmChange


def offset_change(of: ArmChange) -> Array:
    """(Q,) change of the margin; NaN where it is a double eigenvalue."""
    here, problem, forcing, n = of.here, of.problem, of.forcing, of.n
    there = here.mesh.collocated
    theta, torque = (table[there].reshape(-1, n) for table in (here.theta, here.torque))
    mode = worst_mode(problem, theta)
    if mode is None:
        return np.zeros(of.size)
    if not np.isfinite(mode.pairing):
        return np.full(of.size, np.nan)
    wave, count = _Wave(problem, theta, mode), len(theta)

    def at_points(table: Array) -> Array:
        """(N, r, Q) of what the parameters change at all points."""
        return table[there].reshape(count, -1, of.size)

    changed = np.concatenate([at_points(of.response.phi), at_points(forcing.data)[:, n:]], axis=1)
    function = section_function("mode", count, n, True)
    slope = function(theta, problem.stiffness, problem.moment, *here.offsets, *wave.weights)[1].reshape(count, 3 * n)
    out = np.einsum("a,ac,acq->q", problem.weight, slope, changed)
    softer, kappa = at_points(forcing.rate), mode.value
    twisted = at_points(of.response.torque) / problem.assembly.torsional_stiffness[:, None] + softer * torque[..., None]
    out -= kappa * np.einsum("a,ai,aiq->q", problem.weight, wave.a * wave.stretched, twisted)
    out -= np.einsum("a,ai,aiq->q", problem.weight, wave.a * wave.g * wave.tau, softer)
    for p in np.flatnonzero(~there):
        a, tau = wave.beyond(here.mesh.start[p])
        out -= (a * tau) @ np.tensordot(here.weights[p], forcing.rate[p], 1)
    out -= (wave.a_start * wave.tau_start) @ forcing.transmission
    return np.asarray((out + wave.gains(of) @ of.widths) / mode.pairing)


class _Wave:
    """A mode along the arm: y, tau, a, b, t / kt and g' y at the points (N, n), and what it is at breakpoints."""

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
        self.tau, self.tau_start = -(beyond @ self.pull), -(weight * self.pull).sum(0)
        self.a, self.a_start = (up_to.T @ mode.zeta) / weight, mode.zeta.sum(0)
        self.b = np.zeros_like(theta)
        for block in problem.blocks:
            inside = np.ix_(block.points, block.tubes)
            whole = block.compliance + (block.up_to * ((g - 1) / kt).T[block.tubes][:, None]) @ block.beyond
            self.b[inside] = np.einsum("iab,ai->bi", whole, mode.zeta[inside]) / weight[block.points]

    @property
    def weights(self) -> tuple[Array, Array, Array, Array]:
        """What the section function `mode` weighs with, (N, n) each."""
        kt = self.problem.assembly.torsional_stiffness
        return self.mode.y, self.b, -self.mode.value * self.a * self.twist, -self.a * self.tau / kt

    def gains(self, of: ArmChange) -> Array:
        """(T,) what the strips that breakpoints uncover add to the equation, per width."""
        strips, count, kappa = of.strips, len(of.strips.index), self.mode.value
        if not count:
            return np.zeros(0)
        kt, index = self.problem.assembly.torsional_stiffness, strips.index
        places = [self._at(s) for s in of.cuts[index]]
        y, tau, a, b = (np.array(part * 2) for part in zip(*places, strict=True))
        twist = np.concatenate([of.here.torque_tip_side[index]] * 2) / kt
        theta, stiffness, moment, _ = of.given_there
        weights = (y, b, -kappa * a * twist, -a * tau / kt)
        function = section_function("mode", 2 * count, of.n, True)
        values = function(theta, stiffness, moment, *of.here.offsets, *weights)[0][:, 0] * strips.there
        return np.asarray(of.side * (values[:count] - values[count:]))

    def beyond(self, s: float) -> tuple[Array, Array]:
        """a and tau (n,) at a place between whole elements."""
        there = self.problem.arc_length > s
        return self.mode.zeta[there].sum(0), -(self.problem.weight[:, None] * self.pull)[there].sum(0)

    def _at(self, s: float) -> tuple[Array, Array, Array, Array]:
        """y, tau, a, b (n,) at a breakpoint: whole elements lie on either side of it."""
        problem, mode = self.problem, self.mode
        kt, transmission = problem.assembly.torsional_stiffness, problem.assembly.transmission
        before, weight = problem.arc_length < s, problem.weight[:, None]
        turning = self.g * self.tau / (mode.value * kt) + self.twist * self.stretched
        y = transmission * self.tau_start / (mode.value * kt) + (weight * turning)[before].sum(0)
        b = transmission * self.a_start + (weight * self.g * self.a)[before].sum(0)
        mesh = problem.mesh
        for p in np.flatnonzero(~mesh.collocated & (mesh.start + mesh.length / 2 < s)):
            a, tau = self.beyond(mesh.start[p])
            y = y + mesh.length[p] * tau / (mode.value * kt)
            b = b + mesh.length[p] * a
        a, tau = self.beyond(s)
        return y, tau, a, b / kt
