"""What is said about a file that was written to begin with."""

from __future__ import annotations

from ..runs.templates import Written
from .quantities import Quantity
from .report import Report


class WrittenReport(Report[Written]):
    command = "init"
    quantities = (Quantity("then", "a command that uses it", words="{then}", label="next"),)

    def title(self) -> str:
        return ""
