"""Settings of the tests of this folder."""

from __future__ import annotations

import pytest

from tests.conftest import draw_quickly


@pytest.fixture(autouse=True)
def _small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of a sixteenth of their points."""
    draw_quickly(monkeypatch)
