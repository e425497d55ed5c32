"""Tips that follow the centreline of vessels, which their arms touch."""

from __future__ import annotations

import numpy as np
import pytest

import tubeopt
from tubeopt.bodies import Corridor
from tubeopt.errors import InputError

RADIUS, BEND = 1.5e-3, 40e-3


def vessel(angle):
    """Vessel of a straight part of 8 mm and a bend of radius BEND, and its centreline from the bend on."""
    turn = np.linspace(0, angle, 8)
    bend = np.column_stack([BEND * (1 - np.cos(turn)), 0 * turn, 8e-3 + BEND * np.sin(turn)])
    beyond = bend[-1] + 0.02 * np.array([np.sin(angle), 0, np.cos(angle)])
    return Corridor([[0, 0, -0.02], *bend, beyond], RADIUS), bend


@pytest.fixture(scope="module")
def bent():
    """Deployment of a robot whose tubes are less curved than the vessel, and the vessel."""
    body, bend = vessel(0.7)
    robot = tubeopt.load_robot("thesis_ctr")
    counted = []
    motion = tubeopt.deploy(robot, bend[1:], walls=[body], tolerance=RADIUS, progress=counted.append)
    assert counted == list(range(1, len(motion.points)))
    return motion, body


def test_the_tip_reaches_the_end_of_a_vessel_that_its_arm_touches(bent):
    motion, body = bent
    assert motion.status is tubeopt.DeploymentStatus.REACHED
    assert motion.misses[-1] < RADIUS
    assert 0 < motion.largest_force <= 0.5
    # Free tubes of this robot curve by 10 1/m at most, the vessel by 25 1/m: the same joint values lead out of it.
    end = motion.equilibria[-1]
    assert end.walls.contacts
    free = tubeopt.forward_kinematics(end.robot, end.rotations, end.translations)
    assert body.signed_distance(free.position).min() < 0


def test_the_motion_is_that_of_following_its_joint_values(bent):
    motion, body = bent
    path = tubeopt.follow(
        motion.equilibria[0].robot, motion.rotations, motion.translations, start=motion.equilibria[0], walls=[body]
    )
    assert not path.snaps
    tips = np.array([each.tip_position for each in motion.equilibria])
    assert np.allclose(path.value, tips, atol=1e-8)
    forces = [contact.size for each in path.equilibria for contact in each.walls.contacts]
    assert max(forces) <= motion.largest_force * (1 + 1e-6)


def test_a_limit_on_forces_is_kept_and_named():
    body, bend = vessel(0.7)
    motion = tubeopt.deploy(
        tubeopt.load_robot("thesis_ctr"), bend[3:6], walls=[body], tolerance=1e-4, largest_force=0.05
    )
    assert motion.largest_force <= 0.05
    assert motion.status is tubeopt.DeploymentStatus.BLOCKED
    assert "mm from the path" in motion.reason


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"walls": []}, "walls is empty"),
        ({"largest_force": 0.0}, "largest_force is 0"),
        ({"path": [[0, 0]]}, "path has shape"),
    ],
)
def test_wrong_input_is_refused(changes, message):
    body, bend = vessel(0.2)
    arguments = {"path": bend, "walls": [body]} | changes
    with pytest.raises(InputError, match=message):
        tubeopt.deploy(tubeopt.load_robot("thesis_ctr"), **arguments)
