"""The eccentric robot: published and independent numbers, its tubes' own lines, and robots of several segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.eccentric_reference import rows, rows_of, shoot, stepped_tip, thesis_slope
from tests.examples import CONFIGS, DEG, MM
from tubeopt import (
    Discretisation,
    EccentricRobot,
    InputError,
    SegmentedEccentricRobot,
    SolveError,
    Tube,
    forward_kinematics,
    load_robot,
    snap_free_certificate,
)
from tubeopt.block.transcription.buffered import section_function
from tubeopt.equilibrium.centrelines import chained_approximation, tube_centrelines, tube_lengths
from tubeopt.inverse.mirror import mirror_rotations
from tubeopt.typing import Array

ETR = load_robot(CONFIGS / "thesis_etr.yaml")
THREE = load_robot(CONFIGS / "example_three_segment_etr.yaml")
assert isinstance(ETR, EccentricRobot)
assert isinstance(THREE, SegmentedEccentricRobot)
OFFSET = 1.92 * MM / np.sqrt(3)
HOME = (90 * MM, 50 * MM, 0.0)

PUBLISHED = (
    # rotations (deg), tip (mm) as printed in the design
    ((0.0, 60.0, -60.0), (-0.010740, -26.203816, 88.841325)),
    ((0.0, 90.0, -90.0), (-0.000830, -14.275581, 92.492035)),
    ((30.0, 100.0, -20.0), (15.192196, -21.253945, 88.872703)),
)

POSES = (
    # direction and separation (deg) of each segment, inner to outer
    ((150.0, 0.0), (-70.0, 15.0), (80.0, 10.0)),
    ((10.0, 70.0), (200.0, 40.0), (-95.0, 60.0)),
    ((0.0, 120.0), (60.0, 120.0), (-30.0, 120.0)),
)


def mirrored(pose: tuple[tuple[float, float], ...]) -> Array:
    return np.concatenate([mirror_rotations(*np.radians(pair)) for pair in pose])


# --- one segment ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rotations", "tip"), PUBLISHED)
def test_published_tips(rotations: tuple[float, ...], tip: tuple[float, ...]) -> None:
    alpha = np.array(rotations) * DEG
    tubes = rows((ETR.tube,), (0.0,), OFFSET)
    answer = shoot(tubes, alpha)
    solved = forward_kinematics(ETR, alpha)
    assert solved.tip_position == pytest.approx(answer.tip, abs=1e-11)
    assert solved.tip_position / MM == pytest.approx(tip, abs=3e-5)
    # What is left is the shape's integration in 200 steps, each with its mean curvature: it gives every printed digit.
    assert stepped_tip(tubes, answer, 200) / MM == pytest.approx(tip, abs=5.5e-7)
    assert stepped_tip(tubes, answer, 800) == pytest.approx(answer.tip, abs=2e-9)


@pytest.mark.parametrize(("separation", "radius"), [(0, 34.971), (30, 32.864), (60, 26.204), (90, 14.276)])
def test_radii_of_the_four_circles(separation: float, radius: float) -> None:
    for direction in range(0, 360, 60):
        tip = forward_kinematics(ETR, mirror_rotations(direction * DEG, separation * DEG)).tip_position
        # Circles are round to the offset's effect, 0.013 mm; the published ones are those of direction 0.
        tolerance = 1e-3 if direction == 0 else 0.02
        assert np.hypot(*tip[:2]) / MM == pytest.approx(radius, abs=tolerance)


@pytest.mark.parametrize("transmission", [0.0, 0.05])
def test_random_rotations_against_shooting(transmission: float) -> None:
    robot = replace(ETR, transmission_length=transmission)
    random = np.random.default_rng(4)
    tube = replace(ETR.tube, straight_length=transmission)
    for _ in range(4):
        alpha = random.uniform(-1.2, 1.2, 3)
        answer = shoot(rows((tube,), (0.0,), OFFSET), alpha)
        solved = forward_kinematics(robot, alpha)
        assert solved.tip_position == pytest.approx(answer.tip, abs=1e-10)
        assert solved.tip_rotation == pytest.approx(answer.frame, abs=1e-9)
        assert solved.tip_rotations == pytest.approx(answer.end_rotation, abs=1e-9)


def test_right_hand_side_of_the_thesis() -> None:
    random = np.random.default_rng(331)
    count = 100
    theta, slope = random.uniform(-np.pi, np.pi, (count, 3)), random.uniform(-30.0, 30.0, (count, 3))
    bend, nu, kb = ETR.tube.curvature, ETR.tube.material.poisson_ratio, ETR.tube.bending_stiffness
    position = np.full(3, OFFSET), np.array([0.0, 120.0, -120.0]) * DEG
    balance = section_function("balance", count, 3, True)
    moment, _, _, stretch, stretched = balance(
        theta, np.full((count, 3), kb), np.full((count, 3), kb * bend), *position
    )
    # theta' = g w and w' = M / GJ, so theta'' = g' w + g M / GJ with g' = dg/dtheta theta'.
    change = np.einsum("kji,kj->ki", stretched.reshape(count, 3, 3), slope)
    ours = change * slope / stretch + stretch * moment / ETR.tube.torsional_stiffness
    thesis = np.array([thesis_slope(*state, bend, OFFSET, nu) for state in zip(theta, slope, strict=True)])
    assert np.abs(ours - thesis).max() < 1e-9 * np.abs(thesis).max()
    assert ours == pytest.approx(thesis, abs=1e-9, rel=1e-9)


def test_straight_pose_is_not_singular() -> None:
    for direction in (0.0, 0.7, -2.0):
        straight = forward_kinematics(ETR, mirror_rotations(direction, 120 * DEG), verify=True)
        assert straight.tip_position == pytest.approx([0, 0, 94 * MM], abs=1e-9)
        assert straight.stable
        derivatives = straight.jacobian()
        for part in (derivatives.position, derivatives.rotation, derivatives.tip_rotations):
            assert np.isfinite(part).all()
        assert np.linalg.norm(derivatives.position[:2, :3]) > 1e-3
        assert tube_lengths(straight) == pytest.approx([94 * MM] * 3, abs=1e-12)


def test_without_offset_it_is_three_equal_concentric_tubes() -> None:
    centred = replace(ETR, offset=0.0)
    random = np.random.default_rng(0)
    for _ in range(5):
        alpha = random.uniform(-1.5, 1.5, 3)
        answer = shoot(rows((ETR.tube,), (0.0,), 0.0), alpha)
        solved = forward_kinematics(centred, alpha)
        assert solved.tip_position == pytest.approx(answer.tip, abs=1e-10)
        for order in ([0, 2, 1], [1, 2, 0], [2, 1, 0]):
            permuted = forward_kinematics(centred, alpha[order])
            assert permuted.tip_position == pytest.approx(solved.tip_position, abs=1e-12)


def test_the_limit_of_no_offset_is_smooth() -> None:
    """The general equations with the tubes ever closer to the centreline, as no robot can be, end at d = 0."""
    alpha = np.array([30.0, 100.0, -20.0]) * DEG
    centred = forward_kinematics(replace(ETR, offset=0.0), alpha).tip_position
    thin = Tube(1e-9, 0.9e-9, 0.0, 0.094, 1 / 0.12)
    gaps = []
    for distance in (1e-4, 1e-5, 1e-9):
        tip = forward_kinematics(EccentricRobot(thin, offset=distance), alpha).tip_position
        gaps.append(float(np.linalg.norm(tip - centred)))
    assert gaps[1] < 0.11 * gaps[0]
    assert gaps[2] < 1e-10


# --- the tubes' own lines -------------------------------------------------------------------------------------------


def test_tubes_run_beside_the_centreline() -> None:
    solved = forward_kinematics(ETR, np.array([30.0, 100.0, -20.0]) * DEG)
    lines = tube_centrelines(solved)
    assert lines.shape == (3, len(solved.arc_length), 3)
    apart = lines - solved.position
    assert np.linalg.norm(apart, axis=2) == pytest.approx(np.full(lines.shape[:2], OFFSET))
    assert np.einsum("nma,ma->nm", apart, solved.frame[:, :, 2]) == pytest.approx(np.zeros(lines.shape[:2]), abs=1e-15)
    assert apart.sum(0) == pytest.approx(np.zeros((len(solved.arc_length), 3)), abs=1e-15)
    assert lines[:, 0] == pytest.approx(OFFSET * np.array([[1, 0, 0], [-0.5, 0.75**0.5, 0], [-0.5, -(0.75**0.5), 0]]))


@pytest.mark.parametrize("pose", [None, *POSES[:2]])
def test_lengths_are_those_of_the_lines(pose: tuple[tuple[float, float], ...] | None) -> None:
    robot = ETR if pose is None else THREE
    alpha = np.array([30.0, 100.0, -20.0]) * DEG if pose is None else mirrored(pose)
    lengths = tube_lengths(forward_kinematics(robot, alpha))
    fine = forward_kinematics(robot, alpha, discretisation=Discretisation(refinement=3 if pose is None else 2))
    lines = tube_centrelines(fine)

    def chords(step: int) -> Array:
        return np.asarray(np.nansum(np.linalg.norm(np.diff(lines[:, ::step], axis=1), axis=2), axis=1))

    # Chords are short by terms of second and fourth order in their length, which three polylines tell.
    better = [chords(step) + (chords(step) - chords(2 * step)) / 3 for step in (1, 2)]
    assert lengths == pytest.approx(better[0] + (better[0] - better[1]) / 15, abs=1e-10)
    assert not np.allclose(lengths[:3], lengths[:3].mean(), atol=1e-4)


def test_the_inside_of_a_bend_is_shorter() -> None:
    bent = forward_kinematics(ETR, mirror_rotations(90 * DEG, 0.0))  # towards x, where tube 1 is
    lengths = tube_lengths(bent)
    assert lengths[0] == pytest.approx(94 * MM - OFFSET * 94 / 120, rel=1e-4)
    assert lengths[1] == pytest.approx(lengths[2], rel=1e-12)
    assert tube_lengths(forward_kinematics(replace(ETR, offset=0.0), [0.0, 0.5, 1.0])) == pytest.approx([94 * MM] * 3)


def test_tubes_end_where_they_end() -> None:
    solved = forward_kinematics(THREE, mirrored(POSES[0]))
    lines = tube_centrelines(solved)
    for i in range(9):
        reached = ~np.isnan(lines[i, :, 0])
        assert solved.arc_length[reached].max() == pytest.approx(solved.tube_end[i])
    withdrawn = THREE.home_translations - np.repeat([50, 50, 50], 3) * MM
    hidden = forward_kinematics(THREE, mirrored(POSES[0]), withdrawn)
    assert np.isnan(tube_centrelines(hidden)[6:, 1:]).all()
    assert tube_lengths(hidden)[6:] == pytest.approx([0, 0, 0])


# --- several segments -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [(0, 0, 0), (9, 5, 3), (-20, -20, -20), (-25, -60, -60)])
def test_segments_against_shooting(gap: tuple[float, ...]) -> None:
    """At random rotations; shooting knows nothing of assemblies, and starts from the torsion that was solved for."""
    advance = tuple(a + b * MM for a, b in zip(HOME, gap, strict=True))
    alpha = np.random.default_rng(9).uniform(-1.5, 1.5, 9)
    solved = forward_kinematics(THREE, alpha, np.repeat(advance, 3))
    bundle = THREE.assembly(solved.translations)
    twist = (solved.rotation[:, 0] - alpha) / bundle.transmission
    answer = shoot(rows_of(THREE, advance), alpha, twist)
    assert solved.tip_position == pytest.approx(answer.tip, abs=1e-10)
    assert solved.tip_rotation == pytest.approx(answer.frame, abs=1e-8)
    assert solved.rotation[:, 0] == pytest.approx(answer.rotation, abs=1e-8)
    reached = solved.tube_end > 0
    assert solved.tip_rotations[reached] == pytest.approx(answer.end_rotation[reached], abs=1e-8)


def test_one_segment_is_the_single_robot() -> None:
    single = SegmentedEccentricRobot((ETR.tube,))
    for rotations, _ in PUBLISHED:
        alpha = np.array(rotations) * DEG
        one, other = forward_kinematics(single, alpha), forward_kinematics(ETR, alpha)
        assert one.tip_position == pytest.approx(other.tip_position, abs=1e-10)
        assert one.margin == pytest.approx(other.margin, abs=1e-10)
        assert chained_approximation(single, alpha).tip_position == pytest.approx(
            forward_kinematics(replace(ETR, offset=0.0), alpha).tip_position, abs=1e-12
        )


def test_a_segment_of_straight_tubes_only_stiffens() -> None:
    straight = Tube(1.4e-3, 1.25e-3, 0.15, 0.0, 0.0)
    robot = SegmentedEccentricRobot((straight, ETR.tube))
    shift = np.repeat([94 * MM, 0.0], 3)
    ratio = ETR.tube.bending_stiffness / (ETR.tube.bending_stiffness + straight.bending_stiffness)
    for direction in (0.0, 50.0):
        alpha = np.concatenate([np.zeros(3), mirror_rotations(direction * DEG, 0.0)])
        stiff = forward_kinematics(robot, alpha, shift)
        alone = forward_kinematics(ETR, alpha[3:])
        size = [np.linalg.norm(each.curvature, axis=1) for each in (stiff, alone)]
        # Tubes in line have hardly any torsion: the moments stay, and the stretch changes by (d u)^2.
        assert size[0] == pytest.approx(ratio * size[1], rel=1e-4)
        centred = forward_kinematics(replace(robot, offset=0.0), alpha, shift)
        assert np.linalg.norm(centred.curvature, axis=1) == pytest.approx(ratio * ETR.tube.curvature, rel=1e-12)
        assert stiff.tip_rotations[:3] == pytest.approx([0.0] * 3, abs=1e-12)


@pytest.mark.parametrize("pose", POSES)
def test_torques_add_up_to_nothing(pose: tuple[tuple[float, float], ...]) -> None:
    robot = THREE
    solved = forward_kinematics(robot, mirrored(pose))
    lines = tube_centrelines(solved)
    stiffness = np.array([tube.torsional_stiffness for tube in robot.tubes])
    bundle = robot.assembly(solved.translations)
    angle, u = bundle.offset_angle[:, None], solved.curvature
    stretch = 1 + bundle.offset[:, None] * (u[:, 0] * np.sin(angle) - u[:, 1] * np.cos(angle))
    # Where sections meet, the torsion that is given belongs to one side and the curvature to the same one.
    twist = np.where(np.isnan(lines[:, :, 0]), 0.0, solved.torsion / stretch)
    for k in range(3):
        torque = stiffness[3 * k : 3 * k + 3] @ twist[3 * k : 3 * k + 3]
        assert np.abs(torque).max() < 1e-9


def test_overlap_is_refused_in_words() -> None:
    closer = THREE.home_translations - np.repeat([1 * MM, 0, 0], 3)
    for solve in (forward_kinematics, chained_approximation):
        with pytest.raises(
            InputError, match=r"^segment 1 begins to curve at 0\.089 m, before segment 2 ends at 0\.09 m"
        ):
            solve(THREE, np.zeros(9), closer)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("gap", [(0, 0, 0), (10, 4, 2), (-30, -30, -30), (-60, -60, -60), (-120, -90, -50)])
def test_chain_is_the_whole_robot_on_the_centreline(
    pose: tuple[tuple[float, float], ...], gap: tuple[float, ...]
) -> None:
    """With d = 0 and no overlap nothing but the straight tubes' stiffness couples the segments."""
    shift, alpha = THREE.home_translations + np.repeat(gap, 3) * MM, mirrored(pose)
    chain = chained_approximation(THREE, alpha, shift)
    whole = forward_kinematics(replace(THREE, offset=0.0), alpha, shift)
    assert chain.tip_position == pytest.approx(whole.tip_position, abs=1e-10)
    assert chain.tip_rotation == pytest.approx(whole.tip_rotation, abs=1e-9)
    assert chain.arc_length[-1] == pytest.approx(whole.arc_length[-1], abs=1e-12)
    assert chain.position[-1] == pytest.approx(chain.tip_position)
    assert len(chain.segments) == int((whole.tube_end[::3] > 1e-9).sum())
    assert (np.diff(chain.arc_length) > -1e-12).all()


@pytest.mark.parametrize("pose", POSES)
def test_chain_is_close_to_the_full_model(pose: tuple[tuple[float, float], ...]) -> None:
    chain = chained_approximation(THREE, mirrored(pose))
    full = chain.full_model()
    assert full.robot == THREE
    assert full.stable
    distance, fraction = chain.deviation(full)
    assert distance < 0.1 * MM
    assert fraction == pytest.approx(distance / (120 * MM))


def test_no_rotation_of_the_example_snaps() -> None:
    assert snap_free_certificate(THREE) == pytest.approx(0.15, abs=5e-3)


def test_a_chain_on_another_branch_says_so() -> None:
    chain = chained_approximation(THREE, mirrored(POSES[0]))
    elsewhere = replace(chain, tip_position=chain.tip_position + 1 * MM)
    with pytest.raises(SolveError, match=r"another branch, 1\.73 mm"):
        elsewhere.full_model()
