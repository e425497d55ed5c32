"""A client of `tubeopt serve` in Python: pip install websockets."""

import json

from websockets.sync.client import connect


class Robot:
    """robot = Robot(token); robot.enable(); robot.servo_cp([0.05, 0.0, 0.15]); print(robot.state()["margin"])"""

    def __init__(self, token, port=8765, role="commander"):
        self.socket = connect(f"ws://127.0.0.1:{port}", compression=None)
        self.send(op="hello", token=token, role=role)
        self.welcome = json.loads(self.socket.recv(5))

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def enable(self):
        self.send(op="state_command", command="enable")

    def disable(self):
        self.send(op="state_command", command="disable")

    def servo_cp(self, position, direction=None):
        """To be called again and again: the robot holds where it hears nothing for a tenth of a second."""
        self.send(op="servo_cp", position=list(position), direction=None if direction is None else list(direction))

    def servo_cv(self, linear):
        self.send(op="servo_cv", linear=list(linear))

    def move_cp(self, position, direction=None):
        self.send(op="move_cp", position=list(position), direction=None if direction is None else list(direction))

    def move_jp(self, rotations, translations):
        self.send(op="move_jp", rotations=list(rotations), translations=list(translations))

    def state(self, timeout=5):
        """The next state; what was refused on the way is raised."""
        while True:
            told = json.loads(self.socket.recv(timeout))
            if told["op"] == "error":
                raise ValueError(told["words"])
            if told["op"] == "state":
                return told

    def close(self):
        self.socket.close()
