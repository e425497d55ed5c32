"""Reports on built-in files, and on a file that was written to begin with."""

from __future__ import annotations

from ..runs.shipped_files import ShippedFile, ShippedFiles
from ..runs.templates import Written
from .quantities import Quantity, described
from .report import Report

FILE = described(ShippedFile)


class ShippedReport(Report[ShippedFiles]):
    command = "list"
    quantities = (Quantity("shipped", "the files", lambda a: a.files, of=FILE),)
    file = "shipped.json"

    def table(self) -> str:
        """A line per file, however long, so that it can be searched; of robots with their tubes, not the folder."""
        files = self.answer.files
        if {file.folder for file in files} == {"robots"}:
            rows = [("name", "kind", "tubes"), *((f.name, f.kind or "", str(f.n_tubes)) for f in files)]
        else:
            rows = [("name", "folder", "kind"), *((f.name, f.folder, f.kind or "") for f in files)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        said = ["", *(f.about[:1].upper() + f.about[1:] for f in files)]
        lines = ("  ".join([*map(str.ljust, row, widths), words]) for row, words in zip(rows, said, strict=True))
        return "\n".join(line.rstrip() for line in lines)


class WrittenReport(Report[Written]):
    command = "init"
    quantities = (Quantity("then", "command that uses the file", words="{then}", label="next"),)

    def title(self) -> str:
        return ""
