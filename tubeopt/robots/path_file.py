"""Waypoints of joint values in CSV: a column per joint, a row per waypoint."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from os import PathLike

import numpy as np

from ..files.csv_file import CsvTable, read_csv, to_csv
from ..files.units import DEG, MM, in_unit, parse_number
from ..typing import Array
from .limits import reading_fault
from .robot import Robot


@dataclass(frozen=True, eq=False)
class Waypoints:
    """T waypoints."""

    rotations: Array
    """(T, n) rad."""
    translations: Array
    """(T, n) m."""


def joint_columns(n_tubes: int) -> tuple[list[str], list[str]]:
    """Names of the columns of rotations and translations, inner to outer."""
    tubes = range(1, n_tubes + 1)
    return [f"rotation_{i}_deg" for i in tubes], [f"translation_{i}_mm" for i in tubes]


def joint_cells(rotations: Array, translations: Array) -> list[object]:
    """What is in these columns: rotations (n,) rad, translations (n,) m, in as many digits as tell them exactly."""
    return [*(in_unit(float(x), DEG) for x in rotations), *(in_unit(float(x), MM) for x in translations)]


def check_joints(table: CsvTable, robot: Robot) -> None:
    """Complain of cells in `joint_columns` that no tube can have; readings of calibrated drives are not looked at."""
    if robot.calibration is not None:
        return
    for columns in joint_columns(robot.n_tubes):
        for column, tube in zip(columns, robot.tubes, strict=True):
            for row in range(len(table.rows) if column in table.columns else 0):
                value = parse_number(table.cell(row, column))
                if isinstance(value, Decimal) and (allowed := reading_fault(tube, column, float(value))):
                    table.complain(row, column, f"is {value}; it must be {allowed}")


def waypoints_csv(rotations: Array, translations: Array) -> str:
    """The text of a file that `load_waypoints` reads: rotations (T, n) rad, translations (T, n) m."""
    turns, shifts = joint_columns(rotations.shape[1])
    return to_csv([*turns, *shifts], map(joint_cells, rotations, translations))


def load_waypoints(path: str | PathLike[str], robot: Robot) -> Waypoints:
    """The waypoints in a CSV file with the columns `joint_columns`; without those of translations, at home.

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no number: one line for each
            problem.
    """
    turns, shifts = joint_columns(robot.n_tubes)
    table = read_csv(path, (*turns, *shifts))
    listed = f"{turns[0]} to {turns[-1]} and {shifts[0]} to {shifts[-1]}"
    moved = table.expect(turns, together=shifts, shown=listed)
    rotations = table.numbers(turns, DEG)
    home = np.tile(robot.home_readings, (len(table.rows), 1))
    translations = table.numbers(shifts, MM) if moved else home
    check_joints(table, robot)
    table.check()
    return Waypoints(rotations, translations)
