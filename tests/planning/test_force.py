"""Plans and proofs under any force on the tip, against sampled forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.stability.robots import random_robot
from tubeopt import (
    ConcentricRobot,
    InputError,
    Load,
    Piece,
    PlanOptions,
    SolveError,
    Tube,
    deflection_bound,
    forward_kinematics,
    plan_trajectory,
    snap_free_certificate,
    verify_trajectory,
)
from tubeopt.block.transcription.loaded import evaluate
from tubeopt.bodies.obstacles import Sphere
from tubeopt.design.parameters import as_pieces
from tubeopt.equilibrium.problem import loaded_problem
from tubeopt.stability.certificate import arm_sections
from tubeopt.stability.deflection import max_section_force, under_any_force
from tubeopt.typing import Array

FINE = ConcentricRobot((Tube(1e-3, 0.7e-3, 0.05, 0.08, 10.0), Tube(1.6e-3, 1.2e-3, 0.03, 0.05, 8.0)))
"""A robot that forces of some 100 mN cannot snap."""

ASIDE = np.array([0.0, 0.02, 0.0])


def test_what_holds_under_any_force_on_the_tip() -> None:
    """Sampled forces leave the arm in stable equilibria with the margin, and away from the body, that are told."""
    path = np.array([[0.0, 0.0], [-0.02, -0.01]])
    turns = np.array([[0.0, 0.0], [1.5, 1.0]])
    body = Sphere(forward_kinematics(FINE, turns[1], path[1]).tip_position + ASIDE, 5e-3)
    proof = verify_trajectory(
        FINE, [0.0, 1.0], turns, path, max_force=0.02, obstacles=[body], clearance=5e-3, min_margin=0.5
    )
    assert proof.holds
    assert proof.forced is not None
    random, radius = np.random.default_rng(0), FINE.tubes[-1].outer_diameter / 2
    for t in np.linspace(0, 1, 8):
        alpha, shift = turns[0] + t * (turns[1] - turns[0]), path[0] + t * (path[1] - path[0])
        force = random.normal(size=3)
        plain = forward_kinematics(FINE, alpha, shift)
        e = forward_kinematics(FINE, alpha, shift, load=Load(0.02 * force / np.linalg.norm(force)))
        assert e.margin >= proof.least_margin
        assert np.linalg.norm(e.tip_position - plain.tip_position) <= proof.forced.deflection
        assert body.signed_distance(e.position).min() - radius >= proof.least_clearance
    weak = verify_trajectory(FINE, [0.0, 1.0], turns, path, max_force=0.02, min_margin=0.6)
    assert any("of the margin of 0.6 only 0.5" in fault for fault in weak.faults)
    strong = verify_trajectory(FINE, [0.0, 1.0], turns, path, max_force=2.0, obstacles=[body])
    assert any("nothing shows that no force of up to 2000 mN" in fault for fault in strong.faults)
    assert strong.least_clearance == -np.inf


def test_a_plan_under_any_force() -> None:
    rest = PlanOptions(max_force=0.02, clearance=1e-3, objective="none")
    ends = ([0.0, 0.0], [0.0, 0.0]), ([1.5, 1.0], [-0.02, -0.01])
    body = Sphere(forward_kinematics(FINE, *ends[1]).tip_position + ASIDE, 5e-3)
    plan = plan_trajectory(FINE, *ends, obstacles=[body], options=rest)
    assert plan.proved
    assert plan.min_clearance == pytest.approx(1e-3)
    assert plan.proof.least_clearance >= 1e-3
    assert plan.proof.forced is not None
    assert plan.proof.forced.max_force == 0.02
    with pytest.raises(SolveError, match="no plan can be proved: at translations 0, 0 mm the proved margin is"):
        plan_trajectory(FINE, *ends, options=replace(rest, max_force=2.0))


BORNE = Load((0.01, -0.02, 0.0), gravity=(0.0, 3.0, -9.81), distributed=(0.05, 0.0, 0.1))
"""On the tip, by weight, and along the arm."""


def pushes(count: int) -> Array:
    """(count, 3) forces of 1 N to all sides, those along the axes first."""
    rows = np.random.default_rng(4).normal(size=(count - 6, 3))
    return np.concatenate([np.eye(3), -np.eye(3), rows / np.linalg.norm(rows, axis=1)[:, None]])


def test_what_holds_under_any_further_force_beside_a_load() -> None:
    """Of arms that were solved for under the load and a force in many directions."""
    path, turns = np.array([[0.0, 0.0], [-0.02, -0.01]]), np.array([[0.0, 0.0], [1.5, 1.0]])
    body = Sphere(forward_kinematics(FINE, turns[1], path[1], load=BORNE).tip_position + ASIDE, 5e-3)
    requested = {"obstacles": [body], "clearance": 5e-3, "max_force": 0.02}
    proof = verify_trajectory(FINE, [0.0, 1.0], turns, path, load=BORNE, min_margin=0.2, **requested)
    assert proof.holds
    assert proof.forced is not None
    radius = FINE.tubes[-1].outer_diameter / 2
    for t in np.linspace(0, 1, 4):
        joints = turns[0] + t * (turns[1] - turns[0]), path[0] + t * (path[1] - path[0])
        current = forward_kinematics(FINE, *joints, load=BORNE)
        for push in pushes(16):
            further = replace(BORNE, force=tuple(BORNE.force + 0.02 * push))
            e = forward_kinematics(FINE, *joints, load=further)
            assert e.margin >= proof.least_margin
            assert np.linalg.norm(e.tip_position - current.tip_position) <= proof.forced.deflection
            assert body.signed_distance(e.position).min() - radius >= proof.least_clearance
    bare = verify_trajectory(FINE, [0.0, 1.0], turns, path, min_margin=0.2, **requested)
    assert bare.forced is not None
    assert bare.forced.margin > proof.forced.margin + 0.015
    strong = verify_trajectory(FINE, [0.0, 1.0], turns, path, load=BORNE, max_force=2.0)
    assert any("nothing shows that no force of up to 2000 mN" in fault for fault in strong.faults)


def test_no_cross_section_bears_more_than_the_bound() -> None:
    """Its force is that of what lies ahead, integrated here."""
    points = (0.03, (0.0, 0.02, 0.0)), (0.07, (0.01, 0.0, -0.03))
    some = Load((0.01, 0.0, 0.02), gravity=(0.0, 0.0, -9.81), points=points, distributed=((0.01, 0.2, (0.1, 0, 0)),))
    path = np.array([[-0.03, -0.02], [-0.01, 0.0]])
    bound = max_section_force(FINE, path, some)
    s = np.linspace(0.0, 0.07, 7001)
    weight = np.zeros((len(s), 3))
    for tube, end in zip(FINE.tubes, (0.07, 0.05), strict=True):
        area = np.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2)
        assert tube.material.thermal is not None
        weight[:, 2] -= 9.81 * tube.material.thermal.density * area * np.maximum(end - s, 0.0)
    borne = np.array(some.force) + weight + np.outer(np.maximum(0.07 - np.maximum(s, 0.01), 0.0), (0.1, 0.0, 0.0))
    for at, force in points:
        borne = borne + np.outer(s <= at, force)
    assert np.linalg.norm(borne, axis=1).max() <= bound <= 2.5 * np.linalg.norm(borne, axis=1).max()
    # To one side all forces add up, and so does their bound.
    along = Load((0.02, 0, 0), points=((0.02, (0.01, 0, 0)),), distributed=(0.3, 0, 0))
    assert max_section_force(FINE, path, along) == pytest.approx(0.02 + 0.01 + 0.3 * 0.07, rel=1e-12)
    part = Load(distributed=((0.01, 0.2, (0.1, 0, 0)),))
    assert max_section_force(FINE, path, part) == pytest.approx(0.1 * (0.07 - 0.01), rel=1e-12)
    hanging = sum(
        9.81 * np.pi / 4 * (t.outer_diameter**2 - t.inner_diameter**2) * t.material.thermal.density * end
        for t, end in zip(FINE.tubes, (0.07, 0.05), strict=True)
    )
    assert max_section_force(FINE, path, Load(gravity=(0.0, -9.81, 0.0))) == pytest.approx(hanging, rel=1e-12)
    with pytest.raises(InputError, match="of a function are no bound"):
        max_section_force(FINE, path, Load(distributed=lambda s: (s, 0.0, 0.0)))
    with pytest.raises(InputError, match="nothing bounds the margin under further forces"):
        max_section_force(FINE, path, Load(moment=(0.01, 0, 0)))


def test_a_further_force_is_bounded_as_the_sum_with_what_is_borne() -> None:
    """The margin under 20 mN beside 50 mN is that under 70 mN; the tip is moved from where the load has it."""
    path = np.array([[0.0, 0.0], [-0.004, -0.002]])
    result, whole = under_any_force(FINE, path, 0.02, Load((0.0, 0.05, 0.0))), under_any_force(FINE, path, 0.07)
    assert result.margin == whole.margin
    assert result.deflection == pytest.approx(whole.deflection * 2 / 7)
    column = ConcentricRobot((Tube(1e-3, 0.7e-3, 0.0, 0.1, 0.0),))
    buckles = np.pi**2 / 4 * float(column.tubes[0].bending_stiffness) / 0.1**2
    # A column of this length buckles under two thirds at the bound, and at the sum of both forces.
    bound = under_any_force(column, [0.0], 0.3 * buckles, Load((0.0, 0.0, -0.3 * buckles)))
    assert bound.margin == pytest.approx(1 - 1.5 * 0.6, abs=1e-6)
    assert under_any_force(column, [0.0], 0.3 * buckles, Load((0.0, 0.0, -0.4 * buckles))).margin < 0


def test_a_plan_under_a_load_and_any_further_force() -> None:
    rest = PlanOptions(max_force=0.02, clearance=1e-3, objective="none")
    ends = ([0.0, 0.0], [0.0, 0.0]), ([1.5, 1.0], [0.0, 0.0])
    load = Load((0.01, 0.0, 0.0), gravity=(0.0, 0.0, -9.81))
    body = Sphere(forward_kinematics(FINE, *ends[1], load=load).tip_position + ASIDE, 5e-3)
    plan = plan_trajectory(FINE, *ends, obstacles=[body], options=rest, load=load)
    assert plan.proved
    assert plan.proof.forced is not None
    assert plan.proof.least_clearance >= 1e-3 - 1e-9
    for k in range(0, len(plan.time), max(1, len(plan.time) // 4)):
        for push in pushes(10):
            further = replace(load, force=tuple(load.force + 0.02 * push))
            e = forward_kinematics(FINE, plan.rotations[k], plan.translations[k], load=further)
            assert e.margin >= plan.proof.least_margin
            room = body.signed_distance(e.position).min() - FINE.tubes[-1].outer_diameter / 2
            assert room >= plan.proof.least_clearance
    with pytest.raises(SolveError, match="no plan can be proved: at translations 0, 0 mm the proved margin is"):
        plan_trajectory(FINE, *ends, options=replace(rest, max_force=2.0), load=load)


def test_tubes_of_pieces_keep_what_is_shown_under_any_force() -> None:
    """At equilibria and at any shapes; of one piece that is an arc the bound is that of the plain tube."""
    arcs = ConcentricRobot(tuple(map(as_pieces, FINE.tubes)))
    for path in ([[-0.02, -0.01]], [[-0.02, -0.01], [-0.018, -0.01]]):
        plain, same = (under_any_force(robot, path, 0.02) for robot in (FINE, arcs))
        assert same.margin == pytest.approx(plain.margin, abs=1e-9)
        assert same.deflection == pytest.approx(plain.deflection, rel=1e-9)
    soft = {"bending_stiffness": 1.5e-3, "torsional_stiffness": 1.6e-3}
    pieces = [Piece(0.03, lambda s: (4 + 100 * s, 3.0, 5.0)), Piece(0.02, -9.0, **soft)]
    inner = Tube.of_pieces(0.9e-3, 0.6e-3, pieces, straight_length=0.04)
    outer = Tube.of_pieces(1.5e-3, 1.2e-3, [Piece.helix(0.03, 2e-3, 0.05)], straight_length=0.02)
    robot, low, high = ConcentricRobot((inner, outer)), np.array([-0.006, -0.004]), np.array([-0.004, -0.002])
    random, force = np.random.default_rng(3), 0.05
    bundle = arm_sections(robot, low, high)
    for fraction in np.linspace(0, 1, 5):
        arm = robot.assembly(low + fraction * (high - low))
        s = np.linspace(1e-6, arm.total_length - 1e-6, 400)
        reached, k = arm.cross_sections(s, s), np.searchsorted(bundle.start, s) - 1
        assert (reached.stiffness.sum(1) >= bundle.stiffness[k] * (1 - 1e-12)).all()
        assert (reached.moment <= bundle.natural_moment[k] * (1 + 1e-12)).all()
        assert (reached.torsional_stiffness >= bundle.torsional * (1 - 1e-12)).all()
    bound, box = under_any_force(robot, low, force), under_any_force(robot, [low, high], force)
    assert 0 < box.margin < bound.margin < snap_free_certificate(robot, low)
    for push in force * pushes(14):
        alpha, load = random.uniform(-np.pi, np.pi, 2), Load(tuple(push))
        bare, e = (forward_kinematics(robot, alpha, low, load=each) for each in (None, load))
        assert e.margin >= bound.margin
        assert np.linalg.norm(e.tip_position - bare.tip_position) <= bound.deflection
        between = low + random.random(2) * (high - low)
        assert forward_kinematics(robot, alpha, between, load=load).margin >= box.margin
        problem = loaded_problem(robot, tuple(low.tolist()), load)
        shape = evaluate(problem, alpha, 0.1 * random.normal(size=problem.size))
        assert np.linalg.eigvalsh(shape.hessian)[0] >= bound.margin


def test_bounds_for_a_box_of_translations_hold_inside() -> None:
    random = np.random.default_rng(2)
    for n in (2, 3):
        robot = random_robot(random, n, bend=0.5)
        straight, length = (np.array([getattr(t, name) for t in robot.tubes]) for name in ("straight_length", "length"))
        low = np.minimum(straight - random.uniform(0, 0.4, n) * length, straight)
        high = np.minimum(low + random.uniform(0, 0.008, n), straight)
        bound = under_any_force(robot, [low, high], 0.01)
        for _ in range(3):
            shift = random.uniform(low, high)
            assert snap_free_certificate(robot, shift, max_force=0.01) >= bound.margin
            assert deflection_bound(robot, shift, max_force=0.01)[0] <= bound.deflection


@pytest.mark.parametrize(
    "way",
    [
        [[-0.03, -0.03], [0.0, 0.0]],
        [[0.0, 0.0], [-0.03, -0.03]],
        [[-0.001, -0.001], [0.0, 0.0], [-0.001, -0.001]],
        [[-0.03, 0.0], [0.0, 0.0]],
    ],
    ids=["out", "in", "out and in", "one tube"],
)
def test_what_holds_on_a_way_holds_where_it_is_least(way: list[list[float]]) -> None:
    """The longest arm is the softest and the farthest moved, wherever on the way it is."""
    bound = under_any_force(FINE, way, 0.02)
    assert bound.margin <= snap_free_certificate(FINE, [0.0, 0.0], max_force=0.02)
    assert bound.deflection >= deflection_bound(FINE, [0.0, 0.0], max_force=0.02)[0]
