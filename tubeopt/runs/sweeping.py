"""Sweeps: a function at many points. Each result is saved at once, and an interrupted run continues.

`tubeopt sweep` does so for studies; `sweep` takes any function of a point that returns numbers and text.
"""

from __future__ import annotations

import csv
import functools
import hashlib
import math
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
import scipy

from ..display import Displayed
from ..errors import InputError, TimeLimitError, choice, positive
from ..files.files import Journal, atomic_write, save_arrays
from ..solvers.parallel import Failure, Outcome, each
from ..solvers.sampling import sobol

# --- points of a grid or a random sample ------------------------------------------------------------------------------

METHODS = ("grid", "random", "sobol", "latin_hypercube")

MAX_POINTS = 10**7
"""Largest number of points."""

Value = float | str | bool


@dataclass(frozen=True)
class Axis:
    """Keys with common values."""

    keys: tuple[str, ...]
    values: tuple[Value, ...] | None = None
    """Listed values; None for the range from `low` to `high`."""
    low: float = 0.0
    high: float = 0.0
    count: int = 0
    """Number of values of the range on a grid."""

    @property
    def size(self) -> int:
        """Number of values on a grid."""
        return self.count if self.values is None else len(self.values)

    def on_grid(self, index: int) -> Value:
        """Value at an index on a grid. A range includes both ends."""
        if self.values is not None:
            return self.values[index]
        return self.at(index / (self.count - 1) if self.count > 1 else 0.0)

    def at(self, unit: float) -> Value:
        """Value at a fraction from 0 to 1 of the axis; a range is rounded to 15 digits."""
        if self.values is not None:
            # Each value has an equal part of 0 to 1; 1 itself belongs to the last value.
            return self.values[min(int(unit * len(self.values)), len(self.values) - 1)]
        # 15 digits: 0.1 * 3 becomes 0.3, and both ends are exact.
        return float(f"{(1 - unit) * self.low + unit * self.high:.15g}")


@dataclass(frozen=True)
class Points(Sequence[dict[str, Value]]):
    """Points of a sweep in a fixed order; each maps every key to its value.

    Raises:
        InputError: unknown method, no axis, a key on two axes, a sample without count, more than ten million points.
    """

    axes: tuple[Axis, ...]
    method: str = "grid"
    """Grid or sampling method, from `METHODS`."""
    total: int = 0
    """Number of points; computed for a grid."""
    seed: int = 0
    """Random seed of a sample."""

    def __post_init__(self) -> None:
        choice("sample.method", self.method, METHODS)
        if not self.axes:
            raise InputError("vary is empty; it must name at least one key")
        for key in self.keys:
            if self.keys.count(key) > 1:
                raise InputError(f"vary {key}: it is given {self.keys.count(key)} times; it must be given once")
        if self.method == "grid":
            object.__setattr__(self, "total", math.prod(axis.size for axis in self.axes))
        if not 1 <= self.total <= MAX_POINTS:
            raise InputError(f"the sweep has {self.total} points; there must be 1 to {MAX_POINTS}")

    @property
    def keys(self) -> tuple[str, ...]:
        """Varied keys."""
        return tuple(key for axis in self.axes for key in axis.keys)

    def __len__(self) -> int:
        return self.total

    def __getitem__(self, index):  # type: ignore[no-untyped-def]
        """Point at an index, or list of points for a slice. On a grid the last axis varies fastest."""
        if isinstance(index, slice):
            return [self[k] for k in range(self.total)[index]]
        index = range(self.total)[index]
        if self.method == "grid":
            indices = np.unravel_index(index, [axis.size for axis in self.axes])
            chosen = [axis.on_grid(int(k)) for axis, k in zip(self.axes, indices, strict=True)]
        else:
            units = _sample(self.method, len(self.axes), self.total, self.seed)[index]
            chosen = [axis.at(float(unit)) for axis, unit in zip(self.axes, units, strict=True)]
        return {key: value for axis, value in zip(self.axes, chosen, strict=True) for key in axis.keys}


# Every point needs one row of the whole sample; the cache avoids drawing it again for each.
@functools.lru_cache(maxsize=4)
def _sample(method: str, dimension: int, count: int, seed: int) -> np.ndarray:
    """Draw a sample of the unit cube, shape (count, dimension)."""
    if method == "random":
        return np.random.default_rng(seed).random((count, dimension))
    if method == "latin_hypercube":
        return np.asarray(scipy.stats.qmc.LatinHypercube(dimension, rng=seed).random(count))
    return sobol(dimension, count, seed)


# --- table with a row per point, as CSV and npz -----------------------------------------------------------------------

# Joint values, coordinates and the nine entries of a rotation are columns; shapes of 100 points are not.
MAX_COLUMNS = 16
"""Longest list of an answer that becomes columns of the table."""

NOT_A_RESULT = ("statistics", "files", "seconds")
"""Keys of an answer, at any depth, that differ from run to run."""

FIXED = ("point", "status", "reason")
"""Columns of every table: number of the point, from 1; done or failed; reason of a failure."""

Entries = Callable[[], Iterable[Mapping[str, Any]]]
"""Function that reads the lines of a journal, sorted by index."""


def flatten(record: Mapping[str, Any], leave: Sequence[str] = ()) -> dict[str, float | str | bool | None]:
    """Convert an answer to one row with columns such as `snap.before.margin`, without the keys `leave` at any depth."""
    return {path: value for key in record if key not in leave for path, value in _flat(key, record[key], leave)}


def _flat(path: str, value: Any, leave: Sequence[str]) -> Iterator[tuple[str, float | str | bool | None]]:
    # Before the test for lists: arrays become lists of plain numbers.
    if hasattr(value, "tolist"):  # an array
        value = value.tolist()
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key not in leave:
                yield from _flat(f"{path}.{key}", inner, leave)
    elif isinstance(value, (list, tuple)):
        if len(value) <= MAX_COLUMNS:
            for k, inner in enumerate(value):
                yield from _flat(f"{path}[{k}]", inner, leave)
    else:
        yield path, value


def write_table(directory: Path, entries: Entries) -> list[Path]:
    """Write table.csv and table.npz from journal lines, sorted by point; returns their paths.

    Raises:
        InputError: the files cannot be written.
    """
    parameters: dict[str, None] = {}
    results: dict[str, None] = {}
    for entry in entries():
        parameters.update(dict.fromkeys(entry["parameters"]))
        results.update(dict.fromkeys(entry.get("record", {})))
    columns = list(dict.fromkeys([FIXED[0], *parameters, *FIXED[1:], *results]))
    text = directory / "table.csv"
    with atomic_write(text) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for entry in entries():
            row = _row(entry)
            writer.writerow([_cell(row.get(column)) for column in columns])
    # The journal is read again for each column, so that only numbers are in memory, not all lines.
    stored = {column: _array([_row(entry).get(column) for entry in entries()]) for column in columns}
    return [text, save_arrays(directory / "table.npz", **stored)]


def _row(entry: Mapping[str, Any]) -> dict[str, Any]:
    reason = why_failed(entry)
    fixed = {"point": entry["index"] + 1, "status": "failed" if reason else "done", "reason": reason}
    return {**entry.get("record", {}), **entry["parameters"], **fixed}


def why_failed(entry: Mapping[str, Any]) -> str:
    """Reason of a failed point, from its line in the journal; "" for a successful one."""
    failure = entry.get("failure")
    return f"{failure['kind']}: {failure['reason']}" if failure else ""


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return " ".join(value.split()) if isinstance(value, str) else repr(value)


def _array(values: Sequence[Any]) -> np.ndarray:
    """Column of numbers, with NaN for missing values, or of text."""
    # JSON has no NaN: the journal has such numbers as text.
    known = [value for value in values if value is not None and value not in ("NaN", "Infinity", "-Infinity")]
    if all(isinstance(value, (bool, int, float)) for value in known):
        return np.array([np.nan if value is None else float(value) for value in values])
    return np.array([_cell(value) for value in values])


# --- the run ----------------------------------------------------------------------------------------------------------

JOURNAL = "journal.jsonl"

Point = Mapping[str, Any]
Answer = Mapping[str, Any]


class Progress(Protocol):
    """Callback with the numbers of finished, of all, and of failed points."""

    def __call__(self, done: int, total: int, failed: int) -> object: ...


@dataclass(frozen=True)
class Sweep(Displayed):
    """Files of a sweep and numbers of its points."""

    points: Annotated[int, "number of points"]
    computed: Annotated[int, "points computed by this run"]
    """Other points come from the journal."""
    failures: Annotated[tuple[tuple[int, str], ...], "the failed points"]
    """Index, from 0, and reason of each failed point."""
    table: Path
    """Path of the CSV table."""
    arrays: Path
    """Path of the npz table."""
    journal: Path
    """Path of the journal, JSON lines."""
    rows: tuple[Mapping[str, float | str], ...] | None = None
    """Rows of the table, if they are in memory."""

    def unkept(self) -> Sweep:
        """Sweep with the rows of its table in memory, since its files will be deleted."""
        with self.table.open(encoding="utf-8", newline="") as lines:
            rows = csv.DictReader(lines)
            return replace(self, rows=tuple({key: _read(cell) for key, cell in row.items()} for row in rows))


def _read(cell: str) -> float | str:
    """Convert a cell of the table to a number, if possible."""
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell


SWEEP_LIMIT = 86400.0
"""Default time limit of a sweep, s: one day. Finished points are kept."""


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
    """Evaluate a function at every point, with a journal and a table in `directory`.

    Points and answers are mappings of names to anything that JSON or NumPy supports; nested values become columns such
    as `tip[0]` and `snap.fraction`. An exception at a point is recorded there with its reason. Points in the journal of
    an earlier run with the same points are not computed again.

    Args:
        function: a function of a module, or a `functools.partial` of one, sent to every worker once.
        fingerprint: identifies the sweep; by default it is computed from the function and all points.
        workers, scheduler: as for `tubeopt.solvers.parallel.each`.
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
        ...     result = tubeopt.sweep(square, points, directory, fingerprint="squares", workers=1)
        ...     [row["y"] for row in result.unkept().rows]
        [1.0, 9.0]
    """
    if not callable(function):
        raise InputError(f"function is {function!r}; it must be a function of a point")
    until = time.monotonic() + positive("time_limit", time_limit)
    points = _checked(points)
    directory = Path(directory)
    fingerprint = fingerprint or _fingerprint(function, points)
    with Journal(directory / JOURNAL, fingerprint, len(points)) as journal:
        # Failures are kept by default: the same input fails again.
        done = set(journal.done) - (journal.failed if retry_failed else set())
        left = [index for index in range(len(points)) if index not in done]
        if progress is not None:
            progress(len(done), len(points), len(journal.failed & done))
        # A generator: points of a large grid are made when a worker is free.
        chosen = (points[index] for index in left)
        outcomes = each(function, chosen, workers=workers, scheduler=scheduler) if left else iter(())
        for outcome in outcomes:
            index = left[outcome.index]
            journal.append(index, _entry(points[index], outcome))
            done.add(index)
            if progress is not None:
                progress(len(done), len(points), len(journal.failed & done))
            # After the last point there is nothing to stop.
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
    if isinstance(points, Points):  # checked when they were created
        return points
    if isinstance(points, (str, Mapping)) or not isinstance(points, Iterable):
        raise InputError(f"points are {type(points).__name__}; they must be a list of mappings of names to values")
    checked = list(points)
    if not checked:
        raise InputError("there are no points; there must be at least one")
    for index, point in enumerate(checked):
        if problem := _row_problem(f"points[{index}]", point):
            raise InputError(problem)
    return checked


def _entry(point: Point, outcome: Outcome[Answer]) -> dict[str, Any]:
    entry: dict[str, Any] = {"parameters": flatten(point), "seconds": outcome.seconds}
    failure, answer = outcome.failure, outcome.value
    if failure is None:
        problem = _row_problem("the answer", answer)
        failure = Failure("TypeError", problem) if problem else None
    if failure is not None:
        return entry | {"failure": asdict(failure)}
    return entry | {"record": flatten(answer or {})}


def _row_problem(what: str, data: object) -> str:
    """Reason why data are no row of a table; "" if they are one."""
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
            # Sorted: the order of keys does not change a point.
            digest.update(repr(sorted(point.items())).encode())
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(f"the function cannot be sent to other processes: {error}") from None
    return digest.hexdigest()
