"""Many configurations at once: the answers of single solves, and what happens to those that have none."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.shooting import shoot
from tests.examples import CRL, THESIS, THESIS_TIPS
from tests.stability.robots import random_robot
from tubeopt import (
    ConcentricRobot,
    EccentricRobot,
    InputError,
    SolveError,
    Tube,
    forward_kinematics,
    forward_kinematics_batch,
    load_robot,
)
from tubeopt.equilibrium import batch
from tubeopt.inverse.joints import joint_space
from tubeopt.robots.robot import Robot
from tubeopt.solvers.compiled import binding
from tubeopt.solvers.compiled.binding import kernel_of, solve_many_compiled
from tubeopt.solvers.compiled.library import compiler
from tubeopt.typing import Array

ETR = EccentricRobot(Tube(1.92e-3, 1.57e-3, 0.02, 0.094, 26.0), transmission_length=0.05)


def random_joints(robot: Robot, count: int, seed: int) -> tuple[Array, Array]:
    """Within the limits of the lengths, carriages and ends in any order."""
    random = np.random.default_rng(seed)
    shift = np.empty((count, robot.n_tubes))
    for tubes in robot.moving_together:
        tube = robot.tubes[tubes[0]]
        shift[:, list(tubes)] = random.uniform(-0.95 * tube.curved_length, tube.straight_length, (count, 1))
    return random.uniform(-2 * np.pi, 2 * np.pi, (count, robot.n_tubes)), shift


@pytest.mark.parametrize("robot", [THESIS, CRL, ETR], ids=["thesis", "crl", "etr"])
def test_the_answers_are_those_of_single_solves(robot: Robot) -> None:
    alpha, shift = random_joints(robot, 60, 1)
    many = forward_kinematics_batch(robot, alpha, shift)
    assert many.converged.all()
    for k in range(len(many)):
        one = forward_kinematics(robot, alpha[k], shift[k])
        assert many.tip_position[k] == pytest.approx(one.tip_position, abs=1e-12)
        assert many.tip_rotation[k] == pytest.approx(one.tip_rotation, abs=1e-11)
        assert many.tip_rotations[k] == pytest.approx(one.tip_rotations, abs=1e-11)
        assert many.margin[k] == pytest.approx(one.margin, abs=1e-8)
        assert many.energy[k] == pytest.approx(one.energy, rel=1e-10)
        assert max(many.residual[k], many.mesh_error[k]) < 1e-8


def test_numbers_of_the_design() -> None:
    rotations = [rotations for rotations, _, _ in THESIS_TIPS]
    many = forward_kinematics_batch(THESIS, rotations)
    for k, (_, tip, margin) in enumerate(THESIS_TIPS):
        assert 1e3 * many.tip_position[k] == pytest.approx(tip, abs=2e-8)
        assert many.margin[k] == pytest.approx(margin, abs=1e-5)


@pytest.mark.parametrize("robot", [THESIS, CRL], ids=["thesis", "crl"])
def test_thousands_of_random_configurations_all_converge(robot: ConcentricRobot) -> None:
    alpha, shift = random_joints(robot, 3000, 2)
    many = forward_kinematics_batch(robot, alpha, shift, workers=2)
    assert many.converged.all()
    assert many.stable.all()
    assert many.failures == ()
    assert many.residual.max() < 1e-10
    for k in range(0, 3000, 300):
        # Independent shooting from the torsion at the plate, which a single solve tells.
        e = forward_kinematics(robot, alpha[k], shift[k])
        tip = shoot(robot, alpha[k], shift[k], e.torsion[:, 0]).tip_position
        assert many.tip_position[k] == pytest.approx(tip, abs=1e-9)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_robots_of_other_numbers_of_tubes(n: int) -> None:
    robot = random_robot(np.random.default_rng(n), n)
    alpha, shift = random_joints(robot, 40, n)
    many = forward_kinematics_batch(robot, alpha, shift)
    for k in range(0, 40, 4):
        assert many.tip_position[k] == pytest.approx(forward_kinematics(robot, alpha[k], shift[k]).tip_position)


def test_what_is_left_over_does_not_read_old_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that is wholly withdrawn among others: the kernel leaves it over, in memory that held huge numbers."""
    if kernel_of(THESIS) is None:
        pytest.skip("no C compiler")
    monkeypatch.setattr(np, "empty", lambda shape, dtype=float: np.full(shape, np.finfo(float).max, dtype))
    out = [-tube.curved_length for tube in THESIS.tubes]
    many = forward_kinematics_batch(THESIS, [(0.3, -0.2, 0.1), (0.0, 1.0, 2.0)], [out, (0.0, 0.0, 0.0)])
    assert many.converged.all()
    assert many.tip_position[0].tolist() == [0.0, 0.0, 0.0]
    assert many.tip_rotations[0] == pytest.approx([0.3, -0.2, 0.1])
    assert many.tip_position[1] == pytest.approx(forward_kinematics(THESIS, (0.0, 1.0, 2.0)).tip_position, abs=1e-12)


def test_workers_and_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    alpha, shift = random_joints(THESIS, 500, 3)
    one = forward_kinematics_batch(THESIS, alpha, shift)
    monkeypatch.setattr(batch, "CHUNK", 37)
    done: list[int] = []
    other = forward_kinematics_batch(THESIS, alpha, shift, workers=3, progress=done.append)
    assert np.array_equal(one.tip_position, other.tip_position)
    assert np.array_equal(one.margin, other.margin)
    assert done[-1] == 500
    assert done == sorted(done)


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    alpha, shift = random_joints(THESIS, 20, 4)
    one = forward_kinematics_batch(THESIS, alpha, shift)
    monkeypatch.setattr(batch, "solve_many_compiled", lambda *_: None)
    other = forward_kinematics_batch(THESIS, alpha, shift)
    assert other.converged.all()
    assert one.tip_position == pytest.approx(other.tip_position, abs=1e-11)
    assert one.margin == pytest.approx(other.margin, abs=1e-8)


def test_a_finer_tolerance_refines_only_what_needs_it() -> None:
    alpha, shift = random_joints(THESIS, 40, 5)
    rough, fine = (forward_kinematics_batch(THESIS, alpha, shift, tolerance=t) for t in (1e-8, 1e-11))
    assert fine.mesh_error.max() <= 1e-11 < rough.mesh_error.max()
    assert fine.tip_position == pytest.approx(rough.tip_position, abs=1e-9)


def test_a_failure_costs_its_own_row(monkeypatch: pytest.MonkeyPatch) -> None:
    alpha, shift = random_joints(THESIS, 6, 6)

    def fails(*arguments: object, **options: object) -> None:
        raise SolveError("no stable equilibrium was found")

    table = batch.solve_many_compiled(THESIS, alpha, shift)
    if table is None:
        pytest.skip("no C compiler")
    table[1][2] = True
    monkeypatch.setattr(batch, "solve_many_compiled", lambda *given: None if given[-1] else table)
    monkeypatch.setattr(batch, "forward_kinematics", fails)
    many = forward_kinematics_batch(THESIS, alpha, shift)
    assert many.converged.tolist() == [True, True, False, True, True, True]
    assert many.failures == ((2, "no stable equilibrium was found"),)
    assert np.isnan(many.tip_position[2]).all()
    assert np.isfinite(many.tip_position[many.converged]).all()
    with pytest.raises(SolveError, match="configuration 2"):
        forward_kinematics_batch(THESIS, alpha, shift, on_failure="raise")


def test_one_row_of_translations_serves_all_and_none_is_home() -> None:
    alpha = np.array([[0.0, 1.0, 2.0], [0.5, 0.0, -0.5]])
    home = forward_kinematics_batch(THESIS, alpha)
    assert np.array_equal(home.tip_position, forward_kinematics_batch(THESIS, alpha, [0.0, 0.0, 0.0]).tip_position)
    assert len(forward_kinematics_batch(THESIS, np.zeros((0, 3)))) == 0


@pytest.mark.parametrize(
    ("rotations", "translations", "options", "words"),
    [
        ([0.0, 1.0, 2.0], None, {}, r"rotations has the shape \(3,\); it must be \(N, 3\)"),
        ([[0.0, 1.0]], None, {}, r"rotations has the shape \(1, 2\)"),
        ([["a", "b", "c"]], None, {}, "rotations is no array of numbers"),
        ([[10**400, 0, 0]], None, {}, "rotations is no array of numbers"),
        (None, None, {}, r"rotations is None; it must be an array \(N, n\)"),
        ([[0.0] * 3], np.nan, {}, r"translations is nan; it must be an array \(N, n\)"),
        ([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]], None, {}, r"rotations\[1\] is \[0.0, nan, 0.0\]; every number"),
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0]], {}, "translations has the shape"),
        ([[0.0] * 3] * 2, [[0.0] * 3, [0.0, 9.0, 0.0]], {}, r"translations\[1\] of tube 2 is 9 m"),
        ([[0.0] * 3, [0.0, -1e9, 0.0]], None, {}, r"^rotations has -1e\+09 rad; it must be at most 1000 rad"),
        ([[0.0] * 3], None, {"tolerance": 0.0}, "tolerance is 0"),
        ([[0.0] * 3], None, {"tolerance": 10**400}, "tolerance is an integer beyond 1e308"),
        ([[0.0] * 3], None, {"workers": -1}, "workers is -1"),
        ([[0.0] * 3], None, {"workers": True}, "workers is True"),
        ([[0.0] * 3], None, {"on_failure": "ignore"}, "on_failure is 'ignore'"),
    ],
)
def test_bad_input(rotations: object, translations: object, options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        forward_kinematics_batch(THESIS, rotations, translations, **options)  # type: ignore[arg-type]


def test_tubes_of_one_segment_must_move_together() -> None:
    with pytest.raises(InputError, match=r"translations\[1\]: .*share a sheath"):
        forward_kinematics_batch(ETR, np.zeros((2, 3)), [[0.0, 0.0, 0.0], [0.0, -0.01, 0.0]])


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("name", ["thesis_ctr", "two_tube", "example_pieces"])
def test_side_by_side_configurations_have_the_results_of_each_alone(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rotations of several turns, of which some end unstable; tubes made of pieces are solved alone in any case."""
    robot = load_robot(f"configs/robots/{name}.yaml")
    random, space = np.random.default_rng(2), joint_space(robot)
    joints = space.joint(space.sample(400))
    n = robot.n_tubes
    rotations = random.uniform(-12, 12, (len(joints), n))
    straight = [tube.straight_length for tube in robot.tubes]
    translations = np.minimum(joints[:, n:], straight)
    together = solve_many_compiled(robot, rotations, translations)
    monkeypatch.setattr(binding, "abreast_library", lambda _: None)
    alone = solve_many_compiled(robot, rotations, translations)
    assert together is not None
    assert alone is not None
    assert (together[1] == alone[1]).all()
    assert np.abs(together[0] - alone[0])[:, : 12 + n].max() < 1e-12
    assert np.abs(together[0] - alone[0]).max() < 1e-9
