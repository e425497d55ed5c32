"""The JSON Schemas in configs/schema say what the files are checked against."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from tubeopt.runs.schema import PAGE, page, schemas, write_schemas

CONFIGS = Path(__file__).parents[2] / "configs"
WRITTEN = sorted(path.name for path in (CONFIGS / "schema").glob("*.schema.json"))


@lru_cache
def made() -> dict[str, str]:
    """Schemas of the code; made when a test asks, since all workers load this module and few run its tests."""
    return schemas()


@lru_cache
def validator(name: str) -> Any:
    """Of files of a kind; checked itself."""
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(made()[f"{name}.schema.json"])
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", WRITTEN)
def test_the_files_are_in_step(name: str) -> None:
    written = (CONFIGS / "schema" / name).read_text(encoding="utf-8")
    assert written == made()[name], "run `python -m tubeopt.runs.schema`"


def test_schemas_are_written_to_directory(tmp_path: Path) -> None:
    assert {path.name for path in write_schemas(tmp_path / "schema")} == set(made()) == set(WRITTEN)
    assert json.loads((tmp_path / "schema" / "robot.schema.json").read_text())["title"] == "tubeopt robot"


def test_bounds_are_rounded() -> None:
    """-40 degC is 233.15 K, and not -40.00000000000002 degC."""
    unrounded = re.compile(r'"\w*[mM](?:in|ax)imum": -?\d*\.\d{11,}')
    assert [name for name, text in made().items() if unrounded.search(text)] == []


def test_the_page_is_in_step() -> None:
    assert (CONFIGS.parent / PAGE).read_text(encoding="utf-8") == page(), "run `python -m tubeopt.runs.schema`"


def test_page_names_choices_once() -> None:
    for row in page().splitlines():
        output, _, allowed = row.rstrip(" |").rpartition("; ")
        choices = re.findall(r"[\w-]+", allowed.replace(" or ", " "))
        if " or " in allowed and set(allowed.split(" or ")) == set(choices):
            assert not all(re.search(rf"(?<![\w-]){word}(?![\w-])", output) for word in choices), row


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*/*.yaml")), ids=lambda path: path.stem)
def test_every_file_passes_its_schema(path: Path) -> None:
    name = {
        "studies": "study",
        "molds": "mold",
        "ovens": "oven",
        "rigs": "rig",
        "tubes": "tubes",
        "joints": "joints",
        "obstacles": "obstacles",
    }.get(path.parent.name, "robot")
    assert list(validator(name).iter_errors(yaml.safe_load(path.read_text(encoding="utf-8")))) == []


def test_bounds_and_units_are_in_the_schema() -> None:
    tube = json.loads(made()["robot.schema.json"])["$defs"]["TubeEntry"]
    assert tube["properties"]["outer_diameter_mm"] == {"exclusiveMinimum": 0, "type": "number"}
    assert tube["additionalProperties"] is False
