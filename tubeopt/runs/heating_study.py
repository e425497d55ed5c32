"""Studies of heating: schedule, feedback control, calibration of the rig, and all tubes of a robot."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from ..display import Displayed
from ..errors import InputError, choice
from ..files.checked import NotNegative, Number, Positive, Whole, in_file
from ..files.field_metadata import key
from ..files.fields import build_from, keys_from
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..shaping.firmware.boards import (
    BOARDS,
    CONVERTERS,
    READS,
    Part,
    Wiring,
    converter_for,
    hall_slope,
    parts_list,
    pwm_frequency,
    with_pulses,
)
from ..shaping.heating.calibration import BIAS, FACTORS, HeatingLog, RigFit, calibrate
from ..shaping.heating.controller import ENOUGH, Feedback, wilson
from ..shaping.heating.cutout import stop_current
from ..shaping.heating.oven import Oven, OvenPlan, plan_oven
from ..shaping.heating.plan import HeatingPlan, slot_milliseconds
from ..shaping.heating.planning import plan_heating
from ..shaping.heating.rig import Rig
from ..shaping.heating.robust import Band, assess, charge_tables, design_feedback, most_likely
from ..shaping.heating.sensors import SENSORS, Sensor, equipped, sensor_for
from ..shaping.heating.spec import HeatingSpec
from ..shaping.heating.uncertainty import Uncertainty
from ..shaping.materials import mold_material
from ..shaping.mold.heat import heating_for
from ..shaping.mold.mold import RobotMold, chosen_tubes, equal_tubes
from ..shaping.mold.spec import MoldSpec
from ..shaping.tube_fabrication import TubeFabrication, plan_tube
from ..typing import Progress
from .mold_study import MoldPath
from .robot_keys import RobotPath, TubeNumber
from .study_file import Arguments, Options, Timed, question
from .workshop_file import CameraRecording, load_camera, load_heating_log, load_oven, load_rig

OPEN = "none"
"""Name in place of a sensor for a heating by its schedule alone."""

OPEN_LOOP = 0.5
"""Required success probability without a sensor."""


@dataclass(frozen=True)
class Success:
    """Probability that a heating stays within window and limit on rigs with uncertain parameters."""

    probability: float
    """Fraction of the random rigs that succeed."""
    samples: int
    """Number of random rigs."""
    sensor: str = ""
    """Sensor of the feedback control; "" in open loop."""
    open_loop: float | None = None
    """Success probability without the sensor."""
    silent: float = 0.0
    """Fraction of the random rigs that miss without a report of the board."""

    @classmethod
    def led(cls, feedback: Feedback) -> Self:
        """Success of a heating with a controller."""
        f = feedback
        return cls(f.probability, f.samples, f.sensor.name, f.open_loop, f.silent)

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval of the probability."""
        return wilson(round(self.probability * self.samples), self.samples)

    @property
    def required(self) -> float:
        """Smallest probability of success at which a rig counts as ready."""
        return ENOUGH if self.sensor else OPEN_LOOP

    @property
    def likely(self) -> bool:
        """True unless the probability is below the required one: with a sensor, beyond its 95 % interval."""
        return (self.interval[1] if self.sensor else self.probability) >= self.required


@dataclass(frozen=True, eq=False)
class Heating(Displayed):
    """Heating plan with its tables and its results on random rigs."""

    plan: HeatingPlan
    tables: Annotated[tuple[HeatingPlan, ...], "the same for other states of charge"] = ()
    band: Band | None = None
    """Temperatures on random rigs; None unless requested."""
    uncertainty: Uncertainty = field(default_factory=Uncertainty.of_a_workshop)
    """Distribution of the random rigs."""
    scale: Annotated[float, key("duty_scale"), "factor on the duties"] = 1.0
    """Scaled for the highest success probability with `robust`."""

    @property
    def success(self) -> Success | None:
        """Success probability with the plan's `feedback`, or in open loop; None if no rigs were sampled."""
        feedback = self.plan.feedback
        if feedback is not None:
            return Success.led(feedback)
        return None if self.band is None else Success(self.band.probability, len(self.band.lowest))


def evaluate_heating(
    plan: HeatingPlan,
    charges: tuple[float, ...] = (),
    progress: Progress | None = None,
    *,
    uncertainty: Uncertainty | None = None,
    samples: int = 0,
    scaled: bool = False,
    sensor: Sensor | None = None,
) -> Heating:
    """Evaluate a plan on random rigs, with tables for other states of charge.

    Args:
        samples: number of random rigs; with 0 there is no band.
        scaled: scale the duty cycle for the highest success probability.
        sensor: sensor of the feedback control that is designed for the plan.
    """
    check_sample_count(samples, sensor)
    uncertainty = uncertainty or Uncertainty.of_a_workshop()
    steps = 1 + len(charges) + (samples > 0)
    show = progress or (lambda done, total: None)
    show(1, steps)
    band, scale = None, 1.0
    if samples and scaled:
        # Scaled duties move the temperatures of random rigs within the window.
        best = most_likely(plan, uncertainty, samples=samples)
        plan, band, scale = best.plan, best.band, best.scale
    elif samples:
        band = assess(plan, uncertainty, samples=samples)
    tables: list[HeatingPlan] = []
    for k, charge in enumerate(charges):
        tables += charge_tables(plan, [charge])
        show(2 + k, steps)
    show(steps, steps)
    if sensor is not None:
        plan = replace(plan, feedback=design_feedback(plan, sensor, uncertainty, samples=samples))
    return Heating(plan, tuple(tables), band, uncertainty, scale)


MIN_FEEDBACK_SAMPLES = 20
"""Smallest number of random rigs to test a controller on."""


def check_sample_count(samples: int, sensor: object) -> None:
    """Raise InputError for too few random rigs to test the controller of a sensor on."""
    if sensor is not None and samples < MIN_FEEDBACK_SAMPLES:
        raise InputError(f"samples is {samples}; with a sensor it must be at least {MIN_FEEDBACK_SAMPLES}")


Charge = Annotated[Positive, Field(le=100)]
"""State of charge, percent."""

SensorName = Annotated[str, AfterValidator(lambda name: choice("sensor", name, SENSORS))]
"""Name of a sensor."""

SAMPLES = (
    f"number of random rigs to estimate the success probability; 0 to skip; at least {MIN_FEEDBACK_SAMPLES} with a "
    "sensor"
)
"""Description of the key `samples`."""

SENSOR = Field(
    None,
    description=f"sensor of the feedback control: {', '.join(SENSORS)}; default none (open loop)",
    examples=["SENSOR"],
)


def sensor_of(name: str | None, tube: Tube, rig: Rig) -> Sensor | None:
    """Sensor of that name for a tube on a rig; None for None."""
    return None if name is None else sensor_for(name, tube, rig)


RigPath = Annotated[
    Rig,
    in_file(load_rig, "a rig file", kind=Rig),
    Field(description="path of the rig file, relative to this file, or the name of a built-in rig"),
]
"""Rig, given as the path of its file or the name of a built-in rig."""


class TubeOnRig(Timed):
    """Rig with the tube that is heated on it."""

    rig: RigPath
    robot: RobotPath | None = Field(
        None, description="robot file with the tube to heat; default the tube of the rig file", examples=["ROBOT.yaml"]
    )
    tube: TubeNumber = 1

    @model_validator(mode="after")
    def _has_tube(self) -> Self:
        if self.robot is None and self.tube > 1:
            raise ValueError(f"tube is {self.tube}; without a robot it must be 1, the rig file's own")
        self.heated_tube()
        return self

    def heated_tube(self) -> Tube:
        """Heated tube, of the robot or of the rig file; raises ValueError without any."""
        if self.robot is None:
            if self.rig.tube is None:
                raise ValueError("robot is missing; the rig file has no tube")
            return self.rig.tube
        return self.robot.tubes[self.tube - 1]


class HeatedTube(TubeOnRig):
    """Rig with mold material and battery voltage for a plan."""

    material: str | None = Field(None, description="mold material, instead of that of the rig file")
    battery_V: Positive | None = Field(
        None, description="measured voltage of the battery at rest; by default that of the rig file"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self.configured_rig()
        slot_milliseconds(self.spec().slot)
        return self

    def configured_rig(self) -> Rig:
        """Rig with the given mold material and battery voltage."""
        rig = self.rig
        if self.material is not None:
            rig = replace(rig, mold=replace(rig.mold, material=mold_material(self.material)))
        if self.battery_V is not None:
            rig = rig.with_charge(rig.battery.charge_at(self.si("battery_V")))
        return rig

    def spec(self) -> HeatingSpec:
        """Requirements on the heating, SI."""
        return build_from(HeatingSpec, self)


@keys_from(HeatingSpec)
class HeatingStudy(HeatedTube):
    """Schedule that keeps the curved part of a tube within a temperature window."""

    doing = "planning the heating"

    kind: Literal["heating"]
    charges_percent: list[Charge] = Field(
        [],
        description="states of charge of further duty-cycle tables, percent; --charges-percent none for no tables",
    )
    loss_percent: NotNegative | None = Field(
        None,
        lt=100,
        description="half-width of the uncertainty of the heat loss of a calibrated rig; "
        "contacts (30 %) and resistivity (2 %) add to it. Default: an uncalibrated rig with typical uncertainties",
    )
    robust: bool = Field(False, description="scale the duty cycle for the highest success probability")
    samples: Annotated[Whole, Field(ge=0)] = Field(64, description=SAMPLES)
    sensor: SensorName | None = SENSOR

    @model_validator(mode="after")
    def _enough_samples(self) -> Self:
        check_sample_count(self.samples, self.sensor)
        return self

    def run(self, progress: Progress | None = None) -> Heating:
        """Plan the heating; if it misses the window, `feasible` of the plan is false."""
        charges = self.si("charges_percent")
        if progress is not None:
            progress(0, 1 + len(charges) + (self.samples > 0))
        # Without a calibration all parameters are uncertain.
        loss, tube, rig = self.in_si("loss_percent"), self.heated_tube(), self.configured_rig()
        sensor = sensor_of(self.sensor, tube, rig)
        return evaluate_heating(
            plan_heating(tube, equipped(rig, sensor), self.spec()),
            charges,
            progress,
            uncertainty=Uncertainty.of_a_workshop() if self.loss_percent is None else Uncertainty(**loss),
            samples=self.samples,
            scaled=self.robust,
            sensor=sensor,
        )


# --- oven -------------------------------------------------------------------------------------------------------------

OvenPath = Annotated[
    Oven,
    in_file(load_oven, "an oven file", kind=Oven),
    Field(description="path of the oven file, relative to this file, or the name of a built-in oven"),
]
"""Oven, given as the path of its file."""


@question("planning the oven")
def plan_soak(
    oven: OvenPath,
    options: Annotated[Options, Arguments(plan_oven, "window_degC", "hold_time")],
    robot: Annotated[
        RobotPath | None,
        Field(description="robot file with the tube; default the tube of the oven file", examples=["ROBOT.yaml"]),
    ] = None,
    tube: TubeNumber = 1,
) -> OvenPlan:
    """Soak time of a tube in its mold in an oven, furnace or salt bath."""
    if robot is None and tube > 1:
        raise InputError(f"tube is {tube}; without a robot it must be 1, the oven file's own")
    heated = oven.tube if robot is None else robot.tubes[tube - 1]
    if heated is None:
        raise InputError("robot is missing; the oven file has no tube")
    return plan_oven(heated, oven, **options)


# --- feedback control and firmware ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ClosedLoopHeating(Displayed):
    """Heating with feedback control, and the board that runs it."""

    plan: HeatingPlan
    """Planned duty cycle."""
    feedback: Feedback
    """Controller and its success probability."""
    wiring: Wiring
    """Board, pins and parts."""
    frequency: Annotated[float, key("pwm_Hz"), "PWM frequency"]
    shared: tuple[HeatingPlan, ...] = ()
    """Heatings of all tubes of the circuit; empty for a circuit of this tube alone."""

    @functools.cached_property
    def parts(self) -> tuple[Part, ...]:
        """Electrical parts of the circuit, with what this tube has for itself."""
        return parts_list(self.plan, self.wiring, self.shared)


@keys_from(HeatingSpec)
class ClosedLoopStudy(HeatedTube):
    """Feedback control of a heating: gains, success probability on random rigs, and firmware."""

    doing = "planning the heating and its controller"

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
    objective: Literal["time", "energy", "margin"] = Field(
        "margin",
        description="objective: margin (to the window and the limit), time (shortest) or energy (least charge)",
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
        hall_slope(self.wiring(), stop_current(self.heated_tube(), self.pulsed_rig()))
        return self

    def pulsed_rig(self) -> Rig:
        """Rig with the heated tube, with the pulses of the board and with the sensor on the tube."""
        rig = equipped(replace(self.configured_rig(), tube=self.heated_tube()), self._sensor())
        return with_pulses(rig, self.heated_tube(), self.wiring(), self.si("pwm_Hz"))

    def _sensor(self) -> Sensor:
        sensor = sensor_for(choice("sensor", self.sensor, READS), self.heated_tube(), self.configured_rig())
        # A thermometer of known bias was compared with another one, in its slot: no correction is left.
        return sensor if self.bias_K is None else replace(sensor, bias=self.si("bias_K"), correction=0.0)

    def wiring(self) -> Wiring:
        """Board and converter, with the current sensor of a built circuit."""
        built = self.rig.circuit.hall_sensitivity
        return Wiring(board=self.board, converter=converter_for(self.sensor, self.converter), shunt_V_per_A=built)

    def run(self, progress: Progress | None = None) -> ClosedLoopHeating:
        """Plan the heating for the board's PWM frequency, and design its controller."""
        show = progress or (lambda done, total: None)
        show(0, 2)
        # Before planning: switching losses depend on the frequency.
        rig, wiring = self.pulsed_rig(), self.wiring()
        plan = plan_heating(self.heated_tube(), rig, self.spec())
        show(1, 2)
        feedback = design_feedback(plan, self._sensor(), samples=self.samples)
        show(2, 2)
        return ClosedLoopHeating(replace(plan, feedback=feedback), feedback, wiring, rig.circuit.pwm_frequency)


# --- calibration of a rig ---------------------------------------------------------------------------------------------


class HeatingCalibrationStudy(TubeOnRig):
    """Heat loss and contacts of a rig, from a heating log."""

    doing = "calibrating the rig"

    kind: Literal["heating_calibration"]
    log: Annotated[Path, in_file(Path, "a CSV file")] = Field(
        description="path of a CSV file with the columns time_s, duty and any of temperature_degC, voltage_V, current_A"
    )
    fit: list[str] = Field(
        ["loss", "gap", "contact_resistance", "resistivity"],
        description=f"parameters to estimate, from {', '.join((*FACTORS, BIAS))}",
        examples=["NAME,.."],
    )
    camera: Annotated[CameraRecording, in_file(load_camera, "a CSV file")] | None = Field(
        None,
        description="CSV file of a thermal camera, recorded with the log: time_s, and "
        "temperatures in degC at points of the tube. The name of a column is "
        "its distance from the middle of the curved part, mm",
        examples=["FILE.csv"],
    )
    noise_K: Positive | None = Field(
        None,
        description="known standard deviation of thermometer noise; larger residuals are reported; default estimated",
    )
    noise_V: Positive | None = Field(None, description="known standard deviation of voltage noise; default estimated")
    noise_A: Positive | None = Field(None, description="known standard deviation of current noise; default estimated")
    position_mm: Number = Field(
        Decimal(0),
        description="distance of the thermometer from the middle of the curved part, to either side; "
        "on the tube beyond the mold, the edge of the mold is used",
    )
    lag_s: NotNegative = Field(Decimal(0), description="time constant of the thermometers")

    @functools.cached_property
    def _recording(self) -> HeatingLog:
        log = load_heating_log(self.log, **self.in_si("position_mm", "lag_s"))
        return log if self.camera is None else log.with_camera(*self.camera)

    @model_validator(mode="after")
    def _readable(self) -> Self:
        _ = self._recording
        return self

    def run(self, progress: Progress | None = None) -> RigFit:
        """Calibrate the rig; raises InputError for an unknown parameter."""
        # Without a known noise the fit estimates it.
        known = {"temperature": self.noise_K, "voltage": self.noise_V, "current": self.noise_A}
        noise = {name: float(value) for name, value in known.items() if value is not None}
        return calibrate(self.heated_tube(), self.rig, self._recording, self.fit, noise=noise)


# --- molds and heatings of all tubes of a robot -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TubeParts:
    """Mold and heating of one tube."""

    number: Annotated[int, key("tube"), "number of the tube, from 1"]
    fabrication: TubeFabrication
    """Mold and heating as planned together, with their remarks."""
    mold: Annotated[RobotMold, "its mold"]
    heating: Annotated[Heating, "its heating"]
    led: ClosedLoopHeating | None = None
    """Firmware of the heating; None without a sensor that a sketch reads."""

    @property
    def rig(self) -> Rig:
        """Rig as drawn with its tube, and with the current sensor of the circuit that all tubes share."""
        rig, sensor = self.heating.plan.rig, None if self.led is None else self.led.wiring.shunt_V_per_A
        circuit = rig.circuit if sensor is None else replace(rig.circuit, hall_sensitivity=sensor)
        return replace(rig, tube=self.heating.plan.tube, circuit=circuit)

    def with_firmware(self, wiring: Wiring, shared: tuple[HeatingPlan, ...]) -> TubeParts:
        """A copy with the firmware for a wiring that several heatings share, of a heating with a sensor."""
        plan = self.heating.plan
        assert plan.feedback is not None
        frequency = plan.rig.circuit.pwm_frequency
        return replace(self, led=ClosedLoopHeating(plan, plan.feedback, wiring, frequency, shared))


@dataclass(frozen=True, eq=False)
class Fabrication(Displayed):
    """Molds and heatings for all tubes of a robot."""

    robot: Robot
    parts: Annotated[tuple[TubeParts, ...], key("tubes"), "mold and heating of every tube"]
    left_out: Annotated[tuple[str, ...], "omitted tubes, with the reason"]

    @property
    def success(self) -> Success | None:
        """Lowest success probability of all tubes; None if it is unknown for one of them."""
        every = [part.heating.success for part in self.parts]
        known = [success for success in every if success is not None]
        # All tubes must succeed: the robot is at most as likely as its least likely tube.
        return min(known, key=lambda success: success.probability) if len(known) == len(every) else None


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
        "margin",
        description="objective: margin (to the window and the limit), time (shortest) or energy (least charge)",
    )
    charges_percent: list[Charge] = Field(
        [],
        description="states of charge of further duty-cycle tables, percent; --charges-percent none for no tables",
    )
    samples: Annotated[Whole, Field(ge=0)] = Field(100, description=SAMPLES)
    sensor: Annotated[str, AfterValidator(lambda name: choice("sensor", name, (*SENSORS, OPEN)))] = Field(
        "thermocouple", description=f"sensor of the feedback control: {', '.join(SENSORS)}; {OPEN} for open loop"
    )
    board: str = Field("uno", description=f"board to run the sketch: {', '.join(BOARDS)}")

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        check_sample_count(self.samples, None if self.sensor == OPEN else self.sensor)
        self._wiring()
        return self

    def _wiring(self) -> Wiring:
        converter = converter_for(self.sensor) if self.sensor in READS else Wiring.converter
        return Wiring(board=self.board, converter=converter, shunt_V_per_A=self.rig.circuit.hall_sensitivity)

    def run(self, progress: Progress | None = None) -> Fabrication:
        """Plan every tube: its mold for the rig, and its heating on the rig with this mold.

        Raises:
            InputError: no tube of the robot is curved, or as `plan_tube`.
        """
        mold_spec = self.mold or MoldSpec()
        spec = replace(heating_for(mold_spec.heat), objective=self.objective)
        # The key of the study has priority over the mold file.
        spec = spec if self.hold_s is None else replace(spec, hold_time=self.si("hold_s"))
        charges, wiring = self.si("charges_percent"), self._wiring()
        kind = None if self.sensor == OPEN else self.sensor
        chosen, left_out = chosen_tubes(self.robot)
        # One circuit heats all tubes: its pulses are those of the tube that a shorted switch heats fastest.
        frequency = max(pwm_frequency(wiring, replace(self.rig, tube=self.robot.tubes[n - 1])) for n in chosen)
        pulsed, parts = replace(self.rig, circuit=replace(self.rig.circuit, pwm_frequency=frequency)), []
        for k, number in enumerate(chosen):
            if progress is not None:
                progress(k, len(chosen))
            # Each tube has a mold of its own: its arc and its length of cold end decide the plate.
            tube = self.robot.tubes[number - 1]
            sensor = sensor_of(kind, tube, pulsed)
            fabrication = plan_tube(tube, equipped(pulsed, sensor), mold_spec, spec, number=number)
            mold = RobotMold(fabrication.marked_mold, self.robot.name, (), (equal_tubes(self.robot, number),))
            heating = evaluate_heating(fabrication.heating, charges, samples=self.samples, sensor=sensor)
            parts.append(TubeParts(number, fabrication, mold, heating))
        if self.sensor in READS:
            plans = tuple(part.heating.plan for part in parts)
            slope = min(hall_slope(wiring, stop_current(plan.tube, plan.rig)) for plan in plans)
            wiring = replace(wiring, shunt_V_per_A=slope)
            parts = [part.with_firmware(wiring, plans) for part in parts]
        return Fabrication(self.robot, tuple(parts), tuple(left_out))
