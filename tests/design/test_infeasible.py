"""Infeasible tasks: the smallest relaxation, in words, verified by applying it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.design.tasks import equal_pair, snap_free_thesis, tightest, two_tubes
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
from tubeopt.design import (
    DesignNotFoundError,
    Free,
    InfeasibleDesignError,
    Length,
    Objective,
    Reach,
    SnapFree,
    Strain,
    Target,
    solve,
)
from tubeopt.design.infeasibility import apply_changes, best_of, shown_infeasible
from tubeopt.design.optimize import DesignStatus
from tubeopt.design.program import Program, compile_task
from tubeopt.design.solve import multistart
from tubeopt.solvers.time_limit import OutOfTimeError, within
from tubeopt.typing import Array


def refused(task: DesignTask, shown: str = "") -> DesignNotFoundError:
    with pytest.raises(DesignNotFoundError) as caught:
        optimize_design(task, turns=1)
    assert isinstance(caught.value, SolveError)
    assert isinstance(caught.value, InfeasibleDesignError) is bool(shown)
    assert ("no design meets all requirements, since " + shown in str(caught.value)) is bool(shown)
    assert ("no design was found" in str(caught.value)) is not bool(shown)
    return caught.value


def test_certificate_falls_to_the_closed_form() -> None:
    pair = equal_pair(0.1, 0.05)
    task = replace(tightest(pair, 0.5), free=(Free("curvature", (0, 1), 15.0, 30.0, "equal"),))
    error = refused(task, "the certified margin is at most")
    best = snap_free_certificate(equal_pair(0.1, 0.05, 15.0))
    change = error.relaxations[0].changes[0]
    assert change.limit.description == "certified margin"
    assert best - 0.03 * abs(best) <= change.value <= best + 1e-6
    assert f"must fall from 0.5 to {change.limit.shown(change.value)}" in str(error)


def test_relaxation_is_enough_and_not_more_than_needed() -> None:
    target = Reach((Target((0.05, -0.06, 0.11)),))
    free = (Free("curvature", (0,), 5.0, 15.0),)
    strain = Strain((0.008,), in_poses=False)
    few = DesignSolver(retries=1, poses=64, iterations=40, orders=2)
    task = DesignTask(two_tubes(), free, (SnapFree(0.1), strain, target), Objective("change"), solver=few)
    error = refused(task)
    path = error.relaxations[0]
    assert path.text in str(error)
    assert path.task == apply_changes(task, path.changes)
    assert optimize_design(path.task, turns=1, start=path.attempt).verification.satisfied
    less = tuple(replace(change, amount=0.5 * change.amount) for change in path.changes)
    assert not multistart(compile_task(apply_changes(task, less)), starts=1).designs


def test_failures_are_counted_by_what_failed() -> None:
    task = DesignTask(
        two_tubes(), (Free("curvature", (0, 1), 15.0, 25.0),), (SnapFree(0.9),), Objective("tip_curvature")
    )
    error = refused(task, "the certified margin is at most")
    assert "of 4 starts, 4 failed most at the certified margin" in str(error)
    error = refused(replace(task, solver=DesignSolver(retries=1)), "the certified margin")
    assert "of 1 starts, 1 failed most at the certified margin" in str(error)
    with pytest.raises(InputError, match="retries is 0; it must be at least 1"):
        DesignSolver(retries=0)


@pytest.mark.parametrize("turn", [0.0, 0.3, 45.0], ids=["across", "between", "diagonal"])
def test_tolerance_rises_to_the_distance_of_the_target(turn: float) -> None:
    """A straight tube stays on the axis of the plate, 5 mm from the target."""
    straight = ConcentricRobot((Tube(1.0 * MM, 0.8 * MM, 0.1, 0.1, 0.0),))
    position = (5 * MM * np.cos(np.radians(turn)), 5 * MM * np.sin(np.radians(turn)), 0.1)
    free = (Free("curved_length", (0,), 0.05, 0.15),)
    few = DesignSolver(retries=1)
    error = refused(DesignTask(straight, free, (Reach((Target(position),)),), Objective("length"), solver=few))
    assert "tolerance of target 1 must rise from 0.1 mm to 5 mm" in str(error)


def test_a_limit_that_bounds_allow_exactly_is_told_as_such() -> None:
    task = DesignTask(
        two_tubes(), (Free("curved_length", (0,), 0.07, 0.1),), (Length("length", 0, 0.15),), Objective("length")
    )
    error = refused(task, "the ranges of the dimensions exclude overall length of tube 1 of at most 150 mm")
    assert "overall length of tube 1 must rise from 150 mm to 190 mm" in str(error)
    assert optimize_design(error.relaxations[0].task).objective == pytest.approx(0.19, abs=1e-8)


QUICK = DesignSolver(retries=1, poses=16)


def drawn(task: DesignTask, count: int = 400) -> list[ConcentricRobot]:
    """Random robots in the ranges of a task."""
    random, space = np.random.default_rng(0), task.space
    rows = space.lower + random.random((count, len(space.lower))) * (space.upper - space.lower)
    results = []
    for row in rows:
        with suppress(InputError):
            results.append(replace(task.robot, tubes=space.tubes(row)))
    return results


def test_what_is_shown_holds_for_every_robot_in_the_ranges() -> None:
    free = (Free("curvature", (0, 1), 5.0, 20.0),)
    task = DesignTask(two_tubes(), free, (SnapFree(0.999),), solver=QUICK)
    text = shown_infeasible(compile_task(task))
    best = max(snap_free_certificate(robot) for robot in drawn(task))
    assert text.startswith("the certified margin is at most")
    bound = float(text.split("at most ")[1].split()[0])
    assert best <= bound <= best + 0.2
    assert not shown_infeasible(compile_task(replace(task, requirements=(SnapFree(bound - 1e-3),))))
    strained = replace(task, requirements=(Strain((0.0025,), in_poses=False),))
    assert "tube 1, if straightened, is strained by at least 0.2506 %" in shown_infeasible(compile_task(strained))
    assert min(robot.tubes[0].straightened_strain for robot in drawn(strained)) >= 0.0025
    assert not shown_infeasible(compile_task(replace(task, requirements=(Strain((0.0045,), in_poses=False),))))


def test_limits_that_exclude_each_other_are_shown_together() -> None:
    free = (Free("straight_length", (0,), 0.05, 0.2), Free("curved_length", (0,), 0.05, 0.2))
    both = (
        Length("length", 0, 0.25),
        Length("straight_length", 0, 0.16, least=True),
        Length("curved_length", 0, 0.1, least=True),
    )
    text = shown_infeasible(compile_task(DesignTask(two_tubes(), free, both, ordered=False)))
    for each in (
        "overall length of tube 1 of at most 250 mm",
        "straight length of tube 1 of at least 160 mm",
        "curved length",
    ):
        assert each in text
    for k in range(3):
        assert not shown_infeasible(
            compile_task(DesignTask(two_tubes(), free, both[:k] + both[k + 1 :], ordered=False))
        )


def test_a_target_beyond_the_longest_tube_is_shown() -> None:
    free = (Free("curved_length", (0,), 0.05, 0.1),)
    reach = Reach((Target((0.0, 0.0, 0.2205)), Target((0.0, 0.0, 0.15))))
    text = shown_infeasible(compile_task(DesignTask(two_tubes(), free, (reach,), solver=QUICK)))
    assert text == "target 1 is 220.5 mm from the plate, and no tube gets longer than 220 mm"
    near = Reach((Target((0.0, 0.0, 0.2199)),))
    assert not shown_infeasible(compile_task(DesignTask(two_tubes(), free, (near,), solver=QUICK)))


def test_a_search_that_time_ends_says_what_it_found() -> None:
    task = snap_free_thesis(0.05)
    whole = optimize_design(task, turns=0)
    assert whole.status is DesignStatus.SATISFIED
    programs = compile_task(task)
    with within(1e-9):
        ranking = multistart(programs, starts=2)
    assert ranking.out_of_time == 2
    assert not ranking.designs
    with pytest.raises(DesignNotFoundError, match="the time limit ended 2 of them"):
        best_of(ranking)
    stopped = replace(whole, out_of_time=True)
    assert stopped.status is DesignStatus.STOPPED
    assert any("time limit" in remark for remark in stopped.remarks)


def test_the_best_on_the_way_is_the_answer_where_time_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time ends after the first feasible point of IPOPT: that design is the answer, and keeps what was asked."""
    task, count = snap_free_thesis(0.05), 0
    plain = solve.evaluate

    def evaluated(program: Program, x: Array) -> Any:
        nonlocal count
        best = program.lately.best
        count += best is not None and best.violation == 0
        if count > 3:
            raise OutOfTimeError
        return plain(program, x)

    monkeypatch.setattr(solve, "evaluate", evaluated)
    ranking = multistart(compile_task(task))
    monkeypatch.undo()
    (result,) = ranking.designs
    assert result.out_of_time
    assert ranking.out_of_time == 1
    assert snap_free_certificate(result.robot) >= 0.05 - 1e-6
