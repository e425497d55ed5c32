"""Temperature sensors of a heated tube: thermocouple, resistance of the tube, thermal camera.

A reading lags behind the tube, has a constant bias and noise, and is quantised. The `target` of a sensor is its reading
without these, a function of the state of the thermal model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ...constants import ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError, numbers
from ...files.field_metadata import NOT_NEGATIVE, POSITIVE, Typical, check_fields, key, unit
from ...robots.tubes import Tube
from ...typing import Array
from .rig import HOT, Rig
from .simulation import State, advance, at_rest, circuit_state
from .thermal import ThermalModel, thermal_data
from .thermocouple import ANCHOR, WIRE, reading_error, stem_loss


def lagged_reading(lag: ArrayLike, reading: Array, target: Array, target_after: Array, span: float) -> Array:
    """Readings after `span` s of sensors with a time constant `lag`, s: solution of lag y' + y = target.

    The target changes linearly from `target` to `target_after`.
    """
    lag = np.asarray(lag, dtype=float)
    slope, decay = (target_after - target) / span, np.exp(-span / np.maximum(lag, 1e-9))
    return np.asarray(target_after - lag * slope + (reading - target + lag * slope) * decay)


@dataclass(frozen=True)
class Sensor(Displayed):
    """Properties that all sensors have.

    Raises:
        InputError: a value is out of its range, or the range of valid readings is empty.
    """

    name: ClassVar[str] = "sensor"
    """Name in files and messages."""

    lag: Annotated[float, unit("s"), NOT_NEGATIVE, Typical(1e-3, 30.0), "time constant of the sensor"] = 0.0
    noise: Annotated[float, unit("K"), NOT_NEGATIVE, "standard deviation of one reading"] = 0.0
    bias: Annotated[float, unit("K"), NOT_NEGATIVE, "half-width of the constant error at the temperature window"] = 0.0
    correction: Annotated[
        float, unit("K"), "correction of the readings at the temperature window, in proportion to the rise"
    ] = 0.0
    quantum: Annotated[float, unit("K"), NOT_NEGATIVE, "resolution of the readings; 0 for none"] = 0.0
    lowest: Annotated[float, key("lowest_degC"), "smallest valid reading; below it the sensor counts as broken"] = -50.0
    highest: Annotated[float, key("highest_degC"), "largest valid reading; above it the sensor counts as broken"] = (
        1000.0
    )

    def __post_init__(self) -> None:
        check_fields(self, f"the {self.name}")
        if not self.lowest < self.highest:
            raise InputError(
                f"lowest of the {self.name} is {self.lowest:g} degC; it must be below its highest, {self.highest:g}"
            )

    def target(self, model: ThermalModel, state: State) -> Array:
        """(B,) readings without lag and errors, degC."""
        raise NotImplementedError

    def shown(self, lagged: Array, bias: Array | float, ends: tuple[float, float], rng: np.random.Generator) -> Array:
        """(B,) readings with bias, noise and quantisation, degC.

        The bias remains after the correction. It grows from 0 at the first temperature of `ends` to its full value at
        the second, as errors of thermometers do.
        """
        fraction = np.clip((lagged - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
        value = lagged + bias * fraction + self.noise * rng.standard_normal(len(lagged))
        return np.asarray(np.round(value / self.quantum) * self.quantum) if self.quantum else value


@dataclass(frozen=True, eq=False)
class MeasuredRig:
    """State of B rigs and of the sensors on them."""

    state: State
    target: Array
    """(B,) readings without lag and errors, degC."""
    lagged: Array
    """(B,) readings with lag, without errors, degC."""

    @classmethod
    def at_rest(cls, model: ThermalModel, sensor: Sensor) -> MeasuredRig:
        """Rigs and sensors at ambient temperature."""
        state = at_rest(model)
        target = sensor.target(model, state)
        return cls(state, target, target)

    def after(self, model: ThermalModel, sensor: Sensor, duty: Array | float, span: float) -> MeasuredRig:
        """Rigs and sensors after `span` seconds at a duty, one number or (B,)."""
        state = advance(model, self.state, duty, span)
        target = sensor.target(model, state)
        return MeasuredRig(state, target, lagged_reading(sensor.lag, self.lagged, self.target, target, span))


def tube_temperature(model: ThermalModel, state: State, positions: ArrayLike) -> Array:
    """(B, S) temperatures of the tube, degC, at distances (S,) from the middle of the curved part, m."""
    tube, x = state.cells[:, :, 0], model.half_length - np.abs(positions)
    grid = np.append(model.position, model.half_length)
    # The temperature is symmetric about the middle: flat from the last cell.
    index = np.clip(np.searchsorted(grid, x), 1, len(grid) - 1)
    fraction = (x - grid[index - 1]) / (grid[index] - grid[index - 1])
    T = np.concatenate([tube, tube[:, -1:]], axis=1)
    return np.asarray((1 - fraction) * T[:, index - 1] + fraction * T[:, index]) - ZERO_CELSIUS


@dataclass(frozen=True)
class Thermocouple(Sensor):
    """Thermocouple on the tube: by default of type K, 0.25 mm thick, read by a MAX31855.

    The resolution is that of the converter. Lag and noise are assumed: a bead behind a thin insulating coat. Correction
    and bias are the middle and the half-width of the error in the slot of a mold (`thermocouple.reading_error`), which
    is not symmetric: the reading is too low by up to 16.8 K at 525 degC, or too high by 1.5 K. Compare it with another
    thermocouple for less.
    """

    name: ClassVar[str] = "thermocouple"

    lag: Annotated[float, unit("s"), NOT_NEGATIVE, Typical(1e-3, 30.0), "time constant of the sensor"] = 0.3
    noise: Annotated[float, unit("K"), NOT_NEGATIVE, "standard deviation of one reading"] = 0.5
    bias: Annotated[float, unit("K"), NOT_NEGATIVE, "half-width of the constant error at the temperature window"] = 9.2
    correction: Annotated[
        float, unit("K"), "correction of the readings at the temperature window, in proportion to the rise"
    ] = 7.6
    quantum: Annotated[float, unit("K"), NOT_NEGATIVE, "resolution of the readings; 0 for none"] = 0.25
    wire: Annotated[float, unit("mm"), POSITIVE, Typical(2e-5, 1e-3), "diameter of the wires"] = WIRE
    anchor: Annotated[float, unit("mm"), POSITIVE, Typical(1e-3, 0.1), "length of each wire in the slot"] = ANCHOR
    position: Annotated[
        float, unit("mm"), Typical(1e-4, 0.5), "position on the tube, from the middle of the curved part"
    ] = 0.0

    def target(self, model: ThermalModel, state: State) -> Array:
        """(B,) temperatures at the thermocouple, degC."""
        if abs(self.position) >= model.half_length - model.position[0]:
            raise InputError(
                f"position of the thermocouple is {self.position * 1e3:g} mm from the middle of the tube; it must lie "
                "on the tube"
            )
        return np.asarray(tube_temperature(model, state, (self.position,)).mean(1))


@dataclass(frozen=True)
class Camera(Sensor):
    """Thermal camera, or a line camera, that sees the tube through vents of the lid.

    The bias is that of an emissivity of 0.5 known to 0.02, at 525 degC and 10 um. With dT / T = d(eps) / eps * lambda T
    / c2 that is 18 K. Half of it remains after a comparison of a painted spot with a thermocouple.
    """

    name: ClassVar[str] = "camera"

    lag: Annotated[float, unit("s"), NOT_NEGATIVE, Typical(1e-3, 30.0), "time constant of the sensor"] = 0.1
    noise: Annotated[float, unit("K"), NOT_NEGATIVE, "standard deviation of one reading"] = 1.0
    bias: Annotated[float, unit("K"), NOT_NEGATIVE, "half-width of the constant error at the temperature window"] = 9.0
    quantum: Annotated[float, unit("K"), NOT_NEGATIVE, "resolution of the readings; 0 for none"] = 0.1
    positions: Annotated[
        tuple[float, ...],
        unit("mm"),
        Typical(1e-4, 0.5),
        "measured positions, from the middle of the curved part; the reading is their mean",
    ] = (-20e-3, 0.0, 20e-3)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "positions", numbers("positions of the camera", self.positions))

    def target(self, model: ThermalModel, state: State) -> Array:
        """(B,) mean temperatures of the measured positions, degC."""
        if not self.positions or max(abs(x) for x in self.positions) >= model.half_length:
            raise InputError("positions of the camera must be at least one point on the tube")
        return np.asarray(tube_temperature(model, state, self.positions).mean(1))


@dataclass(frozen=True)
class TubeResistance(Sensor):
    """Tube as its own thermometer: resistance while the switch conducts, relative to that of the cold tube.

    The reading is the mean temperature between the clamps that explains the ratio with the nominal slope of the
    resistivity. The contacts are measured with the tube, so their resistance and an error of the slope affect the
    reading. Both belong to the uncertain rig, not to the bias of the sensor.
    """

    name: ClassVar[str] = "resistance"

    noise: Annotated[float, unit("K"), NOT_NEGATIVE, "standard deviation of one reading"] = 3.0
    slope: Annotated[
        float, unit("per_K"), POSITIVE, "assumed temperature coefficient of the resistivity at 25 degC"
    ] = 5e-4

    def target(self, model: ThermalModel, state: State) -> Array:
        """(B,) temperatures from the ratio of resistances, degC."""
        T_amb, R_contact = model.parameter("T_amb"), model.parameter("R_contact")

        def resistance(T: Array) -> Array:
            return 2 * circuit_state(model, T, state.lumped).R_half + R_contact

        cold = np.broadcast_to(T_amb[:, None], state.cells[:, :, 0].shape)
        ratio = resistance(state.cells[:, :, 0]) / resistance(np.ascontiguousarray(cold))
        start = T_amb - ZERO_CELSIUS
        # Relative to the resistance at the temperature at which the rig was switched on.
        return np.asarray(start + (ratio - 1) * (1 / self.slope + start - 25.0))


WIRES = (WIRE, 0.13e-3)
"""Common diameters of thermocouple wires, m, the stronger one first."""

MOST_DIP = 12.0
"""Largest fall of the tube's temperature by the wires, K: a quarter of a window of 50 K."""

WINDOW = 525.0
"""Temperature for which a thermocouple's error is computed, degC."""


def wire_dip(tube: Tube, rig: Rig, wire: float) -> float:
    """Estimated fall (K) of the temperature of a hot tube at a thermocouple with wires of a diameter, m.

    The legs draw heat evenly over their length. The mold lets as much heat pass as a cylinder into which it has
    diffused for `SETTLED` s, and the wall conducts it along the tube.
    """
    mold, data = rig.mold.material, thermal_data(tube)
    radius = 0.5 * tube.outer_diameter
    diffusivity = mold.conductivity / (mold.density * mold.heat_capacity)
    loss = 2 * math.pi * mold.conductivity / math.log1p(2 * math.sqrt(diffusivity * SETTLED) / radius)
    section = math.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2)
    reach = math.sqrt(data.conductivity * section / loss)
    drawn = HOT * stem_loss(wire, ANCHOR).conductance / (2 * ANCHOR)
    return drawn / loss * -math.expm1(-ANCHOR / reach)


SETTLED = 60.0
"""Duration of a usual hold, s."""


def thermocouple_for(tube: Tube, rig: Rig) -> Thermocouple:
    """Thermocouple for a tube, with correction and bias of its wires: those of the rig's mold, if it has any.

    Otherwise the thickest of `WIRES` that cools the tube by at most `MOST_DIP`, or the thinnest one.
    """
    wire = rig.mold.wire or next((w for w in WIRES if wire_dip(tube, rig, w) <= MOST_DIP), WIRES[-1])
    anchor = rig.mold.anchor
    low, high = reading_error(wire, anchor, WINDOW, 25.0)
    return Thermocouple(wire=wire, anchor=anchor, correction=round(-0.5 * (low + high), 1),
                        bias=round(0.5 * (high - low), 1))  # fmt: skip


def sensor_for(name: str, tube: Tube, rig: Rig) -> Sensor:
    """Sensor of a kind for a tube on a rig, with the typical error of its kind."""
    return thermocouple_for(tube, rig) if name == Thermocouple.name else SENSORS[name]()


def equipped(rig: Rig, sensor: Sensor | None) -> Rig:
    """Rig with the sensor in its mold: a thermocouple draws heat from the tube."""
    if not isinstance(sensor, Thermocouple):
        return rig
    return replace(rig, mold=replace(rig.mold, wire=sensor.wire, anchor=sensor.anchor))


SENSORS: dict[str, type[Sensor]] = {kind.name: kind for kind in (Thermocouple, TubeResistance, Camera)}
"""Sensor classes by name."""
