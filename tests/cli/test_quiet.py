"""Nothing follows an answer, and what is quiet says nothing: in a process of its own, as a shell sees it."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from tests.command_line import ROOT, THESIS
from tubeopt import OrderWarning
from tubeopt.cli.messages import LIBRARY, listening
from tubeopt.solvers.compiled.library import COMPILING


def process(*arguments: str, first: str = "", cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """The program after some Python, which stands for what a command imports."""
    script = f"{first}\nimport sys\nfrom tubeopt.cli import main\nmain(sys.argv[1:])\n"
    command = [sys.executable, "-c", script, *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


def test_no_binding_speaks_after_the_answer() -> None:
    """What of OMPL is left when Python has gone took 28 lines on stderr."""
    pytest.importorskip("ompl")
    done = process("fk", THESIS, first="from ompl import base, geometric, util")
    assert done.returncode == 0
    assert done.stderr == ""


def test_a_plan_by_random_search_is_quiet(tmp_path: Path) -> None:
    pytest.importorskip("ompl")
    plan = f"kind: plan\nrobot: {ROOT}/configs/robots/two_tube.yaml\nstart_deg: [0, 0]\ngoal_deg: [300, 0]\n"
    (tmp_path / "plan.yaml").write_text(f"{plan}method: rrt_connect\nobjective: none\n")
    done = process("plan", str(tmp_path / "plan.yaml"), "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_warnings_of_python_are_one_sentence_or_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with listening(quiet=False):
            warnings.warn("the tubes meet", OrderWarning, stacklevel=1)
            warnings.warn("invalid value encountered in divide", RuntimeWarning, stacklevel=1)
        assert capsys.readouterr().err == "warning: the tubes meet\n"
        with listening(quiet=True):
            warnings.warn("the tubes meet", OrderWarning, stacklevel=1)
        assert capsys.readouterr().err == ""
        with listening(quiet=False):
            LIBRARY.setLevel("DEBUG")
            warnings.warn("invalid value encountered in divide", RuntimeWarning, stacklevel=1)
        assert "RuntimeWarning: invalid value" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("terminal", "quiet", "shown"), [(True, False, True), (False, False, False), (True, True, False)]
)
def test_compilation_is_reported_in_a_terminal(
    terminal: bool, quiet: bool, shown: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with listening(quiet=quiet):
        COMPILING.info("compiling")
    assert ("compiling" in capsys.readouterr().err) == shown
