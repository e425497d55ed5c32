"""What a notebook shows of an object: the table that the command line prints of it, and its picture.

An answer that has a report shows the report. What has none, being a part of an answer or an input, is listed in
`SUMMARIES` with its quantities and its picture; all else shows its fields, in SI.
"""

from __future__ import annotations

import base64
import dataclasses
import io
from typing import Any

import numpy as np
from rich.console import Console, RenderableType

from ..display import brief
from ..errors import SolveError
from ..robots.file import AnyRobot
from .quantities import rows
from .report import Drawing, Report, drawing, two_columns
from .reports import report
from .summaries import SUMMARIES, Summary

WIDTH = 110
"""Characters in a line of a table."""

PICTURE_WIDTH = 640
"""Pixels across which a picture is shown at most."""


def shown(answer: Any) -> dict[str, Any]:
    """All that a notebook may show of an object, by its kind, of one drawing."""
    picture = png(answer)
    page = {"text/html": html(answer, picture)}
    return page if picture is None else {**page, "image/png": picture}


def html(answer: Any, picture: bytes | None) -> str:
    """The object as a piece of a page: its table, and its picture below where there is one."""
    console = Console(record=True, file=io.StringIO(), width=WIDTH, force_jupyter=False)
    console.print(_table(answer), crop=False)
    frame = '<pre style="line-height:1.25;overflow-x:auto">{code}</pre>'
    table = console.export_html(inline_styles=True, code_format=frame).strip()
    if picture is None:
        return table
    style = f'alt="{type(answer).__name__}" style="max-width:{PICTURE_WIDTH}px;width:100%"'
    return f'{table}\n<img {style} src="data:image/png;base64,{base64.b64encode(picture).decode()}">'


def png(answer: Any) -> bytes | None:
    """The picture of an object as PNG, None where there is none."""
    draw = _picture(answer)
    return None if draw is None else draw()._repr_png_()


def _report(answer: Any) -> Report[Any] | None:
    """The report on an answer, None for what no command answers with."""
    try:
        return report(answer)
    except TypeError:
        return None


def _table(answer: Any) -> RenderableType:
    told = _report(answer)
    if told is not None:
        return told.table()
    name, summary = type(answer).__name__, _summary(answer)
    if summary is None:
        return two_columns(f"{name} (SI)", _fields(answer))
    return two_columns(name, rows(answer, summary.quantities))


def _fields(answer: Any) -> list[tuple[str, str]]:
    """What nothing more is known of, as its fields."""
    shown = ((field.name, getattr(answer, field.name)) for field in dataclasses.fields(answer) if field.repr)
    return [(name, brief(value)) for name, value in shown if value is not None]


def _summary(answer: Any) -> Summary | None:
    return next((SUMMARIES[kind] for kind in type(answer).__mro__ if kind in SUMMARIES), None)


def _picture(answer: Any) -> Drawing | None:
    if isinstance(answer, AnyRobot):
        return _at_home(answer)
    told = _report(answer)
    if told is not None:
        stills = [draw for name, draw in told.pictures().items() if "." not in name]
        return stills[0] if stills else None
    summary = _summary(answer)
    return None if summary is None else summary.picture(answer)


def _at_home(robot: Any) -> Drawing | None:
    """A robot as it stands when nothing is turned."""
    from ..equilibrium.kinematics import forward_kinematics

    try:
        return drawing("shape.plot_shape", forward_kinematics(robot, np.zeros(robot.n_tubes)))
    except SolveError:
        return None
