"""A page of the site for every script in `problems/` and for every notebook.

The page of a script has its question, the result, the pictures and the code. That of a notebook has its cells with
the outputs that are saved in it.

A hook of MkDocs. Pages are made from the scripts whenever the site is built, so that they cannot drift from them. Where
TUBEOPT_GALLERY names a directory in which `tests/test_problems.py` has left what every script printed and drew, the
page shows that, and a script without its record is an error; elsewhere, and of a script that `tests/night.txt` leaves
to the night, it shows the pictures in `docs/images`.
"""

from __future__ import annotations

import ast
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PROBLEMS, IMAGES, NOTEBOOKS = ROOT / "problems", ROOT / "docs" / "images", ROOT / "notebooks"
NIGHT = ROOT / "tests" / "night.txt"
LEARNED = "Result: "

GROUPS = {
    "thesis_": "From the thesis",
    "inverse_": "Inverse kinematics",
    "plan_": "Motion planning",
    "control_": "Real-time control",
    "design_": "Design",
    "own_": "Your own problem",
    "mold_": "Fabrication",
    "heat": "Fabrication",
    "fabricat": "Fabrication",
    "": "Stability and more robots",
}
"""Heading of the scripts whose names begin so; the first that fits."""


@dataclass(frozen=True)
class Problem:
    """A script: what its docstring says, its pictures, and what it printed, "" where nobody knows."""

    name: str
    asked: str
    more: str
    learned: str
    code: str
    pictures: tuple[Path, ...]
    printed: str = ""

    @property
    def title(self) -> str:
        """The name of the script in words."""
        text = re.sub(r"fig_(\d+)_(\d+)", r"Figure \1.\2", self.name).replace("_", " ")
        text = text.replace("s curve", "S-curve")
        text = re.sub(r"\b(crl|etr|ctr)\b", lambda match: match[0].upper(), text)
        return text[0].upper() + text[1:]


def read_problem(script: Path, records: Path | None) -> Problem:
    """A script and what is known of its run.

    Raises:
        ValueError: no docstring, no result, no pictures, or no record where records are kept.
    """
    code = script.read_text(encoding="utf-8")
    paragraphs = [" ".join(part.split()) for part in (ast.get_docstring(ast.parse(code)) or "").split("\n\n")]
    learned = [part.removeprefix(LEARNED) for part in paragraphs if part.startswith(LEARNED)]
    if not paragraphs[0] or len(learned) != 1:
        raise ValueError(f"{script.name}: its docstring must state the question and, after '{LEARNED}', the result")
    more = [part for part in paragraphs[1:] if not part.startswith(LEARNED)]
    recorded = records is not None and ((records / f"{script.stem}.json").is_file() or not _by_night(script))
    pictures, printed = _record(script, records) if records and recorded else (_drawn(code), "")
    if not pictures:
        raise ValueError(f"{script.name}: no picture of it was found")
    learned_text = learned[0][0].upper() + learned[0][1:]
    return Problem(script.stem, paragraphs[0], "\n\n".join(more), learned_text, code, tuple(pictures), printed)


def _record(script: Path, records: Path) -> tuple[list[Path], str]:
    """Pictures and text that the run of the tests left; of a map that was run coarsely, the picture in the docs."""
    path = records / f"{script.stem}.json"
    if not path.is_file():
        raise ValueError(f"{script.name}: its run has left no record in {records}")
    record = json.loads(path.read_text(encoding="utf-8"))
    coarse = record["coarse"]
    return [(IMAGES if coarse else records) / name for name in record["pictures"]], "" if coarse else record["printed"]


def _by_night(script: Path) -> bool:
    """The tests of the day do not run it."""
    return f"test_problem[{script.stem}]" in NIGHT.read_text(encoding="utf-8")


def _drawn(code: str) -> list[Path]:
    """Pictures in the docs under the names that a script gives to its own."""
    names = re.findall(r"[\w{}.\-]+\.(?:png|gif)", code)
    results = [path for name in names for path in sorted(IMAGES.glob(re.sub(r"\{[^}]*\}", "*", name)))]
    return list(dict.fromkeys(results))


def all_problems(records: Path | None = None) -> list[Problem]:
    """Every script, by name."""
    return [read_problem(script, records) for script in _scripts()]


def _scripts() -> list[Path]:
    """All scripts by name, figure 2.9 before 2.10."""
    return sorted(
        PROBLEMS.glob("*.py"),
        key=lambda script: [
            (int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", script.stem)
        ],
    )


def page(problem: Problem) -> str:
    """A page in Markdown."""
    parts = [f"# {problem.title}", problem.asked]
    parts += [problem.more] if problem.more else []
    parts += [f"![{problem.title}](images/{path.name})" for path in problem.pictures]
    parts += ["## Result", problem.learned]
    if problem.printed.strip():
        parts += ["## What it prints", f"```text\n{problem.printed.rstrip()}\n```"]
    run = f"    python -m problems.{problem.name}"
    parts += ["## The script", f"From the root of the repository it runs as\n\n{run}", f"```python\n{problem.code}```"]
    return "\n\n".join(parts) + "\n"


def notebook_page(path: Path) -> str:
    """A notebook in Markdown, with its saved outputs."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        parts += [shown for output in cell.get("outputs", ()) if (shown := _output(output))]
    parts.append(f"*From `notebooks/{path.name}`.*")
    return "\n\n".join(parts) + "\n"


def _output(output: dict[str, Any]) -> str:
    """An output of a cell: HTML before a picture before text."""
    data = {kind: "".join(text) for kind, text in output.get("data", {}).items()}
    if "text/html" in data:
        return "<div>" + "\n".join(line.strip() for line in data["text/html"].splitlines() if line.strip()) + "</div>"
    if "image/png" in data:
        return f'<img alt="Picture of the notebook" src="data:image/png;base64,{"".join(data["image/png"].split())}">'
    text = "".join(output.get("text", data.get("text/plain", "")))
    return f"```text\n{text.rstrip()}\n```" if text.strip() else ""


def notebooks() -> list[Path]:
    """All notebooks, in their order."""
    return sorted(NOTEBOOKS.glob("*.ipynb"))


def group(name: str) -> str:
    """Heading of the problem with this name."""
    return next(heading for start, heading in GROUPS.items() if name.startswith(start))


def index(problems: list[Problem]) -> str:
    """The page with all of them."""
    titles = [(path, notebook_page(path).partition("\n")[0].lstrip("# ")) for path in notebooks()]
    parts = [
        "# Gallery",
        "Scripts of `problems/` pose one problem each with the public interface: question, picture, result, code. "
        "Notebooks are a guided tour.",
        "## Notebooks",
        "\n".join(f"- [{title}]({path.stem}.md)" for path, title in titles),
    ]
    for heading in dict.fromkeys(GROUPS.values()):
        mine = [problem for problem in problems if group(problem.name) == heading]
        if mine:
            parts += [
                f"## {heading}",
                '<div class="grid cards" markdown>',
                "\n\n".join(_card(each) for each in mine),
                "</div>",
            ]
    return "\n\n".join(parts) + "\n"


def _card(problem: Problem) -> str:
    picture = f"[![]({f'images/{problem.pictures[0].name}'}){{ loading=lazy }}]({problem.name}.md)"
    return f"-   {picture}\n\n    **[{problem.title}]({problem.name}.md)**\n\n    {problem.asked}"


# --- what MkDocs calls -----------------------------------------------------------------------------------------------


def _records() -> Path | None:
    directory = os.environ.get("TUBEOPT_GALLERY")
    return Path(directory) if directory else None


def on_config(config: Any) -> Any:
    """Enter all pages below "Gallery" in the navigation, by group."""
    pages: dict[str, list[str]] = {"Notebooks": [f"gallery/{path.stem}.md" for path in notebooks()]}
    pages |= {heading: [] for heading in GROUPS.values()}
    for script in _scripts():
        pages[group(script.stem)].append(f"gallery/{script.stem}.md")
    below = ["gallery/index.md", *({heading: each} for heading, each in pages.items())]
    config.nav = [{"Gallery": below} if "Gallery" in entry else entry for entry in config.nav]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages and their pictures to the site."""
    from mkdocs.exceptions import PluginError
    from mkdocs.structure.files import File

    try:
        problems = all_problems(_records())
    except ValueError as error:
        raise PluginError(f"gallery: {error}") from None
    files.append(File.generated(config, "gallery/index.md", content=index(problems)))
    for problem in problems:
        files.append(File.generated(config, f"gallery/{problem.name}.md", content=page(problem)))
    for notebook in notebooks():
        files.append(File.generated(config, f"gallery/{notebook.stem}.md", content=notebook_page(notebook)))
    for path in {path for problem in problems for path in problem.pictures}:  # two scripts may show the same
        files.append(File.generated(config, f"gallery/images/{path.name}", abs_src_path=str(path)))
    return files
