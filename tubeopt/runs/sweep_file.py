"""Sweeps as YAML: a study, and which of its keys vary over which values.

    kind: sweep
    study: {kind: forward_kinematics, robot: ../robots/thesis_ctr.yaml, rotations_deg: [0, 0, 0]}
    vary:
      - {key: "rotations_deg[0]", from: 0, to: 360, count: 37}
      - {key: "robot.tubes[0].curvature_per_m", values: [6, 8, 10]}

Keys are paths in the study; through `robot`, `rig` and `mold` they go on into the files of those.
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
from ..files.shipped import found, resolved
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
"""Keys of studies that name files into which keys that vary go on."""


def _value(value: object) -> Value:
    if isinstance(value, (bool, str)):
        return value
    return float(decimal(value))


class VaryEntry(Entry):
    """One or several keys with common values: a list or a range."""

    key: str | list[str] = Field(
        description="path of the key, such as rotations_deg[0], or a list of keys with equal values"
    )
    values: list[Annotated[Value, BeforeValidator(_value)]] | None = Field(
        None, min_length=1, description="list of values, instead of a range"
    )
    lowest: Number | None = Field(None, alias="from", description="one end of a range")
    highest: Number | None = Field(None, alias="to", description="the other end")
    count: Annotated[Whole, Field(ge=1)] | None = Field(None, description="number of values in the range, for a grid")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        has_range = self.lowest is not None and self.highest is not None
        if (self.values is None) != has_range or (self.lowest is None) != (self.highest is None):
            raise ValueError("must give values, or from and to")
        if self.values is not None and self.count is not None:
            raise ValueError("gives values and a count; a count is for from and to")
        return self

    def build(self, method: str) -> Axis:
        """The axis of the points; raises InputError where a grid has no count."""
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
    """A sweep as its file describes it."""

    data: Data
    """The study's; robot, rig and mold are loaded, or as data where their own keys vary."""
    where: Path
    """The study's file."""
    points: Points
    fingerprint: str
    """A mark that tells it from others."""
    columns: tuple[str, ...] | None = None
    """Beginnings of the names that are kept; None for all."""

    def function(self, summarise: Callable[[Any], Mapping[str, Any]]) -> Callable[[Any], Mapping[str, Any]]:
        """The study as a function of a point, for the workers of a sweep; `summarise` turns its answer into plain data,
        and must be a function of a module."""
        return functools.partial(self._at, summarise)

    def _at(self, summarise: Callable[[Any], Mapping[str, Any]], values: Mapping[str, Value]) -> Mapping[str, Any]:
        """The answer at one point; raises InputError and SolveError as the study does."""
        # Workers reuse the study for every point.
        data = copy.deepcopy(self.data)
        for key, value in values.items():
            _put(data, key, value if isinstance(value, (bool, str)) else Decimal(repr(value)))
        for name, build in FILES.items():
            if isinstance(data.get(name), dict):
                data[name] = build(data[name], name)
        record = flatten(summarise(self._study(data).run()), NOT_A_RESULT)
        if self.columns is None:
            return record
        for column in self.columns:
            _begins_a_result(column, list(record))
        return {key: value for key, value in record.items() if key.startswith(self.columns)}

    def _study(self, data: Data) -> Study:
        try:
            return cast(Study, check_kind(STUDY_KINDS, data, self.where))
        except InputError as error:  # of this point, not of the file, which is as it should be
            raise InputError(str(error).replace(f"{self.where}: ", "")) from None


def _begins_a_result(column: str, results: list[str]) -> None:
    """Raise InputError for a column of no result; parts of results that only some points have are no mistake."""
    # "snap.fraction" is missing where no snap was found, but "snap" is there.
    names = {re.split(r"[.\[]", result)[0] for result in results}
    if not any(result.startswith(column) for result in results) and re.split(r"[.\[]", column)[0] not in names:
        raise InputError(f"columns: no result begins with {column!r}{nearest(column, names)}")


def load_sweep(path: str | PathLike[str]) -> SweepFile:
    """The sweep in a YAML file, its study and robot loaded.

    Raises:
        InputError: no such file, not YAML, keys or values that make no sweep or no study, a key to vary that the study
            does not have. Values that make no robot are the failure of their own points.
    """
    path = found(path, "studies")
    source, typed = load_yaml(path), str(path)
    entry = check(SweepEntry, source, path)
    path = Path(path).absolute()
    try:
        method = "grid" if entry.sample is None else entry.sample.method
        axes = tuple(each.build(method) for each in entry.vary)
        count, seed = (0, 0) if entry.sample is None else (entry.sample.count, entry.sample.seed)
        points = Points(axes, method, count, seed)
        data, where = _study(source["study"], path)
        # Before files are loaded: their content belongs to the mark, not their objects.
        fingerprint = _fingerprint(data, where, source)
        for name in FILES:
            # A robot whose keys do not vary is built once, not at every point.
            data = _with_file(name, data, where, points.keys)
        for key in points.keys:
            _known(data, key)
    except InputError as error:
        lines = str(error).replace(str(path), typed).splitlines()
        raise InputError("\n".join(line if typed in line else f"{typed}: {line}" for line in lines)) from None
    columns = None if entry.columns is None else tuple(entry.columns)
    return SweepFile(data, where, points, fingerprint, columns)


def _study(study: str | Data, path: Path) -> tuple[Data, Path]:
    """Data of the study and the file that they are from, checked as they stand."""
    where = path
    if isinstance(study, str):
        where = resolved(study, path.parent)
        study = load_yaml(where)
    check_kind(STUDY_KINDS, study, where)
    return dict(study), where


def _with_file(name: str, data: Data, where: Path, keys: tuple[str, ...]) -> Data:
    """The study with what is in a file that it names: as data where keys go into it, else built."""
    if not isinstance(data.get(name), str) or name in keys:
        return data
    file = resolved(data[name], where.parent)
    content = _anchored(load_yaml(file), file.parent)
    inside = any(key.startswith(f"{name}.") for key in keys)
    return {**data, name: content if inside else FILES[name](content, data[name])}


def _anchored(data: Any, directory: Path) -> Any:
    """What is in a file, with the tables that it names to be found from anywhere."""
    if isinstance(data, dict):
        named = {key: isinstance(value, str) and key == "table" for key, value in data.items()}
        # A sweep runs in other directories, and perhaps on other machines of a cluster.
        return {k: str(directory / v) if named[k] else _anchored(v, directory) for k, v in data.items()}
    return [_anchored(value, directory) for value in data] if isinstance(data, list) else data


_PART = re.compile(r"(\w+)|\[(\d+)\]")


def _parts(key: str) -> list[str | int]:
    """`tubes[0].curvature_per_m` as its steps."""
    if not re.fullmatch(r"\w+(\[\d+\]|\.\w+)*", key):
        raise InputError(f"vary {key}: this is not a path of a key; it must be like rotations_deg[0] or robot.name")
    return [name or int(number) for name, number in _PART.findall(key)]


def _known(data: Data, key: str) -> None:
    """Raise InputError where the study has no such key."""
    *way, last = _parts(key)
    place: Any = data
    for k, part in enumerate([*way, last]):
        at = path_of([*way, last][:k])
        if isinstance(part, int):
            if not isinstance(place, list) or part >= len(place):
                size = f"a list of {len(place)}, counted from 0" if isinstance(place, list) else shown(place)
                raise InputError(f"vary {key}: {at} is {size}; it has no [{part}]")
        elif not isinstance(place, dict) or part not in place:
            fields = list(STUDY_KINDS[data["kind"]].model_fields) if k == 0 else []
            if k == len(way) and part in fields:
                return
            names = list(place) if isinstance(place, dict) else []
            what = f"{at} has" if at else "the study gives"
            give = "; give it a value first" if part in fields else nearest(part, names)
            raise InputError(f"vary {key}: {what} no {part}{give}")
        place = place[part]


def _put(data: Data, key: str, value: object) -> None:
    *way, last = _parts(key)
    place: Any = data
    for part in way:
        place = place[part]
    place[last] = value


def _fingerprint(data: Data, where: Path, source: Data) -> str:
    """A mark of everything that the results follow from: the keys of the file, and the files that they name."""
    digest = hashlib.sha256(json.dumps([source, data], default=str, sort_keys=True).encode())
    for content in _named(data, where.parent, set()):
        digest.update(content)
    return digest.hexdigest()


def _named(data: object, directory: Path, seen: set[Path]) -> Iterator[bytes]:
    """Contents of the files that are named in data, and in those files."""
    for text in _texts(data):
        # Any text may be a path. Longer ones, or with a null byte, would raise an error of the system.
        file = resolved(text, directory).resolve() if len(text) < 1024 and "\0" not in text else directory
        # Files may name each other in a circle.
        if file.is_file() and file not in seen:
            seen.add(file)
            yield file.read_bytes()
            if file.suffix in (".yaml", ".yml"):
                yield from _named(load_yaml(file), file.parent, seen)


def _texts(data: object) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        for value in data.values():
            yield from _texts(value)
    elif isinstance(data, list):
        for value in data:
            yield from _texts(value)
