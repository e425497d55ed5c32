"""The study of forward kinematics: the equilibrium of a robot at given joint values."""

from __future__ import annotations

import logging
from decimal import Decimal
from typing import Literal

from pydantic import Field

from ..equilibrium.kinematics import KINEMATICS_LIMIT, forward_kinematics
from ..equilibrium.result import Equilibrium
from ..files.checked import Positive
from ..typing import Progress
from .base import Posed
from .load_file import LoadedStudy

LOGGER = logging.getLogger(__name__)


class ForwardKinematicsStudy(Posed, LoadedStudy):
    """The equilibrium of a robot at given joint values. A calibrated robot takes readings."""

    doing = "solving the shape"

    kind: Literal["forward_kinematics"]
    method: Literal["newton", "ipopt", "energy"] = Field("newton", description="solver: newton, ipopt or energy")
    tolerance_rad: Positive = Field(Decimal("1e-8"), description="largest allowed error of tube angles")
    verify: bool = Field(False, description="compare the result with an independent adaptive integration")
    time_limit_s: Positive = Field(Decimal(int(KINEMATICS_LIMIT)), description="time limit of the solve")

    def run(self, progress: Progress | None = None) -> Equilibrium:
        """The equilibrium; raises SolveError where none is found."""
        found = forward_kinematics(
            self.robot,
            *self.joints,
            load=self.pushing(),
            method=self.method,
            tolerance=self.si("tolerance_rad"),
            verify=self.verify,
            time_limit=self.si("time_limit_s"),
        )
        if not found.arc_length[-1]:
            LOGGER.warning("no tube is in front of the base plate at these translations; the tip lies in the plate")
        return found
