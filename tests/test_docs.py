"""The pages in docs/ say what is true: their examples print what they show."""

from __future__ import annotations

import contextlib
import io
import os
import pkgutil
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tubeopt
from tubeopt.runs.robot_keys import load_entry

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", re.DOTALL)
PAGES = sorted(page for page in (ROOT / "docs").glob("*.md") if EXAMPLE.search(page.read_text(encoding="utf-8")))


NAMES = re.findall(r"^::: (\S+)$", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("name", NAMES)
def test_the_reference_names_what_there_is(name: str) -> None:
    assert pkgutil.resolve_name(name).__doc__


def test_the_reference_shows_the_marks_of_a_field() -> None:
    griffe = pytest.importorskip("griffe")
    extensions = griffe.load_extensions(str(ROOT / ".ci" / "field_marks.py"))
    jump = griffe.load("tubeopt.stability.load_limit", extensions=extensions)["LoadLimit.tip_jump"]
    assert str(jump.annotation) == "float"
    assert jump.docstring.value.startswith("Distance that the tip jumps, m. Distance at the load")


def test_robot_files_of_the_page_load(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "robot-file.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    robots = [block for block in blocks if "kind:" in block]
    assert len(robots) == 4
    for block in robots:
        path = tmp_path / "robot.yaml"
        path.write_text(block, encoding="utf-8")
        robot = tubeopt.load_robot(path)
        assert tubeopt.forward_kinematics(robot, np.zeros(robot.n_tubes)).margin > 0.9
    (load,) = (block for block in blocks if "tip_force_mN" in block)
    (tmp_path / "load.yaml").write_text(load, encoding="utf-8")
    assert load_entry(tmp_path / "load.yaml").build().force == (0.02, 0, 0)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_print_what_the_page_shows(page: Path) -> None:
    if page.stem == "data":
        pytest.importorskip("pandas")
        pytest.importorskip("xarray")
    names: dict[str, Any] = {}
    before = Path.cwd()
    os.chdir(ROOT)
    try:
        for example, shown in EXAMPLE.findall(page.read_text(encoding="utf-8")):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(example, names)
            assert printed.getvalue() == shown
    finally:
        os.chdir(before)
