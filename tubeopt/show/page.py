"""The page that pictures are laid out for."""

from __future__ import annotations

from contextvars import ContextVar

WIDTH: ContextVar[float | None] = ContextVar("WIDTH", default=None)
"""Of pictures, m, where they are to be laid out anew for a page; letters keep their size. None leaves each as it is."""

TITLED: ContextVar[bool] = ContextVar("TITLED", default=True)
"""Whether pictures have a heading; a paper has a caption below."""

HEADINGS: ContextVar[list[str] | None] = ContextVar("HEADINGS", default=None)
"""Where pictures without a heading leave it, for their captions."""

FONTS: ContextVar[tuple[str, ...]] = ContextVar("FONTS", default=())
"""Families of letters, the best first; of those that are not installed the next is taken."""

SCALE = "scale"
"""`gid` of the numbers along the edges of a scene, of which some may be left out."""
