"""Plans and proofs under any force on the tip, against sampled forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.stability.robots import random_robot
from tubeopt import (
    ConcentricRobot,
    Load,
    PlanOptions,
    SolveError,
    Tube,
    deflection_bound,
    forward_kinematics,
    plan_trajectory,
    snap_free_certificate,
    verify_trajectory,
)
from tubeopt.bodies.obstacles import Sphere
from tubeopt.stability.deflection import under_any_force

FINE = ConcentricRobot((Tube(1e-3, 0.7e-3, 0.05, 0.08, 10.0), Tube(1.6e-3, 1.2e-3, 0.03, 0.05, 8.0)))
"""A robot that forces of some 100 mN cannot snap."""

ASIDE = np.array([0.0, 0.02, 0.0])


def test_what_holds_under_any_force_on_the_tip() -> None:
    """Sampled forces leave the arm in stable equilibria with the margin, and away from the body, that are told."""
    way = np.array([[0.0, 0.0], [-0.02, -0.01]])
    turns = np.array([[0.0, 0.0], [1.5, 1.0]])
    body = Sphere(forward_kinematics(FINE, turns[1], way[1]).tip_position + ASIDE, 5e-3)
    proof = verify_trajectory(
        FINE, [0.0, 1.0], turns, way, max_force=0.02, obstacles=[body], clearance=5e-3, min_margin=0.5
    )
    assert proof.holds
    assert proof.forced is not None
    random, radius = np.random.default_rng(0), FINE.tubes[-1].outer_diameter / 2
    for t in np.linspace(0, 1, 8):
        alpha, shift = turns[0] + t * (turns[1] - turns[0]), way[0] + t * (way[1] - way[0])
        force = random.normal(size=3)
        plain = forward_kinematics(FINE, alpha, shift)
        e = forward_kinematics(FINE, alpha, shift, load=Load(0.02 * force / np.linalg.norm(force)))
        assert e.margin >= proof.least_margin
        assert np.linalg.norm(e.tip_position - plain.tip_position) <= proof.forced.deflection
        assert body.signed_distance(e.position).min() - radius >= proof.least_clearance
    weak = verify_trajectory(FINE, [0.0, 1.0], turns, way, max_force=0.02, min_margin=0.6)
    assert any("of the margin of 0.6 only 0.5" in fault for fault in weak.faults)
    strong = verify_trajectory(FINE, [0.0, 1.0], turns, way, max_force=2.0, obstacles=[body])
    assert any("nothing shows that no force of up to 2000 mN" in fault for fault in strong.faults)
    assert strong.least_clearance == -np.inf


def test_a_plan_under_any_force() -> None:
    rest = PlanOptions(max_force=0.02, clearance=1e-3, objective="none")
    ends = ([0.0, 0.0], [0.0, 0.0]), ([1.5, 1.0], [-0.02, -0.01])
    body = Sphere(forward_kinematics(FINE, *ends[1]).tip_position + ASIDE, 5e-3)
    found = plan_trajectory(FINE, *ends, obstacles=[body], options=rest)
    assert found.proved
    assert found.min_clearance == pytest.approx(1e-3)
    assert found.proof.least_clearance >= 1e-3
    assert found.proof.forced is not None
    assert found.proof.forced.max_force == 0.02
    with pytest.raises(SolveError, match="no plan can be proved: with translations of 0, 0 mm the margin is only"):
        plan_trajectory(FINE, *ends, options=replace(rest, max_force=2.0))


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
