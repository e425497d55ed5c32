"""The study of everything that it takes to make a robot: molds and heating schedules for every tube, in one go."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..display import Displayed
from ..files.checked import Positive, Whole
from ..robots.robot import Robot
from ..shaping.mold.heat import heating_for
from ..shaping.mold.robot import RobotMold, chosen_tubes
from ..shaping.mold.spec import MoldSpec
from ..shaping.tube_fabrication import TubeFabrication, plan_tube
from ..typing import Progress
from .heating_study import SAMPLES, SENSOR, Charge, Heating, RigPath, SensorName, Success, enough, heating_of, sensor_of
from .mold_study import MoldPath
from .robot_keys import RobotPath
from .study_file import Timed


@dataclass(frozen=True, eq=False)
class TubeParts:
    """Mold and schedules of one tube."""

    number: int
    """Of the tube, from 1."""
    made: TubeFabrication
    """The two as planned together."""
    mold: RobotMold
    """As the command for molds says it."""
    heating: Heating
    """As the command for heatings says it."""


@dataclass(frozen=True, eq=False)
class Fabrication(Displayed):
    """Everything that it takes to make a robot's tubes."""

    robot: Robot
    parts: tuple[TubeParts, ...]
    """One for each tube that is made."""
    left_out: tuple[str, ...]
    """Tubes that are not made, in words."""

    @property
    def success(self) -> Success | None:
        """That of the least likely tube; None where it is not known of one."""
        found = [part.heating.success for part in self.parts]
        known = [one for one in found if one is not None]
        return min(known, key=lambda one: one.probability) if len(known) == len(found) else None


class FabricationStudy(Timed):
    """Molds and heating schedules for every tube of a robot."""

    doing = "planning molds and schedules"

    kind: Literal["fabrication"]
    robot: RobotPath
    rig: RigPath = Field(examples=["RIG.yaml"])
    mold: MoldPath = None
    hold_s: Positive | None = Field(
        None, ge=1, le=1800, description="hold time, 1 to 1800 s; by default that of the mold file, or 60"
    )
    objective: Literal["time", "energy", "margin"] = Field(
        "time", description="objective: time (shortest), energy (least charge) or margin (to the window and the limit)"
    )
    charges_percent: list[Charge] = Field(
        [],
        description="additional states of charge for tables of the duty cycle, percent; as a flag, none for no tables",
    )
    samples: Annotated[Whole, Field(ge=0)] = Field(32, description=SAMPLES)
    sensor: SensorName | None = SENSOR

    @model_validator(mode="after")
    def _tried_enough(self) -> Self:
        enough(self.samples, self.sensor)
        return self

    def run(self, progress: Progress | None = None) -> Fabrication:
        """Each tube's mold drawn for the rig, and its heating planned on the rig with the mold as drawn.

        Raises:
            InputError: no tube of the robot is curved, or as `plan_tube`.
        """
        asked = self.mold or MoldSpec()
        spec = replace(heating_for(asked.heat), objective=self.objective)
        spec = spec if self.hold_s is None else replace(spec, hold_time=self.si("hold_s"))
        charges = self.si("charges_percent")
        chosen, left_out = chosen_tubes(self.robot)
        parts = []
        for k, number in enumerate(chosen):
            if progress is not None:
                progress(k, len(chosen))
            # Each tube has a mold of its own: its arc and its length of cold end decide the plate.
            made = plan_tube(self.robot.tubes[number - 1], self.rig, asked, spec, number=number)
            drawn = RobotMold(made.mold, self.robot.name, ())
            heating = heating_of(made.heating, charges, samples=self.samples, sensor=sensor_of(self.sensor))
            parts.append(TubeParts(number, made, drawn, heating))
        return Fabrication(self.robot, tuple(parts), tuple(left_out))
