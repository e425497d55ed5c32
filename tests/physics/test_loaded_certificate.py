"""The largest eigenvalue under force: against closed forms of columns, and from below by any motion of the tubes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.legendre import Legendre, leggauss
from scipy.linalg import eigh

from tubeopt.physics.certificate import APART, OPPOSED, TURNED, largest_eigenvalue
from tubeopt.typing import Array

Sections = tuple[Array, Array, Array]
Tubes = tuple[Array, Array]


def ritz(force: float, sections: Sections, tubes: Tubes, pairs: tuple[float, float]) -> float:
    """Largest quotient N / T over polynomials, each section its own, continuous Y_i and phi: never above lambda.

    T = sum int kt Y'^2 + K r^2 + sum kt / |beta| Y(0)^2, r = phi' - A . Y, phi(0) = 0, by Gauss points; kt (n,) or
    (n, m).
    """
    (length, stiffness, pull), (kt, held), order = sections, tubes, 8
    n, m = len(kt), len(length)
    kt = kt if kt.ndim == 2 else np.repeat(kt[:, None], m, axis=1)
    node, weight = leggauss(24)
    position, fraction = (node + 1) / 2, weight / 2
    slopes = np.array([Legendre.basis(k, domain=[0, 1])(position) for k in range(order)])
    values = np.array([Legendre.basis(k, domain=[0, 1]).integ(lbnd=0)(position) for k in range(order)])
    ends = np.array([Legendre.basis(k, domain=[0, 1]).integ(lbnd=0)(1.0) for k in range(order)])
    size = n + (n + 1) * m * order  # Y(0), then the slopes of Y_1 ... Y_n, phi on every section
    T, N = np.zeros((size, size)), np.zeros((size, size))
    before = np.zeros((n + 1, size))
    before[:n, :n] = np.eye(n)
    T[:n, :n] = np.diag(kt[:, 0] / held)
    lever = float(length.sum())
    for k in range(m):
        own = [slice(n + (k * (n + 1) + i) * order, n + (k * (n + 1) + i + 1) * order) for i in range(n + 1)]
        A = pull[k] / stiffness[k]
        c = np.outer(pull[k], pull[k]) / stiffness[k] * (1 - np.eye(n))
        for g, (x, w) in enumerate(zip(position, fraction * length[k], strict=True)):
            y, slope = before.copy(), np.zeros((n + 1, size))
            for i in range(n + 1):
                y[i, own[i]] += length[k] * values[:, g]
                slope[i, own[i]] += slopes[:, g]
            bend = slope[n] - A @ y[:n]
            T += w * (slope[:n].T @ np.diag(kt[:, k]) @ slope[:n] + stiffness[k] * np.outer(bend, bend))
            moment = force * (lever - x * length[k])
            form = pairs[0] * np.diag(c.sum(1)) + pairs[1] * c + np.diag(moment * A)
            N += w * (y[:n].T @ form @ y[:n] + 1.5 * force * np.outer(y[n], y[n]))
        for i in range(n + 1):
            before[i, own[i]] += length[k] * ends
        lever -= length[k]
    return float(eigh(N, T, eigvals_only=True)[-1])


@pytest.mark.parametrize("force", [1e-4, 0.02, 1.0, 300.0])
def test_a_straight_rod_has_one_and_a_half_times_the_load_over_eulers(force: float) -> None:
    # N / T = 3/2 F int phi^2 / int K phi'^2, phi(0) = 0: largest for the quarter of a sine.
    K, L = 2e-3, 0.2
    value, tip = largest_eigenvalue(force, (np.array([L]), np.array([K]), np.zeros((1, 1))), (np.ones(1), np.ones(1)))
    assert value == pytest.approx(1.5 * force * (2 * L / np.pi) ** 2 / K, rel=1e-12)
    assert np.abs(tip) == pytest.approx([0, 1], abs=1e-9)


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
def test_two_tubes_turned_against_each_other_have_duponts_threshold(size: float) -> None:
    # Without force lambda = c (1 / kt_1 + 1 / kt_2) / w^2; of tubes that are held at the plate itself w L = pi / 2.
    kt, K, L = np.array([1.5e-3, 1.5e-3]), 3e-3, 0.1
    pull = np.sqrt(size) * np.array([[2e-2, 3e-2]])
    c = pull[0].prod() / K
    value, _ = largest_eigenvalue(0.0, (np.array([L]), np.array([K]), pull), (kt, np.full(2, 1e-12)), TURNED)
    assert value == pytest.approx(2 * c / kt[0] * (2 * L / np.pi) ** 2, rel=1e-9)


@pytest.mark.parametrize(("pairs", "factors"), [(OPPOSED, (1, 1)), (TURNED, (1, -1)), (APART, (0, 0))])
@pytest.mark.parametrize(("force", "seed"), [(0.3, 0), (0.02, 1), (4.0, 2)])
def test_no_motion_has_a_larger_quotient_and_the_best_polynomials_come_to_it(
    pairs: tuple[float, float], factors: tuple[float, float], force: float, seed: int
) -> None:
    """Of sum |c_ij| (Y_i + Y_j)^2, of sum |c_ij| (Y_i - Y_j)^2, and of what the force makes alone."""
    random = np.random.default_rng(seed)
    sections = random.uniform(0.02, 0.06, 2), random.uniform(1e-3, 4e-3, 2), random.uniform(0.005, 0.04, (2, 2))
    kt, held = random.uniform(5e-4, 3e-3, (2, 2)), random.uniform(0.02, 0.1, 2)
    for torsional in (kt[:, 0], kt):
        value, tip = largest_eigenvalue(force, sections, (torsional, held), pairs)
        assert tip[np.argmax(np.abs(tip))] == 1
        assert value == pytest.approx(ritz(force, sections, (torsional, held), factors), rel=1e-9)


@pytest.mark.parametrize(("force", "pairs"), [(0.0, OPPOSED), (0.02, OPPOSED), (1.0, APART)])
def test_an_eigenvalue_does_not_depend_on_where_sections_are_cut(force: float, pairs: tuple[float, float]) -> None:
    """A section that tubes can bend by 16 rad, and the same in 16 sections."""
    stiffness, length, pull = 2e-3, 0.2, np.array([0.1, 0.06])
    tubes = np.full(2, 1e-3), np.full(2, 0.05)
    assert length * pull.sum() / stiffness == pytest.approx(16)
    whole, cut = (
        largest_eigenvalue(force, (np.full(m, length / m), np.full(m, stiffness), np.tile(pull, (m, 1))), tubes, pairs)
        for m in (1, 16)
    )
    assert whole[0] == pytest.approx(cut[0], rel=5e-14)
    assert whole[1] == pytest.approx(cut[1], abs=1e-9)


def test_numbers_that_overflow_leave_no_bound() -> None:
    """Nor does a series that has no finite value."""
    for kt in (1e-300, 0.0):
        sections = np.array([0.1]), np.array([1e-3]), np.full((1, 2), 1e200)
        assert largest_eigenvalue(1.0, sections, (np.full(2, kt), np.full(2, 0.1)))[0] == np.inf
