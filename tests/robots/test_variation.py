"""Bounds of what varies along a tube, of polynomials that attain them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import chebyshev

from tubeopt import Piece, Tube
from tubeopt.robots.lengthwise import BEYOND, _bound, variation
from tubeopt.typing import Array


def derivatives(coefficients: Array, x: float, half: float) -> Array:
    """(4,) of a polynomial by arc length, at x of -1 to 1."""
    orders = [chebyshev.chebder(coefficients, k) / half**k if k else coefficients for k in range(4)]
    return np.array([chebyshev.chebval(x, each) for each in orders])


def test_bounds_of_what_varies_are_attained_where_all_terms_add_up() -> None:
    """T_k is 1 at 1, and 1 or -1 at -1, its derivatives likewise: odd polynomials have their largest derivatives at
    both ends, and are least at -1. There 1 / kt changes most, by the derivatives of a quotient."""
    half = 0.02
    kb, kt = np.array([5.0, 0.9, 0.0, 0.4]), np.array([3.0, 0.5, 0.0, 0.6])
    x, z = np.array([2.0, 0.3, 0.5, 0.2]), np.array([1.0, 0.7, 0.4, 0.1])
    result = _bound(np.array([kb, kt, x, 0.75 * x, z]), half)
    low, high = (np.array([derivatives(each, end, half) for each in (kb, kt)]) for end in (-1, 1))
    assert result[:4] == pytest.approx([low[0, 0], *np.abs(low[0, 1:])])
    v, d, dd, ddd = low[1]
    eased = [-d / v**2, 2 * d**2 / v**3 - dd / v**2, -6 * d**3 / v**4 + 6 * d * dd / v**3 - ddd / v**2]
    assert result[4:8] == pytest.approx([v, *np.abs(eased)])
    assert result[8:12] == pytest.approx(1.25 * derivatives(chebyshev.chebmul(kb, x), 1, half))
    assert result[12:15] == pytest.approx(derivatives(z, 1, half)[:3])
    assert result[15:] == pytest.approx(high[:, 0])


def test_bounds_of_cells_hold_a_little_beyond_them_and_behind_the_end() -> None:
    """Of a stiffness that grows linearly, in cells and in a piece of 0.1 mm; behind the end kt is what it was. A tube
    of fewer cells is filled up with its last."""
    long, short, straight, start = 0.03, 1e-4, 0.04, 1e-3

    def kt(s: float) -> float:
        return start * (1 + 60 * s)

    pieces = Piece(long, 8.0, torsional_stiffness=kt), Piece(short, 8.0, torsional_stiffness=lambda s: 2 * kt(s))
    varying = Tube.of_pieces(1.0e-3, 0.8e-3, pieces, straight_length=straight)
    even = Tube(1.4e-3, 1.2e-3, straight, long, 4.0)
    result = variation((varying, even))
    cells = result.cuts[0] - straight
    inner = np.flatnonzero((cells > 1e-9) & (cells < long - 1e-9))
    assert len(inner) > 1
    # Cell k + 1 begins at cut k.
    assert result.torsional[0, inner + 1] == pytest.approx([kt(s - BEYOND) for s in cells[inner]], rel=1e-10)
    assert result.stiffest[1, 0, inner] == pytest.approx([kt(s + BEYOND) for s in cells[inner]], rel=1e-10)
    assert result.torsional[0, -2] == pytest.approx(2 * start, rel=1e-6)
    assert result.torsional[:, -1] == pytest.approx(result.torsional[:, -2])
    assert not any(result.__dict__[name][..., -1].any() for name in ("bending", "compliance", "moment", "twist"))
    assert (np.diff(result.cuts[1])[1:] == 0).all()
    assert result.moment[0, 1, 1:-1] == pytest.approx(even.bending_stiffness * even.curvature)
