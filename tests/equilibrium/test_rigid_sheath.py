"""Bundles whose sheath is rigid at the plate, at its tip, or both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from tubeopt import (
    BundleRobot,
    Friction,
    InputError,
    Load,
    certify,
    follow,
    load_robot,
    save_robot,
    snap_free_certificate,
)
from tubeopt.control.c_library import c_library

from .test_bundle import ROOT, bundle_of_thesis, random_bundle, tube

LENGTH, TIP = 0.02, 0.065

LOADS = [
    None,
    Load((0.03, 0.02, -0.01)),
    Load((0.01, 0.0, 0.05), (0.002, -0.003, 0.004), frame="tip"),
    Load(gravity=(0.0, -9.81, 3.0), points=((0.012, (0.1, 0.0, 0.0)), (0.05, (0.03, 0.0, 0.02)))),
]


def rigid(seed: int) -> tuple[BundleRobot, Any, Any]:
    """A random bundle with a rigid part at the plate and a rigid tip, with joint values."""
    robot, alpha, shift = random_bundle(np.random.default_rng(seed))
    tubes = tuple(replace(each, mass_per_length=0.02 * k) for k, each in enumerate(robot.tubes, 1))
    return replace(robot, tubes=tubes, sheath_rigid_length=LENGTH, sheath_rigid_from=TIP), alpha, shift


@pytest.mark.parametrize("load", LOADS)
def test_integrated_forces_and_moments_give_the_same_arm(load: Load | None) -> None:
    for seed in (1, 3):
        robot, alpha, shift = rigid(seed)
        pose = robot.fk(alpha, shift, load=load)
        check = pose.verified().verification
        assert check is not None
        assert check.tip_position < 1e-10
        assert check.rotation < 1e-9
        assert check.end_torsion < 1e-7
        assert check.end_curvature < 1e-10
        straight = (pose.arc_length <= LENGTH) | (pose.arc_length > TIP + 1e-9)
        assert not pose.curvature[straight].any()
        assert np.abs(pose.curvature[~straight]).max() > 1
        if load is not None and load.has_energy:
            assert np.abs(pose.compliance - pose.compliance.T)[:3, :3].max() < 1e-10


def test_behind_the_end_of_the_rigid_part_tubes_are_held_as_behind_the_plate() -> None:
    for seed in (0, 2):
        robot, alpha, shift = random_bundle(np.random.default_rng(seed))
        tubes = tuple(each.resized("straight_length", each.straight_length + 0.03) for each in robot.tubes)
        robot = replace(robot, tubes=tubes)
        shaft, force = replace(robot, sheath_rigid_length=LENGTH), Load((0.03, 0.02, -0.01))
        for load in (None, force):
            mine, other = shaft.fk(alpha, shift, load=load), robot.fk(alpha, shift - LENGTH, load=load)
            assert np.abs(mine.tip_position - [0, 0, LENGTH] - other.tip_position).max() < 1e-12
            assert mine.margin == pytest.approx(other.margin, abs=1e-9)
            assert mine.energy == pytest.approx(other.energy, abs=1e-14)
        lever = np.cross([0, 0, LENGTH], force.force)
        assert np.abs(mine.base_wrench[3:] - other.base_wrench[3:] - lever).max() < 1e-14
        # The kernel solves the arm beyond the rigid part, the general solver and the integration all of it.
        check = shaft.fk(alpha, shift).verified().verification
        assert check is not None
        assert max(check.tip_position, check.rotation, check.base_rotation) < 1e-8
        start = replace(robot, sheath_rigid_length=LENGTH, sheath_rigid_from=1.0)
        assert np.abs(start.fk(alpha, shift).tip_position - shaft.fk(alpha, shift).tip_position).max() < 1e-11
        path = follow(shaft, [alpha, alpha + 0.1], [shift, shift - 0.002]).equilibria[-1]
        assert np.abs(path.tip_position - shaft.fk(alpha + 0.1, shift - 0.002).tip_position).max() < 1e-11


def test_a_tube_of_great_stiffness_makes_a_part_rigid() -> None:
    tubes = tuple(tube(0.02 * f, 0.015 * f, k, 0.0, 0.08) for f, k in ((1.0, 14.0), (0.5, 10.0), (1.5, 0.0)))
    robot = BundleRobot(tubes, (0.004,) * 3, (0.0, 2.0, -2.0), sheath_rigid_length=LENGTH)
    alpha, load = np.array([0.0, 1.0, -0.5]), Load((0.05, 0.02, 0.0))
    pose, apart = robot.fk(alpha, load=load), []
    for factor in (1e3, 2e3):
        core = tube(0.02 * factor, 0.015, 0.0, 0.0, LENGTH)
        stiff = BundleRobot((*tubes, core), (*robot.offset, 0.0), (*robot.angle, 0.0))
        apart.append(stiff.fk([*alpha, 0.0], load=load).tip_position - pose.tip_position)
    assert np.abs(apart[0]).max() > 1e-6
    # What a finite stiffness leaves falls with it, to first order.
    assert np.abs(2 * apart[1] - apart[0]).max() < 2e-3 * np.abs(apart[0]).max()


def test_a_tube_that_ends_in_a_rigid_tip_is_pushed_by_what_straightens_it() -> None:
    kb, kappa, offset, length = 0.02, 10.0, 0.006, 0.06
    one = tube(kb, 0.015, kappa, 0.0, 0.1)
    for angle in (90.0, -90.0):
        robot = BundleRobot((one,), (offset,), (np.radians(angle),), sheath_rigid_from=length)
        pose, lever = robot.fk([0.0]), offset * np.sin(np.radians(angle))

        # Energy per length of the sheath: kb (u^2 / g - 2 kappa u + kappa^2 g) / 2, less kb kappa^2 g / 2 in the tip.
        def slope(u: float, lever: float = lever) -> float:
            g = 1 + lever * u
            return 2 * u / g - u**2 * lever / g**2 - 2 * kappa

        u = brentq(slope, 1.0, 20.0)
        assert pose.curvature[1] == pytest.approx([u, 0.0], abs=1e-9)
        assert abs(u - kappa) > 0.1
        assert pose.tube_end[0] == pytest.approx(0.1 - length * lever * u, abs=1e-12)
        turn, beyond = u * length, pose.tube_end[0] - length
        tip = [0.0, -(1 - np.cos(turn)) / u - beyond * np.sin(turn), np.sin(turn) / u + beyond * np.cos(turn)]
        assert np.abs(pose.tip_position - tip).max() < 1e-11


@pytest.mark.parametrize("load", [None, LOADS[1], LOADS[2]])
def test_derivatives_by_the_rigid_parts_are_those_of_differences(load: Load | None) -> None:
    robot, alpha, shift = rigid(1)
    pose, names = robot.fk(alpha, shift, load=load), ("sheath_rigid_length", "sheath_rigid_from")
    jacobian = pose.jacobian(wrt=names)
    for c, name in enumerate(names):
        ahead, behind = (
            replace(robot, **{name: getattr(robot, name) + step}).fk(alpha, shift, load=load, start=pose)
            for step in (1e-6, -1e-6)
        )
        for quantity, slope in (
            ("tip_position", jacobian.position[:, c]),
            ("tip_rotations", jacobian.tip_rotations[:, c]),
            ("margin", jacobian.margin[c]),
            ("energy", jacobian.energy[c]),
        ):
            change = (getattr(ahead, quantity) - getattr(behind, quantity)) / 2e-6
            assert np.abs(change - slope).max() < 1e-8
            assert quantity == "tip_rotations" or np.abs(slope).max() > 1e-5
    there = replace(robot, sheath_rigid_from=0.05)
    with pytest.raises(InputError, match=r"the load begins, ends or acts there, at 0\.05 m"):
        there.fk(alpha, shift, load=LOADS[3]).jacobian(wrt=["sheath_rigid_from"])


def test_tubes_begin_to_curve_where_they_leave_the_rigid_part() -> None:
    tubes = tuple(tube(0.02, 0.015, k, 0.06, 0.08) for k in (12.0, 10.0, 8.0))
    robot = BundleRobot(tubes, (0.003, 0.004, 0.005), (0.0, 2.0, 4.0), sheath_rigid_length=LENGTH)
    shifts = np.array([[0.0, 0.01, -0.01], [0.03, 0.035, 0.022], [0.01, 0.015, 0.021]])
    path = follow(robot, np.tile([0.3, 1.0, -2.0], (3, 1)), shifts)
    assert not path.snaps
    bare = replace(robot, sheath_rigid_length=0.0)
    for pose, shift in zip(path.equilibria[1:], shifts[1:], strict=True):
        other = bare.fk(pose.rotations, shift - LENGTH)
        assert np.abs(pose.tip_position - [0, 0, LENGTH] - other.tip_position).max() < 1e-11
        assert np.abs(pose.tube_end - LENGTH - other.tube_end).max() < 1e-12
    withdrawn = robot.fk([0.3, 1.0, -2.0], [0.0, 0.0, -0.07])
    assert withdrawn.tube_end[2] == pytest.approx(0.01)
    with pytest.raises(InputError, match="no tube is beyond the rigid part of the sheath"):
        robot.fk([0.0, 0.0, 0.0], [-0.065, -0.065, -0.065])


def test_ends_pass_each_other_in_a_rigid_tip_without_a_jump() -> None:
    robot = replace(bundle_of_thesis(), sheath_rigid_from=0.09)
    path = follow(robot, np.radians([[0, 0, 0], [30, -90, -30], [0, 180, 90]]))
    assert not path.snaps
    order = [np.argsort(pose.tube_end).tolist() for pose in path.equilibria[1:]]
    assert order[0] != order[1]
    for pose in path.equilibria[1:]:
        assert np.abs(pose.tip_position - robot.fk(pose.rotations).tip_position).max() < 1e-9


def test_a_certificate_is_that_of_the_arm_beyond_the_rigid_part() -> None:
    tubes = tuple(tube(0.02, 0.015, k, 0.03, length) for k, length in ((8.0, 0.094), (6.0, 0.091)))
    robot = BundleRobot(tubes, (1.1e-3, 1.1e-3), (0.0, np.pi))
    shaft, back = replace(robot, sheath_rigid_length=LENGTH), np.full(2, -LENGTH)
    proved = snap_free_certificate(shaft)
    assert proved == pytest.approx(snap_free_certificate(robot, back), abs=1e-12)
    assert 0.4 < proved != pytest.approx(snap_free_certificate(robot), abs=0.01)
    assert certify(shaft).gradient["curvature"] == pytest.approx(certify(robot, back).gradient["curvature"], rel=1e-9)
    tip = replace(robot, sheath_rigid_from=0.08)
    assert snap_free_certificate(tip) == -np.inf
    assert certify(tip).obstacle == "the sheath is rigid from 80 mm on; there is a proof for flexible tips only."
    with pytest.raises(InputError, match="rigid"):
        c_library(shaft)


def test_robot_files_keep_rigid_parts(tmp_path: Path) -> None:
    robot = rigid(0)[0]
    save_robot(robot, tmp_path / "robot.yaml")
    assert load_robot(tmp_path / "robot.yaml") == robot
    assert "sheath_rigid_from_mm: 65" in (tmp_path / "robot.yaml").read_text()
    with pytest.raises(InputError, match=r"sheath_rigid_from is 0.01 m; it must be greater than sheath_rigid_length"):
        replace(robot, sheath_rigid_from=0.01)


def test_friction_with_a_rigid_tip_heats_by_what_the_drives_put_in() -> None:
    sheath = load_robot(ROOT / "configs" / "bundles" / "steerable_sheath.yaml")
    assert isinstance(sheath, BundleRobot)
    robot, torque, load = replace(sheath, sheath_rigid_from=0.07), 0.01, Load((0.03, 0.0, 0.0))
    # Tube 2 slips all along from 20 deg on; before, a part of it is stuck.
    way = np.radians([[0.0, angle, 0.0] for angle in (0.0, 20.0, *np.linspace(22, 40, 10))])
    states = follow(robot, way, friction=Friction(torque=torque), load=load).equilibria[1:]
    lever = np.array(robot.offset)[:, None] * np.column_stack([np.sin(robot.angle), -np.cos(robot.angle)])
    kt = np.array([float(each.torsional_stiffness) for each in robot.tubes])
    drives = np.array([-kt * e.torsion[:, 0] / (1 + lever @ e.curvature[0]) for e in states])
    done = float(((drives[1:] + drives[:-1]) / 2 * np.diff(way[1:], axis=0)).sum())
    first, last = states[0], states[-1]
    assert first.friction is not None
    assert last.friction is not None
    heat = last.friction.heat - first.friction.heat
    stored = last.energy - first.energy - (last.work - first.work)
    assert heat > 1e-4
    assert done == pytest.approx(stored + heat, rel=1e-3)
