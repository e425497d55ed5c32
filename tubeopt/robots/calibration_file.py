"""The calibration of a robot as a part of its file: the keys, and the way there and back."""

from __future__ import annotations

from decimal import Decimal
from typing import Any, Self

from pydantic import Field, model_validator

from ..files.checked import Entry, Number
from ..files.units import DEG, MM, RAD, in_unit, to_si
from .calibration import Calibration

ONE_EACH = {
    "rotation_offsets_deg": ("rotation_offsets", DEG),
    "translation_offsets_mm": ("translation_offsets", MM),
    "rotation_gains": ("rotation_gains", RAD),
    "translation_gains": ("translation_gains", RAD),
    "rotation_play_deg": ("rotation_play", DEG),
}
"""Keys with a number for every tube, what they set, and their unit."""


class CalibrationEntry(Entry):
    """How joint readings become joint values of the model: gain times reading plus offset, one number per tube."""

    rotation_offsets_deg: list[Number] | None = Field(None, description="added to the rotations; 0 where not given")
    translation_offsets_mm: list[Number] | None = Field(None, description="added to the translations")
    rotation_gains: list[Number] | None = Field(None, description="factors on the rotations; 1 where not given")
    translation_gains: list[Number] | None = Field(None, description="factors on the translations")
    rotation_play_deg: list[Number] | None = Field(None, description="half widths of the backlash; known, not applied")
    latency_s: Number = Field(Decimal(0), description="by which measured tips come later than the readings")
    found_by: str = Field("", description="the data that it was found by")

    def build(self) -> Calibration:
        """The calibration in SI."""
        given = {key: getattr(self, key) for key in ONE_EACH if getattr(self, key) is not None}
        count = max((len(values) for values in given.values()), default=0)
        none = Calibration.none(count)
        tables = {
            name: tuple(to_si(x, unit) for x in given[key]) if key in given else getattr(none, name)
            for key, (name, unit) in ONE_EACH.items()
        }
        return Calibration(**tables, latency=float(self.latency_s), found_by=self.found_by)

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        self.build()
        return self


def calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    """A calibration with the keys and units of a robot file; what reads true is left out."""
    none = Calibration.none(calibration.n_tubes)
    data: dict[str, Any] = {}
    for key, (name, unit) in ONE_EACH.items():
        values = getattr(calibration, name)
        if values != getattr(none, name) or key == "rotation_offsets_deg":  # one table tells how many tubes there are
            data[key] = [in_unit(x, unit) for x in values]
    if calibration.latency:
        data["latency_s"] = in_unit(calibration.latency, RAD)
    if calibration.found_by:
        data["found_by"] = calibration.found_by
    return data
