"""Pictures for a column of a page."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt.show.page import WIDTH
from tubeopt.show.plots.style import finish, new_figure


def test_panels_stand_below_each_other_where_a_column_is_too_narrow_for_them() -> None:
    token = WIDTH.set(88e-3)
    try:
        figure = new_figure(9.0, 3.5)
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
        left.plot([0, 1], [0, 1])
        left.set_ylabel("margin")
        finish(figure, None)
    finally:
        WIDTH.reset(token)
    above, below = (np.asarray(axes.get_position()) for axes in (left, right))
    assert above[0, 1] > below[1, 1]  # no row in common
    assert (above[1, 0] - above[0, 0]) == pytest.approx(below[1, 0] - below[0, 0], rel=1e-6)
    assert right.get_ylabel() == "margin"
    assert figure.get_figwidth() == pytest.approx(88 / 25.4)
