"""Infeasible tasks: the smallest relaxation, in words, verified by applying it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.design.tasks import equal_pair, tightest, two_tubes
from tubeopt import DesignTask, SolveError, optimize_design, snap_free_certificate
from tubeopt.design import Free, InfeasibleDesignError, Objective, Reach, SnapFree, Strain, Target
from tubeopt.design.multistart import multistart
from tubeopt.design.program import compile_task
from tubeopt.design.relaxation import apply_changes


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
    free = (Free("curvature", (0, 1), 5.0, 15.0),)
    strain = Strain((0.008,), in_poses=False)
    task = DesignTask(two_tubes(), free, (SnapFree(0.1), strain, target), Objective("change"))
    error = refused(task)
    assert error.relaxations
    for way in error.relaxations[:1]:
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
