"""The study of a mold: the grooves that set the shape of a robot's tubes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, PlainValidator, ValidationInfo, model_validator

from ..files.units import shown
from ..robots.tubes import Tube
from ..shaping.mold.heat import HeatSpec
from ..shaping.mold.ranking import MaterialRating
from ..shaping.mold.robot import RobotMold, chosen_tubes, plan_robot_mold
from ..shaping.mold.spec import MoldSpec
from .base import Progress, RobotPath, Study, Whole
from .mold_file import load_mold_spec


@dataclass(frozen=True, eq=False)
class Ranking:
    """Mold materials for a tube, best first.   heat: the heating that they are for."""

    ratings: tuple[MaterialRating, ...]
    tube: Tube
    heat: HeatSpec


def _load(value: object, info: ValidationInfo) -> MoldSpec:
    if isinstance(value, MoldSpec):  # of a sweep, which has loaded or changed it
        return value
    if not isinstance(value, str):
        raise ValueError(f"is {shown(value)}; it must be the path of a mold file")
    return load_mold_spec(info.context["directory"] / value if info.context else value)


MoldPath = Annotated[
    MoldSpec,
    PlainValidator(_load, json_schema_input_type=str),
    Field(description="path of the mold file, relative to this file"),
]
"""What is asked of a mold, given as the path of its file."""


class MoldStudy(Study):
    """The mold for the tubes of a robot."""

    kind: Literal["mold_plan"]
    robot: RobotPath
    mold: MoldPath | None = Field(None, description="what is asked of it; by default what `tubeopt mold` takes")
    tubes: list[Whole] | None = Field(None, description="numbers from 1; by default every different curved tube")

    @model_validator(mode="after")
    def _has_tubes(self) -> Self:
        chosen_tubes(self.robot, self._numbers())
        return self

    def _numbers(self) -> list[int] | None:
        return None if self.tubes is None else [int(number) for number in self.tubes]

    def run(self, progress: Progress | None = None) -> RobotMold:
        """The mold; raises InputError where none can be made."""
        return plan_robot_mold(self.robot, self.mold, self._numbers())
