"""The verdict on a robot: proved, found, or honestly neither; and snaps that are hard to see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import CRL, DEG, MM, THESIS, TWO_TUBE, nested
from tests.stability.reference import TURN, bundle, closed_form, first_fold
from tests.stability.robots import random_robot, random_translations, unit_pair
from tubeopt import (
    ConcentricRobot,
    Finding,
    JointLimits,
    Material,
    Tube,
    assess_snapping,
    find_snap,
    worst_certificate,
    worst_margin,
)
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from tubeopt.stability import SnapSearch, snap_free_certificate
from tubeopt.stability.snap_assessment import equilibrium_grid, folds
from tubeopt.typing import Array


def bent(robot: ConcentricRobot, curvatures: tuple[float, ...]) -> ConcentricRobot:
    return ConcentricRobot(
        tuple(replace(tube, curvature=curvature) for tube, curvature in zip(robot.tubes, curvatures, strict=True))
    )


def scaled(robot: ConcentricRobot, certificate: float, shift: Array | None = None) -> ConcentricRobot:
    """The robot with all curvatures scaled so that its certificate is this: 1 - mu goes with their square."""
    factor = np.sqrt((1 - certificate) / (1 - snap_free_certificate(robot, shift)))
    return bent(robot, tuple(factor * tube.curvature for tube in robot.tubes))


def test_a_robot_that_cannot_snap() -> None:
    verdict = assess_snapping(scaled(THESIS, 0.1))
    assert verdict.finding is Finding.SNAP_FREE
    assert verdict.certificate.margin == pytest.approx(0.1, abs=1e-9)
    assert verdict.worst is not None
    assert verdict.worst.margin >= 0.1
    assert verdict.snap is None
    assert verdict.paths == 0


@pytest.mark.parametrize(("robot", "turn"), [(THESIS, 214.222427), (TWO_TUBE, 203.90356628)], ids=["thesis", "two"])
def test_a_robot_that_snaps_and_the_way_to_it(robot: ConcentricRobot, turn: float) -> None:
    steps: list[tuple[int, int]] = []
    verdict = assess_snapping(robot, progress=lambda done, total: steps.append((done, total)))
    assert verdict.finding is Finding.CAN_SNAP
    assert verdict.snap is not None
    assert verdict.start is not None
    assert verdict.end is not None
    assert verdict.snap.rotations[0] / DEG == pytest.approx(turn, abs=1e-5)
    again = find_snap(robot, (verdict.start, None), (verdict.end, None))
    assert again is not None
    assert again.fraction == verdict.snap.fraction
    assert steps[0][0] == 0
    assert steps[0][1] > 1


def test_neither_proved_nor_found() -> None:
    verdict = assess_snapping(scaled(THESIS, -0.01))
    assert verdict.finding is Finding.OPEN
    assert verdict.worst is not None
    assert verdict.worst.margin == pytest.approx(
        1 - 1.01 * (1 - worst_margin(THESIS).margin) / 1.9960831654838389, abs=1e-6
    )
    assert verdict.worst.margin > 0
    assert verdict.paths > 30


def pairs() -> list[tuple[ConcentricRobot, Array]]:
    """Two tubes of all kinds, with translations: unequal lengths and Poisson's ratios, tubes that curve to either side,
    one that does not, an inner one that ends inside the outer, long transmissions, certificates next to 0."""
    out: list[tuple[ConcentricRobot, Array]] = []
    for seed in range(16):
        random = np.random.default_rng([9, seed])
        robot = random_robot(random, 2, bend=random.uniform(0.8, 3.0))
        shift = random_translations(random, robot) if seed % 2 else robot.home_translations
        if seed % 4 == 0:
            robot = lengthened(robot, 0.4 * seed / 4)
        if seed % 8 == 3:
            shift[0] = shift[1] + robot.tubes[1].length - robot.tubes[0].length - 0.01
        if seed % 8 == 5:
            robot = bent(robot, (0.0, robot.tubes[1].curvature))
        elif seed % 4 == 1 and snap_free_certificate(robot, shift) < 1:
            robot = scaled(robot, (1e-6, -1e-6)[seed // 8], shift)
        out.append((robot, shift))
    return out


def lengthened(robot: ConcentricRobot, extra: float) -> ConcentricRobot:
    """The robot with transmissions that are longer by this, m."""
    return ConcentricRobot(tuple(replace(tube, straight_length=tube.straight_length + extra) for tube in robot.tubes))


def test_two_tubes_are_decided() -> None:
    results = {Finding.CAN_SNAP: 0, Finding.SNAP_FREE: 0}
    for robot, shift in pairs():
        verdict = assess_snapping(robot, shift)
        results[verdict.finding] += 1
        relaxed = np.pi if robot.tubes[0].curvature * robot.tubes[1].curvature < 0 else 0.0
        turn = first_fold(bundle(robot, shift), relaxed)
        assert (verdict.finding is Finding.CAN_SNAP) == (turn is not None)
        if turn is None:
            continue
        assert verdict.snap is not None
        assert verdict.start is not None
        assert np.ptp(verdict.snap.rotations - verdict.start) == pytest.approx(turn, abs=1e-7)
        assert abs(verdict.snap.before.margin) < 1e-8
        assert verdict.snap.after.stable
        assert verdict.snap.energy_released >= 0
        if verdict.followed:
            again = find_snap(robot, (verdict.start, shift), (verdict.end, shift))
            assert again is not None
            assert again.fraction == verdict.snap.fraction
    assert min(results.values()) >= 4


@pytest.mark.parametrize(("lever", "within"), [(4.5, True), (8.0, False)])
def test_two_tubes_snap_after_more_than_a_turn(lever: float, within: bool) -> None:
    """Long transmissions: differences of rotations up to 720 deg are inside the limits of +-360 deg for each tube."""
    robot = unit_pair(1.44, lever)
    fold = float(closed_form(1.44, 1.0, lever, np.linspace(0.0, np.pi, 100001)).max())
    assert fold > TURN
    assert (fold < 2 * TURN) == within
    verdict = assess_snapping(robot)
    assert verdict.snap is not None
    assert verdict.within_limits is within
    assert np.ptp(verdict.snap.rotations) == pytest.approx(fold, abs=1e-8)
    assert (np.abs(verdict.snap.rotations).max() <= TURN) == within
    wide = replace(robot, joint_limits=JointLimits(((0.0, 0.0), (-4 * TURN, 4 * TURN)), robot.limits.translations))
    again = assess_snapping(wide)
    assert again.snap is not None
    assert again.within_limits
    assert np.abs(again.snap.rotations) == pytest.approx([0.0, fold], abs=1e-8)


def test_three_tubes_that_only_snap_where_all_are_turned() -> None:
    """Turns of one tube meet no snap; the fold at which the stable equilibria end shows where to turn."""
    robot = ConcentricRobot(
        tuple(
            Tube(od * MM, bore * MM, straight, curved, curvature, Material.from_poisson_ratio("m", modulus, nu))
            for od, bore, straight, curved, curvature, modulus, nu in (
                (0.433, 0.280, 0.378, 0.200, 14.0, 43.5e9, 0.295),
                (0.653, 0.572, 0.292, 0.168, 10.8, 58.8e9, 0.299),
                (0.975, 0.689, 0.196, 0.084, -13.8, 67.6e9, 0.140),
            )
        )
    )
    relaxed = [np.pi, np.pi, 0.0]
    for end in ([-np.pi, np.pi, 0.0], [np.pi, -np.pi, 0.0]):
        assert find_snap(robot, (relaxed, None), (end, None)) is None
    verdict = assess_snapping(robot)
    assert verdict.finding is Finding.CAN_SNAP
    assert verdict.within_limits
    assert verdict.snap is not None
    low, high = np.array(robot.limits.rotations).T
    assert (verdict.snap.rotations >= low).all()
    assert (verdict.snap.rotations <= high).all()
    again = find_snap(robot, (verdict.start, None), (verdict.end, None))
    assert again is not None
    assert again.fraction == verdict.snap.fraction


def test_narrow_limits() -> None:
    for limit, within in ((2.0, True), (1.0, False)):
        narrow = JointLimits(((-limit, limit),) * 3, THESIS.limits.translations)
        verdict = assess_snapping(replace(THESIS, joint_limits=narrow))
        assert verdict.finding is Finding.CAN_SNAP
        assert verdict.within_limits is within
        assert verdict.snap is not None
        assert (np.abs(verdict.snap.rotations).max() <= limit) == within


def test_the_stable_set_ends_at_folds() -> None:
    problem = reduced_problem(CRL, (0.0, 0.0, 0.0), DEFAULT_DISCRETISATION)
    grid = equilibrium_grid(problem, np.arange(3), np.zeros(3), worst_margin(CRL).unstable)
    result = folds(grid, lambda joints: np.abs(joints).max(-1) < TURN, max_folds=4)
    assert len(result) == 4
    assert (np.diff(np.abs(result).max(1)) >= 0).all()
    snaps = [find_snap(CRL, (np.zeros(3), None), ([*1.2 * fold, 0.0], None)) for fold in result]
    assert None not in snaps
    nearest, *_ = snaps
    assert nearest is not None
    assert nearest.rotations[:2] == pytest.approx(result[0], abs=0.2)


def test_tubes_that_curve_to_the_other_side_start_relaxed() -> None:
    mirrored = bent(THESIS, tuple(-tube.curvature if i == 0 else tube.curvature for i, tube in enumerate(THESIS.tubes)))
    verdict = assess_snapping(mirrored)
    assert verdict.start is not None
    assert verdict.snap is not None
    np.testing.assert_allclose(verdict.start / DEG, [180, 0, 0], atol=1e-12)
    # To the other side the inner tube would be turned beyond its 360 deg.
    assert verdict.snap.rotations[0] / DEG == pytest.approx(180 - 214.222427, abs=1e-5)
    assert verdict.within_limits


def test_every_robot_with_an_unstable_shape_snaps_on_some_way() -> None:
    """Robots whose certificate is a little below 0, where a snap is hardest to find."""
    random = np.random.default_rng(7)
    results = {Finding.CAN_SNAP: 0, Finding.OPEN: 0}
    for k in range(3):
        base = (THESIS, CRL)[k % 2]
        curvatures = tuple(random.uniform(0.2, 1.2) * tube.curvature for tube in base.tubes)
        verdict = assess_snapping(scaled(bent(base, curvatures), random.uniform(-0.1, 0.0)))
        results[verdict.finding] += 1
        assert verdict.worst is None or (verdict.worst.margin <= 0) == (verdict.finding is Finding.CAN_SNAP)
        if verdict.snap is not None:
            assert verdict.snap.energy_released >= 0
    assert results[Finding.CAN_SNAP] >= 1


SHALLOW = [
    # Base, translations (m), curvatures (1/m), the way (deg), where it snaps (fraction; None: just not)
    (
        THESIS,
        (0.0, 0.0, 0.0),
        (-4.406763302421558, 6.568223098254401, 1.2685179411781118),
        ((180, 0, 0), (540, 0, 0)),
        0.5,
    ),
    (
        THESIS,
        (0.0, 0.0, 0.0),
        (7.139216987342674, 3.9456875606410264, 0.9247978242472614),
        ((0, 0, 0), (360, 0, 0)),
        None,
    ),
    (
        THESIS,
        (0.07240144204295745, 0.13750470802709133, 0.04765097432639645),
        (-9.783045328640526, 1.699894609347745, 2.058051136851442),
        ((180, 0, 0), (540, 0, 0)),
        0.5,
    ),
    (
        CRL,
        (0.09730177118959787, -0.08102549911951391, -0.08610760324694353),
        (74.01438399477506, 34.99301596707985, 11.102995632850146),
        ((0, 0, 0), (0, 360, 0)),
        0.5,
    ),
]


@pytest.mark.parametrize(("base", "shift", "curvatures", "way", "snaps"), SHALLOW)
def test_snaps_of_robots_that_only_just_snap(
    base: ConcentricRobot,
    shift: tuple[float, ...],
    curvatures: tuple[float, ...],
    way: tuple[tuple[float, ...], tuple[float, ...]],
    snaps: float | None,
) -> None:
    robot = bent(base, curvatures)
    start, end = ((np.radians(angles), shift) for angles in way)
    snap = find_snap(robot, start, end)
    if snaps is None:
        assert snap is None
    else:
        assert snap is not None
        assert snap.fraction == pytest.approx(snaps, abs=1e-4)
        assert abs(snap.before.margin) < 1e-8
        assert snap.after.stable
        assert snap.energy_released >= 0


def test_the_least_certificate_of_a_box_lies_at_a_kink() -> None:
    robot = nested((0.01, 0.04, 15.0), (0.005, 0.04, 15.0), (0.0, 0.04, 15.0))
    home = snap_free_certificate(robot)
    box = worst_certificate(robot, [-0.003, -0.004, 0.0], [0.004, 0.004, 0.0], effort=SnapSearch(evaluations=60))
    assert box.certificate.margin <= home + 1e-6
    samples: Array = np.random.default_rng(3).uniform(box.lower, box.upper, (20, 3))
    assert box.certificate.margin <= min(snap_free_certificate(robot, shift) for shift in samples)
