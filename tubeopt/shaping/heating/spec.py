"""Specification of a heating schedule."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from ...display import Displayed
from ...errors import InputError, choice, finite, items, positive, vector
from ...files.field_metadata import POSITIVE, OneOf, Range, Typical, check_fields, key, unit

OBJECTIVES = ("time", "energy", "margin")
QUENCHES = ("water", "air")
FREE = ("clearance", "lead", "vents")
LONGEST = 1800.0
"""Longest hold and heating, s."""


@dataclass(frozen=True)
class HeatingSpec(Displayed):
    """Heat treatment of the curved part, and limits of the schedule.

    Raises:
        InputError: an empty window, a window above the limit, or another value out of its range.
    """

    window_degC: Annotated[tuple[float, float], "temperature range of the whole curved part during the hold time"] = (
        500.0,
        550.0,
    )
    hold_time: Annotated[float, key("hold_s"), POSITIVE, "hold time at the set temperature, 1 to 1800 s"] = 60.0
    limit_degC: Annotated[
        float | None,
        "temperature limit of every point at all times, up to 1200 degC; default the upper end of the window",
    ] = None
    ramp: Annotated[
        float,
        key("ramp_K_per_s"),
        POSITIVE,
        Typical(0.05, 1000.0),
        "largest heating rate of any point outside the clamps, averaged over the pulses. "
        "Infeasible if the smallest duty, 1 of 255, heats the cold tube faster",
    ] = 20.0
    objective: Annotated[
        str,
        OneOf(OBJECTIVES),
        "objective: time (shortest), energy (least charge) or margin (largest distance to "
        "the window's ends and to the limit)",
    ] = "time"
    longest_heating: Annotated[
        float,
        key("longest_s"),
        POSITIVE,
        Typical(2.0, 7200.0),
        "largest heating time before the hold time, up to 1800 s",
    ] = 360.0
    slot: Annotated[float, key("slot_s"), POSITIVE, Typical(5e-3, 60.0), "duration of one duty-cycle value"] = 0.5
    quench: Annotated[str, OneOf(QUENCHES), "cooling after the hold time: water or air"] = "water"
    free: Annotated[
        tuple[str, ...],
        OneOf(FREE),
        "rig parameters to optimise for an even temperature: clearance (between clamp and mold), "
        "lead (straight tube in the mold beside the curved part), vents",
    ] = ()
    lead_range: Annotated[
        tuple[float, float], unit("mm"), POSITIVE, Typical(5e-4, 1.0), "bounds of the lead, with --free lead"
    ] = (
        3e-3,
        60e-3,
    )
    clearance_range: Annotated[
        tuple[float, float],
        unit("mm"),
        POSITIVE,
        Typical(1e-4, 0.2),
        "bounds of the uncovered length between clamp and mold, with --free clearance",
    ] = (1e-3, 20e-3)
    most_vent: Annotated[
        float,
        unit("percent"),
        Range(above=0.0, maximum=0.5),
        "largest open fraction of the tube's surface, up to 50 %, with --free vents",
    ] = 0.4

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        check_fields(self)
        set_field(self, "window_degC", _pair("window_degC", self.window_degC))
        low, high = self.window_degC
        limit = high if self.limit_degC is None else finite("limit_degC", self.limit_degC)
        if high > limit:
            raise InputError(f"window_degC is {low:g} to {high:g} degC; it must end below the limit of {limit:g} degC")
        set_field(self, "limit_degC", limit)
        if low < 50:
            raise InputError(f"window_degC begins at {low:g} degC; it must begin at 50 degC or above")
        if limit > 1200:
            name = "limit_degC is" if limit > high else "window_degC ends at"
            raise InputError(f"{name} {limit:g} degC; it must be at most 1200 degC, where nitinol nearly melts")
        if self.hold_time < 1:
            raise InputError(f"hold_time is {self.hold_time:g} s; it must be at least 1 s")
        for name in ("hold_time", "longest_heating"):
            if getattr(self, name) > LONGEST:
                raise InputError(f"{name} is {getattr(self, name):g} s; it must be at most {LONGEST:g} s")
        if not 0.02 <= self.slot <= min(5.0, self.hold_time):
            raise InputError(f"slot is {self.slot:g} s; it must be 0.02 to 5 s, and not above the hold_time")
        wished: Any = self.free
        chosen = items("free", wished, object, f"any of {', '.join(FREE)}")
        set_field(self, "free", tuple(choice("free", name, FREE) for name in chosen))
        for name in ("lead_range", "clearance_range"):
            pair = _pair(name, getattr(self, name))
            positive(name, pair[0])
            set_field(self, name, pair)

    @property
    def hold_slots(self) -> int:
        """Number of whole slots that cover the hold."""
        return math.ceil(self.hold_time / self.slot - 1e-9)

    @property
    def covered_time(self) -> float:
        """Time of the whole slots that cover the hold from any start, s."""
        return self.slot * (self.hold_slots + 1)

    @property
    def limit(self) -> float:
        """The limit in degC, as a number."""
        assert self.limit_degC is not None
        return self.limit_degC


def _pair(name: str, value: Any) -> tuple[float, float]:
    low, high = vector(name, value, 2, "the least and the greatest").tolist()
    if not low < high:
        unit = " degC" if name.endswith("_degC") else " m"
        raise InputError(f"{name} is {low:g}{unit} to {high:g}{unit}; the first must be below the second")
    return low, high
