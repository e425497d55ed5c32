"""`tubeopt ik`: the joint values that bring the tip to a target."""

from __future__ import annotations

from ..runs.inverse_study import InverseStudy
from ..show.report import present
from ..show.reports import report
from .flags import ask, asks
from .options import JsonOption, OutOption


@asks(InverseStudy, flags={"start": "--from"})
def ik(study: InverseStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Inverse kinematics: stable joint values that bring the tip to a target, and point it there.

    Ends with 3 where the target, or every one of a table, is missed, with --closest as well; misses within a table are
    named in it. With --follow, targets are put between those of the table where the robot would leap.
    """
    present(report(ask(study, "solving targets", out)), out=out, as_json=as_json)
