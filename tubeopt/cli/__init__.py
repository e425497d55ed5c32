"""The command line, with one module per group of commands.

`main` starts and ends the process `tubeopt`. It delays Ctrl-C until a command can report it: during imports and at
exit, Python would end the process with a traceback, or without a message.
"""

from __future__ import annotations

import contextlib
import gc
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

__all__ = ["main"]

# Packages that use nanobind: on exit they print their remaining objects on stderr.
BINDINGS = "ompl", "manifold3d"

# Thresholds of the garbage collector. With those of Python, collections during imports take a tenth of a short command.
GARBAGE = 50_000, 20, 20


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run one command as a process and exit; `arguments` default to those of the process."""
    gc.set_threshold(*GARBAGE)
    signals: list[int] = []
    listens = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else it was started to ignore Ctrl-C
    if listens:
        signal.signal(signal.SIGINT, lambda number, frame: signals.append(number))
    try:
        # Importing takes most of a short command: Ctrl-C is already noted here.
        from .app import main as run

        run(arguments, signals)
    finally:
        with contextlib.suppress(OSError, ValueError):  # Python reports a broken stdout at exit
            sys.stdout.flush()
        if listens:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        # An interrupt during `exec`, which dataclasses use, is stored by Python and would end the process by the
        # signal: another `exec` clears it.
        exec("")
        if not any(name in sys.modules for name in BINDINGS):
            # The final garbage collection takes time; the system frees all memory anyway.
            gc.freeze()
