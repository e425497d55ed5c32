"""The study of a mold: the grooves that set the shape of a robot's tubes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..display import Displayed
from ..files.checked import NotNegative, in_file
from ..files.units import MM, to_si
from ..robots.tubes import Tube
from ..shaping.mold.heat import HeatSpec
from ..shaping.mold.materials import mold_material
from ..shaping.mold.ranking import MaterialRating
from ..shaping.mold.robot import RobotMold, chosen_tubes, plan_robot_mold
from ..shaping.mold.spec import MoldSpec
from ..shaping.mold.springback import Springback
from .base import Progress, RobotPath, Study, Whole
from .mold_file import load_mold_spec, load_springback


@dataclass(frozen=True, eq=False)
class Ranking(Displayed):
    """Mold materials for a tube, best first.   heat: the heating that they are for."""

    ratings: tuple[MaterialRating, ...]
    tube: Tube
    heat: HeatSpec


MoldPath = Annotated[
    MoldSpec,
    in_file(load_mold_spec, "a mold file", kind=MoldSpec),
    Field(description="path of the mold file, relative to this file"),
]
"""What is asked of a mold, given as the path of its file."""


class MoldStudy(Study):
    """The mold for the tubes of a robot."""

    kind: Literal["mold_plan"]
    robot: RobotPath
    mold: MoldPath | None = Field(None, description="what is asked of the mold", examples=["MOLD.yaml"])
    tubes: list[Whole] | None = Field(
        None, description="which tubes, from 1; by default every different curved one", examples=["N,.."]
    )
    material: str | None = Field(
        None, description="of both plates: steel, mdf, glass_mica, calcium_silicate; by default the mold file's"
    )
    springback: Annotated[Springback, in_file(load_springback, "a spring-back file")] | None = Field(
        None, description="spring-back from `tubeopt mold calibrate`: a YAML file", examples=["FILE.yaml"]
    )
    cold_length_mm: NotNegative | None = Field(
        None, description="from a clamp to where the tube is hot; by default estimated"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._spec()
        chosen_tubes(self.robot, self._numbers())
        return self

    def _spec(self) -> MoldSpec:
        """What is asked of the mold, with what is given in its place."""
        spec = self.mold or MoldSpec()
        if self.material is not None:
            spec = replace(spec, material=mold_material(self.material))
        if self.springback is not None:
            spec = replace(spec, springback=self.springback)
        return spec if self.cold_length_mm is None else replace(spec, cold_length=to_si(self.cold_length_mm, MM))

    def _numbers(self) -> list[int] | None:
        return None if self.tubes is None else [int(number) for number in self.tubes]

    def run(self, progress: Progress | None = None) -> RobotMold:
        """The mold; raises InputError where none can be made."""
        return plan_robot_mold(self.robot, self._spec(), self._numbers())
