"""Fixtures of the tests of inverse kinematics."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module")
def small_tables(own_tables: None) -> Iterator[None]:
    """Tables of starts of a module's own, with a quarter of the usual configurations."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tubeopt.inverse.table.SIZE", 512)
        yield
