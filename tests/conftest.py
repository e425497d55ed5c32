"""Settings shared by all tests."""

from __future__ import annotations

import os

# Matrices here are small: BLAS threads only wait for each other, long where every core has a worker.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

from tubeopt.cli import main

from .command_line import COLOUR, Outcome, Run

# A solve that builds its functions first takes seconds, later ones well under a millisecond: a deadline per example
# would only measure the order of the tests.
settings.register_profile("default", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", settings.get_profile("default"), derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the program with these arguments."""
    monkeypatch.setenv("COLUMNS", "80")

    def run_main(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as exit_:
            main(list(arguments))
        out, err = (COLOUR.sub("", stream) for stream in capsys.readouterr())
        assert "Traceback" not in out + err
        code = exit_.value.code
        assert isinstance(code, int)
        return Outcome(code, out, err)

    return run_main
