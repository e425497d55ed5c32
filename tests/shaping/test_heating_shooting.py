"""A dense shooting search finds no heating plan where `plan_heating` finds none."""

from __future__ import annotations

import pytest

from benchmarks.heating_shooting import COUNTS, compare, random_case, searched
from tubeopt import plan_heating
from tubeopt.shaping.heating.simulation import resimulate
from tubeopt.shaping.heating.thermal import FINE, thermal_model


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


@pytest.mark.parametrize("number", [41, 163])
def test_counts_too_coarse_for_the_ramp_need_no_program(number: int) -> None:
    """One count alone exceeds the ramp: the window is kept at the rate of one count at rest, the least of all plans."""
    case = random_case(0, number)
    plan = plan_heating(case.tube, case.rig, case.spec, cures=False)
    model = thermal_model(case.tube, case.rig, FINE)
    one = resimulate(model, case.spec.slot, [1 / COUNTS]).within
    assert one is not None
    assert one.rate > case.spec.ramp
    assert not plan.feasible
    assert plan.iterations == 0
    assert plan.shortfall == 0.0
    assert one.rate <= plan.steepest + 1e-6 < 1.01 * one.rate


def test_the_search_finds_what_the_plan_finds() -> None:
    """Otherwise it would prove nothing."""
    case = random_case(0, 44)
    outcome = searched(case)[2]
    assert outcome.feasible
