"""The study of forward kinematics: the equilibrium of a robot at given joint values."""

from __future__ import annotations

import logging
from typing import Annotated

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from .robot_keys import ExternalLoad, Joints, RobotPath
from .study_file import Arguments, Options, question
from .surroundings_file import WallBodies

LOGGER = logging.getLogger(__name__)


@question("solving the shape", timed=False)
def solve_shape(
    robot: RobotPath,
    joints: Joints,
    load: ExternalLoad,
    options: Annotated[Options, Arguments(forward_kinematics, "method", "tolerance", "verify", "time_limit")],
    walls: WallBodies = (),
) -> Equilibrium:
    """The equilibrium of a robot at given joint values; for a calibrated robot these are drive readings."""
    equilibrium = forward_kinematics(robot, *joints, load=load, walls=walls, **options)
    if not equilibrium.arc_length[-1]:
        LOGGER.warning("no tube is in front of the base plate at these translations; the tip lies in the plate")
    return equilibrium
