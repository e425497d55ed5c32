"""Reports on the loads of drives and the fatigue of tubes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.console import RenderableType

from ..equilibrium.readings import to_readings
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import TO_MILLI, TO_MM
from ..robots.file import joint_cells, joint_columns
from ..stability import Drives, Fatigue, TubeFatigue
from ..stability.drives import DrivesStatus
from ..typing import Array
from .formatting import counted
from .quantities import Quantity, described
from .report import Drawing, Report, drawing, grid


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

    def pictures(self) -> dict[str, Drawing]:
        return {"drives": drawing("drives.plot_drives", self.answer)}


TUBE_FATIGUE = described(
    TubeFatigue,
    "amplitude mean largest place fibre",
    Quantity("cycles_percent", "amplitude and mean of every cycle of one repetition, the largest first",
             lambda t: np.column_stack([t.cycles.amplitude, t.cycles.mean])),
    Quantity("endurance", "life by published tests of nitinol, as a sentence", lambda t: str(t.endurance)),
    Quantity("life", "median repetitions to failure by the given curve; null without one, and beyond it",
             lambda t: _number(t.life)),
    Quantity("life_low", "lower end of its scatter", lambda t: _number(t.life_range[0])),
    Quantity("life_high", "upper end of its scatter", lambda t: _number(t.life_range[1])),
)  # fmt: skip

FATIGUE = described(
    Fatigue,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    Quantity("returned", "true if the motion is repeated forth and back"),
    Quantity("equilibria", "number of equilibria of one repetition", lambda a: a.statistics.equilibria),
    Quantity("snaps", "number of snaps of one repetition", lambda a: a.statistics.snaps, form="d"),
    Quantity("tubes", "strains of the tubes, inner to outer", lambda a: list(a.tubes), of=TUBE_FATIGUE),
)  # fmt: skip


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


class FatigueReport(Report[Fatigue]):
    command = "fatigue"
    quantities = FATIGUE
    file = "fatigue.json"

    def title(self) -> str:
        way = "forth and back" if self.answer.returned else "as a loop"
        return f"{self.answer.robot.name or 'robot'}: strain cycles of a motion that is repeated {way}"

    def rows(self) -> list[tuple[str, str]]:
        """Rows of the table, with the life of each tube by published tests."""
        lives = [(f"tube {i}", str(t.endurance)) for i, t in enumerate(self.answer.tubes, start=1)]
        return [*super().rows(), *lives]

    def below(self) -> list[RenderableType]:
        """A row per tube."""
        cells = [
            (
                str(i),
                f"{100 * t.amplitude:.3f}",
                f"{100 * t.mean:.3f}",
                f"{t.place * TO_MM:.1f}",
                str(len(t.cycles.amplitude)),
                f"{t.life:.2g}" if np.isfinite(t.life) else "",
            )
            for i, t in enumerate(self.answer.tubes, start=1)
        ]
        columns = ("tube", "amplitude (%) >", "mean (%) >", "place (mm) >", "cycles >", "life >")
        return [grid(columns, cells)]

    def save(self, directory: Path) -> list[Path]:
        """Write fatigue.json, and strain.csv with the strain of every tube over one repetition."""
        a, path = self.answer, directory / "strain.csv"
        columns = ["waypoint", *(f"strain_{i + 1}_percent" for i in range(len(a.tubes)))]
        table = np.column_stack([a.tubes[0].waypoint, *(100 * t.history for t in a.tubes)])
        write_text(path, to_csv(columns, ([f"{v:.9g}" for v in row] for row in table)))
        return [*super().save(directory), path]

    def pictures(self) -> dict[str, Drawing]:
        return {"fatigue": drawing("drives.plot_fatigue", self.answer)}
