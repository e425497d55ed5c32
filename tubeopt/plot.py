"""All pictures: a function draws an answer, returns the figure, and saves it at a path.

What `plot.pyi` imports is loaded when it is first used.
"""

import ast
import importlib
from pathlib import Path
from typing import Any

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_PLACES = {
    name.name: f".{node.module}" for node in _STUB.body if isinstance(node, ast.ImportFrom) for name in node.names
}

__all__ = sorted(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name], __package__), name)


def __dir__() -> list[str]:
    return list(__all__)
