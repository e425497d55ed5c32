"""The study of a heating: the schedule that sets the shape of a tube on a rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from ..errors import choice
from ..files.checked import NotNegative, Positive, in_file
from ..files.fields import asking, values
from ..files.units import PERCENT, to_si
from ..robots.tubes import Tube
from ..shaping.feedback.feedback import Feedback, lead_by
from ..shaping.feedback.sensors import SENSORS, Sensor
from ..shaping.firmware.boards import BOARDS, CONVERTERS, Wiring, pwm_frequency
from ..shaping.heating.files import slot_milliseconds
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.rig import Rig
from ..shaping.heating.robust import Band, assess, charge_tables, most_likely
from ..shaping.heating.uncertainty import Uncertainty
from ..shaping.heating.spec import HeatingSpec
from ..shaping.mold.materials import mold_material
from .base import Progress, RobotPath, Study, Whole
from .rig_file import load_rig


@dataclass(frozen=True)
class Ensemble:
    """Uncertain rigs on which a plan is tried.

    uncertainty: of the rig.   samples: how many.   scaled: whether the duties are scaled to the most likely success.
    """

    uncertainty: Uncertainty
    samples: int
    scaled: bool = False


@dataclass(frozen=True, eq=False)
class Heating:
    """A plan, its tables by the battery's charge, and its band over uncertain rigs, None where that was not asked for.

    scale: by which its duties were scaled to the most likely success.
    """

    plan: HeatingPlan
    tables: tuple[HeatingPlan, ...] = ()
    band: Band | None = None
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    scale: float = 1.0


def heating_of(
    planned: HeatingPlan,
    charges: tuple[float, ...] = (),
    ensemble: Ensemble | None = None,
    progress: Progress | None = None,
) -> Heating:
    """A plan with tables for other states of charge, and with what becomes of it on uncertain rigs."""
    steps = 1 + len(charges) + (ensemble is not None)
    tell = progress or (lambda done, total: None)
    tell(1, steps)
    band, scale = None, 1.0
    if ensemble is not None and ensemble.scaled:
        better = most_likely(planned, ensemble.uncertainty, samples=ensemble.samples)
        planned, band, scale = better.plan, better.band, better.scale
    elif ensemble is not None:
        band = assess(planned, ensemble.uncertainty, samples=ensemble.samples)
    tables: list[HeatingPlan] = []
    for k, charge in enumerate(charges):
        tables += charge_tables(planned, [charge])
        tell(2 + k, steps)
    tell(steps, steps)
    return Heating(planned, tuple(tables), band, Uncertainty() if ensemble is None else ensemble.uncertainty, scale)


RigPath = Annotated[
    Rig,
    in_file(load_rig, "a rig file", kind=Rig),
    Field(description="path of the rig file, relative to this file"),
]
"""A rig, given as the path of its file."""


def _of_the_robot(tube: int, info: ValidationInfo) -> int:
    robot = info.data.get("robot")
    if robot is not None and tube > robot.n_tubes:
        raise ValueError(f"is {tube}; it must be 1 to {robot.n_tubes}")
    return tube


class HeatedTube(Study):
    """A tube on a rig, and what its heating is asked for: the keys of a `HeatingSpec` come with `asking`."""

    rig: RigPath
    robot: RobotPath | None = Field(
        None, description="robot whose tube is heated; by default the rig's own tube", examples=["ROBOT.yaml"]
    )
    tube: Annotated[Whole, Field(ge=1), AfterValidator(_of_the_robot)] = Field(
        1, description="which tube of the robot, from 1"
    )
    material: str | None = Field(None, description="mold material in place of the rig's")
    battery_V: Positive | None = Field(None, description="of the battery at rest, as read; by default the rig file's")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._tube()
        self._rig()
        slot_milliseconds(self._spec().slot)
        return self

    def _tube(self) -> Tube:
        if self.robot is None:
            if self.rig.tube is None:
                raise ValueError("robot is missing; the rig file names no tube")
            return self.rig.tube
        chosen: Any = self.robot.tubes[self.tube - 1]
        return chosen  # type: ignore[no-any-return]

    def _rig(self) -> Rig:
        """The rig with the material and the voltage that are given."""
        rig = self.rig
        if self.material is not None:
            rig = replace(rig, mold=replace(rig.mold, material=mold_material(self.material)))
        if self.battery_V is not None:
            rig = rig.with_charge(rig.battery.charge_at(float(self.battery_V)))
        return rig

    def _spec(self) -> HeatingSpec:
        return HeatingSpec(**values(HeatingSpec, self))

    def planned(self) -> HeatingPlan:
        """The plan; where it cannot hold the window, its `feasible` is false and it says by how much."""
        return plan_heating(self._tube(), self._rig(), self._spec())


@asking(HeatingSpec)
class HeatingStudy(HeatedTube):
    """The schedule that holds the curved part of a tube within a window of temperature."""

    kind: Literal["heating"]
    charges_percent: list[Positive] = Field(
        [], description="also tables for these states of charge; none for no tables"
    )
    loss_percent: NotNegative = Field(
        Decimal(15), lt=100, description="half-width of what is not known of the heat loss; 0 for no band"
    )
    robust: bool = Field(False, description="scale the duties to the most likely success")
    samples: Annotated[Whole, Field(ge=0)] = Field(0, description="uncertain rigs in the ensemble; 0 for no band")

    def run(self, progress: Progress | None = None) -> Heating:
        """The plan, its tables and its band."""
        charges = tuple(to_si(charge, PERCENT) for charge in self.charges_percent)
        ensemble = None
        if self.samples and self.loss_percent:
            uncertainty = Uncertainty(loss=to_si(self.loss_percent, PERCENT))
            ensemble = Ensemble(uncertainty, self.samples, scaled=self.robust)
        if progress is not None:
            progress(0, 1 + len(charges) + (ensemble is not None))
        return heating_of(self.planned(), charges, ensemble, progress)


@dataclass(frozen=True, eq=False)
class LedHeating:
    """A heating that a sensor leads, and the board that runs it.   frequency: Hz, of the board's pulses."""

    plan: HeatingPlan
    feedback: Feedback
    wiring: Wiring
    frequency: float


@asking(HeatingSpec)
class LedHeatingStudy(HeatedTube):
    """A heating that a sensor leads: the law, how likely uncertain rigs keep the window, and the sketch of a board."""

    kind: Literal["led_heating"]
    sensor: str = Field("thermocouple", description=f"what is felt of the tube: {', '.join(SENSORS)}")
    bias_K: NotNegative | None = Field(
        None, description="half-width of the sensor's error that stays; by default what is usual for its kind"
    )
    board: str = Field("uno", description=f"what runs the sketch: {', '.join(BOARDS)}")
    converter: str = Field("max31855", description=f"what reads the thermometer: {', '.join(CONVERTERS)}")
    pwm_Hz: Positive | None = Field(
        None, description="of the pulses, the nearest that the board has; by default its lowest, which loses least"
    )
    samples: Annotated[Whole, Field(ge=20)] = Field(200, description="uncertain rigs on which the law is tried")

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        self._sensor()
        pwm_frequency(self._wiring(), self._rig(), self._wanted())
        return self

    def _sensor(self) -> Sensor:
        kind = SENSORS[choice("sensor", self.sensor, tuple(SENSORS))]
        return kind() if self.bias_K is None else kind(bias=float(self.bias_K))

    def _wiring(self) -> Wiring:
        return Wiring(board=self.board, converter=self.converter)

    def _wanted(self) -> float | None:
        return None if self.pwm_Hz is None else float(self.pwm_Hz)

    def run(self, progress: Progress | None = None) -> LedHeating:
        """The plan for the board's pulses, the law, and what becomes of it on uncertain rigs."""
        tell = progress or (lambda done, total: None)
        tell(0, 2)
        rig, wiring = self._rig(), self._wiring()
        frequency = pwm_frequency(wiring, rig, self._wanted())
        rig = replace(rig, circuit=replace(rig.circuit, pwm_frequency=frequency))
        plan = plan_heating(self._tube(), rig, self._spec())
        tell(1, 2)
        feedback = lead_by(plan, self._sensor(), samples=self.samples)
        tell(2, 2)
        return LedHeating(plan, feedback, wiring, frequency)
