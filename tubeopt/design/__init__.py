"""Tube design: robots that cannot snap, as nonlinear programs over tubes and task poses."""

from ..block.custom import CustomObjective, CustomRequirement
from ..block.quantities import Quantities
from .infeasibility import DesignNotFoundError, InfeasibleDesignError, LimitChange, Relaxation
from .objectives import Objective
from .optimize import DesignSolution, FrontPoint, ParetoFront, optimize_design, pareto_front
from .parameters import Free
from .requirements import (
    Avoid,
    Bore,
    Channel,
    Corridor,
    Coverage,
    Deflection,
    Deployment,
    Girth,
    Length,
    Nesting,
    Poses,
    Reach,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    StrokeForce,
    Target,
    Wall,
)
from .search import SearchedDesign, SearchedPair, search_design, search_pair
from .sensitivities import Dimension, Sensitivity
from .stock import Candidate, StockChoice, StockTube, choose_from_stock
from .task import DesignSolver, DesignTask
from .tolerance import ToleranceAnalysis, Tolerances, tolerance_analysis
from .verify import Check, Verification, count_snaps

OwnObjective, OwnRequirement = CustomObjective, CustomRequirement  # names before 0.2, for one release

__all__ = [
    "Avoid",
    "Bore",
    "Candidate",
    "Channel",
    "Check",
    "Corridor",
    "Coverage",
    "CustomObjective",
    "CustomRequirement",
    "Deflection",
    "Deployment",
    "DesignNotFoundError",
    "DesignSolution",
    "DesignSolver",
    "DesignTask",
    "Dimension",
    "Free",
    "FrontPoint",
    "Girth",
    "InfeasibleDesignError",
    "Length",
    "LimitChange",
    "Nesting",
    "Objective",
    "ParetoFront",
    "Poses",
    "Quantities",
    "Reach",
    "Relaxation",
    "SearchedDesign",
    "SearchedPair",
    "Sensitivity",
    "SnapFree",
    "SnapFreeInUse",
    "StockChoice",
    "StockTube",
    "Strain",
    "Stroke",
    "StrokeForce",
    "Target",
    "ToleranceAnalysis",
    "Tolerances",
    "Verification",
    "Wall",
    "choose_from_stock",
    "count_snaps",
    "optimize_design",
    "pareto_front",
    "search_design",
    "search_pair",
    "tolerance_analysis",
]
