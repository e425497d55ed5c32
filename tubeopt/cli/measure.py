"""`tubeopt measure`: where to measure, so that parameters of the robot are determined best."""

from __future__ import annotations

from ..runs.measure_study import MeasureStudy
from ..show.report import present
from ..show.reports import report
from .flags import ask, asks
from .options import JsonOption, OutOption


@asks(MeasureStudy)
def measure(study: MeasureStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Where to measure: configurations that determine parameters best, and a way through them without a snap."""
    present(report(ask(study, "choosing configurations", out)), out=out, as_json=as_json)
