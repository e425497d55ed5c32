"""The page that pictures are laid out for."""

from __future__ import annotations

from contextvars import ContextVar

WIDTH: ContextVar[float | None] = ContextVar("WIDTH", default=None)
"""Of pictures, m, where they are to be laid out anew for a page; letters keep their size. None leaves each as it is."""

TITLED: ContextVar[bool] = ContextVar("TITLED", default=True)
"""Whether pictures have a heading; a paper has a caption below."""

SCALE = "scale"
"""`gid` of the numbers along the edges of a scene, of which some may be left out."""
