"""Passport of a tube: one file from its drawing over mold and heatings to its measured radius.

`tubeopt fabricate` begins it. A command that saves into the folder of a passport continues it. In a robot file the key
`passport` of a tube replaces its drawn radius by the measured one.
"""

from __future__ import annotations

import math
from itertools import count
from os import PathLike
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from ..files.checked import Entry, NotNegative, Number, Positive, Whole, check
from ..files.units import MM, to_si
from ..files.yaml_file import load_yaml, save_yaml

PASSPORT_FILE = "passport.yaml"
"""Name of the file in the folder of a tube."""

HEADER = "Passport of a tube, for tubeopt: from drawing to measured radius."


class HeatingEntry(Entry):
    """A heating of the tube."""

    ended: str = Field(description="reason for the end; done for a complete schedule")
    lowest_degC: Number | None = Field(None, description="lowest reading in the hold")
    highest_degC: Number | None = Field(None, description="highest reading in the hold")
    time_s: NotNegative = Field(description="duration")
    log: str = Field("", description="file with the log")


class RadiusEntry(Entry):
    """A measurement of the tube."""

    source: str = Field("", description="scan or photo")
    radius_mm: Positive = Field(description="radius of the bend")
    error_mm: Positive = Field(description="its standard error")


class SpringbackTrialsEntry(Entry):
    """Spring-back that was fitted to trials."""

    trials: Whole = Field(description="number of trials")
    lost_percent: Number = Field(description="lost fraction of the curvature of the mold")


class ValidationEntry(Entry):
    """Comparison of the robot with measured tips."""

    robot: str = Field("", description="name of the robot")
    configurations: Whole = Field(description="number of measured tips")
    mean_error_mm: NotNegative = Field(description="mean distance of predicted and measured tips")


class MeasuredRadius(NamedTuple):
    """Radius from all measurements, m."""

    radius: float
    standard_error: float


class Passport(Entry):
    """A tube from its drawing to its measured radius."""

    kind: Literal["passport"]
    robot: str = Field("", description="name of the robot")
    tube: Whole = Field(description="number of the tube, from the inside")
    drawn_radius_mm: Positive = Field(description="radius of the drawing")
    mold_radius_mm: Positive = Field(description="radius of the groove")
    heatings: list[HeatingEntry] = Field([], description="heatings, the first one first")
    measurements: list[RadiusEntry] = Field([], description="measured radii")
    springback: list[SpringbackTrialsEntry] = Field([], description="spring-back from trials")
    validations: list[ValidationEntry] = Field([], description="comparisons with measured tips")

    @property
    def measured(self) -> MeasuredRadius | None:
        """Mean radius, weighted by the standard errors of the measurements; None without any."""
        if not self.measurements:
            return None
        radii = [(to_si(m.radius_mm, MM), to_si(m.error_mm, MM)) for m in self.measurements]
        weights = [1 / error**2 for _, error in radii]
        mean = sum(weight * radius for weight, (radius, _) in zip(weights, radii, strict=True)) / sum(weights)
        return MeasuredRadius(mean, 1 / math.sqrt(sum(weights)))


PASSPORT_KINDS = {"passport": Passport}
"""Kinds of passport files."""


def load_passport(path: str | PathLike[str]) -> Passport:
    """Load a passport; raises InputError with one line per problem."""
    return check(Passport, load_yaml(path), path)


def begin_passport(directory: Path, *, robot: str, tube: int, drawn_radius: float, mold_radius: float) -> Path:
    """Write the passport of a new tube, radii in m, into its folder and return its path.

    A passport there that has entries belongs to a tube that was made: it is renamed, as passport_1.yaml.
    """
    path = directory / PASSPORT_FILE
    if path.exists() and load_yaml(path).keys() & {"heatings", "measurements", "springback", "validations"}:
        path.rename(next(p for k in count(1) if not (p := path.with_stem(f"{path.stem}_{k}")).exists()))
    radii = {"drawn_radius_mm": _millimetres(drawn_radius), "mold_radius_mm": _millimetres(mold_radius)}
    save_yaml(path, {"kind": "passport", "robot": robot, "tube": tube} | radii, HEADER)
    return path


def continue_passport(directory: Path, key: str, **entry: Any) -> list[Path]:
    """Append an entry under a key to the passport in a folder; return its path, or nothing without a passport.

    Lengths end in `_mm` and are in m here. Raises InputError for an invalid passport.
    """
    path = directory / PASSPORT_FILE
    if not path.exists():
        return []
    data: Any = load_yaml(path)
    check(Passport, data, path)
    rounded = {name: _millimetres(value) if name.endswith("_mm") else value for name, value in entry.items()}
    data[key] = [*data.get(key, []), rounded]
    check(Passport, data, path)
    save_yaml(path, data, HEADER)
    return [path]


def _millimetres(length: float) -> float:
    """Length in mm to a tenth of a micrometre."""
    return round(1e3 * length, 4)
