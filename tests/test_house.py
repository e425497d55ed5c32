"""Rules of the house that no linter checks: what is called late, nothing private borrowed, units typed once."""

from __future__ import annotations

import ast
import dataclasses
import functools
import importlib
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tubeopt
from tests.conftest import listed

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "tubeopt"


def modules() -> dict[str, Path]:
    """Name without the package's own -> file."""
    results = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        results[".".join(parts).removesuffix(".__init__").removesuffix("__init__")] = path
    return results


IMPORT = re.compile(r"^ *from (\.+)([\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)
"""Read as text: to parse all modules takes seconds."""


@functools.cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(name: str, path: Path) -> Iterator[tuple[str, str]]:
    """Module and name of everything that a module takes from the package, wherever in it."""
    current = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for dots, module, names in IMPORT.findall(path.read_text(encoding="utf-8")):
        base = current[: len(current) - len(dots) + 1] if name else []
        source = ".".join(part for part in (*base, module) if part)
        taken = re.sub(r"#.*|[()]", "", names).split(",")
        yield from ((source, each.split()[0]) for each in taken if each.strip())


@pytest.fixture(scope="module")
def arrows() -> dict[str, set[tuple[str, str]]]:
    return {name: set(imports(name, path)) for name, path in modules().items()}


def test_what_methods_call_late_is_a_public_function_of_a_module_above(arrows: dict[str, set[tuple[str, str]]]) -> None:
    called = re.compile(r'lazy_import\("tubeopt\.([\w.]+)\.(\w+)"\)')
    for name, path in modules().items():
        for module, function in called.findall(path.read_text(encoding="utf-8")):
            above = {source for source, _ in arrows[module]} | {f"{source}.{what}" for source, what in arrows[module]}
            assert name in above, f"{module} does not know {name}"
            assert callable(getattr(importlib.import_module(f"tubeopt.{module}"), function))
            assert not function.startswith("_")


def test_no_private_name_is_taken_from_another_module(arrows: dict[str, set[tuple[str, str]]]) -> None:
    taken = {f"{source}.{what}" for names in arrows.values() for source, what in names if re.match("_[^_]", what)}
    assert taken == set()


def test_millimetres_are_typed_where_units_are() -> None:
    typed = re.compile(r"^(MM|MILLI|DEG|PERCENT)\b[^\n]*= *[\d.(]", re.MULTILINE)
    results = [name for name, path in modules().items() if typed.search(path.read_text(encoding="utf-8"))]
    assert set(results) <= {"files.units"}


def test_names_are_words_of_the_field() -> None:
    other = re.compile(r"(?<![a-z])(hunt|walk|lose|reel|desk|rubbing|rubbed|leap|told|hedge|prudence)(?![a-z])")
    suspects = {name: path for name, path in modules().items() if other.search(name + path.read_text(encoding="utf-8"))}
    for name, path in suspects.items():
        nodes = list(ast.walk(tree(path)))
        names = {name} | {
            getattr(node, kind) for kind in ("id", "attr", "name") for node in nodes if hasattr(node, kind)
        }
        assert [one for one in names if one and other.search(one)] == [], name


def test_every_field_of_public_data_is_told() -> None:
    classes = [
        (name, node)
        for name, path in modules().items()
        if re.search(r"^class \w+\(", path.read_text(encoding="utf-8"), re.MULTILINE)
        for node in tree(path).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    public = {"Displayed"}
    while more := {n.name for _, n in classes if {ast.unparse(b).split("[")[0] for b in n.bases} & public} - public:
        public |= more
    untold = [
        f"{name}.{node.name}.{field}"
        for name, node in classes
        if node.name in public and any("dataclass" in ast.unparse(each) for each in node.decorator_list)
        for field in untold_fields(node, ast.get_docstring(node) or "")
    ]
    assert untold == []


def test_fields_of_what_users_import_have_docstrings_of_their_own() -> None:
    exported = [getattr(tubeopt, name) for name in tubeopt.__all__]
    bare = [
        f"{one.__name__}.{field}"
        for one in exported
        if isinstance(one, type) and dataclasses.is_dataclass(one)
        for node in tree(modules()[one.__module__.removeprefix("tubeopt.")]).body
        if isinstance(node, ast.ClassDef) and node.name == one.__name__
        for field in untold_fields(node, "")
    ]
    assert bare == []


def untold_fields(node: ast.ClassDef, words: str) -> Iterator[str]:
    """Fields of a dataclass without a docstring, an annotation that tells them, or a place in `words`."""
    for field, after in zip(node.body, [*node.body[1:], None], strict=True):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        name, kind = field.target.id, ast.unparse(field.annotation)
        own = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        hidden = name.startswith("_") or "ClassVar" in kind
        if not (own or hidden or "Annotated" in kind or re.search(rf"\b{name}\b", words)):
            yield name


ENTRY = re.compile(r"(?:^ {4}|(?<=\S) {2,3})((?:\*{0,2}\w+, )*\*{0,2}\w+): ", re.MULTILINE)
"""Names of an entry of Args; short entries share a line."""


def test_docstrings_describe_arguments_that_exist() -> None:
    nodes = [(path, node) for path in modules().values() for node in ast.walk(tree(path))]
    classes = {node.name: node for _, node in nodes if isinstance(node, ast.ClassDef)}
    stale = [
        f"{path.name}: {node.name}: {name}"
        for path, node in nodes
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        and (section := re.search(r"^Args:\n(.*?)(?=^\S|\Z)", ast.get_docstring(node) or "", re.MULTILINE | re.DOTALL))
        for entry in ENTRY.findall(section[1])
        for name in entry.replace("*", "").split(", ")
        if name not in arguments(node, classes)
    ]
    assert stale == []


def arguments(node: ast.FunctionDef | ast.ClassDef, classes: dict[str, ast.ClassDef]) -> set[str]:
    """Names of the parameters of a function, or of the constructors and fields of a class and its bases."""
    if isinstance(node, ast.FunctionDef):
        return {part.arg for part in ast.walk(node.args) if isinstance(part, ast.arg)}
    made = [arguments(part, classes) for part in node.body if getattr(part, "name", "") in ("__init__", "__new__")]
    fields = {ast.unparse(part.target) for part in node.body if isinstance(part, ast.AnnAssign)}
    bases = [classes[name] for name in (ast.unparse(base).split("[")[0] for base in node.bases) if name in classes]
    return fields.union(*made, *(arguments(base, classes) for base in bases))


@pytest.mark.parametrize("file", ["slow.txt", "night.txt", "searches.txt"])
def test_lists_of_tests_name_tests(file: str) -> None:
    """A name that no test has would leave out nothing, unseen. What is left to the night is slow, too."""
    for name in listed(file):
        path, *_, function = name.split("[")[0].split("::")
        assert f"def {function}(" in (ROOT / "tests" / path).read_text(encoding="utf-8"), name
    assert {name.split("[")[0] for name in listed("night.txt")} <= listed("slow.txt")


FORBIDDEN = {
    "physics/strain.py": ("from ..solvers import newton", "packages know only those below them"),
    "robots/tubes.py": ("from .assembly import Assembly", "no circles, of packages or of files"),
    "planning/motion.py": ("from ..design import task", "questions do not know each other"),
    "inverse/goal.py": ("from ..planning import plan", "inverse kinematics knows none of the questions"),
    "show/formatting.py": ("from ..cli import output", "what is shown does not know the commands"),
    "equilibrium/linearised.py": ("import casadi", "CasADi is used where programs are stated"),
    "control/command.py": ("import yaml", "YAML is used where files are read and written"),
    "show/surfaces.py": ("import matplotlib", "Matplotlib is used where pictures are drawn"),
}
"""File -> a line that it must not have, and the contract that this breaks."""


def test_forbidden_imports_break_the_contract(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "tubeopt", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for file, (line, _) in FORBIDDEN.items():
        path = tmp_path / "tubeopt" / file
        path.write_text(f"{path.read_text(encoding='utf-8')}\n{line}\n", encoding="utf-8")
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as lint; lint()", "--no-cache"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    broken = [row for row in done.stdout.splitlines() if "BROKEN" in row]
    for file, (line, contract) in FORBIDDEN.items():
        assert any(contract in row for row in broken), f"{line} in {file}"
