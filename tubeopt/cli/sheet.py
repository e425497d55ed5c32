"""`tubeopt mold sheet`: the sheet with marks for photos of tubes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from ..runs.templates import WrittenFile
from ..shaping.mold.photo import SHEET_MARKS
from ..show.plots.tube_photo import plot_mark_sheet
from ..show.reports import report
from .flags import command
from .output import OF_PICTURES, Output, can_be_saved, present


@command("tubeopt mold sheet marks.pdf", without=("out", *OF_PICTURES))
def sheet(
    output: Output,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = Path("marks.pdf"),
) -> None:
    """Write the sheet with four marks for photos of tubes, to print on A4 or Letter.

    Print it at 100 % and measure the distances of its marks. If they differ from the printed ones, give them to
    `tubeopt mold measure` by --marks-mm.
    """
    if file.suffix != ".pdf":
        raise InputError(f"{file}: the name of the sheet must end in .pdf")
    if file.is_dir():
        raise InputError(f"{file}: this is a directory; it must be a file")
    can_be_saved(file.parent)
    plot_mark_sheet(SHEET_MARKS, file)
    present(report(WrittenFile("tubeopt mold measure PHOTO")), output, written=[file])
