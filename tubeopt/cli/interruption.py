"""Ctrl-C ends every command within two seconds, with a sentence on what is kept.

Python tells a program of Ctrl-C between two of its own steps. Solvers that are compiled may not come to one for long,
or, as IPOPT does, end their solve and let the program go on with what they have. So a thread hears of it as well, and
ends the process where it does not end by itself.
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
from .messages import INTERRUPTED, complain

PATIENCE = 1.2
"""Seconds that a command has to tell that it ends; Python takes half a second more to leave."""

_KEPT: list[Callable[[], str]] = []
_OWN: list[bool] = []
_HEARD: list[int] = []


@contextlib.contextmanager
def keeping(what: str | Callable[[], str]) -> Iterator[None]:
    """Say what is kept where the block is interrupted: words, or what tells them then."""
    tell = what if callable(what) else lambda: what
    _KEPT.append(tell)
    try:
        yield
    except Exception:  # an error ends what is kept; KeyboardInterrupt is none, and its words are still needed
        _KEPT.remove(tell)
        raise
    _KEPT.remove(tell)


def kept() -> str:
    """What is kept of a command that is interrupted, in words."""
    return _KEPT[-1]() if _KEPT else "nothing was saved"


@contextlib.contextmanager
def interruptible(as_json: bool) -> Iterator[threading.Lock]:
    """End the process where Ctrl-C does not end the block by itself; who takes the lock says so, and nobody else."""
    _KEPT.clear()
    _HEARD.clear()
    telling = threading.Lock()
    if threading.current_thread() is not threading.main_thread():
        yield telling
        return
    # A signal handler of Python waits for the next bytecode. The wakeup descriptor is written by C at once.
    heard, told = socket.socketpair()
    # The C handler must not block where the buffer is full.
    told.setblocking(False)
    over = threading.Event()

    def _watch() -> None:
        while number := heard.recv(1):
            # `wait` returns True where the block ended by itself in time.
            if number[0] != signal.SIGINT or _OWN or over.wait(PATIENCE):
                continue
            # Only one of the two threads reports the interruption.
            if telling.acquire(blocking=False):
                _end(as_json)

    # A full buffer means that Ctrl-C was already noted: no warning is needed.
    before = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
    watcher = threading.Thread(target=_watch, daemon=True)
    watcher.start()
    try:
        yield telling
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        told.close()
        watcher.join()
        heard.close()


@contextlib.contextmanager
def awake() -> Iterator[None]:
    """Let Ctrl-C raise KeyboardInterrupt in the block, unless the process was started to ignore it."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN or threading.current_thread() is not threading.main_thread():
        yield
        return

    def _interrupt(number: int, frame: FrameType | None) -> None:
        _HEARD.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def interrupted() -> bool:
    """Whether Ctrl-C was heard: what a command raises after it may be what compiled code makes of it."""
    return bool(_HEARD)


@contextlib.contextmanager
def left_alone() -> Iterator[None]:
    """Leave Ctrl-C to the block, which ends by it in its own way."""
    _OWN.append(True)
    try:
        yield
    finally:
        _OWN.pop()


def stop_workers() -> None:
    """End the processes that work for this one, which would wait for what they are at when it ends."""
    for child in multiprocessing.active_children():
        child.kill()


def _end(as_json: bool) -> None:
    stop_workers()
    remove_unfinished()
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[2K\x1b[?25h")  # whatever bar was there, and the cursor that it hid
    complain(f"interrupted; {kept()}", INTERRUPTED, "interrupted", as_json)
    sys.stdout.flush()
    # `sys.exit` would raise in this thread only, and wait for the solver in the other.
    os._exit(INTERRUPTED)
