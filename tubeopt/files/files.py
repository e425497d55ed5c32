"""Files read with one clear sentence where that fails, and written whole or not at all, or by lines in a journal."""

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
from .shipped import NAME, alike, shipped

LOGGER = logging.getLogger(__name__)

MANY = 1000
"""Files of a directory that are looked at for the one that was meant."""

ALIKE = 0.85
"""Part of a name that must be another one's, for that to be meant."""


_UNFINISHED: set[Path] = set()


def remove_unfinished() -> None:
    """Remove what is being written, for a process that is ended where it is."""
    for temporary in list(_UNFINISHED):
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_write(path: str | PathLike[str]) -> Iterator[Path]:
    """Yield a name beside `path` to write to; it becomes `path` when the block ends without an error.

    Whoever reads `path` meanwhile, and whoever looks after an interruption, sees the old file or the new one.
    Missing directories are made.

    Raises:
        InputError: the file cannot be written there.
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
    """A block that writes one of several files; a warning where what it needs is not installed, and no file."""
    try:
        yield
    except MissingExtraError as error:
        LOGGER.warning(f"left out: {error}")


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write `text` to `path` in UTF-8, whole or not at all; raises InputError where that cannot be."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def save_arrays(path: str | PathLike[str], /, **arrays: Any) -> Path:
    """Write arrays under their names as npz, whole or not at all; raises InputError where that cannot be."""
    with atomic_write(path) as temporary:
        plain: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
        np.savez(temporary, **plain)
    return Path(path)


def no_such_file(path: str | PathLike[str]) -> InputError:
    """That a file is missing, and which is called much the same, beside it or of those that come with tubeopt."""
    file = Path(path)
    try:
        others = [each.name for each in islice(file.parent.iterdir(), MANY)]
    except OSError:
        others = []
    close = difflib.get_close_matches(file.name, others, n=1, cutoff=ALIKE)
    hint = "".join(f"; did you mean {file.with_name(k)}?" for k in close)
    named = shipped().get(file.stem)
    if not hint and named is not None and file.name in (named.stem, named.name):
        hint = f"; use the built-in file by its name, {file.stem}"
    elif not hint and NAME.fullmatch(file.name):
        hint = alike(path)
    return InputError(f"{path}: there is no such file{hint}")


def read_bytes(path: str | PathLike[str]) -> bytes:
    """The content of a file; raises InputError naming it where it cannot be read."""
    try:
        return Path(path).read_bytes()
    except FileNotFoundError:
        raise no_such_file(path) from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a directory; it must be a file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_text(path: str | PathLike[str]) -> str:
    """The text of a file in UTF-8; raises InputError naming it where it cannot be read."""
    try:
        return read_bytes(path).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is not a text file in UTF-8") from None


# --- journal of a sweep: a line of JSON for every point, appended as soon as the point is done ------------------------

SYNC_INTERVAL = 0.1
"""Longest time (s) that a point is on the way to the disk; what a loss of power takes is computed again."""


class Journal:
    """The journal of one sweep, open for appending; one run at a time.

    done: place of the line of every point that has one, by the point's index.   failed: those of them that failed.

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
        except BaseException:  # also where a signal comes: no file stays open and locked
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self._sync()
        self._file.close()

    def append(self, index: int, entry: Mapping[str, Any]) -> None:
        """Write the line of a point; `entry` holds a "record", or a "failure"."""
        # Reading entries moves the position: every line is appended at the end.
        place = self._file.seek(0, os.SEEK_END)
        self._write({"index": index, **entry})
        self._note(index, place, "failure" in entry)
        # fsync waits for the disk, and points may take less than that: many share one.
        if time.monotonic() - self._synced > SYNC_INTERVAL:
            self._sync()

    def entries(self) -> Iterator[dict[str, Any]]:
        """The last line of every point, by index."""
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

    def _note(self, index: int, place: int, failed: bool) -> None:
        self.done[index] = place
        # A point that failed before and was computed again has two lines: the last one counts.
        (self.failed.add if failed else self.failed.discard)(index)

    def _read(self) -> None:
        """Take in what is there, cut off a torn end, and write the head of a new journal."""
        place, size = 0, self._file.seek(0, os.SEEK_END)
        self._file.seek(0)
        for number, line in enumerate(self._file):
            data = _parse(line)
            if data is None and place + len(line) == size and (number or _line(self._head).startswith(line)):
                break  # torn by a kill, or nonsense after a loss of power
            if data is None:
                raise InputError(f"{self.path}: line {number + 1} is damaged; this is not the journal of a sweep")
            if number == 0:
                self._check(data)
            else:
                self._note(data["index"], place, "failure" in data)
            place += len(line)
        # A line without its end would swallow the next one.
        self._file.truncate(place)
        if place == 0:
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
    """The head or the entry in a whole line; None where it is damaged."""
    try:
        data = json.loads(line)
    except ValueError:
        return None
    if not isinstance(data, dict) or not line.endswith(b"\n"):
        return None
    entry = isinstance(data.get("index"), int) and "parameters" in data and ("record" in data or "failure" in data)
    return data if entry or "fingerprint" in data else None


def lock(file: BinaryIO, path: Path) -> None:
    """Hold a file for this run, where the system knows locks; raises InputError where another run holds it."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise InputError(f"{path}: another run is writing here; wait for it, or give another directory") from None
