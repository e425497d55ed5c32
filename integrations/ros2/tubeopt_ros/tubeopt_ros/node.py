"""The node: messages of ROS 2 to commands of `CrtkRobot`, and its state to messages."""

from __future__ import annotations

import contextlib
import time
from functools import partial

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64, String

import tubeopt
from tubeopt.control.c_binding import CServo
from tubeopt.control.c_library import c_library
from tubeopt.control.crtk import CrtkRobot

try:  # the messages of CRTK, which its clients use
    from crtk_msgs.msg import OperatingState, StringStamped
except ImportError:
    OperatingState = StringStamped = None


class RobotNode(Node):
    """One robot under the names of CRTK."""

    def __init__(self) -> None:
        super().__init__("tubeopt_robot")
        for name, value in (("robot", ""), ("rotations", [0.0]), ("translations", [0.0]), ("rate", 500.0)):
            self.declare_parameter(name, value)
        path, rotations, translations, rate = (
            self.get_parameter(name).value for name in ("robot", "rotations", "translations", "rate")
        )
        robot = tubeopt.load_robot(path)
        self.robot = CrtkRobot(CServo(c_library(robot), (rotations, translations)))
        self._n, self._period = robot.n_tubes, 1.0 / rate
        for op, kind, read in (
            ("servo_cp", PoseStamped, _pose),
            ("move_cp", PoseStamped, _pose),
            ("servo_cv", TwistStamped, _twist),
            ("servo_jp", JointState, self._joints),
            ("move_jp", JointState, self._joints),
            ("servo_jr", JointState, self._joints),
            ("move_jr", JointState, self._joints),
            ("hold", Empty, _nothing),
            ("state_command", StringStamped or String, _word),
        ):
            self.create_subscription(kind, op, partial(self._hear, op, read), 1)
        self.create_subscription(PoseStamped, "sensor_cp", self.feel, 1)
        self._out = {
            name: self.create_publisher(kind, name, 1)
            for kind, names in (
                (JointState, ("measured_js", "setpoint_js")),
                (PoseStamped, ("measured_cp", "setpoint_cp")),
                (OperatingState or String, ("operating_state",)),
                (String, ("why",)),
                (Float64, ("margin",)),
                (WrenchStamped, ("measured_cf",)),
            )
            for name in names
        }
        self.create_timer(self._period, self.tick)

    def _hear(self, op, read, message) -> None:
        with self._surviving(op):
            self.robot.command({"op": op, **read(message)}, time.monotonic())

    @contextlib.contextmanager
    def _surviving(self, op):
        """What makes no sense is warned of; whatever else goes wrong holds the robot, and the node goes on."""
        try:
            yield
        except tubeopt.InputError as error:
            self.get_logger().warning(f"{op} is refused: {error}")
        except Exception as error:  # any error of one message holds the robot, and the node goes on
            words = f"the robot is held: {type(error).__name__} in {op}: {error}"
            self.robot.hold(words)
            self.get_logger().warning(words)

    def _joints(self, message) -> dict:
        names = [f"{kind}_{i + 1}" for kind in ("rotation", "translation") for i in range(self._n)]
        given, position = list(message.name), [float(value) for value in message.position]
        if given and sorted(given) != sorted(names):
            raise tubeopt.InputError(
                f"name is {', '.join(given)}; it must be empty or have each of {', '.join(names)} once"
            )
        if len(position) != len(names):
            raise tubeopt.InputError(
                f"position has {len(position)} numbers; it must have {len(names)}, in this order: {', '.join(names)}"
            )
        # Clients of CRTK name no joints: positions are then in the order of the joints.
        at = dict(zip(given or names, position, strict=True))
        ordered = [at[name] for name in names]
        return {"rotations": ordered[: self._n], "translations": ordered[self._n :]}

    def feel(self, message) -> None:
        """Tell the force at the tip that moves it from where the model has it to where a sensor sees it."""
        with self._surviving("sensor_cp"):
            self._feel(message)

    def _feel(self, message) -> None:
        compliance, place = self.robot.servo.compliance, _place(message)
        if compliance is None:
            raise tubeopt.InputError("the C library of this robot knows no compliance")
        gap = np.array(place) - self.robot.servo.equilibrium.tip_position
        if not np.isfinite(gap).all():
            raise tubeopt.InputError(f"position is {place}; every number must be finite")
        if not np.linalg.norm(gap) <= self.robot.servo.space.length:
            raise tubeopt.InputError(f"position is {np.linalg.norm(gap):g} m from the tip; it is in metres")
        told = WrenchStamped()
        told.header.stamp, told.header.frame_id = self.get_clock().now().to_msg(), "plate"
        force = told.wrench.force
        force.x, force.y, force.z = np.linalg.solve(compliance[:3, :3], gap).tolist()
        self._out["measured_cf"].publish(told)

    def tick(self) -> None:
        """One step, and what is told of it."""
        with self._surviving("a step"):
            self.robot.tick(time.monotonic, self._period)
        with self._surviving("a report"):
            self._report()

    def _report(self) -> None:
        told, stamp = self.robot.report(time.monotonic()), self.get_clock().now().to_msg()
        for name in ("measured_js", "setpoint_js"):
            message = JointState(name=told[name]["name"], position=told[name]["position"])
            message.velocity = told[name]["velocity"]
            message.header.stamp = stamp
            self._out[name].publish(message)
        for name in ("measured_cp", "setpoint_cp"):
            message = PoseStamped()
            message.header.stamp, message.header.frame_id = stamp, "plate"
            place, turn = message.pose.position, message.pose.orientation
            place.x, place.y, place.z = told[name]["position"]
            turn.w, turn.x, turn.y, turn.z = quaternion(np.array(told[name]["rotation"]))
            self._out[name].publish(message)
        self._out["operating_state"].publish(_state(told["operating_state"], stamp))
        self._out["why"].publish(String(data=told["why"]))
        self._out["margin"].publish(Float64(data=told["margin"]))


def quaternion(rotation: np.ndarray) -> tuple[float, ...]:
    """Unit quaternion, scalar first, of a rotation matrix (3, 3): the eigenvector of Bar-Itzhack's matrix."""
    r = rotation
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    table = np.block([[np.trace(r), skew], [skew[:, None], r + r.T - np.trace(r) * np.eye(3)]])
    vector = np.linalg.eigh(table)[1][:, -1]
    return tuple((vector * (1 if vector[0] >= 0 else -1)).tolist())


def _in_plate(message) -> None:
    """Raise InputError where a message is in a frame other than that of the plate."""
    frame = getattr(getattr(message, "header", None), "frame_id", "")
    if frame not in ("", "plate"):
        raise tubeopt.InputError(f"frame_id is {frame!r}; it must be empty or 'plate', in which the robot is led")


def _place(message) -> list:
    _in_plate(message)
    p = message.pose.position
    return [p.x, p.y, p.z]


def _pose(message) -> dict:
    place, q = _place(message), message.pose.orientation
    ahead = [2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), q.w**2 + q.z**2 - q.x**2 - q.y**2]
    return {"position": place, "direction": ahead if any(ahead) else None}


def _twist(message) -> dict:
    _in_plate(message)
    v = message.twist.linear
    return {"linear": [v.x, v.y, v.z]}


def _word(message) -> dict:
    return {"command": message.string if StringStamped else message.data}


def _nothing(message) -> dict:
    return {}


def _state(known: dict, stamp):
    if OperatingState is None:
        return String(data=known["state"])
    message = OperatingState(**known)
    message.header.stamp = stamp
    return message


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = RobotNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
