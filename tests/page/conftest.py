"""The robot in the page: built once, served as files, in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.show.viewer.browser import CHROMIUM

from .serving import FLAGS, build, served


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page with its kernel."""
    pytest.importorskip("ziglang", reason="NOT TESTED: the robot in the page needs ziglang")
    out: Path = tmp_path_factory.mktemp("page")
    build(out)
    return out


@pytest.fixture(scope="session")
def address(folder: Path) -> Iterator[str]:
    """Where the page is served."""
    with served(folder) as url:
        yield url


@pytest.fixture(scope="session")
def browser(address: str) -> Iterator[Any]:
    """One for all tests."""
    if CHROMIUM is None:
        pytest.skip("NOT TESTED: the robot in the page needs Chromium (apt-get install chromium)")
    api = pytest.importorskip("playwright.sync_api", reason="NOT TESTED: the robot in the page needs playwright")
    with api.sync_playwright() as player:
        browser = player.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()
