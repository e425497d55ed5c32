"""`tubeopt doctor`: what is installed is told, and what is computed is checked."""

from __future__ import annotations

import pytest

from tests.command_line import Run, answer
from tubeopt.show import command_report


def test_an_installation_that_works(run: Run) -> None:
    result = answer(run("doctor", "--json"))
    assert result["passed"]
    assert 0 < result["difference_mm"] < 1e-6
    assert result["solve_us"] < 1e6  # less than a second on any machine
    assert {"tubeopt", "casadi", "numpy", "scipy"} <= set(result["versions"])


def test_what_an_extra_lacks_is_named(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_report, "EXTRAS", {"view": ("no_such_module",)})
    assert "pip install 'tubeopt[view]'" in " ".join(run("doctor").out.split())


def test_wrong_numbers_end_with_3(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_report, "TOLERANCE", 0.0)
    result = run("doctor")
    assert result.code == 3
    assert "self-test failed" in result.err
