"""File access: clear errors, atomic writes, and a journal that is written line by line."""

from __future__ import annotations

import difflib
import json
import logging
import os
import secrets
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np

from ..errors import InputError, MissingExtraError
from .shipped import NAME, shipped, suggestion

LOGGER = logging.getLogger(__name__)

MAX_FILES = 1000
"""Largest number of files of a directory that are compared with a missing one."""

MIN_SIMILARITY = 0.85
"""Smallest `difflib` ratio of a suggested file name."""


_UNFINISHED: set[Path] = set()


def remove_unfinished() -> None:
    """Remove unfinished files, before a process is killed."""
    for temporary in list(_UNFINISHED):
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_write(path: str | PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path for writing; the file is renamed to `path` when the block ends without an error.

    Other processes see the old file or the complete new one, also after an interruption. Missing directories are
    created.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    # In the same directory: `os.replace` is atomic only within one file system.
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The thread that ends the process after Ctrl-C removes these files, since no `finally` runs then.
        _UNFINISHED.add(temporary)
        try:
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
            _UNFINISHED.discard(temporary)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


@contextmanager
def left_out_where_missing() -> Iterator[None]:
    """Turn a missing package in the block into a warning: one of several files is not written."""
    try:
        yield
    except MissingExtraError as error:
        LOGGER.warning(f"left out: {error}")


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write a text file in UTF-8 in one atomic step; raises InputError if that fails."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def save_arrays(path: str | PathLike[str], /, **arrays: Any) -> Path:
    """Write named arrays as npz in one atomic step; raises InputError if that fails."""
    with atomic_write(path) as temporary:
        plain: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
        np.savez(temporary, **plain)
    return Path(path)


def no_such_file(path: str | PathLike[str]) -> InputError:
    """Error for a missing file, with a similar name in its directory or among the built-in files."""
    file = Path(path)
    try:
        names = [sibling.name for sibling in islice(file.parent.iterdir(), MAX_FILES)]
    except OSError:
        names = []
    close = difflib.get_close_matches(file.name, names, n=1, cutoff=MIN_SIMILARITY)
    hint = "".join(f"; did you mean {file.with_name(name)}?" for name in close)
    named = shipped().get(file.stem)
    if not hint and named is not None and file.name in (named.stem, named.name):
        hint = f"; use the built-in file by its name, {file.stem}"
    elif not hint and NAME.fullmatch(file.name):
        hint = suggestion(path)
    return InputError(f"{path}: there is no such file{hint}")


def read_bytes(path: str | PathLike[str]) -> bytes:
    """Read a file; raises InputError with its path if that fails."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        raise no_such_file(path) from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a directory; it must be a file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_text(path: str | PathLike[str]) -> str:
    """Read a text file in UTF-8; raises InputError with its path if that fails."""
    try:
        return read_bytes(path).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is not a text file in UTF-8") from None


# --- journal of a sweep: a line of JSON for every point, appended when the point is finished --------------------------

SYNC_INTERVAL = 0.1
"""Longest time between two writes to the disk, s; points lost by a power failure are computed again."""


class Journal:
    """Journal of a sweep, open for appending by one run at a time.

    Attributes:
        done: index of a point -> position of its line in the file.
        failed: indices of failed points.

    Raises:
        InputError: the file is the journal of another sweep, is damaged, in use by another run, or cannot be written.
    """

    def __init__(self, path: Path, fingerprint: str, points: int) -> None:
        self.path = path
        self.done: dict[int, int] = {}
        self.failed: set[int] = set()
        self._head = {"fingerprint": fingerprint, "points": points}
        self._synced = 0.0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = path.open("a+b")
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
        try:
            lock(self._file, path)
            self._read()
        except BaseException:  # also for a signal: the file must not stay locked
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self._sync()
        self._file.close()

    def append(self, index: int, entry: Mapping[str, Any]) -> None:
        """Write the line of a point; `entry` has a "record" or a "failure"."""
        # Reading entries moves the position: every line is appended at the end.
        position = self._file.seek(0, os.SEEK_END)
        self._write({"index": index, **entry})
        self._note(index, position, "failure" in entry)
        # fsync waits for the disk, and a point may take less time: several points share one.
        if time.monotonic() - self._synced > SYNC_INTERVAL:
            self._sync()

    def entries(self) -> Iterator[dict[str, Any]]:
        """Last line of every point, sorted by index."""
        for index in sorted(self.done):
            self._file.seek(self.done[index])
            yield json.loads(self._file.readline())

    def _write(self, line: Mapping[str, Any]) -> None:
        try:
            self._file.write(_line(line))
            self._file.flush()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror or error}") from error

    def _sync(self) -> None:
        os.fsync(self._file.fileno())
        self._synced = time.monotonic()

    def _note(self, index: int, position: int, failed: bool) -> None:
        self.done[index] = position
        # A point that failed before and was computed again has two lines: the last one counts.
        (self.failed.add if failed else self.failed.discard)(index)

    def _read(self) -> None:
        """Read an existing journal, cut off an incomplete last line, and write the head of a new journal."""
        position, size = 0, self._file.seek(0, os.SEEK_END)
        self._file.seek(0)
        for number, line in enumerate(self._file):
            data = _parse(line)
            if data is None and position + len(line) == size and (number or _line(self._head).startswith(line)):
                break  # incomplete after a kill or a power failure
            if data is None:
                raise InputError(f"{self.path}: line {number + 1} is damaged; this is not the journal of a sweep")
            if number == 0:
                self._check(data)
            else:
                self._note(data["index"], position, "failure" in data)
            position += len(line)
        # The next line would be appended to an incomplete one.
        self._file.truncate(position)
        if position == 0:
            self._write(self._head)
            self._sync()

    def _check(self, head: Mapping[str, Any]) -> None:
        if head != self._head:
            raise InputError(
                f"{self.path}: this journal belongs to another sweep, or the input files "
                "have changed; give another directory, or delete the journal"
            )


def _line(data: Mapping[str, Any]) -> bytes:
    from pydantic_core import to_json  # here: wheels are built without pydantic

    return to_json(data, inf_nan_mode="strings") + b"\n"


def _parse(line: bytes) -> dict[str, Any] | None:
    """Parse a line of the journal; None for a damaged one."""
    try:
        data = json.loads(line)
    except ValueError:
        return None
    if not isinstance(data, dict) or not line.endswith(b"\n"):
        return None
    entry = isinstance(data.get("index"), int) and "parameters" in data and ("record" in data or "failure" in data)
    return data if entry or "fingerprint" in data else None


def lock(file: BinaryIO, path: Path) -> None:
    """Lock a file for this run, if the system has locks; raises InputError if another run has locked it."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise InputError(f"{path}: another run is writing here; wait for it, or give another directory") from None
