"""The study of a heating: the schedule that sets the shape of a tube on a rig."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PlainValidator, ValidationInfo, model_validator

from ..files.checked import Number, Positive
from ..files.units import shown
from ..robots.tubes import Tube
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.rig import Rig
from ..shaping.heating.spec import HeatingSpec
from .base import Progress, RobotPath, Study, Whole
from .rig_file import load_rig


def _load(value: object, info: ValidationInfo) -> Rig:
    if isinstance(value, Rig):  # of a sweep, which has loaded or changed it
        return value
    if not isinstance(value, str):
        raise ValueError(f"is {shown(value)}; it must be the path of a rig file")
    return load_rig(info.context["directory"] / value if info.context else value)


RigPath = Annotated[
    Rig,
    PlainValidator(_load, json_schema_input_type=str),
    Field(description="path of the rig file, relative to this file"),
]
"""A rig, given as the path of its file."""


class HeatingStudy(Study):
    """The schedule that holds the curved part of a tube within a window of temperature."""

    kind: Literal["heating"]
    rig: RigPath
    robot: RobotPath | None = Field(None, description="whose tube is heated; by default the rig's own tube")
    tube: Annotated[Whole, Field(ge=1)] = Field(1, description="which tube of the robot, from 1")
    window_degC: Annotated[list[Number], Field(min_length=2, max_length=2)] = Field(
        [Decimal(500), Decimal(550)], description="of the curved part during the hold"
    )
    limit_degC: Number | None = Field(None, description="for every point at all times; by default the window's end")
    hold_s: Positive = Field(Decimal(60), description="length of the hold")
    ramp_K_per_s: Positive = Field(Decimal(20), description="greatest rate of warming")
    objective: Literal["time", "energy", "margin"] = "time"
    slot_s: Positive = Field(Decimal("0.5"), description="for how long a duty is kept")
    longest_s: Positive = Field(Decimal(120), description="longest heating before the hold")
    quench: Literal["water", "air"] = "water"
    free: list[Literal["clearance", "lead", "vents"]] = Field([], description="what of the rig may be chosen")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._tube()
        self._spec()
        return self

    def _tube(self) -> Tube:
        if self.robot is None:
            if self.rig.tube is None:
                raise ValueError("robot is missing; the rig file names no tube")
            return self.rig.tube
        if self.tube > self.robot.n_tubes:
            raise ValueError(f"tube is {self.tube}; it must be 1 to {self.robot.n_tubes}")
        chosen: Any = self.robot.tubes[self.tube - 1]
        return chosen  # type: ignore[no-any-return]

    def _spec(self) -> HeatingSpec:
        low, high = (float(value) for value in self.window_degC)
        return HeatingSpec(
            window_degC=(low, high),
            hold_time=float(self.hold_s),
            limit_degC=None if self.limit_degC is None else float(self.limit_degC),
            ramp=float(self.ramp_K_per_s),
            objective=self.objective,
            longest_heating=float(self.longest_s),
            slot=float(self.slot_s),
            quench=self.quench,
            free=tuple(self.free),
        )

    def run(self, progress: Progress | None = None) -> HeatingPlan:
        """The plan; where it cannot hold the window, its `feasible` is false and it says by how much."""
        return plan_heating(self._tube(), self.rig, self._spec())
