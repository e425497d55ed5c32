"""The check by adaptive integration: silent on what is right, and loud on every kind of wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.shooting import shoot
from tests.examples import CRL, MM, THESIS, configurations, eccentric_robot, nested
from tubeopt import (
    BundleRobot,
    ConcentricRobot,
    Discretisation,
    Equilibrium,
    Load,
    Piece,
    Tube,
    Verification,
    forward_kinematics,
    load_robot,
)
from tubeopt.equilibrium.verification import verifications, verify_equilibrium
from tubeopt.robots.load import Stretch


def checked(equilibrium: Equilibrium) -> Verification:
    verification = verify_equilibrium(equilibrium).verification
    assert verification is not None
    return verification


@pytest.fixture(scope="module")
def solved() -> Equilibrium:
    return forward_kinematics(THESIS, (0.5, -0.8, 1.0), np.array([60.0, 30.0, 0.0]) * MM)


@pytest.mark.parametrize("robot", [THESIS, CRL], ids=lambda robot: robot.name)
def test_random_configurations_are_confirmed(robot: ConcentricRobot) -> None:
    for rotations, translations in configurations(robot, 10, seed=31):
        check = checked(forward_kinematics(robot, rotations, translations))
        assert check.tip_position < 1e-9
        assert check.tip_rotation < 1e-8
        assert check.rotation < 1e-9
        assert check.end_torsion < 1e-7
        assert check.base_rotation < 1e-12


def test_tubes_beside_the_centreline_are_confirmed() -> None:
    check = checked(forward_kinematics(eccentric_robot(), np.radians([30.0, 100.0, -20.0])))
    assert check.tip_position < 1e-9
    assert check.tip_rotation < 1e-8
    assert check.rotation < 1e-8
    assert check.end_torsion < 1e-7
    assert check.base_rotation < 1e-12


def test_asked_for_with_the_solve() -> None:
    assert forward_kinematics(THESIS, (0.0, 1.0, 2.0)).verification is None
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0), verify=True)
    assert solved.verification == checked(solved)


def test_one_tube_and_none() -> None:
    robot = nested((0.05, 0.1, 12.0))
    assert checked(forward_kinematics(robot, [0.7], [0.02])).tip_position < 1e-12
    withdrawn = checked(forward_kinematics(robot, [0.7], [-0.1]))
    assert (withdrawn.tip_position, withdrawn.rotation, withdrawn.end_torsion) == (0.0, 0.0, 0.0)


def test_an_error_of_the_mesh_shows_at_its_true_size() -> None:
    coarse = forward_kinematics(CRL, (2.0, 0.5, 0.0), discretisation=Discretisation("gauss", 2), tolerance=1.0)
    reference = shoot(CRL, coarse.rotations, coarse.translations, coarse.torsion[:, 0])
    miss = np.abs(coarse.torsion[:, 0] - reference.torsion).max()
    check = checked(coarse)
    # Integration from the solved base values misses the boundary condition at the tips by what the base is wrong.
    assert miss > 1e-5
    assert 0.1 * miss < check.end_torsion < 100 * miss
    assert check.tip_position > 1e-8


def test_a_wrong_shape_shows(solved: Equilibrium) -> None:
    moved = solved.position + np.array([0.0, 3e-6, 4e-6])
    wrong = replace(solved, arm=replace(solved.arm, position=moved))
    assert checked(wrong).tip_position == pytest.approx(5e-6, rel=1e-3)
    c, s = np.cos(1e-5), np.sin(1e-5)
    turned = solved.frame @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    wrong = replace(solved, arm=replace(solved.arm, frame=turned))
    assert checked(wrong).tip_rotation == pytest.approx(1e-5, rel=1e-3)


def test_a_wrong_torsion_shows(solved: Equilibrium) -> None:
    turned = solved.rotation.copy()
    turned[1, -1] += 1e-4
    assert checked(replace(solved, arm=replace(solved.arm, rotation=turned))).rotation == pytest.approx(1e-4, rel=1e-3)
    slope = solved.torsion.copy()
    slope[2, 0] += 1e-3
    check = checked(replace(solved, arm=replace(solved.arm, torsion=slope)))
    # Tube 3 is held 0.1 m behind the plate.
    assert check.base_rotation == pytest.approx(1e-4, rel=1e-3)
    assert check.end_torsion > 1e-4


def test_other_joint_values_than_those_solved_show(solved: Equilibrium) -> None:
    wrong = replace(solved, rotations=solved.rotations + np.array([0.0, 0.01, 0.0]))
    assert checked(wrong).base_rotation == pytest.approx(0.01, rel=1e-6)
    moved = replace(solved, translations=solved.translations + np.array([0.0, 0.0, 1e-3]))
    assert checked(moved).tip_position > 1e-5


def test_the_same_tubes_in_pieces_miss_by_the_same(solved: Equilibrium) -> None:
    def halved(tube: Tube) -> Tube:
        half = Piece(tube.curved_length / 2, tube.curvature)
        sizes = tube.outer_diameter, tube.inner_diameter
        return Tube.of_pieces(*sizes, [half, half], straight_length=tube.straight_length, material=tube.material)

    slope = solved.torsion.copy()
    slope[:, 0] += 1e-3
    wrong = replace(solved, arm=replace(solved.arm, torsion=slope))
    one, other = checked(wrong), checked(replace(wrong, robot=ConcentricRobot(tuple(map(halved, THESIS.tubes)))))
    # Torsion in rad/m, not the torque that goes with it.
    assert one.end_torsion > 1e-4
    assert other.end_torsion == pytest.approx(one.end_torsion, rel=1e-6)
    assert other.tip_position == pytest.approx(one.tip_position, rel=1e-6)


LOADS = {
    "force": Load((0.05, -0.03, 0.02)),
    "weight": Load(gravity=(0.0, -9.81, 0.0)),
    "points": Load(points=((0.06, (0.05, 0.0, 0.02)), (0.11, (0.0, -0.03, 0.0), (0.002, 0.001, -0.003)))),
    "at the plate and the tip": Load(points=((0.0, (0.1, 0.0, 0.0), (0.0, 0.0, 0.004)), (0.195, (0.0, 0.01, 0.0)))),
    "along the arm": Load(distributed=((0.02, 0.1, (0.2, 0.0, 0.1), (0.02, -0.03, 0.04)),)),
    "moment": Load((0.02, 0.0, 0.0), (0.004, -0.003, 0.006)),
    "turning with the tip": Load((0.02, 0.0, 0.03), (0.004, -0.003, 0.006), frame="tip"),
}


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
def test_loads_are_confirmed(load: Load) -> None:
    shift = np.array([-5.0, -10.0, -20.0]) * MM
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0), shift, load=load, verify=True)
    check = solved.verification
    assert check is not None
    assert check.tip_position < 1e-10
    assert check.tip_rotation < 1e-9
    assert check.rotation < 1e-9
    assert check.end_torsion < 1e-7
    assert check.end_curvature < 1e-7
    assert check.base_rotation < 1e-12
    without = forward_kinematics(THESIS, (0.0, 1.0, 2.0), shift)
    assert np.linalg.norm(without.tip_position - solved.tip_position) > 1e-4


def test_what_the_load_is_not_shows() -> None:
    """An equilibrium under one load is none under another: moments are left at the tip, and tubes end with torsion."""
    solved = forward_kinematics(THESIS, (0.0, 1.0, 2.0), load=LOADS["moment"])
    more = replace(LOADS["moment"], moment=(0.005, -0.003, 0.006))
    wrong = replace(solved, load=more)
    vars(wrong)["base_wrench"] = solved.base_wrench
    check, tip = checked(wrong), solved.tip_rotation
    own = tip.T @ (0.001, 0.0, 0.0)
    stiffness = THESIS.tubes[0].bending_stiffness
    assert check.end_curvature == pytest.approx(np.abs(own[:2]).max() / stiffness, rel=1e-6)
    assert check.end_torsion == pytest.approx(abs(own[2]) / THESIS.tubes[0].torsional_stiffness, rel=1e-6)


def test_tubes_of_pieces_under_a_load_are_confirmed() -> None:
    pieces = (Piece(0.03, 8.0), Piece(0.05, 14.0, bending_stiffness=THESIS.tubes[0].bending_stiffness / 2))
    inner = Tube.of_pieces(1e-3, 0.7e-3, pieces, straight_length=0.1)
    robot = ConcentricRobot((inner, Tube(1.6e-3, 1.1e-3, 0.05, 0.05, 9.0)))
    for load in (LOADS["force"], LOADS["moment"], Load(points=((0.03, (0.05, 0.0, 0.0), (0.001, 0.002, 0.003)),))):
        check = forward_kinematics(robot, (0.3, 1.4), load=load, verify=True).verification
        assert check is not None
        assert check.tip_position < 1e-10
        assert check.end_torsion < 1e-7
        assert check.end_curvature < 1e-7


@pytest.mark.parametrize("load", [None, Load(force=(0.02, 0.01, 0.0))], ids=["unloaded", "force"])
def test_arms_that_are_integrated_together_are_checked_each_for_itself(load: Load | None) -> None:
    """Of three with other sections, one wrong and one withdrawn behind the plate, each is as by itself."""
    home = np.array(THESIS.home_translations)
    positions = [home, home - 0.02 * np.arange(3)] + (
        [-np.array([tube.length for tube in THESIS.tubes])] if not load else []
    )
    arms = [forward_kinematics(THESIS, (0.2, 1.0, -0.4), position, load=load) for position in positions]
    moved = arms[1].arm.position + np.array([0.0, 0.0, 1e-4])
    wrong = replace(arms[1], arm=replace(arms[1].arm, position=moved))
    arms.append(wrong)
    for own, result in zip(map(checked, arms), verifications(arms), strict=True):
        for name in ("tip_position", "tip_rotation", "rotation", "end_torsion", "base_rotation"):
            assert getattr(result, name) == pytest.approx(getattr(own, name), rel=1e-5, abs=1e-9)
    assert verifications(arms)[-1].tip_position == pytest.approx(1e-4, rel=1e-3)


BUNDLE_LOADS = {
    "none": None,
    "tip": Load((0.05, 0.0, 0.02)),
    "moment": Load(moment=(1e-3, 2e-3, 1e-3)),
    "point": Load(points=((0.03, (0.1, 0.0, 0.0)),)),
    "all along": Load(distributed=(0.5, 0.3, 0.0)),
    "stretches": Load(distributed=(Stretch(0.02, 0.05, (0.1, 0.05, 0.1), (0.01, 0.02, 0.005)),)),
    "follows": Load((0.05, 0.02, 0.0), frame="tip"),
    "weight": Load((0.0, 0.0, 0.01), gravity=(5.0, -9.8, 3.0)),
}


@pytest.mark.parametrize("name", BUNDLE_LOADS)
def test_bundles_are_confirmed(name: str) -> None:
    """Curves that begin in front of the plate and behind it, and a sheath; one end beyond the others' own lengths."""
    robot = load_robot("configs/bundles/steerable_sheath.yaml")
    pose = forward_kinematics(robot, np.radians([0, 40, 0]), [-0.02, 0.01, -0.01], load=BUNDLE_LOADS[name], verify=True)
    check = pose.verification
    assert check is not None
    assert check.tip_position < 1e-10
    assert check.tip_rotation < 1e-8
    assert check.rotation < 1e-9
    assert check.end_torsion < 1e-7
    # A load on the whole sheath jumps where it ends, inside an element.
    assert check.end_curvature < (1e-6 if name == "all along" else 1e-8)
    assert check.base_rotation < 1e-9


def test_a_bundle_whose_ends_stay_together_and_one_of_segments_are_confirmed() -> None:
    thesis = load_robot("thesis_etr").bundle()  # type: ignore[attr-defined]
    arm = load_robot("example_three_segment_etr").bundle()  # type: ignore[attr-defined]
    for robot, degrees in (
        (thesis, (0, 0, 0)),
        (thesis, (0, 60, -60)),
        (arm, (-50, -35, -65, 110, 125, 95, 70, 85, 55)),
    ):
        check = checked(robot.fk(np.radians(degrees)))
        assert max(check.tip_position, check.rotation, check.end_curvature) < 1e-8
        assert check.end_torsion < 1e-6


def test_another_bundle_is_not_confirmed() -> None:
    robot = load_robot("configs/bundles/steerable_sheath.yaml")
    assert isinstance(robot, BundleRobot)
    pose = robot.fk(np.radians([0, 60, 30]))
    turned = replace(pose, rotations=pose.rotations + np.array([1e-4, 0, 0]))
    assert checked(turned).base_rotation == pytest.approx(1e-4, rel=1e-3)
    moved = replace(pose, translations=pose.translations - np.array([1e-3, 0, 0]))
    assert checked(moved).tip_position > 1e-6
