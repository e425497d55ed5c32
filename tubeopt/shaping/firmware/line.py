"""What a computer says to a rig and hears from it, one JSON object a line, over a port; and a rig in place of a rig."""

from __future__ import annotations

import contextlib
import json
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...constants import ZERO_CELSIUS
from ...errors import InputError, SolveError, import_extra
from ...physics.heat import PROPERTIES
from ..heating.controller import HeatingLaw, begin, decide
from ..heating.rig import COUNTS
from ..heating.sensors import Felt, Sensor
from ..heating.simulation import State, current
from ..heating.thermal import ThermalModel

BAUD = 115200


@contextlib.contextmanager
def _lost() -> Iterator[None]:
    """Say of a port that it is gone."""
    try:
        yield
    except OSError as error:  # of which the exceptions of pyserial are
        raise SolveError(f"the connection to the rig is lost: {error}; check that the rig is off") from None


class SerialLine:
    """The serial port of a board that runs the sketch.

    Raises:
        InputError: pyserial is not installed, or there is no such port, or it cannot be opened.
    """

    def __init__(self, port: str) -> None:
        serial = import_extra("serial", "rig", "rigs on a port")
        try:
            self._port = serial.Serial(port, BAUD, timeout=1.0)
        except (serial.SerialException, ValueError, OSError) as error:
            raise InputError(f"--port is {port!r}; it must be a serial port that can be opened: {error}") from None
        self._rest = b""

    def send(self, do: str, **more: Any) -> None:
        """Send a command; raises SolveError where the port is gone."""
        with _lost():
            self._port.write((json.dumps({"do": do, **more}, separators=(",", ":")) + "\n").encode())

    def receive(self) -> dict[str, Any] | None:
        """The next report, {} for what is none, None where nothing came within a second; errors as `send`."""
        with _lost():
            self._rest += self._port.readline()
        if not self._rest.endswith(b"\n"):
            return None
        text, self._rest = self._rest, b""
        try:
            found = json.loads(text)
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    def close(self) -> None:
        """Let go of it."""
        self._port.close()


@dataclass
class SimulatedRig:
    """One member of a thermal model that is switched and read like a rig."""

    model: ThermalModel
    """Of one member."""
    sensor: Sensor
    bias: float = 0.0
    """Of the sensor where `hot` is reached, K."""
    hot: float = 550.0
    """degC."""
    seed: int = 0
    """Of the sensor's noise."""
    time: float = field(default=0.0, init=False)
    """s."""

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


class SimulatedLine:
    """A simulated rig that a law leads, in place of a board.

    speed: of its clock, in seconds of the rig per second; infinite for as fast as can be.
    """

    def __init__(
        self,
        rig: SimulatedRig,
        law: HeatingLaw,
        limit: float,
        speed: float = float("inf"),
        window: tuple[float, float] | None = None,
    ) -> None:
        self._rig, self._law, self._limit, self._speed, self._window = rig, law, limit, speed, window
        self._lead: deque[float] = deque()
        self._memory = begin(1)
        self._count, self._running, self._dry, self._reason, self._state = 0, False, False, "", "idle"
        self._heard: deque[dict[str, Any]] = deque()
        self._hello()

    def _hello(self) -> None:
        slot = round(1000 * self._law.slot)
        self._heard.append(
            {
                "event": "hello",
                "firmware": "simulated",
                "schedule": "",
                "slots": len(self._law.planned),
                "slot_ms": slot,
                "window_degC": self._window,
            }
        )

    def send(self, do: str, **more: Any) -> None:
        """Send a command."""
        if do == "start" and not self._running:
            self._running, self._dry, self._memory = True, bool(more.get("dry")), begin(1)
            self._lead.clear()
        elif do == "stop" and self._running:
            self._end("stopped by command")
        elif do == "hello":
            self._hello()
        elif do == "lead":
            self._lead = deque(np.linspace(more["from"] / 100, more["to"] / 100, more["slots"]).tolist())
        else:
            self._heard.append(self._status())

    def receive(self) -> dict[str, Any] | None:
        """The next report; a slot of the rig goes by where none waits."""
        if self._heard:
            return self._heard.popleft()
        if not self._running:
            return None
        law, place = self._law, int(self._memory.place[0])
        if self._dry:  # without current the tube would never come to where the schedule waits for it
            law = replace(law, holdback=np.inf)
        reading = self._rig.reading
        if reading > self._limit:
            self._end("over-temperature")
        elif place >= len(law.planned):
            self._end("done")
        elif self._memory.waited[0] > law.patience:
            self._end("behind schedule")
        else:
            lead = self._lead.popleft() if self._lead else np.nan
            count, self._memory = decide(law, self._memory, np.array([reading]), lead)
            self._count = int(count[0])
            self._state = "holding" if place >= law.hold[0] else "heating"
            self._heard.append(self._status(reading))
            self._rig.pass_time(0 if self._dry else self._count, law.slot)
            if np.isfinite(self._speed):
                time.sleep(law.slot / self._speed)
        return self._heard.popleft()

    def close(self) -> None:
        """Nothing to let go of."""

    @property
    def hottest(self) -> float:
        """Hottest point of the simulated tube, degC."""
        return self._rig.hottest - ZERO_CELSIUS

    def _end(self, reason: str) -> None:
        self._running, self._count, self._reason, self._state = False, 0, reason, "stopped"
        self._heard.append(self._status())

    def _status(self, reading: float | None = None) -> dict[str, Any]:
        volt, ampere = self._rig.electrics(self._count > 0 and not self._dry)
        place = int(self._memory.place[0])
        return {
            "event": "status",
            "state": self._state,
            "time_s": round(self._rig.time, 3),
            "temperature_degC": self._rig.reading if reading is None else reading,
            "reference_degC": float(self._law.reference[min(place, len(self._law.reference) - 1)]),
            "count": self._count,
            "place": place,
            # In the steps of the sketch's own reports.
            "voltage_V": round(volt, 2),
            "current_A": round(ampere, 1),
            "reason": self._reason,
            "dry": self._dry,
            "led": bool(self._lead),
        }


Line = SerialLine | SimulatedLine
"""A line to a rig."""
