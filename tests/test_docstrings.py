"""The examples in the docstrings of public functions say what is true."""

from __future__ import annotations

import doctest
import inspect
from pathlib import Path

import pytest

import tubeopt

ROOT = Path(__file__).resolve().parents[1]

SHOWN_ELSEWHERE = {
    "follow_the_leader",  # docs/planning.md
    "follow_tip_path",
    "load_problem_solution",  # docs/own-problem.md
    "load_workspace",  # docs/many.md
    "sweep",
    "plan_heating",  # docs/heating.md
    "predict_tube",  # docs/mold.md
    "save_rig",
    "show_in_3d",  # docs/data.md
    "to_dataframe",
    "to_xarray",
}
"""Functions whose examples take longer, or an extra, and stand on a page of the docs or in a notebook."""

FUNCTIONS = [name for name in tubeopt.__all__ if inspect.isfunction(getattr(tubeopt, name))]


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in SHOWN_ELSEWHERE])
def test_the_example_of_a_function_is_true(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    text = inspect.unwrap(getattr(tubeopt, name)).__doc__ or ""
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples
    said: list[str] = []
    assert doctest.DocTestRunner().run(example, out=said.append).failed == 0, "".join(said)
