"""A pose is the one of forward kinematics, and its derivatives are those of differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.examples import random_robot
from tubeopt import forward_kinematics, snap_free_certificate
from tubeopt.design.pose import FRACTIONS, Pose, Twist, solve_pose
from tubeopt.equilibrium.arm_change import SHAPE_POINTS
from tubeopt.equilibrium.directions import PARAMETERS
from tubeopt.equilibrium.linearised import position_changes, positions_at
from tubeopt.robots.tubes import Tube
from tubeopt.typing import Array

Numbers = dict[str, Array]


def pose_of(numbers: Numbers, guess: Twist | None = None) -> Pose:
    """A pose of tubes that are given by their stiffnesses and lengths alone."""
    n = len(numbers["rotations"])
    tubes = [Tube(1e-4, 0.0, **{name: float(numbers[name][i]) for name in PARAMETERS[2:]}) for i in range(n)]
    return Pose(solve_pose(tubes, numbers["rotations"], numbers["translations"], guess), PARAMETERS)


def random_numbers(seed: int, n: int) -> tuple[Any, Numbers]:
    """A robot that is turned far enough for its margin to fall below 1, withdrawn by a little."""
    random = np.random.default_rng([7, seed])
    while True:
        robot = random_robot(random, n)
        numbers = {name: np.array([getattr(tube, name) for tube in robot.tubes]) for name in PARAMETERS[2:]}
        numbers["rotations"] = random.uniform(-2.5, 2.5, n)
        numbers["translations"] = -random.uniform(0.0, 0.02, n)
        if 0.1 < pose_of(numbers).margin < 0.98:
            return robot, numbers


@pytest.mark.parametrize(("seed", "n"), [(1, 2), (2, 3), (3, 3), (4, 4)])
def test_values_are_those_of_forward_kinematics(seed: int, n: int) -> None:
    robot, numbers = random_numbers(seed, n)
    pose = pose_of(numbers)
    guess = forward_kinematics(robot, numbers["rotations"], numbers["translations"])
    assert np.allclose(pose.arm.position[-1], guess.tip_position, atol=1e-8)
    assert pose.margin == pytest.approx(guess.margin, abs=1e-7)
    assert pose.certificate[0] == pytest.approx(snap_free_certificate(robot, numbers["translations"]), abs=1e-9)


@pytest.mark.parametrize(("seed", "n"), [(1, 2), (2, 3), (3, 3), (4, 4)])
def test_derivatives_are_those_of_differences(seed: int, n: int) -> None:
    _, numbers = random_numbers(seed, n)
    pose = pose_of(numbers)
    of = pose.derivatives
    position, turn = position_changes(of, FRACTIONS), of.tip_rotation[None]
    assert np.allclose(of.tip_position, position[-1], rtol=1e-12, atol=1e-15)
    theta, bend = _section_slopes(pose)
    parts = (position, turn, of.moved, theta, bend, of.one_margin, pose.certificate[1])
    for k, (name, i) in enumerate((name, i) for name in PARAMETERS for i in range(n)):
        size = 1e-6 * (abs(numbers[name][i]) if name in PARAMETERS[2:] else 1.0)
        sides = []
        for sign in (1, -1):
            moved = {key: value.copy() for key, value in numbers.items()}
            moved[name][i] += sign * size
            sides.append(pose_of(moved, pose.guess))
        if sides[0].arm.position.shape != sides[1].arm.position.shape:
            continue  # the mesh itself changes
        changes = [_difference(a, b) / (2 * size) for a, b in zip(_values(sides[0]), _values(sides[1]), strict=True)]
        frame = changes[1] @ pose.arm.frame[-1:].swapaxes(1, 2)
        changes[1] = np.stack([frame[:, 2, 1], frame[:, 0, 2], frame[:, 1, 0]], axis=1)
        for part, change in zip(parts, changes, strict=True):
            floor = 1e-7 * max(1.0, 1e-9 / size)
            assert np.allclose(part[..., k], change, rtol=2e-4, atol=2e-4 * np.abs(change).max() + floor), (name, i)


def _values(pose: Pose) -> tuple[Array, ...]:
    scalars = (np.array(pose.margin), np.array(pose.certificate[0]))
    theta, bend = pose.derivatives.sections
    return (
        positions_at(pose.derivatives, FRACTIONS),
        pose.arm.frame[-1:],
        pose.arm.arc_length,
        theta[..., : len(pose.solved.member.rotations)],
        bend,
        *scalars,
    )


def _section_slopes(pose: Pose) -> tuple[Array, Array]:
    """(P, 5, n, L) of theta and (P, 5, 2, L) of the curvature where each piece is divided."""
    of, n = pose.derivatives, len(pose.solved.member.rotations)
    results = [
        [of.section(k, x, of.moved[4 * k + j]) for j, x in enumerate(SHAPE_POINTS)] for k in range(of.arm.elements)
    ]
    parts = (
        [[part(one) for one in row] for row in results] for part in (lambda s: s.by_tubes[:n], lambda s: s.by_curvature)
    )
    theta, bend = (np.array(part) for part in parts)
    return theta, bend


def _difference(a: Array, b: Array) -> Array:
    return np.asarray(a - b)
