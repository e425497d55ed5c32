"""Derivatives of tip pose, tube tips and margin against finite differences of whole solves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from tests.examples import (
    CRL,
    DEG,
    MM,
    THESIS,
    TWO_TUBE,
    configurations,
    eccentric_robot,
    nested,
    random_robot,
    unstable_home,
)
from tubeopt import (
    ConcentricRobot,
    Discretisation,
    Equilibrium,
    InputError,
    SolveError,
    forward_kinematics,
)
from tubeopt.equilibrium.kinematics import to_equilibrium
from tubeopt.equilibrium.result import Jacobian
from tubeopt.robots.assembly import DIMENSIONS
from tubeopt.robots.eccentric import EccentricRobot
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

TURN, SHIFT = 1e-4, 1e-5
"""Steps of the differences, rad and m."""

FINE = Discretisation(degree=8, refinement=1)
"""A mesh on which what it changes when breakpoints part is far below what is asserted."""


def solve(robot: Robot, rotations: ArrayLike, translations: ArrayLike | None = None) -> Equilibrium:
    """A cold solve on that mesh."""
    return forward_kinematics(robot, rotations, translations, discretisation=FINE)


@dataclass(frozen=True)
class Slopes:
    """Columns of a Jacobian by finite differences."""

    position: Array
    rotation: Array
    tip_rotations: Array
    margin: Array


def differences(solved: Equilibrium, side: int, columns: Array) -> Slopes:
    """Along the joint motions `columns` (2n, k): central in the rotations, one-sided of second order with translation.

    The tolerance is wide, so that no mesh is refined on the way.
    """
    robot, n = solved.robot, solved.robot.n_tubes
    out = []
    for column in columns.T:
        moved = bool(column[n:].any())
        h = SHIFT * side if moved else TURN
        positions, weights = (
            ((0, 1, 2), (-1.5, 2.0, -0.5)) if moved else ((-2, -1, 1, 2), (1 / 12, -2 / 3, 2 / 3, -1 / 12))
        )
        rows = []
        for k in positions:
            joint = np.concatenate([solved.rotations, solved.translations]) + k * h * column
            reached = forward_kinematics(robot, joint[:n], joint[n:], start=solved, tolerance=1e-3, discretisation=FINE)
            turn = Rotation.from_matrix(reached.tip_rotation @ solved.tip_rotation.T).as_rotvec()
            rows.append(np.concatenate([reached.tip_position, turn, reached.tip_rotations, [reached.margin]]))
        out.append(np.array(weights) @ np.array(rows) / h)
    table = np.array(out).T
    return Slopes(table[:3], table[3:6], table[6:-1], table[-1])


def check_jacobian(solved: Equilibrium, side: int, columns: Array | None = None) -> Jacobian:
    """Assert that the Jacobian times `columns` agrees with finite differences."""
    n = solved.robot.n_tubes
    motions = np.eye(2 * n) if columns is None else columns
    exact, slopes = solved.jacobian(side=side), differences(solved, side, motions)
    for name in ("position", "rotation", "tip_rotations"):
        expected = getattr(slopes, name)
        assert getattr(exact, name) @ motions == pytest.approx(expected, abs=1e-5 * max(1.0, np.abs(expected).max()))
    assert exact.margin @ motions == pytest.approx(slopes.margin, abs=1e-5 * max(1.0, np.abs(slopes.margin).max()))
    return exact


def turns_as_one(solved: Equilibrium, jacobian: Jacobian) -> bool:
    """Whether the sum over the rotations is the turn of the whole arm about z, which changes no margin.

    The frame of the tip begins unturned at the plate: the turned arm has Rz R Rz' for R.
    """
    n, z = solved.robot.n_tubes, np.array([0.0, 0.0, 1.0])
    desired = np.cross(z, solved.tip_position), z - solved.tip_rotation[:, 2], np.ones(n), 0.0
    results = (getattr(jacobian, name)[..., :n].sum(-1) for name in ("position", "rotation", "tip_rotations", "margin"))
    return all(np.allclose(a, b, atol=1e-8) for a, b in zip(results, desired, strict=True))


def same(one: Jacobian, other: Jacobian) -> bool:
    """Whether two Jacobians are equal but for round-off."""
    names = ("position", "rotation", "tip_rotations", "margin")
    return all(np.allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-9) for name in names)


@pytest.mark.parametrize("robot", [THESIS, CRL], ids=lambda robot: robot.name)
def test_random_configurations(robot: ConcentricRobot) -> None:
    for rotations, translations in configurations(robot, 6, seed=41):
        solved = solve(robot, rotations, translations)
        ahead, behind = check_jacobian(solved, 1), check_jacobian(solved, -1)
        # Away from coinciding breakpoints both sides are one.
        assert same(ahead, behind)


@pytest.mark.parametrize("seed", range(8))
def test_random_robots(seed: int) -> None:
    random = np.random.default_rng(seed)
    robot = random_robot(random, 2 + seed % 4)
    shift = np.array([random.uniform(-0.9 * tube.curved_length, tube.straight_length) for tube in robot.tubes])
    solved = solve(robot, random.uniform(-2, 2, robot.n_tubes), shift)
    assert turns_as_one(solved, check_jacobian(solved, 1 if seed % 2 else -1))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    ("robot", "rotations"),
    [
        (THESIS, (0.0, 1.0, 2.0)),
        (THESIS, (0.0, np.pi / 2, np.pi)),
        (THESIS, (3.3, 0.0, 0.0)),
        (CRL, (1.0, 0.0, -1.2)),
        (TWO_TUBE, (2.2, 0.0)),
    ],
)
def test_at_home_where_breakpoints_coincide(robot: ConcentricRobot, rotations: tuple[float, ...], side: int) -> None:
    solved = solve(robot, rotations)
    assert turns_as_one(solved, check_jacobian(solved, side))


def test_at_home_the_two_sides_differ() -> None:
    # Advancing uncovers a straight part of one tube at the plate; drawing back takes away a curved one.
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0))
    ahead, behind = solved.jacobian(side=1), solved.jacobian(side=-1)
    assert np.abs(ahead.position[:, 3:] - behind.position[:, 3:]).max() > 0.1
    assert ahead.position[:, :3] == pytest.approx(behind.position[:, :3], abs=1e-12)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("translations", [(-50.0, -100.0, -90.0), (-40.0, 20.0, 30.0), (-150.0, -20.0, 50.0)])
def test_retracted_tubes(translations: tuple[float, ...], side: int) -> None:
    solved = solve(THESIS, (2.3, -0.5, 0.6), np.array(translations) * MM)
    assert turns_as_one(solved, check_jacobian(solved, side))


@pytest.mark.parametrize("side", [1, -1])
def test_tubes_that_end_together(side: int) -> None:
    robot = nested((0.05, 0.1, 12.0), (0.05, 0.1, 7.0), (0.02, 0.1, 4.0))
    solved = solve(robot, (1.5, 0.2, -0.8))
    assert turns_as_one(solved, check_jacobian(solved, side))


@pytest.mark.parametrize(("shift", "side"), [(0.0, 1), (0.0, -1), (20.0, 1), (20.0, -1), (-50.0, 1), (-50.0, -1)])
def test_one_tube(shift: float, side: int) -> None:
    robot = nested((0.05, 0.1, 12.0))
    exact = check_jacobian(solve(robot, [0.7], [shift * MM]), side)
    assert exact.margin.tolist() == [0.0, 0.0]
    # Turning the tube turns the tip about z.
    tip = solve(robot, [0.7], [shift * MM]).tip_position
    assert exact.position[:, 0] == pytest.approx(np.cross([0, 0, 1], tip), abs=1e-8)


def test_withdrawn_tubes_move_nothing_until_they_come_out() -> None:
    solved = solve(THESIS, (0.3, 1.7, 1.0), (0.01, -0.02, -0.12))
    exact = check_jacobian(solved, 1)
    assert (exact.position[:, 5] == 0).all()
    assert (exact.position[:, 2] == 0).all()
    # At the plate the next bit of it does come out.
    solved = solve(THESIS, (0.3, 1.7, 1.0), (0.01, -0.02, -0.1))
    assert np.abs(check_jacobian(solved, 1).position[:, 5]).max() > 1e-2
    assert (check_jacobian(solved, -1).position[:, 5] == 0).all()


def test_nothing_in_front_of_the_plate() -> None:
    withdrawn = np.array([-200.0, -150.0, -100.0]) * MM
    solved = forward_kinematics(THESIS, (0.3, 1.7, 1.0), withdrawn)
    behind = solved.jacobian(side=-1)
    assert not behind.position.any()
    assert behind.tip_rotations == pytest.approx(np.eye(3, 6))


def test_close_to_the_snap_derivatives_grow_without_bound() -> None:
    at = forward_kinematics(THESIS, (0.0, 0.0, 0.0))
    sizes = []
    for angle in (150.0, 210.0, 214.0, 214.2):
        at = forward_kinematics(THESIS, (angle * DEG, 0.0, 0.0), start=at)
        exact = at.jacobian()
        sizes.append(np.abs(exact.position[:, 0]).max())
        assert exact.margin[0] <= 0
    assert (np.diff(sizes) > 0).all()
    assert sizes[-1] > 10 * sizes[0]


def test_an_unstable_equilibrium() -> None:
    solution = unstable_home(THESIS, np.array([np.pi, 0.0, 0.0]))
    saddle = to_equilibrium(solution, "tubes without torsion")
    assert saddle.margin < 0
    check_jacobian(saddle, 1)
    check_jacobian(saddle, -1)


@pytest.mark.parametrize("robot", [THESIS, CRL], ids=lambda robot: robot.name)
def test_the_default_mesh_is_good_for_derivatives_too(robot: ConcentricRobot) -> None:
    for rotations, translations in configurations(robot, 6, seed=43):
        coarse = forward_kinematics(robot, rotations, translations).jacobian()
        exact = solve(robot, rotations, translations).jacobian()
        assert coarse.position == pytest.approx(exact.position, abs=1e-6)
        assert coarse.tip_rotations == pytest.approx(exact.tip_rotations, abs=1e-6)
        # The margin, an eigenvalue, feels the mesh more than the rotations do.
        assert coarse.margin == pytest.approx(exact.margin, abs=1e-2)


@pytest.mark.parametrize("side", [1, -1])
def test_eccentric_robot_whose_tubes_move_together(side: int) -> None:
    robot: Robot = eccentric_robot(transmission=0.05)
    solved = solve(robot, np.radians([30.0, 100.0, -20.0]), np.full(3, -0.01))
    motions = np.zeros((6, 4))
    motions[:3, :3] = np.eye(3)
    motions[3:, 3] = 1.0
    exact = check_jacobian(solved, side, motions)
    # The carriage's derivative is shared in equal parts.
    assert exact.position[:, 3:] == pytest.approx(np.tile(exact.position[:, 3:4], 3))


@pytest.mark.parametrize("side", [1, -1])
def test_an_eccentric_robot_that_is_soft(side: int) -> None:
    robot: Robot = eccentric_robot(transmission=0.02)
    solved = solve(robot, np.radians([20.0, 175.0, 10.0]), np.full(3, -0.01))
    assert 0.1 < solved.margin < 0.8
    motions = np.zeros((6, 4))
    motions[:3, :3] = np.eye(3)
    motions[3:, 3] = 1.0
    exact = check_jacobian(solved, side, motions)
    # Off the centreline, turning all tubes alike is not turning the arm.
    assert abs(exact.margin[:3].sum()) > 1e-6


def test_turning_all_tubes_turns_tip_and_frame() -> None:
    solved = forward_kinematics(CRL, (1.0, 0.0, -1.2), np.array([-10.0, -5.0, 5.0]) * MM)
    exact = solved.jacobian()
    z = np.array([0.0, 0.0, 1.0])
    assert exact.position[:, :3].sum(1) == pytest.approx(np.cross(z, solved.tip_position), abs=1e-8)
    # R -> turn R turn': the frame turns with the plate's z axis, but starts as the plate frame.
    assert exact.rotation[:, :3].sum(1) == pytest.approx(z - solved.tip_rotation @ z, abs=1e-7)
    assert exact.tip_rotations[:, :3].sum(1) == pytest.approx(np.ones(3), abs=1e-10)
    assert exact.margin[:3].sum() == pytest.approx(0.0, abs=1e-9)


def test_where_two_eigenvalues_are_one_the_margin_has_no_derivative() -> None:
    # Three equal concentric tubes, a third of a turn apart: the two modes of relative turning are alike.
    tube = eccentric_robot().tube
    solved = forward_kinematics(EccentricRobot(tube, offset=0.0), np.radians([0.0, 120.0, -120.0]))
    assert 0 < solved.margin < 0.99
    assert np.isnan(solved.jacobian().margin).all()
    assert np.isfinite(solved.jacobian().position).all()


def test_an_unknown_side() -> None:
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0))
    with pytest.raises(InputError, match=r"^side is 0; it must be 1 \(forward\) or -1 \(backward\)$"):
        solved.jacobian(side=0)


def test_at_a_fold_there_are_none() -> None:
    # The rotations just before the snap at 203.9 deg, with joint values just beyond it, where the branch has ended.
    home = forward_kinematics(TWO_TUBE, (0.0, 0.0))
    before = forward_kinematics(TWO_TUBE, (203.9 * DEG, 0.0), start=home)
    with pytest.raises(SolveError, match=r"^the equilibrium is a fold"):
        replace(before, rotations=np.array([203.95 * DEG, 0.0])).jacobian()


def changed(robot: ConcentricRobot, name: str, tube: int, by: float) -> ConcentricRobot:
    """The robot with one dimension of one tube changed by a fraction of it (a length: by `by` metres)."""
    tubes, one = list(robot.tubes), robot.tubes[tube]
    if name.endswith("stiffness"):
        modulus = {"bending_stiffness": "youngs_modulus", "torsional_stiffness": "shear_modulus"}[name]
        change = {"material": replace(one.material, **{modulus: getattr(one.material, modulus) * (1 + by)})}
    else:
        change = {name: getattr(one, name) + by}
    tubes[tube] = replace(one, **change)
    return replace(robot, tubes=tuple(tubes))


@pytest.mark.parametrize("name", DIMENSIONS)
@pytest.mark.parametrize("robot", [THESIS, CRL], ids=lambda robot: robot.name)
def test_dimensions_of_the_tubes(robot: ConcentricRobot, name: str) -> None:
    solved = solve(robot, (0.4, 1.9, -1.2), np.array([-11.0, -6.0, -3.0]) * MM)
    exact = solved.jacobian(wrt=(name,))
    # On the mesh of a usual solve, the compiled kernel differentiates.
    usual = forward_kinematics(robot, solved.rotations, solved.translations).jacobian(wrt=(name,))
    for tube in range(3):
        h = {"curvature": 1e-3}.get(name, 1e-5)
        scale = getattr(robot.tubes[tube], name) if name.endswith("stiffness") else 1.0
        rows = []
        for k in (-2, -1, 1, 2):
            reached = solve(changed(robot, name, tube, k * h), solved.rotations, solved.translations)
            rows.append([*reached.tip_position, *reached.tip_rotations, reached.margin, reached.energy])
        slope = np.array([1 / 12, -2 / 3, 2 / 3, -1 / 12]) @ np.array(rows) / h
        for of in (exact, usual):
            columns = of.position[:, tube], of.tip_rotations[:, tube], [of.margin[tube], of.energy[tube]]
            assert scale * np.concatenate(columns) == pytest.approx(slope, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("robot", [THESIS, TWO_TUBE], ids=lambda robot: robot.name)
def test_energy_is_the_work_of_the_motors(robot: ConcentricRobot) -> None:
    # dE / d alpha_i is the torque with which tube i is held at its base, -kt w_i(0).
    solved = solve(robot, np.linspace(0.3, 2.0, robot.n_tubes))
    torque = [-tube.torsional_stiffness * w for tube, w in zip(robot.tubes, solved.torsion[:, 0], strict=True)]
    assert solved.jacobian(wrt=("rotations",)).energy == pytest.approx(torque, rel=1e-9, abs=1e-15)


def test_an_unknown_parameter() -> None:
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0))
    with pytest.raises(InputError, match=r"^wrt names 'radius'; it may name rotations, translations, curvature, "):
        solved.jacobian(wrt=("rotations", "radius"))
