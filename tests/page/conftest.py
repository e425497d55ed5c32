"""The robot in the page: built once, served as files, in a browser."""

from __future__ import annotations

import functools
import http.server
import importlib.util
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.show.viewer.browser import CHROMIUM

ROOT = Path(__file__).resolve().parents[2]

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]


def hook() -> Any:
    """The module `.ci/page.py`."""
    spec = importlib.util.spec_from_file_location("page_hook", ROOT / ".ci" / "page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Files, without a word for each."""

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page with its kernel."""
    pytest.importorskip("ziglang", reason="NOT TESTED: the robot in the page needs ziglang")
    out: Path = tmp_path_factory.mktemp("page")
    hook().main(out)
    return out


@pytest.fixture(scope="session")
def address(folder: Path) -> Iterator[str]:
    """Where the page is served."""
    handler = functools.partial(Quiet, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/index.html"
    server.shutdown()
    server.server_close()
    thread.join()


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
