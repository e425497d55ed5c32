"""Control at 1 kHz: a servo, its snap guard, an observer, and their interfaces."""

from .c_library import CLibrary, c_library, robot_description, save_c_library
from .command import Command, ServoOptions, ServoStep, Why
from .lookahead import PredictiveServo
from .observer import Correction, Observer, ObserverOptions
from .servo import Servo

__all__ = [
    "CLibrary",
    "Command",
    "Correction",
    "Observer",
    "ObserverOptions",
    "PredictiveServo",
    "Servo",
    "ServoOptions",
    "ServoStep",
    "Why",
    "c_library",
    "robot_description",
    "save_c_library",
]
