"""`tubeopt workspace`: where a robot reaches, from how many sides, and what snapping takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from ..errors import InputError, positive
from ..files.files import atomic_write
from ..robots.file import load_robot
from ..show.report import can_be_saved, present, report, two_columns
from ..show.words import MM
from ..workspaces import METHODS, SnappingLoss, examine, save_workspace
from ..workspaces import workspace as compute
from ..workspaces.findings import Findings
from ..workspaces.loss import require_centred
from .options import JsonOption, OutOption, PlotOption, RobotArgument
from .sweep import counting

CUBIC_CM = 1e6


def workspace(
    robot: RobotArgument,
    samples: Annotated[int, typer.Option(metavar="N", help="Joint values.")] = 10_000,
    method: Annotated[str, typer.Option(help=f"How they are chosen: {', '.join(METHODS)}.")] = METHODS[0],
    seed: Annotated[int, typer.Option(metavar="K", help="Of random and Sobol points.")] = 0,
    voxel_mm: Annotated[
        float | None, typer.Option(metavar="MM", help="Edge of the voxels; by default for about fifty samples in each.")
    ] = None,
    min_margin: Annotated[
        float, typer.Option(metavar="MU", help="Only configurations at least as stable count.")
    ] = 0.0,
    loss: Annotated[
        int, typer.Option(metavar="N", help="Find what is lost to snapping from so many equilibria of all kinds.")
    ] = 0,
    workers: Annotated[int, typer.Option(metavar="N", help="Threads; 0 is one per core.")] = 1,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Where the tip reaches within the robot's limits: volume, directions, margin, and the part lost to snapping.

    With --out the samples are saved as they come, so that memory does not grow with them, and a run that was stopped
    goes on.
    """
    for flag, value, least in (("samples", samples, 1), ("seed", seed, 0), ("loss", loss, 0), ("workers", workers, 0)):
        if value < least:
            raise InputError(f"--{flag} is {value}; it must be at least {least}")
    size = None if voxel_mm is None else positive("--voxel-mm", voxel_mm) / MM
    if not min_margin <= 1:
        raise InputError(f"--min-margin is {min_margin:g}; no margin is above 1")
    question = load_robot(robot)
    if loss:
        require_centred(question)
    can_be_saved(out)
    with counting("solving") as progress:
        found = compute(
            question,
            samples,
            method=method,
            seed=seed,
            out=out,
            workers=workers,
            progress=lambda done, total: progress(done, total, 0),
        )
    with counting("unstable equilibria") as progress:
        answer = examine(
            found,
            size,
            min_margin=min_margin,
            loss=loss,
            progress=lambda done, total: progress(done, total, 0),
        )
    present(WorkspaceReport(answer), out=out, as_json=as_json, plot=plot)


@dataclass(frozen=True)
class WorkspaceReport:
    """What is said and saved about a workspace."""

    answer: Findings

    def record(self) -> dict[str, Any]:
        """The answer as JSON: extent, volumes, dexterity, margins, loss."""
        volume, low, high = self.answer.volume, *self._extent()
        margins = self._margins()
        return {
            "robot": self.answer.workspace.robot.name,
            "method": self.answer.workspace.method,
            "seed": self.answer.workspace.seed,
            "samples": len(self.answer.workspace),
            "without_equilibrium": len(self.answer.workspace.failures),
            "counted": self.answer.voxels.samples,
            "least_margin": float(margins.min()),
            "lower_mm": (low * MM).tolist(),
            "upper_mm": (high * MM).tolist(),
            "voxel_mm": self.answer.voxels.size * MM,
            "voxels": len(self.answer.voxels),
            "volume_cm3": volume.value * CUBIC_CM,
            "volume_first_half_cm3": volume.half * CUBIC_CM,
            "volume_unseen_cm3": volume.unseen * CUBIC_CM,
            "volume_surface_cm3": volume.surface * CUBIC_CM,
            "meridian_volume_cm3": None if self.answer.meridian is None else self.answer.meridian.value * CUBIC_CM,
            "meridian_first_half_cm3": None if self.answer.meridian is None else self.answer.meridian.half * CUBIC_CM,
            "alpha_volume_cm3": None if self.answer.alpha is None else self.answer.alpha.value * CUBIC_CM,
            "alpha_radius_mm": None if self.answer.alpha is None else self.answer.alpha.scale * MM,
            "mean_dexterity": float(self.answer.voxels.dexterity.mean()),
            "largest_dexterity": float(self.answer.voxels.dexterity.max()),
            "snapping": None if self.answer.loss is None else _loss_record(self.answer.loss),
        }

    def _extent(self) -> tuple[np.ndarray, np.ndarray]:
        cubes = self.answer.voxels
        return cubes.index.min(0) * cubes.size, (cubes.index.max(0) + 1) * cubes.size

    def _margins(self) -> np.ndarray:
        least = [np.nanmin(part[:, -1], initial=np.inf) for _, part in self.answer.workspace.chunks()]
        return np.array(least)

    def table(self) -> Table:
        """The answer as a table."""
        r = self.record()
        spans = [
            f"{a} {low:.4g} to {high:.4g}" for a, low, high in zip("xyz", r["lower_mm"], r["upper_mm"], strict=True)
        ]
        rows = [
            ("samples", f"{r['samples']} ({r['method']}), {r['without_equilibrium']} without a stable equilibrium"),
            ("least margin", f"{r['least_margin']:.4f}"),
            ("tips within", ", ".join(spans) + " mm"),
            ("volume", f"{r['volume_cm3']:.4g} cm3 in {r['voxels']} voxels of {r['voxel_mm']:g} mm"),
            ("", f"give or take {r['volume_surface_cm3']:.3g} cm3, half of the voxels on the surface"),
            ("", f"{r['volume_first_half_cm3']:.4g} cm3 from the first half of the samples"),
            ("", f"{r['volume_unseen_cm3']:.3g} cm3 estimated as not seen yet"),
        ]
        if r["meridian_volume_cm3"] is not None:
            half = f"{r['meridian_first_half_cm3']:.4g} from the first half of the samples"
            rows.append(("", f"{r['meridian_volume_cm3']:.4g} cm3 as a body of revolution, {half}"))
        if r["alpha_volume_cm3"] is not None:
            rows.append(("", f"{r['alpha_volume_cm3']:.4g} cm3 as alpha shape of radius {r['alpha_radius_mm']:.3g} mm"))
        dexterity = f"{100 * r['mean_dexterity']:.1f} % of all directions per voxel, at most"
        rows.append(("dexterity", f"{dexterity} {100 * r['largest_dexterity']:.1f} %"))
        if r["snapping"] is not None:
            lost = r["snapping"]
            rows += [
                ("unstable", f"{lost['unstable']} of {lost['equilibria']} equilibria"),
                ("lost to snapping", f"{lost['lost_volume_cm3']:.4g} cm3, {100 * lost['lost_fraction']:.2f} %"),
            ]
        return two_columns(f"{r['robot'] or 'robot'}: workspace", rows)

    def save(self, directory: Path) -> list[Path]:
        """Write voxels.npz, in SI, beside the samples, which are there already where they were streamed."""
        samples = save_workspace(self.answer.workspace, directory)
        path = directory / "voxels.npz"
        c = self.answer.voxels
        lost: dict[str, Any] = (
            {} if self.answer.loss is None else {"held": self.answer.loss.held, "lost": self.answer.loss.lost}
        )
        with atomic_write(path) as temporary:
            np.savez(
                temporary,
                size=np.array(c.size),
                index=c.index,
                count=c.count,
                dexterity=c.dexterity,
                margin=c.margin,
                **lost,
            )
        return [*samples, path]

    def draw(self, directory: Path) -> list[Path]:
        """Write workspace.png."""
        from ..show.plots.workspace import plot_workspace  # Matplotlib takes longer to load than a solve

        path = directory / "workspace.png"
        with atomic_write(path) as temporary:
            plot_workspace(self.answer.workspace, temporary, loss=self.answer.loss, size=self.answer.voxels.size)
        return [path]


@report.register
def _(answer: Findings) -> WorkspaceReport:
    return WorkspaceReport(answer)


def _loss_record(lost: SnappingLoss) -> dict[str, Any]:
    return {
        "equilibria": lost.equilibria,
        "unstable": lost.unstable,
        "held_volume_cm3": lost.held_volume * CUBIC_CM,
        "lost_volume_cm3": lost.lost_volume * CUBIC_CM,
        "lost_first_half_cm3": lost.early_loss * CUBIC_CM,
        "lost_fraction": lost.fraction,
    }
