"""How much time is left, on the clock or in counted work."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ..solvers.time_limit import LateError as LateError
from ..solvers.time_limit import time_left


@dataclass(eq=False)
class Clock:
    """Time that is left of a limit; the longer time `within` which it lies tells how crowded the machine is."""

    limit: float
    """s, at most what is left of the time limit around it."""
    within: Clock | None = None
    """The clock of which this is a share; it ends this one too."""
    now: Callable[[], float] = time.perf_counter
    """Current time, s: of the wall clock, or of counted work, which is the same on every machine under any load."""
    began: float = field(init=False)
    """When it began, s of `now`."""
    worked: float = field(default_factory=time.process_time, init=False)
    """Time of the processor when it began, s."""

    def __post_init__(self) -> None:
        self.began = self.now()
        # Counted work is no time; there the wall clock `within` has the limit.
        if self.now is time.perf_counter:
            self.limit = min(self.limit, time_left())

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return self.now() - self.began

    @property
    def left(self) -> float:
        """Seconds that are left, 0 when the limit is reached."""
        return max(0.0, self.limit - self.seconds)

    def part(self, share: float, *, most: float = math.inf) -> Clock:
        """A clock of its own for a share of what is left, at most so many seconds."""
        return Clock(min(most, share * self.left), self, self.now)

    @property
    def parallel_slowdown(self) -> float:
        """Seconds that pass per second of this process's work, at least 1: more where others use the processor."""
        if self.within is not None:
            return self.within.parallel_slowdown
        passed, worked = time.perf_counter() - self.began, time.process_time() - self.worked
        return max(1.0, passed / worked) if worked > 0 else 1.0

    @property
    def over(self) -> bool:
        """Whether the limit is reached."""
        return self.seconds >= self.limit or (self.within is not None and self.within.over)
