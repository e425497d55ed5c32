"""Robots, rigs, studies and other files that come with tubeopt and are typed by their name: `thesis_ctr`.

They are those of `configs/` in a clone, and of `tubeopt/configs/` in an installed package, where the build puts them.
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
"""What is typed of such a file: its name without folder and ending."""

ONE = {"robots": "robot", "rigs": "rig", "ovens": "oven", "studies": "study"}
"""Folder -> what a file in it is."""

MOST = 3
"""Names that a message proposes."""

ALIKE = 0.5
"""Part of a name that must be another one's, for that to be proposed."""


@lru_cache(maxsize=16)
def shipped(folder: str = "*") -> Mapping[str, Path]:
    """Name -> path of every file that comes with tubeopt, or of those in a folder: "robots", "rigs", "studies", ..."""
    files = sorted(path for ending in ENDINGS for path in FOLDER.glob(f"{folder}/*{ending}"))
    return {path.stem: path for path in files}


def resolved(path: str | PathLike[str], beside: Path = Path()) -> Path:
    """The file that `path` means: the one of exactly this path, else the one of this name that comes with tubeopt.

    A path that means neither is returned as it is, for its reader to refuse. `NAME.yaml` is meant only with its ending:
    a warning says so where there is one.

    Args:
        beside: what a relative path is relative to.
    """
    local = beside / path
    named = shipped().get(str(path))
    # A local file goes first: a robot in the working directory is not replaced by a built-in one.
    if named is None or os.path.isfile(local):
        return local
    for ending in ENDINGS:
        other = beside / f"{path}{ending}"
        if other.is_file() and not other.samefile(named):
            LOGGER.warning(f"{path} is the built-in file; the local file is {other}")
    return named


def found(path: str | PathLike[str], folder: str) -> Path:
    """The file that `path` means, as `resolved`; raises InputError with the nearest names in `folder` for a name of
    none."""
    file = resolved(path)
    if os.path.lexists(file) or not NAME.fullmatch(str(path)):
        return file
    raise InputError(f"{path}: there is no such file, and no built-in {ONE[folder]} has this name{alike(path, folder)}")


def alike(path: str | PathLike[str], folder: str = "*") -> str:
    """Return "; did you mean ...?" for a name that is not known, or an empty string where nothing is called alike."""
    own = [f"{path}{ending}" for ending in ENDINGS if Path(f"{path}{ending}").is_file()]
    near = own or difflib.get_close_matches(Path(path).name, shipped(folder), n=MOST, cutoff=ALIKE)
    if near:
        return f"; did you mean {' or '.join(near)}?"
    return "" if folder == "*" else f"; names are {', '.join(shipped(folder))}"


def about(file: Path) -> str:
    """The first sentence of the comment that a file begins with."""
    lines = file.read_text(encoding="utf-8").splitlines()
    comment = [line.lstrip("# ") for line in lines if line.startswith("#") and "yaml-language-server" not in line]
    return re.split(r"(?<=[.?])\s+(?=[A-Z])", " ".join(comment).strip())[0].removesuffix(".")
