"""The study of several robots beside each other: motions that take all to their goals, and none touches another."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..bodies.anatomy import Anatomy
from ..bodies.frames import Frame
from ..bodies.obstacles import Obstacle
from ..files.checked import Entry, NotNegative, Positive, Triple, Whole
from ..files.units import MM, to_si
from ..planning import ArmsPlan, PlacedRobot, PlanOptions, TipGoal, plan_arms
from ..typing import Array
from .anatomy_file import AnatomyKey, BasePart
from .base import OnePerTube, Progress, RobotPath, Study, joints_of
from .obstacle_file import Bodies, Place, point
from .plan_study import RatesEntry


class PlacedPart(Entry):
    """One of several robots: where it stands, and from where it begins."""

    robot: RobotPath
    name: str = Field("", description="what messages and pictures call it; by default the robot's name")
    base: BasePart | None = Field(None, description="where its plate stands in the frame that all share")
    start_deg: OnePerTube | None = Field(None, description="rotations at the start; all 0 where not given")
    start_mm: OnePerTube | None = Field(None, description="translations at the start; home where not given")

    @property
    def start(self) -> tuple[Array, Array]:
        """Joint values with which it begins."""
        return joints_of(self.robot, self.start_deg, self.start_mm)

    def placed(self, anatomy: Anatomy) -> PlacedRobot:
        """The robot where it stands; landmarks are those of an anatomy."""
        base = Frame() if self.base is None else self.base.frame(anatomy.landmarks)
        return PlacedRobot(self.robot, base, self.name)


def shared(anatomy: Anatomy | None) -> Anatomy:
    """What is around all arms; raises ValueError where it says where a plate stands, as that of one robot does."""
    found = Anatomy() if anatomy is None else anatomy
    if not (np.array_equal(found.base.axes, np.eye(3)) and np.array_equal(found.base.origin, np.zeros(3))):
        raise ValueError("anatomy has a base or a registration, of one robot; here every arm has a base")
    return found


class ArmPart(PlacedPart):
    """One of the robots, and its goal; without one it stays where it is."""

    goal_deg: OnePerTube | None = Field(None, description="rotations at the goal; those of the start where not given")
    goal_mm: OnePerTube | None = Field(None, description="translations at the goal; those of the start where not given")
    tip_mm: Place | None = Field(None, description="goal as a position of the tip, in the frame that all share")
    tip_at: str | None = Field(None, description="goal of the tip: a landmark of the anatomy, or its target")
    tip_direction: Triple | None = Field(None, description="along which the tip shall point, of any length")

    @model_validator(mode="after")
    def _one_goal(self) -> Self:
        joints = self.goal_deg is not None or self.goal_mm is not None
        if joints + (self.tip_mm is not None) + (self.tip_at is not None) > 1:
            raise ValueError("has several goals; it must have one: goal_deg and goal_mm, tip_mm, or tip_at")
        if self.tip_direction is not None and self.tip_mm is None and self.tip_at is None:
            raise ValueError("tip_direction is given without tip_mm or tip_at")
        return self

    def ends(self, anatomy: Anatomy) -> tuple[tuple[Array, Array], Any]:
        """Start and goal."""
        towards = None if self.tip_direction is None else np.array([float(x) for x in self.tip_direction])
        if self.tip_mm is not None:
            return self.start, TipGoal(np.array(point(self.tip_mm)), towards)
        if self.tip_at is not None:
            return self.start, TipGoal(anatomy.place(self.tip_at), towards)
        return self.start, joints_of(self.robot, self.goal_deg or self.start_deg, self.goal_mm or self.start_mm)


class ArmsStudy(Study):
    """Motions of several robots on one plate or endoscope, each on one stable branch, none touching another."""

    doing = "planning"

    kind: Literal["plan_arms"]
    arms: Annotated[list[ArmPart], Field(min_length=2)] = Field(description="the robots, two at least")
    obstacles: Bodies = Field(
        (), description="bodies that all arms keep away from, in the frame that they share: a list, or a YAML file"
    )
    anatomy: AnatomyKey | None = Field(
        None, description="images, meshes and clouds of a patient: what they are made of, or a YAML file"
    )
    clearance_mm: NotNegative = Field(
        Decimal("0.5"), description="least distance of every arm from bodies, and from all others"
    )
    min_margin: NotNegative = Field(Decimal("0.05"), lt=1, description="least stability margin", examples=["MU"])
    rates: RatesEntry = Field(default_factory=RatesEntry, description="how fast the actuators are")
    objective: Literal["length", "time", "effort", "margin", "none"] = Field(
        "length", description="of the smoothing: length, time, effort, margin or none"
    )
    time_limit_s: Positive = Field(Decimal(120), description="for all of it")
    seed: Annotated[Whole, Field(ge=0)] = Field(0, description="of the search", examples=["K"])

    @model_validator(mode="after")
    def _landmarks(self) -> Self:
        for arm in self.arms:
            arm.placed(self._around)
            arm.ends(self._around)
        return self

    @property
    def _around(self) -> Anatomy:
        return shared(self.anatomy)

    @property
    def bodies(self) -> tuple[Obstacle, ...]:
        """Obstacles, and those of the anatomy."""
        return self.obstacles + self._around.bodies

    def run(self, progress: Progress | None = None) -> ArmsPlan:
        """The motions; raises SolveError where there are none, or none were found in time."""
        if progress is not None:
            progress(0, 0)
        ends = [arm.ends(self._around) for arm in self.arms]
        return plan_arms(
            [arm.placed(self._around) for arm in self.arms],
            [start for start, _ in ends],
            [goal for _, goal in ends],
            obstacles=self.bodies,
            min_margin=float(self.min_margin),
            rate_limits=self.rates.build(),
            options=PlanOptions(
                objective=self.objective,
                time_limit=float(self.time_limit_s),
                clearance=to_si(self.clearance_mm, MM),
                seed=self.seed,
            ),
        )
