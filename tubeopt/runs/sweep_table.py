"""The table of a sweep: a row per point, in CSV to read and in npz to compute with."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..files.files import atomic_write, save_arrays

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
    known = [value for value in values if value is not None and value not in ("NaN", "Infinity", "-Infinity")]
    if all(isinstance(value, (bool, int, float)) for value in known):
        return np.array([np.nan if value is None else float(value) for value in values])
    return np.array([_cell(value) for value in values])
