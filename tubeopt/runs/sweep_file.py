"""Sweeps as YAML: a study, and the keys that vary with their values.

    kind: sweep
    study: {kind: forward_kinematics, robot: ../robots/thesis_ctr.yaml, rotations_deg: [0, 0, 0]}
    vary:
      - {key: "rotations_deg[0]", from: 0, to: 360, count: 37}
      - {key: "robot.tubes[0].curvature_per_m", values: [6, 8, 10]}

Keys are paths in the study; paths through `robot`, `rig` and `mold` continue into their files.
"""

from __future__ import annotations

import copy
import functools
import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

from pydantic import BeforeValidator, Field, model_validator

from ..errors import InputError, nearest
from ..files.checked import Entry, Number, Whole, check, check_kind, path_of
from ..files.shipped import find_file, resolve_file
from ..files.units import decimal, shown
from ..files.yaml_file import load_yaml
from ..robots.file import robot_from_dict
from .study_file import STUDY_KINDS, Study
from .sweeping import NOT_A_RESULT, Axis, Points, Value, flatten
from .workshop_file import mold_spec_from_dict, rig_from_dict

Data = dict[str, Any]

FILES: dict[str, Callable[[object, str], Any]] = {
    "robot": robot_from_dict,
    "rig": rig_from_dict,
    "mold": mold_spec_from_dict,
}
"""Keys of studies that name a file with variable keys -> function that builds the object from its data."""


def _as_value(value: object) -> Value:
    if isinstance(value, (bool, str)):
        return value
    return float(decimal(value))


class VaryEntry(Entry):
    """Keys with common values: a list or a range."""

    key: str | list[str] = Field(
        description="path of the key, such as rotations_deg[0], or a list of keys with equal values"
    )
    values: list[Annotated[Value, BeforeValidator(_as_value)]] | None = Field(
        None, min_length=1, description="list of values, instead of a range"
    )
    lowest: Number | None = Field(None, alias="from", description="one end of a range")
    highest: Number | None = Field(None, alias="to", description="the other end")
    count: Annotated[Whole, Field(ge=1)] | None = Field(None, description="number of values in the range, for a grid")

    @model_validator(mode="after")
    def _values_or_range(self) -> Self:
        has_range = self.lowest is not None and self.highest is not None
        if (self.values is None) != has_range or (self.lowest is None) != (self.highest is None):
            raise ValueError("must give values, or from and to")
        if self.values is not None and self.count is not None:
            raise ValueError("gives values and a count; a count is for from and to")
        return self

    def build(self, method: str) -> Axis:
        """Axis of the points; raises InputError if a grid has no count."""
        keys = (self.key,) if isinstance(self.key, str) else tuple(self.key)
        if self.values is not None:
            return Axis(keys, tuple(self.values))
        if method == "grid" and self.count is None:
            raise InputError(f"vary {keys[0]}: count is missing; a grid needs the number of values from {self.lowest}")
        return Axis(keys, None, float(self.lowest or 0), float(self.highest or 0), self.count or 0)


class SampleEntry(Entry):
    """Random points within the ranges, instead of a grid."""

    method: Literal["random", "sobol", "latin_hypercube"] = Field(
        "sobol", description="sampling method: random, sobol or latin_hypercube"
    )
    count: Annotated[Whole, Field(ge=1)] = Field(description="number of points")
    seed: Annotated[Whole, Field(ge=0)] = Field(0, description="random seed")


class SweepEntry(Entry):
    """A study at many values of its keys."""

    kind: Literal["sweep"]
    study: str | dict[str, Any] = Field(description="a study, or the path of its file, relative to this file")
    vary: list[VaryEntry] = Field(min_length=1)
    sample: SampleEntry | None = Field(None, description="random points to draw; default the grid of all values")
    columns: list[str] | None = Field(
        None, min_length=1, description="results to save, given by the beginning of their names; default all"
    )


@dataclass(frozen=True)
class SweepFile:
    """Contents of a sweep file."""

    data: Data
    """Data of the study. Robot, rig and mold are loaded objects, or data if their own keys vary."""
    where: Path
    """Path of the study file."""
    points: Points
    fingerprint: str
    """Hash of all inputs of the results."""
    columns: tuple[str, ...] | None = None
    """Prefixes of the saved results; None for all."""

    def function(self, summarise: Callable[[Any], Mapping[str, Any]]) -> Callable[[Any], Mapping[str, Any]]:
        """Return the study as a function of a point, for the workers of a sweep.

        Args:
            summarise: function of a module that converts an answer of the study to plain data.
        """
        return functools.partial(self._at, summarise)

    def _at(self, summarise: Callable[[Any], Mapping[str, Any]], values: Mapping[str, Value]) -> Mapping[str, Any]:
        """Run the study at one point; raises InputError and SolveError as the study."""
        # Workers use the same data for every point.
        data = copy.deepcopy(self.data)
        for key, value in values.items():
            _put(data, key, value if isinstance(value, (bool, str)) else Decimal(repr(value)))
        for name, build in FILES.items():
            if isinstance(data.get(name), dict):
                data[name] = build(data[name], name)
        record = flatten(summarise(self._study(data).run()), NOT_A_RESULT)
        if self.columns is None:
            return record
        # Some results exist only at some points: "snap.fraction" is missing if there is no snap, but not "snap".
        names = {re.split(r"[.\[]", result)[0] for result in record}
        for column in self.columns:
            if not any(name.startswith(column) for name in record) and re.split(r"[.\[]", column)[0] not in names:
                raise InputError(f"columns: no result begins with {column!r}{nearest(column, names)}")
        return {key: value for key, value in record.items() if key.startswith(self.columns)}

    def _study(self, data: Data) -> Study:
        try:
            return cast(Study, check_kind(STUDY_KINDS, data, self.where))
        except InputError as error:
            # The point is wrong, not the file.
            raise InputError(str(error).replace(f"{self.where}: ", "")) from None


def load_sweep(path: str | PathLike[str]) -> SweepFile:
    """Load a sweep from a YAML file, with its study and robot.

    Raises:
        InputError: no such file, not YAML, invalid keys or values of sweep or study, or a varied key that the study
            does not have. Invalid values of a varied key are failures of their points.
    """
    path = find_file(path, "studies")
    source, given_path = load_yaml(path), str(path)
    entry = check(SweepEntry, source, path)
    path = Path(path).absolute()
    try:
        method = "grid" if entry.sample is None else entry.sample.method
        axes = tuple(each.build(method) for each in entry.vary)
        count, seed = (0, 0) if entry.sample is None else (entry.sample.count, entry.sample.seed)
        points = Points(axes, method, count, seed)
        data, where = _study(source["study"], path)
        # Before files are loaded: the hash includes their content, not the objects.
        fingerprint = _fingerprint(data, where, source)
        for name in FILES:
            # A robot whose keys do not vary is built once, not at every point.
            if isinstance(data.get(name), str) and name not in points.keys:
                file = resolve_file(data[name], where.parent)
                content = _with_absolute_tables(load_yaml(file), file.parent)
                varies = any(key.startswith(f"{name}.") for key in points.keys)
                data = {**data, name: content if varies else FILES[name](content, data[name])}
        for key in points.keys:
            _check_key(data, key)
    except InputError as error:
        lines = str(error).replace(str(path), given_path).splitlines()
        raise InputError("\n".join(line if given_path in line else f"{given_path}: {line}" for line in lines)) from None
    columns = None if entry.columns is None else tuple(entry.columns)
    return SweepFile(data, where, points, fingerprint, columns)


def _study(study: str | Data, path: Path) -> tuple[Data, Path]:
    """Load and check the data of the study; returns them with the path of their file."""
    where = path
    if isinstance(study, str):
        where = resolve_file(study, path.parent)
        study = load_yaml(where)
    check_kind(STUDY_KINDS, study, where)
    return dict(study), where


def _with_absolute_tables(data: Any, directory: Path) -> Any:
    """Data of a file with absolute paths of its tables: a sweep runs in other directories, or on a cluster."""
    if isinstance(data, dict):
        return {
            key: str(directory / value)
            if key == "table" and isinstance(value, str)
            else _with_absolute_tables(value, directory)
            for key, value in data.items()
        }
    return [_with_absolute_tables(value, directory) for value in data] if isinstance(data, list) else data


_PART = re.compile(r"(\w+)|\[(\d+)\]")


def _parts(key: str) -> list[str | int]:
    """Parts of a path such as `tubes[0].curvature_per_m`."""
    if not re.fullmatch(r"\w+(\[\d+\]|\.\w+)*", key):
        raise InputError(f"vary {key}: this is not a path of a key; it must be like rotations_deg[0] or robot.name")
    return [name or int(number) for name, number in _PART.findall(key)]


def _check_key(data: Data, key: str) -> None:
    """Raise InputError if the study has no such key."""
    parts = _parts(key)
    node: Any = data
    for k, part in enumerate(parts):
        path = path_of(parts[:k])
        if isinstance(part, int):
            if not isinstance(node, list) or part >= len(node):
                size = f"a list of {len(node)}, counted from 0" if isinstance(node, list) else shown(node)
                raise InputError(f"vary {key}: {path} is {size}; it has no [{part}]")
        elif not isinstance(node, dict) or part not in node:
            fields = list(STUDY_KINDS[data["kind"]].model_fields) if k == 0 else []
            if len(parts) == 1 and part in fields:
                return
            names = list(node) if isinstance(node, dict) else []
            subject = f"{path} has" if path else "the study gives"
            hint = "; give it a value first" if part in fields else nearest(part, names)
            raise InputError(f"vary {key}: {subject} no {part}{hint}")
        node = node[part]


def _put(data: Data, key: str, value: object) -> None:
    *parents, last = _parts(key)
    node: Any = data
    for part in parents:
        node = node[part]
    node[last] = value


def _fingerprint(data: Data, where: Path, source: Data) -> str:
    """Hash of all inputs of the results: the keys of the file, and the contents of the named files."""
    digest = hashlib.sha256(json.dumps([source, data], default=str, sort_keys=True).encode())
    for content in _named_files(data, where.parent, set()):
        digest.update(content)
    return digest.hexdigest()


def _named_files(data: object, directory: Path, visited: set[Path]) -> Iterator[bytes]:
    """Contents of the files that are named in data or in these files."""
    for text in _texts(data):
        # Any text may be a path. The system refuses longer paths, and null bytes.
        file = resolve_file(text, directory).resolve() if len(text) < 1024 and "\0" not in text else directory
        # Files may name each other in a circle.
        if file.is_file() and file not in visited:
            visited.add(file)
            yield file.read_bytes()
            if file.suffix in (".yaml", ".yml"):
                yield from _named_files(load_yaml(file), file.parent, visited)


def _texts(data: object) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        for value in data.values():
            yield from _texts(value)
    elif isinstance(data, list):
        for value in data:
            yield from _texts(value)
