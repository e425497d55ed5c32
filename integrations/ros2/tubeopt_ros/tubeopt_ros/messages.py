"""Messages of ROS 2 and what they are for `CrtkRobot`: the one place that knows their fields."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String

from tubeopt import InputError

try:  # the messages of CRTK, which its clients use
    from crtk_msgs.msg import OperatingState, StringStamped
except ImportError:
    OperatingState = StringStamped = None

STATE, WORD = OperatingState or String, StringStamped or String


class Reader:
    """Reads messages for a robot of `n` tubes in the frame `plate`; without `directions` only positions count."""

    def __init__(self, n: int, plate: str, directions: bool) -> None:
        self.n, self.plate, self.directions = n, plate, directions
        self.names = [f"{kind}_{i + 1}" for kind in ("rotation", "translation") for i in range(n)]

    def jp(self, message, part: str = "position") -> dict:
        """Joint values; clients of CRTK name no joints, and then give them in this order."""
        given, values = list(message.name), [float(value) for value in getattr(message, part)]
        if given and sorted(given) != sorted(self.names):
            raise InputError(
                f"name is {', '.join(given)}; it must be empty or have each of {', '.join(self.names)} once"
            )
        if len(values) != len(self.names):
            raise InputError(
                f"{part} has {len(values)} numbers; it must have {len(self.names)}, in this order: "
                f"{', '.join(self.names)}"
            )
        at = dict(zip(given or self.names, values, strict=True))
        ordered = [at[name] for name in self.names]
        return {"rotations": ordered[: self.n], "translations": ordered[self.n :]}

    jr = js = jp

    def jv(self, message) -> dict:
        """Velocities of the joints."""
        return self.jp(message, "velocity")

    def place(self, message) -> list:
        """Position of a pose in the frame of the plate."""
        self._in_plate(message)
        p = message.pose.position
        return [p.x, p.y, p.z]

    def cp(self, message) -> dict:
        """Position of the tip, and the z axis of the orientation as its direction."""
        place, q = self.place(message), message.pose.orientation
        # Products: powers of floats raise OverflowError, products are infinite and then rejected.
        along = q.w * q.w + q.z * q.z - q.x * q.x - q.y * q.y
        ahead = [2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), along]
        return {"position": place, "direction": ahead if self.directions and any(ahead) else None}

    def cr(self, message) -> dict:
        """Translation and turn of the tip, along and about the axes of the plate; the identity turns nothing."""
        place, q = self.place(message), message.pose.orientation
        sine = math.hypot(q.x, q.y, q.z)
        angle = math.remainder(2 * math.atan2(sine, q.w), 2 * math.pi)
        turn = [angle * part / (sine or 1.0) for part in (q.x, q.y, q.z)]
        return {"translation": place, "turn": turn if self.directions else None}

    def cv(self, message) -> dict:
        """Velocity of the tip, and at which its direction turns."""
        self._in_plate(message)
        v, w = message.twist.linear, message.twist.angular
        return {"linear": [v.x, v.y, v.z], "angular": [w.x, w.y, w.z] if self.directions else None}

    def state_command(self, message) -> dict:
        """The word of a state command."""
        return {"command": message.string if StringStamped else message.data}

    def hold(self, message) -> dict:
        """Nothing."""
        return {}

    free = hold

    def _in_plate(self, message) -> None:
        frame = getattr(getattr(message, "header", None), "frame_id", "")
        if frame not in ("", self.plate):
            raise InputError(f"frame_id is {frame!r}; it must be empty or {self.plate!r}, the frame of the base plate")


def stamped(message, stamp, frame: str = ""):
    """The message with its header filled."""
    message.header.stamp, message.header.frame_id = stamp, frame
    return message


def joint_state(told: dict) -> JointState:
    """Names, positions and velocities of the joints."""
    return JointState(name=told["name"], position=told["position"], velocity=told["velocity"])


def pose(position, w_x_y_z, message=None):
    """A PoseStamped, or the Transform `message`, of a position and a unit quaternion, scalar first."""
    if message is None:
        message = PoseStamped()
        place, turn = message.pose.position, message.pose.orientation
    else:
        place, turn = message.translation, message.rotation
    place.x, place.y, place.z = map(float, position)
    turn.w, turn.x, turn.y, turn.z = map(float, w_x_y_z)
    return message


def twist(told: dict) -> TwistStamped:
    """Linear and angular velocity."""
    message = TwistStamped()
    v, w = message.twist.linear, message.twist.angular
    v.x, v.y, v.z = told["linear"]
    w.x, w.y, w.z = told["angular"]
    return message


def operating_state(told: dict):
    """State, and whether the robot is homed and busy."""
    return OperatingState(**told) if OperatingState else String(data=told["state"])


def matrix(values: np.ndarray) -> Float64MultiArray:
    """A matrix by rows, with its sizes."""
    message, (rows, columns) = Float64MultiArray(), values.shape
    message.layout.dim = [
        MultiArrayDimension(label="rows", size=rows, stride=rows * columns),
        MultiArrayDimension(label="columns", size=columns, stride=columns),
    ]
    message.data = values.ravel().tolist()
    return message


def quaternion(rotation: np.ndarray) -> tuple[float, ...]:
    """Unit quaternion, scalar first, of a rotation matrix (3, 3): the eigenvector of Bar-Itzhack's matrix."""
    r = rotation
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    table = np.block([[np.trace(r), skew], [skew[:, None], r + r.T - np.trace(r) * np.eye(3)]])
    vector = np.linalg.eigh(table)[1][:, -1]
    return tuple((vector * (1 if vector[0] >= 0 else -1)).tolist())
