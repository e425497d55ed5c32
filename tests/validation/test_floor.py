"""Floors of servos that the real robot keeps: a closed form, and robots that are drawn and solved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy

from tests.command_line import Run, refused
from tubeopt import ConcentricRobot, InputError, SolveError, forward_kinematics
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.inverse.joints import joint_space
from tubeopt.validation import real_robots, servo_floor
from tubeopt.validation.floor import _needed

from .test_posterior import uncertain

DRAWN, PLACES = 100, 10


def several() -> ConcentricRobot:
    """Two tubes that can snap, with four uncertain numbers."""
    names, units = ["rotation_2", "curvature_1", "torsional_stiffness_1", "curvature_2"], ["rad", "1/m", "", "1/m"]
    return uncertain(names, units, [0.04, 0.2, 0.04, 0.2])


def test_an_uncertain_zero_raises_the_snap_distance_by_half_its_quantile() -> None:
    """Turns of both tubes by d change their relative rotation by 2 d, and snaps come on both sides."""
    robot, stated, deviation = uncertain(["rotation_2"], ["rad"], [0.1]), 0.3, 0.1
    for confidence in (0.95, 0.999):
        found = servo_floor(robot, stated, confidence=confidence)
        expected = stated + deviation / 2 * scipy.special.ndtri((1 + confidence) / 2)
        assert found == pytest.approx(expected, rel=0.03)


def places(robot: ConcentricRobot, distance: float) -> list[Equilibrium]:
    """Equilibria with this snap distance, or up to 0.02 rad more, on random joint paths."""
    space, random, out = joint_space(robot), np.random.default_rng(5), list[Equilibrium]()
    while len(out) < PLACES:
        q = random.uniform(space.lower, space.upper)
        if not space.admissible(q):
            continue
        turn, shift = (np.array(each) for each in space.split(q))
        near, share, step = forward_kinematics(robot, turn * 0, shift), 0.0, 0.08
        while share + step <= 1 and step > 1e-3:
            try:
                e = forward_kinematics(robot, (share + step) * (turn - turn.mean()), shift, start=near)
                enough = e.snap_distance >= distance
            except SolveError:
                enough = False
            near, share, step = (e, share + step, step) if enough else (near, share, step / 2)
        if distance <= near.snap_distance < distance + 0.02:
            out.append(near)
    return out


def broken(robot: ConcentricRobot, distance: float, stated: float) -> float:
    """Fraction of drawn robots that miss the stated distance at one of the places with this distance at least."""
    reals, at = real_robots(robot), places(robot, distance)
    assert reals is not None

    def keeps(z: np.ndarray) -> bool:
        for near in at:
            real = reals.at(z, near.rotations, near.translations)
            try:
                if forward_kinematics(*real, start=near).snap_distance < stated:
                    return False
            except SolveError:
                return False
        return True

    return float(np.mean([not keeps(z) for z in np.random.default_rng(1).normal(size=(DRAWN, reals.size))]))


def test_the_real_robot_keeps_the_stated_distance() -> None:
    """At the stated distance most robots that may be fall short somewhere; at the raised one as few as told."""
    robot, stated = several(), 0.2
    likely, sure = (servo_floor(robot, stated, confidence=p) for p in (0.95, 0.999))
    assert stated < likely < sure < 0.7
    assert broken(robot, stated, stated) > 0.5
    assert broken(robot, likely, stated) <= 0.1
    assert broken(robot, sure, stated) <= 0.01


def test_what_is_needed_is_interpolated() -> None:
    """Distances 1, 2, 3 of a path, of which the real robot has z less: 1 is kept from 1 + z on."""
    drawn = np.array([[-0.5], [0.0], [0.25], [1.5], [5.0]])
    needed = _needed(np.array([1.0, 2.0, 3.0]), np.full((3, 1), -1.0), drawn, 1.0)
    np.testing.assert_allclose(needed, [0.0, 0.0, 1.25, 2.5, 3.0])


def test_floors_are_refused_and_exported(run: Run, tmp_path: Path) -> None:
    robot = several()
    with pytest.raises(InputError, match="no posterior"):
        servo_floor(replace(robot, posterior=None), 0.2)
    with pytest.raises(SolveError, match=r"with 99\.9 % the real robot keeps no such floor"):
        servo_floor(uncertain(["rotation_2"], ["rad"], [0.8]), 0.2)
    path, folder = str(tmp_path / "robot.yaml"), tmp_path / "c"
    robot.save(path)
    flags = "--confidence", "0.95", "--min-snap-distance-deg", "10"
    assert run("export", path, "--c", str(folder), *flags).code == 0
    header = (folder / "tubeopt_robot.h").read_text().splitlines()
    (line,) = (each for each in header if each.startswith("#define TUBEOPT_MIN_SNAP_DISTANCE"))
    floor = servo_floor(robot, np.radians(10), confidence=0.95)
    assert float(line.split()[2]) == pytest.approx(floor)
    assert f'<param name="min_snap_distance">{floor:.9g}</param>' in (folder / "tubeopt_robot.urdf").read_text()
    (message,) = refused(run("export", path, "--c", str(folder), *flags[:2]))
    assert "without --min-snap-distance-deg" in message
    replace(robot, posterior=None).save(path)
    (message,) = refused(run("export", path, "--c", str(folder), *flags))
    assert "the robot has no posterior" in message
