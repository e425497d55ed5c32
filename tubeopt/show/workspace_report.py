"""Reports on many configurations: a workspace, and a sweep of a study."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from ..errors import SolveError
from ..files.files import save_arrays
from ..files.units import TO_MM, per_si
from ..runs.sweeping import Sweep
from ..typing import Array
from ..workspaces import SnappingLoss, save_workspace
from ..workspaces.volume import Findings, Volume
from .quantities import Quantity, described, line, of_field, within
from .report import Drawing, Report, drawing

LOSS = described(
    SnappingLoss,
    "equilibria unstable",
    Quantity("held_volume_cm3", "volume that stable equilibria reach", form=".6g"),
    Quantity("lost_volume_cm3", "volume that only unstable equilibria reach", form=".6g",
             label="volume reached only by unstable equilibria"),
    "early_loss",
    Quantity("lost_fraction", "lost fraction of the whole volume", lambda loss: loss.fraction, form=".6g",
             label="lost fraction of the whole volume"),
    Quantity("lost_equilibria_interval", "95 % confidence interval of the fraction of all equilibria in lost voxels",
             lambda loss: list(loss.interval),
             text="{lost_equilibria_interval[0]:.2g} to {lost_equilibria_interval[1]:.2g}"),
)  # fmt: skip


def _extent(a: Findings, side: int) -> Array:
    """Smallest (side 0) or largest (1) coordinates of the voxels, m."""
    cubes = a.voxels
    # A voxel is known by its lower corner, so the upper end is one index further.
    corner: Array = (cubes.index.max(0) + 1) * cubes.size if side else cubes.index.min(0) * cubes.size
    return corner


def _min_margin(a: Findings) -> float:
    """Smallest margin of all samples."""
    # Part by part: a streamed workspace need not fit into memory.
    return float(min(np.nanmin(part[:, -1], initial=np.inf) for _, part in a.workspace.chunks()))


def _spans_text(a: Findings) -> str:
    """Ranges of the tip coordinates, as text."""
    parts = [part[:, -7:-4] for _, part in a.workspace.chunks()]
    low, high = (TO_MM * of([of(tips, axis=0) for tips in parts], axis=0) for of in (np.nanmin, np.nanmax))
    return ", ".join(f"{a} {x:.4g} to {y:.4g}" for a, x, y in zip("xyz", low, high, strict=True)) + " mm"


def _dexterity_text(a: Findings) -> str:
    """Mean and largest dexterity of the voxels, as text."""
    dexterity = a.voxels.dexterity
    return f"{100 * dexterity.mean():.1f} % of all directions per voxel, at most {100 * dexterity.max():.1f} %"


MERIDIAN: tuple[Quantity[Volume], ...] = (
    Quantity("meridian_volume_cm3", "volume as a body of revolution", lambda volume: volume.value, label="",
             text="{meridian_volume_cm3:.4g} cm3 as a body of revolution, "
             "{meridian_first_half_cm3:.4g} from the first half of the samples"),
    Quantity("meridian_first_half_cm3", "volume as a body of revolution, from the first half of the samples",
             lambda volume: volume.half),
)  # fmt: skip
"""Volume as a body of revolution, which does not always exist."""

ALPHA: tuple[Quantity[Volume], ...] = (
    Quantity("alpha_volume_cm3", "volume of the alpha shape", lambda volume: volume.value, label="",
             text="{alpha_volume_cm3:.4g} cm3 as alpha shape of radius {alpha_radius_mm:.3g} mm"),
    Quantity("alpha_radius_mm", "radius of the alpha shape", lambda volume: volume.scale),
)  # fmt: skip
"""Volume as an alpha shape, which does not always exist."""

WORKSPACE = described(
    Findings,
    Quantity("robot", "name of the robot", lambda a: a.workspace.robot.name),
    Quantity("method", "sampling method of the joint values", lambda a: a.workspace.method),
    Quantity("seed", "seed of random and Sobol samples", lambda a: a.workspace.seed),
    Quantity("samples", "number of samples", lambda a: len(a.workspace),
             text="{samples} ({method}), {without_equilibrium} without a stable equilibrium", label="samples"),
    Quantity("without_equilibrium", "number of samples without a stable equilibrium",
             lambda a: len(a.workspace.failures)),
    Quantity("counted", "number of samples with the required margin", lambda a: a.voxels.samples),
    Quantity("least_margin", "smallest margin", _min_margin, form=".4f", label="least margin"),
    line("tip range", _spans_text),
    Quantity("lower_mm", "smallest coordinates of the voxels", lambda a: _extent(a, 0)),
    Quantity("upper_mm", "largest coordinates of the voxels", lambda a: _extent(a, 1)),
    Quantity("voxel_mm", "edge of a voxel", lambda a: a.voxels.size),
    Quantity("voxels", "number of voxels reached", lambda a: len(a.voxels)),
    Quantity("volume_cm3", "volume", lambda a: a.volume.value,
             text="{volume_cm3:.4g} cm3 in {voxels} voxels of {voxel_mm:g} mm"),
    Quantity("volume_surface_cm3", "half of the volume of the voxels on the surface, as error estimate",
             lambda a: a.volume.surface, label="",
             text="+- {volume_surface_cm3:.4g} cm3 (half of the voxels on the surface)"),
    Quantity("volume_first_half_cm3", "volume from the first half of the samples", lambda a: a.volume.half, label="",
             text="{volume_first_half_cm3:.4g} cm3 from the first half of the samples"),
    Quantity("volume_unseen_cm3", "estimated volume not yet sampled", lambda a: a.volume.unseen, label="",
             text="{volume_unseen_cm3:.4g} cm3 estimated as not yet sampled"),
    *within(MERIDIAN, lambda a: a.meridian),
    *within(ALPHA, lambda a: a.alpha),
    line("dexterity", _dexterity_text),
    Quantity("mean_dexterity", "mean fraction of all directions in which a voxel is reached",
             lambda a: a.voxels.dexterity.mean()),
    Quantity("largest_dexterity", "largest fraction of all directions in which a voxel is reached",
             lambda a: a.voxels.dexterity.max()),
    of_field(Findings, "loss", label="unstable",
             text="{snapping[unstable]} of {snapping[equilibria]} equilibria", of=LOSS),
    line("lost to snapping", lambda a: None if a.loss is None else _loss_text(a.loss)),
)  # fmt: skip


def _loss_text(loss: SnappingLoss) -> str:
    """Volume and fraction lost to snapping, as text."""
    low, high = (100 * end for end in loss.interval)
    interval = f"{low:.2g} to {high:.2g} % of all equilibria (95 % confidence)"
    return f"{loss.lost_volume * per_si('cm3'):.4g} cm3, {100 * loss.fraction:.2f} %; {interval}"


class WorkspaceReport(Report[Findings]):
    command = "workspace"
    quantities = WORKSPACE

    def title(self) -> str:
        return f"{self.answer.workspace.robot.name or 'robot'}: workspace"

    def save(self, directory: Path) -> list[Path]:
        """Write voxels.npz, in SI, next to the samples; streamed samples are already there."""
        samples = save_workspace(self.answer.workspace, directory)
        a = self.answer
        fields = {name: getattr(a.voxels, name) for name in ("size", "index", "count", "dexterity", "margin")}
        lost = {} if a.loss is None else {"held": a.loss.held, "lost": a.loss.lost}
        return [*samples, save_arrays(directory / "voxels.npz", **fields, **lost)]

    def tables(self) -> dict[str, Any]:
        return {"samples": self.answer.workspace}

    def pictures(self) -> dict[str, Drawing]:
        """Pictures of the workspace: from two sides, and in a section."""
        a = self.answer
        return {"workspace": drawing("workspace.plot_workspace", a.workspace, loss=a.loss)}


SHOWN = 3
"""Number of listed failures; the table has all."""

FAILURE: tuple[Quantity[tuple[int, str]], ...] = (
    Quantity("point", "number of the point, from 1", lambda failed: failed[0] + 1),
    Quantity("reason", "reason for the failure", lambda failed: failed[1]),
)

SWEEP = described(
    Sweep,
    of_field(Sweep, "points", label="points", text=lambda a: _points(a)),
    "computed",
    Quantity("failed", "number of failed points", lambda a: len(a.failures), form="d", label="failed"),
    of_field(Sweep, "failures", of=FAILURE),
    Quantity("table", "file of the table", lambda a: _kept(a, a.table)),
    Quantity("arrays", "file of the same arrays", lambda a: _kept(a, a.arrays)),
    Quantity("journal", "journal: a line per point, in order of computation", lambda a: _kept(a, a.journal)),
    Quantity("rows", "the table, if no directory was given", lambda a: None if a.rows is None else list(a.rows),
             optional=True),
)  # fmt: skip


def _kept(a: Sweep, path: Path) -> str | None:
    """Path of the stored samples."""
    return str(path) if a.rows is None else None


def _points(a: Sweep) -> str:
    before = a.points - a.computed
    return f"{a.points}" + (f", {before} of them from an earlier run" if before else "")


class SweepReport(Report[Sweep]):
    command = "sweep"
    quantities = SWEEP

    def table(self) -> RenderableType:
        """Summary of the table; the table itself as CSV if it is not saved."""
        a = self.answer
        if a.rows is None:
            return super().table()
        written = io.StringIO()
        table = csv.DictWriter(written, list(a.rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(a.rows)
        return written.getvalue().rstrip()

    def title(self) -> str:
        return "sweep"

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the number of points, the first failures and the files."""
        a = self.answer
        failures = [(f"  point {index + 1}", reason) for index, reason in a.failures[:SHOWN]]
        if len(a.failures) > SHOWN:
            failures.append(("", f"and {len(a.failures) - SHOWN} more, in the table"))
        return [*super().rows(), *failures, ("table", str(a.table)), ("arrays", str(a.arrays))]

    def tables(self) -> dict[str, Any]:
        """Table of the sweep, for formats other than CSV and npz."""
        return {"table": self.answer}

    def conclude(self) -> None:
        """Raise SolveError if every point failed."""
        a = self.answer
        if len(a.failures) == a.points:
            raise SolveError(f"all {a.points} points failed; the first: {a.failures[0][1]}")
