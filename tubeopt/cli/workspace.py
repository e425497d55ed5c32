"""`tubeopt workspace`: where a robot reaches, from how many sides, and what snapping takes."""

from __future__ import annotations

from ..runs.workspace_study import WorkspaceStudy
from ..show.progress import counting
from ..show.report import can_be_saved, present
from ..show.reports import report
from .flags import asks
from .options import JsonOption, OutOption, PlotOption


@asks(WorkspaceStudy)
def workspace(
    study: WorkspaceStudy, plot: PlotOption = False, out: OutOption = None, as_json: JsonOption = False
) -> None:
    """Where the tip reaches within the robot's limits: volume, directions, margin, and the part lost to snapping.

    With --out the samples are saved as they come, so that memory does not grow with them, and a run that was stopped
    goes on.
    """
    can_be_saved(out)
    with counting("solving") as progress:
        answer = study.run(lambda done, total: progress(done, total, 0), out=out)
    present(report(answer), out=out, as_json=as_json, plot=plot)
