"""What is made: tolerances against what can be computed by hand, stock against enumeration without bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from tests.design.tasks import closed_form, equal_pair, three_tubes, two_tubes
from tubeopt import ConcentricRobot, DesignTask, InputError, Piece, Tube, forward_kinematics, optimize_design
from tubeopt.design import (
    Free,
    Objective,
    SnapFree,
    StockTube,
    Strain,
    Tolerances,
    choose_from_stock,
    tolerance,
    tolerance_analysis,
)
from tubeopt.design.program import compile_task
from tubeopt.design.solve import multistart
from tubeopt.design.stock import combinations, with_sizes
from tubeopt.design.tolerance import sample_tubes
from tubeopt.typing import Array


def test_probability_of_two_tubes_is_that_of_a_product_of_normals() -> None:
    kappa = closed_form(0.1, 0.05, 0.05)
    spread = 0.05
    result = tolerance_analysis(equal_pair(0.1, 0.05, kappa), Tolerances(curvature=spread), samples=2000)
    # snap-free while kappa_1 kappa_2 is below its value at margin 0
    limit = (closed_form(0.1, 0.05, 0.0) / kappa) ** 2
    a = np.linspace(-6, 6, 4001)
    expected = np.trapezoid(norm.pdf(a) * norm.cdf((limit / (1 + spread * a) - 1) / spread), a)
    assert result.interval[0] - 0.01 <= expected <= result.interval[1] + 0.01
    # Wilson (1927): where the share that was seen is just within what 95 % of samples of the normal law would show
    ends = np.array(result.interval)
    assert result.snap_free - ends == pytest.approx(norm.ppf(0.975) * np.sqrt(ends * (1 - ends) / 2000) * [1, -1])


def test_tip_spread_follows_the_derivative_for_small_errors() -> None:
    robot = two_tubes()
    joints = (np.array([0.5, 0.0]), np.array([-0.02, -0.01]))
    result = tolerance_analysis(robot, Tolerances(curvature=1e-4), poses=[joints], samples=400)
    from dataclasses import replace

    tip = forward_kinematics(robot, *joints).tip_position
    total = 0.0
    for i, tube in enumerate(robot.tubes):
        tubes = list(robot.tubes)
        tubes[i] = replace(tube, curvature=tube.curvature * (1 + 1e-5))
        slope = (forward_kinematics(replace(robot, tubes=tuple(tubes)), *joints).tip_position - tip) / 1e-5
        total += float(slope @ slope) * 1e-8
    assert result.spread[0] == pytest.approx(np.sqrt(total), rel=0.1)
    assert result.failed == 0


def test_shares_and_spreads_are_those_of_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 100 certificates from -0.1 to 0.89 ten are below 0 and one is 0; tips are k mm off, and two are lost."""
    taken = 0

    def batch(tubes: Any, robot: Any, translations: Any, poses: Any) -> tuple[Array, Array]:
        nonlocal taken
        if len(tubes) == 1:
            return np.ones(1), np.zeros((1, 2, 3))
        k = taken + np.arange(len(tubes))
        taken += len(tubes)
        tips = np.zeros((len(tubes), 2, 3))
        tips[:, 0, 0] = (k + 1) * 1e-3
        tips[k < 2, 1] = np.nan
        return (k - 10) / 100, tips

    monkeypatch.setattr(tolerance, "_batch", batch)
    joints = np.zeros(2), np.zeros(2)
    result = tolerance_analysis(two_tubes(), Tolerances(), poses=[joints, joints], margin=0.2, samples=100)
    assert (result.snap_free, result.margin_kept, result.failed) == (0.89, 0.7, 2)
    assert result.spread_95 == pytest.approx([95.05e-3, 0.0])
    assert result.spread == pytest.approx([np.sqrt((np.arange(1, 101) ** 2).mean()) * 1e-3, 0.0])


def test_uniform_errors_come_to_their_half_width_and_both_stiffnesses_err_alike() -> None:
    tube = two_tubes().tubes[0]
    errors = Tolerances(curvature=0.01, stiffness=0.02, distribution="uniform")
    made = [tubes[0] for tubes in sample_tubes([tube], errors, 2000)]
    bent, bending, torsional = (
        np.array([getattr(each, name) for each in made]) / getattr(tube, name) - 1
        for name in ("curvature", "bending_stiffness", "torsional_stiffness")
    )
    for off, largest in ((bent, 0.01), (bending, 0.02)):
        assert [off.min(), off.max()] == pytest.approx([-largest, largest], rel=1e-2)
        assert np.abs(off).max() <= largest * (1 + 1e-12)
    assert torsional == pytest.approx(bending, abs=1e-12)


def test_uniform_errors_stay_within_their_half_width() -> None:
    result = tolerance_analysis(equal_pair(0.1, 0.05, 5.0), Tolerances(curvature=0.01, distribution="uniform"))
    high = tolerance_analysis(equal_pair(0.1, 0.05, 5.0 * 1.01), Tolerances(), samples=2).certificate[0]
    low = tolerance_analysis(equal_pair(0.1, 0.05, 5.0 * 0.99), Tolerances(), samples=2).certificate[0]
    assert high <= result.certificate.min() <= result.certificate.max() <= low


def stock() -> list[StockTube]:
    sizes = ((0.5, 0.4), (0.9, 0.7), (1.0, 0.9), (1.2, 1.05), (1.5, 1.2), (1.8, 1.4))
    return [StockTube(f"{od}", od * 1e-3, bore * 1e-3) for od, bore in sizes]


def test_pieces_are_made_as_badly_as_the_tubes_that_they_are() -> None:
    """The same robot, its tubes as two arcs each and with stiffnesses as given, and one whose stretch is known."""
    joints = np.array([0.0, 2.0]), np.array([-0.02, -0.01])
    tolerances = Tolerances(curvature=0.02, stiffness=0.03, straight_length=2e-4, curved_length=5e-4)
    robot = two_tubes()
    halves = tuple(
        Tube.of_pieces(
            tube.outer_diameter,
            tube.inner_diameter,
            [Piece(tube.curved_length / 2, tube.curvature), Piece(tube.curved_length / 2, tube.curvature)],
            straight_length=tube.straight_length,
            bending_stiffness=float(tube.bending_stiffness),
            torsional_stiffness=float(tube.torsional_stiffness),
        )
        for tube in robot.tubes
    )
    plain, general = (
        tolerance_analysis(one, tolerances, poses=[joints], samples=40) for one in (robot, ConcentricRobot(halves))
    )
    assert np.abs(general.certificate - plain.certificate).max() < 1e-6
    assert np.abs(general.tip - plain.tip).max() < 1e-9
    varying = Piece(0.04, lambda s: 10 + 100 * s, bending_stiffness=lambda s: 1e-3 + s)
    tube = Tube.of_pieces(1e-3, 0.7e-3, [varying, Piece(0.04, -5.0)], straight_length=0.05)
    longer = sample_tubes([tube], Tolerances(curved_length=8e-3, stiffness=0.1), 1, seed=1)[0][0]
    grown = longer.curved_length / 0.08
    factor = longer.bending_stiffness / tube.bending_stiffness
    assert abs(grown - 1) > 1e-2
    assert abs(factor - 1) > 1e-2
    assert [piece.length for piece in longer.pieces] == pytest.approx([0.04 * grown] * 2)
    assert longer.pieces[0].precurvature[0](0.03 * grown) == pytest.approx(13.0)
    assert longer.pieces[0].bending_stiffness(0.03 * grown) == pytest.approx(31e-3 * factor)


def test_stock_is_ranked_as_without_bounds() -> None:
    free = (Free("curvature", (0, 1), 0.5, 40.0),)
    task = DesignTask(two_tubes(), free, (SnapFree(0.05), Strain((0.01,))), Objective("tip_curvature"))
    choice = choose_from_stock(task, stock(), clearance=0.05e-3, keep=2)
    values = []
    for sizes in combinations(stock(), 2, 0.05e-3):
        result = multistart(compile_task(with_sizes(task, sizes))).designs[0]
        values.append((-result.objective, tuple(size.name for size in sizes)))
    best = sorted(values, reverse=True)[:2]
    assert len(values) == len(choice.candidates)
    assert choice.count("pruned") > 0
    for (value, names), one in zip(best, choice.candidates, strict=False):
        assert tuple(size.name for size in one.sizes) == names
        assert one.objective == pytest.approx(value, rel=1e-5)
    assert choice.best is choice.candidates[0]


def test_stock_that_does_not_nest_is_refused() -> None:
    task = DesignTask(three_tubes(), (Free("curvature", (0, 1, 2), 0.5, 40.0),), (SnapFree(0.05),))
    with pytest.raises(InputError, match="no 3 tubes in stock nest with a clearance of 5 mm"):
        choose_from_stock(task, stock(), clearance=5e-3)
    with pytest.raises(InputError, match="samples is 1; it must be at least 2"):
        tolerance_analysis(three_tubes(), Tolerances(), samples=1)


def test_starts_on_several_processes_find_the_same() -> None:
    task = DesignTask(
        two_tubes(), (Free("curvature", (0, 1), 1.0, 25.0),), (SnapFree(0.2),), Objective("tip_curvature")
    )
    one, two = (optimize_design(task, starts=4, workers=workers, turns=1) for workers in (1, 2))
    assert one.objective == pytest.approx(two.objective, rel=1e-9)
    assert one.ranking.starts == two.ranking.starts == 4
    assert sum(one.ranking.found) == 4
