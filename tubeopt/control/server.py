"""Server of a robot over WebSocket and OpenIGTLink on this machine: one commander, many watchers, a token, and limits.

Messages are JSON objects with "op". The first of every client is {"op": "hello", "token": ..., "role": "commander" or
"watcher"}; then a commander sends the commands of `CrtkRobot.command`. All clients receive {"op": "state", ...} at the
rate of publishing. A slow client receives the latest state only, which needs no further memory. The events of CRTK are
{"op": "error", "warning" or "status", "words": ...}. An invalid message is answered by an error. Any other error stops
the robot, which is then in the state FAULT until it is enabled again.

OpenIGTLink is the protocol of 3D Slicer, without a token. A client receives the pose of the tip (TRANSFORM TipToPlate),
the centreline (POINT Centreline) and a STATUS, in mm. It sends commands: a TRANSFORM or the first POINT is the target
of the tip, a STRING is a `state_command` or hold.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import secrets
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from http import HTTPStatus
from importlib.util import find_spec
from typing import Annotated, Any
from urllib.parse import urlsplit

import numpy as np

from ..arguments import typed
from ..errors import InputError, SolveError, finite, instance, whole
from ..files.field_metadata import POSITIVE, Range, Typical, unit
from ..files.units import TO_MM
from .command import Why
from .crtk import MOST_EVENTS, CrtkRobot

LOGGER = logging.getLogger("tubeopt")
logging.getLogger("websockets").addHandler(logging.NullHandler())  # a traceback for each invalid client

# Steps of the loop whose times are kept, 100 s at 1 kHz: 1.6 MB.
REMEMBERED = 100_000

# The server is for programs of this machine: any program that reaches its port could move the robot.
HOST = "127.0.0.1"

# Messages per second and client above which they are read more slowly: twice the rate of the loop, which uses the last
# one only.
MESSAGE_RATE = 2000.0

# Time limit of the hello, s, and maximum size of a message, bytes: no command has more than 1 kB.
HELLO_SECONDS, LONGEST_MESSAGE = 5.0, 16_384

# Each client costs a task and one copy of the state; a program that connects again and again must not use up the
# sockets.
MOST_CLIENTS = 256

# Seconds that a client has to close its connection once the server ends.
CLOSING = 1.0

# Hosts of pages that may control the robot: a browser sends the page's own with every request, and without this check
# any page that is open on this machine could try.
LOCAL = ("127.0.0.1", "localhost", "::1")

# Roles of a client.
ROLES = ("commander", "watcher")

# Maximum number of characters of a reported error.
LONGEST_TEXT = 300

# Time for which one thread of Python may delay the others, s: a small part of a period.
TURNS = 2e-4


@dataclass(frozen=True)
class ServerOptions:
    """Settings of a server."""

    port: Annotated[int, Range(minimum=0, maximum=65535), "TCP port of the server; 0 selects a free port"] = 8765
    token: str = ""
    """Password of the clients; "" makes a random one."""
    period: Annotated[
        float, unit("s"), Range(above=0.0, maximum=1.0), Typical(1e-5, 0.2), "period of the control loop"
    ] = 1e-3
    publish: Annotated[float, unit("Hz"), POSITIVE, "rate of published states"] = 40.0
    slicer_port: Annotated[
        int | None, Range(minimum=0, maximum=65535), "TCP port for 3D Slicer by OpenIGTLink; default none"
    ] = None

    def __post_init__(self) -> None:
        for name in ("period", "publish"):
            if not 0 < finite(name, getattr(self, name)) < 1e6:
                raise InputError(f"{name} is {getattr(self, name):g}; it must be more than 0 and less than 1e6")
        instance("token", self.token, str)
        for name in ("port", "slicer_port"):
            port = getattr(self, name)
            if port is not None and not 0 <= whole(name, port) < 65536:
                raise InputError(f"{name} is {port}; it must be 0 to 65535")


@dataclass(eq=False)
class _Client:
    """Connection of a client: remaining number of messages at a time, and events still to send."""

    socket: Any
    left: float
    since: float
    commander: bool = False
    events: deque[tuple[str, str]] = field(default_factory=lambda: deque(maxlen=MOST_EVENTS))
    news: asyncio.Event = field(default_factory=asyncio.Event)


class Pace:
    """Timing of the loop: numbers of steps and missed periods, and load and delay of the last REMEMBERED steps."""

    def __init__(self) -> None:
        self.steps = self.missed = 0
        self._times = np.zeros((REMEMBERED, 2))

    def add(self, took: float, delay: float, missed: int) -> None:
        """Record a step: its duration and delay, s, and the number of missed periods before it."""
        self._times[self.steps % REMEMBERED] = took, delay
        self.steps += 1
        self.missed += missed

    def quantiles(self, fraction: float) -> tuple[float, float]:
        """Quantiles, s, of the processor time and of the delay of the last steps."""
        known = self._times[: min(self.steps, REMEMBERED)]
        took, delay = np.quantile(known, fraction, axis=0) if len(known) else (0.0, 0.0)
        return float(took), float(delay)


@contextmanager
def _turns(seconds: float) -> Iterator[None]:
    """Set the interval at which Python switches threads within a block, s."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(seconds, before))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def check_installed(*, slicer: bool = False) -> None:
    """Raise InputError early if `websockets`, or `pyigtl` for Slicer, is not installed."""
    for name, needed in (("websockets", True), ("pyigtl", slicer)):
        if needed and find_spec(name) is None:
            raise InputError(f"{name} is missing; pip install 'tubeopt[control]' brings it")


@typed
class RobotServer:
    """Serves one robot until it is stopped.

    Args:
        robot: robot to serve.   options: see `ServerOptions`.
        clock: function that returns a time in s; it must never decrease.
        tell: called with the name of an event, such as "held", and a sentence on it.
    """

    def __init__(
        self,
        robot: CrtkRobot,
        options: ServerOptions | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        tell: Callable[[str, str], object] = lambda event, message: None,
    ) -> None:
        self.robot, self.options, self._clock = robot, options or ServerOptions(), clock
        self._say = tell
        self.token = self.options.token or secrets.token_urlsafe(16)
        self.port, self.slicer_port = self.options.port, self.options.slicer_port
        self.pace = Pace()
        self._clients: set[_Client] = set()
        self._commander: _Client | None = None
        self._report: dict[str, Any] = {}
        self._state = self._logged = ""
        self._robot_in_hand = threading.Lock()
        self._ended = threading.Event()

    async def serve(self, ready: Callable[[], object] | None = None) -> None:
        """Serve until cancelled; `ready` is called when clients can connect.

        Raises:
            InputError: a port is taken, or `websockets` or `pyigtl` is not installed.
        """
        options = self.options
        check_installed(slicer=options.slicer_port is not None)
        from websockets.asyncio.server import serve

        web = serve(
            self._welcome,
            HOST,
            options.port,
            process_request=_refuse_foreign_page,
            max_size=LONGEST_MESSAGE,
            max_queue=16,
            compression=None,
            close_timeout=CLOSING,
        )
        async with AsyncExitStack() as stack:
            self.port = await _listening(stack, web, options.port)
            if options.slicer_port is not None:
                slicer = asyncio.start_server(self._welcome_slicer, HOST, options.slicer_port, limit=LONGEST_MESSAGE)
                self.slicer_port = await _listening(stack, slicer, options.slicer_port)
            self._ended.clear()
            # In a thread of its own: waiting for a socket takes milliseconds, and many messages take longer.
            tasks = [asyncio.create_task(asyncio.to_thread(self._loop)), asyncio.create_task(self._publish())]
            try:
                with _turns(TURNS):
                    if ready is not None:
                        ready()
                    await asyncio.gather(*tasks)
            finally:  # whatever ends it, be it an interrupt in `ready`
                self._ended.set()
                for task in tasks:
                    task.cancel()

    def _loop(self) -> None:
        """Run one step per period. Missed steps are not repeated: joints never exceed their rates."""
        period, due = self.options.period, time.perf_counter()
        while not self._ended.is_set():
            start_time, delay = time.thread_time(), time.perf_counter() - due
            try:
                with self._robot_in_hand:
                    self.robot.tick(self._clock, period)
            except Exception as error:  # any error of a step stops the robot, and the loop continues
                self._failed(error)
            self.pace.add(time.thread_time() - start_time, delay, int(delay / period))
            due = max(due + period, time.perf_counter())
            time.sleep(max(due - time.perf_counter(), 0.0))

    def _failed(self, error: Exception) -> str:
        """Stop the robot after an error; returns the sentence that reports it."""
        error_text = str(error) if isinstance(error, InputError | SolveError) else f"{type(error).__name__}: {error}"
        error_text = f"the robot stopped: {error_text}"[:LONGEST_TEXT]
        with self._robot_in_hand:
            self.robot.fault(error_text)
        if error_text != self._logged:
            known = isinstance(error, InputError | SolveError)
            LOGGER.warning(error_text, exc_info=None if known else error)
            self._say("held", error_text)
            self._logged = error_text
        return error_text

    async def _publish(self) -> None:
        while True:
            await asyncio.sleep(1 / self.options.publish)
            if not self._clients:
                continue
            try:
                with self._robot_in_hand:
                    report = self.robot.report(self._clock()) | {"snap_distance": self.robot.snap_distance()}
                report |= {"steps": self.pace.steps, "missed_periods": self.pace.missed}
                self._report, self._state = report, json.dumps(report, allow_nan=False)
            except Exception as error:  # any error of a report stops the robot, and the server continues
                self._failed(error)
            with self._robot_in_hand:
                events = list(self.robot.events)
                self.robot.events.clear()
            for client in self._clients:
                client.events.extend(events)
                client.news.set()

    async def _send_state(self, client: _Client) -> None:
        """Send events and the latest state repeatedly, as fast as the client reads."""
        while True:
            await client.news.wait()
            client.news.clear()
            while client.events:
                await client.socket.send(_event(*client.events.popleft()))
            if self._state:
                await client.socket.send(self._state)

    async def _welcome(self, socket: Any) -> None:
        """Serve one client from its hello to its disconnection."""
        from websockets.exceptions import ConnectionClosed

        client = _Client(socket, MESSAGE_RATE, self._clock())
        publishing = None
        with suppress(ConnectionClosed):
            try:
                hello = await asyncio.wait_for(socket.recv(), HELLO_SECONDS)
                self._admit(client, hello)
            except (InputError, TimeoutError) as error:
                await socket.close(1008, str(error)[:120] or "no hello came")
                return
            try:
                await socket.send(json.dumps({"op": "welcome", "role": "commander" if client.commander else "watcher"}))
                self._clients.add(client)
                publishing = asyncio.create_task(self._send_state(client))
                async for message in socket:
                    if error_text := await self._hear(client, partial(_read, message)):
                        await socket.send(_event("error", error_text))
            finally:
                if publishing is not None:
                    publishing.cancel()
                self._leave(client)

    def _admit(self, client: _Client, hello: str | bytes) -> None:
        """Admit a client; raises InputError if its hello, token or role is invalid."""
        message = _read(hello)
        token = message.get("token")
        if message.get("op") != "hello" or not isinstance(token, str):
            raise InputError("the first message must be a hello with the token")
        if not hmac.compare_digest(*(word.encode(errors="surrogatepass") for word in (token, self.token))):
            raise InputError("the token is wrong")
        if len(self._clients) >= MOST_CLIENTS:
            raise InputError(f"there are {MOST_CLIENTS} clients already")
        role = message.get("role", "watcher")
        if role not in ROLES:
            raise InputError(f"role is {role!r}; it must be {' or '.join(ROLES)}")
        if role == "commander":
            self._command_by(client)

    def _command_by(self, client: _Client) -> None:
        """Make a client the commander; raises InputError if there is another one."""
        if self._commander not in (None, client):
            raise InputError("another client already controls the robot")
        if not client.commander:
            self._commander, client.commander = client, True
            self._say("commander", "connected")

    def _leave(self, client: _Client) -> None:
        self._clients.discard(client)
        if client is self._commander:
            self._commander = None
            with self._robot_in_hand:
                self.robot.release()
            self._say("commander", "disconnected")

    async def _hear(self, client: _Client, read: Callable[[], dict[str, Any]]) -> str:
        """Execute a command read by `read`; returns the error as text, or ""."""
        now, rate = self._clock(), MESSAGE_RATE
        client.left = min(rate, client.left + max(now - client.since, 0.0) * rate)
        client.since = now
        if client.left < 1:
            await asyncio.sleep(1 / rate)  # who sends more is read more slowly
        client.left -= 1
        try:
            if not client.commander:
                raise InputError("this client is a watcher; it cannot send commands")
            command = read()
            with self._robot_in_hand:
                self.robot.command(command, self._clock())
        except InputError as error:
            return str(error)
        except Exception as error:  # any error of one command stops the robot, and the server continues
            return self._failed(error)
        return ""

    async def _welcome_slicer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client by OpenIGTLink from connection to disconnection."""
        client = _Client(writer, MESSAGE_RATE, self._clock())
        publishing = asyncio.create_task(self._send_state_to_slicer(client))
        try:
            if len(self._clients) >= MOST_CLIENTS:
                return
            self._clients.add(client)
            with suppress(asyncio.IncompleteReadError, ConnectionError):
                while True:
                    read = await _slicer_message(reader)
                    if read is None:
                        continue
                    try:
                        self._command_by(client)
                        if error_text := await self._hear(client, read):
                            client.events.append(("error", error_text))
                    except InputError as error:
                        client.events.append(("error", str(error)))
        except (InputError, ValueError, struct.error) as error:
            LOGGER.warning("a client by OpenIGTLink is rejected: %s", error)
        finally:
            publishing.cancel()
            self._leave(client)
            writer.close()

    async def _send_state_to_slicer(self, client: _Client) -> None:
        """Send the latest state repeatedly, as fast as the client reads; an error stays in STATUS for one state."""
        with suppress(ConnectionError):
            while True:
                await client.news.wait()
                client.news.clear()
                error_text = next((error_text for kind, error_text in reversed(client.events) if kind == "error"), "")
                client.events.clear()
                for message in _slicer_state(self._report, error_text) if self._report else ():
                    client.socket.write(message.pack())
                await client.socket.drain()


async def _listening(stack: AsyncExitStack, server: Any, port: int) -> int:
    """Number of a port that is open until a stack ends; raises InputError if it is not available."""
    try:
        listens = await stack.enter_async_context(await server)
    except OSError as error:
        raise InputError(f"port {port} cannot be used: {error.strerror or error}") from None
    return int(next(iter(listens.sockets)).getsockname()[1])


def _refuse_foreign_page(connection: Any, request: Any) -> Any:
    """Response 403 for a page of another machine, otherwise None; programs send no origin."""
    origins = request.headers.get_all("Origin")
    if all(urlsplit(origin).hostname in LOCAL for origin in origins):
        return None
    return connection.respond(HTTPStatus.FORBIDDEN, "pages of other machines must not control this robot\n")


# --- OpenIGTLink ------------------------------------------------------------------------------------------------------

# Bytes of a header, and points of the centreline: Slicer draws each as a point that can be dragged.
HEADER, CENTRELINE = 58, 20

# Codes of a STATUS.
STATUS_OK, UNREACHABLE, UNKNOWN, NOT_READY, MANUAL, IS_DISABLED = 1, 8, 12, 13, 14, 15


@lru_cache(maxsize=1)
def _status_class() -> Any:
    """Message class STATUS for pyigtl, which then also reads such messages."""
    from pyigtl import messages

    class StatusMessage(messages.MessageBase):  # type: ignore[misc]
        """State message: a code, the name of an error, and a text."""

        def __init__(
            self, code: int = STATUS_OK, name: str = "", text: str = "", device_name: str | None = None
        ) -> None:
            super().__init__(device_name=device_name)
            self.code, self.name, self.text = code, name, text
            self._message_type, self._valid_message = "STATUS", True

        def _pack_content(self) -> bytes:
            return struct.pack("> H q 20s", self.code, 0, self.name.encode()[:20]) + self.text.encode() + b"\0"

        def _unpack_content(self, content: bytes) -> None:
            self.code, _, name = struct.unpack("> H q 20s", content[:30])
            self.name, self.text = (part.rstrip(b"\0").decode() for part in (name, content[30:]))

    messages.message_type_to_class_constructor["STATUS"] = StatusMessage
    return StatusMessage


def _slicer_state(report: dict[str, Any], failure: str) -> list[Any]:
    """OpenIGTLink messages of a state, in mm; `failure` is the text of STATUS."""
    from pyigtl.messages import PointMessage, TransformMessage

    pose, shape = np.eye(4), TO_MM * np.array(report["shape"])
    pose[:3, :3], pose[:3, 3] = report["setpoint_cp"]["rotation"], TO_MM * np.array(report["setpoint_cp"]["position"])
    few = shape[np.linspace(0, len(shape) - 1, CENTRELINE).round().astype(int)]
    state, why = report["operating_state"], failure or report["why"]
    code = {"DISABLED": IS_DISABLED, "PAUSED": MANUAL, "FAULT": UNKNOWN}.get(state["state"], STATUS_OK)
    if failure:
        code = UNKNOWN
    elif not state["is_homed"]:
        code = NOT_READY
    elif code == STATUS_OK and Why.NO_CLOSER.text in why:
        code = UNREACHABLE
    text = f"{state['state']}, margin {report['margin']:.3f}" + (f": {why}" if why else "")
    names = [f"{k}" for k in range(CENTRELINE)]
    return [
        TransformMessage(pose, device_name="TipToPlate"),
        PointMessage(few.tolist(), names=names, device_name="Centreline"),
        _status_class()(code, state["state"], text, device_name="Robot"),
    ]


async def _slicer_message(reader: asyncio.StreamReader) -> Callable[[], dict[str, Any]] | None:
    """Next message as a function that returns its command; None for a message without a command.

    Raises:
        InputError, ValueError, struct.error: it is no message of OpenIGTLink.
    """
    from pyigtl.messages import CRC64, MessageBase

    _status_class()
    header = await reader.readexactly(HEADER)
    fields, (check,) = MessageBase.parse_header(header), struct.unpack("> Q", header[-8:])
    if fields["body_size"] > LONGEST_MESSAGE:
        raise InputError(f"a message has {fields['body_size']} bytes; it must have at most {LONGEST_MESSAGE}")
    body = await reader.readexactly(fields["body_size"])
    if check not in (0, CRC64(body)):
        raise InputError("a message is broken: its check sum differs")
    if fields["message_type"] not in ("TRANSFORM", "POINT", "STRING"):
        return None

    def read() -> dict[str, Any]:
        message = MessageBase.create_message(fields["message_type"])
        try:
            message.unpack(fields, body)
        except (ValueError, TypeError, struct.error, IndexError):
            raise InputError(f"{fields['message_type']} cannot be read") from None
        if fields["message_type"] == "STRING":
            word = message.string.strip()
            return {"op": "hold"} if word == "hold" else {"op": "state_command", "command": word}
        if fields["message_type"] == "POINT":
            if not message.positions:
                raise InputError("POINT has no point; its first one is where the tip is to go")
            return {"op": "move_cp", "position": [x / TO_MM for x in message.positions[0]]}
        pose = message.matrix
        return {"op": "move_cp", "position": (pose[:3, 3] / TO_MM).tolist(), "direction": pose[:3, 2].tolist()}

    return read


def _event(kind: str, message: str) -> str:
    return json.dumps({"op": kind, "words": message[:LONGEST_TEXT]})


def _read(message: str | bytes) -> dict[str, Any]:
    try:
        read = json.loads(message)
    except (ValueError, RecursionError):
        raise InputError("the message is not JSON") from None
    if not isinstance(read, dict):
        raise InputError("the message is not a JSON object")
    return read
