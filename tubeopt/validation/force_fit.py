"""Fit of a force at the tip to measured points of an arm, and its covariance to second order."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from ..equilibrium.kinematics import under_load
from ..equilibrium.linearised import linearise, position_changes, positions_at, tip_forces
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, without_unit_warnings
from ..robots.load import Load
from ..robots.order import last_tube
from ..solvers.robust_least_squares import LeastSquaresSolver, Weights, descend
from ..typing import Array, Mask
from .model import about_z

# Distance from the tip, m, at which a measured point is the tip: round-off of the arm's length.
ARRIVED = 1e-12

# Singular values of the Jacobian below this fraction of the largest are noise: the Jacobian has about as many digits.
UNSEEN = 1e-8


class Effort(NamedTuple):
    """Limits of a fit."""

    steps: int
    """Maximum number of equilibria tried."""
    settled: float
    """Step, in standard errors of the force, below which the fit has converged."""


# 40 random forces on the thesis robot took 3 to 25 steps. In a hardly observable direction steps are shortened often,
# and more are necessary.
FULL = Effort(60, 1e-4)

# For fits to moved measurements, from which errors are computed. They start at the fit to the measurement itself; a
# hundredth of a standard error changes the errors by a per cent.
QUICK = Effort(12, 1e-2)

# Largest displacement of a measured point in one step, as a fraction of the arm: the linear fit is useless beyond.
LONGEST_MOVE = 0.1

# Relative to the diagonal of the normal equations. Some directions are a thousand times less observable than others, a
# million times in squares: a damping of 1e-6 would suppress them.
FIRST_DAMPING = 1e-8

# Step, in standard errors, below which a fit has converged where it ends for another reason.
SURE = 1e-3

# Residual along a direction, in standard errors, below which a fit is as good as the noise, whatever the force along
# it.
WITHIN = 4.0

# Standard deviations by which measurements are moved: the nodes -sqrt(3), 0, sqrt(3) integrate polynomials up to
# degree 5 against a Gaussian (Gauss-Hermite), so that second moments of F + a z + b z^2 / 2 are exact.
ROOT = np.sqrt(3.0)

# (1024, 3) normal numbers from a Halton sequence: the quantile of 95 % of squares from as many random ones would be
# off by 4 %.
NORMAL = scipy.special.ndtri(scipy.stats.qmc.Halton(3, scramble=False).random(1025)[1:])

EVERYWHERE = np.eye(3)


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured points of an arm, in the plate frame."""

    arc_length: Array
    """(P,) arc lengths, m; inf for the tip of a bundle."""
    position: Array
    """(P, 3) measured positions, m."""
    noise: float
    """Standard deviation of a coordinate, m."""
    offset: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) offset of the foremost point from the arm, in the frame of the tip, m."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A force with its equilibrium and linearised residuals."""

    force: Array
    """(3,) force in addition to the known load, N."""
    equilibrium: Equilibrium
    residual: Array
    """(3 P,) measured less computed coordinates, over the noise."""
    jacobian: Array
    """(3 P, 3) derivative of the computed coordinates by the force, over the noise, 1/N."""


def fit(trial: Trial, base: Load, measured: Measured, effort: Effort, axes: Array = EVERYWHERE) -> tuple[Trial, int]:
    """Least-squares fit of a force that differs from a trial's only along orthonormal axes (3, m).

    Returns:
        The trial at the fit, and the number of forces tried.

    Raises:
        SolveError: the fit does not converge.
    """
    model = _Pushed(trial, base, measured, effort.steps, axes)
    count = len(trial.residual)
    weights = Weights(np.ones(count), np.ones(count), np.full(axes.shape[1], np.inf))
    steps = LeastSquaresSolver(
        iterations=effort.steps,
        settled=1e-12,  # a direction that is hardly seen is a small part of the cost
        first_damping=FIRST_DAMPING,
        round_off=effort.settled**2 / count,
    )
    end = descend(model, weights, model.start, solver=steps).state.trial
    if float(np.linalg.norm(remaining_step(end, axes))) <= max(SURE, effort.settled):
        return end, model.tried
    residual = f"the residual is {rms_distance(end, measured) * 1e3:.3g} mm"
    raise SolveError(f"the force did not converge in {effort.steps} steps: {residual}", end.equilibrium)


class _Force:
    """Force with components x (m,) along the axes, N; its trial is computed when needed, from a trial nearby."""

    def __init__(self, model: _Pushed, x: Array, trial: Trial) -> None:
        self._model, self.x, self._near = model, x, trial

    @cached_property
    def trial(self) -> Trial:
        """Force and its equilibrium; raises SolveError if it does not exist or is beyond the linearised range."""
        return self._near if self is self._model.start else self._model.tried_at(self.x, self._near)

    def moved(self, step: Array) -> _Force:
        """Force after a step (m,) along the axes."""
        return _Force(self._model, self.x + step, self.trial)


class _Pushed:
    """Model for `descend`: coordinates of the measured points over their noise, under a force at the tip."""

    freedoms = 0

    def __init__(self, start: Trial, base: Load, measured: Measured, most_steps: int, axes: Array) -> None:
        self.bounds = np.outer([-np.inf, np.inf], np.ones(axes.shape[1]))
        # The part of the force normal to the axes is constant.
        self._axes, self._held = axes, start.force - axes @ (axes.T @ start.force)
        self._base, self._measured, self._most_steps, self.tried = base, measured, most_steps, 0
        self.start = _Force(self, axes.T @ start.force, start)

    def tried_at(self, x: Array, trial: Trial) -> Trial:
        """Force with components x (m,) and its equilibrium; raises SolveError if it does not exist."""
        force = self._held + self._axes @ x
        self.tried += 1
        if self.tried > self._most_steps:
            raise SolveError("the step limit was reached")
        # The Jacobian is over the noise: times it, this is in m.
        moved = np.abs(trial.jacobian @ (force - trial.force)).max() * self._measured.noise
        if moved > LONGEST_MOVE * float(trial.equilibrium.arc_length[-1]):
            raise SolveError("the force moves the arm beyond the range of the linearisation")
        try:
            return trial_at(trial.equilibrium, self._base, force, self._measured)
        except InputError as error:
            raise SolveError(str(error)) from None

    def residuals(self, state: _Force) -> Array:
        """(3 P, 1) fitted less measured."""
        return -state.trial.residual[:, None]

    def jacobian(self, state: _Force) -> Array:
        """(3 P, 1, m) derivatives of the residuals by the force along the axes."""
        return (state.trial.jacobian @ self._axes)[:, None]

    def costly(self, state: _Force) -> bool:
        """False, since the derivatives are computed together with the equilibrium."""
        return False


def trial_at(equilibrium: Equilibrium, base: Load, force: Array, measured: Measured) -> Trial:
    load = replace(base, force=tuple(np.add(base.force, force).tolist()))
    with without_unit_warnings():  # trial forces may be unusual
        e = under_load(equilibrium, load)
    noise = measured.noise
    tip = last_tube(e.tube_end)
    away = e.tip_rotation @ about_z(e.rotation[int(tip), -1]) @ measured.offset
    # The compliance of the tip has these slopes already; other points need the whole arm.
    if len(measured.arc_length) == 1 and measured.arc_length[0] >= e.arc_length[-1] - ARRIVED:
        slopes = e.compliance[:3, :3] + _rotation_slope(e.compliance[3:, :3], away)
        return Trial(force, e, (measured.position[0] - e.tip_position - away) / noise, slopes / noise)
    known, fractions = linearise(e, (), more=tip_forces), measured.arc_length / e.arc_length[-1]
    residuals = measured.position - positions_at(known, fractions)
    slopes = position_changes(known, fractions)
    if away.any():
        residuals[0] -= away
        slopes[0] += _rotation_slope(e.compliance[3:, :3], away)
    return Trial(force, e, residuals.ravel() / noise, slopes.reshape(-1, 3) / noise)


def _rotation_slope(turns: Array, away: Array) -> Array:
    """(3, 3) derivative of a vector (3,) in a frame with rotation vectors `turns` (3, 3) by column, rad per unit."""
    return np.cross(turns.T, away).T


def remaining_step(trial: Trial, axes: Array) -> Array:
    """(3 P,) change of the observable residuals, over the noise, by the next Gauss-Newton step along axes (3, m)."""
    slopes = trial.jacobian @ axes
    return np.asarray(slopes @ np.linalg.lstsq(slopes, trial.residual, rcond=UNSEEN)[0])


def rms_distance(trial: Trial, measured: Measured) -> float:
    # The mean is over coordinates, and a point has three of them.
    return measured.noise * float(np.sqrt(3 * (trial.residual**2).mean()))


def hidden(trial: Trial) -> Mask:
    """(3,) True for unobservable directions, in the order from best to worst observable.

    One standard error along them is, to first order, more than four times the buckling load of a straight arm.
    """
    e, size = trial.equilibrium, np.linalg.svd(trial.jacobian, compute_uv=False)
    # Euler's load of a column that is clamped at one end, pi^2 K / (4 L^2).
    buckling = np.pi**2 / 4 * sum(tube.bending_stiffness for tube in e.robot.tubes) / float(e.arc_length[-1]) ** 2
    return np.asarray((size * 4 * buckling < 1) | (size <= UNSEEN * size[0]))


class Covariance(NamedTuple):
    """Covariance of a force with its principal axes."""

    matrix: Array
    """(3, 3) covariance, N^2; inf along directions without a bound."""
    directions: Array
    """(3, 3) principal axes by row, from the best to the worst determined."""
    errors: Array
    """(3,) standard errors along the principal axes, N."""


def covariance_of(trial: Trial, base: Load, measured: Measured, axes: Array) -> Covariance:
    """Covariance of a fitted force, to second order.

    A measurement that is off by z standard deviations along the k-th left singular vector of the Jacobian gives a
    force F(z) = F + a z + b z^2 / 2. Both vectors follow from fits to measurements moved by the root of 3 standard
    deviations to either side: these nodes integrate a Gaussian to the third order. The covariance is the second moment
    about F, scaled so that its 95 % ellipsoid contains 95 % of the forces F(z) of normal z.

    Fits to moved measurements differ along `axes` (3, m), as the fit to the measurement does, and along one other
    direction where that one is evaluated.
    """
    left, size, right = np.linalg.svd(trial.jacobian @ axes, full_matrices=True)
    right = right @ axes.T
    if len(right) < 3:
        complement = scipy.linalg.null_space(axes.T)
        complement_svd = np.linalg.svd(trial.jacobian @ complement, full_matrices=False)
        left = np.column_stack([left[:, : len(right)], complement_svd[0]])
        size, right = np.append(size, complement_svd[1]), np.vstack([right, complement_svd[2] @ complement.T])
    linear, bent, lost = np.zeros((3, 3)), np.zeros((3, 3)), hidden(trial)
    for k in np.flatnonzero(~lost):
        along = axes if k < axes.shape[1] else np.column_stack([axes, right[k]])
        sides = [_moved(trial, base, measured, sign * ROOT * left[:, k], along) for sign in (1.0, -1.0)]
        known = [side for side in sides if side is not None]
        lost[k] = len(known) < 2
        if sides[0] is not None and sides[1] is not None:
            # F(r) - F(-r) = 2 a r, and the sum of both changes is b r^2.
            linear[k], bent[k] = (sides[0] - sides[1]) / (2 * ROOT), (sides[0] + sides[1]) / ROOT**2
        elif known:
            side = 1.0 if sides[0] is not None else -1.0
            # With one side only, a = v / size is that of the linear fit, and the rest is b r^2 / 2.
            bent[k] = 2 * (known[0] - side * ROOT * right[k] / size[k]) / ROOT**2
    if lost.any():
        return _unbounded(linear, bent, right, lost)
    first = right.T / size
    forces = NORMAL @ linear + 0.5 * NORMAL**2 @ bent
    covariance = _second_moment(linear, bent)
    # The same quantile for the linear F with the same draws: their sampling error cancels in the ratio.
    reached, usual = (
        np.quantile(np.einsum("ki,ij,kj->k", f, np.linalg.inv(c), f), 0.95)
        for f, c in ((forces, covariance), (NORMAL @ first.T, first @ first.T))
    )
    covariance *= reached / usual
    square, axes = np.linalg.eigh(covariance)
    return Covariance(covariance, axes.T, np.sqrt(square))


def _second_moment(linear: Array, bent: Array) -> Array:
    """(3, 3) mean of F F' for forces F = sum_k a_k z_k + b_k z_k^2 / 2 of normal numbers z.

    a_k and b_k are rows of `linear` and `bent`, and z_k are independent standard normal variables.
    """
    # E z^4 = 3 and E z_j^2 z_k^2 = 1: squares leave b_k b_k' / 2, and the mean of F adds its own square.
    total = bent.sum(0)
    return np.asarray(linear.T @ linear + bent.T @ bent / 2 + np.outer(total, total) / 4)


def _moved(trial: Trial, base: Load, measured: Measured, by: Array, axes: Array) -> Array | None:
    """(3,) change of the fitted force along axes (3, m), N, if residuals change `by` (3 P,); None without a fit."""
    moved = replace(measured, position=measured.position + measured.noise * by.reshape(-1, 3))
    shifted = replace(trial, residual=trial.residual + by)
    try:
        return np.asarray(fit(shifted, base, moved, QUICK, axes)[0].force - trial.force)
    except (InputError, SolveError):
        return None


def _unbounded(linear: Array, bent: Array, right: Array, lost: Mask) -> Covariance:
    """Covariance where the directions `lost` (3,) have no bound."""
    bounded_axes = right[~lost]
    square = bounded_axes @ _second_moment(linear, bent) @ bounded_axes.T
    eigenvalues, eigenvectors = np.linalg.eigh(square)
    directions = np.vstack([eigenvectors.T @ bounded_axes, right[lost]])
    errors = np.append(np.sqrt(np.maximum(eigenvalues, 0.0)), np.full(int(lost.sum()), np.inf))
    # Infinite in every entry that a direction without a bound contributes to.
    bounded = np.isfinite(errors)
    matrix = (directions[bounded].T * errors[bounded] ** 2) @ directions[bounded]
    for direction in directions[~bounded]:
        outer = np.outer(direction, direction)
        reached = np.abs(outer) > UNSEEN
        matrix[reached] = np.inf * np.sign(outer)[reached]
    return Covariance(np.asarray(matrix), directions, errors)
