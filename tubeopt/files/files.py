"""Files read with one clear sentence where that fails, and written whole or not at all."""

from __future__ import annotations

import difflib
import logging
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any

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
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
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
