"""The lifecycle node: messages of ROS 2 to commands of `CrtkRobot`, and its state to messages."""

from __future__ import annotations

import contextlib
import math
import time
from functools import partial

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

import tubeopt
from tubeopt.control.c_binding import CServo
from tubeopt.control.c_library import c_library
from tubeopt.control.command import ServoOptions
from tubeopt.control.crtk import COMMANDS, STATE_COMMANDS, CrtkRobot
from tubeopt.control.server import Pace

from .display import Display, diagnostics
from .messages import STATE, WORD, Reader, joint_state, matrix, operating_state, pose, quaternion, stamped, twist

LIMITS = ServoOptions()
PARAMETERS = {
    "robot": "thesis_ctr",
    "rotations": [0.0],
    "translations": [0.0],
    "rate": 500.0,
    "display_rate": 20.0,
    "watchdog": 0.1,
    "directions": True,
    "autostart": True,
    "frame_prefix": "",
    **{name: getattr(LIMITS, name) for name in ("speed", "turn_rate", "shift_rate", "min_margin")},
    "turn_acceleration": 0.0,
    "shift_acceleration": 0.0,
    "min_snap_distance": 0.0,
}
"""Parameters and their defaults; an acceleration of 0 has no limit, a snap distance of 0 leaves the margin,
and a single joint value of 0 is home."""

KINDS = {
    "cp": PoseStamped,
    "cr": PoseStamped,
    "cv": TwistStamped,
    "jp": JointState,
    "jr": JointState,
    "jv": JointState,
    "js": JointState,
    "hold": Empty,
    "free": Empty,
    "state_command": WORD,
}
"""Messages of the commands, by their names or the last two letters."""

REPORTS = {
    "measured_js": JointState,
    "setpoint_js": JointState,
    "goal_js": JointState,
    "measured_cp": PoseStamped,
    "setpoint_cp": PoseStamped,
    "measured_cv": TwistStamped,
    "measured_cf": WrenchStamped,
    "operating_state": STATE,
    "jacobian": Float64MultiArray,
    "error": String,
    "warning": String,
    "status": String,
    "why": String,
    "margin": Float64,
    "snap_distance": Float64,
    "shape": MarkerArray,
    "/diagnostics": DiagnosticArray,
}

DONE, FAILED = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class RobotNode(LifecycleNode):
    """One robot under the names of CRTK. It is built when the node is configured, and moves while it is active."""

    def __init__(self) -> None:
        super().__init__("tubeopt_robot")
        for name, value in PARAMETERS.items():
            self.declare_parameter(name, value)
        self.robot = self._timer = None
        for op in COMMANDS:
            kind, depth = op if op in KINDS else op[-2:], 1 if op.startswith("servo") else 10
            self.create_subscription(KINDS[kind], op, partial(self._hear, op, kind), depth)
        self.create_subscription(PoseStamped, "sensor_cp", self.feel, 1)
        for word in (*STATE_COMMANDS, "hold"):
            self.create_service(Trigger, word, partial(self._serve, word))
        self._out = {name: self.create_lifecycle_publisher(kind, name, 10) for name, kind in REPORTS.items()}

    # --- transitions ---

    def on_configure(self, state) -> TransitionCallbackReturn:
        """Build the robot; what is impossible fails with a sentence."""
        at = {name: self.get_parameter(name).value for name in PARAMETERS}
        try:
            robot = tubeopt.load_robot(at["robot"])
            rotations = robot.home_rotations if list(at["rotations"]) == [0.0] else at["rotations"]
            translations = robot.home_translations if list(at["translations"]) == [0.0] else at["translations"]
            for name in ("rate", "display_rate"):
                if not 0 < at[name] < 1e5:
                    raise tubeopt.InputError(f"{name} is {at[name]} Hz; it must be more than 0 and less than 1e5")
            limits = {name: getattr(LIMITS, name) and at[name] for name in ("speed", "turn_rate", "shift_rate")}
            optional = "turn_acceleration", "shift_acceleration", "min_snap_distance"
            limits |= {name: at[name] or None for name in optional}
            servo = CServo(
                c_library(robot), (rotations, translations), ServoOptions(min_margin=at["min_margin"], **limits)
            )
            self.robot = CrtkRobot(servo, watchdog=at["watchdog"])
        except (tubeopt.InputError, tubeopt.SolveError, OSError) as error:
            self.get_logger().error(f"the robot cannot be configured: {error}")
            return FAILED
        self._name, self._period = robot.name or "robot", 1.0 / at["rate"]
        self._every = max(1, round(at["rate"] / at["display_rate"]))
        self._plate = f"{at['frame_prefix']}plate"
        self._reader = Reader(robot.n_tubes, self._plate, at["directions"])
        self._display, self._pace = Display(self, robot, at["frame_prefix"]), Pace()
        return DONE

    def on_activate(self, state) -> TransitionCallbackReturn:
        """Start the loop; the robot is disabled until a client enables it."""
        self._due = time.monotonic()
        self._timer = self.create_timer(self._period, self.tick)
        return super().on_activate(state)

    def on_deactivate(self, state) -> TransitionCallbackReturn:
        """Brake, disable the robot, and stop the loop."""
        self._stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state) -> TransitionCallbackReturn:
        """Forget the robot."""
        self.robot = None
        return DONE

    def on_shutdown(self, state) -> TransitionCallbackReturn:
        """Brake and stop."""
        self._stop()
        return DONE

    def on_error(self, state) -> TransitionCallbackReturn:
        """Brake and stop; the node can be configured again."""
        self._stop()
        return DONE

    def _stop(self) -> None:
        if self._timer is None:
            return
        self.destroy_timer(self._timer)
        self._timer = None
        self.robot.command({"op": "state_command", "command": "disable"}, time.monotonic())
        while self.robot.servo.moving and self.robot.state == "DISABLED":
            self.tick()
            time.sleep(self._period)

    # --- commands ---

    def _hear(self, op, kind, message) -> None:
        with self._surviving(op):
            self._check_active()
            self.robot.command({"op": op, **getattr(self._reader, kind)(message)}, time.monotonic())

    def _serve(self, word, request, response) -> Trigger.Response:
        """Answer of a service: whether a state command, or hold, was accepted, with the state or the reason."""
        try:
            self._check_active()
            command = {"op": "hold"} if word == "hold" else {"op": "state_command", "command": word}
            self.robot.command(command, time.monotonic())
            response.success, response.message = True, self.robot.state
        except tubeopt.InputError as error:
            response.success, response.message = False, str(error)
        return response

    def _check_active(self) -> None:
        if self._timer is None:
            raise tubeopt.InputError("the node is not active; activate it first")

    @contextlib.contextmanager
    def _surviving(self, op):
        """What makes no sense is reported; any other error stops the robot, and the node continues."""
        try:
            yield
        except tubeopt.InputError as error:
            words = f"{op} is refused: {error}"
            self.get_logger().warning(words)
            self._out["error"].publish(String(data=words))
        except Exception as error:  # any error of one message or step stops the robot, and the node continues
            words = f"the robot stopped: {type(error).__name__} in {op}: {error}"
            self.robot.fault(words)
            self.get_logger().error(words)

    def feel(self, message) -> None:
        """Publish the force at the tip that moves it from where the model has it to where a sensor sees it."""
        with self._surviving("sensor_cp"):
            self._feel(message)

    def _feel(self, message) -> None:
        self._check_active()
        compliance, place = self.robot.servo.slopes.compliance, self._reader.place(message)
        if compliance is None:
            raise tubeopt.InputError("the C library of this robot knows no compliance")
        gap = np.array(place) - self.robot.servo.equilibrium.tip_position
        if not np.isfinite(gap).all():
            raise tubeopt.InputError(f"position is {place}; every number must be finite")
        if not math.hypot(*gap) <= self.robot.servo.space.length:
            raise tubeopt.InputError(f"position is {math.hypot(*gap):g} m from the tip; it is in metres")
        told = stamped(WrenchStamped(), self._now(), self._plate)
        force = told.wrench.force
        force.x, force.y, force.z = np.linalg.solve(compliance[:3, :3], gap).tolist()
        self._out["measured_cf"].publish(told)

    # --- loop ---

    def tick(self) -> None:
        """One step, and its report."""
        began, late = time.thread_time(), time.monotonic() - self._due
        with self._surviving("a step"):
            self.robot.tick(time.monotonic, self._period)
        with self._surviving("a report"):
            self._report()
        self._pace.add(time.thread_time() - began, max(late, 0.0), max(int(late / self._period), 0))
        self._due = max(self._due + self._period, time.monotonic())

    def _report(self) -> None:
        told, stamp = self.robot.report(time.monotonic()), self._now()
        for name in ("measured_js", "setpoint_js", "goal_js"):
            self._publish(name, stamped(joint_state(told[name]), stamp))
        for name in ("measured_cp", "setpoint_cp"):
            turn = quaternion(np.array(told[name]["rotation"]))
            self._publish(name, stamped(pose(told[name]["position"], turn), stamp, self._plate))
        self._publish("measured_cv", stamped(twist(told["measured_cv"]), stamp, self._plate))
        state = operating_state(told["operating_state"])
        self._publish("operating_state", state if STATE is String else stamped(state, stamp))
        while self.robot.events:
            kind, words = self.robot.events.popleft()
            self._publish(kind, String(data=words))
        self._publish("why", String(data=told["why"]))
        self._publish("margin", Float64(data=told["margin"]))
        if self._pace.steps % self._every == 0:
            self._show(told, stamp)

    def _show(self, told, stamp) -> None:
        """What is for eyes, and the Jacobian: less often than each step."""
        arm, slopes = self.robot.servo.equilibrium, self.robot.servo.slopes
        if (turn := self.robot.snap_distance()) is not None:
            self._publish("snap_distance", Float64(data=turn))
        self._publish("jacobian", matrix(np.vstack([slopes.position, slopes.rotation])))
        self._display.frames(arm, stamp)
        self._publish("shape", self._display.markers(arm, told["snap_warning"], stamp))
        if self._pace.steps % round(1 / self._period) < self._every:  # once per second
            self._publish("/diagnostics", stamped(diagnostics(self._name, told, self._pace), stamp))

    def _publish(self, name, message) -> None:
        self._out[name].publish(message)

    def _now(self):
        return self.get_clock().now().to_msg()


def main() -> None:
    """Run the node until it is stopped; with the parameter `autostart` it becomes active at once."""
    rclpy.init()
    node = RobotNode()
    try:
        if node.get_parameter("autostart").value and node.trigger_configure() == DONE:
            node.trigger_activate()
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
