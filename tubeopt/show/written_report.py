"""What is said about a file that was written to begin with."""

from __future__ import annotations

from ..runs.templates import Written
from .quantities import Quantity
from .report import Report


class WrittenReport(Report[Written]):
    command = "init"
    quantities = (Quantity("then", "command that uses the file", words="{then}", label="next"),)

    def title(self) -> str:
        return ""
