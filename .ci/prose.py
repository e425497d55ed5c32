"""The check that texts are plain technical English: words, sentence length, and how a description begins.

    python .ci/prose.py                 check everything; exit code 1 with a list of faults
    python .ci/prose.py --count         faults of every part
    python .ci/prose.py --catalogue     print every help text, message, key and status for a reviewer

The words are those of the table in docs/style.md.
"""

from __future__ import annotations

import argparse
import ast
import functools
import io
import json
import re
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

LONGEST = 30
"""Words of a sentence; writers aim at 20."""

STARTS = re.compile(r"(Of|That|What|Those|Which|Whose|By|As|The same)\b")
"""How a description must not begin: the noun or the verb comes first."""

OPENINGS = re.compile(
    r"(?:\([^)]*\)(?:, \([^)]*\))* )?(of|that|what|whose|which|whether|where|why|how|who|by|those|as|it|its|so|to|from|"
    r"with|without|in|on|at|and|but|nothing|not|their|they|between|around|beside|behind|after|before)\b",
    re.IGNORECASE,
)
"""How no docstring begins, after the shape of an array: a preposition or a pronoun names nothing."""

PROSE = re.compile(r"[a-z]{2,},? [a-z]{2,}")
"""What a string has that is a text, and no name or format."""

CALLS = re.compile(r"(Error|Exit|warn|warning|info|warn_implausible|BadParameter)$")
"""Functions and errors with a message for a user."""


@dataclass(frozen=True)
class Text:
    """A text that a user reads."""

    part: str
    """Page, or kind and module."""
    where: str
    text: str
    description: bool = False
    """It describes a thing: its noun or verb comes first."""


@functools.cache
def rules() -> tuple[re.Pattern[str], dict[str, str]]:
    """Pattern of all that is not written, and for each phrase what is written instead, from the style guide."""
    page = (ROOT / "docs" / "style.md").read_text(encoding="utf-8")
    table = page.partition("## Words to avoid")[2]
    rows = re.findall(r"^\| (`.*?) \| (.*?) \|", table, re.MULTILINE)
    instead = {phrase: words for phrases, words in rows for phrase in re.findall("`(.*?)`", phrases)}
    longest_first = sorted(instead, key=len, reverse=True)
    any_of = "|".join(re.escape(phrase).replace("\\#", r"\d+") for phrase in longest_first)
    return re.compile(rf"(?<![\w-])(?:{any_of})(?![\w-])", re.IGNORECASE), instead


@functools.cache
def allowed() -> re.Pattern[str]:
    """Fixed phrases in which a word of the table is right."""
    page = (ROOT / "docs" / "style.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^Allowed phrases: (.*)$", page, re.MULTILINE)
    return re.compile("|".join(re.escape(phrase) for phrase in re.findall("`(.*?)`", line)), re.IGNORECASE)


def faults(text: Text) -> Iterator[str]:
    """What is against the style guide in a text."""
    plain = allowed().sub("...", re.sub(r"`[^`]*`", "code", text.text))
    pattern, instead = rules()
    for found in pattern.finditer(plain):
        yield f"{text.where}: '{found[0]}': {instead[re.sub(r'[0-9]+', '#', found[0].lower())]}"
    if text.description and STARTS.match(plain):
        yield f"{text.where}: begins with '{plain.split()[0]}': begin with the noun or the verb: {plain[:60]}"
    for sentence in re.split(r"(?<=[.?!])[\"')*]* +(?=[A-Z`*\"(\[])|\n", plain):
        count = len(re.findall(r"[A-Za-z]{2,}[\w'-]*|\ba\b", sentence))
        if count > LONGEST:
            yield f"{text.where}: a sentence of {count} words: {sentence.strip()[:70]}..."


def texts() -> Iterator[Text]:
    """All texts that users read."""
    yield from _helps()
    yield from _sources()
    yield from _docstrings()
    for page in [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md")), *ROOT.glob("tubeopt/**/*.md")]:
        name, text = page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")
        if name == "docs/style.md":  # its table has the words on purpose
            text = text.partition("## Words to avoid")[0]
        yield from _page(name, text)
    for script in sorted((ROOT / "problems").glob("*.py")):
        yield from _script(script.relative_to(ROOT).as_posix(), script.read_text(encoding="utf-8"))
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        name = notebook.relative_to(ROOT).as_posix()
        for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
            yield from (_page if cell["cell_type"] == "markdown" else _script)(name, "".join(cell["source"]))


def _helps() -> Iterator[Text]:
    from tubeopt.cli.app import program

    def _of(group: Any, words: str) -> Iterator[Text]:
        for name, command in group.commands.items():
            full = f"{words} {name}"
            if command.help:
                yield Text("help", full, command.help, description=True)
            if hasattr(command, "commands"):
                yield from _of(command, full)
                continue
            made = command.command
            for option in made.params:
                if option.help:
                    yield Text("help", f"{full} {option.opts[0]}", option.help, description=True)
            if made.epilog:
                yield Text("help", f"{full} (note)", made.epilog.partition("Example: ")[0].strip())

    yield from _of(program(), "tubeopt")


def _sources() -> Iterator[Text]:
    """Messages of errors and warnings, sentences of status, labels of quantities and keys, and all other strings with
    words, which functions return or draw."""
    for path in sorted((ROOT / "tubeopt").rglob("*.py")):
        module = path.relative_to(ROOT).as_posix()
        tree = ast.parse(path.read_text(encoding="utf-8"))
        known = list(_called(tree, module))
        yield from known
        for line, words in _strings(tree):
            if not any(words in each.text for each in known):
                yield Text(f"string {module}", f"{module}:{line}", words)


def _called(tree: ast.Module, module: str) -> Iterator[Text]:
    """Texts of a module whose use is known from the call, class or annotation that they are in."""
    for node in ast.walk(tree):
        where = f"{module}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Call) and CALLS.search(_name(node.func)):
            for part in node.args[:1]:
                if words := _words(part):
                    yield Text(f"message {module}", where, words)
        elif isinstance(node, ast.Call) and _name(node.func) == "Quantity":
            for part in (*node.args[1:2], *(one.value for one in node.keywords if one.arg in ("label", "text"))):
                if words := _words(part):
                    yield Text(f"label {module}", where, words)
        elif isinstance(node, ast.Call):
            for part in (one.value for one in node.keywords if one.arg == "description"):
                if words := _words(part):
                    yield Text(f"key {module}", where, words, description=True)
        elif isinstance(node, ast.ClassDef) and "StatusEnum" in {_name(base) for base in node.bases}:
            for member in node.body:
                if isinstance(member, ast.Assign) and (words := _words(member.value)):
                    yield Text(f"message {module}", f"{module}:{member.lineno}", words)
        elif isinstance(node, ast.Subscript) and _name(node.value) == "Annotated":
            for part in getattr(node.slice, "elts", ())[1:]:
                if isinstance(part, ast.Constant | ast.JoinedStr) and (words := _words(part)):
                    yield Text(f"key {module}", where, words, description=True)


def _strings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every string with words; without docstrings."""
    done: set[int] = set()
    for node in ast.walk(tree):  # from outside to inside: a string before its parts
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            done.add(id(node.value))
        elif isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in done:
            done.update(id(part) for part in ast.walk(node) if not isinstance(node, ast.Constant))
            if PROSE.search(words := _words(node)):
                yield node.lineno, words


def _script(name: str, code: str) -> Iterator[Text]:
    """Docstrings, comments and strings of a script, or of a cell."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and (words := ast.get_docstring(node)):
            for paragraph in words.split("\n\n"):
                yield Text(name, f"{name}:{getattr(node, 'lineno', 1)}", " ".join(paragraph.split()))
    for line, words in _strings(tree):
        yield Text(name, f"{name}:{line}", words)
    for token in tokenize.generate_tokens(io.StringIO(code).readline):
        if token.type == tokenize.COMMENT:
            yield Text(name, f"{name}:{token.start[0]}", token.string.lstrip("# "))


def _docstrings() -> Iterator[Text]:
    """Docstrings of public names and of those in the reference, of their methods and of their fields."""
    import tubeopt

    reference = re.findall(
        r"^::: (tubeopt\..*)\.(\w+)$", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    names = {(getattr(getattr(tubeopt, name), "__module__", None), name) for name in tubeopt.__all__} | set(reference)
    for home in sorted({home for home, _ in names if home and home.startswith("tubeopt.")}):
        path = ROOT / f"{home.replace('.', '/')}.py"
        if not path.exists():
            path = ROOT / home.replace(".", "/") / "__init__.py"
        module = path.relative_to(ROOT).as_posix()
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if (home, getattr(node, "name", None)) in names:
                yield from _documented(node, module)


def openings() -> Iterator[str]:
    """Docstrings of modules, classes, functions, fields and constants that begin with no noun or verb."""
    for path in sorted((ROOT / "tubeopt").rglob("*.py")):
        yield from _openings(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))


def _openings(module: str, code: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            words = node.value.value.strip()
            if found := OPENINGS.match(words):
                yield f"{module}:{node.lineno}: begins with '{found[1]}': begin with the noun or the verb: {words[:60]}"


def _documented(node: Any, module: str) -> Iterator[Text]:
    parts = [node, *(node.body if isinstance(node, ast.ClassDef) else ())]
    for part, after in zip(parts, [*parts[1:], None], strict=True):
        words, line = None, getattr(part, "lineno", 0)
        if isinstance(part, ast.FunctionDef | ast.ClassDef) and not part.name.startswith("_"):
            words = ast.get_docstring(part)
        elif isinstance(part, ast.AnnAssign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            words = str(after.value.value)
        if words:
            prose = words.partition(">>>")[0]
            flat = re.sub(r"(?<!\n)\n(?!\n| *- | *[-\w*`, ]+: )", " ", prose)
            yield Text(f"docstring {module}", f"{module}:{line}", flat, description=True)


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _words(node: ast.expr) -> str:
    """The text of a literal; what is put into it stands as {}."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(_words(part) if isinstance(part, ast.Constant) else "{}" for part in node.values)
    if isinstance(node, ast.BinOp):
        return _words(node.left) + _words(node.right)
    if isinstance(node, ast.IfExp):
        return f"{_words(node.body)}\n{_words(node.orelse)}".strip()
    return ""


def _page(name: str, text: str) -> Iterator[Text]:
    """Paragraphs, items and cells of a page of Markdown, without code and formulas."""
    hidden = re.compile(r"^```.*?^```|^    .*?$|^:::.*?$|\$\$.*?\$\$|<!--.*?-->", re.MULTILINE | re.DOTALL)
    text = hidden.sub(lambda found: re.sub(r"[^\n]", "", found[0]), text)
    text = re.sub(r"\$[^$\n]+\$", "x", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    block: list[str] = []
    first = 1
    for number, line in enumerate([*text.split("\n"), ""], start=1):
        if line.startswith("|"):
            for cell in line.strip("|").split("|"):
                yield Text(name, f"{name}:{number}", cell.strip())
            continue
        starts = re.match(r" *([-*]|\d+\.) |#|!!!", line)
        if (starts or not line.strip()) and block:
            yield Text(name, f"{name}:{first}", " ".join(block))
            block = []
        if line.strip():
            first = first if block else number
            block.append(line.strip())


def main() -> int:
    """Check, count or print the texts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for flag, words in (
        ("--count", "faults and words of every part"),
        ("--catalogue", "print all texts but pages"),
    ):
        parser.add_argument(flag, action="store_true", help=words)
    asked = parser.parse_args()
    if asked.catalogue:
        for text in texts():
            if not text.part.endswith(".md"):
                print(f"{text.where}\n    {text.text}")
        return 0
    found: dict[str, list[str]] = {}
    for text in texts():
        found.setdefault(text.part, []).extend(faults(text))
    found["openings of docstrings"] = list(openings())
    if asked.count:
        for part, each in found.items():
            print(f"{len(each):5d}  {part}")
        return 0
    shown = [one for each in found.values() for one in each]
    print("\n".join(shown) if shown else "prose: no faults")
    return 1 if shown else 0


if __name__ == "__main__":
    sys.exit(main())
