"""Sweeps: a function at many points, each saved as it is done, that continue where a killed run stopped.

`tubeopt sweep` runs studies this way; `sweep` takes any function of a point that returns numbers and text.
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

# --- points: what varies, over a grid or a sample of its values -------------------------------------------------------

METHODS = ("grid", "random", "sobol", "latin_hypercube")

MOST_POINTS = 10**7

Value = float | str | bool


@dataclass(frozen=True)
class Axis:
    """Keys that take the same values."""

    keys: tuple[str, ...]
    values: tuple[Value, ...] | None = None
    """Of a list; None for the range from `low` to `high`."""
    low: float = 0.0
    high: float = 0.0
    count: int = 0
    """Values of the range on a grid."""

    @property
    def places(self) -> int:
        """How many values it has on a grid."""
        return self.count if self.values is None else len(self.values)

    def on_grid(self, place: int) -> Value:
        """The value at a place on a grid, from 0; those of a range to 15 digits, ends included."""
        if self.values is not None:
            return self.values[place]
        return self.at(place / (self.count - 1) if self.count > 1 else 0.0)

    def at(self, unit: float) -> Value:
        """The value at a number from 0 to 1."""
        if self.values is not None:
            # Equal shares of 0 to 1; 1 itself belongs to the last value.
            return self.values[min(int(unit * len(self.values)), len(self.values) - 1)]
        # 15 digits: 0.1 * 3 becomes 0.3, and both ends are exact.
        return float(f"{(1 - unit) * self.low + unit * self.high:.15g}")


@dataclass(frozen=True)
class Points(Sequence[dict[str, Value]]):
    """All points of a sweep, in a fixed order; each gives every key its value.

    Raises:
        InputError: unknown method, no axis, a key on two axes, a sample without count, more than ten million points.
    """

    axes: tuple[Axis, ...]
    method: str = "grid"
    """One of `METHODS`."""
    total: int = 0
    """Of a sample; a grid has its own number."""
    seed: int = 0
    """Of a sample."""

    def __post_init__(self) -> None:
        choice("sample.method", self.method, METHODS)
        if not self.axes:
            raise InputError("vary is empty; it must name at least one key")
        for key in self.keys:
            if self.keys.count(key) > 1:
                raise InputError(f"vary {key}: it is given {self.keys.count(key)} times; it must be given once")
        if self.method == "grid":
            object.__setattr__(self, "total", math.prod(axis.places for axis in self.axes))
        if not 1 <= self.total <= MOST_POINTS:
            raise InputError(f"the sweep has {self.total} points; there must be 1 to {MOST_POINTS}")

    @property
    def keys(self) -> tuple[str, ...]:
        """All keys that vary."""
        return tuple(key for axis in self.axes for key in axis.keys)

    def __len__(self) -> int:
        return self.total

    def __getitem__(self, index):  # type: ignore[no-untyped-def]
        """The value of every key at a point, from 0, or a list of points. On a grid the last axis runs fastest."""
        if isinstance(index, slice):
            return [self[k] for k in range(self.total)[index]]
        index = range(self.total)[index]
        if self.method == "grid":
            places = np.unravel_index(index, [axis.places for axis in self.axes])
            chosen = [axis.on_grid(int(k)) for axis, k in zip(self.axes, places, strict=True)]
        else:
            units = _sample(self.method, len(self.axes), self.total, self.seed)[index]
            chosen = [axis.at(float(unit)) for axis, unit in zip(self.axes, units, strict=True)]
        return {key: value for axis, value in zip(self.axes, chosen, strict=True) for key in axis.keys}


# Every point takes its row of the whole sample, which would be drawn anew for each.
@functools.lru_cache(maxsize=4)
def _sample(method: str, dimension: int, count: int, seed: int) -> np.ndarray:
    """(count, dimension) numbers from 0 to 1."""
    if method == "random":
        return np.random.default_rng(seed).random((count, dimension))
    if method == "latin_hypercube":
        return np.asarray(scipy.stats.qmc.LatinHypercube(dimension, rng=seed).random(count))
    return sobol(dimension, count, seed)


# --- table: a row per point, in CSV to read and in npz to compute with ------------------------------------------------

# Six joint values, three coordinates and nine entries of a rotation are columns; shapes of 100 points are not.
LONGEST_LIST = 16
"""Longer lists of an answer, curves and maps, are left out of the table."""

NOT_A_RESULT = ("statistics", "files", "seconds")
"""Keys of a study's answer, at any depth, that say how it was found, which differs from run to run."""

FIXED = ("point", "status", "reason")
"""Columns of every table: the number of the point, from 1; done or failed; why it failed."""

Entries = Callable[[], Iterable[Mapping[str, Any]]]
"""Lines of a journal by index, as often as they are asked for."""


def flatten(record: Mapping[str, Any], leave: Sequence[str] = ()) -> dict[str, float | str | bool | None]:
    """An answer as one row: `snap.before.margin`, `tip_position_mm[2]`; keys to leave out are so at any depth."""
    return {path: value for key in record if key not in leave for path, value in _flat(key, record[key], leave)}


def _flat(path: str, value: Any, leave: Sequence[str]) -> Iterator[tuple[str, float | str | bool | None]]:
    # Before the test for lists: arrays become lists of plain numbers.
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key not in leave:
                yield from _flat(f"{path}.{key}", inner, leave)
    elif isinstance(value, (list, tuple)):
        if len(value) <= LONGEST_LIST:
            for k, inner in enumerate(value):
                yield from _flat(f"{path}[{k}]", inner, leave)
    else:
        yield path, value


def write_table(directory: Path, entries: Entries) -> list[Path]:
    """Write table.csv and table.npz of journal lines; return their paths.

    The rows stand in the order of the points, whatever the order in which they were computed.

    Raises:
        InputError: the files cannot be written.
    """
    columns = _columns(entries)
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


def _columns(entries: Entries) -> list[str]:
    """Names of all columns: parameters before results."""
    parameters: dict[str, None] = {}
    results: dict[str, None] = {}
    for entry in entries():
        parameters.update(dict.fromkeys(entry["parameters"]))
        results.update(dict.fromkeys(entry.get("record", {})))
    return list(dict.fromkeys([FIXED[0], *parameters, *FIXED[1:], *results]))


def _row(entry: Mapping[str, Any]) -> dict[str, Any]:
    reason = why_failed(entry)
    fixed = {"point": entry["index"] + 1, "status": "failed" if reason else "done", "reason": reason}
    return {**entry.get("record", {}), **entry["parameters"], **fixed}


def why_failed(entry: Mapping[str, Any]) -> str:
    """Why a point failed, from its line in the journal; empty where it did not."""
    failure = entry.get("failure")
    return f"{failure['kind']}: {failure['reason']}" if failure else ""


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return " ".join(value.split()) if isinstance(value, str) else repr(value)


def _array(values: Sequence[Any]) -> np.ndarray:
    """A column: numbers (nan where there is none), or text."""
    # JSON has no NaN: the journal keeps such numbers as words.
    known = [value for value in values if value is not None and value not in ("NaN", "Infinity", "-Infinity")]
    if all(isinstance(value, (bool, int, float)) for value in known):
        return np.array([np.nan if value is None else float(value) for value in values])
    return np.array([_cell(value) for value in values])


# --- the run ----------------------------------------------------------------------------------------------------------

JOURNAL = "journal.jsonl"

Point = Mapping[str, Any]
Answer = Mapping[str, Any]


class Progress(Protocol):
    """Called with how many points are done, how many there are, and how many of those done have failed."""

    def __call__(self, done: int, total: int, failed: int) -> object: ...


@dataclass(frozen=True)
class Sweep(Displayed):
    """Files of a sweep and numbers of its points."""

    points: Annotated[int, "number of points"]
    computed: Annotated[int, "points computed by this run"]
    """The others were in the journal."""
    failures: Annotated[tuple[tuple[int, str], ...], "the failed points"]
    """Index, from 0, and reason of each."""
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
            # Sorted: the order of keys does not change a point.
            digest.update(repr(sorted(point.items())).encode())
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(f"the function cannot be sent to other processes: {error}") from None
    return digest.hexdigest()
