"""A load that changes slowly while the joints rest: where the robot goes, and where it snaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..equilibrium.continuation import JointPath
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.load_answer import to_loaded
from ..equilibrium.load_continuation import JointFamily
from ..equilibrium.load_problem import LOADED_DISCRETISATION
from ..equilibrium.loaded import loaded_point
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..robots.load import Load
from ..solvers.parallel.blas import small
from .following import Path
from .loaded_following import loaded_leg


@small
def push(equilibrium: Equilibrium, load: Load) -> Path:
    """What a robot does while the load on it turns evenly into another one: the equilibria at both ends, and the snaps
    between, at fractions of the way.

    Args:
        equilibrium: stable, with a load whose forces keep their direction, or without one.
        load: the new one; `Load()` takes the old one off.

    Raises:
        InputError: an unstable equilibrium, or a load without an energy.
        SolveError: descent from where the branch is lost finds no stable equilibrium.
    """
    robot, before = equilibrium.robot, equilibrium.load or Load()
    if not (load.has_energy and before.has_energy):
        raise InputError("load has a moment or turns with the tip; it has no energy, so snaps are not told")
    if not equilibrium.stable:
        raise InputError(f"equilibrium has margin {equilibrium.margin:.3g}; it must be stable (margin above 0)")
    alpha, shift = equilibrium.rotations, equilibrium.translations
    try:
        return Path((equilibrium, forward_kinematics(robot, alpha, shift, load=load, guess=equilibrium)), ())
    except SolveError:
        here = np.concatenate([alpha, shift])
    family = JointFamily(JointPath(robot, here, here, LOADED_DISCRETISATION), load, before)
    point, snaps = loaded_leg(family, replace(loaded_point(equilibrium), t=0.0), 0)
    end = to_loaded(point)
    return Path((equilibrium, end), tuple(snaps))
