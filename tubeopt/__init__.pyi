# The names of `tubeopt`, and where each comes from: loaded when it is first used.

from . import (
    block,
    bodies,
    design,
    equilibrium,
    errors,
    files,
    inverse,
    physics,
    planning,
    robots,
    runs,
    shaping,
    show,
    solvers,
    stability,
    typing,
    validation,
    workspaces,
)
from .block.equilibrium_block import EquilibriumBlock, OrderWarning
from .design import (
    DesignSolution,
    DesignSolver,
    DesignTask,
    SearchedDesign,
    SearchedPair,
    optimize_design,
    search_design,
    search_pair,
)
from .equilibrium.batch import EquilibriumBatch, forward_kinematics_batch
from .equilibrium.clearance import ClearanceCorrection, clearance_correction
from .equilibrium.file import load_equilibrium
from .equilibrium.kinematics import forward_kinematics
from .equilibrium.result import Equilibrium, Jacobian, Statistics, Status, Verification
from .equilibrium.solving import Discretisation
from .errors import InputError, SolveError
from .inverse import (
    IkSession,
    InverseOptions,
    InverseSolution,
    InverseSolver,
    InverseStatus,
    WaySearch,
    inverse_kinematics,
)
from .planning import (
    ArmsPlan,
    ArmsProof,
    EntryRegion,
    LeaderSolver,
    PairReach,
    PlacedRobot,
    PlanOptions,
    Proof,
    RateLimits,
    ReachShare,
    RegionReach,
    Roadmap,
    TipGoal,
    TipPathSolver,
    Trajectory,
    build_roadmap,
    evaluate_reach,
    follow_the_leader,
    follow_tip_path,
    load_roadmap,
    plan_arms,
    plan_from_region,
    plan_trajectory,
    verify_arms,
    verify_trajectory,
)
from .robots.concentric import ConcentricRobot
from .robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from .robots.file import load_robot, save_robot
from .robots.friction import Friction
from .robots.limits import JointLimits
from .robots.load import Load
from .robots.materials import NITINOL, Material
from .robots.pieces import Piece, Slots
from .robots.tubes import Tube
from .runs.rig_file import load_rig, save_rig
from .runs.sweeping import Sweep, sweep
from .shaping import HeatingSolver, Mold, MoldSolver, MoldSpec, RigSolver, plan_mold, predict_tube
from .shaping.heating.feedback import Feedback
from .shaping.heating.leading import lead_by
from .shaping.heating.plan import HeatingPlan
from .shaping.heating.planning import plan_heating
from .shaping.heating.rig import Rig
from .shaping.heating.sensors import Camera, Thermocouple, TubeResistance
from .shaping.heating.spec import HeatingSpec
from .shaping.heating.uncertainty import Uncertainty
from .show.interactive import show_in_3d
from .show.solids import save_solid
from .show.tables import save_table, to_dataframe, to_xarray
from .solvers import parallel
from .solvers.problem import Problem
from .solvers.problem_solution import ProblemSolution, load_problem_solution
from .solvers.problem_status import ProblemStatus
from .solvers.settings import Ipopt, Newton
from .stability import (
    Branch,
    Certificate,
    EnergyMap,
    Finding,
    FrictionBand,
    LoadLimit,
    Path,
    Snap,
    SnapSearch,
    StabilityMap,
    Verdict,
    WorstCertificate,
    WorstMargin,
    certify,
    deflection_bound,
    energy_map,
    find_equilibria,
    find_load_limit,
    find_snap,
    find_stroke_force,
    follow,
    friction_band,
    judge,
    snap_free_certificate,
    stability_map,
    trace_branch,
    worst_certificate,
    worst_margin,
)
from .validation.force import ForceEstimate, ForceRecord, estimate_force, estimate_forces
from .workspaces import SnappingLoss, Workspace, load_workspace, snapping_loss, workspace

__version__: str

__all__ = [
    "NITINOL",
    "ArmsPlan",
    "ArmsProof",
    "Branch",
    "Camera",
    "Certificate",
    "ClearanceCorrection",
    "ConcentricRobot",
    "DesignSolution",
    "DesignSolver",
    "DesignTask",
    "Discretisation",
    "EccentricRobot",
    "EnergyMap",
    "EntryRegion",
    "Equilibrium",
    "EquilibriumBatch",
    "EquilibriumBlock",
    "Feedback",
    "Finding",
    "ForceEstimate",
    "ForceRecord",
    "Friction",
    "FrictionBand",
    "HeatingPlan",
    "HeatingSolver",
    "HeatingSpec",
    "IkSession",
    "InputError",
    "InverseOptions",
    "InverseSolution",
    "InverseSolver",
    "InverseStatus",
    "Ipopt",
    "Jacobian",
    "JointLimits",
    "LeaderSolver",
    "Load",
    "LoadLimit",
    "Material",
    "Mold",
    "MoldSolver",
    "MoldSpec",
    "Newton",
    "OrderWarning",
    "PairReach",
    "Path",
    "Piece",
    "PlacedRobot",
    "PlanOptions",
    "Problem",
    "ProblemSolution",
    "ProblemStatus",
    "Proof",
    "RateLimits",
    "ReachShare",
    "RegionReach",
    "Rig",
    "RigSolver",
    "Roadmap",
    "SearchedDesign",
    "SearchedPair",
    "SegmentedEccentricRobot",
    "Slots",
    "Snap",
    "SnapSearch",
    "SnappingLoss",
    "SolveError",
    "StabilityMap",
    "Statistics",
    "Status",
    "Sweep",
    "Thermocouple",
    "TipGoal",
    "TipPathSolver",
    "Trajectory",
    "Tube",
    "TubeResistance",
    "Uncertainty",
    "Verdict",
    "Verification",
    "WaySearch",
    "Workspace",
    "WorstCertificate",
    "WorstMargin",
    "build_roadmap",
    "certify",
    "clearance_correction",
    "deflection_bound",
    "energy_map",
    "estimate_force",
    "estimate_forces",
    "evaluate_reach",
    "find_equilibria",
    "find_load_limit",
    "find_snap",
    "find_stroke_force",
    "follow",
    "follow_the_leader",
    "follow_tip_path",
    "forward_kinematics",
    "forward_kinematics_batch",
    "friction_band",
    "inverse_kinematics",
    "judge",
    "lead_by",
    "load_equilibrium",
    "load_problem_solution",
    "load_rig",
    "load_roadmap",
    "load_robot",
    "load_workspace",
    "optimize_design",
    "plan_arms",
    "plan_from_region",
    "plan_heating",
    "plan_mold",
    "plan_trajectory",
    "predict_tube",
    "save_rig",
    "save_robot",
    "save_solid",
    "save_table",
    "search_design",
    "search_pair",
    "show_in_3d",
    "snap_free_certificate",
    "snapping_loss",
    "stability_map",
    "sweep",
    "to_dataframe",
    "to_xarray",
    "trace_branch",
    "verify_arms",
    "verify_trajectory",
    "workspace",
    "worst_certificate",
    "worst_margin",
]
