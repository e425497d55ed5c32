"""What slots have left of a tube, along the arm."""

from __future__ import annotations

import pytest

from tests.examples import PIECES, THESIS
from tubeopt.show.surfaces import shade, slotted


def test_a_slotted_piece_is_told_where_it_lies() -> None:
    # 30 mm straight, 10 mm straight behind the transition, then 30 mm with 0.3 of the stiffness.
    result = slotted(PIECES.tubes[2], 0.03, 0.0, 0.04)
    assert result == [(0.0, pytest.approx(0.01), 1.0), (pytest.approx(0.01), pytest.approx(0.04), pytest.approx(0.3))]
    assert slotted(PIECES.tubes[2], 0.03, 0.02, 0.035) == [(0.02, 0.035, pytest.approx(0.3))]


def test_a_whole_tube_is_one_stretch_in_its_colour() -> None:
    assert slotted(THESIS.tubes[0], 0.01, 0.002, 0.05) == [(0.002, 0.05, 1.0)]
    assert shade(1.0) == 1.0
