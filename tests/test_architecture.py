"""The page on the architecture names what is there, and its picture shows the contract of the packages."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def drawn() -> ModuleType:
    """The script that draws the picture."""
    spec = importlib.util.spec_from_file_location("packages", ROOT / ".ci" / "packages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_picture_is_that_of_the_contract(drawn: ModuleType) -> None:
    assert drawn.PICTURE.read_text(encoding="utf-8") == drawn.picture(), "run python .ci/packages.py"


def test_every_package_has_its_row(drawn: ModuleType) -> None:
    packages = {path.parent.name for path in (ROOT / "tubeopt").glob("*/__init__.py")} | {"gym", "plot"}
    floors = [name for floor in drawn.floors() for name in floor]
    assert packages <= set(floors)
    listed = re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE)
    assert listed == [name for name in floors if name in packages]


def test_ten_steps_name_files_and_functions_that_are_there() -> None:
    steps = re.findall(r"^(\d+)\. ", PAGE, re.MULTILINE)
    assert steps == [str(k) for k in range(1, 11)] * 3
    files = re.findall(r"`([\w/]+/(?:\w+\.py)?)`", PAGE)
    assert len(files) > 12
    for file in files:
        assert (ROOT / "tubeopt" / file).exists(), file
    for file, name in re.findall(r"`([\w/]+\.py)`: `(\w+)(?:\.\w+)?`", PAGE):
        text = (ROOT / "tubeopt" / file).read_text(encoding="utf-8")
        assert re.search(rf"^(?:def|class) {name}\b", text, re.MULTILINE), f"{name} in {file}"
