"""Hook of the site: formulas become MathML when the site is built, so that a page needs neither script nor foreign host."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
"""What `pymdownx.arithmatex` makes of a formula: in a line, or on a line of its own."""


def on_page_content(page: str, **_: Any) -> str:
    """The page with its formulas in MathML."""
    return FORMULA.sub(_typeset, page)


def _typeset(found: re.Match[str]) -> str:
    display = "block" if found[1] == "div" else "inline"
    return f'<{found[1]} class="formula">{convert(html.unescape(found[2]).strip(), display=display)}</{found[1]}>'
