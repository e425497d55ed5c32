"""One increment of a robot whose tubes rub: the least of its energy and of what friction takes on the way there.

    x = argmin  E(x) + sum_r D_r |phi_r(x) - phi_r,before|
    <=>  grad E + P' lam = 0,   |lam| <= D,   lam = D sign(slip) where a row slips, no slip where it sticks

By Newton's method: every step solves the quadratic program of the energy's second-order model with the exact friction
(`sticking`). Where the energy itself is not convex, but is along what sticks, the same exchanges are tried from the rows
that stuck before, and their answer is taken only if it is a minimum by the inertia of the whole system.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..transcription.contact import Contact, Rubbing, evaluate_contact
from ..typing import Array
from .settings import NEWTON
from .sticking import Signs, stick_or_slip

ITERATIONS = 15

HONEST = 1e-9
"""Largest violation of what friction demands, as a slip (rad) or a part of the capacity, with which a state counts."""


@dataclass(frozen=True, eq=False)
class Increment:
    """A state after an increment.

    Attributes:
        state: where it is.   torque: (R,) that friction bears, N m.   signs: (R,) of the slip, 0 where a row sticks.
        slip: (R,) rad, in this increment.   converged: whether it is a minimum, to round-off.
        contraction: largest ratio of successive steps with the same rows sticking.
        violation: of what friction demands, as a slip (rad) or a part of the capacity.
    """

    state: Rubbing
    torque: Array
    signs: Signs
    slip: Array
    converged: bool
    contraction: float
    violation: float


@dataclass(frozen=True, eq=False)
class Model:
    """Second-order model of the energy at a state: Newton's step without friction (X,), response (X, R) to torques of the
    rows, compliance (R, R) of the rows, and the number of negative eigenvalues of the Hessian."""

    step: Array
    response: Array
    compliance: Array
    negative: int


def model_of(contact: Contact, state: Rubbing, shift: float = 0.0) -> Model | None:
    """The model, with `shift` added to the Hessian; None where that is singular."""
    hessian = state.hessian
    if shift:
        hessian = hessian + shift * np.eye(len(hessian))
    right = np.column_stack([-state.gradient, contact.rows.T])
    _, solved, failed = scipy.linalg.lapack.dposv(hessian, right)
    negative = 0
    if failed:
        _, _, solved, failed = scipy.linalg.lapack.dsysv(hessian, right)
        if failed:
            return None
        negative = int((np.linalg.eigvalsh(hessian) < 0).sum())
    return Model(solved[:, 0], solved[:, 1:], contact.rows @ solved[:, 1:], negative)


def choose(contact: Contact, model: Model, slip: Array, signs: Signs | None) -> tuple[Array, Signs] | None:
    """Torques and signs of the rows for a model, from what slipped until now (R,); None where there are none."""
    free = slip + contact.rows @ model.step
    first = np.sign(free).astype(np.int8) if signs is None else signs
    found = stick_or_slip(model.compliance, free, contact.capacity, first, convex=not model.negative)
    return found if found is not None and (not model.negative or _minimum(model, found[1])) else None


def _minimum(model: Model, signs: Signs) -> bool:
    """Whether the Hessian is positive along what sticks: by Haynsworth, what sticks must stop all that is negative."""
    stuck = np.flatnonzero(signs == 0)
    values = np.linalg.eigvalsh(model.compliance[np.ix_(stuck, stuck)]) if len(stuck) else np.zeros(0)
    return int((values < 0).sum()) == model.negative


def increment(
    contact: Contact, rotations: Array, x: Array, before: Array, signs: Signs | None = None
) -> Increment | None:
    """The state at base rotations (n,) near x, from relative rotations `before` (R,); None where there is none close by.

    Args:
        signs: of what slips, for a first guess; by default what the energy's model without friction would do.
    """
    state = evaluate_contact(contact, rotations, x)
    last, contraction, kept = np.inf, 0.0, None
    for _ in range(ITERATIONS):
        model = model_of(contact, state)
        if model is None:
            return None
        found = choose(contact, model, state.turned - before, signs if kept is None else kept)
        if found is None:
            return None
        torque, now = found
        step = model.step - model.response @ torque
        size = turn_of(contact, step)
        if not np.isfinite(size) or size > np.pi:
            return None
        state = evaluate_contact(contact, rotations, state.x + step)
        same = kept is not None and np.array_equal(now, kept)
        if size <= NEWTON.last_step and (size <= NEWTON.round_off or imbalance(contact, state, torque) <= NEWTON.round_off):
            return _told(contact, state, found, before, contraction)
        if same and size > NEWTON.last_step:
            contraction = max(contraction, size / last)
        last, kept = size, now
    return None


def _told(
    contact: Contact, state: Rubbing, found: tuple[Array, Signs], before: Array, contraction: float
) -> Increment:
    torque, signs = found
    slip = state.turned - before
    wrong = np.where(signs == 0, np.abs(slip), np.maximum(0.0, -slip * signs))
    wrong = np.maximum(wrong, np.maximum(0.0, np.abs(torque) / contact.capacity - 1))
    violation = float(wrong.max(initial=0.0))
    slip = np.where(signs == 0, 0.0, slip)
    return Increment(state, torque, signs, slip, violation <= HONEST, contraction, violation)


def turn_of(contact: Contact, step: Array) -> float:
    """Largest change of a rotation that a step in x makes, rad."""
    inside = contact.problem.factor @ step[: contact.problem.size]
    between = contact.known @ step[: contact.problem.size] + contact.loose @ step[contact.problem.size :]
    return float(max(np.abs(inside).max(initial=0.0), np.abs(between).max(initial=0.0)))


def imbalance(contact: Contact, state: Rubbing, torque: Array) -> float:
    """Largest violation of the equations of equilibrium, as an error of a rotation, rad."""
    return turn_of(contact, state.gradient + contact.rows.T @ torque)


def held_margin(contact: Contact, state: Rubbing, signs: Signs) -> float:
    """Least eigenvalue of the Hessian along what the sticking rows leave free, at most 1: how stable the state is as long
    as friction holds what it holds."""
    stuck = contact.rows[signs == 0]
    if not len(stuck):
        return least(state.hessian)
    if len(stuck) >= stuck.shape[1]:
        return 1.0
    free = scipy.linalg.qr(stuck.T, mode="full")[0][:, len(stuck) :]
    return least(free.T @ state.hessian @ free)


def least(matrix: Array) -> float:
    """Least eigenvalue of a symmetric matrix, at most 1."""
    if not len(matrix):
        return 1.0
    return min(1.0, float(scipy.linalg.lapack.dsyevr(matrix, compute_v=0, range="I", il=1, iu=1)[0][0]))


STRIDE = 0.1
"""Largest turn (rad) of a point in one step downhill."""

MOST_STEPS = 2000


def softest(contact: Contact, state: Rubbing, signs: Signs) -> Array:
    """Direction (X,) in which a state is softest without slip of what sticks; its largest turn is 1 rad."""
    free = np.eye(len(state.x))
    stuck = contact.rows[signs == 0]
    if len(stuck):
        free = scipy.linalg.qr(stuck.T, mode="full")[0][:, len(stuck) :]
    direction = free @ np.linalg.eigh(free.T @ state.hessian @ free)[1][:, 0]
    return np.asarray(direction / turn_of(contact, direction))


def slide(
    contact: Contact, rotations: Array, x: Array, before: Array, push: Array
) -> tuple[Increment, float] | None:
    """The flow of energy and friction down to where it comes to rest, and what friction took (J); None where that is not
    found. It begins beside x, on the side of +-`push` (X,) that is lower.

    Linearly implicit Euler steps in the norm of the torsional energy, each with exact friction from where the last one
    left it, which grow into those of Newton where the flow comes to rest.
    """
    sides = [evaluate_contact(contact, rotations, x + side) for side in (push, -push)]
    state = min(sides, key=lambda side: side.torsion.energy + float(contact.capacity @ np.abs(side.turned - before)))
    delay, heat = 1.0, 0.0
    for _ in range(MOST_STEPS):
        model = model_of(contact, state, 1 / delay)
        found = None if model is None or model.negative else choose(contact, model, state.turned - before, None)
        if model is None or found is None:
            delay *= 0.25
            continue
        move = model.step - model.response @ found[0]
        turn = turn_of(contact, move)
        if turn > STRIDE:
            delay *= max(0.1, 0.8 * STRIDE / turn)
            continue
        trial = evaluate_contact(contact, rotations, state.x + move)
        taken = float(contact.capacity @ np.abs(trial.turned - before))
        owed = float(contact.capacity @ np.abs(state.turned - before))
        if trial.torsion.energy + taken > state.torsion.energy + owed + 1e-13 * _scale(contact, state):
            delay *= 0.25
            continue
        if turn < 1e-6 and delay > 1e6:
            # Where the flow only creeps past a state that was lost, Newton's method finds nothing: it goes on.
            last = increment(contact, rotations, state.x, before, found[1])
            if last is not None and last.converged and turn_of(contact, last.state.x - state.x) < 1e-3:
                return last, heat + float(contact.capacity @ np.abs(last.slip))
        state, before, heat = trial, trial.turned, heat + taken
        delay = min(delay * min(3.0, max(1.0, 0.8 * STRIDE / max(turn, 1e-12))), 1e12)
    return None


def _scale(contact: Contact, state: Rubbing) -> float:
    """The energies whose round-off is that of their sum, J."""
    problem = contact.problem
    parts = (state.torsion.moment**2).sum(1) / np.maximum(problem.stiffness.sum(1), 1e-300)
    return float(problem.weight @ parts) + abs(state.torsion.energy)
