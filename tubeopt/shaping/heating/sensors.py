"""What a rig can feel of the tube while it is heated: a thermocouple, the tube's own resistance, a thermal camera.

A sensor reads a temperature. What it reads lags behind, is off by a bias that stays, is noisy, and comes in steps; the
reading that a sensor without these would give is its `target`, a function of the state of the thermal model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ...constants import ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError, numbers
from ...files.field_metadata import NOT_NEGATIVE, POSITIVE, Typical, check_fields, key, unit
from ...physics.heat import PROPERTIES
from ...typing import Array
from .simulation import State, advance, at_rest, current
from .thermal import ThermalModel


def followed(lag: ArrayLike, before: Array, target: Array, now: Array, span: float) -> Array:
    """Readings that lag behind by a time constant, s, `span` seconds after they were `before`, while their targets went
    in a line to `now`: solutions of lag y' + y = target."""
    lag = np.asarray(lag, dtype=float)
    slope, kept = (now - target) / span, np.exp(-span / np.maximum(lag, 1e-9))
    return np.asarray(now - lag * slope + (before - target + lag * slope) * kept)


@dataclass(frozen=True)
class Sensor(Displayed):
    """What all sensors have in common.

    Raises:
        InputError: a value is out of its range, or the range that it reads is empty.
    """

    name: ClassVar[str] = "sensor"
    """What it is called in files and words."""

    lag: Annotated[float, unit("s"), NOT_NEGATIVE, Typical(1e-3, 30.0), "time constant of the sensor"] = 0.0
    noise: Annotated[float, unit("K"), NOT_NEGATIVE, "standard deviation of one reading"] = 0.0
    bias: Annotated[float, unit("K"), NOT_NEGATIVE, "half-width of the constant error at the temperature window"] = 0.0
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
        """(B,) degC that it would read at once and without error."""
        raise NotImplementedError

    def shown(self, lagged: Array, bias: Array | float, ends: tuple[float, float], rng: np.random.Generator) -> Array:
        """(B,) readings: off by a bias in proportion to the rise from one temperature to another, as thermometers err,
        noisy, and in the steps that the sensor has."""
        part = np.clip((lagged - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
        value = lagged + bias * part + self.noise * rng.standard_normal(len(lagged))
        return np.asarray(np.round(value / self.quantum) * self.quantum) if self.quantum else value


@dataclass(frozen=True, eq=False)
class Felt:
    """Rigs, and what a sensor feels of them: (B,) degC that it would read at once, and with its lag."""

    state: State
    target: Array
    lagged: Array

    @classmethod
    def at_rest(cls, model: ThermalModel, sensor: Sensor) -> Felt:
        """Everything at the ambient temperature."""
        state = at_rest(model)
        target = sensor.target(model, state)
        return cls(state, target, target)

    def after(self, model: ThermalModel, sensor: Sensor, duty: Array | float, span: float) -> Felt:
        """`span` seconds later, at a duty, one number or (B,)."""
        state = advance(model, self.state, duty, span)
        target = sensor.target(model, state)
        return Felt(state, target, followed(sensor.lag, self.lagged, self.target, target, span))


def tube_at(model: ThermalModel, state: State, places: ArrayLike) -> Array:
    """(B, S) temperatures, degC, of the tube at distances (S,) from the middle of the curved part, m."""
    tube, wanted = state.cells[:, :, 0], model.half_length - np.abs(places)
    grid = np.append(model.position, model.half_length)
    # The middle mirrors the last cell: temperature is even about it, so it is flat up to there.
    index = np.clip(np.searchsorted(grid, wanted), 1, len(grid) - 1)
    part = (wanted - grid[index - 1]) / (grid[index] - grid[index - 1])
    whole = np.concatenate([tube, tube[:, -1:]], axis=1)
    return np.asarray((1 - part) * whole[:, index - 1] + part * whole[:, index]) - ZERO_CELSIUS


@dataclass(frozen=True)
class Thermocouple(Sensor):
    """A thermocouple on the tube: by default of type K, 0.25 mm thick, read by a MAX31855.

    The resolution is that of the converter. Lag, noise and bias are assumed: a bead behind a thin insulating coat, and
    half of the standard limits of error of type K at 525 degC (ASTM E230: 0.75 %, 4 K). The half assumes one comparison
    with another thermocouple.
    """

    name: ClassVar[str] = "thermocouple"

    lag: Annotated[float, unit("s"), NOT_NEGATIVE, Typical(1e-3, 30.0), "time constant of the sensor"] = 0.3
    noise: Annotated[float, unit("K"), NOT_NEGATIVE, "standard deviation of one reading"] = 0.5
    bias: Annotated[float, unit("K"), NOT_NEGATIVE, "half-width of the constant error at the temperature window"] = 2.0
    quantum: Annotated[float, unit("K"), NOT_NEGATIVE, "resolution of the readings; 0 for none"] = 0.25
    position: Annotated[
        float, unit("mm"), Typical(1e-4, 0.5), "position on the tube, from the middle of the curved part"
    ] = 0.0

    def target(self, model: ThermalModel, state: State) -> Array:
        """(B,) temperature where it touches."""
        if abs(self.position) >= model.half_length - model.position[0]:
            raise InputError(
                f"position of the thermocouple is {self.position * 1e3:g} mm from the middle of the tube; it must lie "
                "on the tube"
            )
        return np.asarray(tube_at(model, state, (self.position,)).mean(1))


@dataclass(frozen=True)
class Camera(Sensor):
    """A thermal camera, or a line of one, that sees the tube through vents of the lid.

    Its bias is that of an emissivity of 0.5 known to 0.02, at 525 degC and 10 um. With dT / T = d(eps) / eps * lambda T
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
        """(B,) mean temperature of the places that it sees."""
        if not self.positions or max(abs(place) for place in self.positions) >= model.half_length:
            raise InputError("positions of the camera must be at least one point on the tube")
        return np.asarray(tube_at(model, state, self.positions).mean(1))


@dataclass(frozen=True)
class TubeResistance(Sensor):
    """The tube as its own thermometer: voltage over current while the switch conducts, as a ratio to the cold tube.

    Reads the mean temperature between the clamps that explains the ratio with the nominal slope of the resistivity. The
    contacts are measured with the tube, so their resistance and an error of the slope affect the reading. Both belong
    to the uncertain rig, not to the bias of the sensor.
    """

    name: ClassVar[str] = "resistance"

    noise: Annotated[float, unit("K"), NOT_NEGATIVE, "standard deviation of one reading"] = 3.0
    slope: Annotated[
        float, unit("per_K"), POSITIVE, "assumed temperature coefficient of the resistivity at 25 degC"
    ] = 5e-4

    def target(self, model: ThermalModel, state: State) -> Array:
        """(B,) temperature that the ratio of resistances stands for."""

        def measured(cells: Array) -> Array:
            now = current(model, cells, state.lumped)
            contact = model.properties[:, PROPERTIES.index("contact")]
            return 2 * now.resistance + contact

        cold = np.broadcast_to(model.surroundings[:, None], state.cells[:, :, 0].shape)
        ratio = measured(state.cells[:, :, 0]) / measured(np.ascontiguousarray(cold))
        start = model.surroundings - ZERO_CELSIUS
        # Relative to the resistance at the temperature at which the rig was switched on.
        return np.asarray(start + (ratio - 1) * (1 / self.slope + start - 25.0))


SENSORS: dict[str, type[Sensor]] = {kind.name: kind for kind in (Thermocouple, TubeResistance, Camera)}
"""Sensors by their names."""
