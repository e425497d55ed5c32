"""The pages in docs/ say what is true: their examples print what they show."""

from __future__ import annotations

import contextlib
import io
import os
import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", re.DOTALL)
PAGES = sorted(page for page in (ROOT / "docs").glob("*.md") if EXAMPLE.search(page.read_text(encoding="utf-8")))


NAMES = re.findall(r"^::: (\S+)$", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("name", NAMES)
def test_the_reference_names_what_there_is(name: str) -> None:
    assert pkgutil.resolve_name(name).__doc__


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_print_what_the_page_shows(page: Path) -> None:
    if page.stem == "data":
        pytest.importorskip("pandas")
        pytest.importorskip("xarray")
    names: dict[str, Any] = {}
    before = Path.cwd()
    os.chdir(ROOT)
    try:
        for example, shown in EXAMPLE.findall(page.read_text(encoding="utf-8")):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(example, names)
            assert printed.getvalue() == shown
    finally:
        os.chdir(before)
