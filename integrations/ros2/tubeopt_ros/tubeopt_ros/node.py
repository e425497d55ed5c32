"""The node: messages of ROS 2 to commands of `CrtkRobot`, and its state to messages."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

import tubeopt
from tubeopt.control.c_binding import CServo
from tubeopt.control.c_library import c_library
from tubeopt.control.crtk import CrtkRobot


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
            ("state_command", String, _word),
        ):
            self.create_subscription(kind, op, partial(self._hear, op, read), 1)
        self.create_subscription(PoseStamped, "sensor_cp", self.feel, 1)
        self._out = {
            name: self.create_publisher(kind, name, 1)
            for kind, names in (
                (JointState, ("measured_js", "setpoint_js")),
                (PoseStamped, ("measured_cp", "setpoint_cp")),
                (String, ("operating_state", "why")),
                (Float64, ("margin",)),
                (WrenchStamped, ("measured_cf",)),
            )
            for name in names
        }
        self.create_timer(self._period, self.tick)

    def _hear(self, op, read, message) -> None:
        try:
            self.robot.command({"op": op, **read(message)}, time.monotonic())
        except (tubeopt.InputError, KeyError) as error:
            self.get_logger().warning(f"{op}: {error}")

    def _joints(self, message) -> dict:
        at = dict(zip(message.name, message.position, strict=True))
        rotations, translations = (
            [at[f"{kind}_{i + 1}"] for i in range(self._n)] for kind in ("rotation", "translation")
        )
        return {"rotations": rotations, "translations": translations}

    def feel(self, message) -> None:
        """Tell the force at the tip that moves it from where the model has it to where a sensor sees it."""
        compliance, place = self.robot.servo.compliance, message.pose.position
        if compliance is None:
            self.get_logger().warning("sensor_cp: the C library of this robot knows no compliance")
            return
        gap = np.array([place.x, place.y, place.z]) - self.robot.servo.equilibrium.tip_position
        told = WrenchStamped()
        told.header.stamp, told.header.frame_id = self.get_clock().now().to_msg(), "plate"
        force = told.wrench.force
        force.x, force.y, force.z = np.linalg.solve(compliance[:3, :3], gap).tolist()
        self._out["measured_cf"].publish(told)

    def tick(self) -> None:
        """One step, and what is told of it."""
        self.robot.tick(time.monotonic, self._period)
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
        self._out["operating_state"].publish(String(data=told["operating_state"]["state"]))
        self._out["why"].publish(String(data=told["why"]))
        self._out["margin"].publish(Float64(data=told["margin"]))


def quaternion(rotation: np.ndarray) -> tuple[float, ...]:
    """Unit quaternion, scalar first, of a rotation matrix (3, 3): the eigenvector of Bar-Itzhack's matrix."""
    r = rotation
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    table = np.block([[np.trace(r), skew], [skew[:, None], r + r.T - np.trace(r) * np.eye(3)]])
    vector = np.linalg.eigh(table)[1][:, -1]
    return tuple((vector * (1 if vector[0] >= 0 else -1)).tolist())


def _pose(message) -> dict:
    p, q = message.pose.position, message.pose.orientation
    ahead = [2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), q.w**2 + q.z**2 - q.x**2 - q.y**2]
    return {"position": [p.x, p.y, p.z], "direction": ahead if any(ahead) else None}


def _twist(message) -> dict:
    v = message.twist.linear
    return {"linear": [v.x, v.y, v.z]}


def _word(message) -> dict:
    return {"command": message.data}


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
