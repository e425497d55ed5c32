"""The robot for 3D Slicer: messages of OpenIGTLink to and from pyigtl's own client, over a socket."""

from __future__ import annotations

import asyncio
import socket
import struct
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import InputError
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.server import RobotServer, ServerOptions, _status_class
from tubeopt.control.servo import Servo

pyigtl = pytest.importorskip("pyigtl")
pytest.importorskip("websockets")

START = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])


def session(talk: Callable[[RobotServer, Any], Awaitable[None]]) -> RobotServer:
    """A server at 500 Hz, and what pyigtl's client says to it in a thread of its own."""

    async def run() -> RobotServer:
        options = ServerOptions(port=0, slicer_port=0, period=2e-3)
        server, ready = RobotServer(CrtkRobot(Servo(THESIS, START)), options), asyncio.Event()
        serving = asyncio.create_task(server.serve(ready.set))
        await asyncio.wait_for(ready.wait(), 20)
        _status_class()  # from here on pyigtl reads STATUS
        client = pyigtl.OpenIGTLinkClient(port=server.slicer_port)
        try:
            await asyncio.wait_for(talk(server, client), 30)
        finally:
            await asyncio.to_thread(client.stop)
            serving.cancel()
            with suppress(asyncio.CancelledError):
                await serving
        return server

    return asyncio.run(run())


async def heard(client: Any, name: str) -> Any:
    """The next message of a device."""
    message = await asyncio.to_thread(client.wait_for_message, name, 10)
    assert message is not None
    return message


async def until(client: Any, holds: Callable[[Any], bool]) -> Any:
    """The first STATUS for which something holds."""
    for _ in range(400):
        if holds(status := await heard(client, "Robot")):
            return status
    raise AssertionError(status.text)


def test_slicer_sees_tip_centreline_and_state_at_40_hz() -> None:
    async def talk(server: RobotServer, client: Any) -> None:
        arm = server.robot.servo.equilibrium
        pose, points, status = [await heard(client, name) for name in ("TipToPlate", "Centreline", "Robot")]
        assert pose.matrix[:3, 3] == pytest.approx(1e3 * arm.tip_position, abs=1e-4)  # single precision
        assert pose.matrix[:3, :3] == pytest.approx(arm.tip_rotation, abs=1e-6)
        line = np.array(points.positions)
        assert line[0] == pytest.approx(np.zeros(3), abs=1e-6)
        assert line[-1] == pytest.approx(1e3 * arm.tip_position, abs=1e-4)
        assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(1e3 * arm.arc_length[-1], rel=2e-3)
        assert (status.code, status.name) == (15, "DISABLED")
        began, stamps = time.monotonic(), set()
        while time.monotonic() - began < 2:
            stamps.add((await heard(client, "TipToPlate")).timestamp)
        assert 60 < len(stamps) < 90

    session(talk)


def test_slicer_moves_the_robot_by_point_and_transform() -> None:
    async def talk(server: RobotServer, client: Any) -> None:
        first = server.robot.servo.equilibrium
        goal = 1e3 * (first.tip_position + np.array([2e-3, 1e-3, 0.0]))
        await heard(client, "Robot")
        client.send_message(pyigtl.PointMessage([goal.tolist()], device_name="Target"), wait=False)
        refused = await until(client, lambda status: status.code == 12)
        assert "move_cp is rejected: the robot is DISABLED" in refused.text
        client.send_message(pyigtl.StringMessage("enable", device_name="Command"), wait=False)
        await until(client, lambda status: status.name == "ENABLED")
        client.send_message(pyigtl.PointMessage([goal.tolist()], device_name="Target"), wait=False)
        while np.linalg.norm((await heard(client, "TipToPlate")).matrix[:3, 3] - goal) > 1e-2:
            pass
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = first.tip_rotation, 1e3 * first.tip_position
        client.send_message(pyigtl.TransformMessage(pose, device_name="TargetToPlate"), wait=False)
        while np.linalg.norm((await heard(client, "TipToPlate")).matrix[:3, 3] - pose[:3, 3]) > 1e-2:
            pass
        assert (await heard(client, "TipToPlate")).matrix[:3, 2] == pytest.approx(first.tip_rotation[:, 2], abs=1e-3)
        far = pyigtl.PointMessage([[0.0, 0.0, 900.0]], device_name="Target")
        client.send_message(far, wait=False)
        assert "position is 0.9 m from the plate" in (await until(client, lambda status: status.code == 12)).text
        client.send_message(pyigtl.PointMessage([[float("nan")] * 3], device_name="Target"), wait=False)
        assert "finite" in (await until(client, lambda status: status.code == 12)).text
        client.send_message(pyigtl.StringMessage("hold"), wait=False)
        await until(client, lambda status: "stopped by command" in status.text)

    session(talk)


def test_one_client_controls_and_a_broken_message_ends_a_connection() -> None:
    async def talk(server: RobotServer, client: Any) -> None:
        await heard(client, "Robot")
        client.send_message(pyigtl.StringMessage("enable"), wait=False)
        await until(client, lambda status: status.name == "ENABLED")
        other = pyigtl.OpenIGTLinkClient(port=server.slicer_port)
        await heard(other, "Robot")
        other.send_message(pyigtl.StringMessage("disable"), wait=False)
        assert "another client already controls" in (await until(other, lambda status: status.code == 12)).text
        await asyncio.to_thread(other.stop)
        message = bytearray(pyigtl.StringMessage("disable").pack())
        for spoilt in (message[:57] + bytes([message[57] ^ 1]) + message[58:], b"\xff" * 58, b"GET / HTTP/1.1" * 9):
            with socket.create_connection(("127.0.0.1", server.slicer_port or 0)) as plain:
                plain.sendall(bytes(spoilt))
                plain.settimeout(10)
                while await asyncio.to_thread(plain.recv, 65536):
                    pass
        unknown = struct.pack("> H 12s 20s II Q Q", 1, b"SENSOR", b"x", 0, 0, 0, 0)
        with socket.create_connection(("127.0.0.1", server.slicer_port or 0)) as plain:
            plain.sendall(unknown)
            assert await asyncio.to_thread(plain.recv, 58)
        assert (await heard(client, "Robot")).name == "ENABLED"

    assert session(talk).robot.state == "ENABLED"


def test_a_taken_port_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        options = ServerOptions(port=0, slicer_port=taken.getsockname()[1])
        server = RobotServer(CrtkRobot(Servo(THESIS, START)), options)
        with pytest.raises(InputError, match=f"port {options.slicer_port} cannot be used"):
            asyncio.run(server.serve())


def test_a_port_is_checked() -> None:
    with pytest.raises(InputError, match="slicer_port is 70000; it must be 0 to 65535"):
        ServerOptions(slicer_port=70000)


def teardown_module() -> None:
    """pyigtl does not read STATUS by itself."""
    pyigtl.messages.message_type_to_class_constructor.pop("STATUS", None)
    _status_class.cache_clear()
