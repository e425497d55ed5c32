"""The exact snap: the first fold on a straight path in joint space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..equilibrium.continuation import JointPath
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.load_continuation import JointFamily
from ..equilibrium.load_problem import LOADED_DISCRETISATION
from ..equilibrium.loaded import loaded_point
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import polish
from ..errors import InputError, vector
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.parallel.blas import small
from ..typing import Array
from .following import Event, motion_along, to_snap
from .loaded_following import LoadedEvent, loaded_motion_along, loaded_start, to_loaded_snap
from .snap import Snap

Configuration = tuple[ArrayLike, ArrayLike | None]


@small
def find_snap(
    robot: Robot,
    start: Configuration,
    end: Configuration,
    *,
    equilibrium: Equilibrium | None = None,
    load: Load | None = None,
) -> Snap | None:
    """The first snap on the straight path from `start` to `end`, or None where the branch reaches the end.

    The branch is followed to where it ends; the fold there is the root of a bordered determinant.

    Args:
        start, end: (rotations, translations), each (n,), rad and m; translations may be None for home.
        equilibrium: stable equilibrium at `start` on the branch to follow; by default that of `forward_kinematics`.
        load: forces that keep their direction and stay on the robot.

    Raises:
        InputError: joint values of the wrong number, or not finite; an equilibrium that is unstable or not at `start`.
        SolveError: no stable equilibrium at `start`, or none where the robot lands.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> home = [0, 0, 0]
        >>> snap = tubeopt.find_snap(robot, (home, home), (np.radians([360, 0, 0]), home))
        >>> round(float(np.degrees(snap.rotations[0])), 3)
        214.222
    """
    path = JointPath(robot, _joint(robot, "start", start), _joint(robot, "end", end))
    if load is not None:
        begin = loaded_point(loaded_start(robot, path.start, load, equilibrium))
        family = JointFamily(replace(path, discretisation=LOADED_DISCRETISATION), load, load)
        loaded_steps = loaded_motion_along(family, replace(begin, t=0.0))
        return next((to_loaded_snap(step, 0) for step in loaded_steps if isinstance(step, LoadedEvent)), None)
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, *path.at(0.0))
    if not first.stable:
        raise InputError(f"equilibrium has margin {first.margin:.3g}; it must be stable (margin above 0)")
    own = np.concatenate([first.rotations, first.translations])
    if np.abs(own - path.start).max() > 1e-9:
        raise InputError("equilibrium is at other joint values than start; they must be the same")
    steps = motion_along(path, polish(first))
    return next((to_snap(path, step, 0) for step in steps if isinstance(step, Event)), None)


def _joint(robot: Robot, name: str, value: Configuration) -> Array:
    try:
        rotations, translations = value
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be a pair (rotations, translations)") from None
    home = robot.home_translations if translations is None else translations
    alpha = vector(f"rotations of {name}", rotations, robot.n_tubes)
    shift = vector(f"translations of {name}", home, robot.n_tubes)
    robot.assembly(shift)
    return np.concatenate([alpha, shift])
