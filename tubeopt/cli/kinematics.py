"""`tubeopt fk`: the shape that a robot takes at given joint values."""

from __future__ import annotations

from ..runs.study_file import ForwardKinematicsStudy
from ..show.report import present
from ..show.reports import report
from .flags import asks
from .options import JsonOption, OutOption, PlotOption


@asks(ForwardKinematicsStudy, flags={"tolerance_rad": "--tolerance-rad,--tolerance"})
def fk(
    study: ForwardKinematicsStudy, plot: PlotOption = False, out: OutOption = None, as_json: JsonOption = False
) -> None:
    """Forward kinematics: the stable shape at given joint values, with its margin to snapping."""
    present(report(study.run()), out=out, as_json=as_json, plot=plot)
