"""How much time is left."""

from __future__ import annotations

import time

from ..solvers.time_limit import LateError as LateError
from ..solvers.time_limit import time_left


class Clock:
    """Time that is left of a limit; the longer time `within` which it lies tells how crowded the machine is."""

    def __init__(self, limit: float, within: Clock | None = None) -> None:
        self.began, self.limit = time.perf_counter(), min(limit, time_left())
        self.since: tuple[float, float] = (self.began, time.process_time()) if within is None else within.since
        """Wall and processor time from which crowding is told, s."""

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self.began

    @property
    def left(self) -> float:
        """Seconds that are left, 0 when the limit is reached."""
        return max(0.0, self.limit - self.seconds)

    def part(self, share: float) -> Clock:
        """A clock of its own for a share of what is left."""
        return Clock(share * self.left, self)

    @property
    def crowding(self) -> float:
        """Seconds that pass per second of this process's work, at least 1: more where others use the processor."""
        passed, worked = time.perf_counter() - self.since[0], time.process_time() - self.since[1]
        return max(1.0, passed / worked) if worked > 0 else 1.0

    @property
    def over(self) -> bool:
        """Whether the limit is reached."""
        return self.seconds >= self.limit
