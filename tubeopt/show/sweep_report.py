"""What is said about a sweep."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from ..errors import SolveError
from ..runs.sweeping import Sweep
from .quantities import Quantity, described, of_field
from .report import Report

SHOWN = 3
"""Failures that are told; the table has all."""

FAILURE: tuple[Quantity[tuple[int, str]], ...] = (
    Quantity("point", "number of the point, from 1", lambda failed: failed[0] + 1),
    Quantity("reason", "reason for the failure", lambda failed: failed[1]),
)

SWEEP = described(
    Sweep,
    of_field(Sweep, "points", label="points", words=lambda a: _points(a)),
    "computed",
    Quantity("failed", "number of failed points", lambda a: len(a.failures), form="d", label="failed"),
    of_field(Sweep, "failures", of=FAILURE),
    Quantity("table", "file of the table", lambda a: _kept(a, a.table)),
    Quantity("arrays", "file of the same arrays", lambda a: _kept(a, a.arrays)),
    Quantity("journal", "journal: a line per point, in order of computation", lambda a: _kept(a, a.journal)),
    Quantity("rows", "the table, if no directory was given", lambda a: None if a.rows is None else list(a.rows),
             optional=True),
)  # fmt: skip


def _kept(a: Sweep, path: Path) -> str | None:
    """The path of what is kept."""
    return str(path) if a.rows is None else None


def _points(a: Sweep) -> str:
    before = a.points - a.computed
    return f"{a.points}" + (f", {before} of them from an earlier run" if before else "")


class SweepReport(Report[Sweep]):
    command = "sweep"
    quantities = SWEEP

    def table(self) -> RenderableType:
        """What there is to know about it; the table itself, as CSV, where it is not kept."""
        a = self.answer
        if a.rows is None:
            return super().table()
        written = io.StringIO()
        table = csv.DictWriter(written, list(a.rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(a.rows)
        return written.getvalue().rstrip()

    def title(self) -> str:
        return "sweep"

    def rows(self) -> list[tuple[str, str]]:
        """How many points there are, the first failures, and where the table is."""
        a = self.answer
        told = [(f"  point {index + 1}", reason) for index, reason in a.failures[:SHOWN]]
        if len(a.failures) > SHOWN:
            told.append(("", f"and {len(a.failures) - SHOWN} more, in the table"))
        return [*super().rows(), *told, ("table", str(a.table)), ("arrays", str(a.arrays))]

    def tables(self) -> dict[str, Any]:
        """The table, which is CSV and npz already."""
        return {"table": self.answer}

    def conclude(self) -> None:
        """Raise SolveError where every point failed."""
        a = self.answer
        if len(a.failures) == a.points:
            raise SolveError(f"all {a.points} points failed; the first: {a.failures[0][1]}")
