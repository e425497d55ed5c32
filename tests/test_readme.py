"""The README says what is true: its example prints what it shows, its commands exist."""

from __future__ import annotations

import contextlib
import io
import os
import re
from pathlib import Path
from typing import Any

from tubeopt.cli.app import program

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_example_prints_what_the_readme_shows() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (shown,) = re.findall(r"```text\n(.*?)```", README, re.DOTALL)
    printed = io.StringIO()
    before = Path.cwd()
    os.chdir(ROOT)
    try:
        with contextlib.redirect_stdout(printed):
            exec(example, {})
    finally:
        os.chdir(before)
    assert printed.getvalue() == shown


def commands(group: Any, words: str = "") -> set[str]:
    """Full names of the commands of a group and of the groups in it."""
    names: set[str] = set()
    for name, command in group.commands.items():
        inner = hasattr(command, "commands")
        names |= commands(command, f"{words}{name} ") if inner else {words + name}
    return names


def test_table_lists_every_command() -> None:
    listed = re.findall(r"^\| `tubeopt ([a-z -]+?)(?: [A-Z]|`)", README, re.MULTILINE)
    assert sorted(listed) == sorted(commands(program()))


def test_links_lead_somewhere() -> None:
    for page in (README, *(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))):
        base = ROOT if page is README else ROOT / "docs"
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page):
            assert (base / target).exists(), target
