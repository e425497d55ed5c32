"""Comparison of the model with measured tips: registration of frames, errors, and effects that explain them."""

from ..bodies.frames import RegistrationError
from .certainty import RealRobots, Uncertainty, path_bounds, real_robots, uncertainty
from .comparison import ErrorGroup, ErrorSummary, ErrorTable, Validation, group_errors, validate
from .effects import EFFECTS, KINDS, PER_RECORDING
from .fitting import Estimate, Fit, FitOptions, fit
from .floor import servo_floor
from .force import ForceEstimate, ForceRecord, estimate_force, estimate_forces
from .identifiability import Placement, where_to_measure
from .measurements import JointLog, Measurements, Parity
from .parameters import Parameter, choose_parameters
from .reading import Detection, RawLog, Reading, detect
from .registration import SENSOR_FRAME, BasePose, Registration, register
from .selection import Comparison, SelectionStep, compare_effects

__all__ = [
    "EFFECTS",
    "KINDS",
    "PER_RECORDING",
    "SENSOR_FRAME",
    "BasePose",
    "Comparison",
    "Detection",
    "ErrorGroup",
    "ErrorSummary",
    "ErrorTable",
    "Estimate",
    "Fit",
    "FitOptions",
    "ForceEstimate",
    "ForceRecord",
    "JointLog",
    "Measurements",
    "Parameter",
    "Parity",
    "Placement",
    "RawLog",
    "Reading",
    "RealRobots",
    "Registration",
    "RegistrationError",
    "SelectionStep",
    "Uncertainty",
    "Validation",
    "choose_parameters",
    "compare_effects",
    "detect",
    "estimate_force",
    "estimate_forces",
    "fit",
    "group_errors",
    "path_bounds",
    "real_robots",
    "register",
    "servo_floor",
    "uncertainty",
    "validate",
    "where_to_measure",
]
