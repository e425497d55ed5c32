"""The README says what is true: its robot, commands and pictures are there, its example prints what it shows."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

import pytest

from tests.command_line import Run
from tubeopt.cli.app import program

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_it_is_short() -> None:
    assert len(README.split()) <= 500


def test_the_robot_of_six_lines(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (robot,) = re.findall(r"```yaml\n(.*?)```", README, re.DOTALL)
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (shown,) = re.findall(r"```text\n(.*?)```", README, re.DOTALL)
    (command,) = re.findall(r"^    tubeopt (fk robot.yaml .*)", README, re.MULTILINE)
    assert len(robot.splitlines()) == 6
    (tmp_path / "robot.yaml").write_text(robot, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(example, {})
    assert printed.getvalue() == shown
    assert run(*command.split(), "--quiet").code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["robot.yaml", "shape.png", "torsion.png"]


def test_its_pictures_are_there_and_small() -> None:
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert len(pictures) == 10
    assert all((ROOT / path).stat().st_size < 6e5 for path in pictures)


def commands(group: Any, words: str = "") -> set[str]:
    """Full names of the commands of a group and of the groups in it."""
    names: set[str] = set()
    for name, command in group.commands.items():
        inner = hasattr(command, "commands")
        names |= commands(command, f"{words}{name} ") if inner else {words + name}
    return names


def test_table_lists_every_command() -> None:
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `tubeopt ([a-z -]+?)(?: [A-Z]|`)", page, re.MULTILINE)
    assert sorted(listed) == sorted(commands(program()))


def test_links_lead_somewhere() -> None:
    for page in (README, *(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))):
        base = ROOT if page is README else ROOT / "docs"
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page):
            assert (base / target).exists(), target
