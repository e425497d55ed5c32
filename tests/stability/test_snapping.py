"""The first snap on a way, checked by brute force on either side of it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.eccentric_reference import rows, shoot, torsion_map
from tests.examples import CRL, DEG, THESIS
from tests.stability.reference import Elements, bundle, integrated, settle_at
from tests.stability.robots import strong, unit_pair
from tubeopt import (
    ConcentricRobot,
    EccentricRobot,
    InputError,
    SegmentedEccentricRobot,
    Tube,
    find_equilibria,
    find_snap,
    follow,
    forward_kinematics,
)
from tubeopt.robots.robot import Robot
from tubeopt.stability import Snap, trace_branch
from tubeopt.typing import Array


def check_fold(robot: Robot, snap: Snap, start: Array, end: Array) -> None:
    """A little before the fold there are two states close to it in finite elements, a little past it there is none."""
    at = start + snap.fraction * (end - start)
    assert np.stack([snap.rotations, snap.translations]) == pytest.approx(at, abs=1e-12)
    fold = Elements(bundle(robot, at[1]))
    theta = integrated(fold, snap.before.tip_rotations)
    values, vectors = fold.modes(at[0], theta)
    assert abs(values[0]) < 1e-5
    direction = np.zeros(theta.size)
    direction[fold.free] = vectors[:, 0] / np.abs(vectors[:, 0]).max()
    results = []
    for t in (snap.fraction - 1e-4, snap.fraction + 1e-4):
        rotations, translations = start + t * (end - start)
        elements = Elements(bundle(robot, translations))
        near_twist = fold.at(theta - at[0], elements.node)
        soft = fold.at(direction.reshape(theta.shape), elements.node)
        near = []
        for push in np.linspace(-0.3, 0.3, 25):
            state = elements.newton(rotations, rotations + near_twist + push * soft, stable=False)
            if state is not None and np.abs(state - rotations - near_twist).max() < 0.4:
                near.append(state[-1])
        results.append([a for k, a in enumerate(near) if all(np.abs(a - b).max() > 1e-6 for b in near[:k])])
    assert [len(states) for states in results] == [2, 0]


@pytest.mark.parametrize(
    ("seed", "folds"),
    [(1, 0), (3, 1), (5, 1), (7, 0), (9, 0), (12, 1), (17, 1), (19, 1), (26, 1), (28, 1)],
)
def test_folds_of_mixed_ways(seed: int, folds: int) -> None:
    """Rotations and translations of random robots moving together, and, of every third, translations alone."""
    random = np.random.default_rng([30, seed])
    robot = strong(random, 2 + seed % 2, bend=2.5)
    n = robot.n_tubes
    low, high = [-0.8 * t.curved_length for t in robot.tubes], [t.straight_length for t in robot.tubes]
    start = np.stack([random.uniform(-0.5, 0.5, n), random.uniform(low, np.maximum(low, -0.02))])
    end = np.stack([random.uniform(-2 * np.pi, 2 * np.pi, n), random.uniform(np.minimum(-0.01, high), high)])
    if seed % 3 == 0:
        start[0] = end[0] = np.pi * (np.arange(n) % 2) * random.uniform(0.8, 1.4)
    # Of several stable equilibria that of most energy, which is the likeliest to be lost.
    first = [one for one in find_equilibria(robot, start[0], start[1]) if one.stable][-1]
    snap = find_snap(robot, (start[0], start[1]), (end[0], end[1]), equilibrium=first)
    path = follow(robot, [start[0], end[0]], [start[1], end[1]], start=first)
    assert (snap is not None) == bool(path.snaps) == bool(folds)
    if snap is None:
        return
    assert path.snaps[0].fraction == pytest.approx(snap.fraction, abs=1e-9)
    assert path.snaps[0].after.tip_rotations == pytest.approx(snap.after.tip_rotations, abs=1e-6)
    assert abs(snap.before.margin) < 1e-8
    check_fold(robot, snap, start, end)


def test_none_where_the_branch_reaches_the_end() -> None:
    assert find_snap(THESIS, ([0.0, 0.0, 0.0], None), ([214.2 * DEG, 0.0, 0.0], None)) is None
    snap = find_snap(THESIS, ([0.0, 0.0, 0.0], None), ([214.25 * DEG, 0.0, 0.0], None))
    assert snap is not None
    assert snap.fraction == pytest.approx(214.222427 / 214.25, abs=1e-7)
    # A robot that is proved not to snap does not, whichever way it is turned.
    assert find_snap(unit_pair(0.5, 0.2), ([0.0, 0.0], None), ([9.0, -9.0], None)) is None
    single = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.05, 0.1, 10.0),))
    assert find_snap(single, ([0.0], [0.0]), ([9.0], [0.02])) is None
    assert find_snap(THESIS, ([1.0, 0.0, 0.0], None), ([1.0, 0.0, 0.0], None)) is None


def test_agrees_with_the_traced_branch_and_following() -> None:
    for robot, end in ((THESIS, [4.5, 0.5, -0.5]), (CRL, [5.0, 0.0, -0.3]), (CRL, [8.0, 1.0, 0.0])):
        start = np.zeros(3)
        snap = find_snap(robot, (start, np.zeros(3)), (end, np.zeros(3)))
        assert snap is not None
        k = int(np.argmax(np.abs(end)))
        branch = trace_branch(robot, start, end, np.zeros(3))
        assert branch.folds[0].rotations[k] / end[k] == pytest.approx(snap.fraction, abs=1e-9)
        assert follow(robot, np.stack([start, end]), np.zeros((2, 3))).snaps[0].fraction == pytest.approx(
            snap.fraction, abs=1e-9
        )
        # Every point of the traced curve is an equilibrium, and both folds of its S are on it.
        assert len(branch.folds) == 2
        for t, rotations, tips, margin in zip(
            branch.fraction[::7], branch.rotations[::7], branch.tip_rotations[::7], branch.margin[::7], strict=True
        ):
            assert rotations == pytest.approx(t * np.array(end), abs=1e-12)
            state = settle_at(robot, rotations, start, tips)
            assert state.tips == pytest.approx(tips, abs=1e-6)
            assert min(1.0, state.elements.margins(rotations, state.theta)[0]) == pytest.approx(margin, abs=1e-4)
        signs = np.sign(branch.margin[np.abs(branch.margin) > 1e-7])
        assert int((np.diff(signs) != 0).sum()) == 2


def test_the_branch_that_is_given() -> None:
    robot, turn = unit_pair(3.0, 0.0), 178.0 * DEG
    low, high = sorted(
        (e for e in find_equilibria(robot, [turn, 0.0]) if e.stable), key=lambda e: float(np.subtract(*e.tip_rotations))
    )
    up = find_snap(robot, ([turn, 0.0], None), ([np.pi + 1.0, 0.0], None), equilibrium=low)
    assert up is not None
    assert up.rotations[0] / DEG == pytest.approx(184.38397018, abs=1e-6)
    assert find_snap(robot, ([turn, 0.0], None), ([np.pi + 1.0, 0.0], None), equilibrium=high) is None
    down = find_snap(robot, ([turn, 0.0], None), ([0.0, 0.0], None), equilibrium=high)
    assert down is not None
    assert down.rotations[0] / DEG == pytest.approx(360 - 184.38397018, abs=1e-6)


SIDE_BY_SIDE = EccentricRobot(Tube(1.92e-3, 1.57e-3, 0.02, 0.094, 13.79), transmission_length=0.1)
TWO_SEGMENTS = SegmentedEccentricRobot(
    (Tube(1.0e-3, 0.8e-3, 0.14, 0.06, 25.0), Tube(1.6e-3, 1.3e-3, 0.05, 0.08, 17.0)),
)


@pytest.mark.parametrize(
    ("robot", "start", "end"),
    [
        # On the centreline the first loses its equilibrium a little earlier, the second a little later.
        (SIDE_BY_SIDE, [0.0, 1.0, -1.0], [6.0, 1.0, -1.0]),
        (SIDE_BY_SIDE, [0.0, 1.0, -1.0], [0.0, 7.0, 0.0]),
        (TWO_SEGMENTS, [0.0, 1.0, -1.0] * 2, [0.0, 1.0, -1.0, 6.0, 1.0, -1.0]),
    ],
    ids=["one-earlier", "one-later", "two"],
)
def test_tubes_off_the_centreline(robot: Robot, start: list[float], end: list[float]) -> None:
    """At the fold the shooting map is singular; where the robot lands, shooting finds the same equilibrium."""
    snap = find_snap(robot, (start, None), (end, None))
    assert snap is not None
    bundle_here = robot.assembly(snap.translations)
    tubes = rows(robot.tubes[::3], tuple(snap.translations[::3]), float(bundle_here.offset[0]))
    twist = (snap.before.rotation[:, 0] - snap.rotations) / bundle_here.transmission
    slope = torsion_map(tubes, snap.rotations, twist)
    values, well = np.linalg.svd(slope)[1], np.linalg.svd(torsion_map(tubes, snap.rotations, 0.9 * twist))[1]
    assert values[-1] < 1e-4 * values[0]
    assert values[-1] < 1e-2 * well[-1]
    assert snap.energy_released > 0
    assert snap.after.margin > 0.9
    reference = shoot(tubes, snap.rotations, (snap.after.rotation[:, 0] - snap.rotations) / bundle_here.transmission)
    assert snap.after.tip_position == pytest.approx(reference.tip, abs=1e-8)
    assert snap.tip_jump > 0.05
    if robot is TWO_SEGMENTS:
        return
    again = follow(robot, [start, end]).snaps[0]
    assert again.fraction == pytest.approx(snap.fraction, abs=1e-8)
    assert again.after.tip_position == pytest.approx(snap.after.tip_position, abs=1e-7)


def test_messages() -> None:
    home = ([0.0, 0.0, 0.0], None)
    with pytest.raises(InputError, match=r"end is .*; it must be a pair \(rotations, translations\)"):
        find_snap(THESIS, home, [0.0, 0.0, 0.0])  # type: ignore[arg-type]
    with pytest.raises(InputError, match="rotations of start has 2 numbers; it must be 3"):
        find_snap(THESIS, ([0.0, 0.0], None), home)
    with pytest.raises(InputError, match=r"translation of tube 3 is 1 m"):
        find_snap(THESIS, home, ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    with pytest.raises(InputError, match="equilibrium is at other joint values than start"):
        find_snap(THESIS, home, home, equilibrium=forward_kinematics(THESIS, [0.1, 0.0, 0.0]))
    unstable = find_equilibria(THESIS, [np.pi, 0.0, 0.0])[-1]
    with pytest.raises(InputError, match=r"equilibrium has margin -0\.9\d+; it must be a stable equilibrium"):
        find_snap(THESIS, ([np.pi, 0.0, 0.0], None), home, equilibrium=unstable)
    with pytest.raises(InputError, match="start and end are the same rotations"):
        trace_branch(THESIS, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
