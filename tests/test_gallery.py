"""The gallery of the site has a page for every problem, made from the script itself."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def gallery() -> Any:
    """The hook of MkDocs."""
    spec = importlib.util.spec_from_file_location("tubeopt_gallery", ROOT / ".ci" / "gallery.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("script", sorted((ROOT / "problems").glob("*.py")), ids=lambda script: script.stem)
def test_every_problem_says_what_is_asked_and_what_one_learns(gallery: Any, script: Path) -> None:
    problem = gallery.read_problem(script, None)
    page = gallery.page(problem)
    assert problem.asked in page
    assert "## Result" in page
    assert script.read_text(encoding="utf-8") in page
    assert all(f"images/{picture.name}" in page for picture in problem.pictures)
    assert f"({problem.name}.md)" in gallery.index([problem])


def test_a_page_shows_what_the_script_printed(gallery: Any, tmp_path: Path) -> None:
    script = ROOT / "problems" / "thesis_hysteresis.py"
    with pytest.raises(ValueError, match=r"thesis_hysteresis\.py: its run has left no record"):
        gallery.read_problem(script, tmp_path)
    record = {"pictures": ["thesis_hysteresis.png"], "printed": "forth: snaps at 214.222427 deg\n", "coarse": False}
    (tmp_path / "thesis_hysteresis.json").write_text(json.dumps(record))
    problem = gallery.read_problem(script, tmp_path)
    assert problem.pictures == (tmp_path / "thesis_hysteresis.png",)
    assert "```text\nforth: snaps at 214.222427 deg\n```" in gallery.page(problem)


def test_a_notebook_is_a_page_with_its_outputs(gallery: Any) -> None:
    path = ROOT / "notebooks" / "1_first_steps.ipynb"
    page = gallery.notebook_page(path)
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert all("".join(cell["source"]) in page for cell in cells)
    assert "```text\n" in page
    assert "<div>" in page
    assert "data:image/png;base64," in page
    assert f"({path.stem}.md)" in gallery.index([])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('"""What?"""\n', "its docstring must state the question"),
        ("print()\n", "its docstring must state the question"),
        ('"""What?\n\nResult: nothing.\n"""\n', "no picture of it was found"),
    ],
)
def test_a_problem_without_its_words_is_refused(gallery: Any, tmp_path: Path, text: str, message: str) -> None:
    script = tmp_path / "some.py"
    script.write_text(text)
    with pytest.raises(ValueError, match=message):
        gallery.read_problem(script, None)
