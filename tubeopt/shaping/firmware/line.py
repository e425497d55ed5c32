"""Connection of a computer to a rig: one JSON object a line over a serial port; and a simulated rig."""

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
from ..heating.controller import HeatingLaw, LawState, decide
from ..heating.rig import COUNTS
from ..heating.sensors import MeasuredRig, Sensor
from ..heating.simulation import State, circuit_state
from ..heating.thermal import ThermalModel

BAUD = 115200


@contextlib.contextmanager
def _port_errors() -> Iterator[None]:
    """Turn errors of a port into SolveError."""
    try:
        yield
    except OSError as error:  # base class of the exceptions of pyserial
        raise SolveError(f"the connection to the rig is lost: {error}; check that the rig is off") from None


class SerialLine:
    """Serial port of a board that runs the sketch.

    Raises:
        InputError: pyserial is not installed, or the port does not exist or cannot be opened.
    """

    def __init__(self, port: str) -> None:
        serial = import_extra("serial", "rig", "rigs on a port")
        try:
            self._port = serial.Serial(port, BAUD, timeout=1.0)
        except (serial.SerialException, ValueError, OSError) as error:
            raise InputError(f"--port is {port!r}; it must be a serial port that can be opened: {error}") from None
        self._buffer = b""

    def send(self, do: str, **arguments: Any) -> None:
        """Send a command; raises SolveError if the port is gone."""
        with _port_errors():
            self._port.write((json.dumps({"do": do, **arguments}, separators=(",", ":")) + "\n").encode())

    def receive(self) -> dict[str, Any] | None:
        """Next report, {} for an invalid one, None without one within a second; errors as `send`."""
        with _port_errors():
            self._buffer += self._port.readline()
        if not self._buffer.endswith(b"\n"):
            return None
        text, self._buffer = self._buffer, b""
        try:
            report = json.loads(text)
        except ValueError:
            return {}
        return report if isinstance(report, dict) else {}

    def close(self) -> None:
        """Close the port."""
        self._port.close()


@dataclass
class SimulatedRig:
    """Rig of one member that is switched and measured like a real one."""

    model: ThermalModel
    sensor: Sensor
    bias: float = 0.0
    """Bias of the sensor at the temperature `hot`, K."""
    hot: float = 550.0
    """Temperature with the given bias, degC."""
    seed: int = 0
    """Seed of the sensor's noise."""
    time: float = field(default=0.0, init=False)
    """Time since the start of the simulation, s."""

    def __post_init__(self) -> None:
        self._rig = MeasuredRig.at_rest(self.model, self.sensor)
        self.ends = float(self._rig.target[0]), self.hot
        self._rng = np.random.default_rng(self.seed)

    @property
    def state(self) -> State:
        """State of the thermal model."""
        return self._rig.state

    def pass_time(self, count: int, span: float) -> None:
        """Simulate `span` seconds at a PWM count."""
        self._rig = self._rig.after(self.model, self.sensor, count / COUNTS, span)
        self.time += span

    @property
    def reading(self) -> float:
        """Reading of the sensor, degC; every call has its own noise."""
        return float(self.sensor.shown(self._rig.lagged, self.bias, self.ends, self._rng)[0])

    def electrics(self, conducting: bool) -> tuple[float, float]:
        """Battery voltage, V, and current, A, while the switch conducts or is open."""
        circuit = circuit_state(self.model, self.state.cells[:, :, 0], self.state.lumped)
        V, I_on = float(circuit.V_terminal[0]), float(circuit.I_on[0])
        return (V, I_on) if conducting else (V + I_on * float(self.model.parameter("R_internal")[0]), 0.0)

    @property
    def hottest(self) -> float:
        """Temperature of the hottest point of the tube, K."""
        return float(self.state.cells[:, :, 0].max())


class SimulatedLine:
    """Simulated rig under a control law, with the commands and reports of a board.

    Args:
        limit: reading at which it stops, degC.
        speed: seconds of the rig per second of the clock; infinite for as fast as possible.
        opening: delay of the cut-out, and the longest allowed one, ms.
    """

    def __init__(
        self,
        rig: SimulatedRig,
        law: HeatingLaw,
        limit: float,
        speed: float = float("inf"),
        window: tuple[float, float] | None = None,
        opening: tuple[int, int] = (0, 0),
    ) -> None:
        self._opening = opening
        self._rig, self._law, self._limit, self._speed, self._window = rig, law, limit, speed, window
        self._override: deque[float] = deque()
        self._law_state = LawState.start(1)
        self._count, self._running, self._dry, self._reason, self._state = 0, False, False, "", "idle"
        self._reports: deque[dict[str, Any]] = deque()
        self.send("hello")

    def send(self, do: str, **arguments: Any) -> None:
        """Send a command: "start", "stop", "hello", "lead", "test" or "status"."""
        if do == "start" and not self._running:
            self._running, self._dry, self._law_state = True, bool(arguments.get("dry")), LawState.start(1)
            self._override.clear()
        elif do == "stop" and self._running:
            self._end("stopped by command")
        elif do == "hello":
            report = {"event": "hello", "firmware": "simulated", "schedule": "", "slots": len(self._law.planned)}
            self._reports.append({**report, "slot_ms": round(1000 * self._law.slot), "window_degC": self._window})
        elif do == "test":
            self._reports.append({"event": "cutout", "opened_ms": self._opening[0], "allowed_ms": self._opening[1]})
            self._end("done")
        elif do == "lead":
            counts = np.linspace(arguments["from"] / 100, arguments["to"] / 100, arguments["slots"])
            self._override = deque(counts.tolist())
        else:
            self._reports.append(self._status())

    def receive(self) -> dict[str, Any] | None:
        """Next report; without one, a slot of the rig is simulated."""
        if self._reports:
            return self._reports.popleft()
        if not self._running:
            return None
        law, index = self._law, int(self._law_state.index[0])
        if self._dry:  # without current the tube would never reach the reference: do not wait for it
            law = replace(law, holdback=np.inf, floor=-np.inf)
        reading = self._rig.reading
        if reading > self._limit:
            self._end("over-temperature")
        elif index >= len(law.planned):
            self._end("done")
        elif self._law_state.waited[0] > law.patience:
            self._end("too cold" if index >= law.hold[0] else "behind schedule")
        else:
            override = self._override.popleft() if self._override else np.nan
            count, self._law_state = decide(law, self._law_state, np.array([reading]), override)
            self._count = int(count[0])
            self._state = "holding" if index >= law.hold[0] else "heating"
            self._reports.append(self._status(reading))
            self._rig.pass_time(0 if self._dry else self._count, law.slot)
            if np.isfinite(self._speed):
                time.sleep(law.slot / self._speed)
        return self._reports.popleft()

    def close(self) -> None:
        """Do nothing: there is no port."""

    @property
    def hottest(self) -> float:
        """Temperature of the hottest point of the simulated tube, degC."""
        return self._rig.hottest - ZERO_CELSIUS

    def _end(self, reason: str) -> None:
        self._running, self._count, self._reason, self._state = False, 0, reason, "stopped"
        self._reports.append(self._status())

    def _status(self, reading: float | None = None) -> dict[str, Any]:
        V, current = self._rig.electrics(self._count > 0 and not self._dry)
        index = int(self._law_state.index[0])
        return {
            "event": "status",
            "state": self._state,
            "time_s": round(self._rig.time, 3),
            "temperature_degC": self._rig.reading if reading is None else reading,
            "reference_degC": float(self._law.reference[min(index, len(self._law.reference) - 1)]),
            "count": self._count,
            "place": index,
            # With the resolution of the sketch's own reports.
            "voltage_V": round(V, 2),
            "current_A": round(current, 1),
            "reason": self._reason,
            "dry": self._dry,
            "led": bool(self._override),
        }


Line = SerialLine | SimulatedLine
"""Connection to a rig."""
