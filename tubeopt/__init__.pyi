# The names of `tubeopt`, and where each comes from: loaded when it is first used.

from . import (
    block,
    bodies,
    control,
    design,
    equilibrium,
    errors,
    files,
    inverse,
    physics,
    planning,
    plot,
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
from .bodies import Box, Capsule, Corridor, HalfSpace, MeshObstacle, Sphere
from .control import Command, Servo, ServoOptions
from .design import (
    DesignSolution,
    DesignSolver,
    DesignTask,
    Free,
    Objective,
    SearchedDesign,
    SearchedPair,
    SnapFree,
    optimize_design,
    search_design,
    search_pair,
)
from .equilibrium.batch import EquilibriumBatch, forward_kinematics_batch
from .equilibrium.clearance import ClearanceCorrection, clearance_correction
from .equilibrium.file import load_equilibrium
from .equilibrium.kinematics import forward_kinematics
from .equilibrium.problem import Discretisation
from .equilibrium.result import Equilibrium, Jacobian, Statistics, Status, Verification
from .errors import InputError, SolveError
from .inverse import (
    IkSession,
    InverseOptions,
    InverseSolution,
    InverseStatus,
    inverse_kinematics,
)
from .planning import (
    ArmsPlan,
    ArmsProof,
    EntryRegion,
    Motion,
    PairReach,
    PlacedRobot,
    PlanOptions,
    Proof,
    RateLimits,
    ReachFraction,
    RegionReach,
    Roadmap,
    TipGoal,
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
from .robots.calibration import Calibration
from .robots.concentric import ConcentricRobot, Friction
from .robots.eccentric import BundleRobot, EccentricRobot, SegmentedEccentricRobot
from .robots.file import load_robot, save_robot
from .robots.limits import JointLimits
from .robots.load import Load
from .robots.materials import NITINOL, Material
from .robots.pieces import Piece, Slots
from .robots.tubes import Tube
from .runs.measurement_file import load_measurements
from .runs.study_file import load_study
from .runs.sweeping import Sweep, sweep
from .runs.workshop_file import load_oven, load_rig, save_rig
from .shaping import Mold, MoldSpec, plan_mold, predict_tube
from .shaping.heating.controller import Feedback
from .shaping.heating.heating_block import HeatingBlock
from .shaping.heating.oven import Oven, OvenPlan, plan_oven
from .shaping.heating.plan import HeatingPlan
from .shaping.heating.planning import plan_heating
from .shaping.heating.rig import Rig
from .shaping.heating.robust import design_feedback
from .shaping.heating.sensors import Camera, Thermocouple, TubeResistance
from .shaping.heating.spec import HeatingSpec
from .shaping.heating.uncertainty import Uncertainty
from .show.notebook import show_in_3d
from .show.plots.shape import plot_shape, plot_shapes
from .show.surfaces import save_solid
from .show.tables import save_table, to_dataframe, to_xarray
from .solvers import parallel
from .solvers.named_program import ProblemSolution, ProblemStatus, load_problem_solution
from .solvers.problem import Problem
from .solvers.settings import Ipopt, Newton
from .stability import (
    Branch,
    Certificate,
    EnergyMap,
    EquilibriaSearch,
    Finding,
    FrictionBand,
    LoadLimit,
    Path,
    Snap,
    SnapAssessment,
    SnapDistance,
    SnapInTime,
    SnapSearch,
    StabilityMap,
    WorstCertificate,
    WorstMargin,
    assess_snapping,
    certify,
    deflection_bound,
    energy_map,
    find_equilibria,
    find_load_limit,
    find_snap,
    find_stroke_force,
    follow,
    friction_band,
    snap_distance,
    snap_free_certificate,
    snap_in_time,
    stability_map,
    trace_branch,
    worst_certificate,
    worst_margin,
)
from .validation import Measurements, validate
from .validation.force import ForceEstimate, ForceRecord, estimate_force, estimate_forces
from .workspaces import SnappingLoss, Workspace, load_workspace, snapping_loss, workspace

__version__: str
RENAMED: dict[str, str]

__all__ = [
    "NITINOL",
    "ArmsPlan",
    "ArmsProof",
    "Box",
    "Branch",
    "BundleRobot",
    "Calibration",
    "Camera",
    "Capsule",
    "Certificate",
    "ClearanceCorrection",
    "Command",
    "ConcentricRobot",
    "Corridor",
    "DesignSolution",
    "DesignSolver",
    "DesignTask",
    "Discretisation",
    "EccentricRobot",
    "EnergyMap",
    "EntryRegion",
    "EquilibriaSearch",
    "Equilibrium",
    "EquilibriumBatch",
    "EquilibriumBlock",
    "Feedback",
    "Finding",
    "ForceEstimate",
    "ForceRecord",
    "Free",
    "Friction",
    "FrictionBand",
    "HalfSpace",
    "HeatingBlock",
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
    "Load",
    "LoadLimit",
    "Material",
    "Measurements",
    "MeshObstacle",
    "Mold",
    "MoldSpec",
    "Motion",
    "Newton",
    "Objective",
    "OrderWarning",
    "Oven",
    "OvenPlan",
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
    "ReachFraction",
    "RegionReach",
    "Rig",
    "Roadmap",
    "SearchedDesign",
    "SearchedPair",
    "SegmentedEccentricRobot",
    "Servo",
    "ServoOptions",
    "Slots",
    "Snap",
    "SnapAssessment",
    "SnapDistance",
    "SnapFree",
    "SnapInTime",
    "SnapSearch",
    "SnappingLoss",
    "SolveError",
    "Sphere",
    "StabilityMap",
    "Statistics",
    "Status",
    "Sweep",
    "Thermocouple",
    "TipGoal",
    "Trajectory",
    "Tube",
    "TubeResistance",
    "Uncertainty",
    "Verification",
    "Workspace",
    "WorstCertificate",
    "WorstMargin",
    "assess_snapping",
    "build_roadmap",
    "certify",
    "clearance_correction",
    "deflection_bound",
    "design_feedback",
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
    "load_equilibrium",
    "load_measurements",
    "load_oven",
    "load_problem_solution",
    "load_rig",
    "load_roadmap",
    "load_robot",
    "load_study",
    "load_workspace",
    "optimize_design",
    "plan_arms",
    "plan_from_region",
    "plan_heating",
    "plan_mold",
    "plan_oven",
    "plan_trajectory",
    "plot_shape",
    "plot_shapes",
    "predict_tube",
    "save_rig",
    "save_robot",
    "save_solid",
    "save_table",
    "search_design",
    "search_pair",
    "show_in_3d",
    "snap_distance",
    "snap_free_certificate",
    "snap_in_time",
    "snapping_loss",
    "stability_map",
    "sweep",
    "to_dataframe",
    "to_xarray",
    "trace_branch",
    "validate",
    "verify_arms",
    "verify_trajectory",
    "workspace",
    "worst_certificate",
    "worst_margin",
]
