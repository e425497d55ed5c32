"""Studies of measurements: validation, calibration, choice of configurations, and force estimation."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from ..errors import InputError
from ..files.checked import Positive, Triple, Whole, in_file
from ..files.field_metadata import Typical
from ..files.fields import keys_from, values
from ..typing import Progress
from ..validation import (
    PER_RECORDING,
    BasePose,
    Comparison,
    Fit,
    FitOptions,
    ForceRecord,
    Measurements,
    Placement,
    Validation,
    choose_parameters,
    compare_effects,
    estimate_forces,
    fit,
    validate,
    where_to_measure,
)
from .measurement_file import load_measurements, load_recordings
from .robot_keys import ExternalLoad, RobotPath
from .study_file import Arguments, Options, Timed, question, rewording

MeasurementsPath = Annotated[
    Measurements,
    in_file(load_measurements, "a CSV file, or of YAML", of="robot"),
    Field(description="path of the CSV file of measured tips, or of a YAML file that maps one, relative to this file"),
]
"""Measurements with the study's robot, given as the path of their file."""

RecordingsPath = Annotated[
    tuple[Measurements, ...],
    in_file(load_recordings, "a CSV file, or of YAML", of="robot"),
    Field(
        description="path of the CSV file of measured tips, of a YAML file that maps one, or of a YAML file that "
        "lists several recordings, relative to this file"
    ),
]
"""One or several recordings with the study's robot, given as the path of their file."""


MeasuredFor = Annotated[
    list[str],
    Field(
        description="parameters to estimate, such as rotation_all or curvature_2; an unknown name prints the list",
        examples=["NAME,.."],
    ),
]

FIT_KEYS = ("per_recording", "folds", "confidence", "noise_mm", "axis_noise_deg", "loss", "priors")
"""Keys that only a fit uses."""

KEYS = {
    r"^(?=(no )?(parameter|effect)s? )": "fit: ",
    # Too few tips, or tips too close to a line, are a property of the file.
    r"^(?=(the tips|the measurements|\d+ measured tips) )": "measurements: ",
}
"""Start of a message of the library -> key that it is about."""


def _valid_folds(folds: int) -> int:
    if folds == 1 or folds < 0:
        raise ValueError(f"is {folds}; it must be 0, or at least 2")
    return folds


@keys_from(FitOptions)
class ValidationStudy(Timed):
    """Errors of the model against measured tips, and fit of its parameters."""

    doing = "solving shapes"

    kind: Literal["validation"]
    robot: RobotPath
    measurements: RecordingsPath
    registration: Literal["rigid", "base-axis", "none", "saved"] | None = Field(
        None,
        description="transformation from device frame to base frame: rigid (fitted), "
        "base-axis, none, or saved (in the robot's calibration). Default: saved "
        "for the calibration recording, otherwise rigid",
    )
    base_position_mm: Triple | None = Field(
        None,
        description="centre of the base plate in the device frame, for base-axis; default 0,0,0",
        examples=["X,Y,Z"],
    )
    base_axis: Triple | None = Field(
        None,
        description="z axis of the base plate in the device frame, for base-axis; default 0,0,1",
        examples=["X,Y,Z"],
    )
    fit: list[str] = Field(
        [],
        description="parameters to estimate, such as rotation_all or curvature_2; default none. With compare, the "
        "effects to try, such as rotation; default all that apply. An unknown name prints the list",
        examples=["NAME,.."],
    )
    compare: bool = Field(
        False, description="add effects one by one, most useful first, until none improves the prediction"
    )
    per_recording: list[Literal["registration", *PER_RECORDING]] = Field(  # type: ignore[valid-type]
        list(FitOptions.per_recording),
        description="effects and registration that every recording has of its own; others are common",
    )
    folds: Annotated[Whole, AfterValidator(_valid_folds)] | None = Field(
        None, description="folds of the cross-validation; 0 for none; default 5, or 10 with compare"
    )
    confidence: Positive = Field(Decimal("0.95"), lt=1, description="confidence level of the intervals, 0 to 1")
    noise_mm: Annotated[Positive | None, Typical(1e-6, 0.02)] = Field(
        None, description="standard deviation of a measured coordinate; default estimated"
    )
    axis_noise_deg: Annotated[Positive | None, Typical(1e-4, 0.5)] = Field(
        None, description="standard deviation of a measured direction; default estimated"
    )

    @model_validator(mode="after")
    def _consistent(self) -> ValidationStudy:
        if self.registration != "base-axis" and (self.base_position_mm or self.base_axis):
            raise ValueError("base_position_mm and base_axis are for registration base-axis only")
        self._base()
        if not (self.fit or self.compare):
            for key in FIT_KEYS:
                # A sweep or a flag may repeat the default.
                if key in self.model_fields_set and getattr(self, key) != type(self).model_fields[key].default:
                    raise ValueError(f"{key} is given without fit or compare; only these use it")
        if self.axis_noise_deg is not None and all(m.orientation is None for m in self.measurements):
            raise ValueError("axis_noise_deg is given, and the measurements have no directions")
        if self.fit and not self.compare:
            with rewording(KEYS):
                # Unknown names are refused here, before minutes of fitting.
                choose_parameters(
                    self.robot, self.measurements, self.fit, self.registration or "rigid", self.per_recording
                )
        return self

    def _base(self) -> BasePose:
        return BasePose(self.si("base_position_mm") or (0.0, 0.0, 0.0), self.si("base_axis") or (0.0, 0.0, 1.0))

    def _options(self) -> FitOptions:
        # There are no more folds than measurements.
        folds = self.folds if self.folds is not None else min(10 if self.compare else 5, *map(len, self.measurements))
        return FitOptions(
            base=self._base(),
            folds=folds,
            noise=tuple(self.in_si("noise_mm", "axis_noise_deg").values()),
            confidence=self.si("confidence"),
            per_recording=tuple(self.per_recording),
            **values(FitOptions, self),
        )

    def run(self, progress: Progress | None = None) -> Validation | Fit | Comparison:
        """Compare with the model, fit parameters, or compare effects.

        Raises:
            SolveError: a shape is not found; in a fit, no shape is found.
        """
        with rewording(KEYS):
            if self.compare:
                return compare_effects(self.robot, self.measurements, self.fit, self._options(), progress=progress)
            if self.fit:
                return fit(self.robot, self.measurements, self.fit, self._options(), progress=progress)
            return validate(self.robot, self.measurements, registration=self.registration, base=self._base())


@question("choosing configurations")
def choose_configurations(
    robot: RobotPath,
    fit: MeasuredFor,
    options: Annotated[Options, Arguments(where_to_measure, "count", "min_margin", "noise", "registration", "seed")],
) -> Placement:
    """Best configurations to measure for estimating parameters, in a sequence without a snap."""
    with rewording(KEYS):
        return where_to_measure(robot, fit, **options)


@question("estimating forces")
def estimate_tip_forces(
    robot: RobotPath,
    measurements: MeasurementsPath,
    load: ExternalLoad,
    options: Annotated[Options, Arguments(estimate_forces, "noise", "registration")],
    progress: Progress | None = None,
) -> ForceRecord:
    """Tip force in every row of a recording of the tip, or of points along the arm."""
    if load is not None and load.frame != "world":
        raise InputError(f"load.frame is {load.frame!r}; it must be 'world': a known load must not turn with the tip")
    with rewording(KEYS):
        return estimate_forces(robot, measurements, known=load, progress=progress, **options)
