"""Buffer section between drive and sheath: against integrated forces, small shifts, and a chain of links."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy

from tests.command_line import Run
from tubeopt import BundleRobot, InputError, load_robot
from tubeopt.physics.buffer import STEEPEST, buffer_bend
from tubeopt.robots.eccentric import Buffer, EccentricRobot, buffered_tubes
from tubeopt.typing import Array

LENGTH = 0.05


def energy(shift: float, length: float) -> float:
    """Bending energy per EI, by integration from the drive; fails if the tube does not reach the sheath."""
    bend = buffer_bend(shift, length)

    def rates(_: float, y: Array) -> list[float]:
        _, _, slope, curvature, _ = y
        change = -bend.across * np.cos(slope) - bend.along * np.sin(slope)
        return [np.sin(slope), np.cos(slope), curvature, change, curvature**2 / 2]

    start = [0.0, 0.0, 0.0, bend.curvature, 0.0]
    run = scipy.integrate.solve_ivp(rates, (0, bend.length), start, method="DOP853", rtol=1e-12, atol=1e-13)
    aside, along, slope, curvature, out = run.y[:, -1]
    assert (aside, along, slope) == pytest.approx((shift, length, 0.0), abs=1e-10)
    assert curvature == pytest.approx(-bend.curvature)
    assert np.abs(run.y[2]).max() <= bend.slope * (1 + 1e-9)
    return float(out)


@pytest.mark.parametrize("shift", [1e-3, 0.01155, 0.04, 0.08])
def test_forces_bend_the_tube_from_the_drive_to_the_sheath_and_do_the_work(shift: float) -> None:
    bend, h = buffer_bend(shift, LENGTH), 1e-6
    across = (energy(shift + h, LENGTH) - energy(shift - h, LENGTH)) / (2 * h)
    along = (energy(shift, LENGTH + h) - energy(shift, LENGTH - h)) / (2 * h)
    assert across == pytest.approx(bend.across, rel=1e-5)
    assert along == pytest.approx(-bend.along, rel=1e-5)


def test_small_shifts_are_those_of_a_beam() -> None:
    bend, shift = buffer_bend(1e-5, LENGTH), 1e-5
    assert bend.slope == pytest.approx(1.5 * shift / LENGTH, rel=1e-6)
    assert bend.curvature == pytest.approx(6 * shift / LENGTH**2, rel=1e-6)
    assert bend.across == pytest.approx(12 * shift / LENGTH**3, rel=1e-6)
    assert bend.length - LENGTH == pytest.approx(0.6 * shift**2 / LENGTH, rel=1e-4)
    assert buffer_bend(0.999 * STEEPEST * LENGTH, LENGTH).slope == pytest.approx(np.pi / 2, abs=2e-2)


def test_a_chain_of_links_of_any_length_has_the_same_shape() -> None:
    count, shift = 60, 0.01155

    def bending(x: Array) -> float:
        turns = np.diff(np.concatenate([[-x[0]], x[:-1], [-x[-2]]]))
        # Links meet at half a link from the ends, where the slope is 0.
        squares = float((turns[1:-1] ** 2).sum() + (turns[0] ** 2 + turns[-1] ** 2) / 2)
        return squares * count * LENGTH / (2 * float(x[-1]))

    ends = {"type": "eq", "fun": lambda x: 20 * np.array([x[-1] * np.mean(f(x[:-1])) - e for f, e in
            ((np.sin, shift), (np.cos, LENGTH))])}  # fmt: skip
    start = np.append(0.34 * np.sin(np.pi * (np.arange(count) + 0.5) / count), 0.0515)
    found = scipy.optimize.minimize(bending, start, constraints=[ends], options={"maxiter": 500, "ftol": 1e-12})
    bend = buffer_bend(shift, LENGTH)
    assert found.success
    assert found.x[-1] == pytest.approx(bend.length, rel=2e-4)
    assert found.x[:-1].max() == pytest.approx(bend.slope, rel=2e-3)
    assert bending(found.x) / LENGTH == pytest.approx(energy(shift, LENGTH), rel=2e-3)


def test_tubes_merge_from_the_gap_and_play_grows_with_friction_and_room(run: Run, tmp_path: Path) -> None:
    thesis = load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    assert buffered_tubes(thesis) == []
    robot = replace(thesis, buffer=Buffer(LENGTH, 0.02, guide=0.01, friction=0.1, clearance=1e-4))
    tube, *others = buffered_tubes(robot)
    # Centres of touching tubes are a diameter apart, at the drive 20 mm more; the shift is that over sqrt(3).
    assert tube.shift == pytest.approx(0.02 / np.sqrt(3))
    assert all(other == pytest.approx(tube) for other in others)
    assert tube.strain == pytest.approx(0.96e-3 / tube.radius)
    # Torque of friction, on a radius of 0.96 mm, over the torsional stiffness of the tube in the buffer.
    moment = thesis.tube.bending_stiffness / tube.radius
    torque = 0.1 * 0.96e-3 * (2 * moment / 0.01 + tube.force)
    assert tube.turn_play == pytest.approx(torque * tube.length / thesis.tube.torsional_stiffness)
    assert tube.slide_play == pytest.approx(1e-4 * 1.2 * tube.shift / LENGTH, rel=0.05)
    assert buffered_tubes(robot.bundle()) == buffered_tubes(robot)
    robot.save(tmp_path / "robot.yaml")
    assert load_robot(tmp_path / "robot.yaml") == robot
    robot.bundle().save(tmp_path / "bundle.yaml")
    assert load_robot(tmp_path / "bundle.yaml") == robot.bundle()
    shown = " ".join(run("robot", "show", str(tmp_path / "bundle.yaml")).out.split())
    assert "moves aside by 11.55 mm, at up to 19.5 deg and 2.52 % strain" in shown
    assert "Play: up to 2.38 deg of a turn" in shown
    # The S strains the tubes, which turn in it; and their curves begin in it, since they have no straight parts.
    assert "warning: tube 1 is strained 2.52 % in the buffer, where it turns, beyond the 1 % limit of nitinol" in shown
    assert "tube 3 is straight over 0 mm, and the buffer takes 51.58 mm" in shown
    assert replace(thesis, transmission_length=0.052, buffer=Buffer(LENGTH, 0.005)).buffer_warnings == []


def test_a_tube_on_the_axis_stays_straight_and_wide_drives_are_refused() -> None:
    tube = load_robot("thesis_etr").tubes[0]
    robot = BundleRobot((tube, tube), (0.0, 2e-3), (0.0, 0.0), buffer=Buffer(LENGTH, 0.02))
    centre, side = buffered_tubes(robot)
    assert centre.shift == centre.strain == centre.slide_play == 0.0
    assert side.shift == pytest.approx(0.02 + tube.outer_diameter - 2e-3)
    with pytest.raises(InputError, match=r"by less than 1[.]67 times the length"):
        buffered_tubes(replace(robot, buffer=Buffer(0.01, 0.02)))
    with pytest.raises(InputError, match="guide of the buffer is missing"):
        Buffer(LENGTH, 0.02, friction=0.1)
