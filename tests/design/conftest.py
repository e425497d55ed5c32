"""Fixtures of the tests of design."""

from __future__ import annotations

from functools import partial

import pytest

from tubeopt import worst_certificate
from tubeopt.stability import SnapSearch


@pytest.fixture
def small_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Maps of margins with four points and snaps in four directions."""
    monkeypatch.setattr("tubeopt.show.design_report.MAP_SAMPLES", 2)
    monkeypatch.setattr("tubeopt.show.design_report.MAP_DIRECTIONS", 4)


@pytest.fixture
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worst of a box of translations is looked for at fewer places than usual before it is found exactly."""
    few = partial(worst_certificate, effort=SnapSearch(evaluations=30))
    monkeypatch.setattr("tubeopt.design.exchange.worst_certificate", few)
