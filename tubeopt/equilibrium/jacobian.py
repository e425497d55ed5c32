"""The Jacobian of an equilibrium: tip pose, tips of the tubes, margin and energy by joint values and dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np

from ..arguments import typed
from ..solvers.blas import small
from ..solvers.compiled.binding import Carriages, Moved, Slopes, Start, kernel_of, slopes_compiled
from ..typing import Array
from .linearised import Linearised, linearise, sharing
from .result import Equilibrium, Jacobian

JOINTS = ("rotations", "translations")
"""What a Jacobian is taken with respect to unless asked otherwise."""

SAME_ARM = 1e-9
"""Rotations that differ by less, rad, are of one arm."""


def derivatives_of(
    equilibrium: Equilibrium,
    wrt: Sequence[str] = JOINTS,
    *,
    side: int = 1,
    carriages: Carriages | None = None,
) -> Linearised:
    """Derivatives of an equilibrium, computed where they are asked for; its `carriages` are by default those of the
    robot."""
    carriages = equilibrium.robot.moving_together if carriages is None else carriages
    return linearise(equilibrium, wrt, side, along=sharing(carriages, tuple(wrt)))


def compiled_slopes(
    at: Equilibrium, sides: tuple[int, ...] | None = None, carriages: Carriages | None = None, **asked: bool
) -> Slopes | None:
    """Derivatives of an equilibrium by the compiled kernel; None where it has none, as of an arm of length zero.

    Translations move towards `sides` (n,), 1 where not given, and tubes of one of the `carriages` together; what is
    `asked` are flags of `slopes_compiled`.
    """
    kernel = kernel_of(at.robot)
    if len(at.arc_length) < 2 or kernel is None or not kernel.differentiable:
        return None
    still, sides = np.zeros(at.robot.n_tubes), sides or (1,) * at.robot.n_tubes
    arm, points = at.arm, at.points
    along = arm.arc_length, arm.rotation, arm.torsion, points.point, points.point_rotation
    start = Start(*along, still, at.translations)
    moved = Moved(sides, at.robot.moving_together if carriages is None else carriages)
    return slopes_compiled(at.robot, at.rotations, at.translations, start, moved, **asked)


def _by_kernel(
    equilibrium: Equilibrium, wrt: Sequence[str], side: int, carriages: Carriages | None = None
) -> Jacobian | None:
    """The Jacobian of a stable equilibrium of concentric tubes, from the compiled kernel; None where that has none, as
    under a load, or what it finds from here is not this equilibrium to the last digits."""
    if equilibrium.load is not None or not set(wrt) <= set(JOINTS) or side not in (1, -1):
        return None
    n = equilibrium.robot.n_tubes
    found = compiled_slopes(equilibrium, (side,) * n, carriages, either=False)
    if found is None or found.off > SAME_ARM:
        return None
    tables = found.position, found.turn, found.tip_rotations, found.margin, found.energy
    if tuple(wrt) == JOINTS:
        return Jacobian(JOINTS, *tables)
    columns = [JOINTS.index(name) * n + i for name in wrt for i in range(n)]
    return Jacobian(tuple(wrt), *(table[..., columns] for table in tables))


@typed
@small
def jacobian(equilibrium: Equilibrium, *, wrt: Sequence[str] = JOINTS, side: int = 1) -> Jacobian:
    """Derivatives of tip pose, tube tips, margin and energy of an equilibrium, by the implicit function theorem.

    Where breakpoints coincide (at home, for instance, every transition lies at the plate) a translation or a length
    changes the order of the sections, and the derivatives differ to either side.

    Args:
        wrt: any of "rotations", "translations", "curvature", "straight_length", "curved_length", "bending_stiffness",
            "torsional_stiffness"; n columns each. Lengths change with the translations held: a longer straight part
            is a longer transmission. Of a tube made of pieces the curvature bends all of them in proportion, and a
            stiffness makes all of it stiffer; its curved length stretches them, and what varies along them.
        side: 1 for breakpoints that move towards the tip, -1 for those that move towards the plate.

    Raises:
        InputError: an unknown name, or a side that is neither.
        SolveError: the equilibrium is a fold, where derivatives are infinite.
    """
    by_kernel = _by_kernel(equilibrium, wrt, side)
    return Jacobian.of(partial(_kept, equilibrium, tuple(wrt), side)) if by_kernel is None else by_kernel


@lru_cache(maxsize=8)
def _kept(equilibrium: Equilibrium, wrt: tuple[str, ...], side: int) -> Linearised:
    """`derivatives_of`, kept for what is read later of a Jacobian."""
    return derivatives_of(equilibrium, wrt, side=side)


@small
def position_slopes(equilibrium: Equilibrium, carriages: Carriages | None = None, *, side: int = 1) -> Array:
    """(3, 2n) derivatives of the tip position of an equilibrium by its joint values, m per rad and per m.

    Args:
        carriages: partition of the tubes, numbered from 0. The translations of each group move together, and each
            column has an equal part of that. By default the carriages of the robot.
        side: as in `jacobian`.

    Raises:
        SolveError: the equilibrium is a fold, where derivatives are infinite.
    """
    found = _by_kernel(equilibrium, JOINTS, side, carriages)
    if found is not None:
        return found.position
    return derivatives_of(equilibrium, side=side, carriages=carriages).tip_position
