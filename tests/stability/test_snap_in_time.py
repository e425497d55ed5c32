"""The snap in time: energies, vibrations and damping in closed form, and an independent chain of nodes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy

from tests.examples import CRL, DEG, nested
from tests.stability.rod_dynamics import Chain, motion_of
from tubeopt import (
    ConcentricRobot,
    Friction,
    InputError,
    Load,
    Material,
    Snap,
    SnapInTime,
    find_snap,
    follow,
    load_robot,
    snap_in_time,
)
from tubeopt.block.transcription.inertia import TubeMotion
from tubeopt.equilibrium.kinematics import forward_kinematics, unsolved
from tubeopt.robots.materials import THERMAL_DATA
from tubeopt.robots.robot import Robot
from tubeopt.robots.tubes import mass_per_length
from tubeopt.stability.snap_in_time import MotionEnd, vibrations
from tubeopt.typing import Array

TILL = load_robot("till_snapping_pair")
SHIFT = (7.97e-3, 13.2e-3)

RATE = 100.0
"""Rotation rate of the drive in the comparison with the chain, rad/s."""


def test_an_arm_that_turns_as_a_whole_dissipates_nothing() -> None:
    """Every tube and the curvature turn at one rate, so that no fibre changes its length."""
    system, y, _ = motion(CRL, np.array([0.4, 1.3, -0.7]), 1e-6, Load())
    together, alone = np.zeros(len(y)), np.zeros(len(y))
    together[-CRL.n_tubes :], alone[-1] = 1.0, 1.0
    damping = system.slopes(y).damping
    assert abs(together @ damping @ together) < 1e-9 * (alone @ damping @ alone)


@pytest.fixture(scope="module")
def crl_snap() -> Snap:
    home = [0.0, 0.0, 0.0]
    snap = find_snap(CRL, (home, home), (np.radians([360.0, 0.0, 0.0]), home))
    assert snap is not None
    return snap


@pytest.fixture(scope="module")
def till_snap() -> Snap:
    snap = find_snap(TILL, ([0.0, 0.0], SHIFT), ([2 * np.pi, 0.0], SHIFT))
    assert snap is not None
    return snap


def motion(robot: Robot, rotations: Array, relaxation: float, load: Load) -> tuple[TubeMotion, Array, Array]:
    """System, coordinates and Hessian at an equilibrium."""
    pose = forward_kinematics(robot, rotations, load=load if load != Load() else None)
    member, x = unsolved(pose, load)
    density = np.array([mass_per_length(tube) for tube in robot.tubes], dtype=float)
    diameters = np.array([[tube.outer_diameter, tube.inner_diameter] for tube in robot.tubes])
    system = TubeMotion(member.problem, density, diameters, np.full(robot.n_tubes, relaxation))
    return system, np.concatenate([x, rotations]), member.at(x).hessian


def test_derivatives_of_a_motion_are_those_of_differences() -> None:
    system, y, hessian = motion(CRL, np.array([0.4, 1.3, -0.7]), 1e-6, Load())
    random = np.random.default_rng(1)
    y, d, step = y + 0.01 * random.normal(size=len(y)), random.normal(size=len(y)), 1e-6
    ahead, behind, slopes = system.at(y + step * d), system.at(y - step * d), system.slopes(y)
    assert (ahead.energy - behind.energy) / (2 * step) == pytest.approx(float(system.at(y).gradient @ d), rel=1e-7)
    np.testing.assert_allclose((ahead.position - behind.position) / (2 * step), slopes.position @ d, atol=1e-6)
    d[len(hessian) :] = 0.0
    ahead, behind = system.at(y + step * d), system.at(y - step * d)
    change = ((ahead.gradient - behind.gradient) / (2 * step))[: len(hessian)]
    np.testing.assert_allclose(change, slopes.stiffness @ d[: len(hessian)], rtol=1e-6, atol=1e-7)
    # The shape for pictures is the same arm.
    shape = system.shape(y)
    weight = system.problem.torsion.weight
    tip = weight @ system.at(y).position[: 3 * len(weight)].reshape(-1, 3)
    np.testing.assert_allclose(shape.position[-1], tip, atol=1e-12)
    np.testing.assert_allclose(shape.rotation[:, -1], system.tip_rotations(y), atol=1e-12)


def test_a_straight_tube_vibrates_and_is_damped_as_a_cantilever() -> None:
    length, relaxation = 0.1, 1e-6
    alloy = Material("nitinol with mass", 58e9, 21.5e9, thermal=THERMAL_DATA["nitinol"])
    robot = nested((0.0, length, 0.0), material=alloy)
    system, y, hessian = motion(robot, np.zeros(1), relaxation, Load())
    result = vibrations(system, y, hessian)
    tube = robot.tubes[0]
    # Roots of cos x cosh x = -1; every mode in two planes.
    roots = np.array([scipy.optimize.brentq(lambda x: np.cos(x) + 1 / np.cosh(x), a, b) for a, b in ((1, 3), (4, 5))])
    omega = roots**2 / length**2 * np.sqrt(tube.bending_stiffness / float(system.density[0]))
    np.testing.assert_allclose(result.frequency[:4], np.repeat(omega, 2) / (2 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(result.ratio[:4], relaxation * np.repeat(omega, 2) / 2, rtol=1e-6)


def test_tubes_twist_as_shafts_with_their_transmissions() -> None:
    # So weakly curved that their coupling is nothing, and bent on their own they would not move: only twist is left.
    alloy = Material("nitinol with mass", 58e9, 21.5e9, thermal=THERMAL_DATA["nitinol"])
    robot = nested((0.06, 0.06, 0.2), (0.0, 0.06, 0.2), material=alloy)
    system, _, hessian = motion(robot, np.zeros(2), 1e-6, Load())
    free = system.problem.torsion.size
    size = scipy.linalg.eigh(system.spin[:free, :free], hessian[:free, :free], eigvals_only=True)
    wave = np.sqrt(21.5e9 / 6450.0)
    # A massless inner shaft behind the plate is Guyan's reduction: its first frequency is a little too high.
    shafts = np.sort([wave / (4 * 0.12), wave / (4 * 0.06)])
    frequency = np.sort(1 / np.sqrt(size[::-1][:2])) / (2 * np.pi)
    assert shafts[0] < frequency[0] < 1.01 * shafts[0]
    assert frequency[1] == pytest.approx(shafts[1], rel=1e-4)
    # A tube that turns as a whole has the inertia of its whole length, transmission included.
    turn = np.zeros(len(system.spin))
    turn[free] = 1.0
    tube = robot.tubes[0]
    inertia = 6450.0 * 2 * tube.second_moment * tube.length
    assert turn @ system.spin @ turn == pytest.approx(inertia, rel=1e-9)


@pytest.mark.parametrize("inertial", [True, False])
def test_energy_is_balanced_while_the_drives_turn(crl_snap: Snap, inertial: bool) -> None:
    moving = snap_in_time(crl_snap, bending_inertia=inertial, rates=(200.0, -50.0, 20.0), duration=6e-4)
    total = moving.kinetic + moving.potential + moving.dissipated - moving.drive_work
    assert np.abs(total - total[0]).max() < 1e-6 * crl_snap.energy_released
    assert moving.energy_error < 1e-6
    # All of them count: the robot snaps, and each is a good part of the energy released.
    for part in (moving.kinetic, moving.potential, moving.dissipated, moving.drive_work):
        assert np.abs(part).max() > 0.01 * crl_snap.energy_released
    assert (np.diff(moving.dissipated) >= 0).all()
    assert moving.tip_rotations[-1, 0] - crl_snap.before.tip_rotations[0] > 1.0


@pytest.mark.parametrize("load", [None, Load(force=(0.0, -0.02, 0.0))], ids=["free", "loaded"])
def test_a_snap_lands_where_slow_motion_predicts(crl_snap: Snap, load: Load | None) -> None:
    home = [0.0, 0.0, 0.0]
    snap = crl_snap if load is None else find_snap(CRL, (home, home), (np.radians([360.0, 0.0, 0.0]), home), load=load)
    assert snap is not None
    moving = snap_in_time(snap, bending_inertia=False, relaxation=3e-5, duration=1.2e-2)
    assert moving.status is MotionEnd.LANDED
    # All of the energy is dissipated, that of the load included, and the arm is there.
    assert moving.kinetic[-1] < 1e-6 * snap.energy_released
    assert moving.dissipated[-1] == pytest.approx(snap.energy_released, rel=1e-4)
    np.testing.assert_allclose(moving.tip_rotations[-1], snap.after.tip_rotations, atol=1e-3)
    np.testing.assert_allclose(moving.tip_position[-1], snap.after.tip_position, atol=1e-5)
    np.testing.assert_allclose(moving.arms[-1].tip_position, moving.tip_position[-1], atol=1e-12)


def test_friction_acts_on_the_relative_rotations() -> None:
    law = Friction(torque=(2e-3, 3e-3), plate=1e-4, ends=(0.0, 2e-4))
    system, y, _ = motion(CRL, np.array([0.4, 1.3, -0.7]), 1e-6, Load())
    friction, assembly = replace(system, between=law).friction, system.problem.torsion.assembly
    ends = assembly.end
    # All torques per length, one at the plate for each pair, and one at the end of the outermost tube.
    total = 2e-3 * ends[1] + 3e-3 * ends[2] + 2 * 1e-4 + 2e-4
    assert friction.capacity.sum() == pytest.approx(total, rel=1e-12)
    d, shape = np.random.default_rng(2).normal(size=len(y)), system.shape(y)
    other = system.shape(y + 1e-3 * d)
    k = int(np.argmin(np.abs(shape.arc_length - ends[2])))
    turned = (other.rotation - shape.rotation)[:, k] / 1e-3
    assert friction.rows[-1] @ d == pytest.approx(turned[2] - turned[1], rel=1e-6)
    force, slope = friction.at(np.full(len(friction.capacity), 1e4))
    np.testing.assert_allclose(force, friction.capacity, rtol=1e-6)
    assert (slope < 1e-6 * friction.capacity).all()


def test_a_snap_with_friction_starts_where_friction_lets_go(crl_snap: Snap) -> None:
    friction, turn = Friction(ends=2e-5), np.linspace(0.0, 2 * np.pi, 61)[:, None] * (1.0, 0.0, 0.0)
    snap = follow(CRL, turn, np.zeros((61, 3)), friction=friction).snaps[0]
    assert snap.rotations[0] > crl_snap.rotations[0] + 0.01
    moving = snap_in_time(snap, bending_inertia=False, relaxation=3e-5, rates=(5.0, 0.0, 0.0), duration=6e-3)
    assert moving.status is MotionEnd.LANDED
    assert moving.energy_error < 1e-6
    # The equilibrium that is lost without friction is held by it while the drives rest.
    held = snap_in_time(crl_snap, bending_inertia=False, friction=friction, duration=6e-3)
    assert held.status is MotionEnd.MOVING
    assert np.abs(held.tip_rotations[-1] - crl_snap.before.tip_rotations).max() < 0.02
    with pytest.raises(InputError, match="by_moment of friction is above 0"):
        snap_in_time(crl_snap, friction=Friction(torque=1e-3, by_moment=0.1))
    with pytest.raises(InputError, match="friction acts on sliding tubes"):
        snap_in_time(crl_snap, friction=Friction(torque=1e-3, sliding=True))


def test_the_arm_rings_with_the_vibrations_of_the_new_equilibrium(crl_snap: Snap) -> None:
    moving = snap_in_time(crl_snap, bending_inertia=False, relaxation=5e-6, duration=8e-3)
    late = moving.time > moving.time[-1] - 6 / moving.frequencies[0]
    time, turn = moving.time[late], (moving.tip_rotations[:, 0] - crl_snap.after.tip_rotations[0])[late]
    k = np.flatnonzero(turn[:-1] * turn[1:] < 0)
    crossing = time[k] - turn[k] * (time[k + 1] - time[k]) / (turn[k + 1] - turn[k])
    peaks = [np.abs(turn[a : b + 1]).max() for a, b in pairwise(k)]
    assert len(k) > 8
    assert 1 / (2 * np.diff(crossing).mean()) == pytest.approx(moving.frequencies[0], rel=0.04)
    # Per half period the amplitude falls by the factor exp(-pi ratio).
    decay = np.log(peaks[0] / peaks[-1]) / (len(peaks) - 1) / np.pi
    assert decay == pytest.approx(moving.damping_ratios[0], rel=0.1)


def test_the_swept_volume_is_the_swept_area_times_the_width(crl_snap: Snap) -> None:
    moving = snap_in_time(crl_snap, bending_inertia=False, relaxation=3e-5)
    assert moving.given
    # The outer tube reaches as far as the others, and covers all of the arm.
    width, length = CRL.tubes[-1].outer_diameter, crl_snap.before.arc_length[-1]
    assert moving.swept_volume == pytest.approx(np.pi / 4 * width**2 * length + width * moving.swept_area, rel=1e-9)


def turn_at_tip(theta: float) -> float:
    """Rotation (rad) of the drive of the pair of Till et al. that holds the inner tube's tip at a rotation."""
    kb = [tube.bending_stiffness for tube in TILL.tubes]
    kt = [tube.torsional_stiffness for tube in TILL.tubes]
    bends = ((37.12, 7.97e-3, 43.6e-3), (8.72, 13.2e-3, 53.1e-3))

    def rates(s: float, state: Array) -> Array:
        m = [k * c if a < s < b else 0.0 for k, (c, a, b) in zip(kb, bends, strict=True)]
        angle = state[:2]
        stiff = kb[0] + (kb[1] if s < 53.1e-3 else 0.0)
        u = [sum(mi * f(a) for mi, a in zip(m, angle, strict=True)) / stiff for f in (np.cos, np.sin)]
        moment = [mi * (u[0] * np.sin(a) - u[1] * np.cos(a)) for mi, a in zip(m, angle, strict=True)]
        return np.array([state[2] / kt[0], state[3] / kt[1], *moment])

    def plate(outer: float) -> Array:
        state, cuts = np.array([theta, outer, 0.0, 0.0]), [55.1e-3, 53.1e-3, 43.6e-3, 13.2e-3, 7.97e-3, 0.0]
        for start, end in pairwise(cuts):
            answer = scipy.integrate.solve_ivp(rates, (start, end), state, method="DOP853", rtol=1e-12, atol=1e-14)
            state = answer.y[:, -1]
        return np.asarray(state)

    outer = scipy.optimize.brentq(lambda angle: plate(angle)[1], -0.2, 0.2, xtol=1e-11)
    at = plate(outer)
    # A torque t twists the transmission by 112 mm t / kt.
    return float(at[0] - 0.112 * at[2] / kt[0])


def test_the_static_fold_of_the_published_pair_is_that_of_shooting(till_snap: Snap) -> None:
    # The maximum of the polynomial through five points about it.
    middle, steps = till_snap.before.tip_rotations[0], np.linspace(-0.04, 0.04, 5)
    through = np.polynomial.Polynomial.fit(steps, [turn_at_tip(middle + step) for step in steps], 4)
    roots = through.deriv().roots()
    top = float(roots[np.argmin(np.abs(roots))].real)
    assert abs(top) < 1e-4
    assert through(top) / DEG == pytest.approx(till_snap.rotations[0] / DEG, abs=1e-6)


def compared(snap: Snap, moving: SnapInTime, cells: int, dt: float) -> tuple[float, float]:
    """Time and peak speed of the independent chain over those of a motion."""
    pose, relaxation = snap.before, 1e-6
    inner, outer = TILL.tubes
    kb, kt = (inner.bending_stiffness, outer.bending_stiffness), (inner.torsional_stiffness, outer.torsional_stiffness)
    mass = [float(mass_per_length(tube) or 0.0) for tube in TILL.tubes]
    inertia = [m * (t.outer_diameter**2 + t.inner_diameter**2) / 8 for m, t in zip(mass, TILL.tubes, strict=True)]
    curved, ends = ((7.97e-3, 43.6e-3), (13.2e-3, 53.1e-3)), (55.1e-3, 53.1e-3)
    chain = Chain(
        55.1e-3, cells, 0.112, kb, kt, (mass[0], mass[1]), (inertia[0], inertia[1]), (37.12, 8.72), curved, ends,
        relaxation, 5e4,
    )  # fmt: skip
    s = np.linspace(0.0, 55.1e-3, cells + 1)
    nodes = np.transpose([np.interp(s, pose.arc_length, row) for row in pose.position.T])
    theta = np.transpose([np.interp(s, pose.arc_length, row) for row in pose.rotation])
    drive = float(snap.rotations[0])
    behind = drive + (theta[0, 0] - drive) * np.linspace(0.0, 1.0, 2 * cells + 1)[1:]
    start, steps = (nodes, theta, behind), round(moving.time[-1] / (10 * dt))
    tip, turned = motion_of(chain, start, lambda time: drive + RATE * time, (dt, 10), steps)
    jump = snap.after.tip_rotations[0] - pose.tip_rotations[0]
    part, at = (turned - pose.tip_rotations[0]) / jump, 10 * dt * np.arange(len(turned))
    low, high = (float(np.interp(0.0, part[k - 1 : k + 1] - level, at[k - 1 : k + 1]))
                 for level in (0.1, 0.9) for k in [int(np.argmax(part > level))])  # fmt: skip
    speed = np.linalg.norm(np.diff(tip, axis=0), axis=1).max() / (10 * dt)
    return (high - low) / moving.duration, float(speed) / moving.peak_speed


@pytest.mark.parametrize(("cells", "dt", "within"), [(20, 2e-7, 0.03), (40, 5e-8, 0.02)])
def test_the_published_snap_is_that_of_an_independent_chain(
    till_snap: Snap, cells: int, dt: float, within: float
) -> None:
    # Moving drives pass the fold at the same rate, so that the slow start is the same.
    moving = snap_in_time(till_snap, rates=(RATE, 0.0), duration=1.4e-3)
    ratios = compared(till_snap, moving, cells, dt)
    assert ratios == pytest.approx((1.0, 1.0), abs=within)


def test_what_is_refused(crl_snap: Snap) -> None:
    with pytest.raises(InputError, match=r"relaxation is -1; it must be"):
        snap_in_time(crl_snap, relaxation=-1.0)
    with pytest.raises(InputError, match=r"duration is 0"):
        snap_in_time(crl_snap, duration=0.0)
    with pytest.raises(InputError, match="rates"):
        snap_in_time(crl_snap, rates=[1.0])
    bare = ConcentricRobot(tuple(replace(tube, material=replace(tube.material, thermal=None)) for tube in CRL.tubes))
    lost = replace(crl_snap.before, robot=bare)
    with pytest.raises(InputError, match="tube 1 has neither a material density nor a mass_per_length"):
        snap_in_time(replace(crl_snap, before=lost))
    turning = replace(crl_snap.before, load=Load(moment=(0.0, 0.0, 1e-3)))
    with pytest.raises(InputError, match="needs a dead force"):
        snap_in_time(replace(crl_snap, before=turning))
