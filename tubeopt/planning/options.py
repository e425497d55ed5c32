"""How a plan is made, in detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Protocol

from ..block.own import OwnObjective
from ..display import Displayed
from ..errors import InputError, instance, positive
from ..files.marks import NOT_NEGATIVE, POSITIVE, OneOf, check_fields, key, unit
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

    search: Annotated[str, OneOf(SEARCHES), "how a way is looked for: auto, rrt_connect or optimal"] = "auto"
    """"auto" (straight, by translations where nothing can snap, else RRT-Connect), "rrt_connect" alone, or "optimal":
    what "auto" finds, after which BIT* (OMPL) has `search_seconds` to find a shorter way."""
    objective: Annotated[
        str, OneOf((*OBJECTIVES, "none")), "of the smoothing: length, time, effort, margin or none"
    ] = "length"
    """"length" (of the path in joint space), "time", "effort" (int of the squares of the accelerations),
    "margin" (largest least margin), or "none"."""
    time_limit: Annotated[float, unit("s"), POSITIVE, "for search and smoothing"] = 60.0
    """For the proof too."""
    search_seconds: float = 5.0
    """Of "optimal", s."""
    clearance: Annotated[float, unit("mm"), NOT_NEGATIVE, "least distance of the arm from obstacles"] = 0.0
    """Of its surface."""
    max_force: Annotated[
        float,
        key("max_tip_force_mN"),
        NOT_NEGATIVE,
        "margin and clearance under any force on the tip of up to this size, in any direction",
    ] = 0.0
    """Forces that keep their direction."""
    carriage_gap: float = 0.0
    """As in `InverseOptions`, m."""
    section_length: float = 0.0
    """As in `InverseOptions`, m."""
    modulo_turns: Annotated[bool, "goal rotations may be reached with any number of whole turns"] = False
    """The plan tells how many."""
    seed: Annotated[int, NOT_NEGATIVE, "of the search"] = 0
    extra_cost: OwnObjective | None = None
    """Of smoothing, an own objective of the joint values and the tip of one pose, `q.poses[0]`: its mean along the
    path, times its weight, is added to the objective, in which the length counts relative to that of the way that was
    found, as 1."""
    effort: PlanEffort = DEFAULT_EFFORT
    """How hard a way is searched for, smoothed, timed and proved."""
    roadmap: Ways | None = field(default=None, repr=False)
    """What is asked for a way before any is searched for, see `build_roadmap`."""

    def __post_init__(self) -> None:
        check_fields(self)
        instance("extra_cost", self.extra_cost, OwnObjective, optional=True)
        if self.extra_cost is not None and self.objective == "none":
            raise InputError("extra_cost is a cost of smoothing, and objective is 'none'; it must be another one")
        if self.roadmap is not None and not hasattr(self.roadmap, "way"):
            raise InputError(f"roadmap is {self.roadmap!r}; it must be a Roadmap")
        instance("effort", self.effort, PlanEffort)
        positive("search_seconds", self.search_seconds)
        for name in ("carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)


DEFAULT_PLAN = PlanOptions()
