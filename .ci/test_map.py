#!/usr/bin/env python
"""Which functions of tubeopt each test runs, and how long it takes.

`python .ci/test_map.py OUT.json [ARGUMENTS]` adds to a file what pytest finds with these arguments.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from types import CodeType, FrameType

import pytest

ROOT = Path(__file__).resolve().parents[1]


class Recorder:
    """A plugin of pytest that notes the code that is called while a test runs; nothing where the test fails."""

    def __init__(self, out: Path) -> None:
        self.out, self.saved = out, time.monotonic()
        self.tests: dict[str, tuple[float, list[str]]] = {}
        self.called: set[CodeType] = set()

    def look(self, frame: FrameType, event: str, arg: object) -> None:
        self.called.add(frame.f_code)

    def pytest_runtest_logstart(self) -> None:
        self.called.clear()
        sys.settrace(self.look)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "setup":
            self.tests[report.nodeid] = 0.0, []
        if report.when == "call" and report.passed:
            package = f"{ROOT}/tubeopt/"
            names = {
                f"{code.co_filename.removeprefix(package)}::{code.co_qualname.split('.<locals>')[0]}"
                for code in list(self.called)
                if code.co_filename.startswith(package)
            }
            self.tests[report.nodeid] = round(report.duration, 3), sorted(names)

    def pytest_runtest_logfinish(self) -> None:
        sys.settrace(None)
        if time.monotonic() - self.saved > 60:
            self.save()

    def save(self) -> None:
        """Add to what the file has."""
        self.out.parent.mkdir(parents=True, exist_ok=True)
        before = json.loads(self.out.read_text()) if self.out.exists() else {}
        self.out.write_text(json.dumps({**before, **self.tests}))
        self.saved = time.monotonic()


if __name__ == "__main__":
    recorder = Recorder(Path(sys.argv[1]))
    pytest.main(["-n0", "-q", "-p", "no:cacheprovider", f"--rootdir={ROOT}", *sys.argv[2:]], plugins=[recorder])
    recorder.save()
