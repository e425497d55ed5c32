"""Reach of a robot: tips of many joint values, their volume and directions, and the part lost to snapping."""

from __future__ import annotations

from .loss import SnappingLoss, snapping_loss
from .sampling import METHODS, Workspace, load_workspace, save_workspace, workspace
from .volume import Findings, Volume, alpha_volume, examine, meridian_volume, voxel_volume
from .voxels import PATCHES, SharedWorkspace, Voxels, place_pair, shared_workspace, voxels

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
