"""The node for ROS 2, on messages that stand for those of ROS."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import os
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.control import ros_loopback
from tests.examples import THESIS
from tubeopt import Load, forward_kinematics
from tubeopt.control.c_library import robot_description, tube_links
from tubeopt.control.crtk import COMMANDS
from tubeopt.solvers.compiled.library import compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

PACKAGE = Path("integrations/ros2/tubeopt_ros")

TICK = 5e-4
"""Seconds from one reading of the clock to the next."""

SEED = [0.0, 1.0, 2.0, -0.05, -0.03, -0.02]


class Robot:
    """An active node, and what was heard of it."""

    def __init__(self, module: Any, bus: ros_loopback.Bus, **parameters: Any) -> None:
        ros_loopback.Node.parameters = {"rotations": SEED[:3], "translations": SEED[3:], **parameters}
        self.module, self.bus, self.told = module, bus, bus.last
        self.node = module.RobotNode()
        assert self.node.trigger_configure() == "success", self.node.logged
        self.node.trigger_activate()
        self.robot = self.node.robot

    @property
    def warned(self) -> list[str]:
        return list(self.node.logged)

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.node.tick()

    def send(self, op: str, message: Any) -> None:
        self.bus.calls[op][0](message)

    def order(self, word: str) -> None:
        kind = self.bus.types["state_command"]
        self.send("state_command", kind(**{next(reversed(kind.fields)): word}))


def imported(patch: pytest.MonkeyPatch) -> Any:
    """The package of the node, on the modules in place."""
    patch.syspath_prepend(str(PACKAGE))
    return importlib.import_module("tubeopt_ros.node")


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Any:
    bus = ros_loopback.install(monkeypatch, crtk=getattr(request, "param", False))
    module = imported(monkeypatch)
    # A clock of the test: on a busy machine the real one lets commands grow old.
    ticks = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: next(ticks) * TICK, thread_time=time.thread_time, sleep=lambda _: None)
    monkeypatch.setattr(module, "time", clock)
    return lambda **parameters: Robot(module, bus, **parameters)


@pytest.fixture
def robot(make: Any) -> Robot:
    active: Robot = make()
    return active


def pose(of: Robot, **place: Any) -> Any:
    """A message with a position, and no orientation."""
    message = of.module.PoseStamped()
    for name, value in {"x": 0.0, "y": 0.0, "z": 0.1, **place}.items():
        setattr(message.pose.position, name, value)
    message.pose.orientation.w = 0.0
    return message


def test_the_node_is_led_and_tells_where_it_is(robot: Robot) -> None:
    node = robot.module
    robot.tick()
    start = robot.told["measured_cp"].pose.position
    place = np.array([start.x, start.y, start.z])
    target = pose(robot, x=start.x + 1e-3, y=start.y, z=start.z)
    robot.send("servo_cp", target)
    assert "enable it first" in robot.warned[-1]
    assert robot.bus.log[-1] == ("error", robot.warned[-1])
    robot.order("enable")
    for _ in range(60):
        robot.send("servo_cp", target)
        robot.tick()
    assert robot.bus.log[-1] == ("status", "ENABLED, homed")
    there = robot.told["setpoint_cp"].pose
    assert there.position.x == pytest.approx(place[0] + 1e-3, abs=1e-6)
    assert robot.told["operating_state"].data == "ENABLED"
    assert 0 < robot.told["margin"].data <= 1
    # The quaternion turns z to where the tip points.
    q, ahead = there.orientation, robot.robot.servo.equilibrium.tip_rotation[:, 2]
    assert robot.node._reader.cp(robot.told["setpoint_cp"])["direction"] == pytest.approx(ahead, abs=1e-12)
    assert q.w**2 + q.x**2 + q.y**2 + q.z**2 == pytest.approx(1)
    back = node.JointState(name=robot.told["setpoint_js"].name, position=SEED)
    for _ in range(100):
        robot.send("servo_jp", back)
        robot.tick()
    assert robot.told["measured_js"].position == pytest.approx(back.position, abs=1e-12)
    robot.send("servo_jp", node.JointState(name=["elbow"], position=[1.0]))
    assert "servo_jp is refused: name is elbow" in robot.warned[-1]
    # Velocities: of the joints, and of the tip as it is measured.
    velocities = [0.2, 0.0, 0.0, 0.0, 0.0, -0.01]
    for _ in range(20):
        robot.send("servo_jv", node.JointState(velocity=velocities))
        robot.tick()
    assert robot.told["measured_js"].velocity == pytest.approx(velocities, abs=1e-9)
    message = node.TwistStamped()
    message.twist.linear.x, message.twist.angular.y = 0.01, 0.02
    for _ in range(20):
        robot.send("servo_cv", message)
        robot.tick()
    v, w = robot.told["measured_cv"].twist.linear, robot.told["measured_cv"].twist.angular
    assert [v.x, v.y, v.z] == pytest.approx([0.01, 0.0, 0.0], abs=5e-4)
    ahead = robot.robot.servo.equilibrium.tip_rotation[:, 2]
    assert np.cross([w.x, w.y, w.z], ahead) == pytest.approx(np.cross([0.0, 0.02, 0.0], ahead), abs=5e-3)


def test_a_sensor_at_the_tip_tells_the_force_there(robot: Robot) -> None:
    force = np.array([1e-4, -2e-4, 5e-5])
    pushed = forward_kinematics(THESIS, SEED[:3], SEED[3:], load=Load(force=tuple(force)))
    robot.send("sensor_cp", pose(robot, **dict(zip("xyz", pushed.tip_position.tolist(), strict=True))))
    told = robot.told["measured_cf"].wrench.force
    # To first order in the force, which bends the arm by 40 um.
    assert np.linalg.norm([told.x, told.y, told.z] - force) < 0.05 * np.linalg.norm(force)


def test_a_client_of_crtk_names_no_joints(robot: Robot) -> None:
    robot.order("enable")
    there = [0.01, 1.0, 2.0, -0.05, -0.03, -0.0201]
    for _ in range(60):
        robot.send("servo_jp", robot.module.JointState(position=there))
        robot.tick()
    assert not robot.warned
    assert robot.told["measured_js"].position == pytest.approx(there, abs=1e-12)


def test_a_relative_pose_moves_and_turns_the_tip_from_where_it_is(robot: Robot) -> None:
    robot.order("enable")
    before = robot.robot.servo.equilibrium
    turn = Rotation.from_rotvec([0.01, -0.02, 0.0])
    message = pose(robot, x=1e-4, y=0.0, z=-1e-4)
    q = message.pose.orientation
    q.x, q.y, q.z, q.w = (-float(part) for part in turn.as_quat())  # of either sign
    robot.send("move_cr", message)
    robot.tick(400)
    after = robot.robot.servo.equilibrium
    assert after.tip_position - before.tip_position == pytest.approx([1e-4, 0.0, -1e-4], abs=2e-6)
    assert after.tip_rotation[:, 2] == pytest.approx(turn.apply(before.tip_rotation[:, 2]), abs=1e-5)
    assert not robot.warned


def test_without_directions_only_positions_count(make: Any) -> None:
    robot = make(directions=False)
    message = pose(robot)
    message.pose.orientation.w = 1.0
    assert robot.node._reader.cp(message)["direction"] is None
    assert robot.node._reader.cr(message)["turn"] is None
    assert robot.node._reader.cv(robot.module.TwistStamped())["angular"] is None


def test_no_message_ends_the_node(robot: Robot) -> None:
    node = robot.module
    robot.order("enable")
    nan, names = float("nan"), robot.robot.report(0.0)["setpoint_js"]["name"]
    state, whole = node.JointState, SEED

    elsewhere = pose(robot)
    elsewhere.header.frame_id = "camera"
    turned = pose(robot)
    turned.pose.orientation.w = nan
    far, spun = node.TwistStamped(), node.TwistStamped()
    far.twist.linear.x, spun.twist.angular.x = 1e308, nan
    for op, message, words in (
        ("servo_jp", state(), "position has 0 numbers; it must have 6"),
        ("servo_jp", state(position=[1.0]), "position has 1 numbers"),
        ("servo_jp", state(position=[nan] * 6), "finite"),
        ("servo_jp", state(position=[1e308] * 6), "rotations of tube 1 is 1e+308 rad"),
        ("servo_jp", state(name=names, position=whole[:5]), "position has 5 numbers"),
        ("servo_jp", state(name=names[:5], position=whole), "name is rotation_1"),
        ("move_jp", state(name=["elbow"] * 6, position=whole), "name is elbow"),
        ("move_jp", state(name=[names[0]] * 6, position=whole), "each of rotation_1"),
        ("servo_cp", pose(robot, x=nan), "finite"),
        ("servo_cp", pose(robot, x=1e308), "at most"),
        ("servo_cp", elsewhere, "frame_id is 'camera'"),
        ("move_cp", turned, "finite"),
        ("servo_cr", turned, "finite"),
        ("servo_cv", far, "at most 1e+06"),
        ("servo_cv", spun, "angular is"),
        ("servo_jv", state(position=whole), "velocity has 0 numbers"),
        ("servo_jv", state(velocity=[1e9] * 6), "at most 1e+06"),
        ("state_command", node.String(data=""), "command is ''"),
        ("state_command", node.String(data="fly"), "command is 'fly'"),
    ):
        count = len(robot.warned)
        robot.send(op, message)
        robot.tick()
        assert len(robot.warned) == count + 1, op
        assert robot.warned[-1].startswith(f"{op} is refused: ")
        assert words in robot.warned[-1], robot.warned[-1]
        assert robot.told["measured_js"].position == whole
    for message in (pose(robot, x=nan), pose(robot, x=50.0), elsewhere):
        robot.send("sensor_cp", message)
        assert robot.warned[-1].startswith("sensor_cp is refused: ")
    robot.send("servo_jp", SimpleNamespace())  # no message at all
    assert "the robot stopped: AttributeError" in robot.warned[-1]
    robot.tick()
    assert "AttributeError" in robot.told["why"].data
    assert robot.told["operating_state"].data == "FAULT"


def test_a_step_that_fails_stops_the_robot_and_the_node_goes_on(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.order("enable")

    def fail(*_: Any) -> None:
        raise RuntimeError("of CasADi")

    move = robot.module.JointState(position=[*SEED[:5], -0.0201])
    with monkeypatch.context() as broken:
        broken.setattr(robot.robot.servo, "step", fail)
        robot.send("move_jp", move)
        robot.tick()
    assert "the robot stopped: RuntimeError in a step: of CasADi" in robot.told["why"].data
    assert robot.bus.log[-1] == ("error", robot.told["why"].data)
    robot.send("move_jp", move)
    assert "the robot is FAULT; enable it first" in robot.warned[-1]
    robot.order("enable")
    robot.send("move_jp", move)
    robot.tick(10)
    assert robot.told["measured_js"].position[5] == pytest.approx(-0.0201, abs=1e-6)


@pytest.mark.parametrize("make", [True], indirect=True)
def test_messages_of_crtk_are_used_where_installed(robot: Robot) -> None:
    robot.tick()
    state = robot.told["operating_state"]
    assert (state.state, state.is_homed, state.is_busy) == ("DISABLED", True, False)
    assert state.header.stamp.nanoseconds > 0
    robot.order("enable")
    turn = [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]
    robot.send("move_jr", robot.module.JointState(position=turn))
    robot.tick()
    assert robot.told["operating_state"].is_busy
    robot.tick(50)
    assert robot.told["measured_js"].position == pytest.approx(np.add(SEED, turn), abs=1e-6)
    robot.send("hold", robot.module.Empty())
    assert robot.robot.report(0.0)["why"] == "stopped by command"
    assert not robot.warned
    # Services say what comes of a state command.
    robot.send("move_jr", robot.module.JointState(position=turn))
    robot.tick()
    assert robot.told["goal_js"].position == pytest.approx(np.add(SEED, np.multiply(2, turn)), abs=1e-6)
    assert robot.bus.services["hold"]().success
    robot.tick()
    assert robot.told["goal_js"].position == robot.told["setpoint_js"].position
    assert robot.bus.services["pause"]().message == "PAUSED"
    refused = robot.bus.services["enable"]()
    assert not refused.success
    assert "enable is rejected: the robot is PAUSED" in refused.message
    robot.tick(25)  # once in 25 ticks
    assert robot.told["snap_distance"].data > 0.1


def test_the_node_moves_only_while_it_is_active(make: Any) -> None:
    robot = make(turn_acceleration=30.0, shift_acceleration=1.0)
    robot.order("enable")
    far = robot.module.JointState(position=[1.0, *SEED[1:]])
    robot.send("move_jp", far)
    robot.tick(50)
    before = robot.robot.servo.equilibrium.rotations[0]
    assert robot.robot.servo.moving
    robot.node.on_deactivate(None)
    # It has braked, from 1.5 rad/s at 30 rad/s^2, and is disabled.
    assert not robot.robot.servo.moving
    assert robot.robot.servo.equilibrium.rotations[0] > before
    assert robot.robot.state == "DISABLED"
    assert robot.node.timers == []
    robot.send("move_jp", far)
    assert "the node is not active" in robot.warned[-1]
    robot.node.trigger_activate()
    robot.order("enable")
    robot.send("move_jp", far)
    robot.tick(350)
    assert robot.robot.servo.equilibrium.rotations[0] == pytest.approx(1.0, abs=1e-6)
    robot.node.on_deactivate(None)
    assert robot.node.on_cleanup(None) == "success"
    for wrong in ({"robot": "no_such_robot"}, {"translations": [0.0, 9.0, 0.0]}, {"rate": 0.0}, {"min_margin": 2.0}):
        ros_loopback.Node.parameters = {"rotations": SEED[:3], "translations": SEED[3:], **wrong}
        node = robot.module.RobotNode()
        assert node.trigger_configure() == "failure"
        assert "the robot cannot be configured: " in node.logged[-1]


def test_frames_markers_diagnostics_and_jacobian_are_those_of_the_arm(make: Any) -> None:
    robot = make(frame_prefix="left_")
    robot.tick()
    arm = forward_kinematics(THESIS, SEED[:3], SEED[3:])
    frames = robot.node.frames
    tip = frames["left_tip"]
    assert tip.header.frame_id == "left_plate"
    moved = tip.transform.translation
    assert [moved.x, moved.y, moved.z] == pytest.approx(arm.tip_position, abs=1e-9)
    # Links join end to end along their z axes, from the carriage to the end of their tube.
    ends: dict[int, list[np.ndarray]] = {}
    for link in tube_links(THESIS):
        at = frames[f"left_{link.name}"].transform
        q = [getattr(at.rotation, name) for name in "xyzw"]
        axis = Rotation.from_quat(q).apply([0.0, 0.0, (link.end - link.start) / 2])
        middle = np.array([at.translation.x, at.translation.y, at.translation.z])
        ends.setdefault(link.tube, []).extend([middle - axis, middle + axis])
    for i, points in ends.items():
        assert points[0] == pytest.approx([0.0, 0.0, SEED[3 + i] - THESIS.tubes[i].straight_length], abs=1e-9)
        gaps = np.linalg.norm(np.array(points[1:-1:2]) - np.array(points[2::2]), axis=1)
        assert gaps.max() < 1e-4
    assert ends[0][-1] == pytest.approx(arm.tip_position, abs=1e-4)
    lines = robot.told["shape"].markers
    assert [line.scale.x for line in lines] == [tube.outer_diameter for tube in THESIS.tubes]
    last = lines[0].points[-1]
    assert [last.x, last.y, last.z] == pytest.approx(arm.tip_position, abs=1e-9)
    status = robot.told["diagnostics"].status[0]
    assert status.level == b"\0"
    assert {entry.key: entry.value for entry in status.values}["state"] == "DISABLED"
    layout = [each.size for each in robot.told["jacobian"].layout.dim]
    by_joints = np.reshape(robot.told["jacobian"].data, layout)
    step = 1e-6
    ahead = forward_kinematics(THESIS, [step, 1.0, 2.0], SEED[3:])
    assert by_joints[:3, 0] == pytest.approx((ahead.tip_position - arm.tip_position) / step, abs=1e-6)
    skew = (ahead.tip_rotation - arm.tip_rotation) @ arm.tip_rotation.T / step
    assert by_joints[3:, 0] == pytest.approx([skew[2, 1], skew[0, 2], skew[1, 0]], abs=1e-5)
    robot.robot.fault("for the test")
    robot.tick(600)
    assert robot.told["diagnostics"].status[0].level == b"\2"


def test_the_description_has_the_joints_of_the_node_and_the_links_of_the_tubes(robot: Robot) -> None:
    root = ElementTree.fromstring(robot_description(THESIS))
    robot.tick()
    joints = {joint.get("name", ""): joint for joint in root.iter("joint") if joint.get("type")}
    moving = {name: joint for name, joint in joints.items() if joint.get("type") != "floating"}
    assert sorted(moving) == sorted(robot.told["measured_js"].name)
    links = [link.get("name", "") for link in root.findall("link")]
    child_of = {name: getattr(joint.find("child"), "attrib", {})["link"] for name, joint in joints.items()}
    assert sorted([*child_of.values(), "plate"]) == sorted(links)  # a tree
    floating = {child for name, child in child_of.items() if name not in moving}
    assert floating == set(robot.node.frames)
    for i, tube in enumerate(THESIS.tubes):
        carriage = moving[f"translation_{i + 1}"]
        origin, limit = carriage.find("origin"), carriage.find("limit")
        assert origin is not None
        assert limit is not None
        assert origin.get("xyz") == f"0 0 {-tube.straight_length:.9g}"
        assert [float(limit.get(end, "nan")) for end in ("lower", "upper")] == list(THESIS.limits.translations[i])
        total = sum(
            float(shape.get("length", "nan"))
            for link in root.iter("link")
            if link.get("name", "").startswith(f"tube_{i + 1}_")
            for shape in link.findall("collision/geometry/cylinder")
        )
        assert total == pytest.approx(tube.length, abs=1e-8)
    declared = [joint.get("name") for joint in root.findall("ros2_control/joint")]
    assert declared == robot.told["measured_js"].name


class Client:
    """What a client of CRTK offers: filled in by its library."""


@pytest.fixture
def crtk_client(monkeypatch: pytest.MonkeyPatch) -> Any:
    """`crtk_python_client` of the Collaborative Robotics Toolkit, where it is installed or TUBEOPT_CRTK_CLIENT has the
    folder of its sources; it is on no package index."""
    bus = ros_loopback.install(monkeypatch, crtk=True)
    monkeypatch.setenv("ROS_VERSION", "2")
    if folder := os.environ.get("TUBEOPT_CRTK_CLIENT"):
        monkeypatch.syspath_prepend(folder)
    if importlib.util.find_spec("crtk") is None:
        pytest.skip("crtk_python_client is not installed")
    library = importlib.import_module("crtk")
    if not hasattr(library, "ral"):
        pytest.skip("another package is called crtk")
    return SimpleNamespace(library=library, bus=bus)


def test_the_client_library_of_crtk_leads_the_node(crtk_client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot(imported(monkeypatch), crtk_client.bus)
    stopped, lock = threading.Event(), threading.Lock()

    def loop() -> None:
        while not stopped.is_set():
            with lock:
                robot.node.tick()
            time.sleep(2e-3)

    client, ral = Client(), crtk_client.library.ral("test")
    tools = crtk_client.library.utils(client, ral, connection_timeout=5.0)
    for name in (
        "operating_state", "setpoint_js", "setpoint_cp", "measured_js", "measured_cp", "measured_cv", "jacobian",
        "hold", "free", "servo_jp", "servo_jr", "servo_cp", "servo_cv", "move_jp", "move_jr", "move_cp",
    ):  # fmt: skip
        getattr(tools, f"add_{name}")()
    ral.check_connections(5.0)
    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    c: Any = client
    try:
        assert c.enable(10.0)
        assert c.unhome(10.0)
        assert not c.is_homed()
        assert c.home(10.0)
        start, turn = np.array(SEED), np.eye(6)[0] * 0.05
        assert c.measured_jp(wait_timeout=5.0)[0] == pytest.approx(start, abs=1e-9)
        assert c.move_jp(start + turn).wait(timeout=20.0)
        assert c.setpoint_jp()[0] == pytest.approx(start + turn, abs=1e-6)
        assert c.move_jp(c.setpoint_jp()[0]).wait(timeout=20.0)  # a move that ends at once
        assert c.move_jr(-turn).wait(timeout=20.0)
        assert c.measured_jp()[0] == pytest.approx(start, abs=3e-6)
        goal = c.setpoint_cp()[0]
        goal.p[0] += 5e-4
        assert c.move_cp(goal).wait(timeout=20.0)
        reached = c.measured_cp()[0]
        assert reached.p == pytest.approx(goal.p, abs=2e-6)
        assert reached.M.own.apply([0, 0, 1]) == pytest.approx(goal.M.own.apply([0, 0, 1]), abs=2e-6)
        assert c.jacobian(wait_timeout=5.0)[0].shape == (6, 6)
        for _ in range(200):
            c.servo_cv(np.array([0.01, 0, 0, 0, 0, 0]))
            time.sleep(2e-3)
            if c.measured_cv()[0][0] > 5e-3:
                break
        assert c.measured_cv()[0][0] == pytest.approx(0.01, abs=5e-3)
        c.hold()
        c.servo_jp(c.setpoint_jp()[0])
        c.servo_jr(np.zeros(6))
        c.servo_cp(c.setpoint_cp()[0])
        with lock:
            assert not robot.warned
        c.free()
        assert c.wait_for_operating_state("ENABLED", 5.0)
        assert c.disable(10.0)
    finally:
        stopped.set()
        thread.join()


def test_every_command_has_a_topic_of_its_type(robot: Robot) -> None:
    kinds = dict.fromkeys(["jp", "jr", "jv", "js"], "JointState") | {"cp": "PoseStamped", "cr": "PoseStamped"}
    kinds |= {"cv": "TwistStamped", "hold": "Empty", "free": "Empty", "state_command": "String"}
    for op in COMMANDS:
        assert robot.bus.types[op].__name__ == (kinds.get(op) or kinds[op[-2:]])
