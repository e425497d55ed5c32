"""Inverse kinematics with stable answers only: which joint values put the tip here, pointing there?"""

from .answer import InverseOptions, InverseSolution, InverseStatistics, InverseStatus, JointPath
from .solving import IkSession, inverse_kinematics

__all__ = [
    "IkSession",
    "InverseOptions",
    "InverseSolution",
    "InverseStatistics",
    "InverseStatus",
    "JointPath",
    "inverse_kinematics",
]
