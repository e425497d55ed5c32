"""Infeasible tasks: the smallest relaxation, in words, verified by applying it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.design.tasks import equal_pair, tightest, two_tubes
from tests.examples import MM
from tubeopt import (
    ConcentricRobot,
    DesignSolver,
    DesignTask,
    InputError,
    SolveError,
    Tube,
    optimize_design,
    snap_free_certificate,
)
from tubeopt.design import Free, InfeasibleDesignError, Length, Objective, Reach, SnapFree, Strain, Target
from tubeopt.design.program import compile_task
from tubeopt.design.relaxation import apply_changes
from tubeopt.design.settings import OptimumSearch, OrderSearch, RelaxationSearch, StartSearch
from tubeopt.design.solve import multistart


def refused(task: DesignTask) -> InfeasibleDesignError:
    with pytest.raises(InfeasibleDesignError) as caught:
        optimize_design(task, turns=1)
    assert isinstance(caught.value, SolveError)
    return caught.value


def test_certificate_falls_to_the_closed_form() -> None:
    pair = equal_pair(0.1, 0.05)
    task = replace(tightest(pair, 0.5), free=(Free("curvature", (0, 1), 15.0, 30.0, "equal"),))
    error = refused(task)
    best = snap_free_certificate(equal_pair(0.1, 0.05, 15.0))
    change = error.relaxations[0].changes[0]
    assert change.limit.words == "certified margin"
    assert best - 0.03 * abs(best) <= change.value <= best + 1e-6
    assert f"must fall from 0.5 to {change.limit.shown(change.value)}" in str(error)


def test_relaxation_is_enough_and_not_more_than_needed() -> None:
    target = Reach((Target((0.05, -0.06, 0.11)),))
    free = (Free("curvature", (0,), 5.0, 15.0),)
    strain = Strain((0.008,), in_poses=False)
    few = DesignSolver(
        StartSearch(retries=1, restarts=0, poses=64),
        OptimumSearch(iterations=40, ball_iterations=10),
        OrderSearch(most=2),
        relaxation=RelaxationSearch(starts=1),
    )
    task = DesignTask(two_tubes(), free, (SnapFree(0.1), strain, target), Objective("change"), solver=few)
    error = refused(task)
    way = error.relaxations[0]
    assert way.words in str(error)
    assert way.task == apply_changes(task, way.changes)
    assert optimize_design(way.task, turns=1, begin=way.attempt).verification.kept
    less = tuple(replace(change, amount=0.5 * change.amount) for change in way.changes)
    assert not multistart(compile_task(apply_changes(task, less)), starts=1).designs


def test_failures_are_counted_by_what_failed() -> None:
    task = DesignTask(
        two_tubes(), (Free("curvature", (0, 1), 15.0, 25.0),), (SnapFree(0.9),), Objective("tip_curvature")
    )
    error = refused(task)
    assert "of 4 starts, 4 failed most at the certified margin" in str(error)
    error = refused(replace(task, solver=DesignSolver(StartSearch(retries=1))))
    assert "of 1 starts, 1 failed most at the certified margin" in str(error)
    with pytest.raises(InputError, match="retries is 0; it must be at least 1"):
        StartSearch(retries=0)


@pytest.mark.parametrize("turn", [0.0, 0.3, 45.0], ids=["across", "between", "diagonal"])
def test_tolerance_rises_to_the_distance_of_the_target(turn: float) -> None:
    """A straight tube stays on the axis of the plate, 5 mm from the target."""
    straight = ConcentricRobot((Tube(1.0 * MM, 0.8 * MM, 0.1, 0.1, 0.0),))
    place = (5 * MM * np.cos(np.radians(turn)), 5 * MM * np.sin(np.radians(turn)), 0.1)
    free = (Free("curved_length", (0,), 0.05, 0.15),)
    few = DesignSolver(StartSearch(retries=1), relaxation=RelaxationSearch(starts=1))
    error = refused(DesignTask(straight, free, (Reach((Target(place),)),), Objective("length"), solver=few))
    assert "tolerance of target 1 must rise from 0.1 mm to 5 mm" in str(error)


def test_a_limit_that_bounds_allow_exactly_is_told_as_such() -> None:
    task = DesignTask(
        two_tubes(), (Free("curved_length", (0,), 0.07, 0.1),), (Length("length", 0, 0.15),), Objective("length")
    )
    error = refused(task)
    assert "overall length of tube 1 must rise from 150 mm to 190 mm" in str(error)
    assert optimize_design(error.relaxations[0].task).objective == pytest.approx(0.19, abs=1e-8)
