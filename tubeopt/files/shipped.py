"""Built-in robots, rigs, studies and other files, used by name: `thesis_ctr`.

They are in `configs/` of a clone, and in `tubeopt/configs/` of an installed package.
"""

from __future__ import annotations

import difflib
import logging
import os
import re
from collections.abc import Mapping
from functools import lru_cache
from os import PathLike
from pathlib import Path

from ..errors import InputError

LOGGER = logging.getLogger(__name__)

PACKAGE = Path(__file__).parents[1]

FOLDER = PACKAGE / "configs" if (PACKAGE / "configs").is_dir() else PACKAGE.parent / "configs"

ENDINGS = ".yaml", ".csv"

NAME = re.compile(r"[A-Za-z0-9_]+")
"""Name of a built-in file, without folder and ending."""

SINGULAR = {"robots": "robot", "rigs": "rig", "ovens": "oven", "studies": "study"}
"""Folder -> kind of its files."""

MAX_SUGGESTIONS = 3
"""Largest number of names in a suggestion."""

MIN_SIMILARITY = 0.5
"""Smallest `difflib` ratio of a suggested name."""


@lru_cache(maxsize=16)
def shipped(folder: str = "*") -> Mapping[str, Path]:
    """Built-in files, or the files of a folder such as "robots", "rigs" or "studies": name -> path."""
    files = sorted(path for ending in ENDINGS for path in FOLDER.glob(f"{folder}/*{ending}"))
    return {path.stem: path for path in files}


def resolve_file(path: str | PathLike[str], folder: Path = Path()) -> Path:
    """Path of a file: the existing file with this path, otherwise the built-in file with this name.

    Other paths are returned unchanged, for the reader to refuse. A local file `NAME.yaml` is used only with its ending;
    a warning reports it.

    Args:
        folder: directory of relative paths.
    """
    local = folder / path
    named = shipped().get(str(path))
    # A local file goes first: a robot in the working directory is not replaced by a built-in one.
    if named is None or os.path.isfile(local):
        return local
    for ending in ENDINGS:
        other = folder / f"{path}{ending}"
        if other.is_file() and not other.samefile(named):
            LOGGER.warning(f"{path} is the built-in file; the local file is {other}")
    return named


def find_file(path: str | PathLike[str], folder: str) -> Path:
    """Path of a file, as `resolve_file`; raises InputError with the nearest names in `folder` for an unknown name."""
    file = resolve_file(path)
    if os.path.lexists(file) or not NAME.fullmatch(str(path)):
        return file
    raise InputError(
        f"{path}: there is no such file, and no built-in {SINGULAR[folder]} has this name{suggestion(path, folder)}"
    )


def suggestion(path: str | PathLike[str], folder: str = "*") -> str:
    """Hint "; did you mean ...?" for an unknown name; "" without a similar name."""
    names = [f"{path}{ending}" for ending in ENDINGS if Path(f"{path}{ending}").is_file()]
    if not names:
        names = difflib.get_close_matches(Path(path).name, shipped(folder), n=MAX_SUGGESTIONS, cutoff=MIN_SIMILARITY)
    if names:
        return f"; did you mean {' or '.join(names)}?"
    return "" if folder == "*" else f"; names are {', '.join(shipped(folder))}"


def description_of(file: Path) -> str:
    """First sentence of the comment at the beginning of a file."""
    lines = file.read_text(encoding="utf-8").splitlines()
    comment = [line.lstrip("# ") for line in lines if line.startswith("#") and "yaml-language-server" not in line]
    return re.split(r"(?<=[.?])\s+(?=[A-Z])", " ".join(comment).strip())[0].removesuffix(".")
