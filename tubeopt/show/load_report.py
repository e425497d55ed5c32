"""What is said and saved about how much a robot bears, and about the forces that act on it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import RenderableType

from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import DEG, TO_MILLI, TO_MM, in_unit
from ..robots.load import Load
from ..runs.stability_studies import Bearing
from ..stability import LoadLimit
from ..validation import ForceEstimate, ForceRecord
from .formatting import counted, margin_in_words, millimetres, released, row
from .load_words import load_in_words
from .quantities import Quantity, described, line, of_field, rows, within
from .report import Drawing, Report, drawing, grid, remarks
from .snap_report import JOINTS, STATE

SHOWN = 20
"""Rows of a recording that a table shows."""

HAPPENS = {
    "fold": "the equilibrium vanishes, and the robot snaps",
    "bifurcation": "the equilibrium turns unstable, and the robot leaves it to one of two sides",
    "flutter": "the equilibrium turns unstable: slow oscillations about it grow",
}

LIMIT = described(
    LoadLimit,
    of_field(LoadLimit, "factor", label="lost at", words="{factor:.9g} times the load"),
    of_field(LoadLimit, "kind", label="there", words=lambda a: HAPPENS[a.kind]),
    line("tip before", lambda a: millimetres(a.before.tip_position, ".4f")),
    line("tip after", lambda a: None if a.after is None else millimetres(a.after.tip_position, ".4f")),
    of_field(LoadLimit, "tip_jump", label="the tip jumps",
             words=lambda a: None if a.after is None else f"{a.tip_jump * TO_MM:.4f} mm"),
    of_field(LoadLimit, "energy_released", label="energy released by tubes and load",
             words=lambda a: released(a.energy_released, "{:.4f} mJ") or None),
    line("margin after", lambda a: _margin_after(a)),
    of_field(LoadLimit, "before", of=STATE),
    of_field(LoadLimit, "after", of=STATE),
)  # fmt: skip


def _margin_after(limit: LoadLimit) -> str | None:
    """The margin of the equilibrium after the limit, in words."""
    if limit.after is None:
        return None
    if limit.kind == "bifurcation":
        # The load of `after` exceeds the limit by a small fraction, so its margin is small and no sign of a snap.
        return f"{limit.after.margin:.1e}, at a load just above the limit"
    return margin_in_words(limit.after.margin)


BEARING = described(
    Bearing,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    *JOINTS,
    Quantity("load", "the load, as text", lambda a: load_in_words(a.load), label="load", words="{load}"),
    "up_to",
    of_field(Bearing, "limit", of=LIMIT),
)  # fmt: skip


def _size(load: Load, factor: float) -> str:
    """How large a multiple of a load is: its force and moment at the tip if it has nothing else, and the factor."""
    alone = not load.points and load.distributed is None and load.gravity is None
    sizes = [(factor * float(np.linalg.norm(part)), unit) for part, unit in ((load.force, "N"), (load.moment, "N m"))]
    parts = [f"{x:.4g} {unit}" if x >= 1 else f"{x * TO_MILLI:.4g} m{unit}" for x, unit in sizes if x > 0]
    times = f"{factor:.6g} times the load"
    return f"{' and '.join(parts)} at the tip ({times})" if alone and parts else times


class BearingReport(Report[Bearing]):
    command = "load-limit"
    quantities = BEARING
    file = "load_limit.json"

    def title(self) -> str:
        a = self.answer
        name = a.robot.name or "the robot"
        if a.limit is None:
            return f"{name} withstands at least {_size(a.load, a.up_to)}, the largest load searched (--up-to)"
        return f"{name} withstands {_size(a.load, a.limit.factor)}"

    def rows(self) -> list[tuple[str, str]]:
        """The load, then the numbers of the limit."""
        limit = self.answer.limit
        return super().rows() + ([] if limit is None else rows(limit, LIMIT))

    def pictures(self) -> dict[str, Drawing]:
        """The robot at the limit, and where it lands as a ghost."""
        limit = self.answer.limit
        if limit is None:
            return {}
        words = f"{limit.factor:.4g} times the load, where the equilibrium is lost"
        if limit.after is None:
            return {"load_limit": drawing("shape.plot_shape", limit.before, remark=words)}
        return {"load_limit": drawing("shape.plot_shape", limit.before, ghosts=[limit.after],
                                      remark=f"{words}; ghost: where the robot lands")}  # fmt: skip


FORCE = described(
    ForceEstimate,
    "force",
    Quantity("standard_error_mN", "standard error along each axis; null if undetermined",
             lambda e: np.sqrt(np.diag(e.covariance))),
    "directions errors",
    Quantity("undetermined", "directions in which the force cannot be distinguished from zero", label="",
             words="{undetermined}"),
    "residual",
)  # fmt: skip

ESTIMATE: tuple[Quantity[tuple[int, ForceEstimate]], ...] = (
    Quantity("row", "row of the recording, from 1", lambda told: told[0]),
    *within(FORCE, lambda told: told[1]),
)


CONFIDENCE = (
    "standard errors are to second order in the noise; ForceEstimate.coverage computes how often the ellipsoid of a "
    "row holds the force, and contains asks the region of the likelihood"
)
"""What is said of standard errors."""

RECORD = described(
    ForceRecord,
    Quantity("robot", "name of the robot", lambda r: r.robot.name),
    Quantity("rows", "number of rows of the recording", lambda r: len(r.estimates), form="d",
             label="rows of the recording"),
    Quantity("told", "number of rows with an estimate", lambda r: sum(e is not None for e in r.estimates), form="d",
             label="rows with an estimate"),
    "noise",
    line("largest force", lambda r: _largest(r)),
    line("standard errors (median)", lambda r: _errors(r)),
    line("confidence", lambda r: CONFIDENCE if _told(r) else None),
    line("not significant", lambda r: _untold(r)),
    Quantity("estimates", "the force in every row with an estimate", lambda r: _told(r), of=ESTIMATE),
    Quantity("failures", "rows without an estimate, from 1, and the reason",
             lambda r: [[k + 1, why] for k, why in r.failures]),
    Quantity("remarks", "effects of the robot that the estimates ignore"),
)  # fmt: skip


def _largest(r: ForceRecord) -> str | None:
    sizes = np.linalg.norm(r.force, axis=1)
    if np.isnan(sizes).all():
        return None
    k = int(np.nanargmax(sizes))
    return f"{sizes[k] * TO_MILLI:.4g} mN in row {k + 1}: {row(r.force[k] * TO_MILLI, '.4g')} mN"


def _errors(r: ForceRecord) -> str | None:
    told = r.standard_error[~np.isnan(r.standard_error[:, 0])]
    return f"{row(np.median(told, axis=0) * TO_MILLI, '.3g')} mN along x, y, z" if len(told) else None


def _told(r: ForceRecord) -> list[tuple[int, ForceEstimate]]:
    return [(k, e) for k, e in enumerate(r.estimates, start=1) if e is not None]


def _untold(r: ForceRecord) -> str:
    count = sum(e is not None and e.undetermined.startswith("undetermined") for e in r.estimates)
    return f"in some direction in {counted(count, 'row', none='no row')}"


class ForceReport(Report[ForceRecord]):
    command = "force"
    quantities = RECORD
    file = "forces.json"

    def title(self) -> str:
        r = self.answer
        return f"{r.robot.name or 'robot'}: forces on the tip in {counted(len(r.estimates), 'row')}"

    def rows(self) -> list[tuple[str, str]]:
        """The recording in short, with the first rows that failed."""
        return [*super().rows(), *((f"row {k + 1}", why) for k, why in self.answer.failures[:5])]

    def below(self) -> list[RenderableType]:
        """Its first rows."""
        told = _told(self.answer)
        columns = ("row >", "force x, y, z (mN) >", "size (mN) >", "standard errors (mN) >")
        cells = (
            [
                str(k),
                row(e.force * TO_MILLI, ".2f"),
                f"{np.linalg.norm(e.force) * TO_MILLI:.2f}",
                row(np.sqrt(np.diag(e.covariance)) * TO_MILLI, ".3g"),
            ]
            for k, e in told[:SHOWN]
        )
        more = len(told) - SHOWN
        rest = [f"and {counted(more, 'row')} more, which --out saves in forces.csv"] if more > 0 else []
        return [grid(columns, cells), *remarks(rest), *remarks(self.answer.remarks, what="remark")]

    def save(self, directory: Path) -> list[Path]:
        """Write forces.json, and forces.csv with a row per row of the recording."""
        path = directory / "forces.csv"
        turns = [f"rotation_{i + 1}_deg" for i in range(self.answer.robot.n_tubes)]
        axes = [f"{name}_{axis}_mN" for name in ("force", "standard_error") for axis in "xyz"]
        corners = [f"covariance_{a}{b}_mN2" for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")]
        write_text(path, to_csv(["row", *turns, *axes, *corners, "residual_mm"], self._cells()))
        return [self.save_record(directory), path]

    def _cells(self) -> Iterator[list[object]]:
        upper = np.triu_indices(3)
        for k, e in enumerate(self.answer.estimates):
            turns = [in_unit(float(a), DEG) for a in self.answer.measurements.rotations[k]]
            if e is None:
                yield [k + 1, *turns, *[""] * 13]
                continue
            numbers = np.concatenate([e.force, np.sqrt(np.diag(e.covariance))]) * TO_MILLI
            square = e.covariance[upper] * TO_MILLI**2
            yield [k + 1, *turns, *(f"{v:.9g}" for v in (*numbers, *square, e.residual * TO_MM))]
