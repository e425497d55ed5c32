"""The study of a heating: the schedule that sets the shape of a tube on a rig."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from ..display import Displayed
from ..errors import InputError, choice
from ..files.checked import NotNegative, Positive, Whole, in_file
from ..files.fields import asking, made
from ..robots.tubes import Tube
from ..shaping.heating.controller import wilson
from ..shaping.heating.feedback_design import design_feedback
from ..shaping.heating.files import slot_milliseconds
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.rig import Rig
from ..shaping.heating.robust import Band, assess, charge_tables, most_likely
from ..shaping.heating.sensors import SENSORS, Sensor
from ..shaping.heating.spec import HeatingSpec
from ..shaping.heating.uncertainty import Uncertainty
from ..shaping.materials import mold_material
from ..typing import Progress
from .rig_file import load_rig
from .robot_keys import RobotPath, TubeNumber
from .study_file import Timed


@dataclass(frozen=True)
class Success:
    """How likely a heating keeps window and limit on rigs that are not quite as filed."""

    probability: float
    """Share of uncertain rigs that do."""
    samples: int
    """Uncertain rigs."""
    led_by: str = ""
    """The sensor that closes the loop; "" where the schedule runs alone."""
    open_loop: float | None = None
    """The same without that sensor."""

    @property
    def interval(self) -> tuple[float, float]:
        """Of the probability, 95 % (Wilson's)."""
        return wilson(round(self.probability * self.samples), self.samples)

    @property
    def likely(self) -> bool:
        """Whether it is at least one half."""
        return self.probability >= 0.5


@dataclass(frozen=True, eq=False)
class Heating(Displayed):
    """A plan, and what becomes of it."""

    plan: HeatingPlan
    tables: tuple[HeatingPlan, ...] = ()
    """The same for other charges of the battery."""
    band: Band | None = None
    """Over uncertain rigs; None where that was not asked for."""
    uncertainty: Uncertainty = field(default_factory=Uncertainty.of_a_workshop)
    """What the band is over."""
    scale: float = 1.0
    """By which the duties were scaled to the most likely success."""

    @property
    def success(self) -> Success | None:
        """How likely it is: led by the sensor of the plan's `feedback`, or alone; None where no rigs were sampled."""
        led = self.plan.feedback
        if led is not None:
            return Success(led.probability, led.samples, led.sensor.name, led.open_loop)
        return None if self.band is None else Success(self.band.probability, len(self.band.lowest))


def heating_of(
    planned: HeatingPlan,
    charges: tuple[float, ...] = (),
    progress: Progress | None = None,
    *,
    uncertainty: Uncertainty | None = None,
    samples: int = 0,
    scaled: bool = False,
    sensor: Sensor | None = None,
) -> Heating:
    """A plan with tables for other states of charge, and with what becomes of it on uncertain rigs: `samples` of them,
    for none of which there is no band; with `scaled` its duties are scaled to the most likely success, with a `sensor`
    its `feedback` is the law that leads it."""
    enough(samples, sensor)
    uncertainty = uncertainty or Uncertainty.of_a_workshop()
    steps = 1 + len(charges) + (samples > 0)
    tell = progress or (lambda done, total: None)
    tell(1, steps)
    band, scale = None, 1.0
    if samples and scaled:
        better = most_likely(planned, uncertainty, samples=samples)
        planned, band, scale = better.plan, better.band, better.scale
    elif samples:
        band = assess(planned, uncertainty, samples=samples)
    tables: list[HeatingPlan] = []
    for k, charge in enumerate(charges):
        tables += charge_tables(planned, [charge])
        tell(2 + k, steps)
    tell(steps, steps)
    if sensor is not None:
        planned = replace(planned, feedback=design_feedback(planned, sensor, uncertainty, samples=samples))
    return Heating(planned, tuple(tables), band, uncertainty, scale)


LEAST_LED = 20
"""Uncertain rigs on which a law is tried at least."""


def enough(samples: int, sensor: object) -> None:
    """Refuse to try the law of a sensor on too few rigs."""
    if sensor is not None and samples < LEAST_LED:
        raise InputError(f"samples is {samples}; with a sensor it must be at least {LEAST_LED}")


Charge = Annotated[Positive, Field(le=100)]
"""A state of charge, percent."""

SensorName = Annotated[str, AfterValidator(lambda name: choice("sensor", name, SENSORS))]
"""What is felt of the tube, by its name."""

SAMPLES = f"number of random rigs to estimate the success probability; 0 to skip; at least {LEAST_LED} with a sensor"
"""What the key `samples` says."""

SENSOR = Field(
    None,
    description=f"sensor of the feedback control: {', '.join(SENSORS)}; default none (open loop)",
    examples=["SENSOR"],
)


def sensor_of(name: str | None) -> Sensor | None:
    """The sensor of that name, with the error that is usual for its kind."""
    return None if name is None else SENSORS[name]()


RigPath = Annotated[
    Rig,
    in_file(load_rig, "a rig file", kind=Rig),
    Field(description="path of the rig file, relative to this file"),
]
"""A rig, given as the path of its file."""


class TubeOnRig(Timed):
    """What studies of heatings share: a rig, and the tube on it."""

    rig: RigPath
    robot: RobotPath | None = Field(
        None, description="robot file with the tube to heat; default the tube of the rig file", examples=["ROBOT.yaml"]
    )
    tube: TubeNumber = 1

    @model_validator(mode="after")
    def _has_a_tube(self) -> Self:
        if self.robot is None and self.tube > 1:
            raise ValueError(f"tube is {self.tube}; without a robot it must be 1, the rig file's own")
        self.heated()
        return self

    def heated(self) -> Tube:
        """The tube that is heated; raises ValueError where neither rig nor robot has it."""
        if self.robot is None:
            if self.rig.tube is None:
                raise ValueError("robot is missing; the rig file has no tube")
            return self.rig.tube
        return self.robot.tubes[self.tube - 1]


class HeatedTube(TubeOnRig):
    """What studies of plans share: a rig as it is set up; what is asked of the heating comes with `asking`."""

    material: str | None = Field(None, description="mold material, instead of that of the rig file")
    battery_V: Positive | None = Field(
        None, description="measured voltage of the battery at rest; by default that of the rig file"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self.set_up()
        slot_milliseconds(self.spec().slot)
        return self

    def set_up(self) -> Rig:
        """The rig with the material and the voltage that are given."""
        rig = self.rig
        if self.material is not None:
            rig = replace(rig, mold=replace(rig.mold, material=mold_material(self.material)))
        if self.battery_V is not None:
            rig = rig.with_charge(rig.battery.charge_at(self.si("battery_V")))
        return rig

    def spec(self) -> HeatingSpec:
        """What is asked of the heating."""
        return made(HeatingSpec, self)


@asking(HeatingSpec)
class HeatingStudy(HeatedTube):
    """Schedule that keeps the curved part of a tube within a temperature window."""

    doing = "planning the heating"

    kind: Literal["heating"]
    charges_percent: list[Charge] = Field(
        [],
        description="additional states of charge for tables of the duty cycle, percent; as a flag, none for no tables",
    )
    loss_percent: NotNegative | None = Field(
        None,
        lt=100,
        description="half-width of the uncertainty of the heat loss of a calibrated rig; "
        "contacts (30 %) and resistivity (2 %) add to it. By default the rig is uncalibrated",
    )
    robust: bool = Field(False, description="scale the duty cycle for the highest success probability")
    samples: Annotated[Whole, Field(ge=0)] = Field(64, description=SAMPLES)
    sensor: SensorName | None = SENSOR

    @model_validator(mode="after")
    def _tried_enough(self) -> Self:
        enough(self.samples, self.sensor)
        return self

    def uncertainty(self) -> Uncertainty:
        """What is not known of the rig: all that a workshop does not know, or what a calibration leaves."""
        if self.loss_percent is None:
            return Uncertainty.of_a_workshop()
        return Uncertainty(**self.in_si("loss_percent"))

    def run(self, progress: Progress | None = None) -> Heating:
        """The plan; where it cannot hold the window, its `feasible` is false and it says by how much."""
        charges = self.si("charges_percent")
        if progress is not None:
            progress(0, 1 + len(charges) + (self.samples > 0))
        planned = plan_heating(self.heated(), self.set_up(), self.spec())
        return heating_of(
            planned,
            charges,
            progress,
            uncertainty=self.uncertainty(),
            samples=self.samples,
            scaled=self.robust,
            sensor=sensor_of(self.sensor),
        )
