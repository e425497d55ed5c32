"""Sweeps: a function at many points, each saved as it is done, that go on where a killed run stopped.

`tubeopt sweep` runs studies this way; `sweep` takes any function of a point that returns numbers and text.
"""

from __future__ import annotations

import csv
import hashlib
import pickle
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

from ..display import Displayed
from ..errors import InputError, TimeLimitError, positive
from ..files.journal import Journal
from ..solvers.parallel.executors import Failure, Outcome, each
from .sweep_points import Points
from .sweep_table import flatten, why_failed, write_table

JOURNAL = "journal.jsonl"

Point = Mapping[str, Any]
Answer = Mapping[str, Any]


class Progress(Protocol):
    """Called with how many points are done, how many there are, and how many of those done have failed."""

    def __call__(self, done: int, total: int, failed: int) -> object: ...


@dataclass(frozen=True)
class Sweep(Displayed):
    """Files of a sweep and numbers of its points."""

    points: int
    """Number of points."""
    computed: int
    """Number of points computed by this run; the others were in the journal."""
    failures: tuple[tuple[int, str], ...]
    """Index, from 0, and reason of every point that failed."""
    table: Path
    """Path of table.csv."""
    arrays: Path
    """Path of table.npz."""
    journal: Path
    """Path of journal.jsonl."""
    rows: tuple[Mapping[str, float | str], ...] | None = None
    """The table itself, where the files are not kept."""

    def unkept(self) -> Sweep:
        """The sweep with its table in it, for files that go."""
        with self.table.open(encoding="utf-8", newline="") as lines:
            rows = csv.DictReader(lines)
            return replace(self, rows=tuple({key: _read(cell) for key, cell in row.items()} for row in rows))


def _read(cell: str) -> float | str:
    """A cell of the table: a number, or text."""
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell


SWEEP_LIMIT = 86400.0
"""s: a sweep may last a day; what was done by then is kept."""


def sweep(  # noqa: PLR0913
    function: Callable[[Any], Answer],
    points: Sequence[Point],
    directory: str | PathLike[str],
    *,
    fingerprint: str = "",
    workers: int = 0,
    scheduler: str | None = None,
    retry_failed: bool = False,
    progress: Progress | None = None,
    time_limit: float = SWEEP_LIMIT,
) -> Sweep:
    """`function` at every point, with a journal and a table in `directory`.

    Points and answers are mappings of names to anything that JSON or NumPy supports; nested values become columns such
    as `tip[0]` and `snap.fraction`. An exception at a point is recorded there with its reason. Points in the journal of
    an earlier run with the same points are not computed again.

    Args:
        function: a function of a module, or a `functools.partial` of one, sent to every worker once.
        fingerprint: identifies the sweep; by default it is computed from the function and all points.
        workers, scheduler: as for `tubeopt.solvers.parallel.executors.each`.
        retry_failed: compute failed points of an earlier run again.
        time_limit: maximum run time, s; checked after each point. Points may have their own limits.

    Raises:
        InputError: no function, or no points; the directory contains another sweep, is in use or cannot be written;
            workers or scheduler as in `parallel.executor`.
        SolveError: the connection to the cluster is lost; the journal keeps all finished points.
        TimeLimitError: (a SolveError) the time limit was reached before all points were done; the journal keeps the
            finished ones.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> def square(point):
        ...     return {"y": point["x"] ** 2}
        >>> with tempfile.TemporaryDirectory() as directory:
        ...     points = [{"x": 1.0}, {"x": 3.0}]
        ...     found = tubeopt.sweep(square, points, directory, fingerprint="squares", workers=1)
        ...     [row["y"] for row in found.unkept().rows]
        [1.0, 9.0]
    """
    if not callable(function):
        raise InputError(f"function is {function!r}; it must be a function of a point")
    until = time.monotonic() + positive("time_limit", time_limit)
    points = _checked(points)
    directory = Path(directory)
    mark = fingerprint or _fingerprint(function, points)
    with Journal(directory / JOURNAL, mark, len(points)) as journal:
        done = set(journal.done) - (journal.failed if retry_failed else set())
        left = [index for index in range(len(points)) if index not in done]
        if progress is not None:
            progress(len(done), len(points), len(journal.failed & done))
        chosen = (points[index] for index in left)
        outcomes = each(function, chosen, workers=workers, scheduler=scheduler) if left else iter(())
        for outcome in outcomes:
            index = left[outcome.index]
            journal.append(index, _entry(points[index], outcome))
            done.add(index)
            if progress is not None:
                progress(len(done), len(points), len(journal.failed & done))
            if len(done) < len(points) and time.monotonic() > until:
                raise TimeLimitError(
                    f"sweep reached its time limit of {time_limit:g} s with {len(done)} of "
                    f"{len(points)} points; run the same sweep in the same directory to "
                    "resume"
                )
        table, arrays = write_table(directory, journal.entries)
        failures = tuple((entry["index"], why_failed(entry)) for entry in journal.entries() if "failure" in entry)
        return Sweep(len(points), len(left), failures, table, arrays, journal.path)


def _checked(points: Any) -> Sequence[Point]:
    if isinstance(points, Points):  # which are checked, and made when they are asked for
        return points
    if isinstance(points, (str, Mapping)) or not isinstance(points, Iterable):
        raise InputError(f"points are {type(points).__name__}; they must be a list of mappings of names to values")
    checked = list(points)
    if not checked:
        raise InputError("there are no points; there must be at least one")
    for index, point in enumerate(checked):
        wrong = _no_row(f"points[{index}]", point)
        if wrong:
            raise InputError(wrong)
    return checked


def _entry(point: Point, outcome: Outcome[Answer]) -> dict[str, Any]:
    entry: dict[str, Any] = {"parameters": flatten(point), "seconds": outcome.seconds}
    failure, answer = outcome.failure, outcome.value
    if failure is None:
        wrong = _no_row("the answer", answer)
        failure = Failure("TypeError", wrong) if wrong else None
    if failure is not None:
        return entry | {"failure": asdict(failure)}
    return entry | {"record": flatten(answer or {})}


def _no_row(what: str, data: object) -> str:
    """Why data make no row of a table, or nothing where they do."""
    if not isinstance(data, Mapping):
        return f"{what} is {data!r:.60}; it must be a mapping of names to values"
    row: Mapping[str, Any] = flatten(data)
    for name, value in row.items():
        if value is not None and not isinstance(value, (str, int, float)):
            return f"{what}: {name} is {value!r:.60}; it must be a number or text"
    return ""


def _fingerprint(function: Callable[..., Any], points: Sequence[Point]) -> str:
    digest = hashlib.sha256()
    try:
        digest.update(pickle.dumps(function))
        for point in points:
            digest.update(repr(sorted(point.items())).encode())
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(f"the function cannot be sent to other processes: {error}") from None
    return digest.hexdigest()
