"""The node for ROS 2, on messages that stand for those of ROS."""

from __future__ import annotations

import importlib
import itertools
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import Load, forward_kinematics
from tubeopt.solvers.compiled.library import compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

PACKAGE = Path("integrations/ros2/tubeopt_ros")

TICK = 5e-4
"""Seconds from one reading of the clock to the next."""


class Message:
    """Fields of a message: those that are named, else as the kinds below have them."""

    fields: ClassVar[dict[str, Any]] = {}

    def __init__(self, **given: Any) -> None:
        for name, make in self.fields.items():
            setattr(self, name, make())
        vars(self).update(given)


def kind(called: str, /, **fields: Any) -> type[Message]:
    return type(called, (Message,), {"fields": fields})


def numbers(names: str) -> Any:
    return lambda: SimpleNamespace(**dict.fromkeys(names, 0.0))


def header() -> SimpleNamespace:
    return SimpleNamespace(stamp=None, frame_id="")


CRTK_MESSAGES = {
    "crtk_msgs.msg": [
        kind("OperatingState", header=header, state=str, is_homed=bool, is_busy=bool),
        kind("StringStamped", header=header, string=str),
    ]
}


class Node:
    """What the node asks of rclpy."""

    def __init__(self, name: str) -> None:
        self.heard: dict[str, Any] = {}
        self.told: dict[str, Any] = {}
        self.warned: list[str] = []

    def declare_parameter(self, name: str, value: Any) -> None:
        pass

    def get_parameter(self, name: str) -> SimpleNamespace:
        known = {
            "robot": "configs/robots/thesis_ctr.yaml",
            "rotations": [0.0, 1.0, 2.0],
            "translations": [-0.05, -0.03, -0.02],
            "rate": 500.0,
        }
        return SimpleNamespace(value=known[name])

    def create_subscription(self, of: Any, name: str, hear: Any, depth: int) -> None:
        self.heard[name] = hear

    def create_publisher(self, of: Any, name: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=lambda message: self.told.__setitem__(name, message))

    def create_timer(self, period: float, call: Any) -> None:
        pass

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.warned.append)


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Any]:
    pose = lambda: SimpleNamespace(position=numbers("xyz")(), orientation=numbers("wxyz")())  # noqa: E731
    wrench = lambda: SimpleNamespace(force=numbers("xyz")(), torque=numbers("xyz")())  # noqa: E731
    twist = lambda: SimpleNamespace(linear=numbers("xyz")())  # noqa: E731
    kinds = {
        "geometry_msgs.msg": [
            kind("PoseStamped", header=header, pose=pose),
            kind("TwistStamped", twist=twist),
            kind("WrenchStamped", header=header, wrench=wrench),
        ],
        "sensor_msgs.msg": [kind("JointState", header=header, name=list, position=list, velocity=list)],
        "std_msgs.msg": [kind("Empty"), kind("Float64", data=float), kind("String", data=str)],
        **(CRTK_MESSAGES if getattr(request, "param", False) else {}),
        "rclpy.node": [Node],
        "rclpy": [],
    }
    for name, classes in kinds.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, each.__name__, each)
        monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.setitem(sys.modules, name.split(".")[0], sys.modules.get(name.split(".")[0], module))
    monkeypatch.syspath_prepend(str(PACKAGE))
    imported = importlib.import_module("tubeopt_ros.node")
    # A clock of the test: on a busy machine the real one lets commands grow old.
    ticks = itertools.count()
    monkeypatch.setattr(imported, "time", SimpleNamespace(monotonic=lambda: next(ticks) * TICK))
    yield imported
    sys.modules.pop("tubeopt_ros.node")


def test_the_node_is_led_and_tells_where_it_is(node: Any) -> None:
    robot = node.RobotNode()
    robot.tick()
    start = robot.told["measured_cp"].pose.position
    place = np.array([start.x, start.y, start.z])
    target = node.PoseStamped()
    target.pose.position = SimpleNamespace(x=start.x + 1e-3, y=start.y, z=start.z)
    robot.heard["servo_cp"](target)
    assert "enable it first" in robot.warned[-1]
    robot.heard["state_command"](node.String(data="enable"))
    for _ in range(60):
        robot.heard["servo_cp"](target)
        robot.tick()
    there = robot.told["setpoint_cp"].pose
    assert there.position.x == pytest.approx(place[0] + 1e-3, abs=1e-6)
    assert robot.told["operating_state"].data == "ENABLED"
    assert 0 < robot.told["margin"].data <= 1
    # The quaternion turns z to where the tip points.
    q, ahead = there.orientation, robot.robot.servo.equilibrium.tip_rotation[:, 2]
    assert node._pose(robot.told["setpoint_cp"])["direction"] == pytest.approx(ahead, abs=1e-12)
    assert q.w**2 + q.x**2 + q.y**2 + q.z**2 == pytest.approx(1)
    joints = robot.told["setpoint_js"]
    back = node.JointState(name=joints.name, position=[0.0, 1.0, 2.0, -0.05, -0.03, -0.02])
    for _ in range(100):
        robot.heard["servo_jp"](back)
        robot.tick()
    assert robot.told["measured_js"].position == pytest.approx(back.position, abs=1e-12)
    robot.heard["servo_cv"](node.TwistStamped())
    robot.heard["servo_jp"](node.JointState(name=["elbow"], position=[1.0]))
    assert "servo_jp is refused: name is elbow" in robot.warned[-1]


def test_a_sensor_at_the_tip_tells_the_force_there(node: Any) -> None:
    robot = node.RobotNode()
    force = np.array([1e-4, -2e-4, 5e-5])
    pushed = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-0.05, -0.03, -0.02], load=Load(force=tuple(force)))
    seen = node.PoseStamped()
    seen.pose.position = SimpleNamespace(**dict(zip("xyz", pushed.tip_position.tolist(), strict=True)))
    robot.heard["sensor_cp"](seen)
    told = robot.told["measured_cf"].wrench.force
    # To first order in the force, which bends the arm by 40 um.
    assert np.linalg.norm([told.x, told.y, told.z] - force) < 0.05 * np.linalg.norm(force)


def test_a_client_of_crtk_names_no_joints(node: Any) -> None:
    robot = node.RobotNode()
    robot.heard["state_command"](node.String(data="enable"))
    there = [0.01, 1.0, 2.0, -0.05, -0.03, -0.0201]
    for _ in range(60):
        robot.heard["servo_jp"](node.JointState(position=there))
        time.sleep(1e-3)
        robot.tick()
    assert not robot.warned
    robot.tick()
    assert robot.told["measured_js"].position == pytest.approx(there, abs=1e-12)


def test_no_message_ends_the_node(node: Any) -> None:
    robot = node.RobotNode()
    robot.heard["state_command"](node.String(data="enable"))
    nan, names = float("nan"), robot.robot.report(0.0)["setpoint_js"]["name"]
    state, whole = node.JointState, [0.0, 1.0, 2.0, -0.05, -0.03, -0.02]

    def pose(**place: Any) -> Any:
        message = node.PoseStamped()
        message.pose.position = SimpleNamespace(**{"x": 0.0, "y": 0.0, "z": 0.1, **place})
        return message

    elsewhere = pose()
    elsewhere.header.frame_id = "camera"
    turned = pose()
    turned.pose.orientation = SimpleNamespace(w=nan, x=0.0, y=0.0, z=1.0)
    far = node.TwistStamped()
    far.twist.linear = SimpleNamespace(x=1e308, y=0.0, z=0.0)
    for op, message, words in (
        ("servo_jp", state(), "position has 0 numbers; it must have 6"),
        ("servo_jp", state(position=[1.0]), "position has 1 numbers"),
        ("servo_jp", state(position=[nan] * 6), "finite"),
        ("servo_jp", state(position=[1e308] * 6), "rotations of tube 1 is 1e+308 rad"),
        ("servo_jp", state(name=names, position=whole[:5]), "position has 5 numbers"),
        ("servo_jp", state(name=names[:5], position=whole), "name is rotation_1"),
        ("move_jp", state(name=["elbow"] * 6, position=whole), "name is elbow"),
        ("move_jp", state(name=[names[0]] * 6, position=whole), "each of rotation_1"),
        ("servo_cp", pose(x=nan), "finite"),
        ("servo_cp", pose(x=1e308), "at most"),
        ("servo_cp", elsewhere, "frame_id is 'camera'"),
        ("move_cp", turned, "finite"),
        ("servo_cv", far, "at most 1e+06"),
        ("state_command", node.String(data=""), "command is ''"),
        ("state_command", node.String(data="fly"), "command is 'fly'"),
    ):
        count = len(robot.warned)
        robot.heard[op](message)
        robot.tick()
        assert len(robot.warned) == count + 1, op
        assert robot.warned[-1].startswith(f"{op} is refused: ")
        assert words in robot.warned[-1], robot.warned[-1]
        assert robot.told["measured_js"].position == whole
    for message in (pose(x=nan), pose(x=50.0), elsewhere):
        robot.heard["sensor_cp"](message)
        assert robot.warned[-1].startswith("sensor_cp is refused: ")
    robot.heard["servo_jp"](SimpleNamespace())  # no message at all
    assert "the robot is held: AttributeError" in robot.warned[-1]
    robot.tick()
    assert "AttributeError" in robot.told["why"].data


def test_a_step_that_fails_holds_the_robot_and_the_node_goes_on(node: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = node.RobotNode()
    robot.heard["state_command"](node.String(data="enable"))

    def fail(*_: Any) -> None:
        raise RuntimeError("of CasADi")

    with monkeypatch.context() as broken:
        broken.setattr(robot.robot.servo, "step", fail)
        robot.heard["move_jp"](node.JointState(position=[0.0, 1.0, 2.0, -0.05, -0.03, -0.021]))
        robot.tick()
    assert "the robot is held: RuntimeError in a step: of CasADi" in robot.told["why"].data
    robot.heard["move_jp"](node.JointState(position=[0.0, 1.0, 2.0, -0.05, -0.03, -0.0201]))
    time.sleep(5e-3)
    robot.tick()
    assert robot.told["measured_js"].position[5] == pytest.approx(-0.0201, abs=1e-6)


@pytest.mark.parametrize("node", [True], indirect=True)
def test_messages_of_crtk_are_used_where_installed(node: Any) -> None:
    robot = node.RobotNode()
    robot.tick()
    state = robot.told["operating_state"]
    assert (state.state, state.is_homed, state.is_busy, state.header.stamp) == ("DISABLED", True, False, "now")
    robot.heard["state_command"](node.StringStamped(string="enable"))
    turn = [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]
    before = list(robot.told["measured_js"].position)
    robot.heard["move_jr"](node.JointState(position=turn))
    robot.tick()
    assert robot.told["operating_state"].is_busy
    for _ in range(50):
        robot.tick()
    assert robot.told["measured_js"].position == pytest.approx(np.add(before, turn), abs=1e-6)
    robot.heard["hold"](node.Empty())
    assert robot.robot.report(0.0)["why"] == "held by command"
    assert not robot.warned
