"""`tubeopt workspace`: where a robot reaches, from how many sides, and what snapping takes."""

from __future__ import annotations

from ..runs.workspace_study import WorkspaceStudy
from .flags import answer, asks
from .output import Output


@asks(WorkspaceStudy, example="tubeopt workspace configs/robots/crl_ctr.yaml --samples 20000 --out results")
def workspace(study: WorkspaceStudy, output: Output) -> None:
    """Where the tip reaches within the robot's limits: volume, directions, margin, and the part lost to snapping.

    With --out the samples are saved as they come, so that memory does not grow with them, and a run that was stopped
    goes on.
    """
    answer(study, output)
