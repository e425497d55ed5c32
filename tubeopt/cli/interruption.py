"""Ctrl-C ends every command within two seconds, with a message on what was saved.

Python handles Ctrl-C between two bytecodes. Compiled solvers may not return to Python for a long time, or, like IPOPT,
end the solve and let the program continue. So a thread receives the signal too, and ends the process if the main thread
does not.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from ..files.files import remove_unfinished
from .messages import INTERRUPTED, print_error

PATIENCE = 1.2
"""Time for a command to end by itself, s; Python needs another half second to exit."""

_SAVED: list[Callable[[], str]] = []
_HANDLED: list[bool] = []
_SIGNALS: list[int] = []


@contextlib.contextmanager
def reporting_saved(what: str | Callable[[], str]) -> Iterator[None]:
    """Set the message on saved results for an interruption of the block: text, or a function that returns it."""
    message = what if callable(what) else lambda: what
    _SAVED.append(message)
    try:
        yield
    except Exception:  # not KeyboardInterrupt: its message is still needed
        _SAVED.remove(message)
        raise
    _SAVED.remove(message)


def saved_message() -> str:
    """Message on the saved results of an interrupted command."""
    return _SAVED[-1]() if _SAVED else "nothing was saved"


@contextlib.contextmanager
def interruptible(as_json: bool) -> Iterator[threading.Lock]:
    """End the process if Ctrl-C does not end the block; only the thread that takes the lock reports it."""
    _SAVED.clear()
    _SIGNALS.clear()
    reporting = threading.Lock()
    if threading.current_thread() is not threading.main_thread():
        yield reporting
        return
    # A signal handler of Python waits for the next bytecode. The wakeup descriptor is written by C at once.
    receiver, sender = socket.socketpair()
    # The C handler must not block if the buffer is full.
    sender.setblocking(False)
    ended = threading.Event()

    def _watch() -> None:
        while number := receiver.recv(1):
            # `wait` returns True if the block ended in time.
            if number[0] != signal.SIGINT or _HANDLED or ended.wait(PATIENCE):
                continue
            # Only one of the two threads reports the interruption.
            if reporting.acquire(blocking=False):
                _end(as_json)

    # A full buffer means that Ctrl-C was already received: no warning is needed.
    before = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    watcher = threading.Thread(target=_watch, daemon=True)
    watcher.start()
    try:
        yield reporting
    finally:
        ended.set()
        signal.set_wakeup_fd(before)
        sender.close()
        watcher.join()
        receiver.close()


@contextlib.contextmanager
def awake() -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C in the block, unless the process was started to ignore it."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN or threading.current_thread() is not threading.main_thread():
        yield
        return

    def _interrupt(number: int, frame: FrameType | None) -> None:
        _SIGNALS.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def interrupted() -> bool:
    """True after Ctrl-C: compiled code may turn it into any other error."""
    return bool(_SIGNALS)


@contextlib.contextmanager
def handling_interruption() -> Iterator[None]:
    """Leave the handling of Ctrl-C to the block."""
    _HANDLED.append(True)
    try:
        yield
    finally:
        _HANDLED.pop()


def stop_workers() -> None:
    """Kill the worker processes: at exit Python would wait for their current tasks."""
    for child in multiprocessing.active_children():
        child.kill()


def _end(as_json: bool) -> None:
    stop_workers()
    remove_unfinished()
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[2K\x1b[?25h")  # clear the progress bar and show the cursor
    print_error(f"interrupted; {saved_message()}", INTERRUPTED, "interrupted", as_json)
    sys.stdout.flush()
    # `sys.exit` would raise in this thread only, and wait for the solver in the other.
    os._exit(INTERRUPTED)
