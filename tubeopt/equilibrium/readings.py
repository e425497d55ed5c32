"""Joint values of the model from what the drives of a robot read, and back, carriages that yield included.

The tubes push a carriage back with F = dE/dz, the change of their elastic energy by its translation z. One of a
compliance c whose reading stands for z0 is at z = z0 - c F(z).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..errors import SolveError
from ..robots.robot import Robot
from ..typing import Array, Index
from .batch import forward_kinematics_batch

STEP = 1e-5
"""m, by which carriages are moved to find the force."""

SETTLED, SURE = 1e-12, 1e-9
"""m and N: translations are found where they are off by less than the first, and the second of a yielding spring."""

STEPS = 12
"""At most, of Newton's method."""


def to_model(robot: Robot, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
    """The model's joint values (..., n) at readings (..., n) of a robot: the readings where it has no calibration.

    Raises:
        SolveError: carriages that yield without end.
    """
    own = robot.calibration
    if own is None:
        return np.array(rotations, dtype=float), np.array(translations, dtype=float)
    alpha, shift = own.to_model(rotations, translations)
    return alpha, yielded(robot, alpha, shift, np.array(own.translation_compliance))


def to_readings(robot: Robot, rotations: ArrayLike, translations: ArrayLike) -> tuple[Array, Array]:
    """The readings (..., n) of a robot at joint values (..., n) of the model: the same where it has no calibration."""
    own = robot.calibration
    if own is None:
        return np.array(rotations, dtype=float), np.array(translations, dtype=float)
    compliance, shift = np.array(own.translation_compliance), np.array(translations, dtype=float)
    if compliance.any():
        alpha, flat = (np.reshape(part, (-1, own.n_tubes)) for part in np.broadcast_arrays(rotations, shift))
        shift = shift + compliance * push(robot, np.asarray(alpha, dtype=float), flat)[0].reshape(shift.shape)
    return own.to_readings(rotations, shift)


def push(robot: Robot, rotations: Array, translations: Array) -> tuple[Array, Array]:
    """Force (N, n), N, with which each tube of a concentric robot pushes its carriage back at joint values (N, n), and
    its change (N, n, n) by translations, N/m; both 0 where there is no stable equilibrium.

    Of tubes that bear no load and do not rub. Where breakpoints coincide the force jumps; told is the mean of both
    sides.
    """
    count, n = translations.shape
    i, j = np.triu_indices(n, 1)
    most = np.maximum(translations, [tube.straight_length for tube in robot.tubes])
    # At the end of its stroke a tube is moved from a step before it.
    middle, unit = np.minimum(translations, most - STEP), np.eye(n)
    moves = np.vstack([np.zeros(n), unit, -unit, unit[i] + unit[j], -unit[i] - unit[j]])[:, None] * STEP
    table = (middle + moves).reshape(-1, n)
    energy = forward_kinematics_batch(robot, np.tile(rotations, (len(moves), 1)), table).energy
    here, ahead, behind, both, neither = (
        part.T for part in np.split(energy.reshape(-1, count), np.cumsum([1, n, n, len(i)]))
    )
    force, stiffness = (ahead - behind) / (2 * STEP), np.zeros((count, n, n))
    own = (ahead - 2 * here + behind) / STEP**2
    mixed = ((both - 2 * here + neither) / STEP**2 - own[:, i] - own[:, j]) / 2
    stiffness[:, range(n), range(n)], stiffness[:, i, j], stiffness[:, j, i] = own, mixed, mixed
    force = force + np.einsum("kij,kj->ki", stiffness, translations - middle)
    known = np.isfinite(force).all(1) & np.isfinite(stiffness).all((1, 2))
    return np.where(known[:, None], force, 0.0), np.where(known[:, None, None], stiffness, 0.0)


def yielded(
    robot: Robot, rotations: Array, translations: Array, compliance: Array, start: Array | None = None
) -> Array:
    """Translations (..., n) of carriages of a compliance (n,), m/N, whose readings stand for `translations`.

    They are where the energy of tubes and springs is least, to which Newton's method leads, the sooner the nearer
    `start` is.

    Raises:
        SolveError: there is no such place: the tubes push the less the farther they are pulled.
    """
    if not compliance.any():
        return translations
    n = robot.n_tubes
    alpha, target = rotations.reshape(-1, n), translations.reshape(-1, n)
    most = np.maximum(target, [tube.straight_length for tube in robot.tubes])
    here, rows = np.minimum(target if start is None else start.reshape(-1, n), most), np.arange(len(target))

    def gap(which: Index, at: Array) -> tuple[Array, Array]:
        """By how much (K, n) translations of rows are ahead of their springs, and its change (K, n, n) by them."""
        force, stiffness = push(robot, alpha[which], at)
        return at - target[which] + compliance * force, np.eye(n) + compliance[:, None] * stiffness

    for _ in range(STEPS):
        ahead, slope = gap(rows, here[rows])
        off = (np.abs(ahead) >= SETTLED + SURE * compliance).any(1)
        rows, ahead, slope = rows[off], ahead[off], slope[off]
        if not len(rows):
            return here.reshape(np.shape(translations))
        here[rows] = np.minimum(here[rows] - np.linalg.solve(slope, ahead[..., None])[..., 0], most[rows])
    for row in rows:
        here[row] = _searched(partial(gap, np.array([row])), here[row], most[row], compliance)
    return here.reshape(np.shape(translations))


def _searched(gap: Callable[[Array], tuple[Array, Array]], start: Array, most: Array, compliance: Array) -> Array:
    """Where the gap (1, n) is none, by Newton's method with a search along every step: for where the force jumps."""
    here, soft = start, compliance > 0
    for _ in range(STEPS):
        ahead, slope = (part[0] for part in gap(here[None]))
        if (np.abs(ahead) < SETTLED + SURE * compliance).all():
            return here
        step = np.minimum(-np.linalg.solve(slope, ahead), most - here)

        def rise(part: float, here: Array = here, step: Array = step) -> float:
            """Of the energy along the step."""
            return float((step[soft] / compliance[soft]) @ gap((here + part * step)[None])[0][0, soft])

        part = 1.0
        if rise(0.0) < 0 < rise(1.0):
            part = float(scipy.optimize.brentq(rise, 0.0, 1.0, xtol=1e-12, rtol=1e-14))
        here = here + part * step
    raise SolveError(
        "the carriage positions do not converge: with compliances of "
        f"{', '.join(f'{c * 1e3:g}' for c in compliance)} mm/N the translation error is "
        f"{np.abs(ahead).max() * 1e3:.2g} mm"
    )
