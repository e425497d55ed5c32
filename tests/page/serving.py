"""The page built into a folder and served as files, for a headless Chromium without a graphics card."""

from __future__ import annotations

import http.server
import importlib.util
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

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


def build(folder: Path) -> None:
    """The page with its kernel into a folder."""
    hook().main(folder)


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Files, without a word for each."""

    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a page in a folder."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/index.html"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
