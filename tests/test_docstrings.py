"""The examples in the docstrings of public functions say what is true."""

from __future__ import annotations

import doctest
import inspect
from pathlib import Path

import pytest

import tubeopt

ROOT = Path(__file__).resolve().parents[1]

PAGES = [*(ROOT / "docs").glob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")]

EXTRAS = {"to_dataframe": "pandas", "to_xarray": "xarray", "show_in_3d": "plotly"}
"""What the examples of some functions need besides."""

LONG = {"estimate_forces", "sweep"}
"""Functions of files and processes, whose examples are their tests and the pages on the commands."""

FUNCTIONS = [name for name in tubeopt.__all__ if inspect.isfunction(getattr(tubeopt, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_example_of_a_function_is_true(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes long has its example on a page, whose examples are run as well."""
    monkeypatch.chdir(ROOT)
    if name in EXTRAS:
        pytest.importorskip(EXTRAS[name])
    text = inspect.unwrap(getattr(tubeopt, name)).__doc__ or ""
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    if not example.examples:
        assert name in LONG or any(f"{name}(" in page.read_text(encoding="utf-8") for page in PAGES)
    said: list[str] = []
    assert doctest.DocTestRunner().run(example, out=said.append).failed == 0, "".join(said)
