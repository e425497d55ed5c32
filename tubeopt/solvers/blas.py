"""Linear algebra in one thread while small problems are solved.

Distributing a matrix of a hundred rows over cores takes longer than its factorisation; on a busy machine, where threads
wait for each other, a hundred times as long.
"""

from __future__ import annotations

import threading
from contextlib import ContextDecorator
from functools import lru_cache
from typing import Any

_LOCK = threading.Lock()
_BEFORE: list[tuple[Any, int]] = []
"""Limited libraries with their earlier numbers of threads."""
_INSIDE = [0]
"""Number of contexts that are entered."""


@lru_cache(maxsize=1)
def _libraries() -> list[Any]:
    """Controllers of the linear algebra libraries that NumPy and SciPy have loaded."""
    import scipy.linalg  # noqa: F401  it loads a library of its own
    from threadpoolctl import ThreadpoolController

    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


class _OneThread(ContextDecorator):
    """Context and decorator that runs linear algebra in one thread.

    It applies to all threads of the process, since the libraries have no finer setting. Contexts may be nested, and may
    overlap in several threads.
    """

    def __enter__(self) -> None:
        with _LOCK:
            _INSIDE[0] += 1
            if _INSIDE[0] == 1:
                _BEFORE[:] = [(library, count) for library in _libraries() if (count := library.get_num_threads()) > 1]
                for library, _ in _BEFORE:
                    library.set_num_threads(1)

    def __exit__(self, *_: object) -> None:
        with _LOCK:
            _INSIDE[0] -= 1
            if not _INSIDE[0]:
                for library, count in _BEFORE:
                    library.set_num_threads(count)


small = _OneThread()
"""Context, or decorator of a function, that solves many small problems."""
