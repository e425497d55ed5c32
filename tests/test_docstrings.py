"""The examples in the docstrings of public functions say what is true."""

from __future__ import annotations

import doctest
import inspect
from pathlib import Path

import pytest

import tubeopt

ROOT = Path(__file__).resolve().parents[1]

EXTRAS = {"to_dataframe": "pandas", "to_xarray": "xarray", "show_in_3d": "plotly"}
"""What the examples of some functions need besides."""

FUNCTIONS = [name for name in tubeopt.__all__ if inspect.isfunction(getattr(tubeopt, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_example_of_a_function_is_true(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    if name in EXTRAS:
        pytest.importorskip(EXTRAS[name])
    text = inspect.unwrap(getattr(tubeopt, name)).__doc__ or ""
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples
    output: list[str] = []
    assert doctest.DocTestRunner().run(example, out=output.append).failed == 0, "".join(output)
