"""Equilibria on disk: `result.json` for reading, `arrays.npz` for arrays along the arm. SI units."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import json
import typing
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainSerializer, create_model

from ..arguments import typed
from ..block.transcription.arm import ArmShape, CollocationPoints
from ..errors import InputError
from ..files.checked import check
from ..files.files import atomic_write, read_bytes, read_text, write_text
from ..robots.file import AnyRobot
from ..typing import Array
from .result import Accuracy, Equilibrium, Status

LOAD_FIELDS = ("load", "work", "point_curvature", "friction", "walls")
"""Fields that a file written without loads, friction and walls does not have."""

PARTS = {"arm": ArmShape, "points": CollocationPoints, "accuracy": Accuracy}
"""Parts of an equilibrium with fields that a file stores separately."""

ALONG_THE_ARM = tuple(field.name for field in dataclasses.fields(ArmShape))
"""Arrays with a value per point; all others are short enough to be read in `result.json`."""

TIP = ("tip_position", "tip_rotation")
"""Fields of the arm that a file has for its readers only."""


def _types() -> dict[str, Any]:
    """Names and types of the fields of `result.json`."""
    types: dict[str, Any] = {}
    for name, kind in typing.get_type_hints(Equilibrium).items():
        if name == "arm":
            types |= dict.fromkeys(TIP, Array)
        elif name in PARTS:
            types |= typing.get_type_hints(PARTS[name])
        elif name != "_brief":
            types[name] = kind
    return types


ARRAYS = tuple(name for name, kind in _types().items() if kind == Array)
"""Names of the arrays in `result.json`."""

_StatusByName = Annotated[
    Status,
    BeforeValidator(lambda name: Status.__members__.get(name, name) if isinstance(name, str) else name),
    PlainSerializer(lambda status: status.name),
]


@functools.lru_cache(maxsize=1)
def _record_model() -> type[BaseModel]:
    """The model of `result.json`, derived from `Equilibrium` so that no field can be forgotten."""
    types = _types() | dict.fromkeys(ARRAYS, list[float] | list[list[float]])
    types |= {"status": _StatusByName, "robot": AnyRobot}
    optional = {field.name: field.default for field in dataclasses.fields(Equilibrium) if field.name in LOAD_FIELDS}
    optional["point_curvature"] = []
    fields: dict[str, Any] = {name: (kind, optional.get(name, ...)) for name, kind in types.items()}
    # NaN and infinity, which a failed solve may have, are no JSON numbers: they are written as text.
    config = ConfigDict(extra="forbid", ser_json_inf_nan="strings")
    return create_model("EquilibriumRecord", __config__=config, arrays_sha256=(str, ...), **fields)


def save_equilibrium(equilibrium: Equilibrium, directory: str | PathLike[str]) -> list[Path]:
    """Write `result.json` and `arrays.npz` into `directory`, each whole or not at all, and return their paths.

    Raises:
        InputError: the files cannot be written, or the load is distributed by a function, which no file can hold.
    """
    if equilibrium.load is not None and callable(equilibrium.load.distributed):
        raise InputError("the distributed load is a function; to be saved it must be (3,) or stretches of (3,)")
    result, arrays = Path(directory) / "result.json", Path(directory) / "arrays.npz"
    content = io.BytesIO()
    np.savez(content, **{name: getattr(equilibrium, name) for name in ALONG_THE_ARM})
    values = {name: getattr(equilibrium, name) for name in _types()}
    for name in values.keys() & ARRAYS:
        values[name] = values[name].tolist()
    record = _record_model().model_construct(arrays_sha256=hashlib.sha256(content.getvalue()).hexdigest(), **values)
    with atomic_write(arrays) as temporary:
        temporary.write_bytes(content.getvalue())
    write_text(result, record.model_dump_json(indent=2) + "\n")
    return [result, arrays]


@typed
def load_equilibrium(directory: str | PathLike[str]) -> Equilibrium:
    """Read the equilibrium that `save_equilibrium` wrote into `directory`, equal in every bit.

    Raises:
        InputError: a file is missing, is not what was written, or the two are not of the same solve.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tubeopt.forward_kinematics(robot, [0.5, 0.0]).save(folder)
        ...     tubeopt.load_equilibrium(folder).stable
        True
    """
    result, arrays = Path(directory) / "result.json", Path(directory) / "arrays.npz"
    try:
        record = check(_record_model(), json.loads(read_text(result)), result)
    except json.JSONDecodeError as error:
        raise InputError(f"{result}: not valid JSON: line {error.lineno}: {error.msg}") from None
    values = {name: getattr(record, name) for name in _record_model().model_fields}
    for name in values.keys() & ARRAYS:
        values[name] = np.array(values[name], dtype=float)
    content = read_bytes(arrays)
    if hashlib.sha256(content).hexdigest() != values.pop("arrays_sha256"):
        raise InputError(f"{arrays}: these are not the arrays that belong to {result}")
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        values |= {name: stored[name] for name in ALONG_THE_ARM}
    for name in TIP:
        del values[name]
    for name, kind in PARTS.items():
        values[name] = kind(**{field.name: values.pop(field.name) for field in dataclasses.fields(kind)})
    return Equilibrium(**values)
