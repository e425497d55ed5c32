"""A rig in place of a rig: the thermal model of one, its sensor, its currents, in steps of time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...physics.heat import PROPERTIES
from ..heating.rates import State, at_rest, current
from ..heating.rig import COUNTS
from ..heating.sensors import Sensor
from ..heating.simulation import advance
from ..heating.thermal import ThermalModel


@dataclass
class SimulatedRig:
    """One member of a thermal model that is switched and read like a rig.

    model: one member. bias: K, of the sensor where `hot` degC are reached. noise: seed of the sensor's.
    """

    model: ThermalModel
    sensor: Sensor
    bias: float = 0.0
    hot: float = 550.0
    seed: int = 0
    time: float = field(default=0.0, init=False)
    state: State = field(init=False)

    def __post_init__(self) -> None:
        self.state = at_rest(self.model)
        self._target = self._lagged = self.sensor.target(self.model, self.state)
        self._cold = float(self._target[0])
        self._rng = np.random.default_rng(self.seed)

    def pass_time(self, count: int, span: float) -> None:
        """Let `span` seconds go by with the switch at `count`."""
        self.state = advance(self.model, self.state, count / COUNTS, span)
        now = self.sensor.target(self.model, self.state)
        self._lagged, self._target = self.sensor.followed(self._lagged, self._target, now, span), now
        self.time += span

    @property
    def reading(self) -> float:
        """What the sensor shows, degC."""
        part = np.clip((self._lagged - self._cold) / (self.hot - self._cold), 0.0, 1.0)
        noise = self.sensor.noise * self._rng.standard_normal(1)
        return float(self.sensor.told(self._lagged + self.bias * part + noise)[0])

    def electrics(self, conducting: bool) -> tuple[float, float]:
        """Voltage of the battery, V, and current, A, while the switch conducts or while it does not."""
        now = current(self.model, self.state.cells[:, :, 0], self.state.lumped)
        volt, ampere = float(now.terminal_voltage[0]), float(now.total[0])
        if conducting:
            return volt, ampere
        return volt + ampere * float(self.model.properties[0, PROPERTIES.index("internal")]), 0.0

    @property
    def hottest(self) -> float:
        """Hottest point of the tube, K."""
        return float(self.state.cells[:, :, 0].max())
