"""The study of a robot against measured tips, with or without a fit of its parameters."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Literal

from pydantic import Field, PlainValidator, ValidationInfo, model_validator

from ..files.checked import Number, Positive
from ..files.units import DEG, MM, shown, to_si
from ..validation import (
    BasePose,
    Comparison,
    Fit,
    FitOptions,
    Measurements,
    Validation,
    choose_parameters,
    compare_effects,
    fit,
    validate,
)
from .base import Progress, RobotPath, Study, Whole
from .measurement_file import load_measurements


def _load(value: object, info: ValidationInfo) -> Measurements | None:
    if not isinstance(value, str):
        raise ValueError(f"is {shown(value)}; it must be the path of a CSV file, or of YAML")
    robot = info.data.get("robot")
    if robot is None:  # it has problems itself
        return None
    return load_measurements(info.context["directory"] / value if info.context else value, robot)


MeasurementsPath = Annotated[
    Measurements,
    PlainValidator(_load, json_schema_input_type=str),
    Field(description="path of the CSV file of measured tips, or of the YAML that maps one, relative to this file"),
]
"""Measurements of the study's robot, given as the path of their file."""

Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
"""x, y and z."""


class ValidationStudy(Study):
    """How far measured tips are from the model's, and which parameters bring them closest."""

    kind: Literal["validation"]
    robot: RobotPath
    measurements: MeasurementsPath
    registration: Literal["rigid", "base-axis", "none"] = Field(
        "rigid", description="how the device's frame is brought to the plate's"
    )
    base_position_mm: Triple | None = Field(None, description="for base-axis: plate centre in the device's frame")
    base_axis: Triple | None = Field(None, description="for base-axis: the plate's z in the device's frame")
    fit: list[str] = Field(
        [],
        description="parameters to estimate: latency, rotation_all, curvature_2, ...; with compare, the effects to try",
    )
    compare: bool = Field(False, description="add effects in the order in which they pay, until none does")
    folds: Whole | None = Field(
        None, description="of the cross-validation; 0 for none; 5, or 10 with compare, where not given"
    )
    confidence: Positive = Field(Decimal("0.95"), lt=1, description="of the intervals")
    loss: Literal["linear", "huber", "soft_l1"] = Field("linear", description="how a large error counts")
    priors: bool = Field(False, description="draw the parameters to their values in the drawing")
    noise_mm: Positive | None = Field(None, description="of a measured coordinate; estimated where not given")
    axis_noise_deg: Positive | None = Field(None, description="of a measured direction; estimated where not given")

    @model_validator(mode="after")
    def _consistent(self) -> ValidationStudy:
        if self.registration != "base-axis" and (self.base_position_mm or self.base_axis):
            raise ValueError("base_position_mm and base_axis are for registration base-axis only")
        self._base()
        if self.fit and not self.compare:
            choose_parameters(self.robot, self.measurements, self.fit, self.registration)
        return self

    def _base(self) -> BasePose:
        position = tuple(to_si(x, MM) for x in self.base_position_mm or (Decimal(0),) * 3)
        return BasePose(position, tuple(float(x) for x in self.base_axis or (0.0, 0.0, 1.0)))

    def _options(self) -> FitOptions:
        folds = self.folds if self.folds is not None else min(10 if self.compare else 5, len(self.measurements))
        return FitOptions(
            registration=self.registration,
            base=self._base(),
            folds=folds,
            confidence=float(self.confidence),
            loss=self.loss,
            priors=self.priors,
            noise=(
                None if self.noise_mm is None else to_si(self.noise_mm, MM),
                None if self.axis_noise_deg is None else to_si(self.axis_noise_deg, DEG),
            ),
        )

    def run(self, progress: Progress | None = None) -> Validation | Fit | Comparison:
        """The comparison with the model; the fit where parameters are named; or the effects that pay.

        Raises:
            SolveError: a shape is not found; in a fit, none.
        """
        if self.compare:
            return compare_effects(self.robot, self.measurements, self.fit, self._options(), progress=progress)
        if self.fit:
            return fit(self.robot, self.measurements, self.fit, self._options(), progress=progress)
        return validate(self.robot, self.measurements, registration=self.registration, base=self._base())
