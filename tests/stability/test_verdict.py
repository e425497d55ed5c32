"""The verdict on a robot: proved, found, or honestly neither; and snaps that are hard to see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import CRL, DEG, THESIS, TWO_TUBE, nested
from tubeopt import ConcentricRobot, Finding, find_snap, judge, worst_certificate, worst_margin
from tubeopt.robots.assembly import Array
from tubeopt.stability import snap_free_certificate


def bent(robot: ConcentricRobot, curvatures: tuple[float, ...]) -> ConcentricRobot:
    return ConcentricRobot(
        tuple(replace(tube, curvature=curvature) for tube, curvature in zip(robot.tubes, curvatures, strict=True))
    )


def scaled(robot: ConcentricRobot, certificate: float) -> ConcentricRobot:
    """The robot with all curvatures scaled so that its certificate is this: 1 - mu goes with their square."""
    factor = np.sqrt((1 - certificate) / (1 - snap_free_certificate(robot)))
    return bent(robot, tuple(factor * tube.curvature for tube in robot.tubes))


def test_a_robot_that_cannot_snap() -> None:
    verdict = judge(scaled(THESIS, 0.1))
    assert verdict.finding is Finding.SNAP_FREE
    assert verdict.certificate.margin == pytest.approx(0.1, abs=1e-9)
    assert verdict.worst is not None
    assert verdict.worst.margin >= 0.1
    assert verdict.snap is None
    assert verdict.ways == 0


@pytest.mark.parametrize(("robot", "turn"), [(THESIS, 214.222427), (TWO_TUBE, 203.90356628)], ids=["thesis", "two"])
def test_a_robot_that_snaps_and_the_way_to_it(robot: ConcentricRobot, turn: float) -> None:
    steps: list[tuple[int, int]] = []
    verdict = judge(robot, progress=lambda done, total: steps.append((done, total)))
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
    verdict = judge(scaled(THESIS, -0.01))
    assert verdict.finding is Finding.OPEN
    assert verdict.worst is not None
    assert verdict.worst.margin == pytest.approx(
        1 - 1.01 * (1 - worst_margin(THESIS).margin) / 1.9960831654838389, abs=1e-6
    )
    assert verdict.worst.margin > 0
    assert verdict.ways > 30


def test_tubes_that_curve_to_the_other_side_start_relaxed() -> None:
    mirrored = bent(THESIS, tuple(-tube.curvature if i == 0 else tube.curvature for i, tube in enumerate(THESIS.tubes)))
    verdict = judge(mirrored)
    assert verdict.start is not None
    assert verdict.snap is not None
    np.testing.assert_allclose(verdict.start / DEG, [180, 0, 0], atol=1e-12)
    # To the other side the inner tube would be turned beyond its 360 deg.
    assert verdict.snap.rotations[0] / DEG == pytest.approx(180 - 214.222427, abs=1e-5)
    assert verdict.within_limits


def test_every_robot_with_an_unstable_shape_snaps_on_some_way() -> None:
    """Robots whose certificate is a little below 0, where a snap is hardest to find."""
    random = np.random.default_rng(7)
    found = {Finding.CAN_SNAP: 0, Finding.OPEN: 0}
    for k in range(3):
        base = (THESIS, CRL)[k % 2]
        curvatures = tuple(random.uniform(0.2, 1.2) * tube.curvature for tube in base.tubes)
        verdict = judge(scaled(bent(base, curvatures), random.uniform(-0.1, 0.0)))
        found[verdict.finding] += 1
        assert verdict.worst is None or (verdict.worst.margin <= 0) == (verdict.finding is Finding.CAN_SNAP)
        if verdict.snap is not None:
            assert verdict.snap.energy_released >= 0
    assert found[Finding.CAN_SNAP] >= 1


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


def test_the_least_certificate_of_a_box_lies_at_a_kink(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.stability.worst.EVALUATIONS", 60)
    robot = nested((0.01, 0.04, 15.0), (0.005, 0.04, 15.0), (0.0, 0.04, 15.0))
    home = snap_free_certificate(robot)
    box = worst_certificate(robot, [-0.003, -0.004, 0.0], [0.004, 0.004, 0.0])
    assert box.certificate.margin <= home + 1e-6
    samples: Array = np.random.default_rng(3).uniform(box.lower, box.upper, (20, 3))
    assert box.certificate.margin <= min(snap_free_certificate(robot, shift) for shift in samples)
