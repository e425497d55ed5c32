"""What is said about a robot that was written as a C library."""

from __future__ import annotations

from ..control.c_library import CLibrary
from .quantities import Quantity, described
from .report import Report

LIBRARY = described(
    CLibrary,
    "name",
    Quantity("tubes", "number of tubes", lambda a: a.robot.n_tubes),
    "prefix",
    Quantity("sources", "files of the library", lambda a: list(a.files), label="files",
             words=lambda a: ", ".join(a.files)),
    Quantity("lines", "lines of C", lambda a: sum(
        text.count("\n") for file, text in a.files.items() if file.endswith((".c", ".h")))),
)  # fmt: skip


class CLibraryReport(Report[CLibrary]):
    command = "export"
    quantities = LIBRARY
    file = "library.json"

    def title(self) -> str:
        return f"{self.answer.name} in C"
