"""Groups of tubes and the map from tips to joints: derivatives, independence, products of counts."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.eccentric_reference import rows, rows_of
from tests.eccentric_reference import shoot as reference_shoot
from tests.stability.reference import TURN, all_tips, bundle
from tests.stability.robots import strong
from tubeopt import (
    ConcentricRobot,
    EccentricRobot,
    SegmentedEccentricRobot,
    Tube,
    find_equilibria,
    load_robot,
    snap_free_certificate,
)
from tubeopt.block.transcription.mesh import make_mesh
from tubeopt.block.transcription.reduced import ReducedProblem, reduce
from tubeopt.robots.assembly import assemble
from tubeopt.robots.robot import Robot
from tubeopt.stability.equilibria import groups_of
from tubeopt.stability.shooting import all_tubes, shoot
from tubeopt.typing import Array

THREE = load_robot("configs/robots/example_three_segment_etr.yaml")


def problem_of(robot: Robot) -> ReducedProblem:
    assembly = robot.assembly(robot.home_translations)
    return reduce(assembly, make_mesh(assembly))


def places() -> ReducedProblem:
    """Two pairs of tubes at four places, the outer pair bent before the inner one begins to."""
    inner, outer = Tube(1.2e-3, 1.0e-3, 0.1, 0.05, 25.0), Tube(1.6e-3, 1.3e-3, 0.02, 0.06, 15.0)
    offset, angle = np.full(4, 2e-3), np.radians([0.0, 170.0, 80.0, 260.0])
    shift = np.array([0.06, 0.06, 0.0, 0.0])
    assembly = assemble((inner, inner, outer, outer), shift, offset=offset, offset_angle=angle)
    return reduce(assembly, make_mesh(assembly))


def test_derivatives_of_joints_by_tips() -> None:
    """Inverse to those of the tips by the joints, which differences of shooting with DOP853 give."""
    robot = EccentricRobot(Tube(3e-3, 2.5e-3, 0.0, 0.05, 40.0), transmission_length=0.02)
    tubes = rows(robot.tubes[:1], (0.0,), robot.distance)
    tips = np.array([0.3, 1.9, -0.8])
    shot = shoot(all_tubes(problem_of(robot)), tips[None], steps=32, slopes=True)
    twist = shot.torque[0] / robot.tubes[0].torsional_stiffness
    centre = reference_shoot(tubes, shot.rotations[0], twist)
    assert centre.end_rotation == pytest.approx(tips, abs=1e-7)
    assert centre.twist == pytest.approx(twist, abs=1e-5)
    for direction in np.eye(3):
        ends = [
            reference_shoot(tubes, shot.rotations[0] + step * direction, centre.twist).end_rotation
            for step in (1e-4, -1e-4)
        ]
        assert shot.by_tip[0] @ (ends[0] - ends[1]) / 2e-4 == pytest.approx(direction, abs=1e-6)


@pytest.mark.parametrize("problem", [problem_of(THREE), places()], ids=["segments", "places"])
def test_groups_shoot_as_the_whole_does(problem: ReducedProblem) -> None:
    """Block triangular from the base to the tip: same joints, and the determinant is that of the groups."""
    groups = groups_of(problem)
    n = problem.assembly.n_tubes
    assert [group.tubes.tolist() for group in groups] == (
        [[6, 7, 8], [3, 4, 5], [0, 1, 2]] if n == 9 else [[2, 3], [0, 1]]
    )
    tips = np.random.default_rng(5).uniform(-np.pi, np.pi, (3, n))
    shot = shoot(all_tubes(problem), tips, slopes=True)
    determinant, extra = np.ones(3), np.zeros((3, n))
    for order, group in enumerate(groups):
        k, m = len(group.tubes), group.bundle.n_tubes
        for inner in groups[order + 1 :]:
            assert np.abs(shot.by_tip[:, group.tubes][:, :, inner.tubes]).max() < 1e-14
        for b in range(3):
            own = np.pad((extra[b] / problem.assembly.torsional_stiffness)[group.tubes], (0, m - k))
            part = replace(group.bundle, transmission=group.bundle.transmission + own)
            alone = shoot(part, np.pad(tips[b, group.tubes], (0, m - k))[None], slopes=True)
            assert alone.rotations[0, :k] == pytest.approx(shot.rotations[b, group.tubes], abs=1e-11)
            determinant[b] *= np.linalg.det(alone.by_tip[0, :k, :k])
            extra[b] += alone.travel[0, group.seat] - part.length.sum()
    assert determinant == pytest.approx(np.linalg.det(shot.by_tip), rel=1e-10)
    assert np.abs(extra).max() > 1e-4


def test_pairs_apart_have_the_product_of_their_equilibria() -> None:
    """Two tubes that curve beyond the end of two others: each pair by brute force, and every combination."""
    inner, outer = Tube(1.2e-3, 0.9e-3, 0.1, 0.08, 15.0), Tube(2.4e-3, 2.0e-3, 0.02, 0.10, 22.0)
    tubes = (inner, Tube(1.6e-3, 1.3e-3, 0.1, 0.08, 15.0), Tube(2.0e-3, 1.7e-3, 0.02, 0.10, 22.0), outer)
    robot = ConcentricRobot(tubes)
    shift, rotations = np.array([0.1, 0.1, 0.0, 0.0]), np.array([0.2, 3.3, -0.4, 2.6])
    every = bundle(robot, shift)
    pairs = []
    for pair in ([0, 1], [2, 3]):
        chosen = np.zeros((4, 4))
        chosen[np.ix_(pair, pair)] = 1.0
        pairs.append(all_tips(replace(every, coupling=every.coupling * chosen), rotations, size=1000)[:, pair])
    assert min(len(part) for part in pairs) >= 3
    results = np.array([equilibrium.tip_rotations for equilibrium in find_equilibria(robot, rotations, shift)])
    assert len(results) == len(pairs[0]) * len(pairs[1])
    for one, other in itertools.product(*pairs):
        assert np.abs(results - np.concatenate([one, other])).max(1).min() < 1e-7


def test_a_positive_certificate_leaves_one_equilibrium() -> None:
    observed = 0
    for seed in range(12):
        random = np.random.default_rng([45, seed])
        robot = strong(random, 3, bend=random.uniform(0.8, 1.1))
        if not 0 < snap_free_certificate(robot) < 0.3:
            continue
        observed += 1
        rotations = np.pi * np.arange(3) + random.normal(0.0, 0.3, 3)
        (only,) = find_equilibria(robot, rotations)
        assert only.stable
        (expected,) = all_tips(bundle(robot), rotations, size=40)
        assert only.tip_rotations == pytest.approx(expected, abs=1e-7)
    assert observed >= 2


@pytest.mark.parametrize(
    ("rotations", "with_offsets", "without"),
    [
        ((0.82177, 0.82177, 0.61065, -2.900834, 0.678866, -2.522002), 1, 3),
        ((2.610435, 2.610435, 2.515544, 2.144426, 4.923133, 1.926722), 3, 1),
    ],
)
def test_pairs_that_the_offsets_part_in_one_of_two_segments(rotations: Array, with_offsets: int, without: int) -> None:
    """Within 2 mrad of a fold of the outer segment; shooting with DOP853 knows each equilibrium."""
    segments = (Tube(1.0e-3, 0.8e-3, 0.1, 0.05, 22.0), Tube(1.6e-3, 1.3e-3, 0.01, 0.08, 20.0))
    robot = SegmentedEccentricRobot(segments)
    equilibria = find_equilibria(robot, rotations)
    assert len(equilibria) == with_offsets
    assert len(find_equilibria(replace(robot, offset=0.0), rotations)) == without
    position = np.radians([0.0, 120.0, 240.0] * 2)
    for equilibrium in equilibria:
        stretch = 1 + robot.distance * (equilibrium.curvature[0] @ [np.sin(position), -np.cos(position)])
        tubes = rows_of(robot, (0.08, 0.0))
        answer = reference_shoot(tubes, np.array(rotations), equilibrium.torsion[:, 0] / stretch)
        assert answer.end_rotation == pytest.approx(equilibrium.tip_rotations, abs=1e-6)


def test_three_segments_turned_apart_have_one_equilibrium() -> None:
    """The three segments one after the other."""
    rotations = np.random.default_rng(46).uniform(-TURN, TURN, 9)
    (only,) = find_equilibria(THREE, rotations)
    assert only.stable
    answer = reference_shoot(rows_of(THREE, (0.09, 0.05, 0.0)), rotations, only.torsion[:, 0])
    assert answer.tip == pytest.approx(only.tip_position, abs=1e-8)
