"""tubeopt: design, command and fabrication of concentric and eccentric tube robots."""

from .equilibrium import Equilibrium, Status
from .errors import InputError, SolveError
from .kinematics import Discretisation, forward_kinematics
from .materials import NITINOL, Material
from .robots.concentric import ConcentricRobot
from .robots.limits import JointLimits
from .stability import (
    Path,
    Snap,
    find_equilibria,
    find_snap,
    follow,
)
from .study.result_file import load_equilibrium
from .study.robot_file import load_robot, save_robot
from .tubes import Tube

__version__ = "0.1.0"

__all__ = [
    "NITINOL",
    "Path",
    "Snap",
    "find_equilibria",
    "find_snap",
    "follow",
    "load_equilibrium",
    "load_robot",
    "save_robot",
    "ConcentricRobot",
    "Discretisation",
    "Equilibrium",
    "InputError",
    "JointLimits",
    "Material",
    "SolveError",
    "Status",
    "Tube",
    "forward_kinematics",
]
