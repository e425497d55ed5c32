"""The command line, a module per group of commands. Each turns flags into a question, and an answer into text.

`main` begins and ends the process `tubeopt`: Ctrl-C waits until a command can report it, and undoes nothing done. While
Python imports, and while it leaves, Ctrl-C would end the process by the signal, with a trace or without a word.
"""

from __future__ import annotations

import contextlib
import gc
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

__all__ = ["main"]

# Packages by nanobind: on exit they print on stderr which of their objects are left.
BINDINGS = "ompl", "manifold3d"

# Thresholds of the garbage collector. With those of Python, collections during imports take a tenth of a short command.
GARBAGE = 50_000, 20, 20


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run one command as a process of its own; `arguments` default to those of the process. Ends with SystemExit."""
    gc.set_threshold(*GARBAGE)
    heard: list[int] = []
    listens = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else it was started to ignore Ctrl-C
    if listens:
        signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        # Importing takes most of a short command: Ctrl-C is already noted here.
        from .app import main as run

        run(arguments, heard)
    finally:
        with contextlib.suppress(OSError, ValueError):  # what cannot be printed is told when Python leaves
            sys.stdout.flush()
        if listens:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        # Python remembers an interrupt that fell into text that it ran as code, as dataclasses are made of, and would
        # end by the signal in place of the code: running other text makes it forget.
        exec("")
        if not any(name in sys.modules for name in BINDINGS):
            # Nor need Python look through all that there is for what to take down: the system takes it whole.
            gc.freeze()
