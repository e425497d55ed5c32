"""Time limits: kept however deep the computation is, and never taken for a failure of a part."""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tubeopt
from tests.examples import THESIS
from tubeopt import InputError, SolveError, design, shaping, validation, workspaces
from tubeopt.errors import TimeLimitError
from tubeopt.solvers.parallel import each
from tubeopt.solvers.time_limit import OutOfTimeError, check_time, limited, time_left, within

TINY = 1e-9
"""s; reached before anything is computed."""

HOME = [0.0, 0.0, 0.0]
APART = [0.0, 2.0, 4.0]

QUESTIONS: dict[str, Callable[[float], Any]] = {
    "find_equilibria": lambda t: tubeopt.find_equilibria(THESIS, APART, time_limit=t),
    "worst_margin": lambda t: tubeopt.worst_margin(THESIS, time_limit=t),
    "worst_certificate": lambda t: tubeopt.worst_certificate(THESIS, time_limit=t),
    "assess_snapping": lambda t: tubeopt.assess_snapping(THESIS, time_limit=t),
    "stability_map": lambda t: tubeopt.stability_map(THESIS, time_limit=t),
    "energy_map": lambda t: tubeopt.energy_map(THESIS, APART, time_limit=t),
    "find_load_limit": lambda t: tubeopt.find_load_limit(THESIS, HOME, None, tubeopt.Load((0, 0, -1)), time_limit=t),
    "find_stroke_force": lambda t: tubeopt.find_stroke_force(THESIS, HOME, time_limit=t),
    "follow": lambda t: tubeopt.follow(THESIS, [HOME, APART], time_limit=t),
    "find_snap": lambda t: tubeopt.find_snap(THESIS, (HOME, None), (APART, None), time_limit=t),
    "trace_branch": lambda t: tubeopt.trace_branch(THESIS, HOME, APART, time_limit=t),
    "workspace": lambda t: tubeopt.workspace(THESIS, 64, time_limit=t),
    "snapping_loss": lambda t: tubeopt.snapping_loss(THESIS, 64, time_limit=t),
    "estimate_force": lambda t: tubeopt.estimate_force(THESIS, HOME, tip_position=(0, -0.1, 0.1), time_limit=t),
    "where_to_measure": lambda t: validation.where_to_measure(THESIS, ["curvature"], 8, time_limit=t),
    "forward_kinematics_batch": lambda t: tubeopt.forward_kinematics_batch(THESIS, [HOME], time_limit=t),
    "plan_heating": lambda t: tubeopt.plan_heating(RIG.tube, RIG, time_limit=t),
    "rank_mold_materials": lambda t: shaping.rank_mold_materials(RIG.tube, rig=RIG, time_limit=t),
    "optimize_design": lambda t: tubeopt.optimize_design(_task(), time_limit=t),
    "pareto_front": lambda t: design.pareto_front(_task(), [0.05], time_limit=t),
    "tolerance_analysis": lambda t: design.tolerance_analysis(
        THESIS,
        design.Tolerances(),
        samples=16,
        time_limit=t,  # type: ignore[arg-type]
    ),
}


RIG: Any = tubeopt.load_rig("configs/rigs/thesis_calcium_silicate.yaml")


def _task() -> tubeopt.DesignTask:
    return tubeopt.DesignTask(THESIS, [design.Free("curvature", (0, 1, 2), 0.5, 15.0)], [design.SnapFree(0.05)])


@pytest.mark.parametrize("name", QUESTIONS)
def test_a_limit_that_is_over_ends_a_question_in_a_sentence(name: str) -> None:
    start_time = time.perf_counter()
    with pytest.raises(TimeLimitError, match=rf"{name} reached its time limit of 1e-09 s.*; increase time_limit"):
        QUESTIONS[name](TINY)
    assert time.perf_counter() - start_time < 10.0
    with pytest.raises(InputError, match="time_limit"):
        QUESTIONS[name](-1.0)


def test_every_question_that_searches_has_a_finite_limit_by_default() -> None:
    for module in (tubeopt, design, validation, workspaces):
        for name in module.__all__:
            function = getattr(module, name)
            limit = inspect.signature(function).parameters.get("time_limit") if inspect.isfunction(function) else None
            assert limit is None or 0 < limit.default < math.inf, name
    assert {name for name in QUESTIONS if hasattr(tubeopt, name)} <= {
        name
        for name in tubeopt.__all__
        if inspect.isfunction(getattr(tubeopt, name))
        and "time_limit" in inspect.signature(getattr(tubeopt, name)).parameters
    }
    assert tubeopt.InverseOptions().time_limit < math.inf
    assert tubeopt.PlanOptions().time_limit < math.inf
    assert tubeopt.Ipopt().time_limit < math.inf


def test_the_nearest_limit_counts_and_ends_who_set_it() -> None:
    @limited
    def inner(*, time_limit: float = 100.0) -> float:
        check_time()
        return time_left()

    @limited
    def outer(*, time_limit: float = 100.0) -> float:
        try:
            return inner()
        except SolveError:  # as of a part that failed: a limit must pass by
            return -1.0

    assert 99 < outer() <= 100
    assert outer(time_limit=5.0) <= 5
    with pytest.raises(TimeLimitError, match="outer reached"):
        outer(time_limit=TINY)
    with within(TINY), pytest.raises(OutOfTimeError):
        inner(time_limit=50.0)
    assert time_left() == math.inf


def _slow(point: Any) -> dict[str, float]:
    time.sleep(0.05)
    return {"y": point["x"]}


def test_a_sweep_keeps_what_was_done_by_its_limit(tmp_path: Path) -> None:
    points = [{"x": float(k)} for k in range(20)]
    with pytest.raises(TimeLimitError, match=r"limit of 0.12 s with \d of 20 points"):
        tubeopt.sweep(_slow, points, tmp_path, fingerprint="slow", workers=1, time_limit=0.12)
    result = tubeopt.sweep(_slow, points, tmp_path, fingerprint="slow", workers=1)
    assert result.computed < 20
    assert len(result.unkept().rows or ()) == 20


def test_workers_keep_the_limit() -> None:
    with pytest.raises(OutOfTimeError), within(0.5):
        list(each(_endless, [1, 2], workers=2))


def _endless(_: int) -> None:
    while True:
        check_time()
        time.sleep(0.01)


def test_ipopt_ends_with_the_limit() -> None:
    problem = tubeopt.Problem()
    x = problem.variable("x", 400, guess=np.linspace(-2, 2, 400))
    problem.minimize(sum((1 - x[i]) ** 2 + 100 * (x[i + 1] - x[i] ** 2) ** 2 for i in range(399)))
    start_time = time.perf_counter()
    with pytest.raises(SolveError, match="ran out of time"):
        problem.solve(tubeopt.Ipopt(time_limit=1e-3))
    assert time.perf_counter() - start_time < 5.0
