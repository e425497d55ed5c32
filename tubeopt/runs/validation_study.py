"""The study of a robot against measured tips, with or without a fit of its parameters."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..files.checked import Number, Positive, in_file
from ..files.units import MM, to_si
from ..validation import BasePose, Fit, Measurements, Validation, choose_parameters, fit, validate
from .base import Progress, RobotPath, Study, Whole
from .measurement_file import load_measurements

MeasurementsPath = Annotated[
    Measurements,
    in_file(load_measurements, "a CSV file", of_robot=True),
    Field(description="path of the CSV file of measured tips, relative to this file"),
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
        "rigid", description="how the device's frame is brought to the plate's: rigid, base-axis or none"
    )
    base_position_mm: Triple | None = Field(
        None, description="for base-axis: the plate's centre as the device sees it", examples=["X,Y,Z"]
    )
    base_axis: Triple | None = Field(
        None, description="for base-axis: direction of the plate's z in its frame", examples=["X,Y,Z"]
    )
    fit: list[str] = Field(
        [], description="estimate these: curvature, curvature_2, nu, rotation_1, ...", examples=["NAME,.."]
    )
    folds: Whole = Field(5, description="folds of the cross-validation of a fit; 0 for none")
    confidence: Positive = Field(Decimal("0.95"), lt=1, description="confidence of the intervals")

    @model_validator(mode="after")
    def _consistent(self) -> ValidationStudy:
        if self.registration != "base-axis" and (self.base_position_mm or self.base_axis):
            raise ValueError("base_position_mm and base_axis are for registration base-axis only")
        self._base()
        if self.fit:
            choose_parameters(self.robot, self.measurements, self.fit)
        return self

    def _base(self) -> BasePose:
        position = tuple(to_si(x, MM) for x in self.base_position_mm or (Decimal(0),) * 3)
        return BasePose(position, tuple(float(x) for x in self.base_axis or (0.0, 0.0, 1.0)))

    def run(self, progress: Progress | None = None) -> Validation | Fit:
        """The comparison, or the fit where parameters are named; raises SolveError where a shape is not found."""
        if not self.fit:
            return validate(
                self.robot, self.measurements, registration=self.registration, base=self._base(), progress=progress
            )
        return fit(
            self.robot,
            self.measurements,
            self.fit,
            registration=self.registration,
            base=self._base(),
            folds=self.folds,
            confidence=float(self.confidence),
            progress=progress,
        )
