"""A thread that does one thing after another, and what can wait when nothing else is to be done."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence

Job = Callable[[], object]


class Worker:
    """Runs jobs in the order in which they are posted, then chores when it has been quiet for their delay (s).

    Args:
        chores: (delay, chore): each is run once after the last job, sooner ones first.
        failed: told of an exception that a job or chore lets through; the worker goes on.
    """

    def __init__(self, chores: Sequence[tuple[float, Job]], failed: Callable[[Exception], object]) -> None:
        self._chores = sorted(chores, key=lambda chore: chore[0])
        self._failed = failed
        self._jobs: deque[tuple[str | None, Job]] = deque()
        self._change = threading.Condition()
        self._open = True
        threading.Thread(target=self._run, name="tubeopt-view", daemon=True).start()

    def post(self, job: Job, *, key: str | None = None) -> None:
        """Have a job done; one with a key takes the place of any that waits under the same key."""
        with self._change:
            if key is not None:
                self._jobs = deque(waiting for waiting in self._jobs if waiting[0] != key)
            self._jobs.append((key, job))
            self._change.notify()

    @property
    def waiting(self) -> bool:
        """Whether jobs wait, or the worker is to end: what can be put off should be."""
        return bool(self._jobs) or not self._open

    def close(self) -> None:
        """Do no more jobs; returns at once."""
        with self._change:
            self._open = False
            self._jobs.clear()
            self._change.notify()

    def _run(self) -> None:
        left, quiet = list(self._chores), time.monotonic()
        while self._open:
            job: Job | None = None
            with self._change:
                if not self._jobs:
                    wait = max(0.0, quiet + left[0][0] - time.monotonic()) if left else None
                    if wait != 0.0:
                        self._change.wait(wait)
                if self._jobs:
                    job = self._jobs.popleft()[1]
            if job is not None:
                self._attempt(job)
                left, quiet = list(self._chores), time.monotonic()
            elif self._open and left and time.monotonic() >= quiet + left[0][0]:
                self._attempt(left.pop(0)[1])

    def _attempt(self, job: Job) -> None:
        try:
            job()
        except Exception as error:  # nothing that goes wrong in one job may leave the page without an answer
            if not self._open:
                return
            traceback.print_exc()
            self._failed(error)
