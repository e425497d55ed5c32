"""A robot over WebSocket on this machine: one commander, many watchers, a token, and limits for all.

Messages are JSON objects with "op". The first of every client is {"op": "hello", "token": ..., "role": "commander" or
"watcher"}; then a commander sends what `CrtkRobot.command` knows. Everybody gets {"op": "state", ...} at the rate of
publishing, the newest one only: who reads slowly misses some, and costs no memory. Whatever goes wrong holds the robot
and is reported as {"op": "error", "words": ...}; the next command is served.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Annotated, Any

import numpy as np

from ..arguments import typed
from ..errors import InputError, SolveError, finite, instance, whole
from ..files.field_metadata import POSITIVE, Range, Typical, unit
from .crtk import CrtkRobot

LOGGER = logging.getLogger("tubeopt")
logging.getLogger("websockets").addHandler(logging.NullHandler())  # a traceback for each client that is none

# Steps of the loop whose times are kept, 100 s at 1 kHz: 1.6 MB.
REMEMBERED = 100_000

# The server is for programs of one machine: who reaches its port could move the robot.
HOST = "127.0.0.1"

# Messages per second and client, above which they are read more slowly: twice the rate of the loop, which acts on the
# last one only.
MESSAGE_RATE = 2000.0

# Time that a client has for its hello, s, and bytes of its longest message: no command has more than 1 kB.
HELLO_SECONDS, LONGEST_MESSAGE = 5.0, 16_384

# Each client costs a task and one copy of the state; a program that connects again and again must not use up the
# sockets.
MOST_CLIENTS = 256

# Seconds that a client has to close its connection once the server ends.
CLOSING = 1.0

# What a client may be.
ROLES = ("commander", "watcher")

# Characters of an error that is reported.
LONGEST_WORDS = 300

# Seconds for which one thread of Python may keep the others waiting: a small part of a period.
TURNS = 2e-4


@dataclass(frozen=True)
class ServerOptions:
    """How a robot is served."""

    port: Annotated[int, Range(least=0, most=65535), "TCP port of the server; 0 selects a free port"] = 8765
    token: str = ""
    """Password of the clients; "" makes a random one."""
    period: Annotated[
        float, unit("s"), Range(above=0.0, most=1.0), Typical(1e-5, 0.2), "period of the control loop"
    ] = 1e-3
    publish: Annotated[float, unit("Hz"), POSITIVE, "rate of published states"] = 40.0

    def __post_init__(self) -> None:
        for name in ("period", "publish"):
            if not 0 < finite(name, getattr(self, name)) < 1e6:
                raise InputError(f"{name} is {getattr(self, name):g}; it must be more than 0 and less than 1e6")
        instance("token", self.token, str)
        if not 0 <= whole("port", self.port) < 65536:
            raise InputError(f"port is {self.port}; it must be 0 to 65535")


@dataclass(eq=False)
class _Client:
    """A connection: how many messages it may still send, as of a time, and the error that it is to be sent."""

    socket: Any
    left: float
    since: float
    commander: bool = False
    failure: str = ""
    news: asyncio.Event = field(default_factory=asyncio.Event)


class Pace:
    """How well the loop keeps its period: `steps`, periods `missed`, and of the last REMEMBERED steps how much of the
    processor's time they took and by how much they began late."""

    def __init__(self) -> None:
        self.steps = self.missed = 0
        self._times = np.zeros((REMEMBERED, 2))

    def add(self, took: float, late: float, missed: int) -> None:
        """A step that took and was late by so much, s, after so many periods without one."""
        self._times[self.steps % REMEMBERED] = took, late
        self.steps += 1
        self.missed += missed

    def quantiles(self, share: float) -> tuple[float, float]:
        """Processor time of a step and by how much it began late, s, below which a share of them lies."""
        known = self._times[: min(self.steps, REMEMBERED)]
        took, late = np.quantile(known, share, axis=0) if len(known) else (0.0, 0.0)
        return float(took), float(late)


@contextmanager
def _turns(seconds: float) -> Iterator[None]:
    """The threads of Python take turns as often as this."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(seconds, before))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def check_websockets() -> None:
    """Raise InputError where `websockets` is not installed, before anything that takes long."""
    if find_spec("websockets") is None:
        raise InputError("websockets is missing; pip install 'tubeopt[control]' brings it")


@typed
class RobotServer:
    """Serves one robot until it is stopped.

    Args:
        robot: what is commanded.   options: see `ServerOptions`.
        clock: seconds that never go back.
    """

    def __init__(
        self, robot: CrtkRobot, options: ServerOptions | None = None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.robot, self.options, self._clock = robot, options or ServerOptions(), clock
        self.token = self.options.token or secrets.token_urlsafe(16)
        self.port = self.options.port
        self.pace = Pace()
        self._clients: set[_Client] = set()
        self._commander: _Client | None = None
        self._state = self._failure = ""
        self._logged = ""
        self._robot_in_hand = threading.Lock()
        self._ended = threading.Event()

    async def serve(self, ready: Callable[[], object] | None = None) -> None:
        """Serve until cancelled; `ready` is called when clients can come.

        Raises:
            InputError: the port is taken, or `websockets` is not installed.
        """
        check_websockets()
        from websockets.asyncio.server import serve

        options = self.options
        place = HOST, options.port
        try:
            listening = await serve(
                self._welcome,
                *place,
                max_size=LONGEST_MESSAGE,
                max_queue=16,
                compression=None,
                close_timeout=CLOSING,
            )
        except OSError as error:
            raise InputError(f"port {options.port} cannot be used: {error.strerror or error}") from None
        async with listening:
            self.port = next(iter(listening.sockets)).getsockname()[1]
            self._ended.clear()
            # In a thread of its own: to wait for a socket takes whole milliseconds, and many messages take longer.
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
        """A step per period. What is late is not made up for: joints never go faster than their rates."""
        period, due = self.options.period, time.perf_counter()
        while not self._ended.is_set():
            began, late = time.thread_time(), time.perf_counter() - due
            try:
                with self._robot_in_hand:
                    self.robot.tick(self._clock, period)
            except Exception as error:  # any error of a step holds the robot, and the loop goes on
                self._failure = self._held(error)
            self.pace.add(time.thread_time() - began, late, int(late / period))
            due = max(due + period, time.perf_counter())
            time.sleep(max(due - time.perf_counter(), 0.0))

    def _held(self, error: Exception) -> str:
        """Hold the robot after an error, and return what is reported of it: a sentence."""
        words = str(error) if isinstance(error, InputError | SolveError) else f"{type(error).__name__}: {error}"
        words = f"the robot is held: {words}"[:LONGEST_WORDS]
        with self._robot_in_hand:
            self.robot.hold(words)
        if words != self._logged:
            known = isinstance(error, InputError | SolveError)
            LOGGER.warning(words, exc_info=None if known else error)
            self._logged = words
        return words

    async def _publish(self) -> None:
        while True:
            await asyncio.sleep(1 / self.options.publish)
            failure, self._failure = self._failure, ""
            if not self._clients:
                continue
            try:
                with self._robot_in_hand:
                    told = self.robot.report(self._clock())
                told |= {"steps": self.pace.steps, "missed_periods": self.pace.missed}
                self._state = json.dumps(told, allow_nan=False)
            except Exception as error:  # any error of a report holds the robot, and the server goes on
                failure = failure or self._held(error)
            for client in self._clients:
                client.failure = failure or client.failure
                client.news.set()

    async def _tell(self, client: _Client) -> None:
        """The newest error and state, again and again, as fast as the client reads."""
        while True:
            await client.news.wait()
            client.news.clear()
            words, client.failure = client.failure, ""
            if words:
                await client.socket.send(_error(words))
            if self._state:
                await client.socket.send(self._state)

    async def _welcome(self, socket: Any) -> None:
        """One client from its hello to its end."""
        from websockets.exceptions import ConnectionClosed

        client = _Client(socket, MESSAGE_RATE, self._clock())
        telling = None
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
                telling = asyncio.create_task(self._tell(client))
                async for message in socket:
                    await self._hear(client, message)
            finally:
                if telling is not None:
                    telling.cancel()
                self._leave(client)

    def _admit(self, client: _Client, hello: str | bytes) -> None:
        """Raises InputError where a client may not come in."""
        told = _read(hello)
        token = told.get("token")
        if told.get("op") != "hello" or not isinstance(token, str):
            raise InputError("the first message must be a hello with the token")
        if not hmac.compare_digest(*(word.encode(errors="surrogatepass") for word in (token, self.token))):
            raise InputError("the token is wrong")
        if len(self._clients) >= MOST_CLIENTS:
            raise InputError(f"there are {MOST_CLIENTS} clients already")
        role = told.get("role", "watcher")
        if role not in ROLES:
            raise InputError(f"role is {role!r}; it must be {' or '.join(ROLES)}")
        if role == "commander":
            if self._commander is not None:
                raise InputError("another client already controls the robot")
            self._commander, client.commander = client, True

    def _leave(self, client: _Client) -> None:
        self._clients.discard(client)
        if client is self._commander:
            self._commander = None
            with self._robot_in_hand:
                self.robot.release()

    async def _hear(self, client: _Client, message: str | bytes) -> None:
        """A message of a client; what makes no sense is answered."""
        now, rate = self._clock(), MESSAGE_RATE
        client.left = min(rate, client.left + max(now - client.since, 0.0) * rate)
        client.since = now
        if client.left < 1:
            await asyncio.sleep(1 / rate)  # who sends more is read more slowly
        client.left -= 1
        try:
            if not client.commander:
                raise InputError("this client is a watcher; it cannot send commands")
            told = _read(message)
            with self._robot_in_hand:
                self.robot.command(told, self._clock())
        except InputError as error:
            await client.socket.send(_error(str(error)))
        except Exception as error:  # any error of one command holds the robot, and the server goes on for all clients
            await client.socket.send(_error(self._held(error)))


def _error(words: str) -> str:
    return json.dumps({"op": "error", "words": words[:LONGEST_WORDS]})


def _read(message: str | bytes) -> dict[str, Any]:
    try:
        read = json.loads(message)
    except (ValueError, RecursionError):
        raise InputError("the message is not JSON") from None
    if not isinstance(read, dict):
        raise InputError("the message is not a JSON object")
    return read
