"""A rig over time in a user's program, against the simulation, closed forms and the built-in schedule."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import tubeopt
from tubeopt import HeatingBlock, HeatingSpec, InputError, Rig, plan_heating
from tubeopt.constants import ZERO_CELSIUS
from tubeopt.design import CustomObjective, CustomRequirement
from tubeopt.physics.heat_functions import CLAMP, DRAWN
from tubeopt.shaping.heating import optimal_control
from tubeopt.shaping.heating.optimal_schedule import solve_ideal
from tubeopt.shaping.heating.thermal import PROGRAM, thermal_model

from .heating_reference import TUBE, ideal_tube, integrate, thesis_rig, unchecked

SPEC = HeatingSpec(hold_time=10, objective="energy")


def light_clamps(mass: float) -> Rig:
    return replace(thesis_rig(), clamps=replace(thesis_rig().clamps, mass=mass))


def solved(opti: ca.Opti, tolerance: float = 1e-9) -> Any:
    opti.solver("ipopt", HeatingBlock.solver_options(tolerance))
    return opti.solve()


def at_duty(rig: Any, duty: float, heating: float = 20.0, **more: Any) -> tuple[HeatingBlock, Any]:
    """The block at a constant duty, where nothing is free."""
    opti = ca.Opti()
    block = HeatingBlock(opti, rig, tube=more.pop("tube", TUBE), spec=SPEC, duty=duty, heating_time=heating, **more)
    opti.minimize(0)
    return block, solved(opti)


def test_block_agrees_with_an_adaptive_integrator() -> None:
    duty = 0.04
    block, solution = at_duty(thesis_rig(), duty, refinement=2)
    time = solution.value(block.time)
    history = integrate(thermal_model(TUBE, thesis_rig(), PROGRAM), 0.05, np.full(round(time[-1] / 0.05) + 1, duty))
    middle = np.interp(time, history.time, history.tube[:, 0, -1])
    assert middle[-1] > 500
    np.testing.assert_allclose(solution.value(block.temperature(0.0)), middle, atol=0.25)
    clamp = np.interp(time, history.time, history.lumped[:, 0, CLAMP])
    np.testing.assert_allclose(solution.value(block.clamp_temperature), clamp, atol=0.01)
    drawn = np.interp(time[-1], history.time, history.lumped[:, 0, DRAWN])
    assert solution.value(block.energy) == pytest.approx(drawn, rel=1e-3)
    late = solution.value(block.temperature(0.0, 17.3))
    assert late == pytest.approx(np.interp(17.3, history.time, history.tube[:, 0, -1]), abs=0.25)


def test_tube_without_losses_stores_its_joule_heat() -> None:
    """Lumped limit: c T' = r I^2 d, exact for the collocation in every interval."""
    clamps = unchecked(thesis_rig().clamps, contact_conductance=1e-9)
    mold = unchecked(thesis_rig().mold, gap=1e9)
    rig = unchecked(thesis_rig(), clamps=clamps, mold=mold, convection=1e-12)
    tube = ideal_tube(conductivity=1e-9)
    block, solution = at_duty(rig, 0.02, tube=tube)
    square = solution.value(block.integral(block.duty * block.current**2))
    p = block.parameters.properties
    rise = solution.value(p.r_tube / p.c_tube) * square
    assert rise > 200
    assert solution.value(block.temperature(0.0, block.hold_end) - block.T_amb) == pytest.approx(rise, rel=1e-8)


def test_position_is_symmetric_and_linear_between_cells() -> None:
    block, solution = at_duty(thesis_rig(), 0.03)
    places, rows = solution.value(block.places), solution.value(block.tube_temperature)
    for x in (0.5 * (places[-2] + places[-1]), 0.5 * (places[3] + places[4])):
        assert solution.value(block.temperature(x))[-1] == pytest.approx(np.interp(x, places[::-1], rows[::-1, -1]))
        np.testing.assert_array_equal(solution.value(block.temperature(-x)), solution.value(block.temperature(x)))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("clamp_mass", lambda rig, x: replace(rig, clamps=replace(rig.clamps, mass=x * rig.clamps.mass))),
        ("clamp_area", lambda rig, x: replace(rig, clamps=replace(rig.clamps, area=x * rig.clamps.area))),
        ("lead", lambda rig, x: replace(rig, mold=replace(rig.mold, lead=x * rig.mold.lead))),
        ("clearance", lambda rig, x: replace(rig, clamps=replace(rig.clamps, clearance=x * rig.clamps.clearance))),
        ("mold_thickness", lambda rig, x: replace(rig, mold=replace(rig.mold, thickness=x * rig.mold.thickness))),
    ],
)
def test_free_parameter_has_the_effect_of_the_rig(name: str, values: Any) -> None:
    """A parameter fixed by a constraint of the program against a rig that has its value."""
    rig = replace(thesis_rig(), mold=replace(thesis_rig().mold, gap=80e-6))
    changed = values(rig, 1.3)
    own = {"clamp_mass": rig.clamps.mass, "clamp_area": rig.clamps.area, "lead": rig.mold.lead,
           "clearance": rig.clamps.clearance, "mold_thickness": rig.mold.thickness}[name]  # fmt: skip
    opti = ca.Opti()
    factor = opti.variable()
    opti.set_initial(factor, 1.0)
    opti.subject_to(factor == 1.3)
    block = HeatingBlock(opti, rig, tube=TUBE, spec=SPEC, duty=0.03, heating_time=20.0, parameters={name: own * factor})
    opti.minimize(0)
    solution = solved(opti)
    expected, reference = at_duty(changed, 0.03)
    np.testing.assert_allclose(
        solution.value(block.tube_temperature), reference.value(expected.tube_temperature), rtol=2e-4
    )
    assert repr(block.rig_at(solution)) == repr(changed) or name == "clamp_mass"


@pytest.fixture
def tight_program() -> Iterator[None]:
    """The built-in program at the tolerance of the block."""
    loose = optimal_control.IPOPT
    optimal_control.program.cache_clear()
    optimal_control.IPOPT = replace(loose, tolerance=1e-9, constraint_tolerance=1e-9)
    yield
    optimal_control.IPOPT = loose
    optimal_control.program.cache_clear()


@pytest.mark.parametrize("name", ["time", "energy", "margin"])
@pytest.mark.usefixtures("tight_program")
def test_objective_is_that_of_the_built_in_schedule(name: str) -> None:
    spec = replace(SPEC, objective=name)
    ideal = solve_ideal(TUBE, thesis_rig(), spec)
    opti = ca.Opti()
    block = HeatingBlock(opti, thesis_rig(), tube=TUBE, spec=spec)
    margin = opti.variable() if name == "margin" else ca.MX(0.0)
    block.keep_limits(margin)
    opti.minimize(block.objective(name) - margin)
    solution = solved(opti)
    assert solution.value(opti.f) == pytest.approx(ideal.objective, rel=1e-6)
    assert solution.value(block.hold_start) == pytest.approx(ideal.heating, abs=1e-3)


def test_problem_solves_a_block_and_names_its_violations() -> None:
    problem = tubeopt.Problem("rig")
    block = HeatingBlock(problem, thesis_rig(), tube=TUBE, spec=SPEC, heating_time=40.0)
    block.keep_limits()
    problem.minimize(block.objective("energy"))
    settings = block.solver(1e-6)
    solution = problem.solve(settings)
    assert solution.statistics.iterations < 60
    assert float(solution.value(block.hold_temperatures).min()) >= 500 + ZERO_CELSIUS - 1e-3
    problem.subject_to("cold clamp", 299.0 - block.clamp_temperature)
    with pytest.raises(tubeopt.SolveError, match=r"heating: |cold clamp") as failure:
        problem.solve(replace(settings, iterations=20))
    names = {each.name.split(",")[0].split(":")[0] for each in failure.value.solution.violations}
    assert names <= {"heating", "cold clamp"}


def test_plan_of_a_block_is_simulated() -> None:
    opti = ca.Opti()
    block = HeatingBlock(opti, thesis_rig(), tube=TUBE, spec=SPEC)
    block.keep_limits(margin=5.0)
    opti.minimize(block.objective("time"))
    solution = solved(opti, 1e-6)
    plan = block.plan(solution)
    assert plan.hold_start == pytest.approx(solution.value(block.hold_start), abs=SPEC.slot)
    assert plan.energy == pytest.approx(solution.value(block.energy), rel=0.03)


# --- own requirements of a plan ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CoolClamps(CustomRequirement):
    """Clamps below a limit, K."""

    limit: float
    description, unit, is_upper_bound, size = "clamp temperature", "K", True, 10.0

    def expression(self, q: Any) -> Any:
        return self.limit - q.clamp_temperature


@dataclass(frozen=True)
class Energy(CustomObjective):
    """Energy from the battery, with the weights of objective "energy"."""

    description, weight = "energy", 1e-4

    def expression(self, q: Any) -> Any:
        return 5 * q.energy + 100 * q.hold_start


def test_requirement_that_is_satisfied_changes_nothing() -> None:
    terms = optimal_control.CustomTerms((lambda q: (400.0 - q.clamp_temperature) / 100,))
    plain, own = solve_ideal(TUBE, thesis_rig(), SPEC), solve_ideal(TUBE, thesis_rig(), SPEC, custom=terms)
    assert own.objective == pytest.approx(plain.objective, rel=1e-6)


def test_own_objective_equals_the_built_in_one() -> None:
    own = plan_heating(TUBE, thesis_rig(), SPEC, objective=Energy())
    built_in = plan_heating(TUBE, thesis_rig(), SPEC)
    np.testing.assert_array_equal(own.duty, built_in.duty)


def test_clamps_stay_below_their_limit() -> None:
    rig, spec = light_clamps(1.5e-3), HeatingSpec(objective="margin")
    free = plan_heating(TUBE, rig, spec)
    heated = free.time <= free.hold_end
    limit = float(free.clamp_temperature[heated].max()) - 1.5
    plan = plan_heating(TUBE, rig, spec, requirements=[CoolClamps(limit + ZERO_CELSIUS)])
    assert plan.feasible
    assert plan.clamp_temperature[plan.time <= plan.hold_end].max() <= limit + 1e-3
    assert plan.lowest - 500 < free.lowest - 500


def test_dose_of_the_middle_is_reached() -> None:
    def dose(q: Any) -> Any:
        return q.integral(ca.exp(-18000 * (1 / q.temperature(0.0) - 1 / 798.15))) / 60 - 1

    plan = plan_heating(TUBE, thesis_rig(), HeatingSpec(hold_time=30, objective="energy"), requirements=[dose])
    assert plan.feasible
    T = plan.temperature[plan.time <= plan.hold_end, len(plan.position) // 2] + ZERO_CELSIUS
    equivalent = np.trapezoid(np.exp(-18000 * (1 / T - 1 / 798.15)), dx=plan.spec.slot)
    assert 59.5 < equivalent < 66


def test_wrong_arguments_are_refused() -> None:
    opti, wrong = ca.Opti(), 3.0
    with pytest.raises(InputError, match=r"parameters has the key 'leed'.*lead"):
        HeatingBlock(opti, thesis_rig(), tube=TUBE, parameters={"leed": 1.0})
    with pytest.raises(InputError, match=r"duty has 3 entries"):
        HeatingBlock(opti, thesis_rig(), tube=TUBE, duty=[0.1, 0.1, 0.1])
    with pytest.raises(InputError, match=r"tube is missing"):
        HeatingBlock(opti, replace(thesis_rig(), tube=None))
    with pytest.raises(InputError, match=r"requirements has 3\.0"):
        plan_heating(TUBE, thesis_rig(), requirements=[wrong])  # type: ignore[list-item]
