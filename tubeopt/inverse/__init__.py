"""Inverse kinematics that never answers with a snap: which joint values put the tip here, pointing there?"""

from .answer import InverseOptions, InverseSolution, InverseStatistics, InverseStatus
from .session import IkSession
from .solving import inverse_kinematics

__all__ = [
    "IkSession",
    "InverseOptions",
    "InverseSolution",
    "InverseStatistics",
    "InverseStatus",
    "inverse_kinematics",
]
