"""`tubeopt validate` and `tubeopt measure`: measured tips beside the model's, and where to measure."""

from __future__ import annotations

from ..runs.validation_study import MeasureStudy, ValidationStudy
from .flags import ROBOT, answer, asks
from .output import Output


@asks(
    ValidationStudy,
    arguments={"robot": ROBOT, "measurements": ("MEASURED.csv", "Measured tips.")},
    example="tubeopt validate configs/robots/thesis_etr.yaml configs/experiments/synthetic_etr.csv --fit curvature",
)
def validate(study: ValidationStudy, output: Output) -> None:
    """Measured tips against the model: errors, residuals, and a calibrated robot."""
    answer(study, output)


@asks(
    MeasureStudy,
    example="tubeopt measure configs/robots/crl_ctr.yaml --fit rotation_2,rotation_3,curvature_1 --count 12 "
    "--out results",
)
def measure(study: MeasureStudy, output: Output) -> None:
    """Where to measure: configurations that determine parameters best, and a way through them without a snap."""
    answer(study, output)
