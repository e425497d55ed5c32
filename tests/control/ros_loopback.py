"""ROS 2 in one process: modules that stand for rclpy and the messages, and topics that call who subscribed.

The node and clients of CRTK import these modules in place of those of ROS. What the tests show is that both agree on
names, types and meanings, not that ROS delivers messages.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from functools import total_ordering
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest
from scipy.spatial.transform import Rotation

CLOCK = SimpleNamespace(now=time.time)
"""Seconds of the clock of ROS; tests replace `now`."""


@total_ordering
class Time:
    """Time or duration, ns; it is its own message."""

    def __init__(self, seconds: float = 0.0, nanoseconds: int = 0, clock_type: Any = None) -> None:
        self.nanoseconds = int(seconds * 1e9) + nanoseconds

    @classmethod
    def from_msg(cls, message: Time) -> Time:
        return cls(nanoseconds=message.nanoseconds)

    def to_msg(self) -> Time:
        return self

    def __sub__(self, other: Time) -> Time:
        return Time(nanoseconds=self.nanoseconds - other.nanoseconds)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Time) and self.nanoseconds == other.nanoseconds

    def __lt__(self, other: Time) -> bool:
        return self.nanoseconds < other.nanoseconds

    __hash__ = None  # type: ignore[assignment]


class Message:
    """Message with the fields of its kind; other fields are refused, as ROS does."""

    fields: ClassVar[dict[str, Callable[[], Any]]] = {}

    def __init__(self, **given: Any) -> None:
        assert set(given) <= set(self.fields), (type(self).__name__, set(given) - set(self.fields))
        for name, make in self.fields.items():
            super().__setattr__(name, given.get(name, make()))

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self.fields:
            raise AttributeError(f"{type(self).__name__} has no field {name}")
        kind = type(getattr(self, name))
        assert kind is not float or isinstance(value, float), (type(self).__name__, name, value)
        super().__setattr__(name, value)


def kind(called: str, /, **fields: Any) -> type[Message]:
    """Class of a message."""
    return type(called, (Message,), {"fields": fields})


def _numbers(called: str, names: str) -> type[Message]:
    return kind(called, **dict.fromkeys(names, float))


Header = kind("Header", stamp=Time, frame_id=str)
Point, Vector3 = _numbers("Point", "xyz"), _numbers("Vector3", "xyz")
Quaternion = kind("Quaternion", x=float, y=float, z=float, w=lambda: 1.0)
Pose = kind("Pose", position=Point, orientation=Quaternion)
Twist = kind("Twist", linear=Vector3, angular=Vector3)
Wrench = kind("Wrench", force=Vector3, torque=Vector3)
Transform = kind("Transform", translation=Vector3, rotation=Quaternion)
Marker = kind(
    "Marker", header=Header, ns=str, id=int, type=int, action=int, pose=Pose, scale=Vector3,
    color=_numbers("ColorRGBA", "rgba"), points=list,
)  # fmt: skip
Marker.LINE_STRIP, Marker.ADD = 4, 0  # type: ignore[attr-defined]
Status = kind("DiagnosticStatus", level=bytes, name=str, message=str, hardware_id=str, values=list)
Status.OK, Status.WARN, Status.ERROR = b"\0", b"\1", b"\2"  # type: ignore[attr-defined]
Layout = kind("MultiArrayLayout", dim=list, data_offset=int)

MESSAGES = {
    "geometry_msgs.msg": [
        Point, Pose, Twist, Wrench, Transform,
        kind("PoseStamped", header=Header, pose=Pose),
        kind("TwistStamped", header=Header, twist=Twist),
        kind("WrenchStamped", header=Header, wrench=Wrench),
        kind("TransformStamped", header=Header, child_frame_id=str, transform=Transform),
    ],
    "sensor_msgs.msg": [
        kind("JointState", header=Header, name=list, position=list, velocity=list, effort=list),
        kind("Joy", header=Header, axes=list, buttons=list),
    ],
    "std_msgs.msg": [
        kind("Empty"), kind("Float64", data=float), kind("String", data=str), kind("Bool", data=bool),
        kind("MultiArrayDimension", label=str, size=int, stride=int),
        kind("Float64MultiArray", layout=Layout, data=list),
    ],
    "visualization_msgs.msg": [Marker, kind("MarkerArray", markers=list)],
    "diagnostic_msgs.msg": [
        Status, kind("KeyValue", key=str, value=str), kind("DiagnosticArray", header=Header, status=list)
    ],
}  # fmt: skip

SERVICES = {
    "std_srvs.srv": [
        type("Trigger", (), {"Request": kind("Request"), "Response": kind("Response", success=bool, message=str)})
    ]
}

CRTK_MESSAGES = {
    "crtk_msgs.msg": [
        kind("OperatingState", header=Header, state=str, is_homed=bool, is_busy=bool),
        kind("StringStamped", header=Header, string=str),
    ],
    "crtk_msgs.srv": [],
}


class Bus:
    """Topics: who subscribed, the type of each, and the last message."""

    def __init__(self) -> None:
        self.calls: dict[str, list[Any]] = defaultdict(list)
        self.types: dict[str, type[Message]] = {}
        self.last: dict[str, Any] = {}
        self.log: list[tuple[str, Any]] = []
        self.services: dict[str, Callable[[], Any]] = {}

    def join(self, topic: str, of: type[Message]) -> None:
        """All who use a topic use the same type."""
        assert self.types.setdefault(topic, of) is of, f"{topic} has two types"

    def publish(self, topic: str, message: Any) -> None:
        assert isinstance(message, self.types[topic]), (topic, message)
        self.last[topic] = message
        if topic in ("error", "warning", "status"):
            self.log.append((topic, message.data))
        for call in list(self.calls[topic]):
            call(message)


class Publisher:
    """Publisher of one topic; that of a lifecycle node publishes while the node is active."""

    def __init__(self, bus: Bus, topic: str, active: Callable[[], bool]) -> None:
        self.bus, self.topic_name, self._active = bus, topic, active

    def publish(self, message: Any) -> None:
        if self._active():
            self.bus.publish(self.topic_name, message)

    def get_subscription_count(self) -> int:
        return len(self.bus.calls[self.topic_name])


class Subscription(SimpleNamespace):
    """Subscription of one topic."""

    def get_publisher_count(self) -> int:
        return int(self.topic_name in self.bus.types)


class Node:
    """What nodes ask of rclpy."""

    bus = Bus()
    parameters: ClassVar[dict[str, Any]] = {}

    def __init__(self, name: str) -> None:
        self.active = True
        self.frames: dict[str, Any] = {}
        self.logged: list[str] = []
        self.timers: list[Any] = []

    def declare_parameter(self, name: str, value: Any) -> None:
        self.parameters.setdefault(name, value)

    def get_parameter(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(value=self.parameters[name])

    def create_subscription(self, of: Any, topic: str, hear: Any, qos: Any) -> Any:
        topic = topic.strip("/")
        self.bus.join(topic, of)
        self.bus.calls[topic].append(hear)
        return Subscription(bus=self.bus, topic_name=topic)

    def create_publisher(self, of: Any, topic: str, qos: Any) -> Publisher:
        topic = topic.strip("/")
        self.bus.join(topic, of)
        return Publisher(self.bus, topic, lambda: self.active)

    create_lifecycle_publisher = create_publisher

    def create_service(self, of: Any, name: str, serve: Any) -> None:
        self.bus.services[name] = lambda: serve(of.Request(), of.Response())

    def create_timer(self, period: float, call: Any) -> Any:
        self.timers.append(call)
        return call

    def destroy_timer(self, timer: Any) -> None:
        self.timers.remove(timer)

    def destroy_publisher(self, publisher: Any) -> None:
        pass

    destroy_subscription = destroy_publisher

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: Time(CLOCK.now()), clock_type=None)

    def create_rate(self, frequency: float, clock: Any) -> SimpleNamespace:
        return SimpleNamespace(sleep=lambda: time.sleep(1 / frequency))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.logged.append, error=self.logged.append)


class LifecycleNode(Node):
    """A node with transitions: inactive until it is activated."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.active = False

    def on_activate(self, state: Any) -> str:
        self.active = True
        return "success"

    def on_deactivate(self, state: Any) -> str:
        self.active = False
        return "success"

    def trigger_configure(self) -> str:
        return self.on_configure(None)  # type: ignore[attr-defined, no-any-return]

    def trigger_activate(self) -> str:
        return self.on_activate(None)


class TransformBroadcaster:
    """Keeps the frames with its node."""

    def __init__(self, node: Node) -> None:
        self.node = node

    def sendTransform(self, transforms: list[Any]) -> None:
        self.node.frames |= {each.child_frame_id: each for each in transforms}


class Frame:
    """PyKDL's frame, as far as clients of CRTK ask it."""

    def __init__(self, turn: Any = None, place: Any = (0.0, 0.0, 0.0)) -> None:
        self.M, self.p = turn or KdlRotation(), [float(x) for x in place]


class KdlRotation:
    """PyKDL's rotation: quaternions with the scalar last."""

    def __init__(self, quaternion: Any = (0.0, 0.0, 0.0, 1.0)) -> None:
        self.own = Rotation.from_quat(quaternion)

    @classmethod
    def Quaternion(cls, *x_y_z_w: float) -> KdlRotation:
        return cls(x_y_z_w)

    def GetQuaternion(self) -> list[float]:
        return [float(x) for x in self.own.as_quat()]


def install(patch: pytest.MonkeyPatch, *, crtk: bool) -> Bus:
    """Put the modules of ROS into place, with or without the messages of CRTK; returns the topics."""
    Node.bus, Node.parameters = Bus(), {}
    node = SimpleNamespace
    modules: dict[str, dict[str, Any]] = {
        name: {each.__name__: each for each in kinds}
        for name, kinds in (MESSAGES | SERVICES | (CRTK_MESSAGES if crtk else {})).items()
    }
    modules |= {
        "rclpy": {
            "init": lambda args=None: None, "ok": lambda: True, "shutdown": lambda: None, "create_node": Node,
            "get_default_context": lambda: node(on_shutdown=lambda call: None),
        },
        "rclpy.lifecycle": {
            "LifecycleNode": LifecycleNode, "TransitionCallbackReturn": node(SUCCESS="success", FAILURE="failure")
        },
        "rclpy.node": {"Node": Node},
        "rclpy.publisher": {"Publisher": Publisher},
        "rclpy.subscription": {"Subscription": Subscription},
        "rclpy.qos": {
            "HistoryPolicy": node(KEEP_LAST=1), "DurabilityPolicy": node(TRANSIENT_LOCAL=1), "QoSProfile": node
        },
        "rclpy.time": {"Time": Time, "Duration": Time},
        "rclpy.utilities": {"remove_ros_args": lambda argv: argv},
        "tf2_ros": {"TransformBroadcaster": TransformBroadcaster},
        "PyKDL": {"Frame": Frame, "Rotation": KdlRotation, "Vector": lambda *place: place},
    }  # fmt: skip
    for name in [name for name in sys.modules if name.split(".")[0] in ("tubeopt_ros", "crtk", "crtk_msgs")]:
        patch.delitem(sys.modules, name)
    for name in [*{name.split(".")[0] for name in modules}, *modules]:
        patch.setitem(sys.modules, name, ModuleType(name))
    for name, members in modules.items():
        vars(sys.modules[name]).update(members)
        parent, _, last = name.partition(".")
        if last:
            setattr(sys.modules[parent], last, sys.modules[name])
    if not crtk:
        patch.setitem(sys.modules, "crtk_msgs", None)
    return Node.bus
