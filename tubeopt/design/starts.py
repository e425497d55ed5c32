"""Where the joint values of free poses begin: at the best of many random ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError, SolveError
from ..robots.limits import JointLimits
from ..robots.tubes import Tube
from ..typing import Array
from .layout import FreePose
from .pose import Pose, solve_pose
from .program import Program
from .requirements import Avoid


def with_joints(program: Program, design: Array, random: np.random.Generator) -> Array:
    """A start (X,) with these dimensions (D,), every free pose at the best of random joint values."""
    layout = program.layout
    x = np.clip(np.zeros(layout.size), program.lower, program.upper)
    x[: layout.designs] = design
    if not layout.free_poses:
        return x
    try:
        tubes = layout.space.tubes(design)
    except InputError:
        return x
    joints, poses = _sample(tubes, program.task.robot.joint_limits, random, program.task.solver.starts.poses)
    if not poses:
        return x
    tips = np.array([pose.arm.position[-1] for pose in poses])
    penalty = _outside(program, poses)
    turned = np.zeros(len(poses))
    for index, target in program.targets.items():
        pose = layout.poses[index]
        assert isinstance(pose, FreePose)
        best = int(np.argmin(_gap(tips, target) + penalty + program.task.solver.starts.pose_turn * turned))
        turned = np.array([np.abs((row - joints[best])[: layout.n]).max() for row in joints])
        x[layout.joints(pose)[0]], x[layout.joints(pose)[1]] = np.split(joints[best], 2)
        program.guesses[index] = poses[best].twist
    return np.clip(x, program.lower, program.upper)


def _gap(tips: Array, target: tuple[float, ...]) -> Array:
    """Distance of tips (N, 3) from a point, or from a height where that is all that is given."""
    return np.abs(tips[:, 2] - target[0]) if len(target) == 1 else np.linalg.norm(tips - np.array(target), axis=1)


def _sample(
    tubes: tuple[Tube, ...], limits: JointLimits | None, random: np.random.Generator, count: int
) -> tuple[list[Array], list[Pose]]:
    """Joint values (2 n,), rotations then beta, with carriages and ends in order, within the limits of translations
    where that leaves a range, and their poses."""
    n = len(tubes)
    length = np.array([tube.length for tube in tubes])
    straight = np.array([tube.straight_length for tube in tubes])
    joints: list[Array] = []
    poses: list[Pose] = []
    for _ in range(count):
        rotations = random.uniform(-np.pi, np.pi, n)
        beta = np.zeros(n)
        ahead, behind = 0.0, 0.0
        for i in reversed(range(n)):
            # beta_i <= beta_{i+1}, end_i >= end_{i+1}
            low, high = max(-length[i] + behind, -length[i]), ahead
            if limits is not None:
                first, last = np.array(limits.translations[i]) - straight[i]
                low, high = max(low, first), min(high, last)
            beta[i] = random.uniform(low, high) if high > low else high
            ahead, behind = beta[i], max(beta[i] + length[i], 0.0)
        try:
            solved = solve_pose(tubes, rotations, beta + straight)
        except (InputError, SolveError):
            continue
        if solved.margin > 0:
            joints.append(np.concatenate([rotations, beta]))
            poses.append(Pose(solved))
    return joints, poses


def _outside(program: Program, poses: Sequence[Pose]) -> Array:
    """(N,) how far, m, the worst point of each arm is where it must not be."""
    out = np.zeros(len(poses))
    for one in program.task.requirements:
        for k, pose in enumerate(poses):
            if isinstance(one, Avoid):
                out[k] += max(0.0, one.clearance - float(one.signed_distance(pose.arm.position).min()))
    return out
