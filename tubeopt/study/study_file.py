"""Studies as YAML: a question about a robot, with everything that it takes to answer it.

A new kind of study is a subclass of `Study` with its own keys and `run`, entered in `STUDY_KINDS`.
"""

from __future__ import annotations

from decimal import Decimal
from os import PathLike
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PlainValidator, ValidationInfo, field_validator

from ..equilibrium import Equilibrium
from ..kinematics import forward_kinematics
from ..robots.concentric import ConcentricRobot
from .checked import Entry, Number, Positive, check_kind
from .robot_file import load_robot
from .units import DEG, MM, shown, to_si
from .yaml_file import load_yaml


def _load(value: object, info: ValidationInfo) -> ConcentricRobot:
    if not isinstance(value, str):
        raise ValueError(f"is {shown(value)}; it must be the path of a robot file")
    return load_robot(info.context["directory"] / value if info.context else value)


RobotPath = Annotated[
    ConcentricRobot,
    PlainValidator(_load, json_schema_input_type=str),
    Field(description="path of the robot file, relative to this file"),
]
"""A robot, given as the path of its file."""


class Study(Entry):
    """What all kinds of study have in common."""

    kind: str

    def run(self) -> Any:
        """The answer to the question that the study asks."""
        raise NotImplementedError


class ForwardKinematicsStudy(Study):
    """The equilibrium of a robot at given joint values."""

    kind: Literal["forward_kinematics"]
    robot: RobotPath
    rotations_deg: list[Number] | None = Field(None, description="one per tube; all 0 where not given")
    translations_mm: list[Number] | None = Field(None, description="one per tube, from home; all 0 where not given")
    method: Literal["newton", "ipopt", "energy"] = "newton"
    tolerance_rad: Positive = Decimal("1e-8")
    verify: bool = Field(False, description="compare with an adaptive re-integration")

    @field_validator("rotations_deg", "translations_mm")
    @classmethod
    def _one_per_tube(cls, values: list[Decimal] | None, info: ValidationInfo) -> list[Decimal] | None:
        robot = info.data.get("robot")  # absent where the robot itself has problems
        if values is not None and robot is not None and len(values) != robot.n_tubes:
            count = "1 number" if len(values) == 1 else f"{len(values)} numbers"
            raise ValueError(f"has {count}; it must be {robot.n_tubes} (one per tube)")
        return values

    def run(self) -> Equilibrium:
        """The equilibrium; raises SolveError where none is found."""
        return forward_kinematics(
            self.robot,
            _in_si(self.rotations_deg, DEG, self.robot.n_tubes),
            _in_si(self.translations_mm, MM, self.robot.n_tubes),
            method=self.method,
            tolerance=float(self.tolerance_rad),
            verify=self.verify,
        )


def _in_si(values: list[Decimal] | None, unit: Decimal, n: int) -> np.ndarray:
    return np.zeros(n) if values is None else np.array([to_si(value, unit) for value in values])


STUDY_KINDS: dict[str, type[Study]] = {"forward_kinematics": ForwardKinematicsStudy}
"""What the key `kind` of a study file may say."""


def load_study(path: str | PathLike[str]) -> Study:
    """The study in a YAML file, its robot loaded; call its `run` for the answer.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no study: one line for every problem.
    """
    return check_kind(STUDY_KINDS, load_yaml(path), path)
