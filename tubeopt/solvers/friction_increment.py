"""One increment of a robot whose tubes rub: the least of its energy and of what friction takes on the way there.

    x = argmin  E(x) + sum_r D_r |phi_r(x) - phi_r,before|
    <=>  grad E + P' lam = 0,   |lam| <= D,   lam = D sign(slip) where a row slips, no slip where it sticks

By Newton's method: every step solves the quadratic program of the energy's second-order model with the exact friction
(`sticking`). Where the energy itself is not convex, but is along what sticks, the same exchanges are tried from the
rows that stuck before, and their answer is taken only if it is a minimum by the inertia of the whole system.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ..block.transcription.contact import Contact, Rubbing, evaluate_contact
from ..block.transcription.second_variation import least
from ..typing import Array
from .newton import FLOW_STEPS, STRIDE, grown, shortened
from .settings import FRICTION_ITERATIONS, LAST_STEP, ROUND_OFF, STICK_CHANGES

# --- Sticking and slipping --------------------------------------------------------------------------------------------

# What sticks and what slips: a convex quadratic program with a bound on every multiplier.
#
# Rows of friction with a compliance A (positive definite), free slips b (what they would slip if nothing rubbed) and
# capacities D bear torques lam and slip by v = b - A lam so that
#
#     |lam| <= D,     v = 0 where |lam| < D,     v has the sign of lam where |lam| = D.
#
# Block principal pivoting exchanges all rows of the wrong kind at once (Judice and Pires, Computers & Operations
# Research 21 (1994)), from all rows slipping as if nothing rubbed; from all rows sticking it would go row by row. Where
# that goes in circles, the dual program, least 1/2 lam' A lam - b' lam within the capacities, is solved from there by
# an active set that goes down with every step, and so ends.

Signs = NDArray[np.int8]

SLIP_ROUND_OFF = 1e-12
"""Slip (rad) and fraction of the capacity that are round-off."""

# Block pivoting may cycle. Judice and Pires switch to single exchanges after ten such rounds; here the descent, which
# cannot cycle, is as fast, so that four are enough.
STICK_PATIENCE = 4
"""Exchanges between sticking and slipping without fewer wrong rows, after which pivoting counts as cycling."""


def stick_or_slip(
    compliance: Array, free: Array, capacity: Array, start: Signs, *, convex: bool = True
) -> tuple[Array, Signs] | None:
    """Torques (R,) and for every row the sign of its slip, 0 where it sticks; None where none were found, which only
    round-off can do where A is positive definite.

    Args:
        compliance: (R, R).   free: (R,) slips without friction.   capacity: (R,), above 0.   start: (R,) first guess.
        convex: whether A is positive definite.
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


def _by_descent(compliance: Array, free: Array, capacity: Array, near: Array) -> tuple[Array, Signs] | None:
    """The same from torques (R,) nearby: those inside go down to their least, then the one is freed that gains most."""
    torque = np.clip(near, -capacity, capacity)
    inside = np.abs(torque) < capacity
    for _ in range(STICK_CHANGES * (len(free) + 1)):
        rows = np.flatnonzero(inside)
        if len(rows):
            rest = free[rows] - compliance[rows] @ (torque * ~inside)
            target, failed = _solve(compliance[np.ix_(rows, rows)], rest)
            if failed:
                return None
            move, room = target - torque[rows], np.full(len(rows), np.inf)
            ahead = move != 0
            room[ahead] = (np.copysign(capacity[rows], move) - torque[rows])[ahead] / move[ahead]
            first = int(np.argmin(room))
            if room[first] < 1:
                torque[rows] += room[first] * move
                torque[rows[first]] = np.copysign(capacity[rows[first]], move[first])
                inside[rows[first]] = False
                continue
            torque[rows] = target
        wrong = np.where(inside, 0.0, -np.sign(torque) * (free - compliance @ torque))
        worst = int(np.argmax(wrong)) if len(wrong) else 0
        if not len(wrong) or wrong[worst] <= SLIP_ROUND_OFF:
            return torque, np.where(inside, 0, np.sign(torque)).astype(np.int8)
        inside[worst] = True
    return None


def _solve(matrix: Array, right: Array) -> tuple[Array, bool]:
    """Solution of a symmetric system, by Cholesky where it is positive definite; whether it is singular."""
    # Half the work of an indefinite factorisation, and nearly all matrices here are positive.
    _, x, failed = scipy.linalg.lapack.dposv(matrix, right)
    if failed:
        _, _, x, failed = scipy.linalg.lapack.dsysv(matrix, right)
    return x, failed != 0


FRICTION_TOLERANCE = 1e-9
"""Largest violation of what friction demands, as a slip (rad) or a part of the capacity, with which a state counts."""


@dataclass(frozen=True, eq=False)
class Increment:
    """A state after an increment.

    Attributes:
        state: where it is.   torque: (R,) that friction bears, N m.   signs: (R,) of the slip, 0 where a row sticks or
            has slid along the axis.
        heat: that friction took, J.   converged: whether it is a minimum, to round-off.
        contraction: largest ratio of successive steps with the same rows sticking.
        violation: of what friction demands, as a slip (rad) or a part of the capacity.
    """

    state: Rubbing
    torque: Array
    signs: Signs
    heat: float
    converged: bool
    contraction: float
    violation: float


@dataclass(frozen=True, eq=False)
class Model:
    """Second-order model of an energy: Newton's step without friction (X,), response (X, R) to torques of the rows,
    compliance (R, R) of the rows, and the number of negative eigenvalues of the Hessian."""

    step: Array
    response: Array
    compliance: Array
    negative: int


def model_of(rows: Array, gradient: Array, hessian: Array) -> Model | None:
    """The model for rows (R, X); None where the Hessian is singular."""
    right = np.column_stack([-gradient, rows.T])
    if not len(right):
        return Model(right[:, 0], right[:, 1:], rows @ right[:, 1:], 0)
    # One factorisation for Newton's step and the responses of all rows.
    _, solved, failed = scipy.linalg.lapack.dposv(hessian, right)
    negative = 0
    if failed:
        _, _, solved, failed = scipy.linalg.lapack.dsysv(hessian, right)
        if failed:
            return None
        negative = int((np.linalg.eigvalsh(hessian) < 0).sum())
    return Model(solved[:, 0], solved[:, 1:], rows @ solved[:, 1:], negative)


def choose(model: Model, free: Array, capacity: Array, signs: Signs | None) -> tuple[Array, Signs] | None:
    """Torques and signs of the rows for a model, from what they would slip without friction (R,); None where there are
    none, or where they make no minimum."""
    first = np.sign(free).astype(np.int8) if signs is None else signs
    result = stick_or_slip(model.compliance, free, capacity, first, convex=not model.negative)
    return result if result is not None and (not model.negative or _minimum(model, result[1])) else None


def _minimum(model: Model, signs: Signs) -> bool:
    """Whether the Hessian is positive along what sticks: by Haynsworth, what sticks must stop all that is negative."""
    stuck = np.flatnonzero(signs == 0)
    values = np.linalg.eigvalsh(model.compliance[np.ix_(stuck, stuck)]) if len(stuck) else np.zeros(0)
    return int((values < 0).sum()) == model.negative


class _Turned:
    """Rows that slide along the axis by zeta (rad, over the radius at which they rub) while they turn by v: friction
    takes D sqrt(v^2 + zeta^2), smooth in v, and bears lam = D v / sqrt(v^2 + zeta^2) about the axis.

    Newton's method on lam sqrt(v^2 + zeta^2) = D v in both, with lam kept within D, is at ease however small zeta is
    (Chan, Golub and Mulet, SIAM J. Sci. Comput. 20 (1999)).
    """

    def __init__(self, contact: Contact, slid: Array | None) -> None:
        slid = np.zeros(len(contact.capacity)) if slid is None else slid
        self.any = bool(slid.any())
        self.sharp, self.smooth = slid == 0 if self.any else slice(None), np.flatnonzero(slid)
        self.rows, self.capacity = contact.rows[self.sharp], contact.capacity[self.sharp]
        self.own, self.most, self.zeta = contact.rows[self.smooth], contact.capacity[self.smooth], slid[self.smooth]
        self.torque = np.zeros(len(self.smooth))

    def added(self, state: Rubbing, slip: Array) -> tuple[Array, Array]:
        """Gradient and Hessian of the energy with what these rows take."""
        size = np.hypot(slip[self.smooth], self.zeta)
        # d/dv of D sqrt(v^2 + zeta^2); the second derivative takes the torque in place of D v / size.
        self.pull = self.most * slip[self.smooth] / size
        self.stiffness = (self.most - self.torque * slip[self.smooth] / size) / size
        return (
            state.gradient + self.own.T @ self.pull,
            state.hessian + (self.own.T * self.stiffness) @ self.own,
        )

    def advance(self, step: Array) -> None:
        """The torques after a step of Newton's method."""
        self.torque = np.clip(self.pull + self.stiffness * (self.own @ step), -self.most, self.most)

    def whole(self, torque: Array, signs: Signs, slip: Array) -> tuple[Array, Signs, float]:
        """Torques and signs of all rows, and the heat, J."""
        all_torque, all_signs = np.zeros(len(slip)), np.zeros(len(slip), dtype=np.int8)
        size = np.hypot(slip[self.smooth], self.zeta)
        all_torque[self.sharp], all_signs[self.sharp] = torque, signs
        all_torque[self.smooth] = self.torque  # that of the slip would be its round-off over zeta
        heat = float(self.capacity @ np.abs(slip[self.sharp] * signs)) + float(self.most @ size)
        return all_torque, all_signs, heat


def increment(
    contact: Contact,
    rotations: Array,
    x: Array,
    before: Array,
    signs: Signs | None = None,
    slid: Array | None = None,
) -> Increment | None:
    """The state at base rotations (n,) near x, from relative rotations `before` (R,); None where none is close by.

    Args:
        signs: of what slips, for a first guess; by default what the energy's model without friction would do.
        slid: (R,) by how much rows slide along the axis, over the radius at which they rub, rad.
    """
    state, turned = evaluate_contact(contact, rotations, x), _Turned(contact, slid)
    last, contraction, kept = np.inf, 0.0, None
    signs = None if signs is None else signs[turned.sharp]
    # The set of sticking rows settles in a few steps; then Newton's method converges quadratically.
    for _ in range(FRICTION_ITERATIONS):
        slip = state.turned - before
        model = model_of(turned.rows, *turned.added(state, slip))
        if model is None:
            return None
        free = slip[turned.sharp] + turned.rows @ model.step
        result = choose(model, free, turned.capacity, signs if kept is None else kept)
        if result is None:
            return None
        torque, now = result
        step = model.step - model.response @ torque
        size = contact.turn_of(step)
        # Beyond half a turn the quadratic model says nothing about the energy.
        if not np.isfinite(size) or size > np.pi:
            return None
        state = evaluate_contact(contact, rotations, state.x + step)
        turned.advance(step)
        if size <= LAST_STEP:
            whole = turned.whole(torque, now, state.turned - before)
            # A step of round-off may still change much of the torque of what slides by little.
            tiny = size <= ROUND_OFF and not turned.any
            if tiny or imbalance(contact, state, whole[0]) <= ROUND_OFF:
                return _told(contact, state, whole, (before, slid), contraction)
        elif not turned.any and kept is not None and np.array_equal(now, kept):
            contraction = max(contraction, size / last)
        last, kept = size, now
    return None


def _told(
    contact: Contact,
    state: Rubbing,
    result: tuple[Array, Signs, float],
    history: tuple[Array, Array | None],
    contraction: float,
) -> Increment:
    (torque, signs, heat), (before, slid) = result, history
    slip = state.turned - before
    wrong = np.where(signs == 0, np.abs(slip), np.maximum(0.0, -slip * signs))
    if slid is not None:
        turns = np.abs(torque / contact.capacity * np.hypot(slip, slid) - slip)
        wrong = np.where(slid != 0, turns, wrong)
    wrong = np.maximum(wrong, np.maximum(0.0, np.abs(torque) / contact.capacity - 1))
    violation = float(wrong.max(initial=0.0))
    return Increment(state, torque, signs, heat, violation <= FRICTION_TOLERANCE, contraction, violation)


def imbalance(contact: Contact, state: Rubbing, torque: Array) -> float:
    """Largest violation of the equations of equilibrium, as an error of a rotation, rad."""
    return contact.turn_of(state.gradient + contact.rows.T @ torque)


def held_margin(contact: Contact, state: Rubbing, signs: Signs) -> float:
    """Least eigenvalue of the Hessian along what the sticking rows leave free, at most 1: how stable the state is as
    long as friction holds what it holds."""
    free = _free(contact, signs)
    return least(free.T @ state.hessian @ free)


def _free(contact: Contact, signs: Signs) -> Array:
    """(X, F) directions in which the sticking rows do not slip, of unit length and across each other."""
    stuck = contact.rows[signs == 0]
    if not len(stuck):
        return np.eye(stuck.shape[1])
    return np.asarray(scipy.linalg.qr(stuck.T, mode="full")[0][:, len(stuck) :])


SLOW, PATIENT, NEAR = 1e-4, 20, 1e-3
"""A step (rad) of a flow that may be at rest; steps between two looks whether it is; how far from there rest may be."""


def softest(contact: Contact, state: Rubbing, signs: Signs) -> Array:
    """Direction (X,) in which a state is softest without slip of what sticks; its largest turn is 1 rad."""
    free = _free(contact, signs)
    direction = free @ np.linalg.eigh(free.T @ state.hessian @ free)[1][:, 0]
    return np.asarray(direction / contact.turn_of(direction))


def slide(
    contact: Contact, rotations: Array, x: Array, before: Array, push: Array | None = None
) -> tuple[Increment, float] | None:
    """The flow of energy and friction down to where it comes to rest, and what friction took (J); None where that is
    not found. It begins at x, or beside it, on the side of +-`push` (X,) that is lower.

    Linearly implicit Euler steps in the norm of the torsional energy, each with exact friction from where the last one
    left it, which grow into those of Newton where the flow comes to rest.
    """
    starts = [x] if push is None else [x + push, x - push]
    sides = [evaluate_contact(contact, rotations, start) for start in starts]
    taken = [float(contact.capacity @ np.abs(side.turned - before)) for side in sides]
    lower = min(range(len(sides)), key=lambda k: sides[k].energy + taken[k])
    state, heat = sides[lower], taken[lower] if push is not None else 0.0
    before = state.turned if push is not None else before
    delay, turn, signs = 1.0, np.inf, None
    for count in range(FLOW_STEPS):
        # At rest the flow is left to Newton's method, which also finds what friction alone holds; where the flow only
        # creeps past a state that was lost, that finds nothing near, and the flow goes on.
        if turn < SLOW and (delay > 1e6 or count % PATIENT == 0):
            last = increment(contact, rotations, state.x, before, signs)
            if last is not None and last.converged and contact.turn_of(last.state.x - state.x) < NEAR:
                return last, heat + last.heat
        model = model_of(contact.rows, state.gradient, state.hessian + np.eye(len(x)) / delay)
        result = None
        # Where friction holds what the energy alone would not, from what stuck in the step before.
        if model is not None and (not model.negative or signs is not None):
            free = state.turned - before + contact.rows @ model.step
            result = choose(model, free, contact.capacity, signs if model.negative else None)
        if model is None or result is None:
            delay *= 0.25
            continue
        move = model.step - model.response @ result[0]
        turn = contact.turn_of(move)
        if turn > STRIDE:
            delay *= shortened(turn)
            continue
        trial = evaluate_contact(contact, rotations, state.x + move)
        spent, owed = (float(contact.capacity @ np.abs(at.turned - before)) for at in (trial, state))
        if trial.energy + spent > state.energy + owed + 1e-13 * _scale(contact, state):
            delay *= 0.25
            continue
        state, before, heat, signs = trial, trial.turned, heat + spent, result[1]
        delay = grown(delay, turn)
    return None


def _scale(contact: Contact, state: Rubbing) -> float:
    """The energies whose round-off is that of their sum, J."""
    work = 0.0 if contact.loaded is None else abs(state.elastic.potential - state.elastic.energy)
    return contact.problem.energy_parts + abs(state.energy) + work
