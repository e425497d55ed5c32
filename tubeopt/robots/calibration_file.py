"""The calibration of a robot as a part of its file: the keys, and the way there and back."""

from __future__ import annotations

from typing import Any

from ..files.fields import Part, asking, to_data, values
from .calibration import TABLES, Calibration


@asking(Calibration)
class CalibrationEntry(Part):
    """How joint readings become joint values of the model: gain times reading plus offset, one number per tube."""

    def build(self) -> Calibration:
        """The calibration in SI; tables that are left out are those of drives that read true."""
        given = values(Calibration, self)
        none = Calibration.none(max((len(given[name]) for name in TABLES if name in given), default=0))
        return Calibration(**{name: getattr(none, name) for name in TABLES} | given)


def calibration_to_dict(calibration: Calibration) -> dict[str, Any]:
    """A calibration with the keys and units of a robot file; what reads true is left out."""
    none, data = to_data(Calibration.none(calibration.n_tubes)), to_data(calibration)
    # One table stays, to tell how many tubes there are.
    return {key: value for key, value in data.items() if value != none[key] or key == "rotation_offsets_deg"}
