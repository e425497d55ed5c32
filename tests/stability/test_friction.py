"""Dry friction between tubes: states and loops of two tubes by an independent integration, energy, memory, snaps.

Two tubes of equal kt, phi = relative rotation, q = 2 tau / kt, Q = 2 T_end / kt, c = (1 + nu) k1 k2:
phi'' = c sin phi + q sign(slip), phi(0) - l phi'(0) = gamma, phi'(L) = -Q sign(slip); solved by DOP853 with the front
by bisection, and by linear elements with Richardson extrapolation.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from tests.examples import THESIS
from tubeopt import (
    NITINOL,
    ConcentricRobot,
    EccentricRobot,
    Friction,
    InputError,
    Load,
    Tube,
    follow,
    forward_kinematics,
    friction_band,
    load_equilibrium,
    load_robot,
    snap_free_certificate,
)
from tubeopt.block.transcription.contact import largest_capacity, make_contact, pressed
from tubeopt.equilibrium.result import Equilibrium, Status
from tubeopt.typing import Array

KT = 1e-3
MM = 1e-3


def pair(c: float, length: float, held: float) -> ConcentricRobot:
    """Two tubes with kb = kt whose relative rotation obeys the equation above."""
    tubes = (
        Tube(d, d - 0.5 * MM, held, length, np.sqrt(c), bending_stiffness=KT, torsional_stiffness=KT)
        for d in (1.0 * MM, 2.0 * MM)
    )
    return ConcentricRobot(tuple(tubes))


def turned(robot: ConcentricRobot, friction: Friction, angles: list[float]) -> list[Equilibrium]:
    """States after turning the outer tube to every angle, from rest at 0."""
    path = follow(robot, [[0.0, angle] for angle in [0.0, *angles]], friction=friction)
    assert not path.snaps
    return list(path.equilibria[1:])


def ends(state: Equilibrium) -> tuple[float, float]:
    """Relative rotation at the plate and at the tip."""
    phi = state.rotation[1] - state.rotation[0]
    return float(phi[0]), float(phi[-1])


def friction(q: float, at_end: float = 0.0, refinement: int = 0) -> Friction:
    return Friction(q * KT / 2, ends=at_end * KT / 2, refinement=refinement)


def test_states_of_two_tubes() -> None:
    a, b, c = turned(pair(1, 1.0, 0.3), friction(0.5), [0.15, 2.0, 1.6])
    assert ends(a) == pytest.approx((0.0687078692, 0.0), abs=1e-4)
    assert ends(b) == pytest.approx((1.5838744727, 0.9113630549), abs=1e-8)
    assert ends(c) == pytest.approx((1.3782939758, 0.9113630549), abs=1e-4)
    assert not b.friction.sticking.any()  # type: ignore[union-attr]
    a, b, c = turned(pair(2, 0.9, 0.1), friction(0.4), [0.15, 1.5, 0.2])
    assert ends(a)[0] == pytest.approx(0.1154968323, abs=1e-4)
    assert ends(b) == pytest.approx((1.3312305813, 0.6286240116), abs=1e-8)
    assert ends(c) == pytest.approx((0.2001445589, 0.2007207852), abs=1e-8)


def test_friction_at_the_end_of_a_tube() -> None:
    a, b, c = turned(pair(1.5, 1.0, 0.2), friction(0.3, 0.1), [1.8, 1.5, -1.8])
    assert ends(a) == pytest.approx((1.4811786059, 0.6855178212), abs=1e-8)
    assert ends(b)[0] == pytest.approx(1.2829529032, abs=1e-4)
    assert ends(c) == pytest.approx((-1.4811786059, -0.6855178212), abs=1e-8)


def test_without_bending_in_closed_form() -> None:
    q, held, gamma = 2.0, 0.3, 0.8
    front = 0.6433981132  # gamma = (q / 2) x^2 + l q x
    (state,) = turned(pair(1e-12, 1.0, held), friction(q), [gamma])
    assert ends(state)[0] == pytest.approx(q / 2 * front**2, abs=1e-4)
    (state,) = turned(pair(1e-12, 1.0, held), friction(q, refinement=3), [gamma])
    assert ends(state)[0] == pytest.approx(q / 2 * front**2, abs=5e-6)
    assert abs(ends(state)[0] - q / 2 * front**2) < state.mesh_error


def test_widths_of_loops() -> None:
    for c, q, held, length, gamma, width in [
        (1, 0.5, 0.3, 1.0, 2.0, 0.6935320709),
        (2, 0.4, 0.1, 0.9, 1.5, 0.2539661794),
    ]:
        robot = pair(c, length, held)
        up, _, down = turned(robot, friction(q), [gamma, gamma + 2.0, gamma])
        plain = forward_kinematics(robot, [0, gamma])
        assert ends(down)[1] - ends(up)[1] == pytest.approx(width, abs=1e-8)
        assert ends(up)[1] < ends(plain)[1] < ends(down)[1]


def test_friction_that_grows_with_the_bending_moment() -> None:
    """All slipping, against solve_bvp: phi'' = c sin phi + tau (1 / kt_1 + 1 / kt_2).

    Two tubes pass the moment M = kb_1 kb_2 / (kb_1 + kb_2) |kappa_1 - kappa_2 e^{j phi}|, and tau = tau_0 + b M.
    """
    kb, kappa, held, length, gamma = np.array([1.0, 3.0]) * KT, np.array([1.5, 0.8]), 0.3, 1.0, 2.0
    law = Friction(0.1 * KT, by_moment=0.4)
    robot = ConcentricRobot(
        tuple(
            Tube(d * MM, (d - 0.5) * MM, held, length, k, bending_stiffness=b, torsional_stiffness=0.8 * b)
            for d, b, k in zip((1.0, 2.0), kb, kappa, strict=True)
        )
    )
    reduced, soft = kb.prod() / kb.sum(), (1 / (0.8 * kb)).sum()

    def passed(phi: Array) -> Array:
        return np.asarray(reduced * np.abs(kappa[0] - kappa[1] * np.exp(1j * phi)))

    def rate(_: Array, y: Array) -> Array:
        torque = law.torque[0] + law.by_moment[0] * passed(y[0])  # type: ignore[index]
        return np.array([y[1], reduced * kappa.prod() * soft * np.sin(y[0]) + soft * torque])

    s = np.linspace(0.0, length, 50)
    exact = solve_bvp(
        rate, lambda a, b: np.array([a[0] - held * a[1] - gamma, b[1]]), s, np.array([gamma - s, 0 * s]), tol=1e-8
    )
    reached = []
    for count in (20, 40):
        (*_, last) = turned(robot, law, np.linspace(0.0, gamma, count + 1)[1:].tolist())
        reached.append(ends(last))
        assert not last.friction.sticking.any()  # type: ignore[union-attr]
    errors = np.array(reached) - exact.sol([0.0, length])[0]
    # Capacities are those of the state before: the error is of first order in the step.
    assert np.abs(errors[1] - errors[0] / 2).max() < 0.1 * np.abs(errors[0]).max() < 2e-3
    assert np.abs(2 * errors[1] - errors[0]).max() < 2e-4
    plain = ends(turned(robot, Friction(0.1 * KT), [gamma])[0])
    assert ends(last)[1] < plain[1] - 0.05


def test_front_lies_where_slip_ends() -> None:
    robot = pair(1, 1.0, 0.3)
    (state,) = turned(robot, friction(0.5, refinement=3), [0.15])
    assert state.friction is not None
    stuck = np.array(state.friction.arc_length)[state.friction.sticking]
    assert stuck.min() == pytest.approx(0.518419736, abs=0.01)


@pytest.mark.parametrize(("c", "q", "held", "fold"), [(4, 0.3, 0.0, 204.19709649), (2, 0.4, 0.5, 222.65242158)])
def test_friction_delays_a_snap(c: float, q: float, held: float, fold: float) -> None:
    robot = pair(c, 1.0, held)
    for waypoints in (241, 2):
        path = np.linspace([0, 0], [0, np.radians(240)], waypoints)
        (snap,) = follow(robot, path, friction=friction(q)).snaps
        assert np.degrees(snap.rotations[1]) == pytest.approx(fold, abs=1e-8)
    assert 0 <= snap.before.margin < 1e-4
    assert snap.after.stable
    assert snap.after.friction is not None
    assert snap.before.friction is not None
    # What the tubes lose is heat of friction, and the rest is what the robot swings with.
    assert snap.energy_released > snap.after.friction.heat - snap.before.friction.heat > 0
    before = follow(robot, path).snaps[0]
    assert snap.rotations[1] > before.rotations[1]


def test_what_friction_alone_holds() -> None:
    """Tubes that stand against each other are stable while they are short; friction holds them as they grow."""
    tubes = (Tube(d, d - 0.5 * MM, 60 * MM, 100 * MM, 10.0) for d in (1.0 * MM, 2.0 * MM))
    robot = ConcentricRobot(tuple(tubes))
    against = [[0.0, np.pi]] * 2
    short, long = [-60 * MM] * 2, [0.0, 0.0]
    assert forward_kinematics(robot, against[0], short).stable
    start = forward_kinematics(robot, against[0], short)
    held = follow(robot, against, [short, long], start=start, friction=Friction(0.05, plate=1e-4))
    assert not held.snaps
    state = held.equilibria[-1]
    assert state.friction is not None
    assert state.margin < 0 < state.friction.held_margin
    assert state.status is Status.HELD
    assert not state.stable


def test_no_friction_is_no_friction() -> None:
    motion = np.radians([[0, 0, 0], [40, 0, 20], [-30, 60, 90]])
    plain = follow(THESIS, motion)
    for none in (Friction(), Friction(1e-13)):
        path = follow(THESIS, motion, friction=none)
        for a, b in zip(path.equilibria, plain.equilibria, strict=True):
            assert a.tip_position == pytest.approx(b.tip_position, abs=1e-12 if none.trivial else 1e-10)


def test_a_closed_loop_turns_work_into_heat() -> None:
    """The torque of the drive over its turn, by Simpson's rule on steps cut wherever another point sticks or slips."""
    robot, rub = pair(1, 1.0, 0.3), friction(0.5, refinement=-1)
    (start,) = turned(robot, rub, [2.0])

    def torque(state: Equilibrium) -> float:
        return -KT * float(state.torsion[1, 0])

    def slipping(state: Equilibrium) -> tuple[float, ...]:
        assert state.friction is not None
        lam, largest = np.array(state.friction.torque), np.array(state.friction.capacity)
        return tuple(np.sign(lam) * (np.abs(lam) >= largest * (1 - 1e-12)))

    def work(before: Equilibrium, end: float) -> tuple[float, Equilibrium]:
        initial = float(before.rotations[1])
        path = [[0.0, initial], [0.0, (initial + end) / 2], [0.0, end]]
        _, half, after = follow(robot, path, start=before, friction=rub).equilibria
        if slipping(before) != slipping(after) and abs(end - initial) > 3e-4:
            first, middle = work(before, (initial + end) / 2)
            second, last = work(middle, end)
            return first + second, last
        return (end - initial) * (torque(before) + 4 * torque(half) + torque(after)) / 6, after

    total, state = 0.0, start
    for end in np.concatenate([np.linspace(2.0, 1.0, 11)[1:], np.linspace(1.0, 2.0, 11)[1:]]):
        done, state = work(state, float(end))
        total += done
    assert state.energy == pytest.approx(start.energy, rel=1e-9)
    assert start.friction is not None
    assert state.friction is not None
    heat = state.friction.heat - start.friction.heat
    assert total == pytest.approx(heat, rel=1e-8)


def test_a_dense_path_with_friction_has_its_waypoints_only() -> None:
    path = follow(THESIS, np.radians([[0, 0, 0], [30, 0, 0], [10, 0, 0]]), friction=Friction(0.05))
    (part,) = path.dense
    assert part.at.tolist() == [1, 2, 3]
    assert all(a is b for a, b in zip(part.equilibria, path.equilibria, strict=True))


def test_waypoints_at_once_are_as_one_after_the_other() -> None:
    """The states and the heat of a motion that the compiled kernel follows whole, and of its increments, one by one."""
    friction, fraction = Friction((4e-3, 6e-3)), np.linspace(0, 1, 13)[:, None]
    rotations = np.sin(3 * fraction * [1.0, 1.4, -1.2])
    translations = -0.03 * fraction * [1.0, 0.9, 0.8]
    whole = follow(THESIS, rotations, translations, friction=friction).equilibria
    held = whole[0]
    for k in range(1, len(fraction)):
        reached = follow(THESIS, rotations[k - 1 : k + 1], translations[k - 1 : k + 1], start=held, friction=friction)
        held = reached.equilibria[-1]
        assert whole[k] is whole[k - len(whole)]
        assert whole[k].friction is not None
        assert held.friction is not None
        assert whole[k].tip_position == pytest.approx(held.tip_position, abs=1e-9)
        assert whole[k].friction.heat == pytest.approx(held.friction.heat, rel=1e-6)
    assert whole[2:4] == (whole[2], whole[3])
    with pytest.raises(IndexError):
        whole[len(fraction)]


def test_memory_goes_with_the_material() -> None:
    """A bundle that slides as a whole without turning rubs nothing, and comes back as it was."""
    inner = Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 9.0)
    robot = ConcentricRobot((inner, Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 5.0)))
    rub = Friction(5e-3, plate=1e-4, jumps=1e-4, ends=1e-4)
    path = follow(robot, [[0, 0], [0, 1.5], [0, 1.4]], friction=rub)
    sticky = path.equilibria[-1]
    assert sticky.friction is not None
    assert 0 < sticky.friction.sticking.mean() < 1 or sticky.friction.sticking.all()
    out = follow(robot, [[0, 1.4]] * 3, [[0, 0], [1 * MM, 0], [2 * MM, 0]], start=sticky, friction=rub)
    assert out.equilibria[-1].friction.heat >= sticky.friction.heat  # type: ignore[union-attr]
    many = follow(
        robot, [[0, 1.4]] * 21, np.column_stack([np.linspace(0, 2 * MM, 21), np.zeros(21)]), start=sticky, friction=rub
    )
    assert many.equilibria[-1].tip_position == pytest.approx(out.equilibria[-1].tip_position, abs=2e-6)


def test_sliding_turns_friction_away() -> None:
    inner = Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 9.0)
    robot = ConcentricRobot((inner, Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 5.0)))
    turn = [[0, 0], [0, 1.5]]

    def off(slide: float, *, sliding: bool) -> float:
        rub = Friction(2e-3, sliding=sliding)
        state = follow(robot, turn, [[0, 0], [slide, 0]], friction=rub).equilibria[-1]
        return float(np.linalg.norm(state.tip_position - forward_kinematics(robot, turn[1], [slide, 0]).tip_position))

    assert off(10 * MM, sliding=True) < 0.3 * off(10 * MM, sliding=False)
    assert off(1e-9, sliding=True) == pytest.approx(off(1e-9, sliding=False), rel=1e-4)


def test_sliding_by_round_off_is_none() -> None:
    """There and back by a hair, with sections that come and go at the plate: torques that balance, and no heat."""
    robot = ConcentricRobot(tuple(Tube(d * MM, (d - 0.2) * MM, 60 * MM, 50 * MM, 8.0) for d in (1.0, 1.5, 2.0)))
    path = np.array([[0, 0, 0], [-1.1, -0.6, 5.9], *[[-1.1, -0.6, 5.9]] * 3])
    slides = np.array([[0, 0, 0], [0, 0, 0], [7e-11, -2e-10, 4e-11], [0, 0, 0], [-4e-10, -9e-10, 2e-9]])
    states = follow(robot, path, slides, friction=Friction((1e-3, 1e-2), jumps=1e-4, sliding=True)).equilibria
    for state in states:
        assert state.residual < 1e-10
        assert state.friction is not None
        assert state.friction.violation < 1e-9
    assert states[-1].friction.heat == pytest.approx(states[1].friction.heat, rel=1e-4)  # type: ignore[union-attr]


def random_way(seed: int) -> tuple[ConcentricRobot, Array, Array, Friction]:
    random = np.random.default_rng(seed)
    lengths = np.sort(random.uniform(60, 220, 3))[::-1] * MM
    curved = np.minimum(lengths * random.uniform(0.3, 0.7, 3), 0.1)
    tubes = tuple(
        Tube((1 + 0.5 * k) * MM, (0.8 + 0.5 * k) * MM, lengths[k] - curved[k], curved[k], random.uniform(2, 14))
        for k in range(3)
    )
    robot = ConcentricRobot(tubes)
    unit = tubes[0].torsional_stiffness
    rub = Friction(
        tuple(100 * unit * 10 ** random.uniform(-2.5, 0.3, 2)), plate=unit / 2, jumps=unit / 2, ends=unit / 2
    )
    rotations = np.cumsum(random.normal(0, 0.8, (6, 3)), axis=0)
    translations = np.cumsum(random.normal(0, 4 * MM * (seed % 2), (6, 3)), axis=0)
    return robot, rotations, np.minimum(translations, [tube.straight_length for tube in tubes]), rub


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 5, 7])
def test_laws_of_friction_hold_on_random_ways(seed: int) -> None:
    robot, rotations, translations, rub = random_way(seed)
    for state in follow(robot, rotations, translations, friction=rub).equilibria:
        assert state.friction is not None
        assert state.friction.violation < 1e-9
        assert state.residual < 1e-9
        assert state.friction.held_margin > 0
        assert (np.abs(state.friction.torque) <= np.array(state.friction.capacity) * (1 + 1e-9)).all()


def test_a_certified_robot_does_not_snap_with_friction_either() -> None:
    tubes = (Tube(1.0 * MM, 0.75 * MM, 100 * MM, 80 * MM, 8.0), Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 8.0))
    robot = ConcentricRobot(tubes)
    assert snap_free_certificate(robot) > 0
    path = np.cumsum(np.random.default_rng(0).normal(0, 2.0, (12, 2)), axis=0)
    assert not follow(robot, path, friction=Friction(5e-3)).snaps


def test_state_is_saved_and_goes_on(tmp_path: Path) -> None:
    rub = Friction(1e-3, plate=1e-5, ends=2e-5)
    path = np.radians([[0, 0, 0], [60, 0, 20], [30, 40, 0], [20, 60, -10]])
    whole = follow(THESIS, path, friction=rub).equilibria
    whole[2].save(tmp_path)
    again = load_equilibrium(tmp_path)
    assert again.friction == whole[2].friction
    rest = follow(THESIS, path[2:], start=again, friction=rub).equilibria
    assert rest[-1].tip_position == pytest.approx(whole[-1].tip_position, abs=1e-12)
    assert rest[-1].friction.heat == pytest.approx(whole[-1].friction.heat, rel=1e-9)  # type: ignore[union-attr]


def test_robot_file_keeps_friction(tmp_path: Path) -> None:
    robot = replace(THESIS, friction=Friction((1e-3, 2e-4), plate=1e-5, sliding=True, refinement=1))
    robot.save(tmp_path / "robot.yaml")
    assert load_robot(tmp_path / "robot.yaml") == robot


def test_wrong_input() -> None:
    with pytest.raises(InputError, match="torque of friction is -1; it must be at least 0"):
        Friction(-1)
    with pytest.raises(InputError, match="torque of friction is 3 numbers; the robot has 3 tubes, so it must be 2"):
        follow(THESIS, np.zeros((2, 3)), friction=Friction((1.0, 1.0, 1.0)))
    with pytest.raises(InputError, match="friction is given for 2 and 3 pairs"):
        Friction((1e-3, 1e-3), plate=(1e-3, 1e-3, 1e-3))
    with pytest.raises(InputError, match="refinement of friction is 9"):
        Friction(1.0, refinement=9)
    eccentric = EccentricRobot(Tube(1.0 * MM, 0.75 * MM, 100 * MM, 80 * MM, 8.0, NITINOL), model="thesis")
    with pytest.raises(InputError, match="for concentric robots and bundles"):
        follow(eccentric, np.zeros((2, 3)), friction=Friction(1.0))
    rubbed = follow(THESIS, np.radians([[0, 0, 0], [60, 0, 20]]), friction=Friction(1e-3)).equilibria[-1]
    with pytest.raises(InputError, match="a different friction"):
        follow(THESIS, [rubbed.rotations], start=rubbed, friction=Friction(2e-3))
    with pytest.raises(InputError, match="equilibrium has friction"):
        rubbed.jacobian()


def certified() -> ConcentricRobot:
    return ConcentricRobot(
        (Tube(1.0 * MM, 0.75 * MM, 100 * MM, 80 * MM, 8.0), Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 8.0))
    )


def test_band_holds_every_history() -> None:
    robot, at = certified(), [0.3, 1.9]
    rub = Friction(1e-3, ends=2e-5)
    band = friction_band(forward_kinematics(robot, at), rub)
    assert band.certificate > 0
    paths = np.random.default_rng(1).normal(0, 2.0, (25, 2)) + at
    states = follow(robot, [point for path in paths for point in (path, at)], friction=rub).equilibria[1::2]
    off = np.array([state.tip_position for state in states]) - band.equilibrium.tip_position
    # Tight to first order, for there are ways that make everything slip; and a proof is above all.
    assert np.abs(off).max(0) == pytest.approx(band.tip_half_widths, rel=0.02)
    assert np.linalg.norm(off, axis=1).max() < band.tip_radius < 10 * np.linalg.norm(band.tip_half_widths)
    assert band.guaranteed[0] == 0
    assert band.first_order[0].max() < 1e-20


def test_band_of_friction_that_grows_with_the_bending_moment() -> None:
    """It holds every history, and its capacities are the largest of all rotations."""
    robot, at, law = certified(), [0.3, 1.9], Friction(2e-4, by_moment=0.2)
    still = forward_kinematics(robot, at)
    band = friction_band(still, law)
    paths = np.random.default_rng(1).normal(0, 2.0, (8, 2)) + at
    states = follow(robot, [point for path in paths for point in (path, at)], friction=law).equilibria[1::2]
    off = np.array([state.tip_position for state in states]) - still.tip_position
    assert 0.3 < np.linalg.norm(off, axis=1).max() / np.linalg.norm(band.tip_half_widths) < 1.5
    assert np.linalg.norm(off, axis=1).max() < band.tip_radius < np.inf
    contact = make_contact(THESIS.assembly(np.zeros(3)), Friction(by_moment=(1.0, 2.0)))
    theta = np.random.default_rng(2).uniform(-np.pi, np.pi, (300, 3))
    states = [pressed(contact, np.tile(row, (len(contact.problem.weight), 1))).capacity for row in theta]
    assert (np.max(states, axis=0) <= largest_capacity(contact) * (1 + 1e-12)).all()
    assert np.median(np.max(states, axis=0) / largest_capacity(contact)) > 0.98
    # A load bends tubes by an amount without a bound.
    assert np.isinf(friction_band(forward_kinematics(robot, at, load=Load((0.0, 1e-3, 0.0))), law).tip_radius)


def test_bending_under_a_load_presses_tubes_together() -> None:
    """The moment that the outer tube carries is kb_2 |kappa_2 e_2 - u|, with the curvature u of the loaded arm."""
    robot, law, load = certified(), Friction(by_moment=0.1), Load((0.05, 0.0, 0.0))
    start = forward_kinematics(robot, [0.3, 1.9], load=load)
    state = follow(robot, [[0.3, 1.9]], start=start, load=load, friction=law).equilibria[-1].friction
    assert state is not None
    at, tube = np.array(state.arc_length), robot.tubes[1]
    u = np.array([np.interp(at, start.arc_length, part) for part in start.curvature.T])
    theta = np.interp(at, start.arc_length, start.rotation[1])
    natural = tube.curvature * np.array([np.cos(theta), np.sin(theta)]) * (at < tube.curved_length)
    carried = tube.bending_stiffness * np.linalg.norm(natural - u, axis=0)
    weight = make_contact(robot.assembly(np.zeros(2)), law).problem.weight
    assert len(weight) == len(at)
    assert np.abs(np.array(state.capacity) / (0.1 * weight * carried) - 1).max() < 0.01


@pytest.mark.parametrize("load", [None, Load((0.0, 1e-3, 0.0))], ids=["plain", "force"])
def test_the_radius_of_a_band_is_that_of_the_largest_torque_and_of_the_longest_lever(load: Load | None) -> None:
    """Of two tubes that begin at the plate: torques tau (L - s) have the square int t^2 / kt, the turn of a tube with
    square 1 moves the tip by the root of A^2 L^5 / 20 kt, and bending by that of L^3 / 3 K."""
    length, curvature, torque = 0.06, 3.0, 1e-3
    tubes = Tube(1.0 * MM, 0.75 * MM, 0.0, length, curvature), Tube(1.5 * MM, 1.15 * MM, 0.0, length, curvature)
    band = friction_band(forward_kinematics(ConcentricRobot(tubes), [0.3, 0.4], load=load), Friction(torque))
    stiffness = sum(tube.bending_stiffness for tube in tubes)
    push = sum((torque**2 * length**3 / 3) / tube.torsional_stiffness for tube in tubes)
    slopes = [tube.bending_stiffness * curvature / stiffness for tube in tubes]
    lever = sum(a**2 * length**5 / 20 / tube.torsional_stiffness for a, tube in zip(slopes, tubes, strict=True))
    lever += 0.0 if load is None else length**3 / (3 * stiffness)
    assert band.tip_radius == pytest.approx(np.sqrt(lever * push) / band.certificate, rel=1e-4)


@pytest.mark.parametrize(
    "load", [Load((0.01, 0.004, 0.0)), Load((0.0, 0.05, 0.02), gravity=(0.0, -9.80665, 0.0))], ids=["force", "weight"]
)
def test_band_under_a_load_holds_every_history(load: Load) -> None:
    robot, at = certified(), [0.3, 1.9]
    rub = Friction(1e-3, ends=2e-5)
    still = forward_kinematics(robot, at, load=load)
    band = friction_band(still, rub)
    paths = np.random.default_rng(1).normal(0, 2.0, (15, 2)) + at
    states = follow(robot, [point for path in paths for point in (path, at)], friction=rub, load=load).equilibria[1::2]
    off = np.array([state.tip_position for state in states]) - still.tip_position
    assert np.abs(off).max(0) == pytest.approx(band.tip_half_widths, rel=0.03)
    if load.tip_force_only:
        assert 0 < band.certificate < friction_band(forward_kinematics(robot, at), rub).certificate
        assert np.linalg.norm(off, axis=1).max() < band.tip_radius < 30 * np.linalg.norm(band.tip_half_widths)
    else:
        assert np.isinf(band.tip_radius)


def test_no_load_is_the_zero_of_a_load_for_a_band() -> None:
    robot, at, rub = certified(), [0.3, 1.9], Friction(1e-3, ends=2e-5)
    one, other = (friction_band(forward_kinematics(robot, at, load=load), rub) for load in (None, Load((1e-9, 0, 0))))
    assert np.allclose(one.tip_half_widths, other.tip_half_widths, rtol=1e-6)
    assert one.certificate == pytest.approx(other.certificate, abs=1e-6)


def test_band_is_infinite_without_a_certificate() -> None:
    band = friction_band(forward_kinematics(pair(4, 1.0, 0.5), [0, 1.0]), friction(0.1))
    assert band.certificate < 0
    assert np.isinf(band.tip_radius)
    assert np.isfinite(band.tip_half_widths).all()


def test_out_of_and_back_into_the_plate() -> None:
    """With no tube in front of the plate nothing is unknown, and nothing rubs but at the plate."""
    inside = [-tube.length for tube in THESIS.tubes]
    motion = [inside, [0.9 * d for d in inside], inside]
    path = follow(THESIS, [[0, 0, 0], [0, 0.4, 0.8], [0, 0.4, 0.8]], motion, friction=Friction(0.01, plate=1e-3))
    assert not path.snaps
    for state in (path.equilibria[0], path.equilibria[-1]):
        assert (len(state.point), state.margin, state.energy) == (0, 1.0, 0.0)
        assert state.status is Status.STABLE
