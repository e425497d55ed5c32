"""The program's derivatives against differences; heatings that stall."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.sparse

from tubeopt import HeatingSpec, load_rig, load_robot
from tubeopt.shaping.heating.counts import minimum_time_counts
from tubeopt.shaping.heating.optimal_control import Structure, program
from tubeopt.shaping.heating.optimal_schedule import Ideal, planned_ramp, solve_ideal
from tubeopt.shaping.heating.rig_course import SCALE, TASK, VENTS, rig_parameters
from tubeopt.shaping.heating.thermal import COARSE, PROGRAM, thermal_model
from tubeopt.typing import Array

from .heating_reference import CONFIGS, TUBE, thesis_rig

STEP = 1e-5


@cache
def with_lead(lead: float) -> Ideal:
    """The ideal schedule of the thesis' tube with a lead, m; that of the rig is 20 mm."""
    rig = replace(thesis_rig(), mold=replace(thesis_rig().mold, lead=lead))
    return solve_ideal(TUBE, rig, HeatingSpec(hold_time=10))


def test_derivatives_are_those_of_the_program() -> None:
    generator = np.random.default_rng(5)
    structure = Structure(PROGRAM, soft_limit=True, chosen=("lead", "vents"))
    made = program(structure)
    answer = with_lead(20e-3)
    wishes = generator.uniform(0.5, 2.0, len(TASK))
    p = np.concatenate([rig_parameters(TUBE, thesis_rig(), PROGRAM), wishes])
    x = np.concatenate([answer.x, structure.copies_of(answer.x[-2 - VENTS :])])
    x += 0.05 * generator.standard_normal(x.size)
    way, multipliers = generator.standard_normal(x.size), generator.standard_normal(sum(made.sizes.values()))
    gradient, jacobian, hessian = (made.exact.get_function(name) for name in ("nlp_grad_f", "nlp_jac_g", "nlp_hess_l"))

    def slope(at: Array) -> Array:
        """Of the Lagrangian."""
        return np.asarray(1.3 * gradient(at, p)[1].full().ravel() + jacobian(at, p)[1].sparse().T @ multipliers)

    values = [jacobian(x + sign * STEP * way, p)[0].full().ravel() for sign in (1, -1)]
    np.testing.assert_allclose(
        jacobian(x, p)[1].sparse() @ way, (values[0] - values[1]) / (2 * STEP), rtol=1e-5, atol=1e-5
    )
    upper = hessian(x, p, 1.3, multipliers).sparse()
    whole = upper + scipy.sparse.triu(upper, 1).T
    expected = (slope(x + STEP * way) - slope(x - STEP * way)) / (2 * STEP)
    np.testing.assert_allclose(whole @ way, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("lead", [4e-3, 10e-3])
def test_what_stalls_would_not_get_there_in_five_times_the_time(lead: float) -> None:
    rig = replace(thesis_rig(), mold=replace(thesis_rig().mold, lead=lead))
    model, spec = thermal_model(TUBE, rig, COARSE), HeatingSpec(hold_time=10)
    longer = replace(spec, longest_heating=1800)
    assert (minimum_time_counts(model, spec, rig, 1.0) is None) == (
        minimum_time_counts(model, longer, rig, 1.0) is None
    )


def test_a_lead_that_may_be_longer_is_so_where_its_multiplier_says_it() -> None:
    """That of the lead where it is fixed, against what is chosen where it is free."""
    for lead, gains in ((12e-3, True), (20e-3, False)):
        fixed = with_lead(lead)
        free = HeatingSpec(hold_time=10, free=("lead",), lead_range=(lead, 60e-3))
        chosen = solve_ideal(TUBE, fixed.rig, free, guess=fixed).rig.mold.lead
        assert fixed.longer_lead_helps == (chosen > 1.001 * lead) == gains


def test_time_that_may_be_taken_costs_nothing() -> None:
    """In a mold of steel a short heating and a long one are both optima: the better is told."""
    rig, tube = (
        load_rig(CONFIGS / "rigs" / "thesis_steel.yaml"),
        load_robot(CONFIGS / "robots" / "medlab_ctr.yaml").tubes[1],
    )
    short, whole = (
        solve_ideal(tube, rig, HeatingSpec(slot=0.5, hold_time=30, longest_heating=longest))
        for longest in (60.0, 360.0)
    )
    assert whole.heating > 60
    assert whole.heating / SCALE.duration + whole.miss < short.heating / SCALE.duration + short.miss


def test_the_ramp_is_planned_less_what_the_fine_grid_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.shaping.heating.optimal_schedule.RAMP_RESERVE", 0.5)
    assert planned_ramp(TUBE, thesis_rig(), HeatingSpec(ramp=1000.0), 0.0) == pytest.approx(500.0)
