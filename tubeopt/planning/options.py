"""How a plan is made, in detail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError, choice, positive
from .search import SEARCHES
from .smooth import OBJECTIVES


@dataclass(frozen=True)
class PlanOptions:
    """Details of a plan.

    Args:
        search: "auto" (straight, by translations where nothing can snap, else RRT-Connect), "rrt_connect" alone, or
            "optimal": what "auto" finds, after which BIT* (OMPL) has `search_seconds` to find a shorter way.
        objective: of smoothing: "length" (of the path in joint space), "time", "effort" (int of the squares of the
            accelerations), "margin" (largest least margin), or "none".
        time_limit: s, for everything.   search_seconds: of "optimal", s.
        clearance: least distance of the surface of the arm from obstacles, m.
        carriage_gap, section_length: as in `InverseOptions`, m.
        modulo_turns: a goal rotation may be reached with any number of whole turns; the plan tells how many.
        seed: of the random numbers.

    Raises:
        InputError: a value that is not allowed.
    """

    search: str = "auto"
    objective: str = "length"
    time_limit: float = 60.0
    search_seconds: float = 5.0
    clearance: float = 0.0
    carriage_gap: float = 0.0
    section_length: float = 0.0
    modulo_turns: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        choice("search", self.search, SEARCHES)
        choice("objective", self.objective, (*OBJECTIVES, "none"))
        positive("time_limit", self.time_limit)
        positive("search_seconds", self.search_seconds)
        for name in ("clearance", "carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
        turns: object = self.modulo_turns
        if not isinstance(turns, bool):
            raise InputError(f"modulo_turns is {turns!r}; it must be True or False")
        seed: object = self.seed
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise InputError(f"seed is {seed!r}; it must be a whole number of at least 0")
        object.__setattr__(self, "seed", int(seed))


DEFAULT_PLAN = PlanOptions()
