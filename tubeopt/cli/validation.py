"""`tubeopt validate`: measured tips beside the model's, and the parameters that bring them closest."""

from __future__ import annotations

from ..runs.validation_study import ValidationStudy
from ..show.report import present
from ..show.reports import report
from .flags import ROBOT, ask, asks
from .options import JsonOption, OutOption, PlotOption


@asks(ValidationStudy, arguments={"robot": ROBOT, "measurements": ("MEASURED.csv", "Measured tips.")})
def validate(
    study: ValidationStudy, plot: PlotOption = False, out: OutOption = None, as_json: JsonOption = False
) -> None:
    """Measured tips against the model: errors, residuals, and a calibrated robot."""
    present(report(ask(study, "solving shapes", out)), out=out, as_json=as_json, plot=plot)
