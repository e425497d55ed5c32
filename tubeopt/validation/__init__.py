"""The model against measured tips: frames registered, errors told, the effects found that part robot and drawing."""

from ..bodies.certainty import RegistrationError
from .comparison import ErrorGroup, ErrorSummary, ErrorTable, Validation, group_errors, validate
from .descent import FitSolver
from .effects import EFFECTS, KINDS
from .fitting import Estimate, Fit, FitOptions, fit
from .folds import Parity
from .force import ForceEstimate, ForceRecord, ForceSolver, estimate_force, estimate_forces
from .measurements import JointLog, Measurements
from .parameters import Parameter, choose_parameters
from .placing import Placement, PlacementSearch, where_to_measure
from .registration import SENSOR_FRAME, BasePose, Registration, register
from .selection import Comparison, Step, compare_effects

__all__ = [
    "EFFECTS",
    "KINDS",
    "SENSOR_FRAME",
    "BasePose",
    "Comparison",
    "ErrorGroup",
    "ErrorSummary",
    "ErrorTable",
    "Estimate",
    "Fit",
    "FitOptions",
    "FitSolver",
    "ForceEstimate",
    "ForceRecord",
    "ForceSolver",
    "JointLog",
    "Measurements",
    "Parameter",
    "Parity",
    "Placement",
    "PlacementSearch",
    "Registration",
    "RegistrationError",
    "Step",
    "Validation",
    "choose_parameters",
    "compare_effects",
    "estimate_force",
    "estimate_forces",
    "fit",
    "group_errors",
    "register",
    "validate",
    "where_to_measure",
]
