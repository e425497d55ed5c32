"""What the shell proposes for a value: words, names of files that come with tubeopt, and files that are there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..files.shipped import ENDINGS, FOLDER, shipped

Completion = Callable[[str], list[str]]
"""What is typed of a value so far -> the values that begin so."""

MOST = 200
"""Files of a directory that are proposed."""

FOLDERS = {
    "study": "studies",
    "simulate": "rigs",
    "stock": "tubes",
    "measurements": "experiments",
    "log": "experiments",
}
"""Keys whose files are in a folder that is not called as they are."""


def words(choices: Sequence[str]) -> Completion:
    """What completes one of several words."""
    return lambda incomplete: [word for word in choices if word.startswith(incomplete)]


def files(key: str) -> Completion:
    """What completes the file of a key: names of those that come with tubeopt, and paths."""
    near = [FOLDERS.get(key, ""), key, f"{key}s"]
    folder = next((name for name in near if name and (FOLDER / name).is_dir()), "*")

    def complete(incomplete: str) -> list[str]:
        return [name for name in shipped(folder) if name.startswith(incomplete)] + _there(incomplete)

    return complete


def _there(incomplete: str) -> list[str]:
    """Directories and tables or YAML files whose path begins so."""
    above, slash, begins = incomplete.rpartition("/")
    try:
        beside = sorted(path for path in Path(above + slash).iterdir() if path.name.startswith(begins))[:MOST]
    except OSError:
        return []
    return [
        f"{above}{slash}{path.name}{'/' * path.is_dir()}"
        for path in beside
        if (path.is_dir() or path.suffix in ENDINGS) and (begins or not path.name.startswith("."))
    ]
