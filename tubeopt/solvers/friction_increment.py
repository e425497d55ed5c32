"""Increment of a robot with friction between its tubes: minimum of its energy and the heat of friction.

    x = argmin  E(x) + sum_r D_r |phi_r(x) - phi_r,before|
    <=>  grad E + P' lam = 0,   |lam| <= D,   lam = D sign(slip) where a row slips, no slip where it sticks

Newton's method: every step solves a quadratic program, the second-order model of the energy with the exact friction
(`stick_or_slip`). If the energy is not convex, but is along the sticking rows, the exchanges start from the rows that
stuck before. Their result is accepted only if it is a minimum, by the inertia of the whole system.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ..block.transcription.contact import BundleContact, Contact, ContactState
from ..block.transcription.second_variation import least
from ..typing import Array
from .box_minimum import minimum_in_box
from .newton import flow
from .settings import FRICTION_ITERATIONS, LAST_STEP, NEWTON_ROUND_OFF

# --- Sticking and slipping --------------------------------------------------------------------------------------------

# A convex quadratic program with a bound on every multiplier decides which rows stick.
#
# Rows of friction with a compliance A (positive definite), slips b without friction and capacities D have torques lam
# and slips v = b - A lam so that
#
#     |lam| <= D,     v = 0 where |lam| < D,     v has the sign of lam where |lam| = D.
#
# Block principal pivoting exchanges all wrong rows at once (Judice and Pires, Computers & Operations Research 21
# (1994)). It starts with all rows slipping as without friction; from all rows sticking it would go row by row. If it
# cycles, the dual program, minimum of 1/2 lam' A lam - b' lam within the capacities, is solved from there by an active
# set method that decreases with every step, and so ends.

Signs = NDArray[np.int8]

SLIP_ROUND_OFF = 1e-12
"""Slip (rad), and fraction of the capacity, below which a violation is round-off."""

# Block pivoting may cycle. Judice and Pires switch to single exchanges after ten such rounds; here the descent, which
# cannot cycle, is as fast, so that four are enough.
STICK_PATIENCE = 4
"""Number of exchanges without fewer wrong rows after which pivoting counts as cycling."""


def stick_or_slip(
    compliance: Array, free: Array, capacity: Array, start: Signs, *, convex: bool = True
) -> tuple[Array, Signs] | None:
    """Torques (R,), and signs (R,) of the slips, 0 for rows that stick.

    None if there is no solution; with a positive definite compliance only round-off can cause this.

    Args:
        compliance: A (R, R).   free: slips (R,) without friction.   capacity: (R,), above 0.   start: first signs (R,).
        convex: True if A is positive definite.
    """
    signs, fewest, patience = start.copy(), len(free) + 1, STICK_PATIENCE
    while True:
        torque = capacity * signs
        stuck = np.flatnonzero(signs == 0)
        slip = free - compliance @ torque
        if len(stuck):
            torque[stuck], failed = _solve(compliance[np.ix_(stuck, stuck)], slip[stuck])
            if failed:
                return None
            slip -= compliance[:, stuck] @ torque[stuck]
            slip[stuck] = 0.0
        over = (signs == 0) & (np.abs(torque) > capacity * (1 + SLIP_ROUND_OFF))
        back = slip * signs < -SLIP_ROUND_OFF
        count = int(np.count_nonzero(over | back))
        if not count:
            return torque, signs
        patience = STICK_PATIENCE if count < fewest else patience - 1
        if patience < 0:
            return _by_descent(compliance, free, capacity, torque) if convex else None
        fewest = min(fewest, count)
        signs[back] = 0
        signs[over] = np.sign(torque[over])


def _by_descent(compliance: Array, free: Array, capacity: Array, start: Array) -> tuple[Array, Signs] | None:
    """`stick_or_slip` from torques (R,): they have least energy within their capacities."""
    try:
        least = minimum_in_box(
            compliance, -free, (-capacity, capacity), start, solve=_regular_solution, round_off=SLIP_ROUND_OFF
        )
    except np.linalg.LinAlgError:
        return None
    if least is None:
        return None
    return least.x, np.where(least.inside, 0, np.sign(least.x)).astype(np.int8)


def _regular_solution(matrix: Array, right: Array) -> Array:
    """`_solve`; raises LinAlgError for a singular matrix."""
    x, failed = _solve(matrix, right)
    if failed:
        raise np.linalg.LinAlgError
    return x


def _solve(matrix: Array, right: Array) -> tuple[Array, bool]:
    """Solution of a symmetric system, and True if it is singular."""
    # Cholesky first: it takes half the work of an indefinite factorisation, and nearly all matrices are positive.
    _, x, failed = scipy.linalg.lapack.dposv(matrix, right)
    if failed:
        _, _, x, failed = scipy.linalg.lapack.dsysv(matrix, right)
    return x, failed != 0


FRICTION_TOLERANCE = 1e-9
"""Largest violation of the friction conditions of a converged state, as a slip (rad) or fraction of the capacity."""


@dataclass(frozen=True, eq=False)
class Increment:
    """Friction state after an increment of joints or load."""

    state: ContactState
    torque: Array
    """Friction torques (R,) of the rows, N m."""
    signs: Signs
    """Signs (R,) of the slips, 0 for rows that stick or have slid along the axis."""
    heat: float
    """Heat of friction, J."""
    converged: bool
    """True if the state is a minimum to round-off."""
    contraction: float
    """Largest ratio of successive steps with the same rows sticking."""
    violation: float
    """Largest violation of the friction conditions, as a slip (rad) or fraction of the capacity."""


@dataclass(frozen=True, eq=False)
class FrictionModel:
    """Quadratic model of an energy, with its response to friction torques of the rows."""

    step: Array
    """Newton step (X,) without friction."""
    response: Array
    """Change (X, R) of the unknowns by torques of the rows."""
    compliance: Array
    """Compliance (R, R) of the rows."""
    negative: int
    """Number of negative eigenvalues of the Hessian."""


def model_of(rows: Array, gradient: Array, hessian: Array) -> FrictionModel | None:
    """Model for rows (R, X); None if the Hessian is singular."""
    right = np.column_stack([-gradient, rows.T])
    if not len(right):
        return FrictionModel(right[:, 0], right[:, 1:], rows @ right[:, 1:], 0)
    # One factorisation for Newton's step and the responses of all rows.
    _, solved, failed = scipy.linalg.lapack.dposv(hessian, right)
    negative = 0
    if failed:
        _, _, solved, failed = scipy.linalg.lapack.dsysv(hessian, right)
        if failed:
            return None
        negative = int((np.linalg.eigvalsh(hessian) < 0).sum())
    return FrictionModel(solved[:, 0], solved[:, 1:], rows @ solved[:, 1:], negative)


def choose(model: FrictionModel, free: Array, capacity: Array, signs: Signs | None) -> tuple[Array, Signs] | None:
    """Torques and signs of the rows for a model, from slips without friction (R,); None without a minimum."""
    first = np.sign(free).astype(np.int8) if signs is None else signs
    result = stick_or_slip(model.compliance, free, capacity, first, convex=not model.negative)
    if result is None or not model.negative:
        return result
    # Haynsworth: the Hessian is positive along the sticking rows if their compliance has all its negative eigenvalues.
    stuck = np.flatnonzero(result[1] == 0)
    values = np.linalg.eigvalsh(model.compliance[np.ix_(stuck, stuck)]) if len(stuck) else np.zeros(0)
    return result if int((values < 0).sum()) == model.negative else None


class RowForces(NamedTuple):
    """Friction torques of all rows."""

    torque: Array
    """Torques (R,), N m."""
    signs: Signs
    """Signs (R,) of the slips, 0 for rows that stick or slide along the axis."""
    heat: float
    """Heat of friction, J."""


class _SlidingRows:
    """Rows that slide along the axis by zeta (rad, over their friction radius) while they turn by v.

    Friction takes the heat D sqrt(v^2 + zeta^2), smooth in v, and its torque is lam = D v / sqrt(v^2 + zeta^2).
    Newton's method on lam sqrt(v^2 + zeta^2) = D v in both unknowns, with lam kept within D, converges however small
    zeta is (Chan, Golub and Mulet, SIAM J. Sci. Comput. 20 (1999)).
    """

    def __init__(self, state: ContactState, slid: Array | None) -> None:
        slid = np.zeros(len(state.capacity)) if slid is None else slid
        self.any = bool(slid.any())
        self.sharp, self.smooth = slid == 0 if self.any else slice(None), np.flatnonzero(slid)
        self.zeta = slid[self.smooth]
        self.torque = np.zeros(len(self.smooth))

    def added(self, state: ContactState, slip: Array) -> tuple[Array, Array]:
        """Gradient and Hessian of the energy with the heat of these rows; all rows are those of the state."""
        self.rows, self.capacity = state.rows[self.sharp], state.capacity[self.sharp]
        self.smooth_rows, self.limit = state.rows[self.smooth], state.capacity[self.smooth]
        size = np.hypot(slip[self.smooth], self.zeta)
        # d/dv of D sqrt(v^2 + zeta^2); the second derivative takes the torque in place of D v / size.
        self.slope = self.limit * slip[self.smooth] / size
        self.stiffness = (self.limit - self.torque * slip[self.smooth] / size) / size
        return (
            state.gradient + self.smooth_rows.T @ self.slope,
            state.hessian + (self.smooth_rows.T * self.stiffness) @ self.smooth_rows,
        )

    def advance(self, step: Array) -> None:
        """Update the torques after a step of Newton's method."""
        torque = self.slope + self.stiffness * (self.smooth_rows @ step)
        self.torque = np.clip(torque, -self.limit, self.limit)

    def all_rows(self, torque: Array, signs: Signs, slip: Array) -> RowForces:
        """Friction of all rows, from the torques and signs of the rows without axial sliding."""
        all_torque, all_signs = np.zeros(len(slip)), np.zeros(len(slip), dtype=np.int8)
        size = np.hypot(slip[self.smooth], self.zeta)
        all_torque[self.sharp], all_signs[self.sharp] = torque, signs
        all_torque[self.smooth] = self.torque  # computed from the slip, it would be round-off over zeta
        heat = float(self.capacity @ np.abs(slip[self.sharp] * signs)) + float(self.limit @ size)
        return RowForces(all_torque, all_signs, heat)


def increment(
    contact: Contact | BundleContact,
    rotations: Array,
    x: Array,
    before: Array,
    signs: Signs | None = None,
    slid: Array | None = None,
) -> Increment | None:
    """State at base rotations (n,) near x, from relative rotations `before` (R,); None without one nearby.

    Args:
        signs: first signs of the slips; by default those of the energy's model without friction.
        slid: slide (R,) of the rows along the axis over their friction radius, rad.
    """
    state = contact.evaluate(rotations, x)
    sliding = _SlidingRows(state, slid)
    last, contraction, previous = np.inf, 0.0, None
    signs = None if signs is None else signs[sliding.sharp]
    # The set of sticking rows settles in a few steps; then Newton's method converges quadratically.
    for _ in range(FRICTION_ITERATIONS):
        slip = state.relative_rotations - before
        gradient, hessian = sliding.added(state, slip)
        model = model_of(sliding.rows, gradient, hessian)
        if model is None:
            return None
        free = slip[sliding.sharp] + sliding.rows @ model.step
        result = choose(model, free, sliding.capacity, signs if previous is None else previous)
        if result is None:
            return None
        torque, current = result
        step = model.step - model.response @ torque
        size = contact.largest_rotation(step)
        # Beyond half a turn the quadratic model says nothing about the energy.
        if not np.isfinite(size) or size > np.pi:
            return None
        state = contact.moved(rotations, state, step)
        if state.contact is not contact:  # boundaries stay together from here on
            return None
        sliding.advance(step)
        if size <= LAST_STEP:
            slip = state.relative_rotations - before
            forces = sliding.all_rows(torque, current, slip)
            # After a step of round-off, torques of rows with a small slide may still change.
            tiny = size <= NEWTON_ROUND_OFF and not sliding.any
            if tiny or imbalance(state, forces.torque) <= NEWTON_ROUND_OFF:
                wrong = np.where(forces.signs == 0, np.abs(slip), np.maximum(0.0, -slip * forces.signs))
                if slid is not None:
                    # lam sqrt(v^2 + zeta^2) = D v for rows that slide along the axis.
                    turns = np.abs(forces.torque / state.capacity * np.hypot(slip, slid) - slip)
                    wrong = np.where(slid != 0, turns, wrong)
                wrong = np.maximum(wrong, np.maximum(0.0, np.abs(forces.torque) / state.capacity - 1))
                violation = float(wrong.max(initial=0.0))
                if contact.linear or violation <= FRICTION_TOLERANCE:
                    return Increment(state, *forces, violation <= FRICTION_TOLERANCE, contraction, violation)
        elif not sliding.any and previous is not None and np.array_equal(current, previous):
            contraction = max(contraction, size / last)
        last, previous = size, current
    return None


def imbalance(state: ContactState, torque: Array) -> float:
    """Largest violation of the equations of equilibrium, as an error of a rotation, rad."""
    return state.contact.largest_rotation(state.gradient + state.rows.T @ torque)


def held_margin(state: ContactState, signs: Signs) -> float:
    """Margin while the sticking rows stick: smallest eigenvalue of the Hessian on their null space, at most 1."""
    form, rows = state.contact.form(state)
    free = _free(rows[signs == 0])
    return least(free.T @ form @ free)


def _free(stuck: Array) -> Array:
    """Orthonormal directions (X, F) without slip of sticking rows (S, X)."""
    if not len(stuck):
        return np.eye(stuck.shape[1])
    return np.asarray(scipy.linalg.qr(stuck.T, mode="full")[0][:, len(stuck) :])


SLOW, PATIENT, NEAR = 1e-4, 20, 1e-3
"""Step (rad) below which a flow may be at rest, number of steps between two checks, and distance (rad) of the rest."""


def softest(state: ContactState, signs: Signs) -> Array:
    """Softest direction (X,) of a state without slip of the sticking rows; its largest turn is 1 rad."""
    free = _free(state.rows[signs == 0])
    direction = free @ np.linalg.eigh(free.T @ state.hessian @ free)[1][:, 0]
    return np.asarray(direction / state.contact.largest_rotation(direction))


class _Slid(NamedTuple):
    """State of a flow with friction."""

    state: ContactState
    before: Array
    """Relative rotations (R,) that slips are measured from."""
    heat: float
    """Heat of the flow, J."""
    signs: Signs | None = None
    """Signs of the slips of the last step."""


class _Slip(NamedTuple):
    step: Array
    signs: Signs


class Rest(NamedTuple):
    """End of a flow with friction."""

    increment: Increment
    heat: float
    """Heat of the flow, J."""


def slide(
    contact: Contact | BundleContact, rotations: Array, x: Array, before: Array, push: Array | None = None
) -> Rest | None:
    """State of rest of the energy flow with friction; None if it is not found.

    The flow starts at x, or at the lower of x +- `push` (X,). Each step of `newton.flow` has exact friction from the
    last state.
    """

    def heat_to(state: ContactState, before: Array) -> float:
        return float(state.capacity @ np.abs(state.relative_rotations - before))

    def step(at: _Slid, time: float) -> _Slip | None:
        model = model_of(at.state.rows, at.state.gradient, at.state.hessian + np.eye(len(at.state.x)) / time)
        # If the energy is not convex, the rows that stuck in the last step may still hold the state.
        if model is None or (model.negative and at.signs is None):
            return None
        free = at.state.relative_rotations - at.before + at.state.rows @ model.step
        result = choose(model, free, at.state.capacity, at.signs if model.negative else None)
        return None if result is None else _Slip(model.step - model.response @ result[0], result[1])

    def moved(at: _Slid, slip: _Slip) -> _Slid | None:
        state = at.state
        trial = state.contact.moved(rotations, state, slip.step)
        if not np.isfinite(trial.energy):
            return None
        # Where boundaries stay together from now on, there are fewer rows: they are measured from the same material.
        same = trial.contact is state.contact
        heat = heat_to(trial, at.before if same else np.zeros(len(trial.rows)))
        risen = trial.energy + heat > state.energy + heat_to(state, at.before) + 1e-13 * state.contact.round_off(state)
        if risen:
            return None
        return _Slid(*trial.contact.renewed(trial), at.heat + heat, slip.signs if same else None)

    def rest(at: _Slid, turn: float, time: float, count: int) -> Rest | None:
        # Near rest Newton's method takes over, which also finds states that only friction holds. If the flow merely
        # creeps past a lost state, it finds nothing nearby, and the flow continues.
        if turn >= SLOW or (time <= 1e6 and count % PATIENT):
            return None
        contact = at.state.contact
        last = increment(contact, rotations, at.state.x, at.before, at.signs)
        if last is None or not last.converged or contact.largest_rotation(last.state.x - at.state.x) >= NEAR:
            return None
        return Rest(last, at.heat + last.heat)

    starts = [x] if push is None else [x + push, x - push]
    start = min(
        (contact.evaluate(rotations, side) for side in starts),
        key=lambda side: side.energy + heat_to(side, before),
    )
    # A push turns work into heat at once, as a step does.
    first = _Slid(start, before, 0.0) if push is None else _Slid(*contact.renewed(start), heat_to(start, before))
    return flow(first, step, lambda at, slip: at.state.contact.largest_rotation(slip.step), moved, rest)
