"""What RViz and monitors see of the robot: frames (tf2), markers of the tubes, diagnostics."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, TransformStamped
from tf2_ros import TransformBroadcaster
from visualization_msgs.msg import Marker, MarkerArray

from tubeopt.control.c_library import along_tubes, tube_links
from tubeopt.show.page import rgb, tube_colour

from .messages import pose, quaternion, stamped

RED = 1.0, 0.1, 0.1


class Display:
    """Frames of the tip and of the links of `robot_description`, and markers."""

    def __init__(self, node, robot, prefix: str) -> None:
        self._robot, self._prefix, self._links = robot, prefix, tube_links(robot)
        self._broadcaster = TransformBroadcaster(node)

    def frames(self, arm, stamp) -> None:
        """Broadcast where the tip and the links of the tubes are."""
        ends = np.array([(link.start, link.end) for link in self._links])
        tubes = np.array([link.tube for link in self._links])
        first, last = (along_tubes(self._robot, arm, tubes, ends[:, k]) for k in (0, 1))
        frames = [("tip", arm.tip_position, quaternion(arm.tip_rotation))]
        names = [link.name for link in self._links]
        frames += zip(names, (first + last) / 2, _upright_to(last - first), strict=True)
        self._broadcaster.sendTransform([self._frame(*frame, stamp) for frame in frames])

    def _frame(self, name: str, position, turn, stamp) -> TransformStamped:
        message = stamped(TransformStamped(), stamp, f"{self._prefix}plate")
        message.child_frame_id = self._prefix + name
        pose(position, turn, message.transform)
        return message

    def markers(self, arm, warned: bool, stamp) -> MarkerArray:
        """Each tube as a line of its diameter, from its carriage to its end; red where a snap is near."""
        return MarkerArray(markers=[self._marker(i, arm, warned, stamp) for i in range(self._robot.n_tubes)])

    def _marker(self, i: int, arm, warned: bool, stamp) -> Marker:
        marker, own = stamped(Marker(), stamp, f"{self._prefix}plate"), [link for link in self._links if link.tube == i]
        marker.ns, marker.id, marker.type, marker.action = "tubes", i, Marker.LINE_STRIP, Marker.ADD
        marker.pose.orientation.w = 1.0
        marker.scale.x = 2 * own[0].radius
        red, green, blue = RED if warned else (part / 255 for part in rgb(tube_colour(i)))
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = red, green, blue, 1.0
        s = np.array([own[0].start, *(link.end for link in own)])
        for x, y, z in along_tubes(self._robot, arm, np.full(len(s), i), s).tolist():
            marker.points.append(Point(x=x, y=y, z=z))
        return marker


def diagnostics(name: str, told: dict, pace) -> DiagnosticArray:
    """State, limits and pace of the loop as one status."""
    state, homed = told["operating_state"]["state"], told["operating_state"]["is_homed"]
    level = DiagnosticStatus.OK
    if told["snap_warning"] or not homed:
        level = DiagnosticStatus.WARN
    if state == "FAULT":
        level = DiagnosticStatus.ERROR
    took, late = pace.quantiles(0.99)
    values = {
        "state": state,
        "homed": homed,
        "margin": f"{told['margin']:.4f}",
        "snap warning": told["snap_warning"],
        "steps": pace.steps,
        "missed periods": pace.missed,
        "processor time of a step, 99 % (ms)": f"{1e3 * took:.3g}",
        "step late by, 99 % (ms)": f"{1e3 * late:.3g}",
    }
    status = DiagnosticStatus(level=level, name=f"tubeopt: {name}", hardware_id=name, message=told["why"] or state)
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticArray(status=[status])


def _upright_to(directions: np.ndarray) -> np.ndarray:
    """(m, 4) unit quaternions, scalar first, that turn z into directions (m, 3); those of length 0 turn nothing."""
    d = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    q = np.column_stack([1 + d[:, 2], -d[:, 1], d[:, 0], np.zeros(len(d))])
    q[q[:, 0] < 1e-9] = [0.0, 1.0, 0.0, 0.0]  # straight back: half a turn about x
    return q / np.linalg.norm(q, axis=1, keepdims=True)
