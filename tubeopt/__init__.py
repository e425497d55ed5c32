"""tubeopt: design, command and fabrication of concentric and eccentric tube robots."""

from .derivatives import Jacobian
from .equilibrium import Equilibrium, Statistics, Status, Verification
from .errors import InputError, SolveError
from .kinematics import forward_kinematics
from .materials import NITINOL, Material
from .robots.concentric import ConcentricRobot
from .robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from .robots.limits import JointLimits
from .solution import Discretisation
from .stability import (
    Branch,
    Certificate,
    EnergyMap,
    Finding,
    Path,
    Snap,
    StabilityMap,
    Verdict,
    WorstCertificate,
    WorstMargin,
    certify,
    energy_map,
    find_equilibria,
    find_snap,
    follow,
    judge,
    snap_free_certificate,
    stability_map,
    trace_branch,
    worst_certificate,
    worst_margin,
)
from .study.result_file import load_equilibrium
from .study.robot_file import load_robot, save_robot
from .tubes import Tube

__version__ = "0.1.0"

__all__ = [
    "NITINOL",
    "Branch",
    "Certificate",
    "ConcentricRobot",
    "Discretisation",
    "EccentricRobot",
    "EnergyMap",
    "Equilibrium",
    "Finding",
    "InputError",
    "Jacobian",
    "JointLimits",
    "Material",
    "Path",
    "SegmentedEccentricRobot",
    "Snap",
    "SolveError",
    "StabilityMap",
    "Statistics",
    "Status",
    "Tube",
    "Verdict",
    "Verification",
    "WorstCertificate",
    "WorstMargin",
    "certify",
    "energy_map",
    "find_equilibria",
    "find_snap",
    "follow",
    "forward_kinematics",
    "judge",
    "load_equilibrium",
    "load_robot",
    "save_robot",
    "snap_free_certificate",
    "stability_map",
    "trace_branch",
    "worst_certificate",
    "worst_margin",
]
