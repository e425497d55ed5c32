"""A dense shooting search finds no heating plan where `plan_heating` finds none."""

from __future__ import annotations

import pytest

from benchmarks.heating_shooting import compare, random_case, searched
from tubeopt import plan_heating


@pytest.mark.parametrize("number", [14, 50])
def test_counts_of_a_fast_ramp_are_planned_without_the_program(number: int) -> None:
    """Counts used to exceed the ramp by a few thousandths in the check, and the program took ten seconds."""
    case = random_case(0, number)
    plan = plan_heating(case.tube, case.rig, case.spec, cures=False)
    assert plan.feasible
    assert plan.iterations == 0
    assert 0.98 * case.spec.ramp < plan.steepest <= case.spec.ramp


@pytest.mark.parametrize("number", [3, 9, 44])
def test_the_program_plans_what_its_counts_can_follow(number: int) -> None:
    """Plans of least energy that were missed by a hair of the ramp (9, 44), or fell behind by 100 K (3)."""
    found = compare(0, number)
    assert found.plan == "held"
    assert not found.missed


def test_the_search_finds_what_the_plan_finds() -> None:
    """Otherwise it would prove nothing."""
    case = random_case(0, 44)
    outcome = searched(case)[2]
    assert outcome.feasible
