"""Motion with history against brute force: a gradient flow of the energy at each of many small steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import CRL, DEG, THESIS
from tests.stability.reference import TURN, Creep, bundle, closed_form, settle_at
from tests.stability.robots import snapping_way, unit_pair
from tubeopt import ConcentricRobot, InputError, Load, Tube, find_equilibria, follow, forward_kinematics
from tubeopt.robots.robot import Robot
from tubeopt.stability import Snap, find_snap, motion, trace_branch

STEPS = 24
"""Steps of the brute force per straight line, halved wherever the robot moves much in one."""

SNAPPING = (0, 2, 3, 5, 6, 11, 15, 17)
"""Ways that snap: without them the brute force would be compared with little."""


@pytest.mark.parametrize("k", range(20))
def test_same_states_as_slow_descent(k: int) -> None:
    robot, rotations, translations = snapping_way(k)
    path = follow(robot, rotations, translations)
    assert len(path.equilibria) == len(rotations)
    assert path.snaps or k not in SNAPPING
    joints = np.stack([rotations, translations], axis=1)
    state = settle_at(robot, rotations[0], translations[0], path.equilibria[0].tip_rotations)
    for leg in range(len(rotations) - 1):
        snaps = [snap for snap in path.snaps if snap.index == leg]
        around = [snap.fraction + side for snap in snaps for side in (-1e-5, 1e-5)]
        even = [t for t in np.arange(STEPS) / STEPS if all(abs(t - snap.fraction) > 1e-4 for snap in snaps)]
        times = np.unique(np.concatenate([[0.0], even, around, [1.0]]))
        slow = Creep(robot, joints[leg], joints[leg + 1], state)
        states = {t: slow.to(t) for t in times[1:]}
        for snap in snaps:
            check_snap(snap)
            before, after = (states[snap.fraction + side] for side in (-1e-5, 1e-5))
            # At a fold the states go as the root of what is left of the way.
            assert before.tips == pytest.approx(snap.before.tip_rotations, abs=0.1)
            assert after.tips == pytest.approx(snap.after.tip_rotations, abs=2e-3)
        assert slow.snaps == pytest.approx([snap.fraction for snap in snaps], abs=2e-5)
        state = states[1.0]
        assert state.tips == pytest.approx(path.equilibria[leg + 1].tip_rotations, abs=1e-6)
        energy = state.elements.energy(state.rotations, state.theta)[0]
        assert energy == pytest.approx(path.equilibria[leg + 1].energy, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("k", [0, 2, 17, 18])
def test_zero_load_moves_a_robot_as_none(k: int) -> None:
    """Joint values and load are one search. On these ways breakpoints meet, so that unknowns begin and end."""
    robot, rotations, translations = snapping_way(k)
    plain, loaded = (follow(robot, rotations, translations, load=load) for load in (None, Load()))
    assert [s.index for s in loaded.snaps] == [s.index for s in plain.snaps]
    assert plain.snaps
    for one, other in zip(plain.snaps, loaded.snaps, strict=True):
        assert other.fraction == pytest.approx(one.fraction, abs=1e-11)
        assert abs(other.before.margin) < 1e-12
        assert other.energy_released == pytest.approx(one.energy_released, abs=1e-12)
    assert loaded.value == pytest.approx(plain.value, abs=1e-9)


@pytest.mark.parametrize("load", [None, Load((0.01, 0, 0))])
def test_the_kernel_only_saves_time(load: Load | None, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = np.radians([[0, 0, 0], [250, 30, 0], [20, 60, 0]]), np.array([[0, 0, 0], [-0.02, -0.01, 0], [0, 0, 0]])
    fast = follow(THESIS, *paths, load=load)
    monkeypatch.setattr(motion, "followed_by_kernel", lambda _: False)
    slow = follow(THESIS, *paths, load=load)
    assert [s.index for s in fast.snaps] == [s.index for s in slow.snaps]
    assert fast.snaps
    for one, other in zip(fast.snaps, slow.snaps, strict=True):
        assert one.fraction == pytest.approx(other.fraction, abs=1e-10)
        assert one.after.tip_position == pytest.approx(other.after.tip_position, abs=1e-9)
    assert fast.value == pytest.approx(slow.value, abs=1e-9)


def check_snap(snap: Snap) -> None:
    assert abs(snap.before.margin) < 1e-8
    assert snap.after.margin > 0
    assert snap.energy_released >= 0
    assert snap.energy_released == pytest.approx(snap.before.energy - snap.after.energy)
    assert snap.tip_jump == pytest.approx(np.linalg.norm(snap.after.tip_position - snap.before.tip_position))
    assert np.array_equal(snap.rotations, snap.before.rotations)
    assert np.array_equal(snap.translations, snap.after.translations)


def test_hysteresis_of_two_tubes() -> None:
    """Forth over the fold it snaps there; back it snaps at the other fold, the mirror image."""
    path = follow(unit_pair(3.0, 0.0), [[0.0, 0.0], [TURN, 0.0], [0.0, 0.0]])
    assert [snap.index for snap in path.snaps] == [0, 1]
    fold = 184.38397018
    assert [snap.rotations[0] / DEG for snap in path.snaps] == pytest.approx([fold, 360 - fold], abs=1e-6)
    first, second = path.snaps
    assert first.energy_released == pytest.approx(second.energy_released, rel=1e-9)
    assert path.equilibria[0].tip_position == pytest.approx(path.equilibria[2].tip_position, abs=1e-9)
    # A turn of one tube is one turn of the other end of the S-curve: same shape, tip wound once.
    assert path.equilibria[1].tip_rotations - [TURN, 0.0] == pytest.approx(path.equilibria[0].tip_rotations, abs=1e-9)


@pytest.mark.parametrize("robot", [THESIS, CRL], ids=["thesis", "CRL"])
def test_hysteresis_of_three_tubes(robot: Robot) -> None:
    path = follow(robot, [[0.0, 0.0, 0.0], [2 * TURN, 0.0, 0.0], [0.0, 0.0, 0.0]])
    forth = [snap.rotations[0] for snap in path.snaps if snap.index == 0]
    back = [snap.rotations[0] for snap in path.snaps if snap.index == 1]
    assert len(forth) == len(back) == 2
    # By the mirror image of home the ways there and back are one another's, a turn apart.
    assert sorted(back) == pytest.approx(sorted(2 * TURN - np.array(forth)), abs=1e-7)
    assert min(forth) > max(b for b in back if b < min(forth))
    for snap in path.snaps:
        check_snap(snap)


def test_winding_shifts_everything() -> None:
    """Turning all tubes by the same angle is a turn of the plate."""
    path = np.array([[0.0, 0.0, 0.0], [TURN, 0.3, 0.0]])
    plain, turned = follow(THESIS, path), follow(THESIS, path + 1.0)
    assert [s.fraction for s in turned.snaps] == pytest.approx([s.fraction for s in plain.snaps], abs=1e-9)
    for a, b in zip(plain.equilibria, turned.equilibria, strict=True):
        assert b.tip_rotations == pytest.approx(a.tip_rotations + 1.0, abs=1e-8)


def symmetric(straight: float = 0.0) -> ConcentricRobot:
    """Two outer tubes that pull alike on one inside, but are stiff alike only in their products kb kappa."""
    inner, middle, outer = THESIS.tubes
    stiff = middle.bending_stiffness * middle.curvature
    stretched = replace(
        outer,
        curved_length=middle.curved_length,
        straight_length=straight,
        curvature=stiff / outer.bending_stiffness,
        material=replace(
            outer.material,
            youngs_modulus=outer.material.youngs_modulus * middle.torsional_stiffness / outer.torsional_stiffness,
            shear_modulus=outer.material.shear_modulus * middle.torsional_stiffness / outer.torsional_stiffness,
        ),
    )
    stretched = replace(stretched, curvature=stiff / stretched.bending_stiffness)
    return ConcentricRobot(
        (replace(inner, straight_length=straight + 0.05), replace(middle, straight_length=straight), stretched)
    )


@pytest.mark.parametrize("straight", [0.0, 0.15])
def test_a_pitchfork_on_the_way(straight: float) -> None:
    """The outer tubes turn to both sides of the inner one, which stays in the middle until it tips to either side."""
    robot = symmetric(straight)
    motion = np.array([[0.0, 0.0, 0.0], [0.0, 2.5, -2.5], [0.0, np.pi, -np.pi], [0.0, 0.0, 0.0]])
    path = follow(robot, motion)
    assert all(equilibrium.stable for equilibrium in path.equilibria)
    assert all(snap.energy_released >= 0 for snap in path.snaps)
    middle = forward_kinematics(robot, motion[1])
    assert middle.stable
    # What it takes there is one of all equilibria.
    for joint, equilibrium in zip(motion, path.equilibria, strict=True):
        off = [np.abs(e.tip_rotations - equilibrium.tip_rotations).max() for e in find_equilibria(robot, joint)]
        assert min(off) < 1e-7


def test_a_pitchfork_of_opposed_tubes() -> None:
    """Turning both tubes of a pair against each other, as one by the other: half the relative angle each."""
    path = follow(unit_pair(3.0, 0.0), [[0.0, 0.0], [np.pi, -np.pi]])
    assert len(path.snaps) == 1
    assert 2 * path.snaps[0].rotations[0] / DEG == pytest.approx(184.38397018, abs=1e-6)


def test_start_selects_the_branch() -> None:
    c, lever, turn = 3.0, 0.0, 178.0 * DEG
    robot = unit_pair(c, lever)
    starts = [e for e in find_equilibria(robot, [turn, 0.0]) if e.stable]
    assert len(starts) == 2
    ends = []
    for start in starts:
        path = follow(robot, [[turn, 0.0], [183.0 * DEG, 0.0]], start=start)
        assert not path.snaps
        assert path.equilibria[0].tip_rotations == pytest.approx(start.tip_rotations, abs=1e-9)
        ends.append(float(np.subtract(*path.equilibria[-1].tip_rotations)))
    assert abs(ends[0] - ends[1]) > 1.0
    assert closed_form(c, 1.0, lever, np.array(ends)) / DEG == pytest.approx(183.0, abs=1e-7)


def test_start_elsewhere_is_moved_there_first() -> None:
    robot = unit_pair(3.0, 0.0)
    start = forward_kinematics(robot, [0.0, 0.0])
    far = follow(robot, [[200.0 * DEG, 0.0], [201.0 * DEG, 0.0]], start=start)
    assert not far.snaps
    straight = follow(robot, [[0.0, 0.0], [201.0 * DEG, 0.0]])
    assert len(straight.snaps) == 1
    assert far.equilibria[-1].tip_rotations == pytest.approx(straight.equilibria[-1].tip_rotations, abs=1e-9)


def test_translations_across_breakpoints() -> None:
    """Tubes that pass each other's ends and transitions, and the plate, without a turn: there and back is the same."""
    rotations = np.tile([0.4, 1.5, -0.7], (4, 1))
    translations = np.array([[0.0, 0.0, 0.0], [-0.15, 0.08, -0.09], [0.1, -0.12, 0.05], [0.0, 0.0, 0.0]])
    path = follow(THESIS, rotations, translations)
    assert not path.snaps
    for joint, shift, equilibrium in zip(rotations, translations, path.equilibria, strict=True):
        state = settle_at(THESIS, joint, shift, equilibrium.tip_rotations)
        assert state.tips == pytest.approx(equilibrium.tip_rotations, abs=1e-7)
        assert min(1.0, state.elements.margins(joint, state.theta)[0]) == pytest.approx(equilibrium.margin, abs=1e-4)
    assert path.equilibria[-1].tip_rotations == pytest.approx(path.equilibria[0].tip_rotations, abs=1e-9)


def test_one_way_gives_one_snap_whoever_looks_for_it() -> None:
    rotations = np.array([[0.0, 0.0, 0.0], [1.5 * np.pi, -0.4, 0.2]])
    path = follow(THESIS, rotations)
    snap = find_snap(THESIS, (rotations[0], None), (rotations[1], None))
    branch = trace_branch(THESIS, *rotations)
    assert snap is not None
    assert path.snaps[0].fraction == pytest.approx(snap.fraction, abs=1e-10)
    assert path.snaps[0].after.tip_rotations == pytest.approx(snap.after.tip_rotations, abs=1e-8)
    folds = [float(fold.rotations[0] / rotations[1][0]) for fold in branch.folds]
    assert folds[0] == pytest.approx(snap.fraction, abs=1e-10)


def test_waypoints_do_not_matter() -> None:
    ends = np.array([[0.0, 0.0, 0.0], [TURN, 0.5, -0.5]])
    many = ends[0] + np.linspace(0, 1, 8)[:, None] * (ends[1] - ends[0])
    few, fine = follow(THESIS, ends), follow(THESIS, many)
    assert [s.index + s.fraction for s in fine.snaps] == pytest.approx([7 * s.fraction for s in few.snaps], abs=1e-8)
    assert fine.equilibria[-1].tip_rotations == pytest.approx(few.equilibria[-1].tip_rotations, abs=1e-8)


def test_one_waypoint_and_progress() -> None:
    observed: list[int] = []
    path = follow(THESIS, [[0.0, 1.0, 2.0]], progress=observed.append)
    assert len(path.equilibria) == 1
    assert not path.snaps
    follow(THESIS, np.zeros((3, 3)), progress=observed.append)
    assert observed == [1, 2]


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")  # five turns
def test_tubes_without_coupling() -> None:
    single = ConcentricRobot((Tube(1e-3, 0.8e-3, 0.05, 0.1, 10.0),))
    path = follow(single, [[0.0], [5 * TURN]], [[0.0], [0.02]])
    assert path.equilibria[1].tip_rotations == pytest.approx([5 * TURN])
    assert bundle(single).coupled.size == 0


def test_messages() -> None:
    with pytest.raises(InputError, match=r"rotations has the shape \(3,\); it must be \(N, 3\)"):
        follow(THESIS, [0.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"rotations\[1\] is \[0.0, inf, 0.0\]; every number must be finite"):
        follow(THESIS, [[0.0, 0.0, 0.0], [0.0, np.inf, 0.0]])
    with pytest.raises(InputError, match=r"translations has the shape \(1, 3\); it must be \(2, 3\)"):
        follow(THESIS, np.zeros((2, 3)), np.zeros((1, 3)))
    with pytest.raises(InputError, match="rotations is no array of numbers"):
        follow(THESIS, [["a", "b", "c"]])
    with pytest.raises(InputError, match=r"translation of tube 1 is 0.3 m"):
        follow(THESIS, np.zeros((2, 3)), [[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
    unstable = find_equilibria(THESIS, [np.pi, 0.0, 0.0])[-1]
    with pytest.raises(InputError, match=r"start has margin -0\.9\d+; it must be a stable equilibrium"):
        follow(THESIS, [[np.pi, 0.0, 0.0]], start=unstable)
    with pytest.raises(InputError, match="rotations has no rows"):
        follow(THESIS, np.zeros((0, 3)))


@pytest.mark.parametrize("loaded", [False, True])
def test_snaps_on_the_way_to_the_first_waypoint_are_not_recorded(loaded: bool) -> None:
    load = Load((0.02, 0.0, 0.0))
    start = forward_kinematics(THESIS, [0.0, 0.0, 0.0], load=load if loaded else None)
    beyond = [250 * DEG, 0.0, 0.0]
    moved = follow(THESIS, [beyond], start=start, load=load)
    recorded = follow(THESIS, [[0.0, 0.0, 0.0], beyond], load=load)
    assert not moved.snaps
    assert len(recorded.snaps) == 1
    assert moved.equilibria[0].tip_position == pytest.approx(recorded.equilibria[1].tip_position, abs=1e-10)
