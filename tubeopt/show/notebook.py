"""What a notebook shows of an object: the table that the command line prints of it, and its picture.

An answer that has a report shows the report. What has none, being a part of an answer or an input, is listed in
`SUMMARIES` with its quantities and its picture; all else shows its fields, in SI.
"""

from __future__ import annotations

import base64
import dataclasses
import io
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console, RenderableType

from ..display import brief
from ..errors import SolveError
from ..robots.file import AnyRobot
from .quantities import rows
from .report import Drawing, drawing, two_columns
from .reports import report
from .summaries import SUMMARIES

WIDTH = 110
"""Characters in a line of a table."""

PICTURE_WIDTH = 640
"""Pixels across which a picture is shown at most."""


def shown(answer: Any) -> dict[str, Any]:
    """All that a notebook may show of an object, by its kind, of one drawing."""
    table, draw = _told(answer)
    picture = _drawn(draw)
    page = {"text/html": _html(table(), picture, type(answer).__name__)}
    return page if picture is None else {**page, "image/png": picture}


def png(answer: Any) -> bytes | None:
    """The picture of an object as PNG, None where there is none."""
    return _drawn(_told(answer)[1])


def _drawn(draw: Drawing | None) -> bytes | None:
    return None if draw is None else draw()._repr_png_()


def _html(table: RenderableType, picture: bytes | None, name: str) -> str:
    """A piece of a page: a table, and a picture below where there is one."""
    console = Console(record=True, file=io.StringIO(), width=WIDTH, force_jupyter=False)
    console.print(table, crop=False)
    frame = '<pre style="line-height:1.25;overflow-x:auto">{code}</pre>'
    told = console.export_html(inline_styles=True, code_format=frame).strip()
    if picture is None:
        return told
    style = f'alt="{name}" style="max-width:{PICTURE_WIDTH}px;width:100%"'
    return f'{told}\n<img {style} src="data:image/png;base64,{base64.b64encode(picture).decode()}">'


def _told(answer: Any) -> tuple[Callable[[], RenderableType], Drawing | None]:
    """What makes the table of an object, and what draws its picture, None where there is none."""
    name = type(answer).__name__
    try:
        told = report(answer)
    except TypeError:
        summary = next((SUMMARIES[kind] for kind in type(answer).__mro__ if kind in SUMMARIES), None)
        if summary is None:
            return lambda: two_columns(f"{name} (SI)", _fields(answer)), None
        return lambda: two_columns(name, rows(answer, summary.quantities)), summary.picture(answer)
    if isinstance(answer, AnyRobot):
        return told.table, _at_home(answer)
    return told.table, next((draw for picture, draw in told.pictures().items() if "." not in picture), None)


def _fields(answer: Any) -> list[tuple[str, str]]:
    """What nothing more is known of, as its fields."""
    shown = ((field.name, getattr(answer, field.name)) for field in dataclasses.fields(answer) if field.repr)
    return [(name, brief(value)) for name, value in shown if value is not None]


def _at_home(robot: Any) -> Drawing | None:
    """A robot as it stands when nothing is turned."""
    from ..equilibrium.kinematics import forward_kinematics

    try:
        return drawing("shape.plot_shape", forward_kinematics(robot, np.zeros(robot.n_tubes)))
    except SolveError:
        return None
