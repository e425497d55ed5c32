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


NAME = re.compile(r"(?<!`)`((?:[A-Za-z_]\w*\.)*[A-Za-z_]\w*)(?:\(\))?`(?!`)")
GENERATED = {"files", "json"}
"""Pages that are written from the code."""
FILE_ENDS = {"csv", "h", "json", "md", "nc", "npz", "py", "txt", "yaml"}
FOREIGN = {"crtk_python_client", "robot_state_publisher", "move_cr", "move_jp", "move_jr", "servo_cr", "servo_cv"} | {
    *("servo_jr", "servo_jv", "Restoration_Failed", "Search_Direction_Becomes_Too_Small", "alpha_pr", "PlateToPatient"),
    *("domain_rand", "extension_action_limit", "goal_tolerance_parameters", "max_steps_per_episode", "n_substeps"),
    *("rotation_action_limit", "select_systems", "_GPa", "TUBEOPT_WHEEL", "CLOCK_MONOTONIC"),
    *("bronchialTree", "hepaticArtery", "hepaticVein", "pleuralBoundary", "portalVein"),
}
"""Names of other programs, of builds, and of parts of names."""
COMPOSED = re.compile(r"^(pos|[qrxyz]|[xyz]axis|r\d\d|arms|base|lid)_[xyz\d_]+(_m|_mm|_at_least_mm)?$")
"""Columns and files named by axes and numbers."""


def test_pages_name_what_there_is() -> None:
    """Public paths resolve; other identifiers and modules occur in the code, or are keys of a schema."""
    sources = [*ROOT.glob("tubeopt/**/*.py"), *ROOT.glob("tubeopt/**/*.h"), *ROOT.glob("configs/**/*.json")]
    sources += [*ROOT.glob("benchmarks/*.py"), ROOT / "docs" / "json.md"]
    known = {word for path in sources for word in re.findall(r"[A-Za-z_]\w*", path.read_text(encoding="utf-8"))}
    known |= {path.stem for path in (*ROOT.glob("benchmarks/*.py"), *ROOT.glob("configs/**/*.yaml"))}
    missing = []
    for page in sorted(path for path in (ROOT / "docs").glob("*.md") if path.stem not in GENERATED):
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for module in re.findall(r"`([a-z_]+(?:/\w+)*/\w+\.py)`", text):
            if not (ROOT / "tubeopt" / module).exists() and not (ROOT / module).exists():
                missing.append(f"{page.name}: {module}")
        for name in set(NAME.findall(text)):
            if name.startswith("tubeopt."):
                pkgutil.resolve_name(name)
            elif re.search(r"[a-z_][A-Z_]|_", name) and name.rpartition(".")[2] not in FILE_ENDS:
                inner = [part for part in name.split(".") if part not in known | FOREIGN and not COMPOSED.match(part)]
                # Parameters of a fit are a kind with the number of a tube or the name of an axis.
                missing += [
                    f"{page.name}: {name}" for part in inner if re.sub(r"(_\d|_[xyz])+$", "", part) not in known
                ]
    assert missing == []


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
