"""Studies as YAML: a question about a robot, with everything that it takes to answer it.

A new kind of study is a subclass of `Study` with its own keys and `run`, entered in `STUDY_KINDS`.
"""

from __future__ import annotations

from decimal import Decimal
from os import PathLike
from typing import Literal

import numpy as np
from pydantic import Field

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..files.checked import Positive, check_kind
from ..files.yaml_file import load_yaml
from ..robots.calibration import to_model
from .base import OnePerTube, Progress, RobotPath, Study, metres, radians
from .design_study import DesignStudy
from .heating_study import HeatingStudy
from .inverse_study import InverseStudy
from .load_file import LoadedStudy
from .load_studies import ForceStudy, LoadLimitStudy
from .measure_study import MeasureStudy
from .mold_study import MoldStudy
from .plan_study import PlanStudy
from .stability_studies import CertifyStudy, EquilibriaStudy, FollowStudy, SnapStudy, StabilityMapStudy
from .validation_study import ValidationStudy
from .workspace_study import WorkspaceStudy


class ForwardKinematicsStudy(LoadedStudy):
    """The equilibrium of a robot at given joint values: readings, where the robot has a calibration."""

    kind: Literal["forward_kinematics"]
    robot: RobotPath
    rotations_deg: OnePerTube | None = Field(
        None, description="rotation of every tube, inner to outer; by default all 0"
    )
    translations_mm: OnePerTube | None = Field(
        None, description="translation of every tube, inner to outer; by default home"
    )
    method: Literal["newton", "ipopt", "energy"] = Field("newton", description="how to solve: newton, ipopt, energy")
    tolerance_rad: Positive = Field(Decimal("1e-8"), description="largest error of the tubes' angles")
    verify: bool = Field(False, description="compare with an adaptive re-integration")

    def run(self, progress: Progress | None = None) -> Equilibrium:
        """The equilibrium; raises SolveError where none is found."""
        rotations = radians(self.rotations_deg, np.zeros(self.robot.n_tubes))
        translations = metres(self.translations_mm, self.robot.home_translations)
        return forward_kinematics(
            self.robot,
            *to_model(self.robot, rotations, translations),
            load=self.pushing(),
            method=self.method,
            tolerance=float(self.tolerance_rad),
            verify=self.verify,
        )


STUDY_KINDS: dict[str, type[Study]] = {
    "forward_kinematics": ForwardKinematicsStudy,
    "inverse_kinematics": InverseStudy,
    "equilibria": EquilibriaStudy,
    "snap": SnapStudy,
    "follow": FollowStudy,
    "load_limit": LoadLimitStudy,
    "force": ForceStudy,
    "certify": CertifyStudy,
    "stability_map": StabilityMapStudy,
    "validation": ValidationStudy,
    "measure": MeasureStudy,
    "design": DesignStudy,
    "plan": PlanStudy,
    "workspace": WorkspaceStudy,
    "heating": HeatingStudy,
    "mold_plan": MoldStudy,
}
"""What the key `kind` of a study file may say."""


def load_study(path: str | PathLike[str]) -> Study:
    """The study in a YAML file, its robot loaded; call its `run` for the answer.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no study: one line for every problem.
    """
    data = load_yaml(path)
    if data.get("kind") == "sweep":
        raise InputError(f"{path}: kind is 'sweep'; this is for `tubeopt sweep`, where a study is asked for")
    return check_kind(STUDY_KINDS, data, path)
