"""Settings of the tests of this folder."""

from __future__ import annotations

import pytest

from tests.conftest import lay_out_once

PLACES = (
    "test_pictures_are_whole",
    "test_axes_have_one_scale",
    "test_a_legend_over_what_is_drawn_moves_out_of_the_panel",
    "test_a_legend_on_a_shade_or_in_free_room_stays",
    "test_no_text_overlaps_another_or_is_clipped",
    "test_pictures_of_commands_fit_a_page",
    "test_pictures_of_problems_fit_a_page",
    "test_what_is_crowded_is_relieved",
    "test_panels_stand_below_each_other_where_a_column_is_too_narrow_for_them",
)
"""Tests of where things are in a picture, which is laid out as users have it."""


@pytest.fixture(autouse=True)
def _little_layout(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most tests read what was drawn, wherever it stands."""
    if request.node.name.split("[")[0] not in PLACES:
        lay_out_once(monkeypatch)
