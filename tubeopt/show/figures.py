"""Pictures of an answer for a paper: each with its caption and its data, and the command that made them."""

from __future__ import annotations

import platform
import re
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import TO_MM
from .page import HEADINGS
from .report import Report, file_name


@dataclass(frozen=True)
class Journal:
    """Requirements of a publisher for pictures."""

    width_mm: int
    """Width of one column."""
    format: str
    fonts: tuple[str, ...]
    """Font families in order of preference."""


JOURNALS = {
    "ieee": Journal(88, "pdf", ("Helvetica", "Arial", "Liberation Sans", "Nimbus Sans")),
    "elsevier": Journal(90, "pdf", ("Arial", "Helvetica", "Liberation Sans", "Nimbus Sans")),
    "springer": Journal(84, "tiff", ("Helvetica", "Arial", "Liberation Sans", "Nimbus Sans")),
    "sage": Journal(88, "tiff", ("Arial", "Helvetica", "Liberation Sans", "Nimbus Sans")),
}
"""Name on the command line -> requirements of its publisher."""


@dataclass(frozen=True)
class Figures:
    """Result with pictures for a paper."""

    shown: Report[Any]
    """Report on the result."""
    command: str
    """Command line that made the pictures."""


class FigureReport(Report[Figures]):
    """Report as of the own command, with a caption and data for each picture."""

    def record(self) -> dict[str, Any]:
        return self.answer.shown.record()

    def table(self) -> RenderableType:
        return self.answer.shown.table()

    def save(self, directory: Path) -> list[Path]:
        """Write the files of the study's command, the centrelines of its arms (CSV), and command.txt."""
        from .plots.style import families

        paths = self.answer.shown.save(directory)
        for name, arm in self.answer.shown.solids().items():
            paths.append(directory / f"{name}_centreline.csv")
            rows = TO_MM * np.column_stack([arm.arc_length, arm.position])
            write_text(paths[-1], to_csv(["s_mm", "x_mm", "y_mm", "z_mm"], rows.tolist()))
        paths.append(directory / "command.txt")
        versions = f"tubeopt {version('tubeopt')}, Python {platform.python_version()}"
        versions += f", Matplotlib {version('matplotlib')}"
        write_text(paths[-1], f"{self.answer.command}\n{versions}, letters {families()[0]}\n")
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write every picture without a heading, its data (CSV) where it has scales, and captions.txt."""
        from .plots.figure import drawn_data

        paths, captions = list[Path](), list[str]()
        for name, draw in self.answer.shown.pictures().items():
            picture = directory / file_name(name)
            headings: list[str] = []
            # A context variable reaches all pictures without an argument through every plot function.
            token = HEADINGS.set(headings)
            try:
                figure = draw(picture)
            finally:
                HEADINGS.reset(token)
            paths.append(picture)
            captions.append(f"{picture.name}: {_caption(headings)}")
            if rows := list(drawn_data(figure)):
                paths.append(picture.with_name(f"{picture.stem}_data.csv"))
                write_text(paths[-1], to_csv(["panel", "curve", "x", "y", "value"], rows))
        paths.append(directory / "captions.txt")
        write_text(paths[-1], "\n".join(captions) + "\n")
        return paths

    def conclude(self) -> None:
        self.answer.shown.conclude()


def _caption(headings: list[str]) -> str:
    """The headings of a picture, which it does not have itself, as a sentence."""
    lines = [line.rstrip(",:") for heading in dict.fromkeys(headings) for line in heading.split("\n")]
    return f"{re.sub(r' {2,}', ' ', '; '.join(lines)) or 'No heading'}. Computed with tubeopt {version('tubeopt')}."
