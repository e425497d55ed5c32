"""A robot over WebSocket: who may command, what is refused, and that nothing moves when nobody tells it to."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import shutil
import subprocess
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import InputError, SolveError, find_snap, forward_kinematics
from tubeopt.bodies.obstacles import Sphere
from tubeopt.control.c_binding import CServo, servo_of
from tubeopt.control.command import ServoOptions
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.server import RobotServer, ServerOptions
from tubeopt.control.servo import Servo
from tubeopt.solvers.compiled.library import compiler

websockets = pytest.importorskip("websockets")

SEED = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
CLIENTS = Path("integrations/clients")
CONNECTED: list[Any] = []
"""Clients of the test that runs, to be closed at its end."""
NEEDS_COMPILER = pytest.mark.skipif(compiler() is None, reason="no C compiler")


def robot(**options: float) -> CrtkRobot:
    return CrtkRobot(Servo(THESIS, SEED), **options)


def enabled() -> CrtkRobot:
    out = robot()
    out.command({"op": "state_command", "command": "enable"}, 0.0)
    return out


def tick(of: CrtkRobot, now: float, dt: float = 1e-3) -> None:
    of.tick(lambda: now, dt)


def tip(of: CrtkRobot) -> np.ndarray:
    return of.servo.equilibrium.tip_position


def test_a_stream_moves_the_robot_until_it_ends_however_the_clock_jumps() -> None:
    arm = enabled()
    target = (tip(arm) + np.array([5e-3, 0, 0])).tolist()
    arm.command({"op": "servo_cp", "position": target}, 0.0)
    for k in range(300):
        tick(arm, 1e-3 * k)
        if k == 100:
            held = tip(arm)
    # One tenth of a second of motion at 50 mm/s and the rates, then none.
    assert 1e-4 < np.linalg.norm(held - SEED.tip_position) <= 5.1e-3
    assert np.array_equal(tip(arm), held) or np.linalg.norm(tip(arm) - held) < 1e-4
    assert "in time" in arm.report(0.3)["why"]
    for jump in (1e6, -1e6):
        arm.command({"op": "servo_cp", "position": target}, 1.0)
        before = tip(arm)
        tick(arm, 1.0 + jump)
        assert np.array_equal(tip(arm), before)


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=NEEDS_COMPILER)])
def test_a_step_whose_time_ran_out_while_it_was_made_is_taken_back(fast: bool) -> None:
    arm = CrtkRobot(servo_of(THESIS, SEED) if fast else Servo(THESIS, SEED))
    arm.command({"op": "state_command", "command": "enable"}, 0.0)
    target = (tip(arm) + np.array([5e-3, 0, 0])).tolist()
    for message in (
        {"op": "servo_cp", "position": target},
        {"op": "servo_jp", "rotations": [0.1, 1, 2], "translations": [-0.05, -0.03, -0.02]},
    ):
        arm.command(message, 1.0)
        tick(arm, 1.05)
        sent, before = arm.sent, arm.servo.equilibrium
        assert sent == 1.05
        # The process is put aside for 0.1 s once the step was begun; or the clock jumps there.
        for late in (1.101, -1e6):
            arm.command(message, 1.0)
            times = iter([1.099, late])
            arm.tick(lambda: next(times), 1e-3)  # noqa: B023
            assert arm.servo.equilibrium is before
            assert arm.sent == sent
            assert "in time" in arm.report(1.2)["why"]
        # From there it goes on as if nothing had been.
        arm.command(message, 2.0)
        tick(arm, 2.0)
        gone = arm.servo.equilibrium.rotations - before.rotations
        assert 0 < np.abs(gone).max() <= arm.servo.options.turn_rate * 1e-3 + 1e-12
        known = forward_kinematics(THESIS, arm.servo.equilibrium.rotations, arm.servo.equilibrium.translations)
        assert tip(arm) == pytest.approx(known.tip_position, abs=1e-9)
        assert arm.report(2.0)["setpoint_time"] == 2.0


def test_a_move_arrives_or_says_why_not() -> None:
    arm = enabled()
    target = tip(arm) + np.array([2e-3, 1e-3, 0])
    arm.command({"op": "move_cp", "position": target.tolist()}, 0.0)
    assert arm.busy
    for k in range(600):
        tick(arm, 1e-3 * k)
    assert not arm.busy
    assert tip(arm) == pytest.approx(target, abs=2e-6)
    arm.command({"op": "move_jp", "rotations": [0, 1, 2], "translations": [-0.05, -0.03, -0.02]}, 1.0)
    for k in range(200):
        tick(arm, 1 + 1e-2 * k, 1e-2)
    assert tip(arm) == pytest.approx(SEED.tip_position, abs=1e-5)
    arm.command({"op": "move_cp", "position": [0.29, 0, 0]}, 10.0)
    k = 0
    while arm.busy and k < 2000:
        tick(arm, 10 + 1e-2 * k, 1e-2)
        k += 1
    assert not arm.busy
    assert "short" in arm.report(20.0)["why"]


@NEEDS_COMPILER
def test_the_c_library_leads_where_it_can_do_what_is_asked() -> None:
    fast = servo_of(THESIS, SEED)
    assert isinstance(fast, CServo)
    assert fast.equilibrium.position[-1] == pytest.approx(SEED.tip_position, abs=1e-9)
    assert isinstance(servo_of(THESIS, SEED, obstacles=[Sphere((1.0, 0.0, 0.0), 0.01)]), Servo)
    assert isinstance(servo_of(THESIS, SEED, options=ServoOptions(objective="centre")), Servo)


def test_a_loop_keeps_its_pace_though_the_clock_goes_back() -> None:
    times = iter([0.0, 0.001, -1e6, 1e6, *np.arange(1000) * 1e-3])

    async def serve() -> int:
        server = RobotServer(robot(), ServerOptions(port=0), clock=lambda: next(times))
        serving = asyncio.create_task(server.serve())
        while server.pace.steps < 10:
            await asyncio.sleep(0.01)
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
        assert server.pace.quantiles(0.5)[0] > 0
        return server.pace.steps

    assert asyncio.run(asyncio.wait_for(serve(), 20)) >= 10


def test_what_makes_no_sense_changes_nothing() -> None:
    arm = robot()
    with pytest.raises(InputError, match="enable it first"):
        arm.command({"op": "servo_cp", "position": [0, 0, 0]}, 0.0)
    arm = enabled()
    for message in (
        {},
        {"op": 3},
        {"op": "servo_cp"},
        {"op": "servo_cp", "position": [1, 2]},
        {"op": "servo_cp", "position": [1, 2, float("nan")]},
        {"op": "servo_cp", "position": {"x": 1}},
        {"op": "servo_cp", "position": [0, 0, 0], "direction": [0, 0, 0]},
        {"op": "servo_jp", "rotations": [0, 0, 0]},
        {"op": "state_command", "command": "fly"},
        {"op": "state_command", "command": "resume"},
    ):
        with pytest.raises(InputError):
            arm.command(message, 0.0)
    joints = {"rotations": [0, 1, 2], "translations": [-0.05, -0.03, -0.02]}
    for message, words in (
        ({"op": "move_cp", "position": [30, 0, 120]}, r"position is 123\.\d+ m from .* at most 0\.\d+ m, the length"),
        ({"op": "servo_cp", "position": [30, 0, 120]}, "the length of the longest arm"),
        ({"op": "move_jp", **joints, "translations": [-0.05, -50, 0]},
         r"translations of tube 2 is -50 m; it must lie between -0\.15 and 0\.15 m"),
        ({"op": "servo_jp", **joints, "rotations": [0, 57, 0]}, r"rotations of tube 2 is 57 rad; .* between -6\.28"),
        ({"op": "move_cp", "positin": [0, 0, 0.1]}, "'positin' is not a key of move_cp; .*did you mean 'position'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            arm.command(message, 0.0)
    tick(arm, 0.0)
    assert np.array_equal(tip(arm), SEED.tip_position)
    with pytest.raises(InputError, match="watchdog is 0"):
        robot(watchdog=0.0)


JOINTS = {"rotations": [0.5, -0.5, 0.0], "translations": [0.0, 0.01, 0.0]}


def streamed(arm: CrtkRobot, message: dict[str, Any], count: int = 100) -> dict[str, Any]:
    """The report after so many steps of a stream, each of a millisecond."""
    begun = arm.sent or 0.0
    for k in range(1, count + 1):
        now = begun + 1e-3 * k
        arm.command(message, now)
        tick(arm, now)
    return arm.report(now)


@pytest.mark.parametrize("limits", [{}, {"turn_acceleration": 30.0, "shift_acceleration": 1.0}])
def test_joints_have_the_velocities_that_are_commanded_and_stop_at_their_limits(limits: dict[str, Any]) -> None:
    arm = CrtkRobot(Servo(THESIS, SEED, options=ServoOptions(**limits)))
    arm.command({"op": "state_command", "command": "enable"}, 0.0)
    velocities = [*JOINTS["rotations"], *JOINTS["translations"]]
    told = streamed(arm, {"op": "servo_jv", **JOINTS})
    assert told["measured_js"]["velocity"] == pytest.approx(velocities, abs=1e-6)
    # The tip moves as two equilibria next to each other do.
    arrays = [np.array(told["measured_js"][name]) for name in ("position", "velocity")]
    ahead, behind = (
        forward_kinematics(THESIS, *np.split(arrays[0] + sign * 1e-4 * arrays[1], 2)) for sign in (0.0, -1.0)
    )
    assert told["measured_cv"]["linear"] == pytest.approx((ahead.tip_position - behind.tip_position) / 1e-4, abs=2e-4)
    skew = (ahead.tip_rotation - behind.tip_rotation) @ ahead.tip_rotation.T / 1e-4
    assert told["measured_cv"]["angular"] == pytest.approx([skew[2, 1], skew[0, 2], skew[1, 0]], abs=2e-3)
    # The outer tube stops where its carriage meets that of the middle tube, which it does not push.
    told = streamed(arm, {"op": "servo_jv", "rotations": [0, 0, 0], "translations": [0, 0, 0.05]}, 1500)
    assert told["why"] == "tubes or carriages touch"
    assert np.abs(told["measured_js"]["velocity"]).max() < 1e-6
    assert arm.servo.space.admissible(arm.servo.space.join(*np.reshape(told["measured_js"]["position"], (2, -1))))
    with pytest.raises(InputError, match="translations has 1e"):
        arm.command({"op": "servo_jv", "rotations": [0, 0, 0], "translations": [0, 0, 1e9]}, 0.0)


def test_the_tip_turns_at_the_velocity_and_by_the_angle_that_are_commanded() -> None:
    arm = enabled()
    ahead = arm.servo.equilibrium.tip_rotation[:, 2]
    about = np.cross(ahead, [0.0, 0.0, 1.0])
    about *= 0.05 / np.linalg.norm(about)
    told = streamed(arm, {"op": "servo_cv", "linear": [0, 0, 0], "angular": about.tolist()})
    assert np.cross(told["measured_cv"]["angular"], ahead) == pytest.approx(np.cross(about, ahead), abs=1e-3)
    assert tip(arm) == pytest.approx(SEED.tip_position, abs=1e-5)  # 0.1 um a step, which nobody corrects
    # Back by the angle that it has turned, and a little ahead.
    target = tip(arm) + np.array([1e-4, 0.0, 0.0])
    message: dict[str, Any] = {"op": "move_cr", "translation": [1e-4, 0.0, 0.0], "turn": (-0.1 * about).tolist()}
    arm.command(message, 1.0)
    for k in range(400):
        tick(arm, 1.0 + 1e-3 * k)
    assert not arm.busy
    assert tip(arm) == pytest.approx(target, abs=1e-6)
    assert arm.servo.equilibrium.tip_rotation[:, 2] == pytest.approx(ahead, abs=1e-5)


def test_state_commands_follow_the_table_of_crtk() -> None:
    # Rows: states; columns: enable, disable, pause, resume; "" is rejected.
    table = {
        "DISABLED": ("ENABLED", "DISABLED", "", ""),
        "ENABLED": ("ENABLED", "DISABLED", "PAUSED", ""),
        "PAUSED": ("", "DISABLED", "PAUSED", "ENABLED"),
        "FAULT": ("ENABLED", "DISABLED", "", ""),
    }
    for state, row in table.items():
        for command, after in zip(("enable", "disable", "pause", "resume"), row, strict=True):
            arm = robot()
            arm.state = state
            message = {"op": "state_command", "command": command}
            if after:
                arm.command(message, 0.0)
            else:
                with pytest.raises(InputError, match=f"{command} is rejected: the robot is {state}, which allows"):
                    arm.command(message, 0.0)
            assert arm.state == (after or state)


def test_a_move_is_reported_busy_once_at_least_and_free_asks_for_homing() -> None:
    arm = enabled()
    still: dict[str, Any] = {"rotations": [0, 0, 0], "translations": [0, 0, 0]}
    arm.command({"op": "move_jr", **still}, 0.0)
    tick(arm, 1e-3)
    assert not arm.busy
    assert [arm.report(1e-3)["operating_state"]["is_busy"] for _ in range(2)] == [True, False]
    arm.command({"op": "free"}, 2e-3)
    with pytest.raises(InputError, match="not homed"):
        arm.command({"op": "servo_jr", **still}, 2e-3)
    arm.command({"op": "state_command", "command": "home"}, 2e-3)
    arm.command({"op": "servo_jr", **still}, 2e-3)
    tick(arm, 1.0)
    kinds = [kind for kind, _ in arm.events]
    assert kinds == ["status", "status", "warning"]
    assert "in time" in arm.events[-1][1]


def run(talk: Callable[[RobotServer], Awaitable[None]], *, of: CrtkRobot | None = None) -> RobotServer:
    """Serve a robot while something talks to it."""

    async def both() -> RobotServer:
        server = RobotServer(of or robot(), ServerOptions(port=0, period=2e-3))
        ready = asyncio.Event()
        serving = asyncio.create_task(server.serve(ready.set))
        await asyncio.wait({asyncio.create_task(ready.wait()), serving}, return_when=asyncio.FIRST_COMPLETED)
        try:
            await talk(server)
        finally:
            await asyncio.gather(*(each.close() for each in CONNECTED), return_exceptions=True)
            CONNECTED.clear()
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
        return server

    return asyncio.run(asyncio.wait_for(both(), 60))


async def client(server: RobotServer, role: str = "commander", token: str | None = None) -> Any:
    socket = await websockets.connect(f"ws://127.0.0.1:{server.port}", compression=None)
    CONNECTED.append(socket)
    await socket.send(json.dumps({"op": "hello", "token": token or server.token, "role": role}))
    return socket


async def told(socket: Any, op: str) -> dict[str, Any]:
    while True:
        message: dict[str, Any] = json.loads(await asyncio.wait_for(socket.recv(), 10))
        if message["op"] == op:
            return message


def test_one_commands_and_many_watch_and_a_commander_that_is_killed_stops_the_robot() -> None:
    async def talk(server: RobotServer) -> None:
        commander = await client(server)
        assert (await told(commander, "welcome"))["role"] == "commander"
        for refused in (await client(server), await client(server, token="guessed")):
            with pytest.raises(websockets.ConnectionClosed):
                await told(refused, "welcome")
        watchers = [await client(server, "watcher") for _ in range(20)]
        await watchers[0].send(json.dumps({"op": "state_command", "command": "enable"}))
        assert "watcher; it cannot send commands" in (await told(watchers[0], "error"))["words"]
        await commander.send(json.dumps({"op": "state_command", "command": "enable"}))
        await commander.send(json.dumps({"op": "servo_cv", "linear": [0.02, 0, 0]}))
        await asyncio.sleep(0.05)
        commander.transport.abort()
        await asyncio.sleep(0.1)
        held = tip(server.robot)
        await asyncio.sleep(0.1)
        assert np.array_equal(tip(server.robot), held)
        assert np.linalg.norm(held - SEED.tip_position) > 1e-5
        states = [await told(watcher, "state") for watcher in watchers]
        assert states[0]["setpoint_js"]["name"][0] == "rotation_1"
        again = await client(server)
        assert (await told(again, "welcome"))["role"] == "commander"

    run(talk)


def test_malformed_messages_are_answered_and_the_robot_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.control.server.MESSAGE_RATE", 1e5)

    async def talk(server: RobotServer) -> None:
        commander = await client(server)
        await told(commander, "welcome")
        random = np.random.default_rng(0)
        for k in range(300):
            junk = [b"\xff\x00", "[" * 5000, "{}", '{"op": "servo_cp", "position": 1e999}', str(random.bytes(30))]
            await commander.send(junk[k % len(junk)])
            assert (await told(commander, "error"))["words"]
        await commander.send(json.dumps({"op": "state_command", "command": "enable"}))
        await asyncio.sleep(0.1)
        assert server.robot.state == "ENABLED"
        await commander.send("x" * 100_000)
        with pytest.raises(websockets.ConnectionClosed):
            await told(commander, "never")

    run(talk)


def test_the_clients_of_both_languages_lead_the_robot() -> None:
    spec = importlib.util.spec_from_file_location("tubeopt_client", CLIENTS / "tubeopt_client.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def lead(port: int, token: str) -> float:
        robot = module.Robot(token, port)
        robot.enable()
        for _ in range(10):
            robot.servo_cv([0.02, 0, 0])
            state = robot.state()
        robot.close()
        return float(state["measured_cp"]["position"][0])

    async def talk(server: RobotServer) -> None:
        assert await asyncio.to_thread(lead, server.port, server.token) > SEED.tip_position[0] + 1e-4
        node = shutil.which("node")
        if node is None:
            return
        script = f"""
            const {{ Robot }} = await import("{(CLIENTS / "tubeopt_client.js").resolve()}");
            let count = 0;
            const robot = await Robot.connect("{server.token}", {{ port: {server.port}, onState: (state, robot) => {{
                if (++count < 10) robot.servoCv([-0.02, 0, 0]);
                else {{ console.log(state.operating_state.state); process.exit(0); }}
            }} }});
            robot.enable();
        """
        for flags in ([], ["--experimental-websocket"]):  # Node has WebSocket by default from version 22 on
            asked = [node, *flags, "-e", "process.exit(typeof WebSocket === 'function' ? 0 : 1)"]
            if (await asyncio.to_thread(subprocess.run, asked, capture_output=True)).returncode:
                continue
            await asyncio.sleep(0.1)
            command = [node, *flags, "--no-warnings", "--input-type=module", "-e", script]
            done = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=30)
            assert done.stdout.strip() == "ENABLED", done.stderr
            break

    run(talk)


@pytest.mark.parametrize("error", [RuntimeError("of CasADi"), np.linalg.LinAlgError("singular"), SolveError("a snap")])
@pytest.mark.parametrize("place", ["step", "command", "report"])
def test_any_error_stops_the_robot_in_fault_until_it_is_enabled_again(
    monkeypatch: pytest.MonkeyPatch, error: Exception, place: str
) -> None:
    async def talk(server: RobotServer) -> None:
        commander, watcher = await client(server), await client(server, "watcher")
        await told(commander, "welcome")
        await told(watcher, "welcome")
        await commander.send(json.dumps({"op": "state_command", "command": "enable"}))
        while server.robot.state != "ENABLED":
            await asyncio.sleep(1e-3)
        broken: Any = server.robot.servo if place == "step" else server.robot
        whole, failures = getattr(broken, place), [error]

        def fail(*given: Any) -> Any:
            if failures:
                raise failures.pop()
            return whole(*given)

        monkeypatch.setattr(broken, place, fail)
        there = [0.0, 1.0, 2.0], [-0.05, -0.03, -0.019]
        move = json.dumps({"op": "move_jp", "rotations": there[0], "translations": there[1]})
        await commander.send(move)
        words = (await told(commander, "error"))["words"]
        assert words.startswith("the robot stopped: ")
        assert str(error) in words
        assert (await told(watcher, "error"))["words"] == words
        watcher.transport.abort()
        assert server.robot.state == "FAULT"
        await commander.send(move)
        while "enable it first" not in (await told(commander, "error"))["words"]:
            pass
        await commander.send(json.dumps({"op": "state_command", "command": "enable"}))
        if place == "step":
            assert not server.robot.busy
            assert np.array_equal(server.robot.servo.equilibrium.translations, SEED.translations)
        await commander.send(move)
        for _ in range(40):
            state = await told(commander, "state")
        assert state["setpoint_js"]["position"][5] == pytest.approx(-0.019, abs=1e-6)

    run(talk)


def test_a_server_at_the_plate_serves_commands_out_of_it() -> None:
    async def talk(server: RobotServer) -> None:
        commander = await client(server)
        await told(commander, "welcome")
        await commander.send(json.dumps({"op": "state_command", "command": "enable"}))
        for _ in range(8):
            await commander.send(json.dumps({"op": "servo_cv", "linear": [0, 0, 0.02]}))
            state = await told(commander, "state")
        assert state["measured_cp"]["position"][2] > 1e-4

    at = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-tube.curved_length for tube in THESIS.tubes])
    run(talk, of=CrtkRobot(Servo(THESIS, at)))


def test_what_is_no_number_or_word_is_answered() -> None:
    arm = enabled()
    place, joints = [0.0, 0.0, 0.1], {"rotations": [0, 1, 2], "translations": [-0.05, -0.03, -0.02]}
    for message in (
        {"op": "state_command", "command": ["enable"]},
        {"op": "state_command", "command": {"enable": 1}},
        {"op": "state_command", "command": True},
        {"op": "state_command"},
        {"op": ["servo_cp"], "position": place},
        {"op": "servo_cp", "position": [True, False, True]},
        {"op": "servo_cp", "position": ["0", "0", "0.1"]},
        {"op": "servo_cp", "position": "0.1"},
        {"op": "servo_cp", "position": [[0.0, 0.0, 0.1]]},
        {"op": "servo_cp", "position": [None, 0, 0]},
        {"op": "servo_cp", "position": [10**400, 0, 0]},
        {"op": "servo_cp", "position": place, "direction": [1e-320, 0, True]},
        {"op": "servo_cv", "linear": [1, 2, False]},
        {"op": "move_jp", **joints, "rotations": [0, 1, True]},
        {"op": "move_jp", **joints, "rotations": [0, 1, "2"]},
    ):
        with pytest.raises(InputError) as refused:
            arm.command(message, 0.0)
        assert str(refused.value)
    assert arm.state == "ENABLED"
    assert not arm.busy


@pytest.mark.parametrize("fast", [False, pytest.param(True, marks=NEEDS_COMPILER)])
def test_no_joint_moves_faster_than_its_rate_in_the_time_that_passed(fast: bool) -> None:
    """Periods that are late and early, and steps that take more or less time: what was sent, over when."""
    arm = CrtkRobot(servo_of(THESIS, SEED) if fast else Servo(THESIS, SEED))
    arm.command({"op": "state_command", "command": "enable"}, 0.0)
    options, random, period = arm.servo.options, np.random.default_rng(1), 1e-3
    now = due = 0.0
    times, joints = [], []
    for k in range(1500):
        far = 1.0 if k // 500 % 2 == 0 else -1.0
        message = {"op": "servo_jp", "rotations": [far, 1 + far, 2 - far], "translations": [-0.05 - far * 0.02] * 3}
        if k % 3 == 0:
            message = {"op": "servo_cp", "position": [0.03 * far, 0.02, 0.12]}
        arm.command(message, now)
        late = random.choice([0.0, 1e-5, 4e-4, 9e-4, 3e-3], p=[0.4, 0.3, 0.15, 0.1, 0.05])
        takes = random.choice([2e-5, 1e-4, 7e-4], p=[0.4, 0.4, 0.2])
        begun = now = max(due + late, now)
        due = max(due + period, now)
        reads = iter([begun, *(begun + takes * (j + 1) for j in range(5))])
        last: list[float] = []

        def clock(reads: Any = reads, last: list[float] = last) -> float:
            last.append(next(reads))
            return last[-1]

        before = arm.sent
        arm.tick(clock, period)
        now = max(now, last[-1])
        if arm.sent != before:
            assert arm.sent == last[-1]
            times.append(arm.sent)
            joints.append(np.concatenate([arm.servo.equilibrium.rotations, arm.servo.equilibrium.translations]))
    rates = np.abs(np.diff(joints, axis=0)) / np.diff(times)[:, None]
    most = np.repeat([options.turn_rate, options.shift_rate], 3)
    assert len(times) > 1000
    assert (rates <= most * (1 + 1e-9)).all(), (rates / most).max()
    assert (rates / most).max() > 0.99


def test_a_client_that_leaves_before_it_is_welcome_leaves_room_for_a_commander() -> None:
    async def talk(server: RobotServer) -> None:
        for _ in range(20):
            gone = await client(server)
            gone.transport.abort()
        await asyncio.sleep(0.2)
        assert (await told(await client(server), "welcome"))["role"] == "commander"

    run(talk)


def test_a_role_that_does_not_exist_is_refused_with_those_that_do() -> None:
    async def talk(server: RobotServer) -> None:
        for role in ("commandar", None, ["watcher"]):
            socket = await websockets.connect(f"ws://127.0.0.1:{server.port}", compression=None)
            CONNECTED.append(socket)
            await socket.send(json.dumps({"op": "hello", "token": server.token, "role": role}))
            with pytest.raises(websockets.ConnectionClosed, match="it must be commander or watcher"):
                await told(socket, "welcome")

    run(talk)


def test_a_client_that_is_no_websocket_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    async def talk(server: RobotServer) -> None:
        for greeting in (b"\x16\x03\x01\x02", b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n", b""):
            _, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(greeting)
            writer.close()
            await writer.wait_closed()
        await asyncio.sleep(0.1)
        assert (await told(await client(server), "welcome"))["role"] == "commander"

    run(talk)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("kind", ["servo_jp", "move_jp"])
def test_joint_values_out_of_order_are_refused_where_they_are_commanded(kind: str) -> None:
    arm, before = enabled(), tip(enabled())
    for translations in ([0.0, -0.08, -0.02], [-0.1, -0.03, -0.02]):
        with pytest.raises(InputError, match=r"joint values are out of range: .*mm"):
            arm.command({"op": kind, "rotations": [0.0] * 3, "translations": translations}, 0.0)
    assert not arm.busy
    tick(arm, 0.001)
    assert np.array_equal(tip(arm), before)


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        (None, True),
        ("http://localhost:8000", True),
        ("http://127.0.0.1", True),
        ("https://example.org", False),
        ("http://localhost.example.org", False),
        ("null", False),
    ],
)
def test_a_page_of_another_machine_cannot_connect(origin: str | None, allowed: bool) -> None:
    async def talk(server: RobotServer) -> None:
        socket = await websockets.connect(f"ws://127.0.0.1:{server.port}", compression=None, origin=origin)
        await socket.close()

    if allowed:
        run(talk)
    else:
        with pytest.raises(websockets.InvalidStatus, match="403"):
            run(talk)


@pytest.mark.parametrize("kind", ["python", "c"])
def test_a_robot_goes_on_from_where_its_drives_are(kind: str) -> None:
    if kind == "c" and compiler() is None:
        pytest.skip("no C compiler")
    made = Servo(THESIS, SEED) if kind == "python" else servo_of(THESIS, (SEED.rotations, SEED.translations))
    assert isinstance(made, Servo) == (kind == "python")
    arm, clock = CrtkRobot(made), iter(np.arange(10_000) * 5e-4)
    there = {
        "rotations": (SEED.rotations + np.array([0.4, 0.1, -0.2])).tolist(),
        "translations": SEED.translations.tolist(),
    }
    known = forward_kinematics(THESIS, there["rotations"], SEED.translations, start=SEED)
    arm.command({"op": "set_js", **there}, 0.0)
    assert arm.servo.equilibrium.rotations == pytest.approx(there["rotations"], abs=1e-12)
    assert tip(arm) == pytest.approx(known.tip_position, abs=1e-9)
    for rotations, words in (([1.0, 2.0], "rotations has 2"), ([9.0, 0.0, 0.0], "rotations of tube 1 is 9 rad")):
        with pytest.raises(InputError, match=words):
            arm.command({"op": "set_js", "rotations": rotations, "translations": there["translations"]}, 0.0)
    assert tip(arm) == pytest.approx(known.tip_position, abs=1e-9)
    arm.command({"op": "state_command", "command": "enable"}, 0.0)
    with pytest.raises(InputError, match="set_js is rejected: the robot is ENABLED; disable it first"):
        arm.command({"op": "set_js", **there}, 0.0)
    goal = tip(arm) + np.array([1e-3, 0.0, 0.0])
    arm.command({"op": "move_cp", "position": goal.tolist()}, 0.0)
    for _ in range(300):
        arm.tick(lambda: float(next(clock)), 1e-3)
    assert tip(arm) == pytest.approx(goal, abs=1e-6)


def test_set_js_beyond_a_snap_is_refused() -> None:
    """A straight motion that snaps does not tell where the tubes are."""
    start, beyond = ([0.0, 0.0, 0.0], THESIS.home_translations), ([6.2, 0.0, 0.0], THESIS.home_translations)
    assert find_snap(THESIS, start, beyond) is not None
    arm = CrtkRobot(Servo(THESIS, start))
    with pytest.raises(InputError, match="set_js is rejected"):
        arm.command({"op": "set_js", "rotations": beyond[0], "translations": list(beyond[1])}, 0.0)
    assert arm.servo.equilibrium.rotations == pytest.approx([0.0, 0.0, 0.0])


@pytest.mark.parametrize("word", [None, 1, ["enable"], {"enable": True}, "ENABLE", float("nan")])
def test_a_state_command_of_a_wrong_type_is_answered(word: Any) -> None:
    async def talk(server: RobotServer) -> None:
        commander = await client(server)
        await commander.send(json.dumps({"op": "state_command", "command": word}))
        assert "command is" in (await told(commander, "error"))["words"]

    assert run(talk).robot.state == "DISABLED"
