"""Derivatives of equilibria of bundle robots by joint values, by the implicit function theorem.

The energy E(x, c) has the gradient 0 along x(c): dx/dc = -E_xx^-1 E_xc.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy

from ..block.transcription.bundle import BundleState, bundle_arm, margin_form, place_slopes
from ..errors import InputError, SolveError
from ..solvers.settings import LEAST_STIFFNESS
from ..typing import Array
from .bundle import Bundled
from .kinematics import point_of
from .result import Equilibrium

JOINTS = ("rotations", "translations")
"""Parameters of the derivatives."""

MARGIN_STEP = 1e-4, 1e-6
"""Steps of the differences of the margin at a fixed mode, rad and m."""


@dataclass(frozen=True, eq=False)
class BundleResponse:
    """Changes of a solved state with its 2 n joint values."""

    member: Bundled
    state: BundleState

    @cached_property
    def lengths(self) -> Array:
        """Derivative (m, 2 n) of the lengths h of elements of a straight arm, m."""
        problem = self.state.problem
        boundary_shift = np.zeros((len(problem.order), 2 * problem.n))
        for k, boundary in enumerate(problem.order):
            boundary_shift[k, [problem.n + i for i in boundary.tubes]] = 1.0
        return problem.lengths_by_boundaries @ boundary_shift

    @cached_property
    def _bend(self) -> Array:
        """Derivative (2 N, 2 n) of kappa at fixed x."""
        return self.state.problem.held_bend(self.lengths)

    @cached_property
    def _independent(self) -> Array:
        """Derivative (2 N + m + n, 2 n) of kappa, h and own lengths at fixed x."""
        problem, n = self.state.problem, self.state.problem.n
        h = self.lengths + problem.lengths_by_bend @ self._bend
        return np.concatenate([self._bend, h, np.eye(2 * n)[n:]])

    @cached_property
    def _local(self) -> Array:
        """Derivative (N, 2 n + 3, 2 n) of theta, p, kappa and h by the joint values, at fixed x."""
        problem, n = self.state.problem, self.state.problem.n
        count, m = len(problem.weight), len(problem.order)
        out = np.zeros((count, 2 * n + 3, 2 * n))
        out[:, np.arange(n), np.arange(n)] = 1.0
        # theta at the plate is alpha + x sqrt(|beta| / kt): a tube moved forward has less transmission.
        out[:, np.arange(n), n + np.arange(n)] = -self._untwisted
        out[:, 2 * n : -1] = self._bend.reshape(count, 2, -1)
        out[:, -1] = self._independent[2 * count : 2 * count + m][problem.point_section]
        return out

    @cached_property
    def _untwisted(self) -> Array:
        """Decrease (n,) of the rotations at the plate by the translations at fixed x, rad/m.

        It is the twist of a transmission over twice its length; without a transmission the twist rate of the tube.
        """
        state, problem = self.state, self.state.problem
        at_plate, k = problem.tableau.basis((0.0,), 0)[0], problem.tableau.degree
        twist = problem.torsion(state.x)[1]
        out = (at_plate @ state.turn[:k]) / (at_plate @ np.where(problem.present[:k], state.length[:k], 1.0))
        out[problem.sprung] = twist[problem.sprung] / (2 * problem.bundle.transmission[problem.sprung])
        return np.asarray(out)

    @cached_property
    def x(self) -> Array:
        """Derivative (U, 2 n) of the unknowns."""
        state, problem = self.state, self.state.problem
        right = problem.adjoint_sums(problem.weight[:, None, None] * (state.local_hessian @ self._local))
        # theta = x sqrt(|beta| / kt) at the plate: its derivative by x depends on the transmission, too.
        rows, sprung = problem.sprung_rows, problem.sprung
        spring_slope = (state.gradient - state.x)[rows]
        right[rows, problem.n + sprung] -= spring_slope / (2 * problem.bundle.transmission[sprung])
        if state.loading is not None:
            count = 2 * len(problem.weight)
            by_parameter = state.loading.second @ self._independent
            follow = by_parameter[:count] + problem.lengths_by_bend.T @ by_parameter[count : count + len(problem.order)]
            right[problem.split :] -= state.factor * problem.bend_map.T @ follow
            right -= state.factor * state.loading.torsional_slope @ self._bend
        return np.asarray(-scipy.linalg.solve(state.hessian, right))

    @cached_property
    def tip(self) -> Array:
        """Derivative (6, 2 n) of the tip pose."""
        problem = self.state.problem
        pose = place_slopes(self.state, len(problem.order) - 1)
        out = pose.by_x @ self.x
        out[:3] += pose.by_length @ self.lengths
        if problem.held:
            out += pose.by_bend @ self._bend
        return np.asarray(out)

    @cached_property
    def tip_rotations(self) -> Array:
        """Derivative (n, 2 n) of theta at the ends of the tubes, rad."""
        n = self.state.problem.n
        out = np.eye(n, 2 * n) + self.state.problem.tip_rows @ self.x
        out[:, n:] -= np.diag(self._untwisted)
        return np.asarray(out)

    @cached_property
    def energy(self) -> Array:
        """Derivative (2 n,) of the elastic energy, J."""
        problem, state = self.state.problem, self.state
        weighted = (problem.weight[:, None] * state.by_local).ravel()
        gradient = problem.adjoint_sums((problem.weight[:, None] * state.by_local)[..., None])[:, 0]
        gradient[problem.sprung_rows] += state.x[problem.sprung_rows]
        out = np.asarray(weighted @ self._local.reshape(len(weighted), -1) + gradient @ self.x)
        # A tube without a transmission gets one as it moves back.
        free = np.setdiff1d(np.arange(problem.n), problem.sprung)
        out[problem.n + free] -= problem.bundle.torsional_stiffness[free] * self._untwisted[free] ** 2 / 2
        return out

    @cached_property
    def margin(self) -> Array:
        """Derivative (2 n,) of the margin: that of its form at a fixed mode, by central differences.

        NaN if the boundaries change, and under a load without an energy.
        """
        member, state, n = self.member, self.state, self.state.problem.n
        if not member.descends:
            return np.full(2 * n, np.nan)
        values, vectors = np.linalg.eigh(margin_form(state))
        out, mode = np.zeros(2 * n), vectors[:, 0]
        if values[0] >= 1:
            return out
        joints = np.concatenate([member.rotations, member.translations])
        for k in range(2 * n):
            sides = []
            for step in (MARGIN_STEP[k >= n], 0.0, -MARGIN_STEP[k >= n]):
                alpha, shift = np.split(joints + step * (np.arange(2 * n) == k), 2)
                moved = member.with_inputs(alpha, tuple(shift.tolist()), state.problem.load, member.factor)
                if moved is not None:
                    sides.append((step, float(mode @ margin_form(moved.at(state.x + step * self.x[:, k])) @ mode)))
            # Where a boundary comes in front of the plate there is one side only.
            (high, above), (low, below) = sides[0], sides[-1]
            out[k] = (above - below) / (high - low) if high != low else np.nan
        return out

    @cached_property
    def position(self) -> Array:
        """Derivative (p, 3, 2 n) of the points of the shape at fixed arc lengths, m; for the last point, of the tip.

        Computed by central differences of the unknowns along their derivative.
        """
        member, state, n = self.member, self.state, self.state.problem.n
        joints, known = np.concatenate([member.rotations, member.translations]), bundle_arm(member.rotations, state)
        out = np.zeros((*known.position.shape, 2 * n))
        for k in range(2 * n):
            arms = []
            for step in (MARGIN_STEP[k >= n], 0.0, -MARGIN_STEP[k >= n]):
                alpha, shift = np.split(joints + step * (np.arange(2 * n) == k), 2)
                moved = member.with_inputs(alpha, tuple(shift.tolist()), state.problem.load, member.factor)
                if moved is not None:
                    arms.append((step, bundle_arm(alpha, moved.at(state.x + step * self.x[:, k]))))
            (high, ahead), (low, behind) = arms[0], arms[-1]
            along = (ahead.arc_length - behind.arc_length)[:, None] * known.frame[:, :, 2]
            along[-1] = 0.0
            out[:, :, k] = (ahead.position - behind.position - along) / (high - low)
        return out

    @cached_property
    def bend(self) -> Array:
        """Derivative (2 n,) of the integral of the squared curvature, 1/m."""
        problem, state = self.state.problem, self.state
        table = np.zeros((len(problem.weight), 2 * problem.n + 3))
        table[:, -3:-1] = 2 * problem.weight[:, None] * state.bend / state.h[:, None]
        table[:, -1] = -problem.weight * (state.bend**2).sum(1) / state.h**2
        gradient = problem.adjoint_sums(table[..., None])[:, 0]
        return np.asarray(table.ravel() @ self._local.reshape(table.size, -1) + gradient @ self.x)

    @property
    def total_bend(self) -> float:
        """Integral of the squared curvature, 1/m."""
        return float(self.state.problem.weight @ ((self.state.bend**2).sum(1) / self.state.h))

    @cached_property
    def length_forces(self) -> Array:
        """Derivative (m,) lambda of the energy by the own length of tubes up to each boundary, N."""
        problem, state = self.state.problem, self.state
        by_length = problem.in_section @ (problem.weight * state.by_local[:, -1])
        if state.loading is not None:
            count = 2 * len(problem.weight)
            by_length = by_length - state.factor * state.loading.first[count : count + len(problem.order)]
        return np.asarray(by_length @ problem.lengths_by_boundaries)


@lru_cache(maxsize=8)
def bundle_response(equilibrium: Equilibrium) -> BundleResponse:
    """Changes of an equilibrium of a bundle robot with its joint values.

    Raises:
        SolveError: the equilibrium is a fold.
    """
    if abs(equilibrium.margin) < LEAST_STIFFNESS:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
    point = point_of(equilibrium)
    return BundleResponse(point.member, point.state)


class BundleDerivatives:
    """Derivatives of an equilibrium of a bundle robot in Q directions; names as in `Jacobian`.

    Raises:
        InputError: `wrt` names another parameter than "rotations" or "translations".
    """

    def __init__(self, equilibrium: Equilibrium, wrt: Sequence[str] = JOINTS, along: Array | None = None) -> None:
        for name in wrt:
            if name not in JOINTS:
                raise InputError(f"wrt names {name!r}; of a bundle robot it may name {' and '.join(JOINTS)}")
        n = equilibrium.robot.n_tubes
        columns = np.eye(2 * n)[:, [JOINTS.index(name) * n + i for name in wrt for i in range(n)]]
        self.wrt, self._directions = tuple(wrt), columns if along is None else columns @ along
        self._of = bundle_response(equilibrium)

    @property
    def tip_position(self) -> Array:
        """Derivative (3, Q) of the tip position, m."""
        return np.asarray(self._of.tip[:3] @ self._directions)

    @property
    def tip_rotation(self) -> Array:
        """Turn (3, Q) of the tip frame about world axes, rad."""
        return np.asarray(self._of.tip[3:] @ self._directions)

    @property
    def tip_rotations(self) -> Array:
        """Derivative (n, Q) of theta at the ends of the tubes, rad."""
        return np.asarray(self._of.tip_rotations @ self._directions)

    @property
    def margin(self) -> Array:
        """Derivative (Q,) of the margin."""
        return np.asarray(self._of.margin @ self._directions)

    @property
    def energy(self) -> Array:
        """Derivative (Q,) of the elastic energy, J."""
        return np.asarray(self._of.energy @ self._directions)

    @property
    def position(self) -> Array:
        """Derivative (p, 3, Q) of the points of the shape at fixed arc lengths, m; of the last one, of the tip."""
        return np.asarray(self._of.position @ self._directions)

    @property
    def bend(self) -> Array:
        """Derivative (Q,) of `total_bend`, 1/m."""
        return np.asarray(self._of.bend @ self._directions)

    @property
    def total_bend(self) -> float:
        """Integral of the squared curvature, 1/m."""
        return self._of.total_bend
