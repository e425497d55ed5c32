"""API pages show the marks of a field as text: a Griffe extension that `mkdocs.yml` names.

    tip_jump: Annotated[float, unit("mm"), form(".4f"), "distance that the tip jumps"]

appears as a `float` with the docstring "Distance that the tip jumps, m." and what the source has below the field.
"""

from __future__ import annotations

import ast
from typing import Any

import griffe

from tubeopt.files.units import UNITS, si_unit, unit_of, unit_text


class FieldMarks(griffe.Extension):
    """Documents attributes by their annotations."""

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Replace an annotation by its type, and put the text of its marks in front of the docstring."""
        annotation = attr.annotation
        if not (isinstance(annotation, griffe.ExprSubscript) and str(annotation.left) == "Annotated"):
            return
        assert isinstance(annotation.slice, griffe.ExprTuple)
        attr.annotation, *marks = annotation.slice.elements
        below = attr.docstring.value if attr.docstring else ""
        if text := sentence(marks):
            attr.docstring = griffe.Docstring(f"{text} {below}".strip(), parent=attr)


def sentence(written: list[str | griffe.Expr]) -> str:
    """Description and SI unit of a field; empty without a description."""
    marks = [ast.parse(str(mark), mode="eval").body for mark in written]
    texts = [ast.literal_eval(mark) for mark in marks if isinstance(mark, ast.Constant)]
    keys = [mark.args[0] for mark in marks if isinstance(mark, ast.Call) and ast.unparse(mark.func) in ("unit", "key")]
    units = [unit if (unit := ast.literal_eval(one)) in UNITS else unit_of(unit) for one in keys]
    si = unit_text(si_unit(units[0])) if units else ""
    if not texts:
        return ""
    return f"{texts[0][:1].upper()}{texts[0][1:]}{si and f', {si}'}."
