"""Report on the loads of drives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..equilibrium.readings import to_readings
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import TO_MILLI
from ..robots.file import joint_cells, joint_columns
from ..stability import Drives
from ..stability.drives import DrivesStatus
from ..typing import Array
from .formatting import counted
from .quantities import Quantity, described
from .report import Drawing, Report, drawing


def _where(load: Array) -> Array:
    """Numbers (k,), from 1, of the rows of the table with the largest loads of (T, k)."""
    return np.asarray(np.abs(load).argmax(0) + 1)


def _known(values: Array) -> Array | None:
    """Powers, or None without times and rates."""
    return values if np.isfinite(values).all() else None


DRIVES = described(
    Drives,
    Quantity("robot", "name of the robot", lambda d: d.robot.name),
    Quantity("of", "subject of the loads, as a sentence", lambda d: str(d.status)),
    Quantity("equilibria", "number of equilibria", lambda d: d.statistics.equilibria, form="d"),
    Quantity("failures", "configurations without a stable equilibrium", lambda d: d.statistics.failures),
    Quantity("peak_torque_mN_m", "largest torque of every rotation drive", form=".4g"),
    Quantity("peak_torque_row", "row of each in drives.csv, from 1", lambda d: _where(d.torque)),
    Quantity("peak_force_mN", "largest force of every carriage", form=".4g"),
    Quantity("peak_force_row", "row of each in drives.csv, from 1", lambda d: _where(d.force)),
    Quantity("peak_torque_power_mW", "largest power of every rotation drive; null without times or rates",
             lambda d: _known(d.peak_torque_power), form=".4g", label="largest power of every rotation drive"),
    Quantity("peak_force_power_mW", "largest power of every carriage; null without times or rates",
             lambda d: _known(d.peak_force_power), form=".4g", label="largest power of every carriage"),
    Quantity("work_mJ", "work of all drives along the motion; absent at single configurations",
             lambda d: None if d.status is DrivesStatus.AT else d.work, form=".4g",
             label="work of all drives", optional=True),
    "heat",
    Quantity("snaps", "number of snaps along the motion", lambda d: len(d.snaps), form="d"),
)  # fmt: skip


class DrivesReport(Report[Drives]):
    command = "drives"
    quantities = DRIVES
    file = "drives.json"

    def title(self) -> str:
        d = self.answer
        snaps = f", {counted(len(d.snaps), 'snap')}" if d.snaps else ""
        return f"{d.robot.name or 'robot'}: {d.status}{snaps}"

    def save(self, directory: Path) -> list[Path]:
        """Write drives.json, and drives.csv with a row per equilibrium."""
        d, path = self.answer, directory / "drives.csv"
        turns, shifts = joint_columns(d.robot.n_tubes)
        torques = [f"torque_{i + 1}_mN_m" for i in range(d.torque.shape[1])]
        forces = [f"force_{i + 1}_mN" for i in range(d.force.shape[1])]
        first = "time_s" if d.timed else "number"
        write_text(path, to_csv([first, *turns, *shifts, *torques, *forces], self._cells()))
        return [*super().save(directory), path]

    def _cells(self) -> Iterator[Sequence[object]]:
        d = self.answer
        loads = np.concatenate([d.torque, d.force], axis=1) * TO_MILLI
        for at, rotations, translations, row in zip(d.at, d.rotations, d.translations, loads, strict=True):
            joints = joint_cells(*to_readings(d.robot, rotations, translations))
            yield [f"{at:.9g}", *joints, *(f"{value:.9g}" for value in row)]

    def tables(self) -> dict[str, Any]:
        return {}

    def pictures(self) -> dict[str, Drawing]:
        return {"drives": drawing("drives.plot_drives", self.answer)}
