"""Help as it is shown."""

from __future__ import annotations

import inspect
import re


def flowing(documentation: str) -> str:
    """A docstring whose paragraphs are a line each, which the terminal breaks where it is full."""
    return re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(documentation))
