"""The compiled kernel beside the general solver: the same equilibria, and what it leaves to it."""

from __future__ import annotations

import pickle
import shlex
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.equilibrium.test_bundle import random_bundle
from tests.equilibrium.test_random_pieces import random_robot as random_pieces
from tests.examples import CONFIGS, CRL, THESIS
from tests.stability.robots import random_robot
from tubeopt import (
    ConcentricRobot,
    EccentricRobot,
    Equilibrium,
    InputError,
    Load,
    Piece,
    SegmentedEccentricRobot,
    SolveError,
    Tube,
    forward_kinematics,
    forward_kinematics_batch,
    load_robot,
)
from tubeopt.equilibrium import bundle, kinematics
from tubeopt.equilibrium.directions import PARAMETERS
from tubeopt.equilibrium.jacobian import compiled_slopes, derivatives_of
from tubeopt.equilibrium.member import discretisation_of
from tubeopt.robots.robot import Robot, is_general
from tubeopt.solvers.compiled import binding
from tubeopt.solvers.compiled import library as building
from tubeopt.solvers.compiled.binding import kernel_of
from tubeopt.typing import Array

compiler = pytest.mark.skipif(kernel_of(THESIS) is None, reason="no C compiler")

ETR = EccentricRobot(Tube(1.92e-3, 1.57e-3, 0.02, 0.094, 26.0), transmission_length=0.05)
SEGMENTED = SegmentedEccentricRobot(
    (Tube(1.0e-3, 0.8e-3, 0.1, 0.06, 20.0), Tube(1.6e-3, 1.3e-3, 0.01, 0.08, 15.0)),
)


@contextmanager
def general_solver() -> Iterator[None]:
    """Forward kinematics without the kernel."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kinematics, "solve_compiled", lambda *_: None)
        patch.setattr(bundle, "solve_bundle_compiled", lambda *_: None)
        yield


def general(robot: Robot, *joints: Array, guess: Equilibrium | None = None) -> Equilibrium:
    with general_solver():
        return forward_kinematics(robot, *joints, start=guess)


def check_same(one: Equilibrium, other: Equilibrium) -> None:
    length = max(one.arc_length[-1], 1e-3)
    assert one.tip_position == pytest.approx(other.tip_position, abs=1e-11 * length)
    assert one.tip_rotation == pytest.approx(other.tip_rotation, abs=1e-10)
    assert one.tip_rotations == pytest.approx(other.tip_rotations, abs=1e-10)
    assert one.arc_length == pytest.approx(other.arc_length, abs=1e-12)
    assert one.section_start == pytest.approx(other.section_start, abs=1e-12)
    assert one.tube_end == pytest.approx(other.tube_end, abs=1e-12)
    for name in ("rotation", "torsion", "curvature", "position", "frame"):
        value = getattr(other, name)
        assert getattr(one, name) == pytest.approx(value, abs=1e-9 * max(1.0, np.abs(value).max(initial=0.0))), name
    assert one.margin == pytest.approx(other.margin, abs=1e-8)
    assert one.energy == pytest.approx(other.energy, rel=1e-9, abs=1e-15)
    assert one.residual < 1e-10
    # The kernel begins its check of the mesh from an interpolated state, and so finds more than there is.
    assert other.mesh_error <= 1.1 * one.mesh_error + 1e-12
    assert one.mesh_error < 1e-8
    assert one.tip_error == pytest.approx(other.tip_error, rel=0.3, abs=1e-12)
    assert one.statistics.elements == other.statistics.elements


def _with_kernel(robot: Robot, kernel: building.Kernel) -> binding.Prepared:
    tubes = binding._tubes(robot, 0)
    return binding.Prepared(kernel, tubes, binding.address(tubes[0]))


def joints_of(robot: Robot, random: np.random.Generator) -> tuple[Array, Array]:
    shift = np.empty(robot.n_tubes)
    for tubes in robot.moving_together:
        tube = robot.tubes[tubes[0]]
        shift[list(tubes)] = random.uniform(-0.9 * tube.curved_length, tube.straight_length)
    return random.uniform(-np.pi, np.pi, robot.n_tubes), shift


@compiler
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_random_concentric_robots(n: int) -> None:
    random = np.random.default_rng([1, n])
    for _ in range(25):
        robot = random_robot(random, n)
        alpha, shift = joints_of(robot, random)
        one = forward_kinematics(robot, alpha, shift)
        check_same(one, general(robot, alpha, shift))
        turn, push = random.uniform(-0.05, 0.05, n), random.uniform(-1e-3, 0.0, n)
        there = forward_kinematics(robot, alpha + turn, shift + push, start=one)
        check_same(there, general(robot, alpha + turn, shift + push, guess=one))


@compiler
@pytest.mark.parametrize("robot", [THESIS, CRL, ETR], ids=["thesis", "crl", "etr"])
def test_published_robots(robot: Robot) -> None:
    random = np.random.default_rng(2)
    for _ in range(30):
        alpha, shift = joints_of(robot, random)
        check_same(forward_kinematics(robot, alpha, shift), general(robot, alpha, shift))


def of_pieces(tube: Tube, parts: int = 1) -> Tube:
    """A tube with its arc as a chain of so many pieces."""
    chain = (Piece(tube.curved_length / parts, tube.curvature),) * parts
    return replace(tube, pieces=chain, curvature=abs(tube.curvature))


@compiler
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_tubes_of_one_piece_are_those_of_one_arc(n: int) -> None:
    random = np.random.default_rng([4, n])
    for _ in range(10):
        robot = random_robot(random, n)
        alpha, shift = joints_of(robot, random)
        one = forward_kinematics(robot, alpha, shift)
        made = replace(robot, tubes=tuple(of_pieces(tube) for tube in robot.tubes))
        assert is_general(made)
        check_same(one, forward_kinematics(made, alpha, shift))
        cut = replace(robot, tubes=(of_pieces(robot.tubes[0], 3), *robot.tubes[1:]))
        assert forward_kinematics(cut, alpha, shift).tip_position == pytest.approx(one.tip_position, abs=1e-9)


@compiler
def test_tubes_that_vary_beside_tubes_that_do_not() -> None:
    """Some pieces of the mesh have only tubes that are the same all along them, and half the steps of the shape."""
    inner = Tube.of_pieces(
        1.0e-3, 0.8e-3, [Piece(0.04, 12.0), Piece(0.05, lambda s: (10 + 100 * s, 0.0, 8.0))], straight_length=0.1
    )
    robot = ConcentricRobot((inner, Tube(1.6e-3, 1.3e-3, 0.05, 0.07, 9.0)))
    random = np.random.default_rng(5)
    for _ in range(10):
        alpha, shift = random.uniform(-np.pi, np.pi, 2), -random.uniform(0, [0.09, 0.04])
        check_same(forward_kinematics(robot, alpha, shift), general(robot, alpha, shift))


@compiler
def test_segmented_robot_at_home_and_moved() -> None:
    random = np.random.default_rng(3)
    for push in (0.0, -0.004, 0.003):
        shift = SEGMENTED.home_translations + np.repeat([push, 0.0], 3)
        if push < 0:
            shift = SEGMENTED.home_translations + np.repeat([0.0, push], 3)
        alpha = random.uniform(-1.5, 1.5, 6)
        check_same(forward_kinematics(SEGMENTED, alpha, shift), general(SEGMENTED, alpha, shift))


@compiler
def test_of_several_equilibria_both_find_the_same() -> None:
    """Long transmissions and tight curves, where descents that differ in their steps end in different minima."""
    tubes = tuple(Tube(d, d - 0.3e-3, 0.22 - 0.04 * i, 0.14, 25.0) for i, d in enumerate((1e-3, 1.4e-3, 1.8e-3)))
    robot = ConcentricRobot(tubes)
    for k in range(15, 45):
        alpha = np.random.default_rng([6, k]).uniform(-np.pi, np.pi, 3)
        check_same(forward_kinematics(robot, alpha), general(robot, alpha))


@compiler
def test_many_tubes_that_overlap() -> None:
    """Six tubes that begin and end one after the other have some two hundred unknowns: the kernel has room for them."""
    diameter, curved = 4e-4 * np.arange(1, 7), np.linspace(0.09, 0.05, 6)
    curvature = (6.0, -9.0, 8.0, 12.0, -5.0, 10.0)
    tubes = (Tube(d, d - 1e-4, 0.03, c, k) for d, c, k in zip(diameter, curved, curvature, strict=True))
    robot = ConcentricRobot(tuple(tubes))
    alpha, shift = np.array([0.3, -0.8, 1.4, 0.1, -1.9, 0.7]), np.linspace(0.01, 0.0, 6)
    answer = binding.solve_compiled(robot, alpha, shift)
    assert answer is not None
    assert len(answer.solution.points.point) == 54
    check_same(forward_kinematics(robot, alpha, shift), general(robot, alpha, shift))


@compiler
def test_a_withdrawn_robot_is_a_point() -> None:
    shift = np.array([-tube.curved_length for tube in THESIS.tubes])
    one = forward_kinematics(THESIS, (0.3, -0.2, 0.1), shift)
    assert one.arc_length.tolist() == [0.0]
    assert one.tip_rotations == pytest.approx([0.3, -0.2, 0.1])


@compiler
def test_results_are_the_callers_own() -> None:
    one = forward_kinematics(THESIS, (0.0, 1.0, 2.0))
    tip, theta = one.tip_position.copy(), one.rotation.copy()
    forward_kinematics(THESIS, (1.0, 0.0, -2.0))
    assert np.array_equal(one.tip_position, tip)
    assert np.array_equal(one.rotation, theta)
    assert np.array_equal(pickle.loads(pickle.dumps(one)).rotation, theta)


@compiler
def test_threads_and_robots_do_not_disturb_each_other() -> None:
    """More robots than are remembered, of different numbers of tubes, in several threads at once."""
    robots: list[Robot] = [random_robot(np.random.default_rng([7, k]), 1 + k % 4) for k in range(70)] + [ETR, SEGMENTED]

    def tips(robot: Robot) -> Array:
        random = np.random.default_rng(robot.n_tubes)
        alpha = random.uniform(-1.0, 1.0, (20, robot.n_tubes))
        return forward_kinematics_batch(robot, alpha).tip_position

    alone = [tips(robot) for robot in robots]
    with ThreadPoolExecutor(4) as pool:
        for one, other in zip(alone, pool.map(tips, robots), strict=True):
            assert np.array_equal(one, other)


def test_tubes_of_one_segment_must_move_together() -> None:
    with pytest.raises(InputError, match="share a sheath"):
        forward_kinematics(ETR, (0.0, 0.1, 0.2), (0.0, -0.01, 0.0))


def test_many_breakpoints_closer_than_round_off() -> None:
    tubes = tuple(
        Tube((1 + k) * 4e-4, (1 + k) * 4e-4 - 2e-4, 0.02 + k * 0.7e-12, 0.05 - 2 * k * 0.7e-12, 10.0 + k)
        for k in range(4)
    )
    robot = type(THESIS)(tubes)
    check_same(forward_kinematics(robot, (0.0, 0.5, 1.0, 1.5)), general(robot, (0.0, 0.5, 1.0, 1.5)))


def test_without_a_compiler_the_general_solver_answers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TUBEOPT_CACHE", str(tmp_path))
    for hide in (("TUBEOPT_COMPILE", "0"), ("CC", "/no/such/compiler"), ("CC", "false")):
        with monkeypatch.context() as patch:
            patch.setenv(*hide)
            assert building._build("int nothing;") is None


@compiler
def test_a_compiler_that_does_not_know_the_processor_is_told_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    own = tmp_path / "old-cc"
    own.write_text(f'#!/bin/sh\ncase " $* " in *" {building.OWN_PROCESSOR} "*) exit 1;; esac\nexec cc "$@"\n')
    own.chmod(0o755)
    monkeypatch.setenv("TUBEOPT_CACHE", str(tmp_path))
    monkeypatch.setenv("CC", str(own))
    building._warn_once.cache_clear()
    for text in ("int one(void) { return 1; }", "int two(void) { return 2; }"):
        assert building._build(text) is not None
    (record,) = caplog.records
    assert record.getMessage().startswith(f"{own} cannot compile the kernel with {building.OWN_PROCESSOR}: ")


def test_a_file_that_is_no_library_is_no_kernel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "kernel.so"
    broken.write_bytes(b"")
    monkeypatch.setattr(building, "kernel_path", lambda *_, **__: broken)
    assert building.library.__wrapped__(3, False) is None


@compiler
def test_the_kernel_is_built_once_and_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TUBEOPT_CACHE", str(tmp_path))
    path = building._build("int answer(void) { return 42; }")
    assert path is not None
    assert path.parent == tmp_path / "kernels"
    written = path.stat().st_mtime_ns
    assert building._build("int answer(void) { return 42; }") == path
    assert path.stat().st_mtime_ns == written
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@compiler
def test_the_text_of_a_kernel_is_made_once_for_each_state_of_the_sources(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TUBEOPT_CACHE", str(tmp_path))
    monkeypatch.setattr(building, "packaged_kernel", lambda *_: None)
    made: list[str] = []

    def text() -> str:
        made.append("int answer(void) { return 42; }")
        return made[-1]

    path = building.kernel_path((3, "none"), text)
    assert path is not None
    assert [building.kernel_path((3, "none"), text), len(made)] == [path, 1]
    path.unlink()  # what a note names may be gone
    assert [building.kernel_path((3, "none"), text), len(made)] == [path, 2]
    monkeypatch.setattr(building, "_sources", lambda: "others")
    assert [building.kernel_path((3, "none"), text), len(made)] == [path, 3]


@compiler
def test_a_compiler_that_cannot_tune_for_the_processor_will_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As clang on some ARM machines, which knows no -march=native. Without fused multiplication sines come from the
    library; the answers are the same to round-off."""
    own = building.compiler()
    assert own is not None
    words = f'for word; do [ "$word" = {building.OWN_PROCESSOR} ] && exit 1; done\nexec {shlex.join(own)} "$@" -O0\n'
    plain = tmp_path / "plain-cc"
    plain.write_text(f"#!/bin/sh\n{words}")
    plain.chmod(0o755)
    monkeypatch.setenv("TUBEOPT_CACHE", str(tmp_path))
    monkeypatch.setenv("CC", str(plain))
    robot = random_robot(np.random.default_rng([9, 2]), 2)
    alpha = np.random.default_rng(9).uniform(-np.pi, np.pi, (50, 2))
    here = forward_kinematics_batch(robot, alpha)
    other = building.library.__wrapped__(2, False)
    assert other is not None
    monkeypatch.setattr(binding, "with_kernel", lambda robot, _: _with_kernel(robot, other))
    there = forward_kinematics_batch(robot, alpha)
    assert there.tip_position == pytest.approx(here.tip_position, abs=1e-13)
    assert there.margin == pytest.approx(here.margin, abs=1e-9)
    assert there.residual.max() < 1e-10


@compiler
def test_long_arms_go_to_the_general_solver() -> None:
    long = tuple(replace(tube, curved_length=40 * tube.curved_length) for tube in THESIS.tubes)
    robot = replace(THESIS, tubes=long)
    one = forward_kinematics(robot, (0.0, 0.02, 0.04))
    assert one.residual < 1e-9
    assert one.statistics.elements > 16


@compiler
def test_whole_turns_change_nothing() -> None:
    """Turning every joint by the same 150 turns, near the most that is allowed, leaves the shape as it was."""
    random = np.random.default_rng(8)
    alpha = random.uniform(-np.pi, np.pi, (50, 3))
    here, there = (forward_kinematics_batch(CRL, alpha + 2 * np.pi * turns) for turns in (0, 150))
    assert there.tip_position == pytest.approx(here.tip_position, abs=1e-13)
    assert there.margin == pytest.approx(here.margin, abs=1e-9)


LOADS = (
    Load((0.1, -0.02, 0.03)),
    Load((0.05, 0, -0.05), points=((0.06, (0.1, 0.2, -0.1)),), distributed=((0.03, 0.12, (0.3, 0.1, 0.0)),)),
    Load(gravity=(0, -9.81, 0)),
)


@compiler
@pytest.mark.parametrize("load", LOADS)
def test_loaded_equilibria_are_those_of_the_general_solver(load: Load) -> None:
    random = np.random.default_rng(4)
    for _ in range(2):
        alpha, shift = random.uniform(-2, 2, 3), random.uniform([-0.03, -0.02, -0.01], 0.0)
        turned = alpha + random.uniform(-0.1, 0.1, 3)
        one = forward_kinematics(THESIS, alpha, shift, load=load)
        warm = forward_kinematics(THESIS, turned, shift, load=load, start=one)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(kinematics, "solve_loaded_compiled", lambda *_: None)
            check_same_loaded(one, forward_kinematics(THESIS, alpha, shift, load=load))
            check_same_loaded(warm, forward_kinematics(THESIS, turned, shift, load=load, start=one))


@compiler
@pytest.mark.parametrize("robot", [THESIS, CRL])
def test_a_batch_under_load_is_that_of_single_solves(robot: ConcentricRobot) -> None:
    """Also at other translations, and where a branch ends."""
    random, load, n = np.random.default_rng(3), Load((0.1, 0.0, -0.1)), robot.n_tubes
    alpha = random.uniform(-3, 3, (12, n))
    shift = np.repeat([np.zeros(n), np.linspace(-0.01, 0, n)], 6, axis=0)
    batch = forward_kinematics_batch(robot, alpha, shift, load=load)
    failed = [k for k, _ in batch.failures]
    for k in range(12):
        if k in failed:
            with pytest.raises(SolveError):
                forward_kinematics(robot, alpha[k], shift[k], load=load)
            continue
        one = forward_kinematics(robot, alpha[k], shift[k], load=load)
        assert batch.tip_position[k] == pytest.approx(one.tip_position, abs=1e-12)
        assert batch.tip_rotations[k] == pytest.approx(one.tip_rotations, abs=1e-11)
        assert batch.margin[k] == pytest.approx(one.margin, abs=1e-9)
        assert batch.energy[k] == pytest.approx(one.energy, rel=1e-10)
        assert batch.compliance[k] == pytest.approx(one.compliance, abs=1e-10 * np.abs(one.compliance).max())


def check_same_bundle(one: Equilibrium, other: Equilibrium) -> None:
    # The kernel keeps the elements of a start; the general solver takes new ones where the start needs them.
    at_points = ("point_rotation", "point_curvature") * (one.point_rotation.shape == other.point_rotation.shape)
    for name in ("tip_position", "tip_rotations", "section_start", "tube_end", *at_points[:1]):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-10), name
    # Inside elements the shape is integrated here, and a polynomial there.
    for name in ("position", "frame", "rotation") * bool(at_points):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-9), name
    for name in ("torsion", "curvature", *at_points[1:]) * bool(at_points):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-8), name
    # Eigenvalues gather at margin 1.
    assert one.margin == pytest.approx(other.margin, abs=1e-9 if other.margin < 0.999 else 1e-7)
    assert one.energy == pytest.approx(other.energy, rel=1e-11, abs=1e-15)
    assert one.mesh_error <= 1.1 * other.mesh_error + 1e-11
    assert one.residual < 1e-9


@compiler
def test_bundles_are_those_of_the_general_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """At random joint values, after a small motion from there, and where ends of tubes meet."""
    for seed in range(12):
        random = np.random.default_rng(seed)
        robot, alpha, shift = random_bundle(random)
        one = robot.fk(alpha, shift)
        turned, moved = alpha + random.uniform(-0.2, 0.2, len(alpha)), shift - random.uniform(0.0, 2e-3, len(alpha))
        warm = robot.fk(turned, moved, start=one)
        check_same_bundle(one, general(robot, alpha, shift))
        check_same_bundle(warm, general(robot, turned, moved, guess=one))
    robot = ETR.bundle()
    for degrees in ([0.0, 0.0, 0.0], [40.0, 40.0, 40.0], [0.0, 60.0, -60.0]):
        check_same_bundle(robot.fk(np.radians(degrees)), general(robot, np.radians(degrees)))
    # The kernel also exchanges boundaries that a step makes meet.
    monkeypatch.setattr(kinematics, "_descend", None)
    solved = 0
    for seed in range(30):
        robot, alpha, shift = random_bundle(np.random.default_rng(seed))
        with suppress(TypeError):
            robot.fk(alpha, shift)
            solved += 1
    assert solved >= 29


def check_same_loaded(one: Equilibrium, other: Equilibrium) -> None:
    for name in ("tip_position", "position", "frame", "rotation", "tip_rotations"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-12), name
    for name in ("torsion", "curvature", "point_rotation", "point_curvature", "compliance", "base_wrench"):
        value = getattr(other, name)
        assert getattr(one, name) == pytest.approx(value, abs=1e-11 * np.abs(value).max()), name
    assert one.margin == pytest.approx(other.margin, abs=1e-9)
    assert one.energy == pytest.approx(other.energy, rel=1e-11)
    assert one.work == pytest.approx(other.work, rel=1e-11)
    # The kernel begins its check of the mesh from an interpolated state, and so finds more than there is.
    assert other.mesh_error <= 1.1 * one.mesh_error + 1e-12
    assert one.mesh_error < 1e-8


@compiler
def test_loads_beyond_the_kernel_are_left_to_the_general_solver() -> None:
    """As moments are; for lost equilibria see cli/test_loads.py."""
    assert 0 < forward_kinematics(THESIS, [0.0, 1.0, 2.0], load=Load(moment=(0.01, 0, 0))).margin < 1


@compiler
def test_every_translation_has_the_derivative_of_its_own_side_where_breakpoints_coincide() -> None:
    """Where tube 2 ends at the end of tube 3: beside differences of tips and margins to that side."""
    alpha, ends = np.array([-2.3, 1.0, 0.9]), [tube.curved_length for tube in THESIS.tubes]
    shift = np.array([0.0, ends[2] - ends[1] - 0.01, -0.01])
    at = forward_kinematics(THESIS, alpha, shift)
    start = binding.Start(at.arc_length, at.rotation, at.torsion, at.point, at.point_rotation, np.zeros(3), shift)
    step, told = 1e-5, []
    for sides in ((1, 1, 1), (1, -1, 1)):
        found = binding.slopes_compiled(THESIS, alpha, shift, start, binding.Moved(sides, THESIS.moving_together), 0)
        assert found is not None
        assert found.compliance is None
        told.append(found.margin[4])
        for i, side in enumerate(sides):
            there = [forward_kinematics(THESIS, alpha, shift + k * side * step * np.eye(3)[i]) for k in (1, 2)]
            here, one, two = (np.append(arm.tip_position, arm.margin) for arm in (at, *there))
            slope = (4 * one - two - 3 * here) / (2 * side * step)
            assert found.position[:, 3 + i] == pytest.approx(slope[:3], abs=1e-6)
            assert found.margin[3 + i] == pytest.approx(slope[3], abs=1e-3)
    assert abs(told[0] - told[1]) > 1


@compiler
def test_derivatives_of_what_was_solved_last_do_not_solve_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seed = forward_kinematics(THESIS, [0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])
    at = forward_kinematics(THESIS, [0.01, 1.0, 2.0], [-0.05, -0.03, -0.02], start=seed)
    monkeypatch.setattr(binding, "solve_compiled", lambda *_: pytest.fail("solved once more"))
    arm = at.arc_length, at.rotation, at.torsion, at.point, at.point_rotation
    start = binding.Start(*arm, np.zeros(3), at.translations)
    for sides in ((1, 1, 1), (-1, 1, -1)):
        moved = binding.Moved(sides, THESIS.moving_together)
        assert binding.slopes_compiled(THESIS, at.rotations, at.translations, start, moved, 0) is not None


@compiler
def test_derivatives_are_the_general_ones_of_every_robot() -> None:
    """By joint values, to both sides: at home, where breakpoints coincide, and behind it; also of pieces at random."""
    random, refined = np.random.default_rng(4), set[int]()
    robots = [load_robot(path) for path in sorted(CONFIGS.glob("*.yaml"))]
    robots += [random_pieces(random)[0] for _ in range(6)]
    for robot in robots:
        if not isinstance(robot, ConcentricRobot):
            continue
        n, home = robot.n_tubes, robot.home_translations
        back = 0.2 * robot.tubes[0].curved_length / np.arange(1, n + 1)
        for shift, side in ((home, 1), (home, -1), (home - back, 1), (home - back, -1)):
            at = forward_kinematics(robot, np.linspace(-1.0, 2.0, n), shift)
            told = compiled_slopes(at, (side,) * n, either=False)
            of = derivatives_of(at, side=side)
            assert told is not None
            refined.add(discretisation_of(at).refinement)
            if is_general(robot) and at.margin > 0.999:  # the mesh hardly resolves it
                continue
            assert told.along is not None
            # A margin close to 1 is that of a mode that the mesh resolves to some digits only.
            for mine, other, same in (
                (told.position, of.tip_position, 1e-9),
                (told.turn, of.tip_rotation, 1e-9),
                (told.tip_rotations, of.tip_rotations, 1e-9),
                (told.energy, of.energy, 1e-9),
                (told.along, of.position, 1e-6),
                (told.margin, of.margin, 3e-6),
            ):
                for a, b in zip(np.split(mine, 2, axis=-1), np.split(other, 2, axis=-1), strict=True):
                    assert a == pytest.approx(b, rel=0, abs=same * np.abs(b).max() + 1e-14)
    assert max(refined) > 0


@compiler
def test_columns_of_a_jacobian_are_those_asked_for() -> None:
    at = forward_kinematics(THESIS, [-1.0, 0.8, 2.0])
    every, some = at.jacobian(wrt=PARAMETERS), at.jacobian(wrt=("torsional_stiffness", "translations"))
    assert some.margin == pytest.approx(np.concatenate([every.margin[18:], every.margin[3:6]]), rel=1e-11)
    joints, turned = at.jacobian(), at.jacobian(wrt=("translations", "rotations"))
    assert turned.position == pytest.approx(np.roll(joints.position, 3, axis=1), rel=1e-11)
    assert joints.position == pytest.approx(every.position[:, :6], rel=1e-9)  # the kernel's, and the general one's


@compiler
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("name", ["two_tube", "thesis_ctr", "grassmann_ctr"])
def test_slopes_by_dimensions_are_those_of_the_general_solver(name: str, side: int) -> None:
    robot, rng = load_robot(name), np.random.default_rng(3)
    for retracted in (0.0, 0.015):  # at home all breakpoints meet
        shift = robot.home_translations - retracted * rng.uniform(0, 1, robot.n_tubes)
        at = forward_kinematics(robot, rng.uniform(-2, 2, robot.n_tubes), shift)
        mine, other = at.jacobian(wrt=PARAMETERS, side=side), derivatives_of(at, PARAMETERS, side=side)
        pairs = [(mine.position, other.tip_position), (mine.rotation, other.tip_rotation), (mine.energy, other.energy)]
        pairs.append((mine.tip_rotations, other.tip_rotations))
        if np.isfinite(other.margin).all():
            pairs.append((mine.margin, other.margin))
        for a, b in pairs:
            of_parameter = (np.reshape(part, (-1, len(PARAMETERS), robot.n_tubes)) for part in (a, b))
            for one, known in zip(*(np.moveaxis(part, 1, 0) for part in of_parameter), strict=True):
                assert np.abs(one - known).max() < 1e-7 * np.abs(known).max() + 1e-12


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")
@compiler
def test_a_margin_that_two_modes_share_has_no_slope_unless_one_of_them_is_asked_for() -> None:
    """Three tubes as stiff and as curved as each other, a third of a turn apart: two modes are alike."""
    thin = Tube(1.0e-3, 0.8e-3, 0.02, 0.1, 5.0)
    wide = [replace(thin, outer_diameter=d, inner_diameter=d - 0.2e-3) for d in (1.0e-3, 1.4e-3, 1.8e-3)]
    shares = [thin.bending_stiffness / tube.bending_stiffness for tube in wide]
    tubes = [
        replace(
            tube,
            material=replace(
                tube.material,
                youngs_modulus=tube.material.youngs_modulus * share,
                shear_modulus=tube.material.shear_modulus * share,
            ),
        )
        for tube, share in zip(wide, shares, strict=True)
    ]
    at = forward_kinematics(ConcentricRobot(tuple(tubes)), np.radians([0.0, 120.0, -120.0]))
    assert 0 < at.margin < 0.99
    assert np.isnan(at.jacobian().margin).all()
    assert np.isfinite(at.jacobian().position).all()
    one = compiled_slopes(at)
    assert one is not None
    assert np.isfinite(one.margin).all()
