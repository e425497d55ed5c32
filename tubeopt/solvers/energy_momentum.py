"""Motion of a system with inertia, damping and an energy, by an energy-momentum method with discrete gradients.

The kinetic energy is V' M V / 2 of the rates V of coordinates w(y) that depend on the unknowns. A step h from 0 to 1 is

    (V_1 + V_0) / 2 = (w_1 - w_0) / h
    J' [M (V_1 - V_0) / h - f] + G + D (y_1 - y_0) / h = 0,

with a discrete Jacobian J and a discrete gradient G of the energy E (Gonzalez, J. Nonlinear Sci. 6 (1996)): those at
the middle, plus a multiple of the step for which exactly J (y_1 - y_0) = w_1 - w_0 and G.(y_1 - y_0) = E_1 - E_0. The
step times the equation then is the balance of energy: kinetic, elastic, work of the load f, and the dissipated
(y_1 - y_0)' D (y_1 - y_0) / h. Dry friction of capacity c at relative rates g = R (y_1 - y_0) / h adds the term
R' c g / (g^2 + e^2)^(1/2), and dissipates the work of it. The balance holds for any step length, to the residual of
Newton's method; the motion is accurate to second order. Simo and Tarnow (Z. angew. Math. Phys. 43 (1992)) found such
steps for elastic bodies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy

from ..errors import SolveError
from ..physics.dynamics import DryFriction
from ..typing import Array
from .time_limit import check_time


class MovingSystem(Protocol):
    """System with coordinates w (W,) of its kinetic energy and unknowns y (Y,), of which the last are prescribed."""

    @property
    def mass(self) -> Array:
        """Mass matrix (W, W)."""

    @property
    def force(self) -> Array:
        """Dead load (W,)."""

    @property
    def friction(self) -> DryFriction:
        """Friction."""

    def at(self, y: Array) -> Any:
        """State with `position` w (W,), elastic `energy` and its `gradient` (Y,)."""

    def slopes(self, y: Array) -> Any:
        """Derivative `position` (W, Y) of w, `stiffness` (X, X) of the energy, and `damping` (Y, Y)."""


@dataclass(frozen=True, eq=False)
class Instant:
    """State of a motion at a time."""

    time: float
    y: Array
    position: Array
    """Coordinates w (W,)."""
    velocity: Array
    """Rates V (W,) of w."""
    elastic: float
    """Elastic energy, J."""
    kinetic: float
    """Kinetic energy, J."""
    dissipated: float
    """Energy dissipated since the start, J."""
    load_work: float
    """Work of the dead load since the start, J."""
    drive_work: float
    """Work of the prescribed coordinates since the start, J."""


# A step that grows more slowly has a smooth error, and one that is tried again halves it by an eighth.
GROWTH = 1.5
"""Largest ratio of a step to the one before."""

SAFETY = 0.8
"""Ratio of the next step to the one whose error is expected to be the tolerance."""

ITERATIONS = 12
"""Largest number of Newton iterations of a step, with the matrix of its start."""

BALANCED = 1e-10
"""Energy that a step may leave unbalanced, as a fraction of the energy of the motion."""

# Steps below have no effect on the state but round-off.
SHORTEST = 1e-12
"""Shortest step, s."""


class _Step(NamedTuple):
    """Step that was solved."""

    change: Array
    instant: Instant


def motion(
    system: MovingSystem, start: Array, rates: Array, *, scale: float, tolerance: float, first: float
) -> Iterator[Instant]:
    """Instants of the motion from rest at y (Y,), the first included; it never ends by itself.

    Args:
        rates: rates (P,) of the prescribed coordinates, the last of y, which start at once.
        scale: energy of the motion, J.
        tolerance: error of a step, in the norm of x, over the root of `scale`.
        first: first step, s.

    Raises:
        SolveError: a step fails at any length.
    """
    free, prescribed = len(start) - len(rates), np.zeros(len(start))
    prescribed[free:] = rates
    state = system.at(start)
    velocity = system.slopes(start).position @ prescribed
    kinetic = float(velocity @ system.mass @ velocity) / 2
    now = Instant(
        time=0.0,
        y=start,
        position=state.position,
        velocity=velocity,
        elastic=state.energy,
        kinetic=kinetic,
        dissipated=0.0,
        load_work=0.0,
        drive_work=0.0,
    )
    yield now
    h, mean, slope, before = first, prescribed, np.zeros(len(start)), 0.0
    error_scale = tolerance * np.sqrt(scale)
    while True:
        check_time()
        # The velocity in the middle of the last step, and its rate, predict the step.
        guess = h * (mean + (h + before) / 2 * slope)
        guess[free:] = h * rates
        result = _step(system, now, guess, h, free, BALANCED * scale, error_scale / 10)
        error = np.inf if result is None else float(np.linalg.norm((result.change - guess)[:free]))
        if result is None or (error > 8 * error_scale and before):
            h /= 2
            if h < SHORTEST:
                raise SolveError(f"the motion cannot be continued beyond {1e3 * now.time:g} ms: no step converges")
            continue
        latest = result.change / h
        slope = (latest - mean) / ((h + before) / 2) if before else np.zeros(len(start))
        mean, before, now = latest, h, result.instant
        h *= min(GROWTH, max(1 / GROWTH, SAFETY * (error_scale / max(error, 1e-300)) ** (1 / 3)))
        yield now


def _step(
    system: MovingSystem, now: Instant, guess: Array, h: float, free: int, unbalanced: float, tolerance: float
) -> _Step | None:
    """Step of length h from an instant, by Newton's method from `guess` (Y,); None if it does not converge.

    Args:
        free: number of unknowns; the other coordinates are prescribed.
        unbalanced: largest energy that remains unbalanced, J.
        tolerance: largest last step of Newton's method.
    """
    slopes = system.slopes(now.y + guess / 2)
    jacobian, damping, mass = slopes.position, slopes.damping, system.mass
    inertia = jacobian[:, :free].T @ (mass @ jacobian[:, :free])
    matrix = 2 / h**2 * inertia + slopes.stiffness / 2 + damping[:free, :free] / h
    friction, rows = system.friction, system.friction.rows[:, :free]
    # Close to the fold a long step may make it indefinite.
    factors, pivots, _ = scipy.linalg.lapack.dgetrf(matrix)
    change = guess.copy()
    for _ in range(ITERATIONS):
        slip = friction.rows @ change
        resisting, slope = friction.at(slip / h)
        if len(rows):
            # Friction changes its sign within a step, unlike all other forces.
            factors, pivots, _ = scipy.linalg.lapack.dgetrf(matrix + rows.T @ ((slope / h)[:, None] * rows))
        after, middle = system.at(now.y + change), system.at(now.y + change / 2)
        moved, square = after.position - now.position, float(change[:free] @ change[:free])
        velocity = 2 * moved / h - now.velocity
        push = mass @ ((velocity - now.velocity) / h) - system.force
        # The discrete Jacobian and gradient: those at the middle, corrected along the step.
        along = (moved - jacobian @ change) @ push + after.energy - now.elastic - middle.gradient @ change
        balance = jacobian.T @ push + middle.gradient + damping @ change / h + friction.rows.T @ resisting
        balance[:free] += change[:free] * (along / square if square else 0.0)
        step = scipy.linalg.lapack.dgetrs(factors, pivots, balance[:free])[0]
        size, error = float(np.linalg.norm(step)), abs(float(balance[:free] @ change[:free]))
        if not np.isfinite(size):
            return None
        if size <= tolerance and error <= unbalanced:
            lost = float(change @ damping @ change) / h + float(slip @ resisting)
            return _Step(
                change,
                Instant(
                    time=now.time + h,
                    y=now.y + change,
                    position=after.position,
                    velocity=velocity,
                    elastic=after.energy,
                    kinetic=float(velocity @ mass @ velocity) / 2,
                    dissipated=now.dissipated + lost,
                    load_work=now.load_work + float(system.force @ moved),
                    drive_work=now.drive_work + float(balance[free:] @ change[free:]),
                ),
            )
        change[:free] -= step
    return None
