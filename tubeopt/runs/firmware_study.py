"""The study of a heating that a sensor leads: the law, and the sketch of the board that runs it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..display import Displayed
from ..errors import choice
from ..files.checked import NotNegative, Positive, Whole
from ..files.fields import asking
from ..shaping.firmware.boards import BOARDS, CONVERTERS, READS, Wiring, converter_for, hall_slope, pwm_frequency
from ..shaping.heating.controller import Feedback
from ..shaping.heating.feedback_design import design_feedback
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.sensors import SENSORS, Sensor
from ..shaping.heating.spec import HeatingSpec
from ..typing import Progress
from .heating_study import HeatedTube


@dataclass(frozen=True, eq=False)
class LedHeating(Displayed):
    """A heating that a sensor leads, and the board that runs it."""

    plan: HeatingPlan
    """The schedule."""
    feedback: Feedback
    """The law that leads it, and what it keeps."""
    wiring: Wiring
    """Board, pins and parts."""
    frequency: float
    """Hz, of the board's pulses."""


@asking(HeatingSpec)
class LedHeatingStudy(HeatedTube):
    """Feedback control of a heating: gains, success probability on uncertain rigs, and firmware."""

    doing = "planning the heating and its law"

    kind: Literal["led_heating"]
    sensor: str = Field("thermocouple", description=f"temperature sensor: {', '.join(READS)}")
    bias_K: NotNegative | None = Field(
        None, description="half-width of the constant error of the sensor; by default a typical value of its kind"
    )
    board: str = Field("uno", description=f"board to run the sketch: {', '.join(BOARDS)}")
    converter: str | None = Field(
        None,
        description=f"converter of the sensor signal: {', '.join(CONVERTERS)}; by default the usual one of the sensor",
    )
    pwm_Hz: Positive | None = Field(
        None,
        description="PWM frequency; the nearest one of the board is used. Default: "
        "the lowest, with the smallest switching loss",
    )
    samples: Annotated[Whole, Field(ge=20)] = Field(
        200, description="number of random rigs to test the controller on, at least 20"
    )

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        self._sensor()
        rig = self.set_up()
        pwm_frequency(self._wiring(), rig, self.si("pwm_Hz"))
        hall_slope(self._wiring(), rig.circuit)
        return self

    def _sensor(self) -> Sensor:
        kind = SENSORS[choice("sensor", self.sensor, READS)]
        return kind() if self.bias_K is None else kind(bias=self.si("bias_K"))

    def _wiring(self) -> Wiring:
        return Wiring(board=self.board, converter=converter_for(self.sensor, self.converter))

    def run(self, progress: Progress | None = None) -> LedHeating:
        """The plan for the board's pulses, the law, and what becomes of it on uncertain rigs."""
        tell = progress or (lambda done, total: None)
        tell(0, 2)
        rig, wiring = self.set_up(), self._wiring()
        frequency = pwm_frequency(wiring, rig, self.si("pwm_Hz"))
        rig = replace(rig, circuit=replace(rig.circuit, pwm_frequency=frequency))
        plan = plan_heating(self.heated(), rig, self.spec())
        tell(1, 2)
        feedback = design_feedback(plan, self._sensor(), samples=self.samples)
        tell(2, 2)
        return LedHeating(plan, feedback, wiring, frequency)
