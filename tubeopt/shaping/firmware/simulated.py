"""A rig in place of a rig: the thermal model of one, its sensor, its currents, in steps of time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...physics.heat import PROPERTIES
from ..heating.rates import State, current
from ..heating.rig import COUNTS
from ..heating.sensors import Felt, Sensor
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

    def __post_init__(self) -> None:
        self._felt = Felt.at_rest(self.model, self.sensor)
        self._ends = float(self._felt.target[0]), self.hot
        self._rng = np.random.default_rng(self.seed)

    @property
    def state(self) -> State:
        """Temperatures, and what else the model remembers."""
        return self._felt.state

    def pass_time(self, count: int, span: float) -> None:
        """Let `span` seconds go by with the switch at `count`."""
        self._felt = self._felt.after(self.model, self.sensor, count / COUNTS, span)
        self.time += span

    @property
    def reading(self) -> float:
        """What the sensor shows, degC."""
        return float(self.sensor.shown(self._felt.lagged, self.bias, self._ends, self._rng)[0])

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
