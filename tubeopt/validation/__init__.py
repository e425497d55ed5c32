"""The model against measured tips: frames registered, errors told, chosen parameters of the robot estimated."""

from .comparison import Validation, predict, validate
from .errors import ErrorGroup, ErrorSummary, ErrorTable, group_errors
from .fitting import Estimate, Fit, fit
from .force import ForceEstimate, estimate_force
from .measurements import Measurements
from .parameters import Parameter, choose_parameters
from .registration import SENSOR_FRAME, BasePose, Registration, register

__all__ = [
    "SENSOR_FRAME",
    "BasePose",
    "ErrorGroup",
    "ErrorSummary",
    "ErrorTable",
    "Estimate",
    "Fit",
    "ForceEstimate",
    "Measurements",
    "Parameter",
    "Registration",
    "Validation",
    "choose_parameters",
    "estimate_force",
    "fit",
    "group_errors",
    "predict",
    "register",
    "validate",
]
