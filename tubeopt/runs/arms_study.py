"""The study of several robots beside each other: motions that take all to their goals, and none touches another."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..bodies.anatomy import Anatomy
from ..bodies.frames import Frame
from ..files.checked import NotNegative, Positive
from ..files.field_metadata import Typical
from ..files.fields import asking, values
from ..planning import ArmsPlan, PlacedRobot, PlanOptions, plan_arms
from ..typing import Progress
from .anatomy_file import BasePart
from .obstacle_file import Bodies, Place, Surrounded
from .plan_study import Aimed, RatesEntry, check_rates
from .robot_keys import Started
from .study_file import Study


class PlacedPart(Started):
    """One of several robots: where it stands, and from where it begins."""

    name: str = Field("", description="name in messages and plots; default the name of the robot")
    base: BasePart | None = Field(None, description="base plate in the common frame")

    def placed(self, anatomy: Anatomy) -> PlacedRobot:
        """The robot where it stands; landmarks are those of an anatomy."""
        base = Frame() if self.base is None else self.base.frame(anatomy.landmarks)
        return PlacedRobot(self.robot, base, self.name)


def shared(anatomy: Anatomy | None) -> Anatomy:
    """What is around all arms; raises ValueError where it says where a plate stands, as that of one robot does."""
    found = Anatomy() if anatomy is None else anatomy
    if not (np.array_equal(found.base.axes, np.eye(3)) and np.array_equal(found.base.origin, np.zeros(3))):
        raise ValueError("anatomy has a base or a registration; give the base of every arm instead")
    return found


class ArmPart(Aimed, PlacedPart):
    """One of the robots and its goal; without a goal it does not move."""

    tip_mm: Place | None = Field(None, description="goal position of the tip in the common frame")

    @model_validator(mode="after")
    def _one_goal(self) -> Self:
        joints = self.goal_deg is not None or self.goal_mm is not None
        if joints + (self.tip_mm is not None) + (self.tip_at is not None) > 1:
            raise ValueError("has several goals; it must have one: goal_deg and goal_mm, tip_mm, or tip_at")
        return self


@asking(PlanOptions, "objective", "seed")
class ArmsStudy(Surrounded, Study):
    """Motions of several robots on one plate or endoscope, without snap and without contact between them."""

    doing = "planning"
    assuming = "Results assume no friction, load or weight."

    kind: Literal["plan_arms"]
    arms: Annotated[list[ArmPart], Field(min_length=2)] = Field(description="the robots, at least two")
    obstacles: Bodies = Field(
        (), description="obstacles for all arms, in the common frame: a YAML file or a list of bodies"
    )
    clearance_mm: Annotated[NotNegative, Typical(1e-5, 0.1)] = Field(
        Decimal("0.5"), description="smallest allowed distance of every arm from obstacles and other arms"
    )
    min_margin: NotNegative = Field(
        Decimal("0.05"), lt=1, description="smallest allowed stability margin, below 1", examples=["MU"]
    )
    rates: RatesEntry = Field(default_factory=RatesEntry, description="rate and acceleration limits of the actuators")
    time_limit_s: Positive = Field(Decimal(120), description="time limit of the command")

    @model_validator(mode="after")
    def _landmarks(self) -> Self:
        check_rates(self.rates, *(arm.robot for arm in self.arms))
        around = shared(self.anatomy)
        for arm in self.arms:
            arm.placed(around)
            arm.goal(around)
        return self

    def run(self, progress: Progress | None = None) -> ArmsPlan:
        """The motions; raises SolveError where there are none, or none were found in time."""
        return plan_arms(
            [arm.placed(self.around) for arm in self.arms],
            [arm.start for arm in self.arms],
            [arm.goal(self.around) for arm in self.arms],
            obstacles=self.bodies,
            min_margin=self.si("min_margin"),
            rate_limits=self.rates.build(),
            options=PlanOptions(**values(PlanOptions, self)),
        )
