"""tubeopt: design, command and fabrication of concentric and eccentric tube robots."""

from .batch import EquilibriumBatch, forward_kinematics_batch
from .derivatives import Jacobian
from .equilibrium import Equilibrium, Statistics, Status, Verification
from .errors import InputError, SolveError
from .fabrication import Mold, MoldSpec, plan_mold, predict_tube
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
    "EquilibriumBatch",
    "Finding",
    "InputError",
    "Jacobian",
    "JointLimits",
    "Material",
    "Mold",
    "MoldSpec",
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
    "forward_kinematics_batch",
    "judge",
    "load_equilibrium",
    "load_robot",
    "plan_mold",
    "predict_tube",
    "save_robot",
    "snap_free_certificate",
    "stability_map",
    "trace_branch",
    "worst_certificate",
    "worst_margin",
]
