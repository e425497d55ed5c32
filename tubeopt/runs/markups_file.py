"""Points that 3D Slicer saves: .fcsv, a table below comments, and .mrk.json."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, triple
from ..files.files import read_text
from ..typing import Array

COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
"""Of a .fcsv file that does not name them."""

NOWHERE = ("undefined", "missing")
"""States of a point of a .mrk.json file that has no place."""

UNITS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6}
"""Of a .mrk.json file, m."""


def markups(path: str | PathLike[str]) -> dict[str, Array]:
    """Places (3,), m, by their labels, in the axes of the file.

    Raises:
        InputError: no such file, no points in it, a label that is empty or stands twice, a place that is no three
            finite numbers.
    """
    rows = _of_json(path) if Path(path).suffix.lower() == ".json" else _of_table(path)
    found: dict[str, Array] = {}
    for k, (label, place) in enumerate(rows, start=1):
        name = str(label or "").strip()
        if not name or name in found:
            raise InputError(f"{path}: label of point {k} is {name!r}; every landmark must have a name of its own")
        found[name] = np.array(triple(f"{path}: place of {name!r}", place))
    if not found:
        raise InputError(f"{path}: it has no points")
    return found


def _of_table(path: str | PathLike[str]) -> list[tuple[str, Any]]:
    columns, rows = COLUMNS.split(","), []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.lstrip().startswith("#"):
            key, _, words = line.lstrip("# ").partition("=")
            columns = [each.strip() for each in words.split(",")] if key.strip() == "columns" else columns
        elif line.strip():
            cells = dict(zip(columns, (cell.strip() for cell in line.split(",")), strict=False))
            try:
                place = [float(cells[axis]) * UNITS["mm"] for axis in "xyz"]
            except (KeyError, ValueError):
                raise InputError(f"{path}: line {number} has no x, y and z that are numbers") from None
            rows.append((cells.get("label", ""), place))
    return rows


def _of_json(path: str | PathLike[str]) -> list[tuple[str, Any]]:
    try:
        lists = json.loads(read_text(path))["markups"]
        rows = []
        for each in lists:
            unit = each.get("coordinateUnits", "mm")
            scale = UNITS[str(unit[0] if isinstance(unit, list) else unit)]
            points = [p for p in each.get("controlPoints", ()) if p.get("positionStatus") not in NOWHERE]
            rows += [(p["label"], np.array(p["position"], dtype=float) * scale) for p in points]
    except (ValueError, KeyError, IndexError, TypeError, AttributeError):
        raise InputError(
            f"{path}: not a markups file of 3D Slicer; it must have a list markups of "
            "controlPoints, each with label and position, and coordinateUnits "
            f"{', '.join(UNITS)}"
        ) from None
    return rows
