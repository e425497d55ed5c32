"""Trajectories that never snap: on one stable branch, around obstacles, within rates, and proved."""

from .arms import ArmsProof, PairProof, PlacedRobot, verify_arms
from .arms_plan import ArmsPlan, plan_arms
from .deployment import Deployment, DeploymentStatus, deploy
from .goals import TipGoal
from .motion import RateLimits
from .optimal_motion import Motion
from .plan import EntryRegion, plan_from_region, plan_trajectory
from .proof import Proof, verify_trajectory
from .question import PlanOptions
from .reach_fraction import PairFraction, PairReach, ReachFraction, RegionReach, evaluate_reach
from .roadmap import Roadmap, build_roadmap, load_roadmap
from .tip_path import follow_the_leader, follow_tip_path
from .trajectory import Entry, PlanStatistics, Trajectory

__all__ = [
    "ArmsPlan",
    "ArmsProof",
    "Deployment",
    "DeploymentStatus",
    "Entry",
    "EntryRegion",
    "Motion",
    "PairFraction",
    "PairProof",
    "PairReach",
    "PlacedRobot",
    "PlanOptions",
    "PlanStatistics",
    "Proof",
    "RateLimits",
    "ReachFraction",
    "RegionReach",
    "Roadmap",
    "TipGoal",
    "Trajectory",
    "build_roadmap",
    "deploy",
    "evaluate_reach",
    "follow_the_leader",
    "follow_tip_path",
    "load_roadmap",
    "plan_arms",
    "plan_from_region",
    "plan_trajectory",
    "verify_arms",
    "verify_trajectory",
]
