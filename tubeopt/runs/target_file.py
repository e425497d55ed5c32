"""Targets of the tip in CSV, and single configurations in YAML."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np
from pydantic import Field

from ..files.checked import Entry, Number, check
from ..files.csv_file import read_csv, refuse
from ..files.units import MM, RAD
from ..files.yaml_file import load_yaml
from ..robots.robot import Robot
from ..typing import Array
from .robot_keys import HOME, joints_of

POSITION = ("x_mm", "y_mm", "z_mm")
DIRECTION = ("direction_x", "direction_y", "direction_z")


@dataclass(frozen=True, eq=False)
class Targets:
    """T targets."""

    position: Array
    """(T, 3) m."""
    direction: Array | None
    """(T, 3), of any length."""
    path: str = ""
    """Of the file."""


def load_targets(path: str | PathLike[str]) -> Targets:
    """The targets in a CSV file with the columns x_mm, y_mm, z_mm and, where the tip shall point, direction_x, ...

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no number, a direction without
            length: one line for each problem.
    """
    table = read_csv(path, (*POSITION, *DIRECTION))
    given = table.expect(POSITION, together=DIRECTION)
    position = table.numbers(POSITION, MM)
    direction = table.numbers(DIRECTION, RAD) if given else None
    if direction is not None:
        for k in np.flatnonzero(~direction.any(1)):
            table.complain(int(k), DIRECTION[0], "is 0, as are the other two; a direction must have a length")
    table.check()
    return Targets(position, direction, str(path))


class JointsFile(Entry):
    """One configuration of a robot."""

    rotations_deg: list[Number] = Field(description="rotation of every tube, inner to outer")
    translations_mm: list[Number] | None = Field(
        None, description=f"translation of every tube, inner to outer; default {HOME}"
    )


def load_joints(path: str | PathLike[str], robot: Robot) -> tuple[Array, Array]:
    """Rotations (n,) rad and translations (n,) m of the model where drives read what a YAML file says.

    Raises:
        InputError: no such file, not YAML, an unknown key, not as many numbers as there are tubes.
    """
    joints = check(JointsFile, load_yaml(path), path)
    n = robot.n_tubes
    given = {key: joints.si(key) for key in JointsFile.model_fields}
    problems = [
        f"{key} has {len(values)} numbers; it must be {n} (one per tube)"
        for key, values in given.items()
        if values is not None and len(values) != n
    ]
    refuse(path, problems)
    return joints_of(robot, *given.values())
