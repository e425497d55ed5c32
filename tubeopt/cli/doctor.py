"""`tubeopt doctor`: what is installed, and whether it works."""

from __future__ import annotations

from ..show.doctor import examine
from ..show.reports import report
from .flags import command
from .output import Output, present


@command("tubeopt doctor")
def doctor(output: Output) -> None:
    """Show versions, compiled kernel, threads, cache and extras, and run a timed self-test."""
    present(report(examine()), output)
