"""The study of a workspace: its tips, its volume, and the part lost to snapping."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ..typing import Progress
from ..workspaces import Findings, examine, workspace
from ..workspaces.loss import require_centred
from .robot_keys import RobotPath
from .study_file import Arguments, Options, question


@question("solving", keeps="finished samples are in {out}; the same command continues")
def find_workspace(
    robot: RobotPath,
    sampling: Annotated[Options, Arguments(workspace, "samples", "method", "seed", "workers")],
    examined: Annotated[Options, Arguments(examine, "size", "min_margin", "loss")],
    out: Path | None = None,
    progress: Progress | None = None,
) -> Findings:
    """Tips at many joint values within a robot's limits.

    With `out` the samples are saved there as they come, and a run that was stopped continues.
    """
    if examined["loss"]:
        require_centred(robot)  # before the samples, which take minutes
    found = workspace(robot, out=out, progress=progress, **sampling)
    return examine(found, progress=progress, **examined)
