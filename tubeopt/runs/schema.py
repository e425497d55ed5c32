"""JSON Schemas of robot and study files, for editors: `python -m tubeopt.runs.schema [DIRECTORY]`."""

from __future__ import annotations

import functools
import json
import operator
import sys
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from ..files.checked import Entry
from ..files.files import write_text
from ..robots.file import ROBOT_KINDS
from .mold_file import MOLD_KINDS
from .obstacle_file import ObstacleFile
from .rig_file import RIG_KINDS
from .stock_file import STOCK_KINDS
from .study_file import STUDY_KINDS
from .sweep_file import SweepEntry
from .target_file import JointsFile


class _Numbers(GenerateJsonSchema):
    """Decimals are what numbers are read as; in the file they are numbers, not text."""

    def decimal_schema(self, schema: core_schema.DecimalSchema) -> JsonSchemaValue:
        bounds: dict[str, Any] = {key: float(schema[key]) for key in ("gt", "ge", "lt", "le") if key in schema}
        number: JsonSchemaValue = {"type": "number"}
        self.update_with_validations(number, bounds, self.ValidationsMapping.numeric)
        return number

    def encode_default(self, dft: Any) -> Any:
        return float(dft) if isinstance(dft, Decimal) else super().encode_default(dft)

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False  # the key says it


def _schema(kinds: Mapping[str, type[Entry]], title: str) -> str:
    union: Any = functools.reduce(operator.or_, kinds.values())
    schema = TypeAdapter(union).json_schema(schema_generator=_Numbers)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(head | schema | {"title": title}, indent=2) + "\n"


def schemas() -> dict[str, str]:
    """File name -> JSON Schema, as text."""
    return {
        "joints.schema.json": _schema({"joints": JointsFile}, "tubeopt joint values"),
        "obstacles.schema.json": _schema({"obstacles": ObstacleFile}, "tubeopt obstacles"),
        "mold.schema.json": _schema(MOLD_KINDS, "tubeopt mold"),
        "rig.schema.json": _schema(RIG_KINDS, "tubeopt rig"),
        "robot.schema.json": _schema(ROBOT_KINDS, "tubeopt robot"),
        "study.schema.json": _schema({**STUDY_KINDS, "sweep": SweepEntry}, "tubeopt study"),
        "tubes.schema.json": _schema(STOCK_KINDS, "tubeopt stock of tubes"),
    }


def write_schemas(directory: str | Path = "configs/schema") -> list[Path]:
    """Write the schemas into `directory` and return their paths; raises InputError where that cannot be."""
    paths = []
    for name, text in schemas().items():
        paths.append(Path(directory) / name)
        write_text(paths[-1], text)
    return paths


if __name__ == "__main__":
    for path in write_schemas(*sys.argv[1:2]):
        print(path)
