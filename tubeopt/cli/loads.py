"""`tubeopt load-limit` and `force`: how much the robot bears, and which force acts on it."""

from __future__ import annotations

from ..runs.load_studies import ForceStudy, LoadLimitStudy
from ..show.report import present
from ..show.reports import report
from .flags import ROBOT, ask, asks
from .options import JsonOption, OutOption


@asks(LoadLimitStudy)
def load_limit(study: LoadLimitStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """How many times a load the robot bears before it snaps or buckles, computed exactly, and where it lands."""
    present(report(ask(study, "putting the load on", out)), out=out, as_json=as_json)


@asks(ForceStudy, arguments={"robot": ROBOT, "measurements": ("MEASURED.csv", "Measured positions of the arm.")})
def force(study: ForceStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """The force on the tip in every row of a recording, how sure it is, and what cannot be told."""
    present(report(ask(study, "estimating forces", out)), out=out, as_json=as_json)
