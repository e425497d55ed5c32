"""tubeopt: design, command and fabrication of concentric and eccentric tube robots."""

from .equilibrium import Equilibrium, Status
from .errors import InputError, SolveError
from .kinematics import Discretisation, forward_kinematics
from .materials import NITINOL, Material
from .robots.concentric import ConcentricRobot
from .robots.limits import JointLimits
from .tubes import Tube

__version__ = "0.1.0"

__all__ = [
    "NITINOL",
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
