"""How a plan is made, in detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from ..block.own import OwnObjective
from ..display import Displayed
from ..errors import InputError, choice, instance, positive, whole
from ..inverse.clock import Clock
from ..inverse.search import SEARCHES, Way
from ..typing import Array
from .effort import DEFAULT_EFFORT, PlanEffort, PlanTask
from .smooth import OBJECTIVES


class Ways(Protocol):
    """What knows ways among bodies from earlier on, as a `Roadmap`."""

    def way(self, task: PlanTask, start: Array, goals: Sequence[Array], clock: Clock) -> Way:
        """A way from a point of the chart to one of goals; without points where it knows none."""

    def near(self, task: PlanTask, place: Array, count: int) -> Array:
        """At most `count` points of the chart whose tips are nearest to a place."""


@dataclass(frozen=True)
class PlanOptions(Displayed):
    """Details of a plan.

    Raises:
        InputError: a value that is not allowed.
    """

    search: str = "auto"
    """"auto" (straight, by translations where nothing can snap, else RRT-Connect), "rrt_connect" alone, or "optimal":
    what "auto" finds, after which BIT* (OMPL) has `search_seconds` to find a shorter way."""
    objective: str = "length"
    """Of smoothing: "length" (of the path in joint space), "time", "effort" (int of the squares of the accelerations),
    "margin" (largest least margin), or "none"."""
    time_limit: float = 60.0
    """For everything, s."""
    search_seconds: float = 5.0
    """Of "optimal", s."""
    clearance: float = 0.0
    """Least distance of the surface of the arm from obstacles, m."""
    max_force: float = 0.0
    """N; margin and clearance hold under any force on the tip of up to that size which keeps its direction."""
    carriage_gap: float = 0.0
    """As in `InverseOptions`, m."""
    section_length: float = 0.0
    """As in `InverseOptions`, m."""
    modulo_turns: bool = False
    """A goal rotation may be reached with any number of whole turns; the plan tells how many."""
    seed: int = 0
    """Of the random numbers."""
    extra_cost: OwnObjective | None = None
    """Of smoothing, an own objective of the joint values and the tip of one pose, `q.poses[0]`: its mean along the
    path, times its weight, is added to the objective, in which the length counts relative to that of the way that was
    found, as 1."""
    effort: PlanEffort = DEFAULT_EFFORT
    """How hard a way is searched for, smoothed, timed and proved."""
    roadmap: Ways | None = field(default=None, repr=False)
    """What is asked for a way before any is searched for, see `build_roadmap`."""

    def __post_init__(self) -> None:
        choice("search", self.search, SEARCHES)
        choice("objective", self.objective, (*OBJECTIVES, "none"))
        instance("extra_cost", self.extra_cost, OwnObjective, optional=True)
        if self.extra_cost is not None and self.objective == "none":
            raise InputError("extra_cost is a cost of smoothing, and objective is 'none'; it must be another one")
        if self.roadmap is not None and not hasattr(self.roadmap, "way"):
            raise InputError(f"roadmap is {self.roadmap!r}; it must be a Roadmap")
        instance("effort", self.effort, PlanEffort)
        positive("time_limit", self.time_limit)
        positive("search_seconds", self.search_seconds)
        for name in ("clearance", "max_force", "carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
        instance("modulo_turns", self.modulo_turns, bool)
        object.__setattr__(self, "seed", whole("seed", self.seed, 0))


DEFAULT_PLAN = PlanOptions()
