"""Bounds of the certificate of two tubes made of pieces: how far a margin can bend, and what a mesh leaves out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.examples import nested
from tests.stability.test_pair import Case
from tubeopt import snap_free_certificate
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from tubeopt.stability import certificate
from tubeopt.stability.pair import (
    TOLERANCE,
    Pair,
    _differences,
    farthest_fold,
    least_margin_of_pair,
    margins,
    pair_fold,
    pair_of,
    quotient_curvature_bound,
)
from tubeopt.typing import Array


def lever(coupling: float, reach: float, root: float) -> Pair:
    """Two tubes that are coupled at one point: D = x + reach c sin D, mu = 1 + c root^2 cos D."""
    nothing: Any = None
    one = np.ones((1, 1))
    return Pair(nothing, (0, 1), np.array([coupling]), np.zeros(1), np.zeros(1), reach * one, root * one)


@pytest.mark.parametrize(("coupling", "reach", "root"), [(0.3, 0.0, 1.7), (0.4, 0.8, 1.2), (0.2, 2.5, 0.6)])
def test_no_margin_of_a_pair_bends_more_than_the_bound(coupling: float, reach: float, root: float) -> None:
    pair = lever(coupling, reach, root)
    x = np.linspace(0, 2 * np.pi, 721)
    turn = reach * coupling
    d = np.array([brentq(lambda d, a=a: d - turn * np.sin(d) - a, a - turn - 1, a + turn + 1, xtol=1e-14) for a in x])
    assert margins(pair, x) == pytest.approx(1 + coupling * root**2 * np.cos(d), abs=1e-10)
    # D' = 1 / (1 - turn cos D), and twice by the chain rule.
    slope = 1 / (1 - turn * np.cos(d))
    bend = coupling * root**2 * (-np.cos(d) * slope**2 + np.sin(d) * turn * np.sin(d) * slope**3)
    largest = float(np.abs(bend).max())
    assert largest <= quotient_curvature_bound(pair) * (1 + 1e-12)
    if not reach:
        assert largest == pytest.approx(quotient_curvature_bound(pair), rel=1e-9)


def test_the_least_margin_between_samples_is_bounded_by_the_second_derivative() -> None:
    """mu = 1 + c cos(x + psi), which bends by c at its least value 1 - c, wherever the samples lie."""
    for lag in np.linspace(0, 2 * np.pi / 32, 201):
        pair = replace(lever(0.3, 0.0, 1.7), psi=np.array([lag]))
        smallest = 1 - 0.3 * 1.7**2
        result = least_margin_of_pair(pair)
        assert result.bound <= smallest + 1e-12
        assert result.bound >= smallest - 2 * TOLERANCE * (1 - smallest)


@pytest.mark.parametrize("lead", [1.01, 2.0, 8.0])
def test_a_stable_pair_snaps_within_the_farthest_turn(lead: float) -> None:
    """The joint is at a(x) = x + lead sin x, stable where it grows: the longest way is from one fold to the next."""
    pair = replace(lever(0.5, 0.0, 1.0), lever=np.array([lead / 0.5]))
    fold = np.arccos(-1 / lead)
    true = 2 * (fold + lead * np.sin(fold))
    assert true <= farthest_fold(pair)
    assert farthest_fold(pair) == pytest.approx(2 * np.pi + 1.1 * 2 * lead, rel=1e-3)
    assert lead < 2 or true > 2 * np.pi


def test_a_strong_pair_is_solved_for_each_tip_alone() -> None:
    """D = x + 0.99 sin D, whose iteration has not converged after 60 passes: Newton's method does the rest, on both
    sides of the aligned pose."""
    pair = lever(0.396, 2.5, 0.6)
    for x in np.linspace(-0.01, 0.01, 11):
        d = brentq(lambda d, x=x: d - 0.99 * np.sin(d) - x, -1.0, 1.0, xtol=1e-14)
        assert margins(pair, np.array([x]))[0] == pytest.approx(1 + 0.396 * 0.36 * np.cos(d), abs=1e-10)


def test_what_a_finer_mesh_differs_by_is_taken_off_the_certificate_of_a_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    turned = [(0.05, (15.0, 0.0, 0.0)), (0.05, (0.0, 15.0, 0.0))]
    robot = Case((turned, [(0.09, (12.0, 0.0, 0.0))])).robot
    sharp, worst = snap_free_certificate(robot), certificate.convexity(robot, robot.home_translations)
    assert sharp > worst + 1e-3

    def off(pair: Pair, tips: Array) -> Array:
        return margins(pair, tips) - 5e-4

    monkeypatch.setattr(certificate, "margins", off)
    assert snap_free_certificate(robot) == pytest.approx(sharp - 5e-4, abs=1e-6)


def test_the_bound_of_the_bend_of_a_margin_sums_what_lies_nearer_to_the_tip() -> None:
    """Of three points: P and S of each from those before it, by hand; and no difference bends by more."""
    nothing: Any = None
    coupling, root = np.array([0.3, 0.2, 0.4]), np.diag([0.5, 0.7, 1.1])
    reach = np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [2.0, 1.2, 0.0]])
    pair = Pair(nothing, (0, 1), coupling, np.array([0.1, 1.2, 2.0]), np.zeros(3), reach, root)
    first, second = [1.0], [0.0]
    for i in (1, 2):
        turn = reach[i] * coupling
        first.append(1 + sum(turn[j] * first[j] for j in range(i)))
        second.append(sum(turn[j] * (first[j] ** 2 + second[j]) for j in range(i)))
    each = [c * r**2 * np.hypot(p**2, q) for c, r, p, q in zip(coupling, np.diag(root), first, second, strict=True)]
    assert quotient_curvature_bound(pair) == pytest.approx(max(each))
    x, step = np.linspace(0, 2 * np.pi, 400), 1e-3
    d = [_differences(pair, x + k * step) for k in (-1, 0, 1)]
    assert (np.abs(d[2] - d[0]).max(0) / (2 * step) <= np.array(first) * (1 + 1e-6)).all()
    assert (np.abs(d[2] - 2 * d[1] + d[0]).max(0) / step**2 <= np.array(second) + 1e-5).all()
    # The first point turns with the tips, and what it pulls at the second is most where both are aligned.
    assert np.abs(d[2] - d[0])[:, 1].max() / (2 * step) >= 0.999 * first[1]


def test_a_tube_that_bends_backwards_is_one_turned_by_half_a_turn() -> None:
    plain, back = (nested((0.0, 0.06, 9.0), (0.0, 0.06, sign * 7.0)) for sign in (1, -1))
    pairs = [pair_of(reduced_problem(robot, (0.0, 0.0), DEFAULT_DISCRETISATION)) for robot in (plain, back)]
    one, other = pairs
    assert one is not None
    assert other is not None
    x = np.linspace(0, 2 * np.pi, 17)
    assert margins(other, x) == pytest.approx(margins(one, x + np.pi), abs=1e-9)
    assert np.ptp(margins(one, x)) > 0.1


@pytest.mark.parametrize("margin", [0.02, -0.02])
def test_two_tubes_fold_where_their_opposed_pose_is_not_stable(margin: float) -> None:
    """Alike tubes of length L: the margin of the opposed pose is 1 - (2 omega L / pi)^2."""
    length = 0.08
    inner, outer = nested((0.0, length, 1.0), (0.0, length, 1.0)).tubes
    one, other = inner.bending_stiffness, outer.bending_stiffness
    rate = one * other / (one + other) * (1 / inner.torsional_stiffness + 1 / outer.torsional_stiffness)
    curvature = np.sqrt((1 - margin) / rate) * np.pi / 2 / length
    robot = nested((0.0, length, curvature), (0.0, length, curvature))
    pair = pair_of(reduced_problem(robot, (0.0, 0.0), DEFAULT_DISCRETISATION))
    assert pair is not None
    fold = pair_fold(pair)
    assert (fold is None) == (margin > 0)
    assert fold is None or np.pi < fold.turn < 1.01 * np.pi
