"""The check of texts (`.ci/prose.py`) finds each kind of fault, and its catalogue has every command and flag."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

from tubeopt.cli.app import program

ROOT = Path(__file__).resolve().parents[1]


def _loaded() -> Any:
    spec = importlib.util.spec_from_file_location("prose", ROOT / ".ci" / "prose.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["prose"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


PROSE = _loaded()


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("The robot's margin falls by 0.3 at 22 mN.", ""),
        ("The tool is told the margin.", "'told'"),
        ("Use some 640 samples.", "'some 640'"),
        ("The tube whose end moves.", "'whose'"),
        ("Of the tube.", "begins with 'Of'"),
        ("Of them, `told` is code.", "begins with 'Of'"),
        ("One two " * 20, "a sentence of 40 words"),
        ("Do it in this way.", ""),
    ],
)
def test_a_fault_is_found(text: str, found: str) -> None:
    faults = list(PROSE.faults(PROSE.Text("part", "here", text, description=True)))
    assert [found in each for each in faults] == ([True] if found else [])


@pytest.mark.parametrize("words", ["Of the tube.", "(N, 3) of the tip, m.", "Whether it moves.", "its end"])
def test_a_docstring_that_begins_with_no_noun_is_found(words: str) -> None:
    """Also those of fields and of functions that are not public."""
    code = f'class A:\n    x: int\n    """{words}"""\n\n\ndef _f():\n    """{words}"""\n'
    assert [each.split(":")[1] for each in PROSE._openings("a.py", code)] == ["3", "7"]
    assert list(PROSE._openings("a.py", code.replace(words, "(N, 3) position of the tip, m."))) == []


def test_every_rule_of_the_style_guide_matches_its_own_words() -> None:
    pattern, instead = PROSE.rules()
    assert len(instead) > 50
    for phrase, words in instead.items():
        assert pattern.fullmatch(phrase.replace("#", "6")), phrase
        assert words, phrase


def test_a_page_is_read_without_code() -> None:
    page = "# Title\n\nOne line\nand `code` more.\n\n```python\ntold\n```\n\n| a | b |\n- item\n"
    read = [(text.where, text.text) for text in PROSE._page("page.md", page)]
    assert read == [
        ("page.md:1", "# Title"),
        ("page.md:3", "One line and `code` more."),
        ("page.md:10", "a"),
        ("page.md:10", "b"),
        ("page.md:11", "- item"),
    ]


@pytest.fixture(scope="module")
def catalogue() -> list[Any]:
    """All texts that users read."""
    return list(PROSE.texts())


def test_the_catalogue_has_every_flag_with_words(catalogue: list[Any]) -> None:
    seen = {text.where for text in catalogue if text.part == "help"}
    for name, command in program().commands.items():
        for inner, one in getattr(command, "commands", {"": command}).items():
            full = f"tubeopt {name} {inner}".strip()
            assert full in seen
            missing = [each.opts[0] for each in one.command.params if f"{full} {each.opts[0]}" not in seen]
            assert missing in ([], ["help"], ["--help"]), full


def test_messages_keys_labels_and_docstrings_are_in_the_catalogue(catalogue: list[Any]) -> None:
    parts = {text.part.split()[0] for text in catalogue}
    assert {"help", "message", "key", "label", "docstring", "README.md"} <= parts
