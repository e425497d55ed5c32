"""Where a robot can reach: tips of many joint values, the volume they fill, from how many sides, and what snaps."""

from __future__ import annotations

from .findings import Findings, examine
from .loss import SnappingLoss, snapping_loss
from .run import load_workspace, save_workspace, workspace
from .samples import METHODS
from .shared import SharedWorkspace, place_pair, shared_workspace
from .table import Workspace
from .volume import Volume, alpha_volume, meridian_volume, voxel_volume
from .voxels import PATCHES, Voxels, voxels

__all__ = [
    "METHODS",
    "PATCHES",
    "Findings",
    "SharedWorkspace",
    "SnappingLoss",
    "Volume",
    "Voxels",
    "Workspace",
    "alpha_volume",
    "examine",
    "load_workspace",
    "meridian_volume",
    "place_pair",
    "save_workspace",
    "shared_workspace",
    "snapping_loss",
    "voxel_volume",
    "voxels",
    "workspace",
]
