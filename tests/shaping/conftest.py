"""Settings of the tests of this folder."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of a sixteenth of their points, which take half as long."""
    monkeypatch.setattr("tubeopt.show.plots.style.DPI", 50)
