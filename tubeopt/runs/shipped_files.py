"""List of the built-in files, which are used by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ..display import Displayed
from ..files.field_metadata import key
from ..files.shipped import FOLDER, description_of, shipped
from ..files.yaml_file import load_yaml
from ..robots.file import robot_from_dict


@dataclass(frozen=True)
class ShippedFile(Displayed):
    """Built-in file."""

    name: Annotated[str, "name for commands"]

    folder: Annotated[str, "folder: robots, rigs, studies, ..."]

    kind: Annotated[str | None, "its key `kind`; null without one"]

    n_tubes: Annotated[int | None, key("tubes"), "number of tubes of a robot"]

    about: Annotated[str, "description"]


@dataclass(frozen=True)
class ShippedFiles(Displayed):
    """Built-in files of one folder, or all."""

    files: tuple[ShippedFile, ...]
    """Sorted by folder and name."""


def shipped_folders() -> tuple[str, ...]:
    """Names of the folders of built-in files."""
    return tuple(sorted({path.parent.name for path in shipped().values()}))


def shipped_files(folder: str = "*") -> ShippedFiles:
    """Built-in files of a folder; of all folders by default."""
    listed = sorted(shipped(folder).values(), key=lambda path: path.relative_to(FOLDER))
    return ShippedFiles(tuple(map(_described, listed)))


def _described(path: Path) -> ShippedFile:
    folder = path.parent.name
    data = load_yaml(path) if path.suffix == ".yaml" else {}
    n_tubes = robot_from_dict(data, path).n_tubes if folder == "robots" else None
    return ShippedFile(path.stem, folder, data.get("kind"), n_tubes, description_of(path))
