"""Room between the tubes: the tilt in closed form against convex programs of a beam in a pipe, and the arm it makes."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import tubeopt
from tests.examples import MM, THESIS
from tubeopt import ConcentricRobot, InputError, Piece, Tube, clearance_correction, forward_kinematics
from tubeopt.typing import Array
from tubeopt.validation import FitOptions, Measurements, fit, validate

PAIR = ConcentricRobot(
    (Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 9.0), Tube(1.5 * MM, 1.1 * MM, 70 * MM, 60 * MM, 5.0))
)
"""Two tubes with a radial clearance of 50 um."""

STEP = 0.1
"""Of the programs, in units of sqrt(clearance / mismatch)."""


def beam_in_pipe(mismatch: Array) -> tuple[Array, Array]:
    """Slope (2,) and place (2,) at the free end of the beam that differs least from being bent by `mismatch` (N, 2)
    within a pipe of radius 1, behind which it goes on straight: an own convex program."""
    desired = np.vstack([np.zeros((60, 2)), mismatch])
    program = ca.Opti()
    y = program.variable(2, len(desired) + 2)
    bent = (y[:, 2:] - 2 * y[:, 1:-1] + y[:, :-2]) / STEP**2
    program.minimize(ca.sumsqr(bent - desired.T) * STEP)
    program.subject_to(ca.sum1(y**2).T <= 1)
    program.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-9})
    result = np.array(program.solve().value(y)).T
    return (result[-1] - result[-2]) / STEP, result[-1]


@pytest.mark.parametrize("length", [0.5, 1.5, 6.0, 15.0])
def test_tilt_is_that_of_a_beam_in_a_pipe(length: float) -> None:
    mismatch = np.tile([1.0, 0.0], (round(length / STEP), 1))
    slope, position = beam_in_pipe(mismatch)
    assert slope[0] == pytest.approx(min(np.sqrt(3.0), length), rel=0.06)
    assert slope[1] == pytest.approx(0, abs=1e-4)
    if length > 4:
        assert position[0] == pytest.approx(1, abs=1e-4)


def test_no_beam_is_tilted_more_than_the_bound() -> None:
    """In one plane, with mismatches of every sign that jump as they like: it is proved there; and turning in space."""
    random, steep = np.random.default_rng(0), []
    for k in range(12):
        ends = np.sort(random.uniform(0, 80, 3)).astype(int)
        size = np.repeat(random.uniform(-1, 1, 4), np.diff([0, *ends, 80]))
        angle = (k % 2) * random.uniform(0, 1.5) * np.arange(80) * STEP
        mismatch = size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        slope, _ = beam_in_pipe(mismatch)
        steep.append(np.linalg.norm(slope) / np.sqrt(np.abs(size).max()))
    assert max(steep) < 2 * np.sqrt(2)
    assert max(steep) > 1.0


def test_arm_is_turned_beyond_the_end_of_the_outer_tube() -> None:
    """Tubes turned alike stay in one plane: mismatch, tilt and places by hand."""
    pose = forward_kinematics(PAIR, [0.3, 0.3], [0.0, 0.0])
    result = clearance_correction(pose)
    (leaving,) = result.leavings
    inner, outer = (tube.bending_stiffness for tube in PAIR.tubes)
    fraction, room = outer / (inner + outer), 0.05 * MM
    assert (leaving.tube, leaving.clearance) == (1, pytest.approx(room))
    assert leaving.arc_length == pytest.approx(60 * MM)
    assert leaving.mismatch == pytest.approx(4.0)
    assert leaving.contact == pytest.approx(np.sqrt(12 * room / 4))
    # Tubes of rotation 0 bend about x, so those of 0.3 about (cos 0.3, sin 0.3), and go towards (sin 0.3, -cos 0.3).
    axis = np.array([np.cos(0.3), np.sin(0.3), 0.0])
    np.testing.assert_allclose(leaving.turn, fraction * np.sqrt(3 * room * 4) * axis, atol=1e-9)
    start = int(np.searchsorted(pose.arc_length, 60 * MM))
    sideways = np.cross(axis, pose.frame[start, :, 2])
    np.testing.assert_allclose(leaving.shift, fraction * room * sideways, atol=1e-9)
    moved = np.cross(leaving.turn, pose.tip_position - pose.position[start]) + leaving.shift
    np.testing.assert_allclose(result.tip_position, pose.tip_position + moved, atol=1e-12)
    np.testing.assert_array_equal(result.position[: start + 1], pose.position[: start + 1])
    assert np.linalg.norm(moved) < result.tip_radius
    bent = np.linalg.norm(result.tip_position[:2]) - np.linalg.norm(pose.tip_position[:2])
    assert bent > 0  # the inner tube, which is bent more, gets its way


def test_tubes_of_pieces_tilt_alike() -> None:
    pieces = tuple(
        Tube.of_pieces(
            t.outer_diameter, t.inner_diameter, [Piece(t.curved_length, t.curvature)], straight_length=t.straight_length
        )
        for t in PAIR.tubes
    )
    plain, general = (
        clearance_correction(forward_kinematics(robot, [0.0, 1.2], [-5 * MM, 0.0]))
        for robot in (PAIR, replace(PAIR, tubes=pieces))
    )
    np.testing.assert_allclose(general.tip_position, plain.tip_position, atol=1e-8)
    np.testing.assert_allclose(general.tip_rotation, plain.tip_rotation, atol=1e-7)


def test_three_tubes_tilt_at_two_ends_and_none_without_room() -> None:
    pose = forward_kinematics(THESIS, [0.0, 1.0, 2.0])
    assert [leaving.tube for leaving in clearance_correction(pose, 20e-6).leavings] == [2, 1]
    still = clearance_correction(pose, 0.0)
    np.testing.assert_array_equal(still.position, pose.position)
    assert still.tip_radius == 0


def test_tubes_that_go_on_around_one_that_ended_stay_where_they_are() -> None:
    withdrawn = forward_kinematics(PAIR, [0.3, -0.4], [-40 * MM, 0.0])
    result = clearance_correction(withdrawn)
    assert not result.leavings
    np.testing.assert_array_equal(result.position, withdrawn.position)


def test_file_tells_of_clearance(tmp_path: object) -> None:
    path = f"{tmp_path}/robot.yaml"
    replace(PAIR, clearance=(0.03 * MM,)).save(path)
    assert tubeopt.load_robot(path).clearance == (0.03 * MM,)  # type: ignore[attr-defined]


def test_clearance_is_found_by_a_fit() -> None:
    random = np.random.default_rng(1)
    rotations, translations = random.uniform(-3, 3, (40, 2)), random.uniform([-30 * MM, -10 * MM], 0.0, (40, 2))
    translations[:, 0] += 20 * MM
    true = replace(PAIR, clearance=(0.03 * MM,))
    tips = [
        clearance_correction(forward_kinematics(true, a, d)).tip_position
        for a, d in zip(rotations, translations, strict=True)
    ]
    data = Measurements(rotations, translations, np.array(tips) + random.normal(0, 0.02 * MM, (40, 3)))
    assert validate(true, data).summary.rms < 0.05 * MM < 0.3 * MM < validate(PAIR, data).summary.rms
    fitted = fit(PAIR, data, ["clearance_1"], FitOptions(folds=0))
    assert fitted.estimates[0].low < 0.03 * MM < fitted.estimates[0].high
    assert fitted.robot.clearance == (fitted.estimates[0].value,)  # type: ignore[attr-defined]


def test_wrong_input() -> None:
    pose = forward_kinematics(PAIR, [0.0, 0.0])
    with pytest.raises(InputError, match="clearance is 2 numbers; the robot has 2 tubes, so it must be 1"):
        clearance_correction(pose, [1e-5, 1e-5])
    with pytest.raises(InputError, match="clearance"):
        replace(PAIR, clearance=(-1e-5,))
    eccentric = tubeopt.load_robot("configs/robots/thesis_etr.yaml")
    with pytest.raises(InputError, match="robot is eccentric"):
        clearance_correction(forward_kinematics(eccentric, [0.0, 0.0, 0.0]), 1e-5)
