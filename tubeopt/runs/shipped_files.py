"""What comes with tubeopt and is typed by its name, as a list."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ..display import Displayed
from ..files.field_metadata import key
from ..files.shipped import FOLDER, about, shipped
from ..files.yaml_file import load_yaml
from ..robots.file import robot_from_dict


@dataclass(frozen=True)
class ShippedFile(Displayed):
    """A file that comes with tubeopt."""

    name: Annotated[str, "name for commands"]

    folder: Annotated[str, "folder: robots, rigs, studies, ..."]

    kind: Annotated[str | None, "its key `kind`; null without one"]

    n_tubes: Annotated[int | None, key("tubes"), "number of tubes of a robot"]

    about: Annotated[str, "description"]


@dataclass(frozen=True)
class ShippedFiles(Displayed):
    """The files of one folder, or all."""

    files: tuple[ShippedFile, ...]
    """Folder by folder, in the order of their names."""


def shipped_folders() -> tuple[str, ...]:
    """The folders of files that come with tubeopt."""
    return tuple(sorted({path.parent.name for path in shipped().values()}))


def shipped_files(folder: str = "*") -> ShippedFiles:
    """The files in a folder of those that come with tubeopt, by default in all."""
    listed = sorted(shipped(folder).values(), key=lambda path: path.relative_to(FOLDER))
    return ShippedFiles(tuple(map(_described, listed)))


def _described(path: Path) -> ShippedFile:
    folder = path.parent.name
    data = load_yaml(path) if path.suffix == ".yaml" else {}
    n_tubes = robot_from_dict(data, path).n_tubes if folder == "robots" else None
    return ShippedFile(path.stem, folder, data.get("kind"), n_tubes, about(path))
