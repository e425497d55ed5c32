"""Joint values of the model from the drive readings of a robot, and back, with compliant carriages.

The tubes push a carriage back with F = dE/dz, the derivative of their elastic energy with respect to its translation z.
The energy counts curved parts that the plate holds straight behind it. A carriage of compliance c with the reading z0
is at z = z0 - c F(z).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..errors import SolveError
from ..robots.eccentric import BundleRobot
from ..robots.robot import Robot
from ..typing import Array, Index
from .batch import forward_kinematics_batch

STEP = 1e-5
"""Step of the differences of the energy, m."""

SOLVED = 1e-12
"""Largest error of a solved translation, m."""

FORCE_ERROR = 1e-9
"""Error of the force by the differences, N; times the compliance it adds to SOLVED."""

MAX_STEPS = 12
"""Maximum number of Newton steps."""


def to_model(robot: Robot, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
    """Joint values (..., n) of the model at readings (..., n) of a robot; equal without a calibration.

    Raises:
        SolveError: the carriages have no equilibrium.
    """
    calibration = robot.calibration
    if calibration is None:
        return np.array(rotations, dtype=float), np.array(translations, dtype=float)
    alpha, shift = calibration.to_model(rotations, translations)
    return alpha, yielded(robot, alpha, shift, np.array(calibration.translation_compliance))


def to_readings(robot: Robot, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
    """Readings (..., n) of a robot at joint values (..., n) of the model; equal without a calibration."""
    calibration = robot.calibration
    if calibration is None:
        return np.array(rotations, dtype=float), np.array(translations, dtype=float)
    compliance, shift = np.array(calibration.translation_compliance), np.array(translations, dtype=float)
    if compliance.any():
        alpha, flat = (np.reshape(part, (-1, calibration.n_tubes)) for part in np.broadcast_arrays(rotations, shift))
        shift = shift + compliance * push(robot, np.asarray(alpha, dtype=float), flat)[0].reshape(shift.shape)
    return calibration.to_readings(rotations, shift)


def push(robot: Robot, rotations: Array, translations: Array) -> tuple[Array, Array]:
    """Force (N, n) of each tube on its carriage, N, at joint values (N, n), and its derivatives (N, n, n), N/m.

    For concentric tubes without load and friction. Both are 0 without a stable equilibrium. Where breakpoints coincide
    the force jumps; the mean of both sides is returned.
    """
    count, n = translations.shape
    i, j = np.triu_indices(n, 1)
    upper = np.maximum(translations, [tube.straight_length for tube in robot.tubes])
    # At the end of its stroke the differences are taken one step before it, and the force is extrapolated.
    middle, unit = np.minimum(translations, upper - STEP), np.eye(n)
    moves = np.vstack([np.zeros(n), unit, -unit, unit[i] + unit[j], -unit[i] - unit[j]])[:, None] * STEP
    table = (middle + moves).reshape(-1, n)
    energy = forward_kinematics_batch(robot, np.tile(rotations, (len(moves), 1)), table).energy
    centre, plus, minus, both_plus, both_minus = (
        part.T for part in np.split(energy.reshape(-1, count), np.cumsum([1, n, n, len(i)]))
    )
    ahead, behind = (held_straight(robot, middle + way * STEP) for way in (1, -1))
    force, stiffness = (plus - minus) / (2 * STEP) - (ahead + behind) / 2, np.zeros((count, n, n))
    diagonal = (plus - 2 * centre + minus) / STEP**2
    mixed = ((both_plus - 2 * centre + both_minus) / STEP**2 - diagonal[:, i] - diagonal[:, j]) / 2
    stiffness[:, i, j], stiffness[:, j, i] = mixed, mixed
    stiffness[:, range(n), range(n)] = diagonal - (ahead - behind) / (2 * STEP)
    force = force + np.einsum("kij,kj->ki", stiffness, translations - middle)
    finite = np.isfinite(force).all(1) & np.isfinite(stiffness).all((1, 2))
    return np.where(finite[:, None], force, 0.0), np.where(finite[:, None, None], stiffness, 0.0)


def held_straight(robot: Robot, translations: Array) -> Array:
    """Bending energy per length (N, n), N, of tubes just behind the plate, which holds them straight.

    The elastic energy of an equilibrium leaves it out: a tube that advances releases it.
    """
    straight, length = (
        np.array([getattr(tube, name) for tube in robot.tubes]) for name in ("straight_length", "length")
    )
    own = straight - translations
    curved = (own > straight) & (own < length)
    table = None if isinstance(robot, BundleRobot) else robot.assembly(translations[0]).lengthwise
    if table is None:
        density = [tube.bending_stiffness * tube.curvature**2 / 2 for tube in robot.tubes]
        return np.asarray(curved * np.array(density))
    stiffness, _, x, y, *_ = table.values(own, own)
    return np.asarray(curved * stiffness * (x**2 + y**2) / 2)


def yielded(
    robot: Robot, rotations: Array, translations: Array, compliance: Array, start: Array | None = None
) -> Array:
    """Translations (..., n), m, of carriages with compliances (n,), m/N, at the readings `translations`.

    They minimise the energy of tubes and springs, by Newton's method from `start`.

    Raises:
        SolveError: no minimum, since the force falls faster than the springs yield.
    """
    if not compliance.any():
        return translations
    n = robot.n_tubes
    alpha, target = rotations.reshape(-1, n), translations.reshape(-1, n)
    upper = np.maximum(target, [tube.straight_length for tube in robot.tubes])
    z, rows = np.minimum(target if start is None else start.reshape(-1, n), upper), np.arange(len(target))

    def residual(which: Index, z: Array) -> tuple[Array, Array]:
        """Residual z - z0 + c F(z) (K, n), m, of the translations z of compliant carriages, and its derivatives (K, n,
        n).
        """
        force, stiffness = push(robot, alpha[which], z)
        return z - target[which] + compliance * force, np.eye(n) + compliance[:, None] * stiffness

    for _ in range(MAX_STEPS):
        value, jacobian = residual(rows, z[rows])
        unsolved = (np.abs(value) >= SOLVED + FORCE_ERROR * compliance).any(1)
        rows, value, jacobian = rows[unsolved], value[unsolved], jacobian[unsolved]
        if not len(rows):
            return z.reshape(np.shape(translations))
        z[rows] = np.minimum(z[rows] - np.linalg.solve(jacobian, value[..., None])[..., 0], upper[rows])
    for row in rows:
        z[row] = _with_line_search(partial(residual, np.array([row])), z[row], upper[row], compliance)
    return z.reshape(np.shape(translations))


def _with_line_search(
    residual: Callable[[Array], tuple[Array, Array]], start: Array, upper: Array, compliance: Array
) -> Array:
    """(n,) root of a residual by Newton's method with exact line search, since the force jumps at breakpoints."""
    z, soft = start, compliance > 0
    for _ in range(MAX_STEPS):
        value, jacobian = (part[0] for part in residual(z[None]))
        if (np.abs(value) < SOLVED + FORCE_ERROR * compliance).all():
            return z
        step = np.minimum(-np.linalg.solve(jacobian, value), upper - z)

        def slope(t: float, z: Array = z, step: Array = step) -> float:
            """Derivative of the energy of tubes and springs along the step."""
            return float((step[soft] / compliance[soft]) @ residual((z + t * step)[None])[0][0, soft])

        t = 1.0
        if slope(0.0) < 0 < slope(1.0):
            t = float(scipy.optimize.brentq(slope, 0.0, 1.0, xtol=1e-12, rtol=1e-14))
        z = z + t * step
    raise SolveError(
        "the carriage positions do not converge: with compliances of "
        f"{', '.join(f'{c * 1e3:g}' for c in compliance)} mm/N the translation error is "
        f"{np.abs(value).max() * 1e3:.2g} mm"
    )
