"""Fixtures of the tests of design."""

from __future__ import annotations

from functools import partial

import pytest

from tubeopt import worst_certificate
from tubeopt.stability.settings import SnapSearch


@pytest.fixture
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worst of a box of translations is looked for at fewer places than usual before it is found exactly."""
    few = partial(worst_certificate, effort=SnapSearch(evaluations=60))
    monkeypatch.setattr("tubeopt.design.exchange.worst_certificate", few)
