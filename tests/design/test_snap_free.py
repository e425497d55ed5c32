"""Designs with a certificate: closed form, an independent optimiser, full turns, boxes of translations."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.design.tasks import THESIS, closed_form, equal_pair, snap_free_thesis, three_tubes, tightest, two_tubes
from tubeopt import (
    DesignTask,
    InputError,
    SolveError,
    certify,
    optimize_design,
    snap_free_certificate,
    worst_certificate,
    worst_margin,
)
from tubeopt.design import DesignSolution, Free, Objective, SnapFree, Strain, count_snaps, pareto_front
from tubeopt.design.program import compile_task
from tubeopt.design.solve import solve
from tubeopt.stability import SnapSearch

CASES = np.random.default_rng(50).uniform((0.05, 0.0, 0.0), (0.3, 0.3, 0.9), (12, 3))


def test_two_equal_tubes_are_as_curved_as_the_closed_form_allows() -> None:
    for overlap, transmission, margin in CASES.tolist():
        program = compile_task(tightest(equal_pair(overlap, transmission), margin))
        solution = solve(program, program.layout.space.start)
        assert solution.x[0] == pytest.approx(closed_form(overlap, transmission, margin), rel=1e-6)


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")  # the closed form bends them beyond nitinol
def test_front_of_two_equal_tubes_is_the_closed_form() -> None:
    front = pareto_front(tightest(equal_pair(0.1, 0.05), 0.05), [0.8, 0.05, 0.4])
    assert [point.margin for point in front.points] == [0.05, 0.4, 0.8]
    for point in front.points:
        assert point.objective == pytest.approx(closed_form(0.1, 0.05, point.margin), rel=1e-6)
        assert snap_free_certificate(point.robot) == pytest.approx(point.margin, abs=1e-6)


@cache
def snap_free() -> DesignSolution:
    return optimize_design(snap_free_thesis(), turns=2)


def test_thesis_robot_becomes_snap_free_with_the_least_change() -> None:
    design = snap_free()
    assert design.certificate >= 0.05 - 1e-6
    assert design.certificate == pytest.approx(snap_free_certificate(design.robot), abs=1e-12)
    assert worst_margin(design.robot).margin >= design.certificate
    # another optimiser, with the gradient of `certify`
    start = np.array([tube.curvature for tube in THESIS.tubes])

    def robot(x: np.ndarray) -> object:
        tubes = tuple(replace(tube, curvature=float(k)) for tube, k in zip(THESIS.tubes, x, strict=True))
        return replace(THESIS, tubes=tubes)

    other = minimize(
        lambda x: float((((x - start) / start) ** 2).sum()),
        0.6 * start,
        jac=lambda x: 2 * (x - start) / start**2,
        constraints={
            "type": "ineq",
            "fun": lambda x: certify(robot(x)).margin - 0.05,  # type: ignore[arg-type]
            "jac": lambda x: certify(robot(x)).gradient["curvature"],  # type: ignore[arg-type]
        },
        method="SLSQP",
        options={"ftol": 1e-12},
    )
    assert design.objective == pytest.approx(other.fun, rel=1e-5)
    assert [tube.curvature for tube in design.robot.tubes] == pytest.approx(other.x, rel=1e-3)


def test_full_turns_snap_the_thesis_robot_and_not_its_design() -> None:
    design = snap_free()
    assert count_snaps(design.robot, 12, seed=3) == (0, 0)
    assert count_snaps(THESIS, 12, seed=3)[1] > 2


def test_prices_are_those_of_differences() -> None:
    task = snap_free_thesis()
    (price,) = snap_free().sensitivities
    values = [
        optimize_design(replace(task, requirements=(SnapFree(0.05 + step),)), turns=1).objective
        for step in (1e-3, -1e-3)
    ]
    assert price.limit.description == "certified margin"
    assert price.derivative == pytest.approx((values[0] - values[1]) / 2e-3, rel=1e-4)
    assert "less certified margin buys" in price.sentence


@pytest.mark.usefixtures("few_places")
def test_box_of_translations_holds_its_worst_case() -> None:
    box = ((-0.03, -0.015, 0.0), (0.0, 0.0, 0.0))
    free = (Free("curvature", (0, 1, 2), 0.5, 30.0),)
    requirements = (SnapFree(0.1, box=box), Strain((0.01,)))
    task = DesignTask(three_tubes(), free, requirements, Objective("tip_curvature"), ordered=False)
    design = optimize_design(task, turns=2)
    assert design.rounds >= 1
    assert worst_certificate(design.robot, *box, effort=SnapSearch(evaluations=300)).certificate.margin >= 0.1 - 1.1e-4
    assert all(tube.straightened_strain <= 0.01 + 1e-9 for tube in design.robot.tubes)
    corners = tuple(product(*(sorted({low, high}) for low, high in zip(*box, strict=True))))
    corners_only = replace(task, requirements=(SnapFree(0.1, corners), Strain((0.01,))))
    assert optimize_design(corners_only, turns=0).objective >= design.objective - 1e-6


@pytest.mark.usefixtures("few_places")
def test_certificate_that_is_told_is_the_least_in_the_box() -> None:
    """Whether it is a limit with room, or what is wanted."""
    low, high = np.array([-0.06, -0.04]), np.array([0.05, 0.05])
    box = (tuple(low.tolist()), tuple(high.tolist()))
    free = (Free("curvature", (0, 1), 6.0, 8.0),)
    inside = low + np.random.default_rng(0).random((60, 2)) * (high - low)
    for requirement, objective in ((SnapFree(-5.0, box=box), "tip_curvature"), (SnapFree(-5.0, box=box), "margin")):
        task = DesignTask(two_tubes(), free, (requirement,), Objective(objective), ordered=False)
        design = optimize_design(task, turns=0)
        smallest = min(snap_free_certificate(design.robot, row) for row in inside)
        assert design.certificate <= smallest + 1e-4
        if objective == "margin":
            assert design.objective <= design.certificate + 1.1e-4


def test_largest_certificate_has_the_least_curvature() -> None:
    task = DesignTask(two_tubes(), (Free("curvature", (0, 1), 5.0, 25.0),), (SnapFree(0.1),), Objective("margin"))
    design = optimize_design(task, turns=1)
    assert design.objective == pytest.approx(design.certificate, abs=1e-6)
    assert [tube.curvature for tube in design.robot.tubes] == pytest.approx([5.0, 5.0], abs=1e-5)
    assert {price.limit.description.split(" of ")[0] for price in design.sensitivities} == {"lower bound"}


def test_diameters_walls_and_several_objectives() -> None:
    from tubeopt.design import Nesting, Wall

    free = (
        Free("curvature", (0, 1), 5.0, 25.0),
        Free("outer_diameter", (0,), 0.9e-3, 1.1e-3),
        Free("inner_diameter", (1,), 1.05e-3, 1.3e-3),
    )
    aims = (Objective("turning_radius", weight=10.0), Objective("strain"))
    task = DesignTask(two_tubes(), free, (SnapFree(0.1), Nesting(0.05e-3), Wall(0.05e-3)), aims)
    design = optimize_design(task, turns=1)
    inner, outer = design.robot.tubes
    assert outer.inner_diameter - inner.outer_diameter >= 0.05e-3 - 1e-9
    assert (outer.outer_diameter - outer.inner_diameter) / 2 >= 0.05e-3 - 1e-9
    assert design.objectives["strain"] == pytest.approx(max(t.straightened_strain for t in (inner, outer)), abs=1e-7)
    assert design.objective == pytest.approx(10 * design.objectives["turning_radius"] + design.objectives["strain"])


def test_scaled_curvatures_follow_the_law_of_squares() -> None:
    task = replace(snap_free_thesis(0.1), free=(Free("curvature", (0, 1, 2), 0.1, 1.0, "scaled"),))
    design = optimize_design(task, turns=1)
    factor = np.sqrt(0.9 / (1 - snap_free_certificate(THESIS)))
    assert design.robot.tubes[0].curvature == pytest.approx(10 * factor, rel=1e-6)


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")
def test_a_design_that_no_force_up_to_a_size_can_snap() -> None:
    task = tightest(equal_pair(0.1, 0.05), 0.3)
    bearing = replace(task, requirements=(SnapFree(0.3, max_force=0.02), *task.requirements[1:]))
    design = optimize_design(bearing, turns=1)
    bears = snap_free_certificate(design.robot, max_force=0.02)
    assert 0.3 <= bears < 0.305
    assert design.certificate > bears
    assert design.verification.checks[-1].satisfied
    assert "up to 20 mN" in design.verification.checks[-1].what
    assert design.task is bearing
    strong = replace(task, requirements=(SnapFree(0.05, max_force=1e3), *task.requirements[1:]))
    with pytest.raises(SolveError, match=r"certified for 1e\+06 mN"):
        optimize_design(strong, turns=0)
    with pytest.raises(InputError, match="max_force and box are both given"):
        SnapFree(0.05, box=((0.0,), (0.1,)), max_force=0.01)
