"""How much time is left."""

from __future__ import annotations

import time


class Clock:
    """Time that is left of a limit."""

    def __init__(self, limit: float) -> None:
        self.began, self.limit = time.perf_counter(), limit
        self._worked = time.process_time()

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
        return Clock(share * self.left)

    @property
    def crowding(self) -> float:
        """Seconds that pass per second of this process's work, at least 1: more where others use the processor."""
        worked = time.process_time() - self._worked
        return max(1.0, self.seconds / worked) if worked > 0 else 1.0

    @property
    def over(self) -> bool:
        """Whether the limit is reached."""
        return self.seconds >= self.limit
