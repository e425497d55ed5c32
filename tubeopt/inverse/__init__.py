"""Inverse kinematics with stable answers only: which joint values put the tip here, pointing there?"""

from .answer import InverseSolution, InverseStatistics, InverseStatus, JointPath
from .session import IkSession
from .settings import InverseOptions
from .solving import inverse_kinematics

__all__ = [
    "IkSession",
    "InverseOptions",
    "InverseSolution",
    "InverseStatistics",
    "InverseStatus",
    "JointPath",
    "inverse_kinematics",
]
