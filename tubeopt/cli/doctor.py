"""`tubeopt doctor`: what is installed, and whether it works."""

from __future__ import annotations

from ..show.doctor import examine
from ..show.reports import report
from .flags import command
from .output import OF_PICTURES, Output, present


@command("tubeopt doctor", without=OF_PICTURES)
def doctor(output: Output) -> None:
    """Show versions, compiled kernel, threads, cache and extras, and run a timed self-test."""
    present(report(examine()), output)
