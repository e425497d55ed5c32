"""What is said and saved about equilibria, about a snap, and about motion with snaps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..equilibrium.result import Equilibrium
from ..files.csv_file import to_csv
from ..files.files import atomic_write, write_text
from ..files.units import DEG, in_unit
from ..files.units import MM as MM_UNIT
from ..robots.path_file import joint_columns
from ..runs.stability_studies import Equilibria, Motion, Way
from ..stability import Snap
from .report import report, to_text, two_columns
from .words import MILLI, MM, degrees, in_a_word, millimetres, row, snap_record, state


@dataclass(frozen=True)
class EquilibriaReport:
    """What is said and saved about all equilibria at given joint values."""

    answer: Equilibria

    def record(self) -> dict[str, Any]:
        """The answer as JSON: joint values, and the equilibria, the lowest energy first."""
        a = self.answer
        return {
            "robot": a.robot.name,
            "rotations_deg": np.degrees(a.rotations).tolist(),
            "translations_mm": (a.translations * MM).tolist(),
            "equilibria": [
                state(e) | {"residual_rad": e.residual, "tip_error_mm": e.tip_error * MM} for e in a.equilibria
            ],
        }

    def table(self) -> Group:
        """A row per equilibrium."""
        a = self.answer
        stable = sum(e.stable for e in a.equilibria)
        count = "1 equilibrium" if len(a.equilibria) == 1 else f"{len(a.equilibria)} equilibria"
        head = f"{a.robot.name or 'robot'}: {count} ({stable} stable) at rotations {degrees(a.rotations)}"
        table = Table(box=None, padding=(0, 1, 0, 0))
        for name in ("tip (mm)", "tubes' tips (deg)", "margin", "mJ", "index", ""):
            table.add_column(name, justify="left" if "tip" in name or not name else "right", header_style="bold")
        for e in a.equilibria:
            table.add_row(
                row(e.tip_position * MM, ".2f"),
                row(np.degrees(e.tip_rotations), ".2f"),
                f"{e.margin:.4f}",
                f"{e.potential * MILLI:.4f}",
                str(e.index),
                in_a_word(e.margin),
            )
        return Group(Text(f"{head}, translations {millimetres(a.translations)}"), table)

    def save(self, directory: Path) -> list[Path]:
        """Write equilibria.json."""
        path = directory / "equilibria.json"
        write_text(path, to_text(self.record()))
        return [path]

    def draw(self, directory: Path) -> list[Path]:
        """Write equilibria.png: the shape of lowest energy, the others as ghosts."""
        lowest, *others = self.answer.equilibria
        return [_draw_shape(directory / "equilibria.png", lowest, others)]


@dataclass(frozen=True)
class WayReport:
    """What is said and saved about a straight way of joint values, with a snap or without."""

    way: Way

    def record(self) -> dict[str, Any]:
        """The answer as JSON: the way, the answer in words, and the snap or where the branch arrives."""
        w = self.way
        (alpha, shift), (beta, moved) = w.start, w.end
        return {
            "robot": w.robot.name,
            "from_deg": np.degrees(alpha).tolist(),
            "from_mm": (shift * MM).tolist(),
            "to_deg": np.degrees(beta).tolist(),
            "to_mm": (moved * MM).tolist(),
            "answer": self.sentence(),
            "snap": None if w.snap is None else snap_record(w.snap),
            "arrived": None if w.arrived is None else state(w.arrived),
        }

    def sentence(self) -> str:
        """What happens on the way."""
        w = self.way
        if w.snap is not None:
            return (
                f"snaps {100 * w.snap.fraction:.6f} % of the way, at rotations {degrees(w.snap.rotations)}, "
                f"translations {millimetres(w.snap.translations)}"
            )
        margin = "" if w.arrived is None else f", with margin {w.arrived.margin:.3f}"
        return f"does not snap: the branch reaches the end of the way{margin}"

    def table(self) -> Group:
        """The answer in words, then the numbers of the snap."""
        w = self.way
        rows = [
            ("from", f"rotations {degrees(w.start[0])}, translations {millimetres(w.start[1])}"),
            ("to", f"rotations {degrees(w.end[0])}, translations {millimetres(w.end[1])}"),
        ]
        if w.snap is not None:
            rows += _snap_rows(w.snap)
        elif w.arrived is not None:
            rows.append(("tip at the end", millimetres(w.arrived.tip_position, ".4f")))
        return Group(Text(f"{w.robot.name or 'the robot'} {self.sentence()}"), two_columns("", rows))

    def save(self, directory: Path) -> list[Path]:
        """Write snap.json."""
        path = directory / "snap.json"
        write_text(path, to_text(self.record()))
        return [path]

    def draw(self, directory: Path) -> list[Path]:
        """Write snap.png: the robot before and after the snap, or arrived at the end."""
        path = directory / "snap.png"
        if self.way.snap is not None:
            return [draw_snap(path, self.way.snap)]
        return [] if self.way.arrived is None else [_draw_shape(path, self.way.arrived, [])]


def _snap_rows(snap: Snap) -> list[tuple[str, str]]:
    before, after = snap.before, snap.after
    return [
        ("snap at rotations", degrees(snap.rotations)),
        ("translations", millimetres(snap.translations)),
        ("tip before", millimetres(before.tip_position, ".4f")),
        ("tip after", millimetres(after.tip_position, ".4f")),
        ("the tip jumps", f"{snap.tip_jump * MM:.4f} mm"),
        ("energy released", f"{snap.energy_released * MILLI:.4f} mJ"),
        ("tubes' tips before", degrees(before.tip_rotations, ".6f")),
        ("tubes' tips after", degrees(after.tip_rotations, ".6f")),
        ("margin after", f"{after.margin:.3f}, {in_a_word(after.margin)}"),
    ]


@dataclass(frozen=True)
class MotionReport:
    """What is said and saved about motion through waypoints. Waypoints are counted from 1."""

    motion: Motion

    def record(self) -> dict[str, Any]:
        """The answer as JSON: the state at every waypoint, and the snaps."""
        return {
            "robot": self.motion.robot.name,
            "waypoints": [
                {
                    "rotations_deg": np.degrees(e.rotations).tolist(),
                    "translations_mm": (e.translations * MM).tolist(),
                }
                | state(e)
                for e in self.motion.path.equilibria
            ],
            "snaps": self._snaps(),
        }

    def _snaps(self) -> list[dict[str, Any]]:
        return [{"after_waypoint": snap.index + 1} | snap_record(snap) for snap in self.motion.path.snaps]

    def table(self) -> Group:
        """How far it went, and a row per snap."""
        path = self.motion.path
        count = {0: "no snap", 1: "1 snap"}.get(len(path.snaps), f"{len(path.snaps)} snaps")
        least = min(e.margin for e in path.equilibria)
        last = path.equilibria[-1]
        rows = [
            ("least margin", f"{least:.3f} at a waypoint"),
            ("tip at the end", millimetres(last.tip_position, ".4f")),
        ]
        name = self.motion.robot.name or "robot"
        head = two_columns(f"{name}: {len(path.equilibria)} waypoints, {count}", rows)
        if not path.snaps:
            return Group(head)
        table = Table(box=None, padding=(0, 2, 0, 0), title="snaps", title_justify="left")
        for column in ("waypoints", "at (%)", "rotations (deg)", "translations (mm)", "tip jump (mm)", "energy (mJ)"):
            table.add_column(column, justify="right" if "(" in column[:9] or "energy" in column else "left")
        for snap in path.snaps:
            table.add_row(
                f"{snap.index + 1} to {snap.index + 2}",
                f"{100 * snap.fraction:.3f}",
                row(np.degrees(snap.rotations), ".7g"),
                row(snap.translations * MM, ".6g"),
                f"{snap.tip_jump * MM:.3f}",
                f"{snap.energy_released * MILLI:.4f}",
            )
        return Group(head, table)

    def save(self, directory: Path) -> list[Path]:
        """Write path.csv and snaps.json."""
        turns, shifts = joint_columns(self.motion.robot.n_tubes)
        columns = ["waypoint", *turns, *shifts, "tip_x_mm", "tip_y_mm", "tip_z_mm", "margin"]
        path, snaps = directory / "path.csv", directory / "snaps.json"
        write_text(path, to_csv(columns, self._rows()))
        write_text(snaps, to_text({"robot": self.motion.robot.name, "snaps": self._snaps()}))
        return [path, snaps]

    def _rows(self) -> Iterator[Sequence[object]]:
        for k, e in enumerate(self.motion.path.equilibria, start=1):
            turns = [in_unit(float(angle), DEG) for angle in e.rotations]
            shifts = [in_unit(float(shift), MM_UNIT) for shift in e.translations]
            tip = [round(float(x), 9) + 0.0 for x in e.tip_position * MM]
            yield [k, *turns, *shifts, *tip, round(e.margin, 12)]

    def draw(self, directory: Path) -> list[Path]:
        """Write path.png: the tip and the margin over the waypoints, with the snaps."""
        from .plots import plot_path  # Matplotlib takes longer to load than a solve

        path = directory / "path.png"
        with atomic_write(path) as temporary:
            plot_path(self.motion.path, temporary)
        return [path]


def draw_snap(path: Path, snap: Snap) -> Path:
    """Write the picture of a snap."""
    from .plots import plot_snap  # Matplotlib takes longer to load than a solve

    with atomic_write(path) as temporary:
        plot_snap(snap, temporary)
    return path


def _draw_shape(path: Path, equilibrium: Equilibrium, ghosts: Sequence[Equilibrium]) -> Path:
    from .plots import plot_shape  # Matplotlib takes longer to load than a solve

    with atomic_write(path) as temporary:
        plot_shape(equilibrium, temporary, ghosts=ghosts)
    return path


@report.register
def _(answer: Equilibria) -> EquilibriaReport:
    return EquilibriaReport(answer)


@report.register
def _(answer: Way) -> WayReport:
    return WayReport(answer)


@report.register
def _(answer: Motion) -> MotionReport:
    return MotionReport(answer)
