"""JSON Schemas of all files, for editors, and the page of the docs about them: `python -m tubeopt.runs.schema`."""

from __future__ import annotations

import functools
import json
import operator
import re
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
from .rig_file import COLOUR_KINDS, RIG_KINDS
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
        if isinstance(dft, list):
            return [self.encode_default(each) for each in dft]
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
        "oxide_colours.schema.json": _schema(COLOUR_KINDS, "tubeopt colours of the oxide"),
        "obstacles.schema.json": _schema({"obstacles": ObstacleFile}, "tubeopt obstacles"),
        "mold.schema.json": _schema(MOLD_KINDS, "tubeopt mold"),
        "rig.schema.json": _schema(RIG_KINDS, "tubeopt rig"),
        "robot.schema.json": _schema(ROBOT_KINDS, "tubeopt robot"),
        "study.schema.json": _schema({**STUDY_KINDS, "sweep": SweepEntry}, "tubeopt study"),
        "tubes.schema.json": _schema(STOCK_KINDS, "tubeopt stock of tubes"),
    }


PAGE = "docs/files.md"

INTRODUCTION = """# Files

What the keys of a file may be. A key ends in the unit of its number. The second column has its default, or says that it
is required; where that is empty the key may be left out. Editors complete the keys by the schemas in `configs/schema/`;
messages name a wrong key with the one that was probably meant.

A whole robot, whose tubes are listed inner to outer; `configs/robots/` has twenty more:

```yaml
kind: concentric
name: my robot
tubes:
  - {outer_diameter_mm: 1.1, inner_diameter_mm: 0.9, straight_length_mm: 150, curved_length_mm: 60, radius_mm: 80}
  - {outer_diameter_mm: 1.6, inner_diameter_mm: 1.3, straight_length_mm: 80, curved_length_mm: 50, curvature_per_m: 9}
```

This page is written by `python -m tubeopt.runs.schema` from the models that files are checked against.
"""


def page() -> str:
    """The page of the docs about files, as Markdown: a table of keys for every mapping in them."""
    lines = [INTRODUCTION]
    told: set[str] = set()
    for name, text in schemas().items():
        schema = json.loads(text)
        lines += [f"## {schema['title'].removeprefix('tubeopt ').capitalize()} (`{name}`)", ""]
        parts = [("", schema)] if "properties" in schema else []
        for title, part in [*parts, *schema.get("$defs", {}).items()]:
            if "properties" in part and title not in told:
                told |= {title} if title else set()
                lines += [f"### {_title(title)}", ""] if title else []
                lines += [part.get("description", "").split("\n\n")[0].replace("\n", " "), ""]
                lines += ["| key | by default | |", "|---|---|---|"]
                required = part.get("required", ())
                lines += [_row(key, value, key in required) for key, value in part["properties"].items()]
                lines.append("")
    return "\n".join(lines)


def _title(name: str) -> str:
    """The name of a model as the page calls it."""
    return name.rpartition("__")[2].removesuffix("Entry")


def _row(key: str, value: dict[str, Any], required: bool) -> str:
    default = value.get("default")
    shown = "required" if required else "" if default is None else f"`{json.dumps(default)}`"
    said, allowed = value.get("description", ""), _allowed(value)
    choices = allowed.split(" or ")
    if len(choices) > 1 and all(re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", said) for word in choices):
        allowed = ""  # the description names every one
    words = [said, allowed]
    return f"| `{key}` | {shown} | {'; '.join(word for word in words if word)} |"


def _allowed(value: dict[str, Any]) -> str:
    """What a key may be: its words, the bounds of its number, or the mapping that it is."""
    if "const" in value:
        return str(value["const"])
    if "enum" in value:
        return " or ".join(str(word) for word in value["enum"])
    if "$ref" in value:
        title = _title(value["$ref"].rpartition("/")[2])
        return f"{'an' if title[0] in 'AEIO' else 'a'} {title}"
    signs = {"exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below", "maximum": "at most"}
    found = [f"{words} {value[sign]:g}" for sign, words in signs.items() if sign in value]
    inner = [_allowed(each) for each in (*value.get("anyOf", ()), *value.get("oneOf", ()))]
    inner += [_allowed(value["items"])] if isinstance(value.get("items"), dict) else []
    return ", ".join(found) or " or ".join(dict.fromkeys(word for word in inner if word))


def write_schemas(directory: str | Path = "configs/schema") -> list[Path]:
    """Write the schemas into `directory` and return their paths; raises InputError where that cannot be."""
    paths = []
    for name, text in schemas().items():
        paths.append(Path(directory) / name)
        write_text(paths[-1], text)
    return paths


if __name__ == "__main__":
    write_text(PAGE, page())
    for path in (PAGE, *write_schemas()):
        print(path)
