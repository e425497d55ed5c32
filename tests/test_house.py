"""Rules of the house that a tool can check: no circles of files, nothing private borrowed, units typed once."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "tubeopt"


def modules() -> dict[str, Path]:
    """Name without the package's own -> file."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(parts).removesuffix(".__init__").removesuffix("__init__")] = path
    return found


def imports(name: str, path: Path) -> Iterator[tuple[str, str]]:
    """Module and name of everything that a module takes from the package, wherever in it, but for types alone."""
    here = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]

    def visit(node: ast.AST) -> Iterator[tuple[str, str]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.ImportFrom) and child.level:
                base = here[: len(here) - child.level + 1] if name else []
                source = ".".join(part for part in (*base, child.module or "") if part)
                yield from ((source, alias.name) for alias in child.names)
            if isinstance(child, ast.stmt):
                yield from visit(child)

    yield from visit(ast.parse(path.read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def arrows() -> dict[str, set[tuple[str, str]]]:
    return {name: set(imports(name, path)) for name, path in modules().items()}


def circles(edges: dict[str, set[str]]) -> set[frozenset[str]]:
    """Sets of modules each of which reaches all others of its set."""
    reached: dict[str, set[str]] = {}
    for start in edges:
        seen: set[str] = set()
        ahead = [start]
        while ahead:
            for after in edges[ahead.pop()] - seen:
                seen.add(after)
                ahead.append(after)
        reached[start] = seen
    return {
        frozenset({one, *(other for other in reached[one] if one in reached[other])})
        for one in edges
        if one in reached[one]
    }


def test_files_do_not_know_each_other_both_ways(arrows: dict[str, set[tuple[str, str]]]) -> None:
    known = set(arrows)
    edges = {
        name: {f"{source}.{what}" if f"{source}.{what}" in known else source for source, what in taken} & known - {name}
        for name, taken in arrows.items()
    }
    assert circles(edges) == set()


def test_what_methods_call_late_is_a_public_function_of_a_module_above(arrows: dict[str, set[tuple[str, str]]]) -> None:
    called = re.compile(r'late\("tubeopt\.([\w.]+)\.(\w+)"\)')
    for name, path in modules().items():
        for module, function in called.findall(path.read_text(encoding="utf-8")):
            above = {source for source, _ in arrows[module]} | {f"{source}.{what}" for source, what in arrows[module]}
            assert name in above, f"{module} does not know {name}"
            assert callable(getattr(importlib.import_module(f"tubeopt.{module}"), function))
            assert not function.startswith("_")


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set()}) == {frozenset("abc")}


def test_no_private_name_is_taken_from_another_module(arrows: dict[str, set[tuple[str, str]]]) -> None:
    taken = {f"{source}.{what}" for names in arrows.values() for source, what in names if re.match("_[^_]", what)}
    assert taken == set()


def test_millimetres_are_typed_where_units_are() -> None:
    typed = re.compile(r"^(MM|MILLI|DEG|PERCENT)\b[^\n]*= *[\d.(]", re.MULTILINE)
    found = [name for name, path in modules().items() if typed.search(path.read_text(encoding="utf-8"))]
    assert set(found) <= {"files.units"}
