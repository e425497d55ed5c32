"""A computer beside a rig that plans the rest of its heating anew every few seconds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...typing import Array
from ..heating.replanning import Planner, Rest, first_estimate, observed, replanned

MOST_SLOTS = 12
"""Of one lead: the board goes on alone where no other comes before it ends; it takes no more than 20."""

STRAIGHT = 0.3
"""Counts by which a lead, which is a line, may differ from what was planned."""

STEADY = 2.0
"""K by which what the board wants may differ from the law that is planned with."""


@dataclass
class Leader:
    """What leads a board by its reports.

    planner: with what. every: s from one plan to the next.
    """

    planner: Planner
    every: float = 3.0
    rest: Rest | None = field(default=None, init=False)
    """The last plan."""

    def __post_init__(self) -> None:
        self._estimate = first_estimate(self.planner)
        self._left, self._time = 0, float("-inf")

    @property
    def strength(self) -> float:
        """By how much the rig heats more than its model, as a fraction."""
        return self._estimate.strength

    def advise(self, row: dict[str, Any]) -> dict[str, Any] | None:
        """What to tell the board after one of its reports on a slot that begins: a lead, or nothing.

        Nothing is told to a board whose schedule is another one, or to one that is dry.
        """
        law, place = self.planner.law, int(row["place"])
        if row["dry"] or row["state"] not in ("heating", "holding"):
            return None
        self._estimate = observed(self.planner, self._estimate, row["temperature_degC"], row["count"], law.slot)
        self._left -= 1
        due = row["time_s"] - self._time >= self.every or self._left <= 1
        if not due or place >= len(law.planned) or not self._is_ours(row):
            return None
        self.rest = replanned(self.planner, self._estimate, place)
        slots = straight(self.rest.planned)
        self._left, self._time = slots, row["time_s"]
        first, last = (round(100 * float(self.rest.planned[k])) for k in (0, slots - 1))
        return {"slots": slots, "from": min(first, 25500), "to": min(last, 25500)}

    def _is_ours(self, row: dict[str, Any]) -> bool:
        reference = self.planner.law.reference
        place = np.clip([row["place"] - 1, row["place"]], 0, len(reference) - 1)
        return bool(np.abs(reference[place] - row["reference_degC"]).min() < STEADY)


def straight(planned: Array) -> int:
    """How many of the first counts a line from the first to the last of them tells."""
    most = min(len(planned), MOST_SLOTS)
    for slots in range(most, 2, -1):
        line = np.linspace(planned[0], planned[slots - 1], slots)
        if np.abs(line - planned[:slots]).max() <= STRAIGHT:
            return slots
    return min(most, 2)
