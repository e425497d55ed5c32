"""Time limits of searches, in wall-clock time or in counted work."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ..solvers.time_limit import OutOfTimeError as OutOfTimeError
from ..solvers.time_limit import time_left


@dataclass(eq=False)
class Clock:
    """Time limit of a search, possibly a part of a longer one."""

    limit: float
    """Time limit, s, at most the rest of the enclosing one."""
    within: Clock | None = None
    """Enclosing clock, which ends this one too."""
    now: Callable[[], float] = time.perf_counter
    """Current time, s: wall clock, or counted work. Counted work is equal on every machine and under any load."""
    start_time: float = field(init=False)
    """Start, s of `now`."""
    worked: float = field(default_factory=time.process_time, init=False)
    """Processor time at the start, s."""

    def __post_init__(self) -> None:
        self.start_time = self.now()
        # Counted work is no time; there the wall clock `within` has the limit.
        if self.now is time.perf_counter:
            self.limit = min(self.limit, time_left())

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return self.now() - self.start_time

    @property
    def left(self) -> float:
        """Remaining time, s; 0 after the limit."""
        return max(0.0, self.limit - self.seconds)

    def part(self, fraction: float, *, most: float = math.inf) -> Clock:
        """Clock for a fraction of the remaining time, at most `most` seconds."""
        return Clock(min(most, fraction * self.left), self, self.now)

    @property
    def parallel_slowdown(self) -> float:
        """Ratio of wall-clock to processor time of this process, at least 1; larger on a busy machine."""
        if self.within is not None:
            return self.within.parallel_slowdown
        passed, worked = time.perf_counter() - self.start_time, time.process_time() - self.worked
        return max(1.0, passed / worked) if worked > 0 else 1.0

    @property
    def over(self) -> bool:
        """True if the limit is reached."""
        return self.seconds >= self.limit or (self.within is not None and self.within.over)
