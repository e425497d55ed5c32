"""Plans with an own cost on the path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import InputError, PlanOptions, Trajectory, plan_trajectory
from tubeopt.design import CustomObjective, Quantities

START = ([0.0, 0.0, 0.0], [-0.05, -0.03, 0.0])
GOAL = ([1.5, -0.5, 1.0], [-0.02, -0.01, 0.0])


@dataclass(frozen=True)
class Height(CustomObjective):
    """Height of the tip, m."""

    weight: float = 1.0
    what: str = "tip_position"
    description, unit, factor = "height of the tip", "mm", 1e3

    def expression(self, q: Quantities) -> Any:
        part = getattr(q.poses[0], self.what)
        return part[2] if part.numel() > 1 else part


def planned(cost: CustomObjective | None) -> tuple[Trajectory, float]:
    """A plan, and the mean height of its tip over time."""
    plan = plan_trajectory(THESIS, START, GOAL, options=PlanOptions(extra_cost=cost))
    assert plan.proved
    return plan, float(np.trapezoid(plan.tip_position[:, 2], plan.time) / plan.time[-1])


def test_own_cost_is_traded_for_length() -> None:
    """Of two weights each has the plan of less total cost; what is gained is paid in length."""
    results = [(weight, *planned(Height(weight) if weight else None)) for weight in (0.0, 10.0)]
    lengths = [trajectory.statistics.length for _, trajectory, _ in results]
    heights = [height for *_, height in results]
    assert heights[1] < heights[0] - 0.01
    assert lengths[0] < lengths[1] < 1.1 * lengths[0]
    squares = np.square(lengths) / lengths[0] ** 2
    assert squares[1] + 10.0 * heights[1] < squares[0] + 10.0 * heights[0]


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(InputError, match="the cost height of the tip uses margin; on a path it may use"):
        planned(Height(what="margin"))
    with pytest.raises(InputError, match="extra_cost is 3; it must be a CustomObjective"):
        PlanOptions(extra_cost=3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="objective is 'none'"):
        PlanOptions(objective="none", extra_cost=Height())
