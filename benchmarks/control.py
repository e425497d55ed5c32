"""A robot as a C library beside the robot in Python: tips and derivatives at many configurations, and the time that a
servo step takes.

    python -m benchmarks.control [ROBOT.yaml] [CONFIGURATIONS]

Joint values are drawn from the limits; derivatives are compared on every hundredth.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import tubeopt
from tubeopt.control.c_binding import CRobot
from tubeopt.control.c_library import c_library
from tubeopt.inverse.joints import joint_space


def main(path: str = "configs/robots/thesis_ctr.yaml", count: int = 10_000) -> None:
    robot = tubeopt.load_robot(path)
    library = CRobot(c_library(robot))
    space = joint_space(robot)
    some = space.sample(count) @ space.spread.T + space.offset
    joints = np.tile(some, (count // len(some) + 1, 1))[:count]
    rotations, translations = np.split(joints, 2, axis=1)
    rotations[len(some) :] = np.random.default_rng(0).uniform(-np.pi, np.pi, rotations[len(some) :].shape)
    known = tubeopt.forward_kinematics_batch(robot, rotations, translations)
    tips, slopes, declined = [], [], 0
    for k in range(len(joints)):
        try:
            pose = library.solve(rotations[k], translations[k])
        except tubeopt.SolveError:
            declined += 1
            continue
        tips.append(np.linalg.norm(pose.tip_position - known.tip_position[k]))
        if k % 100 == 0:
            jacobian = tubeopt.forward_kinematics(robot, rotations[k], translations[k]).jacobian()
            slopes.append(np.abs(library.slopes().position - jacobian.position).max())
    print(f"{len(tips)} configurations, {declined} declined")
    print(f"tips differ by {max(tips):.1e} m at most, derivatives of {len(slopes)} by {max(slopes):.1e} m/rad or 1")
    servo(library)


def servo(library: CRobot, steps: int = 5000) -> None:
    """Processor time of steps, of which the call from Python takes a part."""
    n = library.solve(*START).rotations.size
    assert n == len(START[0])
    target = library.follow(*START).tip_position
    took = []
    for k in range(steps):
        turn = 2 * np.pi * k / 1000
        at = target + 5e-3 * np.array([np.cos(turn) - 1, np.sin(turn), 0])
        command = np.concatenate([[1e-3], at, np.zeros(3), [0.1, 6, 0.1, 0.1, 0]])
        began = time.process_time()
        library.servo(command)
        took.append(time.process_time() - began)
    median, rare = np.quantile(took, [0.5, 0.999]) * 1e6
    print(f"servo step from Python: {median:.0f} us in the median, {rare:.0f} us at 99.9 %")


START = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])

if __name__ == "__main__":
    main(*(kind(value) for kind, value in zip((str, int), sys.argv[1:], strict=False)))
