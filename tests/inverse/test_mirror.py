"""Mirror actuation: the map, its six assignments, its inverse for a bend and for a tip, and several segments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.examples import CONFIGS, DEG, MM
from tubeopt import (
    EccentricRobot,
    Equilibrium,
    InputError,
    SegmentedEccentricRobot,
    Tube,
    forward_kinematics,
    load_robot,
)
from tubeopt.inverse import mirror
from tubeopt.inverse.mirror import (
    ASSIGNMENTS,
    STRAIGHT,
    MirrorPose,
    arc_curvature,
    mirror_inverse,
    mirror_pose,
    mirror_rotations,
    mirror_to_tip,
    permuted_tips,
    segment_curvatures,
)

ETR = load_robot(CONFIGS / "thesis_etr.yaml")
assert isinstance(ETR, EccentricRobot)
CENTRED = replace(ETR, offset=0.0)
MIRRORED = EccentricRobot(replace(ETR.tube, curvature=-ETR.tube.curvature))
HELD = replace(ETR, offset=1.4 * MM, transmission_length=0.06)


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ((0, 1, 2), (40, 65, 15)),
        ((0, 2, 1), (40, 15, 65)),
        ((1, 0, 2), (65, 40, 15)),
        ((1, 2, 0), (15, 40, 65)),
        ((2, 0, 1), (65, 15, 40)),
        ((2, 1, 0), (15, 65, 40)),
    ],
)
def test_the_six_assignments(assignment: tuple[int, ...], expected: tuple[float, ...]) -> None:
    assert mirror_rotations(40 * DEG, 25 * DEG, assignment) / DEG == pytest.approx(expected)
    assert assignment in ASSIGNMENTS


def test_what_is_no_actuation() -> None:
    with pytest.raises(InputError, match=r"^assignment is \(0, 1, 1\); it must name the tubes 0, 1 and 2 once each$"):
        mirror_rotations(0.0, 0.0, (0, 1, 1))
    with pytest.raises(InputError, match=r"^separation is nan; it must be a finite number$"):
        mirror_rotations(0.0, float("nan"))


@pytest.mark.parametrize("separation", [0.0, 30.0, 75.0, 110.0])
@pytest.mark.parametrize("direction", [0.0, 90.0, 200.0, -50.0])
def test_the_arm_bends_a_quarter_turn_behind_its_direction(direction: float, separation: float) -> None:
    solved = forward_kinematics(CENTRED, mirror_rotations(direction * DEG, separation * DEG))
    azimuth = np.arctan2(solved.tip_position[1], solved.tip_position[0]) / DEG
    assert (azimuth - (direction - 90) + 180) % 360 == pytest.approx(180, abs=1e-6)
    across = np.array([np.cos(direction * DEG), np.sin(direction * DEG), 0.0])
    assert solved.position @ across == pytest.approx(np.zeros(len(solved.position)), abs=1e-10)


def test_curvature_of_an_arc_is_its_own() -> None:
    solved = forward_kinematics(CENTRED, mirror_rotations(90 * DEG, 0.0))
    assert arc_curvature(solved) == pytest.approx([1 / 0.12, 0.0], rel=1e-12, abs=1e-12)
    pushed = replace(CENTRED, transmission_length=0.02)
    ahead = forward_kinematics(pushed, mirror_rotations(90 * DEG, 0.0), np.full(3, 0.015))
    assert ahead.tip_position[2] == pytest.approx(solved.tip_position[2] + 0.015)
    assert arc_curvature(ahead) == pytest.approx([1 / 0.12, 0.0], rel=1e-12, abs=1e-12)


def test_largest_deviation_of_the_permutations() -> None:
    """0.0138 mm near a separation of 40 deg, where the thesis' Figure 3.9 says 0.36 mm."""
    separations = np.arange(0.0, 121.0, 10.0)
    worst = []
    for separation in separations:
        gaps = [
            np.linalg.norm(tips - reference, axis=1).max()
            for tips, reference in (permuted_tips(ETR, d * DEG, separation * DEG) for d in range(0, 120, 20))
        ]
        worst.append(max(gaps) / MM)
    assert max(worst) == pytest.approx(0.0138, abs=5e-5)
    assert separations[int(np.argmax(worst))] == 40


def test_permutations_change_nothing_on_the_centreline() -> None:
    tips, reference = permuted_tips(CENTRED, 0.3, 40 * DEG)
    assert tips == pytest.approx(np.tile(reference, (6, 1)), abs=1e-13)


@given(azimuth=st.floats(-7.0, 7.0), share=st.floats(0.0, 0.99), which=st.sampled_from([ETR, CENTRED, MIRRORED, HELD]))
@settings(max_examples=25)
def test_inverse_for_a_bend(azimuth: float, share: float, which: EccentricRobot) -> None:
    desired = share / 0.12
    result = mirror_inverse(which, azimuth, desired)
    reached = arc_curvature(forward_kinematics(which, result.rotations))
    assert reached == pytest.approx(desired * np.array([np.cos(azimuth), np.sin(azimuth)]), abs=1e-7)
    assert result.rotations == pytest.approx(mirror_rotations(result.direction, result.separation))
    assert 0 <= result.separation <= STRAIGHT + 1e-12
    assert result.error < 1e-7


def test_inverse_starts_from_the_law_and_improves_on_it() -> None:
    result = mirror_inverse(ETR, 0.0, 5.0)
    law = np.arccos((3 * 5.0 * 0.12 - 1) / 2)
    assert result.direction == pytest.approx(np.pi / 2, abs=1e-3)
    assert abs(result.separation - law) > 1 * DEG


def test_a_straight_arm_keeps_the_direction_that_was_asked_for() -> None:
    result = mirror_inverse(ETR, 1.0, 0.0)
    assert result.separation == pytest.approx(STRAIGHT, abs=1e-9)
    assert result.direction == pytest.approx(1.0 + np.pi / 2)
    assert result.equilibrium.tip_position == pytest.approx([0, 0, 94 * MM], abs=1e-9)


@pytest.mark.parametrize("assignment", ASSIGNMENTS)
def test_inverse_for_every_assignment(assignment: tuple[int, ...]) -> None:
    result = mirror_inverse(ETR, 0.4, 6.0, assignment=assignment)
    assert result.rotations == pytest.approx(mirror_rotations(result.direction, result.separation, assignment))
    assert np.linalg.norm(arc_curvature(result.equilibrium)) == pytest.approx(6.0, abs=1e-9)


def test_more_than_the_precurvature_is_refused() -> None:
    with pytest.raises(InputError, match=r"curvature is 9 per m; towards 30 deg it must be at most 8\.33298 per"):
        mirror_inverse(ETR, 30 * DEG, 9.0)
    with pytest.raises(InputError, match=r"^curvature is -1; it must be at least 0$"):
        mirror_inverse(ETR, 0.0, -1.0)
    largest = float(np.linalg.norm(arc_curvature(forward_kinematics(ETR, [0.0, 0.0, 0.0]))))
    assert mirror_inverse(ETR, -np.pi / 2, largest).separation == pytest.approx(0.0, abs=1e-3)


@given(direction=st.floats(-np.pi, np.pi), separation=st.floats(0.0, 2.0), which=st.sampled_from([ETR, MIRRORED, HELD]))
@settings(max_examples=25)
def test_inverse_for_a_tip(direction: float, separation: float, which: EccentricRobot) -> None:
    tip = forward_kinematics(which, mirror_rotations(direction, separation)).tip_position
    result = mirror_to_tip(which, tip)
    assert result.error < 1e-8
    assert forward_kinematics(which, result.rotations).tip_position == pytest.approx(tip, abs=1e-8)
    assert result.separation == pytest.approx(separation, abs=1e-3)


def test_inverse_in_front_of_the_plate() -> None:
    robot, shift = replace(ETR, transmission_length=0.05), np.full(3, 0.03)
    tip = forward_kinematics(robot, mirror_rotations(1.0, 0.8), shift).tip_position
    result = mirror_to_tip(robot, tip, translations=shift)
    assert (result.direction, result.separation) == pytest.approx((1.0, 0.8), abs=1e-6)
    behind = np.full(3, -0.04)
    tip = forward_kinematics(robot, mirror_rotations(1.0, 0.8), behind).tip_position
    assert mirror_to_tip(robot, tip, translations=behind).separation == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize("separation", [0.4, 1.2, 1.9])
def test_exact_derivatives_need_few_equilibria(separation: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without derivatives a search takes 15 to 20 equilibria; wrong ones would not converge in ten."""
    solved = forward_kinematics(ETR, mirror_rotations(0.7, separation))
    drawn = forward_kinematics(ETR, mirror_rotations(0.7, separation), np.full(3, -0.02))
    bend = arc_curvature(solved)
    calls: list[int] = []

    def counted(*args: Any) -> Equilibrium:
        calls.append(1)
        return forward_kinematics(*args)

    monkeypatch.setattr(mirror, "forward_kinematics", counted)
    for search in (
        lambda: mirror_to_tip(ETR, solved.tip_position),
        lambda: mirror_pose(ETR, drawn.tip_position),
        lambda: mirror_inverse(ETR, float(np.arctan2(bend[1], bend[0])), float(np.linalg.norm(bend))),
    ):
        calls.clear()
        assert search().separation == pytest.approx(separation, abs=1e-6)
        assert len(calls) <= 10


@pytest.mark.parametrize("distance", [1e-5, 1e-4, 2e-3])
def test_a_target_off_the_surface(distance: float) -> None:
    solved = forward_kinematics(ETR, mirror_rotations(0.6, 0.9))
    tips = [forward_kinematics(ETR, mirror_rotations(0.6 + a, 0.9 + b)).tip_position for a, b in ((1e-4, 0), (0, 1e-4))]
    normal = np.cross(tips[0] - solved.tip_position, tips[1] - solved.tip_position)
    target = solved.tip_position + distance * normal / np.linalg.norm(normal)
    with pytest.raises(InputError, match=rf"^position is {distance * 1e3:.3g}\d* mm off the surface"):
        mirror_to_tip(ETR, target)
    near = mirror_to_tip(ETR, target, tolerance=2 * distance)
    assert near.error == pytest.approx(distance, rel=1e-3)
    assert near.equilibrium.tip_position == pytest.approx(solved.tip_position, abs=1e-3 * distance + 1e-9)


@pytest.mark.parametrize("target", [(0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0.0, 0.0, -0.1), (0.2, 0.0, 0.01)])
def test_targets_far_away(target: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"mm off the surface that the tip can reach"):
        mirror_to_tip(ETR, target)


def test_nothing_to_bend() -> None:
    with pytest.raises(InputError, match=r"tubes are straight and cannot bend"):
        mirror_inverse(EccentricRobot(Tube(1e-3, 0.8e-3, 0.0, 0.1, 0.0)), 0.0, 1.0)
    with pytest.raises(InputError, match=r"behind the base plate"):
        mirror_to_tip(ETR, (0.0, 0.0, 0.0), translations=np.full(3, -0.094))


# --- several segments ---

THREE = load_robot(CONFIGS / "example_three_segment_etr.yaml")
assert isinstance(THREE, SegmentedEccentricRobot)
TWO = replace(THREE, segments=THREE.segments[1:])
ADVANCED = {TWO: np.repeat([0.08, 0.025], 3), THREE: np.repeat([0.125, 0.08, 0.03], 3)}
"""Translations with a straight part between the segments, m."""
ACTUATIONS = (((20.0, -130.0, 75.0), (50.0, 80.0, 20.0)), ((-170.0, 10.0, 100.0), (110.0, 35.0, 65.0)))
"""Directions and separations, deg."""


def posed(robot: SegmentedEccentricRobot, which: int) -> Equilibrium:
    """Arm of two or three segments under a mirror actuation."""
    direction, separation = (np.radians(each)[: len(robot.segments)] for each in ACTUATIONS[which])
    return forward_kinematics(robot, mirror_rotations(direction, separation), ADVANCED[robot])


def is_mirrored(pose: MirrorPose) -> bool:
    """Whether two tubes of each segment turn by opposite angles from the third."""
    middle, ahead, behind = pose.rotations.reshape(-1, 3).T
    return bool(np.allclose(ahead + behind, 2 * middle, atol=1e-12) and np.all(ahead - middle >= -1e-12))


def test_rotations_of_segments() -> None:
    both = mirror_rotations([0.3, -1.0], [0.5, 2.0], (1, 0, 2))
    assert both == pytest.approx([*mirror_rotations(0.3, 0.5, (1, 0, 2)), *mirror_rotations(-1.0, 2.0, (1, 0, 2))])
    with pytest.raises(InputError, match=r"^separation has 1 numbers; it must be 2 numbers \(one per segment\)$"):
        mirror_rotations([0.3, -1.0], [0.5])


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("robot", [TWO, THREE], ids=["two", "three"])
def test_inverse_for_the_bend_of_every_segment(robot: SegmentedEccentricRobot, which: int) -> None:
    bend = segment_curvatures(posed(robot, which))
    pose = mirror_inverse(
        robot, np.arctan2(bend[:, 1], bend[:, 0]), np.linalg.norm(bend, axis=1), translations=ADVANCED[robot]
    )
    reached = forward_kinematics(robot, pose.rotations, pose.translations)
    assert segment_curvatures(reached) == pytest.approx(bend, abs=1e-9)
    # The bends have one actuation, the one that they came from.
    assert np.degrees(pose.separation) == pytest.approx(ACTUATIONS[which][1][: len(bend)], abs=1e-6)
    assert reached.tip_position == pytest.approx(posed(robot, which).tip_position, abs=1e-9)
    assert is_mirrored(pose)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("robot", [TWO, THREE], ids=["two", "three"])
def test_poses_of_segments(robot: SegmentedEccentricRobot, which: int) -> None:
    wanted = posed(robot, which)
    tip, axis = wanted.tip_position, wanted.tip_rotation[:, 2]
    held = mirror_to_tip(robot, tip, translations=ADVANCED[robot], tolerance=1e-9)
    assert held.translations == pytest.approx(ADVANCED[robot], abs=1e-15)
    free, aimed = mirror_pose(robot, tip), mirror_pose(robot, tip, direction=2 * axis)
    for pose in (held, free, aimed):
        reached = forward_kinematics(robot, pose.rotations, pose.translations)
        assert reached.tip_position == pytest.approx(tip, abs=1e-9)
        assert reached.stable
        assert is_mirrored(pose)
        robot.assembly(pose.translations)  # in the order of the tubes
    assert aimed.equilibrium.tip_rotation[:, 2] == pytest.approx(axis, abs=1e-9)


def test_turning_the_target_turns_all_tubes() -> None:
    """The three places are symmetric: a third of a turn of arm and directions is one of the tip, exactly."""
    wanted, third = posed(TWO, 0), 2 * np.pi / 3
    turn = np.array([[np.cos(third), -np.sin(third), 0], [np.sin(third), np.cos(third), 0], [0, 0, 1]])
    bend = segment_curvatures(wanted)
    size = np.linalg.norm(bend, axis=1)
    azimuth = np.arctan2(bend[:, 1], bend[:, 0])
    # A third of a turn moves tube 1 to the place of tube 2: the roles of the tubes move on too.
    one = mirror_inverse(TWO, azimuth, size, translations=ADVANCED[TWO])
    other = mirror_inverse(TWO, azimuth + third, size, translations=ADVANCED[TWO], assignment=(1, 2, 0))
    assert other.equilibrium.tip_position == pytest.approx(turn @ one.equilibrium.tip_position, abs=1e-10)
    assert other.separation == pytest.approx(one.separation, abs=1e-9)
    # On the centreline every angle is symmetric.
    centred = replace(TWO, offset=0.0)
    rotations = mirror_rotations([0.3, 2.0], [0.8, 1.5])
    before, after = (forward_kinematics(centred, rotations + turned).tip_position for turned in (0.0, third))
    assert after == pytest.approx(turn @ before, abs=1e-11)


def test_bend_of_segments_by_the_law_of_three_vectors() -> None:
    """Tubes of one direction on the centreline bend a segment by kappa EI / (EI + EI of the straight tubes inside)."""
    centred = replace(THREE, offset=0.0)
    bend = segment_curvatures(forward_kinematics(centred, mirror_rotations([np.pi / 2] * 3, [0.0] * 3)))
    stiffness = np.array([tube.bending_stiffness for tube in THREE.segments])
    curvature = np.array([tube.curvature for tube in THREE.segments])
    assert bend[:, 0] == pytest.approx(curvature * stiffness / np.cumsum(stiffness), rel=1e-10)
    assert bend[:, 1] == pytest.approx(0, abs=1e-10)


def test_a_stretched_arm_of_segments() -> None:
    straight = mirror_inverse(THREE, [0.4, -2.0, 1.0], [0.0, 0.0, 0.0])
    assert straight.separation == pytest.approx([STRAIGHT] * 3, abs=1e-6)
    assert straight.equilibrium.tip_position == pytest.approx([0, 0, 0.12], abs=1e-9)


def test_what_segments_cannot_reach() -> None:
    with pytest.raises(InputError, match=r"^curvature of segment 1 is 20 per m; towards 28\.65 deg the search ends at"):
        mirror_inverse(TWO, [0.5, 0.0], [20.0, 1.0], translations=ADVANCED[TWO])
    with pytest.raises(InputError, match=r"^curvature is \[1.0, -1.0\]; every number must be at least 0$"):
        mirror_inverse(TWO, [0.5, 0.0], [1.0, -1.0])
    with pytest.raises(InputError, match=r"^segment 2 is straight or behind the base plate and cannot bend$"):
        mirror_inverse(TWO, [0.5, 0.0], [1.0, 1.0], translations=np.repeat([0.02, -0.05], 3))
    with pytest.raises(InputError, match=r"^position was not reached: the closest tip that was found is .* mm away"):
        mirror_pose(TWO, (0.0, 0.0, 0.3))
    with pytest.raises(InputError, match=r"^direction is given; the mirror actuation of one segment"):
        mirror_pose(ETR, (0.01, 0.0, 0.08), direction=(0.0, 0.0, 1.0))
