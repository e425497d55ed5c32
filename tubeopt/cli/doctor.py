"""`tubeopt doctor`: what is installed, and whether it works."""

from __future__ import annotations

from ..errors import SolveError
from ..show.doctor import examine
from ..show.report import present, report
from .options import JsonOption


def doctor(as_json: JsonOption = False) -> None:
    """Versions, compiled kernel, threads, cache, extras, and a self-test with its timing."""
    found = examine()
    present(report(found), out=None, as_json=as_json)
    if not found.test.passed:
        raise SolveError(f"the self-test failed: re-integration moves the tip by {found.test.difference:.1e} m")
