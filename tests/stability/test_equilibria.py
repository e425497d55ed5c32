"""All equilibria against a dense grid of shots from the tip."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.eccentric_reference import rows, shoot
from tests.examples import CRL, THESIS
from tests.stability.reference import TURN, all_tips, bundle, settle_at
from tests.stability.robots import random_robot, random_translations, strong, unit_pair
from tubeopt import (
    ConcentricRobot,
    EccentricRobot,
    EquilibriaSearch,
    Equilibrium,
    InputError,
    SegmentedEccentricRobot,
    SolveError,
    Tube,
    find_equilibria,
    forward_kinematics,
)
from tubeopt.robots.robot import Robot
from tubeopt.stability import equilibria
from tubeopt.typing import Array


def check_set(robot: Robot, rotations: Array, translations: Array, found: list[Equilibrium], size: int) -> None:
    """The same tip angles as by brute force; margin, index and energy as in finite elements; degree 1."""
    expected = all_tips(bundle(robot, translations), rotations, size=size)
    tips = np.array([equilibrium.tip_rotations for equilibrium in found])
    assert len(tips) == len(expected)
    for row in expected:
        assert np.abs(tips - row).max(1).min() < 1e-7
    assert sum((-1) ** equilibrium.index for equilibrium in found) == 1
    assert [e.energy for e in found] == sorted(e.energy for e in found)
    for equilibrium in found:
        state = settle_at(robot, rotations, translations, equilibrium.tip_rotations)
        margins = state.elements.margins(rotations, state.theta)
        assert equilibrium.margin == pytest.approx(min(1.0, margins[0]), rel=1e-4, abs=1e-4)
        assert equilibrium.index == int((margins < 0).sum())
        assert equilibrium.stable == (equilibrium.index == 0)
        energy = state.elements.energy(rotations, state.theta)[0]
        assert equilibrium.energy == pytest.approx(energy, rel=1e-7, abs=1e-10)


def test_two_tubes_against_brute_force() -> None:
    counts = []
    for seed in range(30):
        random = np.random.default_rng([40, seed])
        robot = strong(random, 2, bend=random.uniform(1.0, 4.5))
        rotations = random.uniform(-TURN, TURN, 2)
        shift = random_translations(random, robot) if seed % 2 else np.zeros(2)
        equilibria = find_equilibria(robot, rotations, shift)
        check_set(robot, rotations, shift, equilibria, 1000)
        counts.append(len(equilibria))
    assert max(counts) >= 5
    assert len(set(counts)) >= 3


@pytest.mark.parametrize("part", range(3))
def test_three_tubes_against_brute_force(part: int) -> None:
    counts = []
    for seed in range(4):
        random = np.random.default_rng([41, part, seed])
        robot = strong(random, 3, bend=random.uniform(2.0, 4.0))
        rotations = np.pi * np.arange(3) + random.normal(0.0, 0.5, 3)
        shift = random_translations(random, robot) if seed % 2 else np.zeros(3)
        equilibria = find_equilibria(robot, rotations, shift)
        check_set(robot, rotations, shift, equilibria, 120)
        counts.append(len(equilibria))
    assert max(counts) >= 3


@pytest.mark.parametrize("robot", [THESIS, CRL], ids=["thesis", "CRL"])
def test_published_robots_against_brute_force(robot: Robot) -> None:
    for rotations in np.array([[np.pi, 0.0, 0.1], [-3.3, 3.0, 0.0]]):
        check_set(robot, rotations, np.zeros(3), find_equilibria(robot, rotations, np.zeros(3)), 120)


def test_strong_coupling_has_many() -> None:
    """sqrt(c) L = 6.3 is past 3 pi / 2: five tip angles share the input of half a turn, and others next to it."""
    equilibria = find_equilibria(unit_pair(40.0, 0.0), [np.pi + 0.01, 0.0])
    check_set(unit_pair(40.0, 0.0), np.array([np.pi + 0.01, 0.0]), np.zeros(2), equilibria, 2000)
    assert len(equilibria) >= 5


def test_a_rougher_search_finds_the_same_or_says_that_it_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, joints = unit_pair(40.0, 0.0), [np.pi + 0.01, 0.0]

    def tips() -> list[float]:
        return sorted(float(e.tip_rotations[0] - e.tip_rotations[1]) for e in find_equilibria(robot, joints))

    usual = tips()
    monkeypatch.setattr(equilibria, "GRIDS", ((48, 96), (), ()))
    assert tips() == pytest.approx(usual, abs=1e-9)
    monkeypatch.setattr(equilibria, "GRIDS", ((48,), (), ()))
    with pytest.raises(SolveError, match="more of them on every finer grid"):
        find_equilibria(robot, joints)
    with pytest.raises(InputError, match="most_starts is 0; it must be at least 1"):
        EquilibriaSearch(most_starts=0)


def test_a_turn_of_all_tubes_shifts_all() -> None:
    rotations = np.array([3.0, 0.2, -0.2])
    plain = find_equilibria(THESIS, rotations)
    for turn in (TURN, 1.234):
        shifted = find_equilibria(THESIS, rotations + turn)
        assert len(shifted) == len(plain)
        for a, b in zip(plain, shifted, strict=True):
            assert b.tip_rotations == pytest.approx(a.tip_rotations + turn, abs=1e-8)
            assert (b.energy, b.margin) == pytest.approx((a.energy, a.margin), rel=1e-8)
            assert b.tip_position[2] == pytest.approx(a.tip_position[2], abs=1e-9)


def test_a_turn_of_one_tube_is_another_configuration_of_the_same_shapes() -> None:
    """The tube is wound, but its equilibria are those of the unwound one with tips a turn on."""
    plain = find_equilibria(THESIS, [3.0, 0.2, -0.2])
    wound = find_equilibria(THESIS, [3.0 + TURN, 0.2, -0.2])
    assert len(plain) == len(wound)
    for a in plain:
        assert min(np.abs(b.tip_rotations - a.tip_rotations - [TURN, 0, 0]).max() for b in wound) < 1e-8


def test_mirror_images() -> None:
    plain, mirrored = (find_equilibria(CRL, sign * np.array([2.9, 0.3, 0.1])) for sign in (1, -1))
    for a, b in itertools.zip_longest(plain, mirrored):
        assert b.tip_rotations == pytest.approx(-a.tip_rotations, abs=1e-8)


def test_the_cold_start_is_one_of_them() -> None:
    random = np.random.default_rng(42)
    for _ in range(4):
        rotations = random.uniform(-np.pi, np.pi, 3)
        cold = forward_kinematics(CRL, rotations)
        equilibria = find_equilibria(CRL, rotations)
        assert min(np.abs(e.tip_rotations - cold.tip_rotations).max() for e in equilibria) < 1e-7


def test_one_tube_and_tubes_without_coupling() -> None:
    single = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.05, 0.1, 10.0),))
    (only,) = find_equilibria(single, [7.0])
    assert only.tip_rotations == pytest.approx([7.0])
    assert (only.margin, only.index) == (1.0, 0)
    inner, middle, outer = THESIS.tubes
    # All curved parts but the inner one's behind the plate.
    (apart,) = find_equilibria(THESIS, [1.0, 2.0, 3.0], [0.0, -middle.curved_length, -outer.curved_length])
    assert apart.tip_rotations == pytest.approx([1.0, 2.0, 3.0])
    assert inner.curved_length == pytest.approx(apart.arc_length[-1])


@pytest.mark.parametrize("seed", range(2))
def test_four_tubes(seed: int) -> None:
    """By multi-start: each is one in finite elements too, their degree is 1, and the cold start is among them."""
    random = np.random.default_rng([43, seed])
    robot = strong(random, 4, bend=1.2)
    rotations = random.uniform(-TURN, TURN, 4)
    equilibria = find_equilibria(robot, rotations)
    assert sum((-1) ** equilibrium.index for equilibrium in equilibria) == 1
    for equilibrium in equilibria:
        state = settle_at(robot, rotations, np.zeros(4), equilibrium.tip_rotations)
        assert state.tips == pytest.approx(equilibrium.tip_rotations, abs=1e-7)
    cold = forward_kinematics(robot, rotations)
    assert min(np.abs(e.tip_rotations - cold.tip_rotations).max() for e in equilibria) < 1e-7


def test_unequal_transmissions_and_materials() -> None:
    random = np.random.default_rng(44)
    robot = random_robot(random, 3, bend=2.0)
    materials = {tube.material.poisson_ratio for tube in robot.tubes}
    assert len(materials) == 3
    shift = random_translations(random, robot)
    rotations = random.uniform(-np.pi, np.pi, 3)
    check_set(robot, rotations, shift, find_equilibria(robot, rotations, shift), 120)


def test_messages() -> None:
    with pytest.raises(InputError, match="rotations has 2 numbers; it must be 3"):
        find_equilibria(THESIS, [0.0, 0.0])
    with pytest.raises(InputError, match="every number must be finite"):
        find_equilibria(THESIS, [0.0, np.nan, 0.0])
    with pytest.raises(InputError, match=r"translation of tube 1 is 0.3 m"):
        find_equilibria(THESIS, [0.0, 0.0, 0.0], [0.3, 0.0, 0.0])


@pytest.mark.parametrize(
    ("curvature", "transmission", "rotations", "with_offsets", "without"),
    [
        (19.77586535883372, 0.00502213846674022, (2.25246569, -1.92072959, 1.34444495), 3, 1),
        (24.6400922937691, 0.027182275064522435, (0.64335506, 0.37343858, 2.31104655), 5, 3),
        (22.065746430533377, 0.023625003072490346, (0.32523732, 1.38880236, -0.804494), 5, 3),
    ],
)
def test_pairs_that_the_offsets_part(
    curvature: float, transmission: float, rotations: Array, with_offsets: int, without: int
) -> None:
    """Close to a fold the offsets make a pair that the same tubes on the centreline do not have. The numbers are those
    of Newton's method from 1,500 random starts."""
    robot = EccentricRobot(Tube(1.92e-3, 1.57e-3, 0.0, 0.094, curvature), transmission_length=transmission)
    position = np.radians([0.0, 120.0, 240.0])
    equilibria = find_equilibria(robot, rotations)
    assert len(find_equilibria(replace(robot, offset=0.0), rotations)) == without
    assert len(equilibria) == with_offsets
    for one, other in itertools.combinations(equilibria, 2):
        assert np.abs(one.tip_rotations - other.tip_rotations).max() > 1e-3
    for equilibrium in equilibria:
        stretch = 1 + robot.offset * (equilibrium.curvature[0] @ [np.sin(position), -np.cos(position)])
        twist = equilibrium.torsion[:, 0] / stretch
        answer = shoot(rows(robot.tubes[:1], (0.0,), robot.offset), np.array(rotations), twist)
        assert answer.end_rotation == pytest.approx(equilibrium.tip_rotations, abs=1e-6)
        error = float(np.linalg.norm(equilibrium.tip_position - answer.tip))
        assert error < 2e-9
        assert error < max(equilibrium.tip_error, 1e-11)


def test_a_segment_of_straight_tubes_has_no_equilibria_of_its_own() -> None:
    """The straight tubes are solved for too, but on the centreline nothing couples them."""
    segments = (Tube(1.0e-3, 0.8e-3, 0.1, 0.06, 20.0), Tube(1.6e-3, 1.3e-3, 0.01, 0.08, 0.0))
    robot = SegmentedEccentricRobot(segments)
    rotations = np.array([0.4, 2.5, -2.2, 0.3, -0.5, 0.1])
    equilibria = find_equilibria(robot, rotations)
    assert sum((-1) ** equilibrium.index for equilibrium in equilibria) == 1
    reached = forward_kinematics(robot, rotations)
    assert min(np.linalg.norm(e.tip_position - reached.tip_position) for e in equilibria) < 1e-10
