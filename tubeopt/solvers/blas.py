"""One thread of linear algebra while small problems are solved: to share a matrix of a hundred rows among the cores
takes longer than to factor it, and on a busy machine, where a thread waits for the others, a hundred times as long."""

from __future__ import annotations

import threading
from contextlib import ContextDecorator
from functools import lru_cache
from typing import Any

_LOCK = threading.Lock()
_BEFORE: list[tuple[Any, int]] = []
"""Libraries that have been limited, with their numbers of threads before."""
_INSIDE = [0]
"""How many blocks are being worked at."""


@lru_cache(maxsize=1)
def _libraries() -> list[Any]:
    """Those of linear algebra that NumPy and SciPy have loaded."""
    import scipy.linalg  # noqa: F401  which brings its own
    from threadpoolctl import ThreadpoolController

    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


class _OneThread(ContextDecorator):
    """Linear algebra runs in one thread inside of the block, or of a function, and in as many as before after it. For
    all threads of the process, since libraries know no other way; blocks may lie within each other and beside each
    other."""

    def __enter__(self) -> None:
        with _LOCK:
            _INSIDE[0] += 1
            if _INSIDE[0] == 1:
                _BEFORE[:] = [(one, count) for one in _libraries() if (count := one.get_num_threads()) > 1]
                for one, _ in _BEFORE:
                    one.set_num_threads(1)

    def __exit__(self, *_: object) -> None:
        with _LOCK:
            _INSIDE[0] -= 1
            if not _INSIDE[0]:
                for one, count in _BEFORE:
                    one.set_num_threads(count)


small = _OneThread()
"""For blocks, and as the decorator of functions, that solve many small problems."""
