"""`tubeopt workspace`: where a robot reaches, from how many sides, and what snapping takes."""

from __future__ import annotations

from typing import Annotated

import typer

from ..errors import InputError, positive
from ..files.units import TO_MM
from ..robots.file import load_robot
from ..show.progress import counting
from ..show.report import can_be_saved, present
from ..show.reports import report
from ..workspaces import METHODS, examine
from ..workspaces import workspace as compute
from ..workspaces.loss import require_centred
from .options import JsonOption, OutOption, PlotOption, RobotArgument


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
    size = None if voxel_mm is None else positive("--voxel-mm", voxel_mm) / TO_MM
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
    present(report(answer), out=out, as_json=as_json, plot=plot)
