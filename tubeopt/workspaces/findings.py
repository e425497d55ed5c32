"""All that is asked about a workspace at once: its voxels, its volume by every method, and what snapping takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, finite
from ..files.field_metadata import POSITIVE, Range, Typical, key
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Progress
from .loss import SnappingLoss, snapping_loss
from .table import Workspace
from .volume import Volume, alpha_volume, meridian_volume, volume_of
from .voxels import Voxels, voxels


@dataclass(frozen=True, eq=False)
class Findings(Displayed):
    """A workspace and what was found about it; a volume is None where its method has no answer, a loss where it was
    not asked for."""

    workspace: Workspace
    voxels: Voxels
    """That the tips reach."""
    volume: Volume
    meridian: Volume | None
    """Volume of a body of revolution."""
    alpha: Volume | None
    """Volume of an alpha shape."""
    loss: SnappingLoss | None


@typed
@limited
def examine(
    workspace: Workspace,
    size: Annotated[float | None, key("voxel_mm"), POSITIVE, Typical(1e-5, 0.1)] = None,
    *,
    min_margin: Annotated[float, Range(most=1.0)] = 0.0,
    loss: Annotated[int, Range(least=0)] = 0,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Findings:
    """Voxels, volumes and loss of a workspace.

    Args:
        size: edge length of the voxels; by default a round number for about 15 samples per voxel of
            the bounding box.
        min_margin: smallest stability margin of a counted configuration.
        loss: number of sampled equilibria, stable or not, that estimate the share of the workspace lost to snapping; 0
            to skip.
        progress: of the loss.
        time_limit: s, on the clock.

    Raises:
        InputError: as `voxels` and `snapping_loss`.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    finite("min_margin", min_margin)
    cubes = voxels(workspace, size, min_margin=min_margin)
    lost = None
    if loss:
        lost = snapping_loss(
            workspace.robot, loss, size=cubes.size, seed=workspace.seed, reached=workspace, progress=progress
        )
    meridian, alpha = (_where_there_is_one(method, workspace, min_margin) for method in (meridian_volume, alpha_volume))
    return Findings(workspace, cubes, volume_of(cubes), meridian, alpha, lost)


def _where_there_is_one(method: Callable[..., Volume], workspace: Workspace, min_margin: float) -> Volume | None:
    """A volume by a method that some workspaces do not have: flat ones no alpha shape, and not all are round."""
    try:
        return method(workspace, min_margin=min_margin)
    except InputError:
        return None
