"""The friction of a robot as a part of its file: the keys, and the way there and back."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field, model_validator

from ..files.checked import Entry, NotNegative
from ..files.units import UNITS, in_unit, to_si
from .friction import Friction

KEYS = {
    "torque_mN_m_per_m": ("torque", UNITS["mN_m_per_m"]),
    "plate_mN_m": ("plate", UNITS["mN_m"]),
    "jumps_mN_m": ("jumps", UNITS["mN_m"]),
    "ends_mN_m": ("ends", UNITS["mN_m"]),
}
"""Keys with a number for every pair of neighbours, or one for all; what they set, and their unit."""


class FrictionEntry(Entry):
    """Dry friction of every tube in the next one, inner to outer: one number per pair of neighbours, or one for all."""

    torque_mN_m_per_m: list[NotNegative] | None = Field(None, description="wherever both tubes of a pair are")
    plate_mN_m: list[NotNegative] | None = Field(None, description="at the plate, for what rubs behind it")
    jumps_mN_m: list[NotNegative] | None = Field(None, description="where the precurvature of one of the two jumps")
    ends_mN_m: list[NotNegative] | None = Field(None, description="where the outer tube of a pair ends")
    sliding: bool = Field(False, description="whether sliding along the axis uses up friction")
    refinement: int = Field(0, description="how often the pieces of the mesh are halved")

    def build(self) -> Friction:
        """The friction in SI."""
        given = {key: values for key in KEYS if (values := getattr(self, key)) is not None}
        tables = {KEYS[key][0]: tuple(to_si(x, KEYS[key][1]) for x in values) for key, values in given.items()}
        return Friction(**tables, sliding=self.sliding, refinement=self.refinement)

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        self.build()
        return self


def friction_to_dict(friction: Friction) -> dict[str, Any]:
    """A friction with the keys and units of a robot file; what is 0 is left out."""
    data: dict[str, Any] = {}
    for key, (name, unit) in KEYS.items():
        if friction.of(name) != (0.0,):
            data[key] = [in_unit(x, unit) for x in friction.of(name)]
    if friction.sliding:
        data["sliding"] = True
    if friction.refinement:
        data["refinement"] = friction.refinement
    return data
