"""tubeopt: design, command and fabrication of concentric and eccentric tube robots."""

from .batch import EquilibriumBatch, forward_kinematics_batch
from .block.equilibrium_block import EquilibriumBlock, OrderWarning
from .block.ipopt import Ipopt, ProblemStatus
from .block.jacobian import Jacobian
from .block.problem import Problem
from .block.problem_solution import ProblemSolution, load_problem_solution
from .design import DesignSolution, DesignTask, optimize_design
from .equilibrium import Equilibrium, Statistics, Status, Verification
from .errors import InputError, SolveError
from .fabrication import Mold, MoldSpec, plan_mold, predict_tube
from .fabrication.heating import plan_heating
from .fabrication.heating_plan import HeatingPlan
from .fabrication.heating_spec import HeatingSpec
from .fabrication.rig import Rig
from .inverse import IkSession, InverseOptions, InverseSolution, InverseStatus, inverse_kinematics
from .kinematics import forward_kinematics
from .materials import NITINOL, Material
from .planning import (
    PlanOptions,
    Proof,
    RateLimits,
    TipGoal,
    Trajectory,
    follow_the_leader,
    follow_tip_path,
    plan_trajectory,
    verify_trajectory,
)
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
from .study.rig_file import load_rig, save_rig
from .study.robot_file import load_robot, save_robot
from .sweeping import Sweep, sweep
from .tubes import Tube
from .workspaces import SnappingLoss, Workspace, load_workspace, snapping_loss, workspace

__version__ = "0.1.0"

__all__ = [
    "NITINOL",
    "Branch",
    "Certificate",
    "ConcentricRobot",
    "DesignSolution",
    "DesignTask",
    "Discretisation",
    "EccentricRobot",
    "EnergyMap",
    "Equilibrium",
    "EquilibriumBatch",
    "EquilibriumBlock",
    "Finding",
    "HeatingPlan",
    "HeatingSpec",
    "IkSession",
    "InputError",
    "InverseOptions",
    "InverseSolution",
    "InverseStatus",
    "Ipopt",
    "Jacobian",
    "JointLimits",
    "Material",
    "Mold",
    "MoldSpec",
    "OrderWarning",
    "Path",
    "PlanOptions",
    "Problem",
    "ProblemSolution",
    "ProblemStatus",
    "Proof",
    "RateLimits",
    "Rig",
    "SegmentedEccentricRobot",
    "Snap",
    "SnappingLoss",
    "SolveError",
    "StabilityMap",
    "Statistics",
    "Status",
    "Sweep",
    "TipGoal",
    "Trajectory",
    "Tube",
    "Verdict",
    "Verification",
    "Workspace",
    "WorstCertificate",
    "WorstMargin",
    "certify",
    "energy_map",
    "find_equilibria",
    "find_snap",
    "follow",
    "follow_the_leader",
    "follow_tip_path",
    "forward_kinematics",
    "forward_kinematics_batch",
    "inverse_kinematics",
    "judge",
    "load_equilibrium",
    "load_problem_solution",
    "load_rig",
    "load_robot",
    "load_workspace",
    "optimize_design",
    "plan_heating",
    "plan_mold",
    "plan_trajectory",
    "predict_tube",
    "save_rig",
    "save_robot",
    "snap_free_certificate",
    "snapping_loss",
    "stability_map",
    "sweep",
    "trace_branch",
    "verify_trajectory",
    "workspace",
    "worst_certificate",
    "worst_margin",
]
