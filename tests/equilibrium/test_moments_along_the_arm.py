"""Dead moments at places of the arm and along it, against shooting, closed forms, differences and balances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.equilibrium.test_loads import rod
from tests.load_reference import RefLoad, Shooting, Shot, of_robot
from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    InputError,
    Load,
    Tube,
    forward_kinematics,
    load_equilibrium,
    load_robot,
)
from tubeopt.equilibrium.kinematics import point_of
from tubeopt.robots.load import between
from tubeopt.robots.pieces import Piece
from tubeopt.runs.robot_keys import load_entry
from tubeopt.typing import Array

ROTATIONS = (0.0, 1.0, 2.0)
NONE = (0.0, 0.0, 0.0)
COUPLE = (0.006, -0.004, 0.008)
PER_LENGTH = (0.03, 0.05, -0.04)


@pytest.fixture(scope="module")
def thesis() -> ConcentricRobot:
    robot = load_robot("configs/robots/thesis_ctr.yaml")
    assert isinstance(robot, ConcentricRobot)
    return robot


def base_values(e: Equilibrium) -> Array:
    """(n + 2,) torques and bending moment at the plate, where shooting may start."""
    point = point_of(e)
    torque = -(point.member.problem.torsion.weight @ point.state.torque)
    couples = point.member.problem.couples
    assert couples is not None
    np.add.at(torque, couples.tube[: len(couples.joint)], point.state.joint_torques)
    return np.concatenate([torque, e.base_wrench[3:5]])


def shot(robot: ConcentricRobot, e: Equilibrium, same: RefLoad) -> Shot:
    """The equilibrium by shooting, begun with what was found at the plate."""
    beta = e.translations - [tube.straight_length for tube in robot.tubes]
    return Shooting(of_robot(robot), beta, e.rotations, same).solve(base_values(e))


def agrees(e: Equilibrium, same: Shot) -> None:
    """Tip, frame and what acts on the plate are those of shooting."""
    assert same.residual < 1e-12
    assert np.linalg.norm(e.tip_position - same.tip) < 1e-11
    assert np.abs(e.tip_rotation - same.frame).max() < 1e-10
    assert np.allclose(e.base_wrench[3:], [*same.moment_base, same.torque_base.sum()], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("load", "same"),
    [
        (Load(points=((0.06, NONE, COUPLE),)), RefLoad(couples=((0.06, COUPLE),))),
        (Load(points=((0.0, NONE, COUPLE),)), RefLoad(couples=((0.0, COUPLE),))),
        (Load(distributed=lambda s: (*NONE, *PER_LENGTH)), RefLoad(couple_per_length=PER_LENGTH)),
        (
            Load(
                (0.05, 0.02, -0.03),
                (0.004, -0.003, 0.006),
                points=((0.08, (0.02, 0.03, 0.0), COUPLE), (0.03, (0.1, 0.0, 0.05))),
                distributed=((0.0, 0.2, (0.1, 0.2, 0.0), PER_LENGTH),),
            ),
            RefLoad(
                (0.05, 0.02, -0.03),
                (0.004, -0.003, 0.006),
                points=((0.08, (0.02, 0.03, 0.0)), (0.03, (0.1, 0.0, 0.05))),
                couples=((0.08, COUPLE),),
                distributed=(0.1, 0.2, 0.0),
                couple_per_length=PER_LENGTH,
            ),
        ),
    ],
    ids=["objective orientability needs", "at the plate", "along the arm", "with all else"],
)
def test_thesis_robot_against_shooting(thesis: ConcentricRobot, load: Load, same: RefLoad) -> None:
    e = forward_kinematics(thesis, ROTATIONS, load=load)
    agrees(e, shot(thesis, e, same))
    assert 0.5 < e.margin < 1
    assert e.stable


def test_tubes_that_are_drawn_back_against_shooting() -> None:
    robot = load_robot("configs/robots/crl_ctr.yaml")
    assert isinstance(robot, ConcentricRobot)
    shift = np.array([-0.06, -0.04, -0.01]) + [tube.straight_length for tube in robot.tubes]
    length = float(robot.assembly(shift).total_length)
    load = Load(points=((0.03, NONE, COUPLE),), distributed=((0.0, length, NONE, PER_LENGTH),))
    e = forward_kinematics(robot, ROTATIONS, shift, load=load)
    agrees(e, shot(robot, e, RefLoad(couples=((0.03, COUPLE),), couple_per_length=PER_LENGTH)))


@pytest.mark.parametrize("length", [0.4, 0.6])
def test_soft_rod_with_weight_and_wrenches_in_the_middle_and_at_the_tip(length: float) -> None:
    """The size of published soft rods: E 1 MPa, 1,000 kg/m^3, 10 mm in radius."""
    inertia, mass = np.pi / 4 * 0.01**4, 1000 * np.pi * 0.01**2
    tube = replace(rod(length, 1e6 * inertia, 2e6 / 2.9 * inertia).tubes[0], mass_per_length=mass)
    robot = ConcentricRobot((tube,))
    middle, tip = ((0.05, -0.1, 0.02), (0.004, 0.006, 0.003)), ((0.02, 0.03, -0.04), (-0.003, 0.002, 0.001))
    load = Load(*tip, points=((length / 2, *middle),), gravity=(0.0, -9.81, 0.0))
    same = RefLoad(
        *tip, points=((length / 2, middle[0]),), couples=((length / 2, middle[1]),), gravity=(0.0, -9.81, 0.0)
    )
    e = forward_kinematics(robot, [0.0], load=load)
    point = point_of(e)
    assert point.member.problem.couples is not None
    torque = point.state.joint_torques.sum() - point.member.problem.torsion.weight @ point.state.torque
    reference = Shooting(of_robot(robot, [mass]), [0.0], [0.0], same).solve(np.append(torque, e.base_wrench[3:5]))
    assert reference.residual < 1e-12
    assert np.linalg.norm(e.tip_position - reference.tip) < 1e-9
    assert np.linalg.norm(e.tip_position - (0, 0, length)) > 0.1 * length


def test_moment_across_a_straight_rod_bends_it_to_an_arc_up_to_where_it_acts() -> None:
    length, at, stiffness, moment = 0.2, 0.08, 1e-3, 0.01
    e = forward_kinematics(rod(length, stiffness), [0.0], load=Load(points=((at, NONE, (0.0, moment, 0.0)),)))
    curvature = moment / stiffness
    turn, straight = curvature * at, length - at
    # A moment about y turns z towards x.
    x, z = (1 - np.cos(turn)) / curvature + straight * np.sin(turn), np.sin(turn) / curvature + straight * np.cos(turn)
    assert np.allclose(e.tip_position, (x, 0.0, z), rtol=0, atol=1e-12)
    assert e.energy == pytest.approx(moment**2 / stiffness * at / 2, rel=1e-12)


def test_moment_along_a_straight_rod_twists_it_up_to_where_it_acts() -> None:
    held, length, at, shear, moment, per_length = 0.05, 0.2, 0.08, 8e-4, 0.003, 0.02
    tube = rod(length, 1e-3, shear).tubes[0]
    robot = ConcentricRobot((replace(tube, straight_length=held),))
    e = forward_kinematics(robot, [0.0], load=Load(points=((at, NONE, (0.0, 0.0, moment)),)))
    assert e.tip_rotations[0] == pytest.approx(moment * (held + at) / shear, rel=1e-12)
    assert e.energy == pytest.approx(moment**2 * (held + at) / shear / 2, rel=1e-12)
    e = forward_kinematics(robot, [0.0], load=Load(distributed=((0.0, length, NONE, (0.0, 0.0, per_length)),)))
    assert e.tip_rotations[0] == pytest.approx(per_length * (length * held + length**2 / 2) / shear, rel=1e-12)
    energy = per_length**2 * (length**3 / 3 + length**2 * held) / shear / 2
    assert e.energy == pytest.approx(energy, rel=1e-12)
    assert e.base_wrench[5] == pytest.approx(per_length * length, rel=1e-12)


def test_outermost_tube_is_twisted() -> None:
    """A straight sheath around a straight tube turns alone, up to where the moment acts."""
    inner, outer = (Tube(od, bore, 0.0, length, 0.0) for od, bore, length in ((1e-3, 0.0, 0.2), (2e-3, 1.5e-3, 0.1)))
    robot, moment = ConcentricRobot((inner, outer)), 0.004
    e = forward_kinematics(robot, [0.0, 0.0], load=Load(points=((0.06, NONE, (0.0, 0.0, moment)),)))
    assert np.allclose(e.tip_rotations, [0.0, moment * 0.06 / outer.torsional_stiffness], rtol=1e-12, atol=1e-15)
    e = forward_kinematics(robot, [0.0, 0.0], load=Load(points=((0.15, NONE, (0.0, 0.0, moment)),)))
    assert np.allclose(e.tip_rotations, [moment * 0.15 / inner.torsional_stiffness, 0.0], rtol=1e-12, atol=1e-15)


def test_energy_is_the_work_of_the_moment_at_the_tip(thesis: ConcentricRobot) -> None:
    moment = np.array([0.002, -0.004, 0.0032])
    nodes, weights = np.polynomial.legendre.leggauss(8)
    work = 0.0
    for x, w in zip((nodes + 1) / 2, weights / 2, strict=True):
        e = forward_kinematics(thesis, ROTATIONS, load=Load(moment=x * moment))
        work += w * x * moment @ e.compliance[3:, 3:] @ moment
    full = forward_kinematics(thesis, ROTATIONS, load=Load(moment=moment))
    plain = forward_kinematics(thesis, ROTATIONS, load=Load())
    assert full.energy - plain.energy == pytest.approx(work, rel=1e-8)


LOADS = (
    Load(points=((0.06, NONE, COUPLE),)),
    Load((0.02, 0.0, 0.05), (0.004, -0.003, 0.006), distributed=((0.02, 0.1, NONE, PER_LENGTH),)),
    Load((0.02, 0.01, 0.05), (0.004, -0.003, 0.006), frame="tip", points=((0.06, NONE, COUPLE),)),
)


@pytest.mark.parametrize("load", LOADS, ids=["objective orientability needs", "along the arm", "turning with the tip"])
def test_jacobian_and_compliance_are_differences(thesis: ConcentricRobot, load: Load) -> None:
    shift, size = np.array([-0.005, -0.01, -0.02]), 1e-4
    e = forward_kinematics(thesis, ROTATIONS, shift, load=load)
    slopes = e.jacobian()
    turned: list[Rotation] = []

    def ends(joints: Array, more: Array) -> Array:
        if load.frame == "tip" and more.any():  # a dead wrench beside one that turns: where the tip is
            push = (float(e.arc_length[-1]), tuple(more[:3]), tuple(more[3:]))
            both = replace(load, points=(*load.points, push))
        else:
            both = replace(load, force=load.force + more[:3], moment=load.moment + more[3:])
        reached = forward_kinematics(thesis, joints[:3], joints[3:], load=both, tolerance=1e-11)
        turn = Rotation.from_matrix(reached.tip_rotation) * Rotation.from_rotvec([0, 0, reached.tip_rotations[0]])
        turned.append(turn)
        return np.concatenate([reached.tip_position, reached.tip_rotations, [reached.energy]])

    joints = np.concatenate([ROTATIONS, shift])
    # Along directions that have all six parts: a column that is wrong changes each of them.
    random = np.random.default_rng(4)
    for path in random.uniform(0.5, 1.0, (2, 6)) * random.choice([-1, 1], (2, 6)):
        step = size * path * ([1] * 3 + [1e-2] * 3)
        moved = (ends(joints + step, np.zeros(6)) - ends(joints - step, np.zeros(6))) / (2 * size)
        result = np.concatenate([slopes.position, slopes.tip_rotations, slopes.energy[None]]) @ step / size
        assert np.allclose(result, moved, rtol=0, atol=2e-6 * (1 + np.abs(moved).max()))
        step = size * path * ([1] * 3 + [0.03] * 3)
        moved = (ends(joints, step) - ends(joints, -step))[:3] / (2 * size)
        turn = (turned[-2] * turned[-1].inv()).as_rotvec() / (2 * size)
        desired = np.concatenate([moved, turn])
        assert np.allclose(e.compliance @ step / size, desired, rtol=0, atol=1e-6 * np.abs(e.compliance).max())


def test_base_wrench_balances_moments(thesis: ConcentricRobot) -> None:
    force = np.array([0.05, -0.02, 0.01])
    load = Load(force, points=((0.07, NONE, COUPLE),), distributed=((0.02, 0.05, NONE, PER_LENGTH),))
    e = forward_kinematics(thesis, ROTATIONS, load=load)
    moment = np.array(COUPLE) + 0.03 * np.array(PER_LENGTH) + np.cross(e.tip_position, force)
    assert np.allclose(e.base_wrench, np.concatenate([force, moment]), rtol=0, atol=1e-12)


def test_tubes_of_pieces_bear_the_same(thesis: ConcentricRobot) -> None:
    def pieced(tube: Tube) -> Tube:
        half = tube.curved_length / 2
        pieces = (Piece(half, tube.curvature), Piece(half, tube.curvature, bending_stiffness=tube.bending_stiffness))
        return Tube.of_pieces(
            tube.outer_diameter, tube.inner_diameter, pieces, straight_length=tube.straight_length,
            material=tube.material, bending_stiffness=tube.bending_stiffness,
            torsional_stiffness=tube.torsional_stiffness,
        )  # fmt: skip

    same = ConcentricRobot(tuple(map(pieced, thesis.tubes)))
    for load in LOADS:
        one, other = (forward_kinematics(robot, ROTATIONS, load=load) for robot in (thesis, same))
        assert np.allclose(one.tip_position, other.tip_position, rtol=0, atol=1e-10)
        assert np.allclose(one.tip_rotations, other.tip_rotations, rtol=0, atol=1e-9)
        assert one.energy == pytest.approx(other.energy, rel=1e-9)


def test_files_and_studies_have_moments(thesis: ConcentricRobot, tmp_path: Path) -> None:
    path = tmp_path / "load.yaml"
    path.write_text(
        "points:\n  - {at_mm: 60, moment_mN_m: [6, -4, 8]}\n"
        "distributed_mN_per_m:\n  - {from_mm: 20, to_mm: 100, moment_mN_m_per_m: [30, 50, -40]}\n"
    )
    load = load_entry(path).build()
    assert load == Load(points=((0.06, NONE, COUPLE),), distributed=((0.02, 0.1, NONE, PER_LENGTH),))
    e = forward_kinematics(thesis, ROTATIONS, load=load)
    e.save(tmp_path)
    assert load_equilibrium(tmp_path).load == load
    assert load.scaled(2.0).points[0].moment == (0.012, -0.008, 0.016)
    assert between(load, load, 0.25).per_length(np.array([0.05]))[0, 3:] == pytest.approx(PER_LENGTH)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"points": ((0.05,),)}, r"points\[0\] is \(0\.05,\); it must be \(arc length, force"),
        ({"points": ((0.05, NONE, (1.0, 2.0)),)}, r"moment of points\[0\]"),
        ({"distributed": ((0.0, 0.1, NONE, NONE, NONE),)}, r"distributed\[0\] is .*; it must be \(start, end, force"),
        ({"distributed": ((0.0, 0.1, NONE, (1.0, np.nan, 0.0)),)}, r"moment of distributed\[0\]"),
    ],
)
def test_wrong_entries_are_named(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Load(**given)


def test_a_function_gives_as_many_numbers_everywhere(thesis: ConcentricRobot) -> None:
    """Else the moments beyond the plate would be left out without a word."""
    for first in ((0.0, 0.0, 0.0), None):
        load = Load(distributed=lambda s, first=first: first if s < 0.05 else (0.0, 0.0, 0.0, 0.0, 0.02, 0.0))
        with pytest.raises(InputError, match=r"distributed at .* m .* it must be 3 numbers"):
            forward_kinematics(thesis, ROTATIONS, load=load)
