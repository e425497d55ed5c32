"""What a heating schedule is asked for."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ...errors import InputError, choice, finite, positive

OBJECTIVES = ("time", "energy", "margin")
QUENCHES = ("water", "air")
FREE = ("clearance", "lead", "vents")
LONGEST = 1800.0
"""Hold, s, beyond which no tube that is heated by its own resistance needs one."""


@dataclass(frozen=True)
class HeatingSpec:
    """The treatment that the curved part needs, and what the schedule must respect.

    Args:
        window_degC: least and greatest temperature of the whole curved part during the hold, degC.
        hold_time: s; 1 to 1800.
        limit_degC: no point of the tube may ever be hotter; None is the upper end of the window.
        ramp: greatest rate of warming of any point outside of the clamps at any time, K/s, the duty taken for a mean
            power; it can be kept where one count warms the cold tube by less.
        objective: "time" (soonest done), "energy" (least charge), or "margin" (farthest from the window's ends).
        longest_heating: of the time before the hold, s.
        slot: time for which one duty is kept, s.
        quench: "water" or "air", after the hold.
        free: what of the rig may be chosen to even out the temperature: any of "clearance", "lead" and "vents".
        lead_range, clearance_range: bounds of these where they are free, m.
        most_vent: greatest fraction of the tube's surface that a vent may leave open where vents are free.

    Raises:
        InputError: an empty window, a window above the limit, or another value out of its range.
    """

    window_degC: tuple[float, float] = (500.0, 550.0)
    hold_time: float = 60.0
    limit_degC: float | None = None
    ramp: float = 20.0
    objective: str = "time"
    longest_heating: float = 120.0
    slot: float = 0.5
    quench: str = "water"
    free: tuple[str, ...] = ()
    lead_range: tuple[float, float] = (3e-3, 60e-3)
    clearance_range: tuple[float, float] = (1e-3, 20e-3)
    most_vent: float = 0.4

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "window_degC", _pair("window_degC", self.window_degC))
        low, high = self.window_degC
        limit = high if self.limit_degC is None else finite("limit_degC", self.limit_degC)
        if high > limit:
            raise InputError(f"window_degC is {low:g} to {high:g} degC; it must end below the limit of {limit:g} degC")
        set_field(self, "limit_degC", limit)
        if low < 50:
            raise InputError(f"window_degC begins at {low:g} degC; it must begin at 50 degC or above")
        if limit > 1200:
            raise InputError(f"limit_degC is {limit:g} degC; it must be at most 1200 degC, where nitinol nearly melts")
        for name in ("hold_time", "ramp", "longest_heating", "slot"):
            set_field(self, name, positive(name, getattr(self, name)))
        if self.hold_time < 1:
            raise InputError(f"hold_time is {self.hold_time:g} s; it must be at least 1 s")
        for name in ("hold_time", "longest_heating"):
            if getattr(self, name) > LONGEST:
                raise InputError(f"{name} is {getattr(self, name):g} s; it must be at most {LONGEST:g} s")
        if not 0.02 <= self.slot <= min(5.0, self.hold_time):
            raise InputError(f"slot is {self.slot:g} s; it must be 0.02 to 5 s, and not above the hold_time")
        choice("objective", self.objective, OBJECTIVES)
        choice("quench", self.quench, QUENCHES)
        wished: Any = self.free
        if isinstance(wished, str) or not isinstance(wished, Iterable):
            raise InputError(f"free is {wished!r}; it must be a list of any of {', '.join(FREE)}")
        set_field(self, "free", tuple(choice("free", name, FREE) for name in self.free))
        for name in ("lead_range", "clearance_range"):
            pair = _pair(name, getattr(self, name))
            positive(name, pair[0])
            set_field(self, name, pair)
        if not 0 < positive("most_vent", self.most_vent) <= 0.5:
            raise InputError(f"most_vent is {self.most_vent:g}; it must be above 0 and at most 0.5")

    @property
    def hold_slots(self) -> int:
        """Whole slots that cover the hold."""
        return math.ceil(self.hold_time / self.slot - 1e-9)

    @property
    def covered_time(self) -> float:
        """Time that whole slots may need to cover the hold wherever it begins, s."""
        return self.slot * (self.hold_slots + 1)

    @property
    def limit(self) -> float:
        """The limit in degC, as a number."""
        assert self.limit_degC is not None
        return self.limit_degC


def _pair(name: str, value: Any) -> tuple[float, float]:
    try:
        low, high = value
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be two numbers, the least and the greatest") from None
    low, high = finite(name, low), finite(name, high)
    if not low < high:
        raise InputError(f"{name} is {low:g} to {high:g}; the first must be below the second")
    return low, high
