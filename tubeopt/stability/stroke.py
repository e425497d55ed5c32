"""How hard a robot can push with its tip before it buckles or snaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, positive
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.parallel.blas import small
from .load_limit import LoadLimit, find_load_limit
from .loaded_certificate import bundle_of


@small
def find_stroke_force(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    equilibrium: Equilibrium | None = None,
    up_to: float = 10.0,
) -> LoadLimit | None:
    """The largest force with which the tip can push along itself; None where it can with `up_to`, N.

    What it pushes pushes back along the line on which the tip pointed at first, and lets it go anywhere: it neither
    holds the tip nor turns with it. The limit is where the robot buckles or snaps, see `find_load_limit`; its `factor`
    is the force, N. An arm that lies in a plane with its push buckles out of it; most others have no limit: they bend
    away, ever softer and never unstable, and what counts is how far (`compliance`, `tip_deflection` of designs).

    Args:
        rotations, translations: (n,) rad and m; translations None for home.
        equilibrium: the stable, unloaded equilibrium to start from; by default that of `forward_kinematics`.
        up_to: largest force to look at, N.

    Raises:
        InputError, SolveError: as `find_load_limit`.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> limit = tubeopt.find_stroke_force(robot, [0.0, 0.0, 0.0])
        >>> round(1e3 * limit.factor), limit.kind
        (125, 'bifurcation')
    """
    positive("up_to", up_to)
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, rotations, translations)
    if first.load is not None:
        raise InputError("equilibrium bears a load or is unstable; it must be unloaded and stable")
    arm = bundle_of(robot.assembly(first.translations))
    # About the force that buckles the weakest part as a column of the whole length.
    unit = min(up_to, float(arm.stiffness.min()) / arm.total_length**2)
    x, y, z = (-unit * first.tip_rotation[:, 2]).tolist()
    limit = find_load_limit(
        robot, rotations, translations, Load((x, y, z)), equilibrium=first, up_to=float(np.divide(up_to, unit))
    )
    return None if limit is None else replace(limit, factor=limit.factor * unit)
