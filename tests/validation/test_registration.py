"""Registration: a known motion is found exactly, whatever the motion; what cannot be told is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from tubeopt import InputError
from tubeopt.validation import BasePose, register
from tubeopt.validation.registration import MeasuredDirections

RANDOM = np.random.default_rng(2)
POINTS = RANDOM.uniform(-0.04, 0.04, (12, 3)) + np.array([0.0, 0.0, 0.09])
ANGLE = st.floats(-np.pi, np.pi)
PLACE = st.floats(-1.0, 1.0)


@given(st.tuples(ANGLE, ANGLE, ANGLE), st.tuples(PLACE, PLACE, PLACE))
def test_a_rigid_motion_is_recovered_exactly(turn: tuple[float, ...], place: tuple[float, ...]) -> None:
    motion = Rotation.from_rotvec(turn)
    result = register(motion.apply(POINTS) + place, POINTS)
    np.testing.assert_allclose(result.rotation @ motion.as_matrix(), np.eye(3), atol=1e-13)
    np.testing.assert_allclose(result.apply(motion.apply(POINTS) + place), POINTS, atol=1e-14)


def test_points_in_a_plane_are_turned_and_not_mirrored() -> None:
    flat = POINTS * [1.0, 1.0, 0.0]
    motion = Rotation.from_rotvec([0.3, -2.0, 1.0])
    result = register(motion.apply(flat), flat)
    np.testing.assert_allclose(result.rotation, motion.as_matrix().T, atol=1e-12)
    mirrored = register(POINTS * [-1.0, 1.0, 1.0], POINTS)
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1.0)


def test_no_other_motion_is_closer() -> None:
    measured = POINTS + RANDOM.normal(0, 2e-3, POINTS.shape)
    result = register(measured, POINTS)
    best = ((result.apply(measured) - POINTS) ** 2).sum()

    def squares(x: np.ndarray) -> float:
        moved = Rotation.from_rotvec(x[:3]).apply(measured) + x[3:] * 0.1
        return float(((moved - POINTS) ** 2).sum() / best)

    other = min(minimize(squares, RANDOM.normal(0, 0.3, 6), tol=1e-14).fun for _ in range(3))
    assert other == pytest.approx(1.0, abs=1e-8)


@given(ANGLE, st.tuples(PLACE, PLACE, st.floats(-0.9, 1.0)), st.tuples(PLACE, PLACE, PLACE))
@example(0.0, (5e-324, 5e-324, -0.5), (0.0, 0.0, 0.0))
@example(0.0, (0.0, 1.0793177668514686e-159, -0.5), (0.0, 0.0, 0.0))
def test_the_yaw_about_a_known_base_is_recovered_exactly(
    yaw: float, axis: tuple[float, ...], place: tuple[float, ...]
) -> None:
    if np.linalg.norm(axis) < 1e-3:
        axis = (0.0, 0.0, 1.0)
    if np.hypot(*axis[:2]) < 1e-9:  # of opposite vectors that are not quite so SciPy turns one beside the other
        axis = (0.0, 0.0, axis[2])
    up, _ = Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])
    to_device = up * Rotation.from_rotvec([0.0, 0.0, yaw])
    measured = to_device.apply(POINTS) + place
    result = register(measured, POINTS, "base-axis", base=BasePose(place, axis))
    np.testing.assert_allclose(result.apply(measured), POINTS, atol=1e-12)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_an_axis_along_or_against_z(z: float) -> None:
    result = register(POINTS * [1.0, z, z], POINTS, "base-axis", base=BasePose(axis=(0.0, 0.0, z)))
    np.testing.assert_allclose(result.apply(POINTS * [1.0, z, z]), POINTS, atol=1e-14)


@pytest.mark.parametrize("angle", [60.0, 120.0, 180.0])
def test_directions_decide_the_yaw_where_an_axis_is_wrong(angle: float) -> None:
    """Of all that is matched the best rotation about the axis agrees; of tips alone it may not."""
    directions = RANDOM.normal(size=POINTS.shape) * [1.0, 1.0, 0.2]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    off = Rotation.from_euler("x", angle, degrees=True).apply([0.0, 0.0, 1.0])
    result = register(
        POINTS,
        POINTS,
        "base-axis",
        base=BasePose(axis=tuple(off)),
        directions=MeasuredDirections(directions, directions),
    )
    np.testing.assert_allclose(result.rotation @ off, [0.0, 0.0, 1.0], atol=1e-9)


def test_yaw_and_tilt() -> None:
    result = register(Rotation.from_euler("z", -30, degrees=True).apply(POINTS), POINTS)
    assert np.degrees([result.yaw, result.tilt]) == pytest.approx([30.0, 0.0], abs=1e-6)
    result = register(Rotation.from_euler("x", 20, degrees=True).apply(POINTS), POINTS)
    assert np.degrees([result.yaw, result.tilt]) == pytest.approx([0.0, 20.0], abs=1e-9)


def test_none_leaves_everything_where_it_is() -> None:
    result = register(POINTS + 1.0, POINTS, "none")
    np.testing.assert_array_equal(result.apply(POINTS), POINTS)


def test_what_cannot_be_told_is_refused() -> None:
    line = np.outer(np.linspace(0, 1, 5), [0.0, 0.0, 0.1])
    with pytest.raises(InputError, match="lie on a line"):
        register(line, line)
    with pytest.raises(InputError, match="needs at least 3"):
        register(POINTS[:2], POINTS[:2])
    with pytest.raises(InputError, match="all rotations about the axis fit alike, as of tips on the axis"):
        register(line, line, "base-axis")
    with pytest.raises(InputError, match=r"registration is 'rigd'.*did you mean 'rigid'"):
        register(POINTS, POINTS, "rigd")
    with pytest.raises(InputError, match=r"base axis is \(0, 0, 0\)"):
        BasePose(axis=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="base position has 2 numbers"):
        BasePose(position=(0.0, 0.0))
