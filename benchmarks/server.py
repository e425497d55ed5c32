"""The server under fault: a robot at 1 kHz whose clients are killed, talk nonsense, crowd, and whose clock jumps.

    python -m benchmarks.server [--seconds 600] [--watchers 100] [--malformed 10000]

The server runs in a process of its own. A commander streams velocities of the tip and pauses, and is killed every ten
seconds, in the middle of a stream; another client sends messages that make no sense; watchers read the state. Every
fifteen seconds the clock of the server jumps, by 1,000 s ahead or back, which the server is not told. The process looks
at every step by the clock that does not jump: whether the robot moved later than the watchdog allows after the last
command that was taken, and faster than its rates. When it moved is told twice: by the time that the setpoint carries,
and by when somebody could read it first, as a process may be put aside between the two. Times are processor times of a
step, and by how much it began late; beside it a third process does nothing but sleep for a period, again and again, and
so tells which periods the machine had no time for.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import tubeopt
import tubeopt.control.server
from tubeopt.control.c_binding import servo_of
from tubeopt.control.crtk import AnyServo, CrtkRobot
from tubeopt.control.server import Pace, RobotServer, ServerOptions

WATCHDOG, PERIOD, TOKEN = 0.1, 1e-3, "benchmark"
SEED = [0.0, 1.0, 2.0], [-0.05, -0.03, -0.02]
JUMP, EVERY = 1e3, 15.0
"""Seconds by which the clock jumps, and how often."""

JUNK = [
    b"\xff\x00",
    "[" * 5000,
    "{}",
    "null",
    '{"op": "servo_cp", "position": 1e999}',
    '{"op": 3}',
    '{"op": "servo_cp"',
]
JUNK += ['{"op": "servo_cv", "linear": [0, 0, NaN]}', '{"op": "servo_jp", "rotations": [0]}', "\u0000" * 100]


class Jumping(threading.local):
    """A clock that jumps ahead and back; `steady` is when each thread read it last, by one that does not."""

    steady = -np.inf

    def __call__(self) -> float:
        """Seconds."""
        self.steady = time.monotonic()
        return self.steady + JUMP * (int(self.steady / EVERY) % 2)


CLOCK = Jumping()


class Watched(CrtkRobot):
    """A robot whose motion is looked at by a clock that does not jump."""

    def __init__(self, servo: AnyServo) -> None:
        super().__init__(servo, watchdog=WATCHDOG)
        self.taken = -np.inf
        self.moved, self.dropped, self.too_fast = 0, 0, 0
        self.late, self.late_to_read = -np.inf, -np.inf

    def command(self, message: Mapping[str, Any], now: float) -> None:
        """As that of the robot, with the time at which it was taken: that of `now`, which this thread has just read."""
        super().command(message, now)
        self.taken = CLOCK.steady

    def tick(self, clock: Callable[[], float], dt: float) -> None:
        """As that of the robot; then what it did. The last that it read of the clock is the time of the setpoint."""
        before, sent, o, asked = self.servo.equilibrium, self.sent, self.servo.options, [0]

        def counted() -> float:
            asked[0] += 1
            return clock()

        super().tick(counted, dt)
        stamp, readable = CLOCK.steady, time.monotonic()
        self.dropped += asked[0] == 2 and self.sent == sent
        after = self.servo.equilibrium
        turned, shifted = np.abs(after.rotations - before.rotations), np.abs(after.translations - before.translations)
        if not (turned.any() or shifted.any()):
            return
        self.moved += 1
        self.late = max(self.late, stamp - self.taken - WATCHDOG)
        self.late_to_read = max(self.late_to_read, readable - self.taken - WATCHDOG)
        self.too_fast += bool(turned.max() > o.turn_rate * dt + 1e-9 or shifted.max() > o.shift_rate * dt + 1e-9)


async def serve(path: str) -> None:
    """Serve until a line comes in; then say how it went."""
    robot = tubeopt.load_robot(path)
    watched = Watched(servo_of(robot, SEED))
    tubeopt.control.server.MESSAGE_RATE = 1e4  # the flood of messages is what is measured
    server = RobotServer(watched, ServerOptions(port=0, token=TOKEN, period=PERIOD), clock=CLOCK)
    serving = asyncio.create_task(server.serve(lambda: print(server.port, flush=True)))
    await asyncio.wait(
        {serving, asyncio.create_task(asyncio.to_thread(sys.stdin.readline))}, return_when="FIRST_COMPLETED"
    )
    pace = server.pace
    report = {
        "servo": type(watched.servo).__name__,
        "steps": pace.steps,
        "steps that moved": watched.moved,
        "share of periods missed": pace.missed / (pace.steps + pace.missed),
        "processor time of a step (ms): median, 99 %, 99.9 %": [1e3 * pace.quantiles(q)[0] for q in (0.5, 0.99, 0.999)],
        "step began late (ms): median, 99 %, 99.9 %": [1e3 * pace.quantiles(q)[1] for q in (0.5, 0.99, 0.999)],
        "latest time of a setpoint, after the watchdog's (ms; must be at most 0)": 1e3 * watched.late,
        "the same of when it could be read first": 1e3 * watched.late_to_read,
        "steps taken back, as the watchdog bit while they were made": watched.dropped,
        "steps beyond the rates": watched.too_fast,
        "crashed": serving.done(),
    }
    print(json.dumps(report), flush=True)
    serving.cancel()
    with suppress(asyncio.CancelledError):
        await serving


def sleep(seconds: float) -> None:
    """Periods that a process misses which does nothing."""
    pace, due = Pace(), time.perf_counter()
    while pace.steps < seconds / PERIOD - pace.missed:
        late = time.perf_counter() - due
        pace.add(0.0, late, int(late / PERIOD))
        due = max(due + PERIOD, time.perf_counter())
        time.sleep(max(due - time.perf_counter(), 0.0))
    late = [1e3 * pace.quantiles(q)[1] for q in (0.5, 0.99, 0.999)]
    print(json.dumps([pace.missed / (pace.steps + pace.missed), late]), flush=True)


async def enter(port: int, role: str) -> Any:
    """A client that was let in; another commander's place is free only after that one is gone."""
    from websockets import ConnectionClosed
    from websockets.asyncio.client import connect

    while True:
        socket = await connect(f"ws://127.0.0.1:{port}", compression=None, max_queue=4)
        with suppress(ConnectionClosed):
            await socket.send(json.dumps({"op": "hello", "token": TOKEN, "role": role}))
            await socket.recv()
            return socket
        await asyncio.sleep(0.05)


async def command(port: int, end: float) -> int:
    """Streams with pauses until the end, killed every ten seconds; how many were."""
    killed, random = 0, np.random.default_rng(0)
    while time.monotonic() < end:
        socket = await enter(port, "commander")
        reading = asyncio.create_task(drain(socket))
        await socket.send(json.dumps({"op": "state_command", "command": "enable"}))
        for k in range(500):
            if k % 100 == 0:
                velocity = random.uniform(-0.03, 0.03, 3).tolist()
            if k % 100 < 80:
                await socket.send(json.dumps({"op": "servo_cv", "linear": velocity}))
            await asyncio.sleep(0.02)
        await socket.send(json.dumps({"op": "servo_cv", "linear": velocity}))
        socket.transport.abort()
        killed += 1
        reading.cancel()
    return killed


async def drain(socket: Any) -> int:
    """Read what comes until the connection ends; how many messages."""
    count = 0
    with suppress(Exception):  # however the connection ends, what came before is counted
        async for _ in socket:
            count += 1
    return count


async def pester(port: int, end: float, count: int) -> int:
    """Messages that make no sense, spread over the time; how many were answered."""
    socket = await enter(port, "watcher")
    answered, start = 0, time.monotonic()
    for k in range(count):
        await asyncio.sleep(max(start + (end - start) * 0.95 * k / count - time.monotonic(), 0))
        await socket.send(JUNK[k % len(JUNK)])
        while json.loads(await socket.recv())["op"] != "error":
            pass
        answered += 1
    await socket.close()
    return answered


async def memory(process: int, end: float) -> list[float]:
    """Resident memory (MB), twice a second."""
    out = []
    while time.monotonic() < end:
        line = next(
            each for each in Path(f"/proc/{process}/status").read_text().splitlines() if each.startswith("VmRSS")
        )
        out.append(int(line.split()[1]) / 1024)
        await asyncio.sleep(0.5)
    return out


async def torment(options: argparse.Namespace) -> None:
    """All of it against a server in a process of its own."""
    again, pipe = [sys.executable, "-m", "benchmarks.server"], asyncio.subprocess.PIPE
    child = await asyncio.create_subprocess_exec(*again, "--serve", "--robot", options.robot, stdin=pipe, stdout=pipe)
    idle = await asyncio.create_subprocess_exec(*again, "--sleep", "--seconds", str(options.seconds), stdout=pipe)
    assert child.stdout is not None
    assert child.stdin is not None
    port, end = int(await child.stdout.readline()), time.monotonic() + options.seconds
    watchers = [asyncio.create_task(drain(await enter(port, "watcher"))) for _ in range(options.watchers)]
    asked = command(port, end), pester(port, end, options.malformed), memory(child.pid, end)
    killed, answered, resident = await asyncio.gather(*asked)
    child.stdin.write(b"\n")
    report = json.loads(await child.stdout.readline())
    heard = await asyncio.gather(*watchers)
    await child.wait()
    missed, late = json.loads((await idle.communicate())[0])
    quarter = len(resident) // 4
    report |= {
        "a process that only sleeps: share of periods missed": missed,
        "and began late (ms): median, 99 %, 99.9 %": late,
        "commanders killed": killed,
        "malformed messages answered": answered,
        "states heard by a watcher": [min(heard), max(heard)],
        "memory (MB) after a quarter, at the end": [resident[quarter], resident[-1]],
    }
    for name, value in report.items():
        print(f"{name}: {value}")


def main() -> None:
    """Serve, or torment a server."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="configs/robots/thesis_ctr.yaml")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--watchers", type=int, default=100)
    parser.add_argument("--malformed", type=int, default=10_000)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--sleep", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.sleep:
        sleep(options.seconds)
    else:
        asyncio.run(serve(options.robot) if options.serve else torment(options))


if __name__ == "__main__":
    main()
