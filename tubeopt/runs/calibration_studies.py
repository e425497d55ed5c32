"""Studies of a workshop: what a rig and the spring-back of tubes are, from logs and trials."""

from __future__ import annotations

import functools
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..files.checked import NotNegative, Number, Positive, in_file
from ..shaping.heating.calibration import BIAS, FACTORS, RigFit, calibrate
from ..shaping.heating.logged import HeatingLog
from ..shaping.mold.springback import Calibration, calibrate_springback
from ..typing import Array, Progress
from .heating_study import TubeOnRig
from .mold_file import Trials, load_trials
from .rig_file import load_camera, load_heating_log
from .study_file import Arguments, Options, question

CameraView = tuple[Array, Array, Array]
"""Times, places and temperatures that a camera saw."""


TrialsPath = Annotated[
    Trials,
    in_file(load_trials, "a CSV file"),
    Field(description="path of a CSV file with the columns mold_radius_mm and obtained_radius_mm"),
]


class HeatingCalibrationStudy(TubeOnRig):
    """Heat loss and contacts of a rig, from a heating log."""

    doing = "calibrating the rig"

    kind: Literal["heating_calibration"]
    log: Annotated[Path, in_file(Path, "a CSV file")] = Field(
        description="path of a CSV file with the columns time_s, duty and any of temperature_degC, voltage_V, current_A"
    )
    fit: list[str] = Field(
        ["loss", "gap", "contact_resistance", "resistivity"],
        description=f"parameters to estimate, from {', '.join((*FACTORS, BIAS))}",
        examples=["NAME,.."],
    )
    camera: Annotated[CameraView, in_file(load_camera, "a CSV file")] | None = Field(
        None,
        description="CSV file of a thermal camera, recorded with the log: time_s, and "
        "temperatures in degC at points of the tube. The name of a column is "
        "its distance from the middle of the curved part, mm",
        examples=["FILE.csv"],
    )
    noise_K: Positive | None = Field(None, description="stated noise of the thermometers, compared with the residuals")
    noise_V: Positive | None = Field(None, description="stated noise of the voltage")
    noise_A: Positive | None = Field(None, description="stated noise of the current")
    position_mm: Number = Field(
        Decimal(0), description="position of the thermometer, from the middle of the curved part"
    )
    lag_s: NotNegative = Field(Decimal(0), description="time constant of the thermometers")

    @functools.cached_property
    def _read(self) -> HeatingLog:
        log = load_heating_log(self.log, **self.in_si("position_mm", "lag_s"))
        return log if self.camera is None else log.with_camera(*self.camera)

    @model_validator(mode="after")
    def _can_be_read(self) -> Self:
        _ = self._read
        return self

    def run(self, progress: Progress | None = None) -> RigFit:
        """The calibrated rig; raises InputError for a factor that is not known."""
        stated = {"temperature": self.noise_K, "voltage": self.noise_V, "current": self.noise_A}
        noise = {name: float(value) for name, value in stated.items() if value is not None}
        return calibrate(self.heated(), self.rig, self._read, self.fit, noise=noise)


@question("running the study", timed=False)
def calibrate_mold(
    trials: TrialsPath, options: Annotated[Options, Arguments(calibrate_springback, "model")]
) -> Calibration:
    """Spring-back of tubes, from trials."""
    return calibrate_springback(trials.mold_radius, trials.obtained_radius, **options)
