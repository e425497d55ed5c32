"""What is told of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import Friction, Load, follow, inverse_kinematics, plan_trajectory
from tubeopt.show.inverse_report import SOLUTION
from tubeopt.show.plan_report import TrajectoryReport
from tubeopt.show.quantities import record, rows


def test_friction_holds_the_tip_within_what_is_told() -> None:
    rubbing = replace(THESIS, friction=Friction(torque=0.0005))
    home = THESIS.home_translations
    plain, plan = (plan_trajectory(r, ([0, 0, 0], home), ([0.3, 1.2, 0], home)) for r in (THESIS, rubbing))
    report = TrajectoryReport(plan).record()["tip_by_history_mm"]
    assert "tip_by_history_mm" not in TrajectoryReport(plain).record()
    smallest = min(e.snap_distance for e in plain.arms)
    assert TrajectoryReport(plain).record()["least_snap_distance_deg"] == pytest.approx(np.degrees(smallest), rel=2e-6)
    assert any(
        row[0] == "snap distance" and row[1].startswith(f"at least {np.degrees(smallest):.1f} deg at every sample")
        for row in TrajectoryReport(plain).rows()
    )
    assert plan.proof.least_margin == plain.proof.least_margin
    passed = follow(rubbing, plan.rotations, plan.translations, friction=rubbing.friction)
    off = np.abs([e.tip_position for e in passed.equilibria] - plan.tip_position).max(0) * 1e3
    assert (off <= 1.02 * np.array(report)).all()
    assert off[0] > 0.3 * report[0]
    assert any(row[0] == "effect of friction" and "to first order" in row[1] for row in TrajectoryReport(plan).rows())


def test_inverse_kinematics_reports_the_snap_distance() -> None:
    target = [0.02, 0.01, 0.15]
    solution = inverse_kinematics(THESIS, target)
    shown = np.degrees(solution.equilibrium.snap_distance)
    assert record(solution, SOLUTION)["snap_distance_deg"] == pytest.approx(shown)
    assert any(
        name == "snap distance" and f"at least {shown:.1f} deg" in text for name, text in rows(solution, SOLUTION)
    )
    pushed = inverse_kinematics(THESIS, target, load=Load((0.0, 1e-3, 0.0)))
    assert 0 < record(pushed, SOLUTION)["snap_distance_deg"] < 1.1 * shown
    turned = inverse_kinematics(THESIS, target, load=Load(moment=(0.0, 1e-4, 0.0)))
    assert "snap_distance_deg" not in record(turned, SOLUTION)
    assert all(name != "snap distance" for name, _ in rows(turned, SOLUTION))
