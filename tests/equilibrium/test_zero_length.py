"""An arm of length zero: all tubes withdrawn to the plate, where every insertion begins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tubeopt import (
    ConcentricRobot,
    Friction,
    InputError,
    Load,
    SolveError,
    find_stroke_force,
    follow,
    follow_the_leader,
    forward_kinematics,
    inverse_kinematics,
    load_equilibrium,
    load_robot,
    save_solid,
)
from tubeopt.control.command import Command, Why
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.jacobian import derivatives_of
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.equilibrium.verification import verify_equilibrium
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.posture import posture_of
from tubeopt.show.plots.shape import plot_shape
from tubeopt.show.surfaces import SampledCentreline

ROBOTS = Path("configs/robots")
NAMES = sorted(path.stem for path in ROBOTS.glob("*.yaml"))
SEGMENTED = "example_three_segment_etr"
"""Its segments cannot all be withdrawn: their curved parts would overlap."""
LENGTHS = (0.0, 1e-15, 1e-13, 1e-10, 1e-6)
"""Of the arm, m: none, below round-off, and hardly any."""


def withdrawn(name: str, length: float = 0.0, turn: float = 0.0) -> Equilibrium:
    """The equilibrium of a robot whose tubes all end `length` in front of the plate, by a cold solve."""
    robot = load_robot(ROBOTS / f"{name}.yaml")
    rotations = turn + np.linspace(0.3, -2.0, robot.n_tubes)
    return forward_kinematics(robot, rotations, [length - tube.curved_length for tube in robot.tubes])


@pytest.mark.parametrize("name", [name for name in NAMES if name != SEGMENTED])
@pytest.mark.parametrize("length", LENGTHS)
def test_every_robot_has_its_equilibrium_and_derivatives_at_length_zero(name: str, length: float) -> None:
    at = withdrawn(name, length)
    assert at.tip_position == pytest.approx([0, 0, length], abs=1e-10)
    assert at.margin == pytest.approx(1.0, abs=1e-4)
    for side in (1, -1):
        slopes = at.jacobian(side=side)
        tables = slopes.position, slopes.rotation, slopes.tip_rotations, slopes.margin, slopes.energy
        assert all(np.isfinite(table).all() for table in tables)


@pytest.mark.parametrize("name", [name for name in NAMES if name != SEGMENTED])
def test_derivatives_at_length_zero_are_those_of_an_arm_that_begins(name: str) -> None:
    # At 1 um in front of the plate every term of a derivative is there, and off by the length over a radius.
    current, reached = withdrawn(name).jacobian(), withdrawn(name, 1e-6).jacobian()
    for quantity in ("position", "rotation", "tip_rotations", "margin", "energy"):
        one, other = getattr(current, quantity), getattr(reached, quantity)
        assert one == pytest.approx(other, rel=1e-3, abs=5e-3 * max(1.0, np.abs(other).max())), quantity
    back = withdrawn(name).jacobian(side=-1)
    n = len(back.margin) // 2
    assert not back.position.any()
    assert not back.rotation[:, n:].any()


def test_a_tube_that_leaves_the_plate_alone_turns_the_tip_by_its_curvature() -> None:
    robot = load_robot(ROBOTS / "thesis_ctr.yaml")
    assert isinstance(robot, ConcentricRobot)
    at, n = withdrawn("thesis_ctr"), robot.n_tubes
    slopes = at.jacobian()
    kappa = np.array([tube.curvature for tube in robot.tubes])
    assert slopes.position[:, n:] == pytest.approx(np.outer([0, 0, 1], np.ones(n)), abs=1e-12)
    own = np.array([kappa * np.cos(at.rotations), kappa * np.sin(at.rotations)])
    assert slopes.rotation[:2, n:] == pytest.approx(own, rel=1e-12)
    assert slopes.tip_rotations[:, :n] == pytest.approx(np.eye(n))
    # Nothing is stored in a tube that bends as it was made.
    assert slopes.energy == pytest.approx(np.zeros(2 * n), abs=1e-15)


def test_tubes_of_one_carriage_leave_the_plate_with_the_energy_of_their_straightening() -> None:
    at = withdrawn("two_tube")
    robot, together = at.robot, ((0, 1),)
    kb, kappa = (np.array([getattr(tube, key) for tube in robot.tubes]) for key in ("bending_stiffness", "curvature"))
    pull = kb * kappa * np.exp(1j * at.rotations)
    u = pull.sum() / kb.sum()
    slopes = derivatives_of(at, carriages=together)
    assert slopes.energy[2:].sum() == pytest.approx((kb @ kappa**2 - abs(pull.sum()) ** 2 / kb.sum()) / 2, rel=1e-12)
    assert slopes.tip_rotation[:2, 2:].sum(1) == pytest.approx([u.real, u.imag], rel=1e-12)
    assert slopes.tip_position[:, 2:].sum(1) == pytest.approx([0, 0, 1])
    # The margin begins to fall: twice the rate of coupling over the springs of both transmissions, in series.
    coupling = (pull[0] * pull[1].conjugate()).real / kb.sum()
    held = np.array([tube.length for tube in robot.tubes]) / [tube.torsional_stiffness for tube in robot.tubes]
    assert slopes.margin[2:].sum() == pytest.approx(min(0.0, coupling * held.sum()), rel=1e-12)
    # What leaves the plate twists the transmissions.
    assert slopes.tip_rotations[:, 2:].sum(1) == pytest.approx(-held * (u.conjugate() * pull).imag, rel=1e-12)
    apart = withdrawn("two_tube", turn=0.0)
    opposed = forward_kinematics(robot, [0.0, 2.5], apart.translations)
    pull = kb * kappa * np.exp(1j * opposed.rotations)
    coupling = (pull[0] * pull[1].conjugate()).real / kb.sum()
    falls = derivatives_of(opposed, carriages=together).margin[2:].sum()
    assert falls == pytest.approx(coupling * held.sum(), rel=1e-12)
    assert falls < -1


@pytest.mark.parametrize("length", [0.0, 0.02])
def test_one_joint_of_two_tubes_moves_the_tip_once(length: float) -> None:
    # Each tube alone pushes the tip; both at once push it no farther.
    at = withdrawn("two_tube", length)
    space = joint_space(at.robot)
    assert len(space.carriages) == 1
    slope = posture_of(space, at).jacobian[0][:, -1]
    beyond = forward_kinematics(at.robot, at.rotations, at.translations + 1e-6)
    assert slope == pytest.approx((beyond.tip_position - at.tip_position) / 1e-6, abs=1e-4)


def test_natural_twist_behind_the_plate_turns_a_tube_that_ends_there() -> None:
    at, near = withdrawn("example_pieces"), withdrawn("example_pieces", 1e-7)
    assert np.abs(near.tip_rotations - near.rotations).max() > 0.1
    assert at.tip_rotations == pytest.approx(near.tip_rotations, abs=1e-4)


@pytest.mark.parametrize("name", ["thesis_ctr", "two_tube", "thesis_etr", "example_pieces"])
def test_a_branch_goes_out_from_the_plate_and_back(name: str) -> None:
    at = withdrawn(name, turn=2.5)
    out = forward_kinematics(at.robot, at.rotations, at.translations + 0.02, start=at)
    cold = forward_kinematics(at.robot, at.rotations, at.translations + 0.02)
    assert out.tip_position == pytest.approx(cold.tip_position, abs=1e-8)
    back = forward_kinematics(at.robot, at.rotations, at.translations, start=out)
    assert back.tip_position == pytest.approx([0, 0, 0], abs=1e-15)
    assert verify_equilibrium(back).verification is not None


@pytest.mark.parametrize("name", ["thesis_ctr", "two_tube", "thesis_etr", "example_pieces"])
def test_a_servo_leaves_the_plate(name: str) -> None:
    at = withdrawn(name)
    servo, dt = Servo(at.robot, at), 1e-2
    for _ in range(20):
        before = servo.equilibrium
        step = servo.step(Command(velocity=[0, 0, 0.01]), dt)
        assert np.abs(step.translations - before.translations).max() <= servo.options.shift_rate * dt * (1 + 1e-12)
    assert servo.equilibrium.tip_position[2] == pytest.approx(2e-3, rel=0.1)
    # And comes back to it, where nothing can go on.
    for _ in range(30):
        step = servo.step(Command(velocity=[0, 0, -0.01]), dt)
    assert servo.equilibrium.tip_position[2] == pytest.approx(0, abs=1e-6)
    assert step.why & Why.RANGE


def test_inverse_kinematics_starts_at_the_plate_and_goes_there() -> None:
    at = withdrawn("thesis_ctr")
    target = forward_kinematics(at.robot, [0.4, 0.2, 0.1], at.translations + 0.02).tip_position
    solution = inverse_kinematics(at.robot, target, start=at, reachable=True)
    assert solution.equilibrium.tip_position == pytest.approx(target, abs=1e-6)
    home = inverse_kinematics(at.robot, [0, 0, 0], start=at)
    assert home.equilibrium.tip_position == pytest.approx([0, 0, 0], abs=1e-6)
    with pytest.raises(SolveError, match="5 mm short"):
        inverse_kinematics(at.robot, [0, 0, -5e-3], start=at)


def test_what_needs_an_arm_says_that_there_is_none(tmp_path: Path) -> None:
    at = withdrawn("thesis_ctr")
    for length in (0.0, 1e-13):
        with pytest.raises(InputError, match="no tube is in front of the base plate"):
            forward_kinematics(at.robot, at.rotations, at.translations + length, load=Load(force=(0.1, 0, 0)))
    with pytest.raises(InputError, match="goal has no tube in front of the plate"):
        follow_the_leader(at.robot, at)
    with pytest.raises(InputError, match="no tube is in front of the base plate"):
        find_stroke_force(at.robot, at.rotations, at.translations)
    at.save(tmp_path / "at")
    assert load_equilibrium(tmp_path / "at").tip_position == pytest.approx([0, 0, 0])


@pytest.mark.parametrize("name", ["thesis_ctr", "two_tube", "example_pieces"])
@pytest.mark.parametrize("friction", [Friction(torque=1e-3), Friction(plate=1e-3, jumps=1e-4, ends=1e-4)])
def test_a_motion_with_friction_begins_and_ends_at_the_plate(name: str, friction: Friction) -> None:
    at = withdrawn(name)
    turns = at.rotations + np.array([0.0, 0.3, 0.3, 0.0])[:, None]
    shifts = at.translations + np.array([0.0, 0.0, 0.02, 0.0])[:, None]
    path = follow(at.robot, turns, shifts, friction=friction)
    assert path.equilibria[-1].tip_position == pytest.approx([0, 0, 0], abs=1e-12)


def test_an_arm_of_length_zero_is_drawn_and_has_no_surface(tmp_path: Path) -> None:
    at = withdrawn("thesis_ctr")
    assert plot_shape(at) is not None
    assert not SampledCentreline(at).position([0.0]).any()
    with pytest.raises(InputError, match="no tube is in front of the base plate"):
        save_solid(at, tmp_path / "arm.stl")
    assert not list(tmp_path.iterdir())


def test_a_section_next_to_nothing_has_tubes_in_it() -> None:
    # Two ends 3e-12 m apart: what lies inside that section rounds to where it ends.
    robot = load_robot(ROBOTS / "example_pieces.yaml")
    shift = [-0.10997135502651482, -0.039971355023306426, -0.03233539074900648]
    at = forward_kinematics(robot, [-3.4, 0.6, 0.0], shift)
    assert np.diff(np.append(at.section_start, at.arc_length[-1])).min() < 1e-11
    assert np.isfinite(at.jacobian().position).all()
