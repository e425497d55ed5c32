"""Control at 1 kHz: a servo, its snap guard, a state estimator, and their interfaces."""

from .c_library import CLibrary, c_library, robot_description, save_c_library
from .command import Command, ServoOptions, ServoStep, Why
from .estimator import (
    BaseReading,
    Correction,
    CurvatureReading,
    EstimatorOptions,
    StateEstimate,
    StateEstimator,
    TipReading,
)
from .lookahead import PredictiveServo
from .servo import Servo

__all__ = [
    "BaseReading",
    "CLibrary",
    "Command",
    "Correction",
    "CurvatureReading",
    "EstimatorOptions",
    "PredictiveServo",
    "Servo",
    "ServoOptions",
    "ServoStep",
    "StateEstimate",
    "StateEstimator",
    "TipReading",
    "Why",
    "c_library",
    "robot_description",
    "save_c_library",
]
