"""Inverse kinematics: answers are stable equilibria on target and inside the limits, or say why there is none."""

from __future__ import annotations

import math
import pickle
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import tubeopt
from tests.examples import CONFIGS, CRL, MM, THESIS, TWO_TUBE, eccentric_robot, nested, random_robot
from tests.inverse_targets import inside, reachable
from tubeopt import (
    ConcentricRobot,
    InputError,
    InverseOptions,
    InverseStatus,
    SolveError,
    Tube,
    forward_kinematics,
    forward_kinematics_batch,
    inverse_kinematics,
)
from tubeopt.bodies.obstacles import Scene, Sphere
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.batch import solved_batch
from tubeopt.inverse import joint_path, multistart
from tubeopt.inverse.clock import Clock
from tubeopt.inverse.gauss_newton import reach
from tubeopt.inverse.goal import pose_question, unit_vector
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.mirror import mirror_closed_form, mirror_pose
from tubeopt.inverse.multistart import build_table, nearest_starts, start_table
from tubeopt.inverse.posture import posture_of
from tubeopt.inverse.search import PathResult, find_path
from tubeopt.inverse.task import Task
from tubeopt.robots.limits import JointLimits
from tubeopt.robots.robot import Robot
from tubeopt.solvers.compiled.bundle import bundle_kernel
from tubeopt.solvers.compiled.library import cache_directory

ETR = tubeopt.load_robot(CONFIGS / "thesis_etr.yaml")
SEGMENTED = tubeopt.load_robot(CONFIGS / "example_three_segment_etr.yaml")
TARGET = np.array([50.0, 30.0, 150.0]) * MM


def check_answer(answer: tubeopt.InverseSolution, robot: Robot, min_margin: float = 0.05) -> None:
    """What every answer promises, by forward kinematics from its joint values."""
    assert answer.reached
    again = forward_kinematics(robot, answer.rotations, answer.translations, start=answer.equilibrium)
    assert np.linalg.norm(again.tip_position - answer.target_position) <= 1e-7
    assert again.margin >= min_margin
    assert again.margin == pytest.approx(answer.margin, abs=1e-9)
    assert inside(robot, answer.rotations, answer.translations)
    assert answer.position_error == pytest.approx(
        np.linalg.norm(answer.equilibrium.tip_position - answer.target_position), abs=1e-15
    )
    if answer.cold_start_agrees:
        cold = forward_kinematics(robot, answer.rotations, answer.translations)
        assert np.linalg.norm(cold.tip_position - answer.target_position) <= 1e-7
    if answer.target_direction is not None and answer.direction_error < 1e-6:
        assert again.tip_rotation[:, 2] @ answer.target_direction == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("robot", [THESIS, CRL, TWO_TUBE, ETR], ids=lambda robot: robot.name)
def test_tips_of_random_configurations_are_reached(robot: Robot) -> None:
    for desired in reachable(robot, 6, seed=1):
        answer = inverse_kinematics(robot, desired.tip_position)
        check_answer(answer, robot)
        assert answer.cold_start_agrees


@pytest.mark.parametrize("robot", [THESIS, CRL, TWO_TUBE], ids=lambda robot: robot.name)
def test_and_pointed_as_they_were(robot: Robot) -> None:
    for desired in reachable(robot, 4, seed=2):
        answer = inverse_kinematics(robot, desired.tip_position, direction=3 * desired.tip_rotation[:, 2])
        check_answer(answer, robot)
        assert answer.direction_error <= 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_robots_of_all_kinds(seed: int) -> None:
    robot = random_robot(np.random.default_rng(seed), 1 + seed)
    for desired in reachable(robot, 3, seed):
        answer = inverse_kinematics(robot, desired.tip_position)
        check_answer(answer, robot)
        assert np.linalg.norm(answer.equilibrium.tip_position - desired.tip_position) <= 1e-7


def test_several_segments_of_eccentric_tubes() -> None:
    home = forward_kinematics(SEGMENTED, np.radians([20, 50, -30, 80, 0, 10, -60, 15, 40.0]))
    answer = inverse_kinematics(SEGMENTED, home.tip_position, min_margin=0.1)
    again = forward_kinematics(SEGMENTED, answer.rotations, answer.translations, start=answer.equilibrium)
    assert np.linalg.norm(again.tip_position - home.tip_position) <= 1e-7
    assert again.margin >= 0.1


def test_narrow_limits_are_kept() -> None:
    limits = JointLimits(((-1.0, 0.5), (-0.4, 1.2), (-2.0, -0.1)), ((-0.05, 0.0), (-0.03, 0.0), (-0.06, -0.05)))
    robot = replace(THESIS, joint_limits=limits)
    for desired in reachable(robot, 6, seed=4):
        check_answer(inverse_kinematics(robot, desired.tip_position), robot)
        other = inverse_kinematics(THESIS, desired.tip_position, limits=limits)
        assert inside(robot, other.rotations, other.translations)


@pytest.mark.parametrize("margin", [0.0, 0.3, 0.8])
def test_the_margin_is_never_below_its_bound(margin: float) -> None:
    """Targets at the tip of configurations close to a snap: another posture is found, or none."""
    result = 0
    for k, desired in enumerate(reachable(CRL, 6, seed=5, margin=0.02)):
        try:
            answer = inverse_kinematics(CRL, desired.tip_position, min_margin=margin, start=desired if k % 2 else None)
        except SolveError:
            continue
        check_answer(answer, CRL, margin)
        result += 1
    assert result >= 3


def test_a_target_whose_nearest_posture_is_unstable() -> None:
    """The tip of the unstable equilibrium of opposed tubes: the answer is another, stable posture."""
    saddle = min(tubeopt.find_equilibria(THESIS, np.radians([200, 0, 0])), key=lambda e: e.margin)
    assert saddle.margin < 0
    answer = inverse_kinematics(THESIS, saddle.tip_position, start=(saddle.rotations, saddle.translations))
    check_answer(answer, THESIS)


class TestSeed:
    def test_a_seed_on_target_is_the_answer(self) -> None:
        first = inverse_kinematics(THESIS, TARGET)
        again = inverse_kinematics(THESIS, TARGET, start=first)
        np.testing.assert_allclose(again.rotations, first.rotations, atol=1e-6)
        assert again.statistics.start == "seed"
        assert again.straight_from_seed

    def test_a_small_step_stays_on_the_branch_and_close(self) -> None:
        seed = forward_kinematics(THESIS, [0.4, 1.0, -0.5], [-0.01, -0.02, -0.015])
        target = seed.tip_position + np.array([3e-4, -2e-4, 1e-4])
        answer = inverse_kinematics(THESIS, target, start=seed)
        check_answer(answer, THESIS)
        assert answer.straight_from_seed
        assert np.abs(answer.rotations - seed.rotations).max() < 0.1
        path = tubeopt.follow(
            THESIS,
            [seed.rotations, answer.rotations],
            [seed.translations, answer.translations],
            start=seed,
        )
        assert not path.snaps
        assert np.linalg.norm(path.equilibria[-1].tip_position - target) < 1e-7

    def test_nearest_is_nearest(self) -> None:
        """No small motion along the postures with the same tip comes closer to the reference."""
        reference = (np.radians([30.0, 60.0, 90.0]), np.array([-0.03, -0.02, -0.01]))
        answer = inverse_kinematics(THESIS, TARGET, reference=reference)
        goal = pose_question(THESIS, TARGET, reference=reference)
        at = posture_of(goal.space, answer.equilibrium)
        kernel = np.linalg.svd(goal.slope(at) * goal.space.scale)[2][3:] * goal.space.scale
        random, tried = np.random.default_rng(0), 0
        for _ in range(60):
            moved = at.to(goal.space.clip(at.q + 0.01 * random.normal(size=3) @ kernel))
            if moved is None or not moved.admissible:
                continue
            beside = reach(goal, moved)
            assert not beside.reached or goal.cost(beside.posture) >= goal.cost(at) - 1e-5
            tried += beside.reached
        assert tried >= 5

    def test_an_optimum_of_one_method_is_one_of_the_other(self) -> None:
        reference = (np.radians([90.0, 140.0, 190.0]), np.array([-0.03, -0.03, -0.04]))
        centre, scale = np.concatenate(reference), np.array([1, 1, 1, 0.2, 0.2, 0.2])

        def cost(method: str, seed: tubeopt.InverseSolution | None) -> tuple[tubeopt.InverseSolution, float]:
            options = InverseOptions(method=method)
            answer = inverse_kinematics(THESIS, TARGET, reference=reference, start=seed, options=options)
            check_answer(answer, THESIS)
            q = np.concatenate([answer.rotations, answer.translations])
            return answer, float(np.sum(((q - centre) / scale) ** 2))

        for first, second in (("gauss_newton", "nlp"), ("nlp", "gauss_newton")):
            answer, value = cost(first, None)
            assert cost(second, answer)[1] == pytest.approx(value, rel=1e-4)

    def test_weights_say_what_moves(self) -> None:
        seed = forward_kinematics(THESIS, [0.4, 1.0, -0.5], [-0.01, -0.02, -0.015])
        target = seed.tip_position + np.array([2e-3, 1e-3, 0.0])
        still = inverse_kinematics(THESIS, target, start=seed, weights=([1e3, 1.0, 1.0], [5.0, 5.0, 5.0]))
        free = inverse_kinematics(THESIS, target, start=seed, weights=([1.0, 1e3, 1.0], [5.0, 5.0, 5.0]))
        assert abs(still.rotations[0] - 0.4) < 0.1 * abs(free.rotations[0] - 0.4)


def test_largest_margin_and_least_curvature_are_better_than_any_answer() -> None:
    target = next(e for e in reachable(CRL, 40, seed=9, margin=0.05) if e.margin < 0.6).tip_position
    plain = inverse_kinematics(CRL, target)
    stiff = inverse_kinematics(CRL, target, options=InverseOptions(objective="margin", starts=1))
    slender = inverse_kinematics(CRL, target, options=InverseOptions(objective="curvature", starts=1))
    assert stiff.margin >= plain.margin - 1e-6
    bends = []
    for each in (plain, slender):
        e = each.equilibrium
        square = (e.curvature**2).sum(1)
        bends.append(float(np.sum((square[1:] + square[:-1]) / 2 * np.diff(e.arc_length))))
    assert bends[1] <= 1.02 * bends[0]


def test_a_direction_as_a_cost_is_a_compromise() -> None:
    direction = np.array([1.0, 0.0, 0.2])
    with pytest.raises(SolveError, match=r"deg off the direction"):
        inverse_kinematics(THESIS, TARGET, direction=direction, options=InverseOptions(starts=1))
    free = inverse_kinematics(THESIS, TARGET, reference=(np.zeros(3), None), options=InverseOptions(starts=2))
    options = InverseOptions(direction_weight=50.0, starts=2)
    aimed = inverse_kinematics(THESIS, TARGET, direction=direction, reference=(np.zeros(3), None), options=options)
    check_answer(aimed, THESIS)
    unit = direction / np.linalg.norm(direction)
    assert aimed.direction_error < np.arccos(free.equilibrium.tip_rotation[:, 2] @ unit)


class TestObstacles:
    body = Sphere((0.025, 0.013, 0.09), 0.012)

    def test_the_whole_arm_keeps_away(self) -> None:
        options = InverseOptions(clearance=2 * MM)
        answer = inverse_kinematics(THESIS, TARGET, obstacles=[self.body], options=options)
        check_answer(answer, THESIS)
        e = answer.equilibrium
        # The centreline, finely sampled, with the tubes' radii.
        s = np.linspace(0, e.arc_length[-1], 2000)
        line = np.column_stack([np.interp(s, e.arc_length, e.position[:, k]) for k in range(3)])
        radius = np.max(
            [np.where(s <= end, t.outer_diameter / 2, 0) for t, end in zip(THESIS.tubes, e.tube_end, strict=True)], 0
        )
        distance = self.body.signed_distance(line) - radius
        assert distance.min() >= 2 * MM - 3e-5
        assert answer.clearance == pytest.approx(distance.min(), abs=1e-4)

    def test_the_program_keeps_away_too(self) -> None:
        options = InverseOptions(clearance=2 * MM, method="nlp")
        answer = inverse_kinematics(THESIS, TARGET, obstacles=[self.body], options=options)
        check_answer(answer, THESIS)
        assert answer.clearance >= 2 * MM

    def test_a_target_inside_of_one_is_out_of_reach(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """The tip, 0.5 mm thick, touches the sphere: no pose is closer, and as many starts as there may be find it."""
        body = Sphere(tuple(TARGET), 0.01)
        nearest = 0.01 + THESIS.tubes[0].outer_diameter / 2
        monkeypatch.setattr(multistart, "PROGRAM_STARTS", 1)
        monkeypatch.setattr(multistart, "CLEAR_STARTS", 2)
        for starts in (1, 2):
            options = InverseOptions(starts=starts)
            with pytest.raises(SolveError, match=r"mm short.*arm at obstacle 1 \(sphere\)") as report:
                inverse_kinematics(THESIS, TARGET, obstacles=[body], options=options)
            closest = report.value.solution
            assert closest.position_error == pytest.approx(nearest, abs=2e-5)
            assert closest.clearance >= 0

    def test_a_small_one_is_seen_between_the_points_of_the_measurement(self) -> None:
        e = forward_kinematics(THESIS, [0.0, 1.0, 2.0])
        s = np.linspace(0, e.arc_length[-1], 40001)
        line = CubicHermiteSpline(e.arc_length, e.position, e.frame[:, :, 2])(s)
        reach = np.where(s[:, None] <= e.tube_end, [t.outer_diameter / 2 for t in THESIS.tubes], 0.0).max(1)
        for position in np.linspace(0.103, 0.107, 9) * e.arc_length[-1] / 0.2:
            k = int(np.searchsorted(s, position))
            body = Sphere(tuple(line[k] + 1.2 * MM * e.frame[0, :, 0]), 0.2 * MM)
            smallest = float((body.signed_distance(line) - reach).min())
            assert ArmSurface(e).clearance(Scene((body,))) == pytest.approx(smallest, abs=2e-6)

    def test_the_closest_pose_is_clear_too(self, monkeypatch: pytest.MonkeyPatch) -> None:
        body = Sphere((1.96 * MM, 12.05 * MM, 67.32 * MM), 8 * MM)
        target = np.array([10.4, 38.2, 103.6]) * MM
        monkeypatch.setattr(multistart, "CLEAR_STARTS", 1)
        options = InverseOptions(clearance=MM, starts=1, method="gauss_newton")
        closest = inverse_kinematics(THESIS, target, obstacles=[body], on_failure="closest", options=options)
        assert closest.clearance >= MM
        assert closest.margin >= 0.05
        assert inside(THESIS, closest.rotations, closest.translations)


class TestOutOfReach:
    def test_the_message_says_by_how_far_and_why(self) -> None:
        with pytest.raises(SolveError, match=r"^target not reached in \d+ starts: [\d.]+ mm short: .*beyond .*closer"):
            inverse_kinematics(THESIS, [0, 0, 0.6], options=InverseOptions(starts=2))

    @pytest.mark.parametrize(
        ("robot", "target", "given", "cause"),
        [
            (TWO_TUBE, [0.0, 0.0, 80.0], {}, r"margin at its bound \(0\.05\); allow a smaller min_margin$"),
            (THESIS, [150.0, 0.0, 30.0], {}, r"translation of tube 3 at its end \(-100 mm\); move the target$"),
            (
                TWO_TUBE,
                [0.0, 20.0, 78.0],
                {"obstacles": [Sphere((0.0, 20 * MM, 78 * MM), 5 * MM)]},
                r"arm at obstacle 1 \(sphere\); move the target away from it$",
            ),
        ],
    )
    def test_the_message_has_one_cause_and_one_advice(
        self, robot: Robot, target: list[float], given: dict[str, Any], cause: str
    ) -> None:
        with pytest.raises(SolveError, match=cause) as report:
            inverse_kinematics(robot, np.multiply(target, MM), options=InverseOptions(starts=2), **given)
        assert str(report.value).count(";") == 1

    def test_the_cause_is_what_holds_the_tip_back(self) -> None:
        """A smaller margin brings the tip closer, as the message says."""
        missed = [
            inverse_kinematics(
                TWO_TUBE, [0.0, 0.0, 0.08], min_margin=smallest, on_failure="closest", options=InverseOptions(starts=2)
            ).position_error
            for smallest in (0.2, 0.05)
        ]
        assert missed[0] > missed[1] + 1e-5

    def test_the_closest_pose_on_request(self) -> None:
        closest = inverse_kinematics(ETR, [0.0, 0.0, 0.2], on_failure="closest", options=InverseOptions(starts=1))
        assert closest.status is InverseStatus.CLOSEST
        assert not closest.reached
        # Straight up is as close as 94 mm of arm get.
        assert closest.position_error == pytest.approx(0.2 - 0.094, abs=1e-4)
        assert closest.margin >= 0.05
        with pytest.raises(SolveError) as failure:
            inverse_kinematics(ETR, [0.0, 0.0, 0.2], options=InverseOptions(starts=3))
        assert failure.value.solution.position_error == pytest.approx(closest.position_error, abs=1e-4)

    @pytest.mark.parametrize("robot", [THESIS, CRL, TWO_TUBE], ids=lambda robot: robot.name)
    def test_more_starts_never_give_a_worse_one(self, robot: Robot) -> None:
        target = 1.6 * next(reachable(robot, 1, seed=8)).tip_position + np.array([10.0, 0.0, 0.0]) * MM
        missed = [
            inverse_kinematics(
                robot, target, on_failure="closest", options=InverseOptions(starts=starts)
            ).position_error
            for starts in (1, 2, 4, 8)
        ]
        assert (np.diff(missed) <= 1e-7 * 0.4).all()

    def test_the_closest_pose_is_not_that_of_one_valley(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """From a start in the valley of a local minimum, at 303.3 mm, it is closer than any of many random poses."""
        monkeypatch.setattr("tubeopt.inverse.multistart.solve_program", lambda *_: pytest.fail("a program is solved"))
        target, valley = np.array([0.391, -0.032, 0.003]), ([0.1, 2.7, -2.1], [-0.057, -0.025, -0.019])
        options = InverseOptions(starts=1, method="gauss_newton")
        closest = inverse_kinematics(THESIS, target, start=valley, on_failure="closest", options=options)
        many = forward_kinematics_batch(THESIS, *np.split(joint_space(THESIS).sample(16384), 2, axis=1))
        allowed = many.converged & (many.margin >= 0.05)
        away = np.hypot(*many.tip_position[:, :2].T) - np.hypot(*target[:2]), many.tip_position[:, 2] - target[2]
        assert closest.position_error < np.hypot(*away)[allowed].min() < 0.303
        again = inverse_kinematics(THESIS, target, on_failure="closest", options=InverseOptions(starts=24))
        assert again.position_error == pytest.approx(closest.position_error, abs=1e-5)

    @pytest.mark.parametrize("robot", [THESIS, CRL, ETR], ids=lambda robot: robot.name)
    def test_the_closest_pose_is_a_minimum(self, robot: Robot) -> None:
        """No small motion that keeps ranges, order and margin brings the tip closer, by plain forward kinematics."""
        target = 1.6 * next(reachable(robot, 1, seed=8)).tip_position + np.array([10.0, 0.0, 0.0]) * MM
        closest = inverse_kinematics(robot, target, on_failure="closest", options=InverseOptions(starts=4))
        space, random, tried = joint_space(robot), np.random.default_rng(0), 0
        q = space.join(closest.rotations, closest.translations)
        for _ in range(200):
            near = space.nearest(q + random.choice([1e-3, 1e-2, 5e-2]) * random.normal(size=len(q)) * space.scale)
            reached = forward_kinematics(robot, *space.split(near), start=closest.equilibrium)
            if reached.margin < 0.05:
                continue
            tried += 1
            assert np.linalg.norm(reached.tip_position - target) >= closest.position_error - 1e-7
        assert tried >= 50

    def test_the_closest_pose_keeps_order_and_margin(self) -> None:
        inner = Tube(1.0 * MM, 0.7 * MM, 62.6 * MM, 186.2 * MM, 4.24)
        robot = ConcentricRobot([inner, Tube(1.4 * MM, 1.1 * MM, 35.4 * MM, 149.0 * MM, 9.23)])
        for target in ([0.0, 0.0, 0.2], [0.3, 0.2, 0.05]):
            closest = inverse_kinematics(robot, target, on_failure="closest", options=InverseOptions(starts=2))
            assert not closest.reached
            assert closest.margin >= 0.05
            assert inside(robot, closest.rotations, closest.translations, 1e-9)


class TestAllSolutions:
    def test_they_are_distinct_and_all_answers(self) -> None:
        solution = inverse_kinematics(THESIS, TARGET, all_solutions=True, options=InverseOptions(starts=16))
        assert len(solution) >= 2
        for answer in solution:
            check_answer(answer, THESIS)
        middles = [
            np.array([np.interp(0.6, e.arc_length / e.arc_length[-1], e.position[:, k]) for k in range(3)])
            for e in (a.equilibrium for a in solution)
        ]
        assert np.linalg.norm(middles[0] - middles[1]) > 1e-3
        assert [a.margin for a in solution] == sorted((a.margin for a in solution), reverse=True)

    def test_ranked_by_the_reference_where_there_is_one(self) -> None:
        reference = (np.zeros(3), np.zeros(3))
        options = InverseOptions(starts=8)
        solution = inverse_kinematics(THESIS, TARGET, all_solutions=True, reference=reference, options=options)
        distance = [np.sum(a.rotations**2) + np.sum((a.translations / 0.2) ** 2) for a in solution]
        assert distance == sorted(distance)

    def test_a_target_out_of_reach_has_none(self) -> None:
        with pytest.raises(SolveError, match="short"):
            inverse_kinematics(ETR, [0.0, 0.0, 0.2], all_solutions=True, options=InverseOptions(starts=2))


class TestEccentric:
    def test_closed_form_is_exact_for_an_arc(self) -> None:
        """Without torsion, tubes turned alike bend with their own curvature: the arc of the closed form."""
        robot = replace(eccentric_robot(0.05), offset=0.0)
        kappa, length, advance = 1 / 0.12, 0.094, -0.02
        arc = length + advance
        radius, height = (1 - np.cos(kappa * arc)) / kappa, np.sin(kappa * arc) / kappa
        pose = mirror_closed_form(robot, [radius * np.cos(0.7), radius * np.sin(0.7), height])
        assert pose.separation == pytest.approx(0.0, abs=1e-6)
        assert pose.translations == pytest.approx(np.full(3, advance), abs=1e-12)
        tip = forward_kinematics(robot, pose.rotations, pose.translations).tip_position
        np.testing.assert_allclose(tip, [radius * np.cos(0.7), radius * np.sin(0.7), height], atol=1e-9)

    @pytest.mark.parametrize("translation", [-0.03, 0.0, 0.04])
    def test_full_model_gives_back_what_was_put_in(self, translation: float) -> None:
        robot = eccentric_robot(0.05)
        for direction, separation in ((0.4, 0.3), (-2.0, 1.0), (3.0, 1.6)):
            rotations = tubeopt.inverse.mirror.mirror_rotations(direction, separation)
            desired = forward_kinematics(robot, rotations, np.full(3, translation))
            pose = mirror_pose(robot, desired.tip_position)
            np.testing.assert_allclose(pose.equilibrium.tip_position, desired.tip_position, atol=1e-8)
            if translation <= 0:
                assert pose.separation == pytest.approx(separation, abs=1e-5)
                assert np.angle(np.exp(1j * (pose.direction - direction))) == pytest.approx(0.0, abs=1e-5)

    def test_out_of_reach_is_said(self) -> None:
        with pytest.raises(InputError, match="translation"):
            mirror_closed_form(ETR, [0.0, 0.0, 0.2])
        with pytest.raises(InputError, match=r"curvature|off the axis"):
            mirror_closed_form(ETR, [0.05, 0.0, 0.01])


@pytest.mark.usefixtures("own_tables")
class TestStarts:
    def test_the_table_is_kept_on_disk_by_content(self) -> None:
        robot = nested((0.05, 0.06, 10.0), (0.03, 0.04, 8.0))
        space = joint_space(robot)
        first = start_table(space, 64)
        files = set(cache_directory().glob("inverse-*.npz"))
        assert files
        again = start_table(space, 64)
        np.testing.assert_array_equal(first.q, again.q)
        other = joint_space(replace(robot, tubes=(robot.tubes[0], replace(robot.tubes[1], curvature=8.1))))
        start_table(other, 64)
        assert len(set(cache_directory().glob("inverse-*.npz"))) == len(files) + 1

    def test_a_damaged_file_is_built_anew(self) -> None:
        space = joint_space(nested((0.05, 0.06, 9.0), (0.03, 0.04, 8.0)))
        before = set(cache_directory().glob("inverse-*.npz"))
        first = start_table(space, 64)
        (path,) = set(cache_directory().glob("inverse-*.npz")) - before
        path.write_bytes(b"PK\x03\x04 not whole")
        np.testing.assert_array_equal(start_table(space, 64).q, first.q)

    def test_without_a_place_to_keep_it_the_table_still_serves(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        (tmp_path / "file").write_text("in the way")
        monkeypatch.setenv("TUBEOPT_CACHE", str(tmp_path / "file" / "below"))
        assert len(start_table(joint_space(TWO_TUBE), 32).q) > 0

    def test_a_table_for_which_there_is_no_time_is_not_kept(self) -> None:
        space = joint_space(nested((0.05, 0.06, 7.0), (0.03, 0.04, 6.0)))
        before = set(cache_directory().glob("inverse-*.npz"))
        assert not start_table(space, 64, Clock(0.0)).complete
        assert set(cache_directory().glob("inverse-*.npz")) == before
        assert start_table(space, 64, Clock(60.0)).complete

    def test_a_table_goes_on_from_where_time_ran_out(self, monkeypatch: pytest.MonkeyPatch) -> None:
        class Once(Clock):
            """Over after one look."""

            @property
            def over(self) -> bool:
                looked, self.limit = self.limit == 0.0, 0.0
                return looked

        space = joint_space(nested((0.05, 0.06, 7.5), (0.03, 0.04, 6.0)))
        part = start_table(space, 64, Once(60.0))
        assert 0 < part.tried < 64
        solved: list[int] = []
        solve = solved_batch
        monkeypatch.setattr(
            "tubeopt.inverse.multistart.solved_batch",
            lambda r, a, d, **k: (solved.append(len(a)), solve(r, a, d, **k))[1],
        )
        whole = start_table(space, 64)
        assert sum(solved) == 64 - part.tried
        np.testing.assert_array_equal(whole.q, build_table(space, 64).q)

    def test_starts_are_turned_towards_the_target(self) -> None:
        space = joint_space(CRL)
        table = start_table(space, 256)
        for desired in reachable(CRL, 3, seed=6):
            starts = nearest_starts(space, table, (desired.tip_position, None), min_margin=0.05, reference=None)
            assert all(space.admissible(q) for q in starts[:20])
            tips = [forward_kinematics(CRL, *space.split(q)).tip_position for q in starts[:5]]
            flat = np.array(tips)[:, :2]
            azimuth = np.arctan2(*desired.tip_position[1::-1])
            np.testing.assert_allclose(np.exp(1j * np.arctan2(flat[:, 1], flat[:, 0])), np.exp(1j * azimuth), atol=1e-6)


class TestJoints:
    def test_tubes_without_play_are_one_joint(self) -> None:
        space = joint_space(TWO_TUBE)
        assert space.carriages == ((0, 1),)
        assert joint_space(THESIS).carriages == ((0,), (1,), (2,))

    def test_limits_that_contradict_the_order_are_refused(self) -> None:
        limits = JointLimits(((-1, 1),) * 3, ((-0.2, -0.19), (0.1, 0.15), (0.09, 0.1)))
        with pytest.raises(InputError, match="limits allow no joint values with the tube order"):
            inverse_kinematics(THESIS, TARGET, limits=limits)

    def test_gaps_and_section_lengths_are_kept(self) -> None:
        options = InverseOptions(carriage_gap=5 * MM, section_length=8 * MM)
        answer = inverse_kinematics(THESIS, TARGET, options=options)
        held = answer.translations - [t.straight_length for t in THESIS.tubes]
        ends = held + [t.length for t in THESIS.tubes]
        assert (np.diff(held) >= 5 * MM - 1e-9).all()
        assert (-np.diff(ends) >= 8 * MM - 1e-9).all()


def test_starts_that_all_end_far_from_the_target_end_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multistart, "HOPELESS", 3)
    with pytest.raises(SolveError) as caught:
        inverse_kinematics(TWO_TUBE, [0.5, 0.0, 0.05])
    assert caught.value.solution.statistics.tries == 3


class TestInput:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"position": [0, 0]}, "position has 2 numbers"),
            ({"position": [0, 0, np.nan]}, "every number must be finite"),
            ({"direction": [0, 0, 0]}, r"direction is \(0, 0, 0\)"),
            ({"min_margin": 1.0}, "min_margin is 1; it must be at least 0 and less than 1"),
            ({"min_margin": -0.1}, "min_margin is -0.1"),
            ({"start": 3}, "start is 3; it must be a pair"),
            ({"start": ([0, 0], None)}, "rotations of start has 2 numbers"),
            ({"reference": ([0, 0, 0], [1, 1, 1])}, "moves it out of its carriage"),
            ({"robot": None}, "robot is None; it must be a robot"),
            ({"limits": 3}, "limits is 3; it must be a JointLimits"),
            ({"obstacles": Sphere((0, 0, 1), 0.1)}, r"it must be a sequence of bodies, as \[Sphere"),
            ({"obstacles": ["wall"]}, "obstacle 1 is 'wall'; it must be a body"),
            ({"options": {}}, "options is {}; it must be an InverseOptions"),
            ({"weights": [1, 2, 3]}, "weights must be a pair"),
            ({"weights": ([1, 1, -1], [1, 1, 1])}, "weights must be at least 0"),
            ({"on_failure": "ignore"}, "on_failure is 'ignore'; it must be one of raise, closest"),
            ({"limits": JointLimits(((0, 1),), ((0, 1),))}, "limits are given for 1 tubes; the robot has 3"),
            ({"options": InverseOptions(objective="nearest")}, "neither reference nor start is given"),
            ({"options": InverseOptions(direction_weight=1.0)}, "direction_weight is given without a direction"),
        ],
    )
    def test_what_makes_no_sense_is_refused(self, options: dict[str, object], message: str) -> None:
        with pytest.raises(InputError, match=message):
            inverse_kinematics(**({"robot": THESIS, "position": TARGET} | options))  # type: ignore[arg-type]

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"objective": "best"}, "objective is 'best'; it must be one of nearest, margin, curvature"),
            ({"method": "guess"}, "method is 'guess'"),
            ({"clearance": -1.0}, "clearance is -1; it must be at least 0"),
            ({"starts": 0}, "starts is 0; it must be at least 1"),
            ({"starts": "many"}, "starts is 'many'; it must be a whole number"),
            ({"starts": np.nan}, "starts is nan; it must be a whole number"),
            ({"steps": 0}, "steps is 0; it must be at least 1"),
            ({"distinct": 0.0}, "distinct is 0; it must be greater than 0"),
        ],
    )
    def test_options_too(self, options: dict[str, object], message: str) -> None:
        with pytest.raises(InputError, match=message):
            InverseOptions(**options)  # type: ignore[arg-type]

    @pytest.mark.parametrize("size", [1e-200, 1e200])
    def test_directions_have_any_length(self, size: float) -> None:
        np.testing.assert_allclose(unit_vector("direction", [3 * size, 0.0, 4 * size]), [0.6, 0.0, 0.8], rtol=1e-15)

    def test_a_program_needs_as_many_joints_as_equations(self) -> None:
        with pytest.raises(InputError, match="the 3 independent joints"):
            inverse_kinematics(TWO_TUBE, TARGET, direction=[0, 0, 1], options=InverseOptions(method="nlp"))


class TestWays:
    """Whether the robot gets to an answer without a snap is said, and a way is found where it is asked for."""

    def test_a_way_is_followed_without_a_snap(self) -> None:
        """Among random targets are some to which the straight way from home snaps; the way that is found does not."""
        around = 0
        for desired in reachable(THESIS, 6, seed=33):
            answer = inverse_kinematics(THESIS, desired.tip_position, reachable=True)
            assert answer.reachable
            assert answer.path is not None
            assert answer.path.origin == "home"
            path = tubeopt.follow(THESIS, answer.path.rotations, answer.path.translations)
            assert not path.snaps
            assert np.linalg.norm(path.equilibria[-1].tip_position - desired.tip_position) <= 1e-6
            np.testing.assert_array_equal(answer.path.rotations[-1], answer.rotations)
            np.testing.assert_array_equal(answer.path.rotations[0], np.zeros(3))
            home = THESIS.home_translations
            straight = tubeopt.follow(THESIS, [np.zeros(3), answer.rotations], [home, answer.translations])
            around += bool(straight.snaps)
        assert around

    def test_it_begins_at_the_seed(self) -> None:
        seed = forward_kinematics(THESIS, [0.4, 1.0, -0.5], [-0.01, -0.02, -0.015])
        answer = inverse_kinematics(THESIS, TARGET, start=seed, reachable=True)
        assert answer.path is not None
        assert answer.path.origin == "seed"
        np.testing.assert_allclose(answer.path.translations[0], seed.translations, atol=1e-15)
        path = tubeopt.follow(THESIS, answer.path.rotations, answer.path.translations, start=seed)
        assert not path.snaps
        assert np.linalg.norm(path.equilibria[-1].tip_position - TARGET) <= 1e-6

    def test_without_being_asked_only_a_known_way_is_stated(self) -> None:
        for desired in reachable(CRL, 8, seed=33):
            answer = inverse_kinematics(CRL, desired.tip_position)
            assert answer.reachable is (None if answer.path is None else True)
            if answer.path is not None:
                path = tubeopt.follow(CRL, answer.path.rotations, answer.path.translations)
                assert not path.snaps
                assert np.linalg.norm(path.equilibria[-1].tip_position - desired.tip_position) <= 1e-6

    def test_a_loaded_machine_finds_the_same(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """The work is counted, so that a search ends, too, after the same motions while another thread is busy."""
        robot = tubeopt.load_robot("rvim_ctr")
        target = forward_kinematics(robot, np.random.default_rng(1).uniform(-3, 3, (10, robot.n_tubes))[9]).tip_position
        monkeypatch.setattr(joint_path, "PATH_WORK", 0.2)  # the whole search takes 2.4
        ends: list[tuple[int, int]] = []

        def noted(task: Task, *asked: Any, **more: Any) -> PathResult:
            path = find_path(task, *asked, **more)
            ends.append((path.motions, task.work.operations))
            return path

        monkeypatch.setattr(joint_path, "find_path", noted)
        alone = inverse_kinematics(robot, target, reachable=True, options=InverseOptions(time_limit=math.inf))
        stop = threading.Event()

        def disturb() -> None:
            while not stop.wait(1e-4):
                sum(range(10_000))

        other = threading.Thread(target=disturb)
        other.start()
        try:
            again = inverse_kinematics(robot, target, reachable=True, options=InverseOptions(time_limit=math.inf))
        finally:
            stop.set()
            other.join()
        assert ends[0] == ends[1]
        assert ends[0][0] > 100
        assert alone.reachable is again.reachable is False

    def test_where_none_is_found_it_is_said(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("tubeopt.inverse.joint_path.snap_free_path", lambda *_, **__: None)
        for desired in reachable(THESIS, 5, seed=33):
            answer = inverse_kinematics(THESIS, desired.tip_position, reachable=True)
            assert answer.reachable is (answer.path is not None)


def test_an_answer_pickles() -> None:
    answer = inverse_kinematics(THESIS, TARGET)
    again = pickle.loads(pickle.dumps(answer))
    np.testing.assert_array_equal(again.rotations, answer.rotations)
    assert again.status is InverseStatus.REACHED


def test_a_time_limit_ends_the_search() -> None:
    far = [0.0, 0.0, 2.0]
    inverse_kinematics(THESIS, forward_kinematics(THESIS, [0.3, 0.2, 0.1]).tip_position)  # the table is built
    with pytest.raises(SolveError, match=r"target not reached within 0\.001 s") as report:
        inverse_kinematics(THESIS, far, start=([0.0, 0.0, 0.0], None), options=InverseOptions(time_limit=1e-3))
    assert report.value.solution.statistics.tries == 1
    assert report.value.solution.status is InverseStatus.TIMED_OUT
    # Without a single start in time, that is what is said, and not that there is no margin.
    with pytest.raises(SolveError, match=r"within 1e-09 s.*whether the target can be reached is not known") as report:
        inverse_kinematics(THESIS, far, options=InverseOptions(time_limit=1e-9))
    assert "margin" not in str(report.value)
    with pytest.raises(SolveError, match=r"out of reach, 16\d\d mm beyond the longest arm"):
        inverse_kinematics(THESIS, far, options=InverseOptions(starts=1))
    with pytest.raises(InputError, match="time_limit is 0; it must be greater than 0"):
        InverseOptions(time_limit=0)


def test_derivatives_differ_to_either_side_only_where_breakpoints_coincide() -> None:
    """Where one tube ends at the end of another, a descent has a second side to try; elsewhere it has not."""
    corner = tubeopt.load_robot(CONFIGS / "example_equal_ends.yaml")
    space = joint_space(corner)
    for shift, differ in ((0.0, True), (-1e-3, False)):
        d = corner.home_translations + shift * np.arange(corner.n_tubes)[::-1]
        at = posture_of(space, forward_kinematics(corner, corner.home_rotations + [0.3, 1.0, 2.0][: corner.n_tubes], d))
        assert at.two_sided == differ


def test_six_tubes_beside_each_other_are_aimed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(SEGMENTED, tubeopt.SegmentedEccentricRobot)
    robot = replace(SEGMENTED, segments=SEGMENTED.segments[:2], joint_limits=None).bundle()
    if bundle_kernel(6) is None:
        pytest.skip("no compiler")

    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("the general solver takes half a second where ends stay together")

    with monkeypatch.context() as patch:
        patch.setattr("tubeopt.equilibrium.batch.forward_kinematics", never)
        table = build_table(joint_space(robot), 64)
    assert table.complete
    assert 32 < len(table.q) < 64
    for row, tip, margin in zip(table.q[:5], table.tip, table.margin, strict=False):
        joint = joint_space(robot).joint(row)
        pose = forward_kinematics(robot, joint[:6], joint[6:])
        assert np.linalg.norm(pose.tip_position - tip) < 1e-9
        assert pose.margin == pytest.approx(margin, abs=1e-9)
    for turns in ([0.4, 2.0, -1.0, -0.3, 1.0, 2.5], [2.5, 0.3, -2.0, 1.0, -0.4, 0.2]):
        pose = robot.fk(turns, [0.035, 0.035, 0.035, -0.01, -0.01, -0.01])
        answer = robot.ik(pose.tip_position, direction=pose.tip_rotation[:, 2])
        check_answer(answer, robot)
        assert answer.equilibrium.tip_rotation[:, 2] == pytest.approx(pose.tip_rotation[:, 2], abs=1e-7)
