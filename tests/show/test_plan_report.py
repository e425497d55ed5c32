"""What is told of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.examples import THESIS
from tubeopt import Friction, follow, plan_trajectory
from tubeopt.show.plan_report import TrajectoryReport


def test_friction_holds_the_tip_within_what_is_told() -> None:
    rubbing = replace(THESIS, friction=Friction(torque=0.0005))
    home = THESIS.home_translations
    plain, plan = (plan_trajectory(r, ([0, 0, 0], home), ([0.3, 1.2, 0], home)) for r in (THESIS, rubbing))
    told = TrajectoryReport(plan).record()["tip_by_history_mm"]
    assert "tip_by_history_mm" not in TrajectoryReport(plain).record()
    assert plan.proof.least_margin == plain.proof.least_margin
    passed = follow(rubbing, plan.rotations, plan.translations, friction=rubbing.friction)
    off = np.abs([e.tip_position for e in passed.equilibria] - plan.tip_position).max(0) * 1e3
    assert (off <= 1.02 * np.array(told)).all()
    assert off[0] > 0.3 * told[0]
    assert any(row[0] == "friction holds it" and "to first order" in row[1] for row in TrajectoryReport(plan).rows())
