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
from ..inverse.task import Task
from ..inverse.way_settings import DEFAULT_WAY, WaySearch
from ..typing import Array
from .smooth import OBJECTIVES


class Ways(Protocol):
    """What knows ways among bodies from earlier on, as a `Roadmap`."""

    def way(self, task: Task, start: Array, goals: Sequence[Array], clock: Clock) -> Way:
        """A way from a point of the chart to one of goals; without points where it knows none."""

    def near(self, task: Task, place: Array, count: int) -> Array:
        """At most `count` points of the chart whose tips are nearest to a place."""


@dataclass(frozen=True)
class PlanOptions(Displayed):
    """Details of a plan.

    Args:
        search: "auto" (straight, by translations where nothing can snap, else RRT-Connect), "rrt_connect" alone, or
            "optimal": what "auto" finds, after which BIT* (OMPL) has `search_seconds` to find a shorter way.
        objective: of smoothing: "length" (of the path in joint space), "time", "effort" (int of the squares of the
            accelerations), "margin" (largest least margin), or "none".
        extra_cost: of smoothing, an own objective of the joint values and the tip of one pose, `q.poses[0]`: its mean
            along the path, times its weight, is added to the objective, in which the length counts relative to that of
            the way that was found, as 1.
        time_limit: s, for everything.   search_seconds: of "optimal", s.
        clearance: least distance of the surface of the arm from obstacles, m.
        max_force: N; margin and clearance hold under any force on the tip of up to that size which keeps its direction.
        carriage_gap, section_length: as in `InverseOptions`, m.
        modulo_turns: a goal rotation may be reached with any number of whole turns; the plan tells how many.
        seed: of the random numbers.
        effort: how hard a way is searched for.
        roadmap: what is asked for a way before any is searched for, see `build_roadmap`.

    Raises:
        InputError: a value that is not allowed.
    """

    search: str = "auto"
    objective: str = "length"
    time_limit: float = 60.0
    search_seconds: float = 5.0
    clearance: float = 0.0
    max_force: float = 0.0
    carriage_gap: float = 0.0
    section_length: float = 0.0
    modulo_turns: bool = False
    seed: int = 0
    extra_cost: OwnObjective | None = None
    effort: WaySearch = DEFAULT_WAY
    roadmap: Ways | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        choice("search", self.search, SEARCHES)
        choice("objective", self.objective, (*OBJECTIVES, "none"))
        instance("extra_cost", self.extra_cost, OwnObjective, optional=True)
        if self.extra_cost is not None and self.objective == "none":
            raise InputError("extra_cost is a cost of smoothing, and objective is 'none'; it must be another one")
        if self.roadmap is not None and not hasattr(self.roadmap, "way"):
            raise InputError(f"roadmap is {self.roadmap!r}; it must be a Roadmap")
        instance("effort", self.effort, WaySearch)
        positive("time_limit", self.time_limit)
        positive("search_seconds", self.search_seconds)
        for name in ("clearance", "max_force", "carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
        instance("modulo_turns", self.modulo_turns, bool)
        object.__setattr__(self, "seed", whole("seed", self.seed, 0))


DEFAULT_PLAN = PlanOptions()
